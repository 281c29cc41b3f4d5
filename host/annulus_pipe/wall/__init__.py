"""The pipe from the profiles of many frames: its wall, shape, stations, defects and colour.

`survey` is the whole pipeline in one pure call, arrays in, arrays out; the modules are its steps. A method (rings)
brings a frame's points, and finds the pipe in them with `pose`; nothing here knows how they were measured. Sees only
geometry and numbers, and never opens a file.
"""
