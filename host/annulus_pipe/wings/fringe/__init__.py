"""Scans under a slide of fringes: the heights of a plate, the wall of a pipe, by motion phase shifting."""
