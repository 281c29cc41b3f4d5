"""A camera of a head as a row of numbers that loops in C project with (host/native/stereo_lens.h): the same place as
`Camera.project`."""

import numpy as np

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import FloatArray
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
