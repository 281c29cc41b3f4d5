"""A wall that swells inwards by 0.7 mm over 20 mm was listed as "joint, butt fusion", and so was a bead of 0.9 mm that
may be off by 2: whatever stood inwards all round was one. Fails without `Bead.is_none`, and without `Bead.is_sure`."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, NOISE_MM, round_pipe, scan

from annulus_pipe.wall import joints
from annulus_pipe.wall.beads import measure_bead
from annulus_pipe.wall.features import FeatureKind
from annulus_pipe.wall.survey import Survey, survey

STATIONS = [4.8 * i for i in range(25) if i % 5 != 4]
AT_MM = 180.0


def surveyed(stands: Callable[[np.ndarray], np.ndarray]) -> Survey:
    """stands : mm inwards, by chainage; the same all round."""
    profiles = scan(lambda c, z: round_pipe(c, z) - stands(z), z_mm=STATIONS, directions=360, seed=3)
    sigma = np.array(NOISE_MM, np.float32)
    return survey([replace(one, sigma_mm=sigma[one.ring]) for one in profiles], CALIBRATION)


def swell(height: float, half_mm: float) -> Callable[[np.ndarray], np.ndarray]:
    return lambda z: height * np.exp(-(((z - AT_MM) / half_mm) ** 2))


def rolls(height: float, width: float) -> Callable[[np.ndarray], np.ndarray]:
    def stands(z: np.ndarray) -> np.ndarray:
        arm = np.abs(z - AT_MM) * 4.0 / width - 1.0
        return np.where(arm < 1.0, height * np.sqrt(np.maximum(1.0 - arm * arm, 0.0)), 0.0)

    return stands


def names(pipe: Survey) -> list[tuple[FeatureKind, str]]:
    return [(one.kind, one.remark) for one in pipe.features]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("height", "half_mm"), [(0.72, 10.75), (0.8, 12.0), (1.0, 14.0), (0.7, 18.0), (0.9, 24.0)])
def test_a_wall_that_swells_is_no_weld(height: float, half_mm: float) -> None:
    assert (FeatureKind.JOINT, "butt fusion") not in names(surveyed(swell(height, half_mm)))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("height", "width"), [(1.2, 8.0), (1.2, 10.5), (2.0, 5.0), (4.0, 10.0)])
def test_a_bead_is_one(height: float, width: float) -> None:
    assert names(surveyed(rolls(height, width))) == [(FeatureKind.JOINT, "butt fusion")]


def test_a_bead_that_may_be_none_has_no_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(joints, "measure_bead", lambda *zone: replace(measure_bead(*zone), height_k2_mm=2.1))
    assert names(surveyed(rolls(1.2, 8.0))) == [(FeatureKind.NAMELESS, "a bead, or nothing")]
