"""Frames on their way: shared memory, worker processes, viewers. Knows no method."""
