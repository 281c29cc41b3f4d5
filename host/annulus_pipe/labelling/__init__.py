"""Frames to labelled frames: edges in host time, the flash that lit a frame, its place and roll. Sans-I/O."""
