"""Cameras, when their frames were taken, and which flash lit them. Knows no method and no wire."""
