"""What clear, still water does to the rings below it, undone.

A ring's light and the camera's view both bend where they enter the water. Both come along the pipe, at 20 to 35
degrees to the surface, so what lies a depth D below it seems to lie 0.1 to 0.3 D below it, the more so the wider the
ring: rings disagree in order. Whatever is opaque shows all rings at one height. Assumed: a flat, still surface across
y, and the pipe's own round bottom under it. Then one number explains a point, the height of the surface, and it is
solved for, point by point: rings that agree on it have seen water.
"""

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door

WATER = 1.333  # refractive index, visible light, 20 C; 1.331..1.339 from red to blue and from 0 to 30 C
LOWEST = 3.0  # of a point's height above the bottom: seen straight down, a depth shrinks to three quarters
SHALLOW = 1e-3  # of the radius: how far below eye and lamp it is at least
BISECTIONS = 26  # of lengths like the radius: to a thousandth of a micrometre

_surface_heights = door(
    "surface_heights",
    "f8[n,3] points",
    "f8[n,3] eyes",
    "f8[n,3] lamps",
    "f8[n,3] axes",
    "f8[n] radius",
    "f8 index",
    "f8 lowest",
    "f8 shallow",
    "i8 halvings",
    "f8[n]! out",
)


def surface_heights(
    points_mm: FloatArray, eyes_mm: FloatArray, lamps_mm: FloatArray, axes: FloatArray, radius_mm: FloatArray
) -> FloatArray:
    """(N,) mm: the y at which a water surface makes the pipe's bottom appear at each point; NaN where none does.

    Parameters
    ----------
    points_mm : (N, 3) as triangulated without water, in a frame with the pipe's axis along z and y straight down, the
        surface's normal. eyes_mm, lamps_mm : (N, 3) where each point's ray and its ring's cone start, same frame.
    axes : (N, 3) unit axes of the cones. radius_mm : (N,) of the pipe's bottom about z.
    """
    out = np.empty(len(points_mm))
    arrays = (np.ascontiguousarray(a, dtype=np.float64) for a in (points_mm, eyes_mm, lamps_mm, axes, radius_mm))
    _surface_heights(*arrays, WATER, LOWEST, SHALLOW, BISECTIONS, out)
    return out
