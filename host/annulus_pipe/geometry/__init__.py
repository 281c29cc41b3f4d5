"""Shapes and views: cameras, cones, cylinders, poses, the head's calibration as a value, targets in photographs.

Assumed: lengths in mm, angles in radians; the camera frame has z down the pipe, x right, y down as in the image; pixel
centres are at whole numbers, as in OpenCV. What cannot be computed (a ray that misses, a pixel the lens model cannot
invert) is NaN, never a guess. Knows no method, opens no file.
"""
