"""`annulus calibrate`: from a scan or photographs to a section of calibration.json, with what it is worth.

Reads frames, hands them to the method's own maths (`rings.calibration`, `geometry.intrinsics`), judges the answer, says
in words what to do better, and writes. Assumed: a frame was lit as its label says. An answer that the frames do not
hold is refused in one line; one that is merely weak is written with its uncertainty and a warning. README.md here is
for the user.
"""
