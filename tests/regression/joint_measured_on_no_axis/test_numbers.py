"""Hi-lo 0.5 mm +- 0.03 where there was none, at a bead beside the bend; 1.8 +- 0.06 where it was 2, before the last 15
mm of a scan. Fails without `line_off`: what sound wall on both sides of a joint says of the line."""

import numpy as np
import pytest
from over_limit import _bead, scanned
from synthetic_pipe import CALIBRATION, RadiusMap, round_pipe

from annulus_pipe.wall.survey import Survey, survey

EVERY_SECOND = np.array([2.4 * i for i in range(50) if i % 5 != 4])[::2]
CLOCK_DEG = 216.0


def towards(clock: np.ndarray) -> np.ndarray:
    return np.cos(np.radians(clock - CLOCK_DEG))


def surveyed(wall: RadiusMap) -> Survey:
    return survey(scanned(wall, stations=EVERY_SECOND), CALIBRATION)


def assert_within(pipe: Survey, name: str, truth: float) -> None:
    """Whatever joint gives the number; none may."""
    given = [one for joint in pipe.features for one in joint.measures if one.name == name]
    assert all(abs(one.value - truth) <= one.k2 for one in given), given


def test_a_bead_beside_the_place_where_a_pipe_turns_is_not_moved_aside_by_it() -> None:
    def turned(c: np.ndarray, z: np.ndarray) -> np.ndarray:
        return round_pipe(c, z) + np.tan(np.radians(1.5)) * np.maximum(z - 129.0, 0.0) * towards(c)

    pipe = surveyed(_bead(turned, 147.6, 1.8))
    assert [str(one.kind) for one in pipe.features].count("joint") == 1
    assert_within(pipe, "hilo_mm", 0.0)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("left_mm", [15.0, 8.0, 10.0])
def test_next_to_an_end_of_the_scan_no_number_is_wrong(left_mm: float) -> None:
    pipe = surveyed(lambda c, z: round_pipe(c, z) + 2.0 * (z > 280.0 - left_mm) * towards(c))
    for name, truth in {"hilo_mm": 2.0, "angle_deg": 0.0, "step_mm": 0.0}.items():
        assert_within(pipe, name, truth)
