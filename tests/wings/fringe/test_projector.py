"""The slide as calibration.json says it."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.wings.fringe.measure import Eye, FringeProjector, Shots, bore, projector, projector_to_dict, track
from annulus_pipe.wings.fringe.measure.placement import PlacedHead, PointLooks
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
    assert re.findall(r"#define SLIDE_LEAST (\d+)", slide) == [str(projector.PLAIN)]
    assert re.findall(r"#define BOUNCES (\d+)", slide) == [str(projector.BOUNCES)]
    names = re.findall(r"enum \{(.*)\}", camera)[0].replace(" ", "").split(",")
    assert [getattr(track, name) for name in names] == list(range(len(names)))
    fields = re.findall(r"typedef struct \{\s*Numbers ([^;]*);\s*\} ByEye;", wall)[0]
    assert fields.count(",") + 1 == bore.SUMS


LENS = (-0.03, 0.01, 0.002, -0.003, 0.001)
BALL = (0.5, -0.3, 60.0, 15.0)


def test_a_ball_sends_light_on_by_the_law_of_reflection() -> None:
    """Rays are followed from the slide over the ball; the phase where they arrive is that of where they left."""
    random = np.random.default_rng(3)
    angle, round_, centre = random.uniform(0.02, 0.2, 200), random.uniform(0, 2 * np.pi, 200), np.array(BALL[:3])
    way = np.stack([np.sin(angle) * np.cos(round_), np.sin(angle) * np.sin(round_), np.cos(angle)], axis=1)
    way = way[(way @ centre) ** 2 > centre @ centre - BALL[3] ** 2]
    met = way * (way @ centre - np.sqrt((way @ centre) ** 2 - centre @ centre + BALL[3] ** 2))[:, None]
    normal = (met - centre) / BALL[3]
    back = way - 2 * np.einsum("ni,ni->n", way, normal)[:, None] * normal
    there = met + random.uniform(30, 150, len(met))[:, None] * back
    slide = FringeProjector.from_dict(
        {**RINGS, "centre_mm": [0, 0, 0], "mirror": {"centre_mm": list(BALL[:3]), "radius_mm": BALL[3]}}
    )
    bare = replace(slide, mirror_mm=())
    assert len(way) > 150
    np.testing.assert_allclose(slide.phase(there), bare.phase(way), rtol=1e-10)


@pytest.mark.parametrize(("kind", "ball"), [("stripes", ()), ("rings", ()), ("rings", BALL)])
def test_loops_in_c_have_the_same_lens_and_ball_as_python(kind: str, ball: tuple[float, ...]) -> None:
    random = np.random.default_rng(1)
    slide = replace(FringeProjector.from_dict(STRIPES if kind == "stripes" else RINGS), distortion=LENS, mirror_mm=ball)
    slide = replace(slide, centre_mm=(0.4, -0.2, 5.0))
    shots = Shots.single(np.ones((3, 200, 200), np.float32))
    one = HeadCamera(0, Camera("pinhole", 200, 200, 90.0, 90.0, 99.5, 99.5), slide.rotation, (3.0, 2.0, 60.0))
    head = PlacedHead.at([Eye(one, slide)], shots, np.array([[0, 0, 0], [0.5, 0, 2], [0, 0.3, 4.0]]), 76.0)
    head.shading[:, 0, 1] = 50.0
    z = random.uniform(15, 40, 300) if ball else random.uniform(60, 100, 300)
    x = np.stack([random.uniform(15, 30, 300), random.uniform(15, 30, 300), z], axis=1)
    normal = np.tile([0.0, 0.0, -1.0], (300, 1))
    here, view = PointLooks.of(head, shots.images, x, normal), head.view
    for n in range(3):
        way = x - view.eyes[n]
        way *= 1e-4 / (way @ [0.0, 0.0, -1.0])[:, None]
        slope = (view.phase(x + way, n) - view.phase(x - way, n)) / 2e-4
        np.testing.assert_allclose(here.phase[n], view.phase(x, n), rtol=1e-9)
        np.testing.assert_allclose(here.slope[n], slope, rtol=1e-5, atol=1e-7)


def test_lens_and_ball_are_read_as_written_and_an_old_file_has_neither() -> None:
    slide = replace(FringeProjector.from_dict(RINGS), distortion=LENS, mirror_mm=BALL)
    assert FringeProjector.from_dict(projector_to_dict(slide)) == slide
    old = FringeProjector.from_dict(RINGS)
    assert not old.distortion and not old.mirror_mm and not old.numbers[4:].any()


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
        ({"distortion": [0.1] * 6}, "distortion"),
        ({"mirror": {"centre_mm": [0, 0, 10], "radius_mm": 12}}, "within the ball"),
    ],
)
def test_what_is_wrong_is_named(change: dict[str, object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        FringeProjector.from_dict({**STRIPES, **change})
    with pytest.raises(ValueError, match="must be an object"):
        FringeProjector.from_dict([])
