"""Methods beside the rings, each in a folder of its own: one physics, from its files to its pictures and commands."""
