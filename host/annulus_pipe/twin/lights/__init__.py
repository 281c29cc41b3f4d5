"""What lights the wall. A light is a table of numbers for one frame and a kernel that adds to the pixels of a stretch.

`projector` is what all slides share: one point of light that falls off, is turned from, and is stopped by rods. What
the slide in it lets through is `slide.through`, chosen by the type of the slide's table when the frame's kernel is
compiled; `slits` is the one there is. A new slide is a file beside it and a line in `slide.slide_of`.
"""
