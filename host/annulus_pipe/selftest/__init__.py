"""A controller times its own outputs: what firmware/README.md promises, and what this board keeps of it.

The turntable's STEP output, by a jumper, plays the camera; levels of the pins are read back at their pads (`scope`). So
one board, a jumper and a USB cable are all it needs. `lamps`, `microwave` and `line` are what is measured, `run` the
order, `page` the result for people.
"""
