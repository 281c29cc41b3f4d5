"""What lights the wall. A light is a table of numbers for one frame, which a loop of host/native/twin_lights.c reads.

`projector` is what all slides share: one point of light that falls off, is turned from, and is stopped by rods. What
the slide in it lets through is said by a table and a loop of its own; `slits` is the one there is. A new slide is a
file beside it, a loop in C with a line in SLIDES of twin_lights.c, and a line in `slide.slides_of`.
"""
