"""A thermoacoustic measurement from file to file: simulate or acquire a sweep, decode it, make its image.

Ties `thermoacoustic` (the physics) to the controller, the digitizer and the files of `record`. What a person sees of it
is `annulus tai` and `annulus burst`.
"""
