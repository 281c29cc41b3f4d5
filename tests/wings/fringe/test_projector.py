"""The slide as calibration.json says it."""

import numpy as np
import pytest

from annulus_pipe.wings.fringe.measure import FringeProjector
from annulus_pipe.wings.fringe.measure.projector import wave

STRIPES = {
    "kind": "stripes",
    "centre_mm": [20, 0, 0],
    "rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "period": 0.04,
    "phase0": 0.6,
}
RINGS = {**STRIPES, "kind": "rings", "centre_mm": [0, 0, -60], "period_mm": 8.0, "nominal_radius_mm": 101.6}


def test_stripes_are_even_in_the_tangent() -> None:
    slide = FringeProjector.from_dict(STRIPES)
    at = slide.phase(np.array([[20.0, 5.0, 100.0], [24.0, 5.0, 100.0], [28.0, 5.0, 200.0]]))
    np.testing.assert_allclose(at, [0.6, 0.6 + 2 * np.pi, 0.6 + 2 * np.pi])


def test_rings_are_even_on_the_wall_they_are_drawn_for() -> None:
    slide = FringeProjector.from_dict(RINGS)
    wall = np.array([[101.6 * np.cos(0.3), 101.6 * np.sin(0.3), z] for z in (80.0, 88.0, 96.0)])
    np.testing.assert_allclose(np.diff(slide.phase(wall)), 2 * np.pi)


def test_the_wave_has_its_harmonics_and_their_slope() -> None:
    numbers = FringeProjector.from_dict({**STRIPES, "harmonics": [0.1, -0.05, 0.02, 0.03]}).numbers
    for phase in np.linspace(-3, 3, 7):
        value, slope, _ = wave(numbers, phase)
        k = np.exp(1j * phase * np.array([1, 2, 3]))
        assert value == pytest.approx(float((k * [1, 0.1 + 0.05j, 0.02 - 0.03j]).real.sum()))
        step = wave(numbers, phase + 1e-6)[0] - wave(numbers, phase - 1e-6)[0]
        assert slope == pytest.approx(step / 2e-6, abs=1e-6)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"kind": "dots"}, "expected stripes or rings"),
        ({"period": 0}, "period"),
        ({"period": None}, "period"),
        ({"centre_mm": [1, 2]}, "centre_mm"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]}, "rotation"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "mirror"),
        ({"harmonics": [0.1]}, "harmonics"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        FringeProjector.from_dict({**STRIPES, **change})
    with pytest.raises(ValueError, match="must be an object"):
        FringeProjector.from_dict([])
