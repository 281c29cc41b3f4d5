"""The slide as calibration.json says it."""

import re
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.wings.fringe.measure import FringeProjector, bore, track
from annulus_pipe.wings.fringe.measure.projector import HARMONICS_MAX

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


def test_the_loops_in_c_count_as_python_does() -> None:
    native = Path(__file__).resolve().parents[3] / "host/native"
    slide, camera, wall = ((native / f"fringe_{one}").read_text() for one in ("projector.h", "camera.h", "bore.c"))
    assert re.findall(r"#define HARMONICS (\d+)", slide) == [str(HARMONICS_MAX)]
    assert re.findall(r"#define BLOCK (\d+)", camera) == [str(track.BLOCK)]
    names = re.findall(r"enum \{(.*)\}", camera)[0].replace(" ", "").split(",")
    assert [getattr(track, name) for name in names] == list(range(len(names)))
    fields = re.findall(r"typedef struct \{\s*Numbers ([^;]*);\s*\} ByEye;", wall)[0]
    assert fields.count(",") + 1 == bore.SUMS


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
