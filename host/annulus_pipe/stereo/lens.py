"""A camera of a head as a row of numbers that compiled loops can project with: the same place as `Camera.project`."""

import math

import numpy as np

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import jit
from annulus_pipe.rings.polar import PolarGrid
from annulus_pipe.vocabulary import AnnulusError

DISTORTION, ROTATION, TRANSLATION, GRID = 5, 17, 26, 29  # where they begin
NUMBERS = 34


def lens_numbers(camera: Camera, rotation: FloatArray, translation_mm: FloatArray, grid: PolarGrid) -> FloatArray:
    """(NUMBERS,) model, fx, fy, cx, cy, distortion, rotation and translation from the head, centre, first and step of
    the grid's lines and how many there are. Raises AnnulusError for a lens that no head beside its projector has."""
    if camera.model == "mirror" or any(camera.distortion[12:]):
        raise AnnulusError(
            f"calibration: a {camera.model} camera with {len(camera.distortion)} numbers of distortion, expected "
            "fisheye, or pinhole with 12 at most, beside a projector"
        )
    out = np.zeros(NUMBERS)
    out[:5] = 0.0 if camera.model == "fisheye" else 1.0, camera.fx, camera.fy, camera.cx, camera.cy
    out[DISTORTION : DISTORTION + min(len(camera.distortion), 12)] = camera.distortion[:12]
    out[ROTATION:TRANSLATION], out[TRANSLATION:GRID] = rotation.ravel(), translation_mm
    out[GRID:] = *grid.centre, grid.first, grid.step, len(grid.cosine)
    return out


@jit
def on_line(lens, px, py, pz):  # type: ignore[no-untyped-def]
    """A point of the head's frame, mm -> the line it is seen on and the sample along it; NaN behind a pinhole."""
    r, t, g = lens[ROTATION:], lens[TRANSLATION:], lens[GRID:]
    x = r[0] * px + r[1] * py + r[2] * pz + t[0]
    y = r[3] * px + r[4] * py + r[5] * pz + t[1]
    z = r[6] * px + r[7] * py + r[8] * pz + t[2]
    d = lens[DISTORTION:]
    if lens[0] == 0.0:
        rho = math.sqrt(x * x + y * y)
        theta = math.atan2(rho, z)
        t2 = theta * theta
        scale = theta * (1 + t2 * (d[0] + t2 * (d[1] + t2 * (d[2] + t2 * d[3])))) / max(rho, 1e-12)
        u, v = x * scale, y * scale
    else:
        if z <= 1e-9:
            return np.nan, np.nan
        a, b = x / z, y / z
        q = a * a + b * b
        radial = (1 + q * (d[0] + q * (d[1] + q * d[4]))) / (1 + q * (d[5] + q * (d[6] + q * d[7])))
        u = a * radial + 2 * d[2] * a * b + d[3] * (q + 2 * a * a) + q * (d[8] + q * d[9])
        v = b * radial + d[2] * (q + 2 * b * b) + 2 * d[3] * a * b + q * (d[10] + q * d[11])
    u, v = lens[1] * u + lens[3] - g[0], lens[2] * v + lens[4] - g[1]
    line = math.atan2(v, u) * (g[4] / (2 * math.pi))
    if line < 0:
        line += g[4]
    return line, (math.sqrt(u * u + v * v) - g[2]) * g[3]
