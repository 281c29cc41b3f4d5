"""What host/native/calibration_bundle.c finds along an observation's line, by scipy's root finder and differences."""

import math

import numpy as np
from scipy.optimize import brentq

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.calibration.observations import RAY_STEP_PX

SIZES = np.array([1e-6] * 3 + [1e-4] * 3 + [1e-6] * 2 + [1e-4] * 3)  # of steps: half-angle .. ty and the radius


def on_line(three: FloatArray, at: float) -> FloatArray:
    """(3,) Lagrange's parabola through what is RAY_STEP_PX nearer, at the slit and farther out."""
    p = at / RAY_STEP_PX
    return 0.5 * p * (p - 1) * three[0] + (1 - p * p) * three[1] + 0.5 * p * (p + 1) * three[2]


def angle_off(
    rays: FloatArray, origins: FloatArray, at: float, numbers: FloatArray, sectors: FloatArray, camera: FloatArray
) -> float:
    """Angle about the cone's axis of the wall's point seen at `at`, less the cone's half-angle there.

    numbers (11,): half-angle, axis x y, vertex x y z, rx, ry, tx, ty, radius. sectors (2, n): offset and shift of the
    ring's sectors, n may be 0. camera (6,): how it is turned about its centre, and moved.
    """
    way, start = on_line(rays, at), on_line(origins, at) + camera[3:]
    way = way + np.cross(camera[:3], way)
    half, ax, ay, *vertex, rx, ry, tx, ty, radius = numbers
    turn_x = np.array([[1, 0, 0], [0, math.cos(rx), -math.sin(rx)], [0, math.sin(rx), math.cos(rx)]])
    turn_y = np.array([[math.cos(ry), 0, math.sin(ry)], [0, 1, 0], [-math.sin(ry), 0, math.cos(ry)]])
    across = (turn_x @ turn_y).T[:2]
    q, w = across @ (start - np.array([tx, ty, 0.0])), across @ way
    a, b, c = w @ w, q @ w, q @ q - radius**2  # Eq. 1
    d = start + (math.sqrt(b * b - a * c) - b) / a * way - np.array(vertex)
    axis = np.array([ax, ay, math.sqrt(max(1.0 - ax * ax - ay * ay, 1e-12))])
    far = float(np.linalg.norm(d))
    d = d / far
    cosine, sine = float(d @ axis), float(np.linalg.norm(np.cross(d, axis)))
    offset, shift = sector_at(sectors, d, axis) if sectors.size else (0.0, 0.0)
    return math.atan2(sine * far, cosine * far - shift) - half - offset


def sector_at(sectors: FloatArray, d: FloatArray, axis: FloatArray) -> tuple[float, float]:
    """Offset and shift where a direction runs, linear between the sectors' beginnings."""
    e1 = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
    turn = math.atan2(float(np.cross(axis, e1) @ d), float(e1 @ d)) / (2 * math.pi) % 1.0
    n = sectors.shape[1]
    at = np.arange(n + 1) / n
    offset, shift = (float(np.interp(turn, at, np.append(row, row[0]))) for row in sectors)
    return offset, shift


def place(rays: FloatArray, origins: FloatArray, numbers: FloatArray, sectors: FloatArray, camera: FloatArray) -> float:
    """px along the line, where the image of the ring crosses it."""
    return float(brentq(lambda at: angle_off(rays, origins, at, numbers, sectors, camera), -40.0, 40.0, xtol=1e-13))


def moved(rays: FloatArray, origins: FloatArray, numbers: FloatArray, sectors: FloatArray) -> FloatArray:
    """(17,) how that place moves with the numbers and with the camera's turn and centre, by differences."""
    still, out = np.zeros(6), np.empty(17)
    for i in range(17):
        step = SIZES[i] if i < 11 else (1e-6 if i < 14 else 1e-4)
        ends = []
        for way in (-1.0, 1.0):
            n, c = numbers.copy(), still.copy()
            (n if i < 11 else c)[i if i < 11 else i - 11] += way * step
            ends.append(place(rays, origins, n, sectors, c))
        out[i] = (ends[1] - ends[0]) / (2 * step)
    return out


def middle(
    rays: FloatArray,
    origins: FloatArray,
    at: float,
    numbers: FloatArray,
    sectors: FloatArray,
    width: float,
    probe: float,
) -> float:
    """px from a slit's middle to its cone, which lies at the middle of its edges' angles: t''/t' w^2 / 8."""

    def angle(there: float) -> float:
        return angle_off(rays, origins, there, numbers, sectors, np.zeros(6))

    slopes = [(angle(at + d + 1e-3) - angle(at + d - 1e-3)) / 2e-3 for d in (-probe, probe)]
    return (slopes[1] - slopes[0]) / (angle(at + probe) - angle(at - probe)) * width**2 / 8
