"""On clean black the flanks of a thin line were all that changed and were taken for noise: the line was not seen."""

import math

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.rings.reconstructor import Reconstructor


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("thick", [0.5, 0.8, 1.1, 2.0])
def test_a_line_on_clean_black_is_seen(thick: float) -> None:
    v, u = np.mgrid[0:288, 0:352]
    light = 200 * np.exp(-0.5 * ((np.hypot(u - 176, v - 144) - 84) / thick) ** 2)
    image = np.stack([0.3 * light, 0.1 * light, light], axis=2).astype(np.uint8)
    plane = Cone(math.pi / 2, (0.0, 0.0, 1.0), (0.0, 0.0, 250.0 * 150.0 / 84.0))
    camera = Camera("pinhole", 352, 288, 250.0, 250.0, 176.0, 144.0)
    known = Calibration(camera, "", (plane,), 150.0, pattern={"kind": "line"})
    profile = Reconstructor(known).profile(image, frame=0, z_mm=0.0)
    radius = np.hypot(*profile.points_mm[:, :2].T)
    assert len(radius) > 600 and abs(radius.mean() - 150.0) < 0.3
