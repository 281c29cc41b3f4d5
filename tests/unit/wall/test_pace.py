"""The odometer against marks on the wall: a wrong one is reported, a right one is not, and a wall without marks says
nothing."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from synthetic_pipe import CALIBRATION, RADIUS_MM, round_pipe, scan

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.wall.pace import ODOMETER
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.texture import LedFrame

STATIONS = [5.0 * i for i in range(34)]
SIDE_MM = 0.5  # of a speck


def photographed(z_mm: float, specks: np.ndarray) -> np.ndarray:
    """(308, 416, 3) uint8: a ray of every pixel meets the pipe, and the light falls off with the distance."""
    camera = CALIBRATION.camera
    y, x = np.mgrid[: camera.height, : camera.width].astype(float)
    u, v = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    ahead = RADIUS_MM / np.maximum(np.hypot(u, v), 1e-3)
    row = np.clip((ahead + z_mm) / SIDE_MM, 0, len(specks) - 1).astype(int)
    column = (np.arctan2(v, u) / (2 * np.pi) % 1.0 * specks.shape[1]).astype(int)
    light = specks[row, column] * 200.0 * np.minimum(RADIUS_MM / ahead, 1.0)
    return np.repeat(np.clip(light, 0, 255).astype(np.uint8)[..., None], 3, axis=2)


def scanned(went: float, contrast: float, calibration: Calibration = CALIBRATION) -> Survey:
    """By a head that goes `went` times as far as its odometer counts."""
    rng = np.random.default_rng(4)
    specks = ndimage.gaussian_filter(rng.normal(size=(1400, 960)), (5, 5), mode="wrap")
    specks = 0.7 + contrast * specks / specks.std()
    led = [LedFrame(1000 + i, 30.0 * i, photographed(went * 30.0 * i, specks)) for i in range(6)]
    return survey(scan(round_pipe, z_mm=STATIONS), calibration, led)


@pytest.mark.deep(but=2)
@pytest.mark.parametrize(
    ("went", "contrast"), [(1.05, 0.08), (1.0, 0.08), (1.05, 0.0), (0.95, 0.08), (1.03, 0.08), (0.95, 0.0)]
)
def test_marks_contradict_a_wrong_odometer_and_no_other(went: float, contrast: float) -> None:
    reported = [one.text for one in scanned(went, contrast).findings if one.kind == ODOMETER]
    if went == 1.0 or contrast == 0.0:
        assert not reported
        return
    (line,) = reported
    part, which = line.split("it counts ")[1].split(" % ")[0], "more" if went < 1 else "less"
    assert float(part) == pytest.approx(100 * abs(went - 1), abs=0.5)
    assert f"% {which} than the head went" in line


def test_marks_that_lie_closer_than_the_cable_went_say_that_the_lens_is_longer_than_calibrated() -> None:
    """What `with_marks` takes it for: f R is larger than measured by as much."""
    camera = CALIBRATION.camera
    shorter = replace(camera, fx=camera.fx / 1.01, fy=camera.fy / 1.01)
    scale = scanned(1.0, 0.08, replace(CALIBRATION, camera=shorter)).scale
    assert scale is not None and scale.marks is not None
    assert scale.marks[0] == pytest.approx(0.01, abs=0.003)
