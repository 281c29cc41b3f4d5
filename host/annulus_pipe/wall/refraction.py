"""What clear, still water does to the rings below it, undone.

A ring's light and the camera's view both bend where they enter the water. Both come along the pipe, at 20 to 35
degrees to the surface, so what lies a depth D below it seems to lie 0.1 to 0.3 D below it, the more so the wider the
ring: rings disagree in order. Whatever is opaque shows all rings at one height. Assumed: a flat, still surface across
y, and the pipe's own round bottom under it. Then one number explains a point, the height of the surface, and it is
solved for, point by point: rings that agree on it have seen water.
"""

import math

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import jit

WATER = 1.333  # refractive index, visible light, 20 C; 1.331..1.339 from red to blue and from 0 to 30 C
LOWEST = 3.0  # of a point's height above the bottom: seen straight down, a depth shrinks to three quarters
BISECTIONS = 26  # of lengths like the radius: to a thousandth of a micrometre


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
    _heights(*arrays, WATER, out)
    return out


@jit
def _heights(points, eyes, lamps, axes, radius, index, out):  # type: ignore[no-untyped-def]
    for n in range(len(points)):
        p, eye, lamp, axis = points[n], eyes[n], lamps[n], axes[n]
        dx, dy, dz = p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]
        length = math.sqrt(dx * dx + dy * dy + dz * dz)
        way = (dx / length, dy / length, dz / length)
        vx, vy, vz = p[0] - lamp[0], p[1] - lamp[1], p[2] - lamp[2]
        ring = (vx * axis[0] + vy * axis[1] + vz * axis[2]) / math.sqrt(vx * vx + vy * vy + vz * vz)
        bottom = math.sqrt(max(radius[n] ** 2 - p[0] ** 2, 0.0))
        low = max(p[1] - LOWEST * (bottom - p[1]), max(eye[1], lamp[1]) + 1e-3 * radius[n])
        high = p[1]
        out[n] = np.nan
        if not low < high or way[1] <= 0.0:
            continue
        at_low = _cosine(low, eye, way, lamp, axis, radius[n], index) - ring
        at_high = _cosine(high, eye, way, lamp, axis, radius[n], index) - ring
        if not at_low * at_high < 0.0:
            continue
        for _ in range(BISECTIONS):
            middle = 0.5 * (low + high)
            if (_cosine(middle, eye, way, lamp, axis, radius[n], index) - ring) * at_low > 0.0:
                low = middle
            else:
                high = middle
        out[n] = 0.5 * (low + high)


@jit
def _cosine(height, eye, way, lamp, axis, radius, index):  # type: ignore[no-untyped-def]
    """Cosine of the angle between a cone's axis and the light, as it leaves the lamp, that lights what a ray sees."""
    s = (height - eye[1]) / way[1]
    ax, az = eye[0] + s * way[0], eye[2] + s * way[2]
    wx, wz = way[0] / index, way[2] / index
    wy = math.sqrt(1.0 - wx * wx - wz * wz)
    a = wx * wx + wy * wy
    b = ax * wx + height * wy
    inside = b * b - a * (ax * ax + height * height - radius * radius)
    if inside < 0.0:
        return np.nan
    s = (math.sqrt(inside) - b) / a
    qx, qy, qz = ax + s * wx, height + s * wy, az + s * wz
    # where light from the lamp enters the water so that it gets there: Snell's law along the surface
    far = math.sqrt((qx - lamp[0]) ** 2 + (qz - lamp[2]) ** 2)
    above, below = height - lamp[1], qy - height
    low, high = 0.0, far
    for _ in range(BISECTIONS):
        u = 0.5 * (low + high)
        if u * math.sqrt((far - u) ** 2 + below * below) < index * (far - u) * math.sqrt(u * u + above * above):
            low = u
        else:
            high = u
    part = low / max(far, 1e-9)
    bx, by, bz = (qx - lamp[0]) * part, above, (qz - lamp[2]) * part
    return (bx * axis[0] + by * axis[1] + bz * axis[2]) / math.sqrt(bx * bx + by * by + bz * bz)
