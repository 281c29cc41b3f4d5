"""A calibration says the same when it is read back, in both formats, and what cannot be one is named by its key."""

import copy
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.calibration import Calibration, HeadCamera, RingCorrection, camera_alone, head_from_dict
from annulus_pipe.geometry.camera import Camera, Mirror
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.vocabulary import AnnulusError

DATA = Path(__file__).parents[2] / "data"
CAMERA = Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)
RINGS = (Cone(0.33, (0.0, 0.0, 1.0), (0.0, 0.0, -56.0)), Cone(0.41, (0.0, 0.0, 1.0), (0.0, 0.0, -56.0)))
COVARIANCE = tuple(tuple(1e-4 if i == j else 0.0 for j in range(12)) for i in range(12))
CORRECTIONS = (RingCorrection((0.001, -0.002, 0.0)), RingCorrection((0.0, 0.0, 0.001, 0.0), (0.1, 0.0, -0.1, 0.0)))
TURNED = ((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def _corrected() -> Calibration:
    return Calibration(CAMERA, "RGB", RINGS, 76.2, COVARIANCE, CORRECTIONS)


def _two() -> Calibration:
    return replace(_corrected(), others=(HeadCamera(4, CAMERA, TURNED, (-40.0, 0.0, 1.5)),))


def through_json(calibration: Calibration) -> Calibration:
    return Calibration.from_dict(json.loads(json.dumps(calibration.to_dict())))


numbers = st.floats(-100.0, 100.0)
vectors = st.tuples(numbers, numbers, numbers)


@st.composite
def cameras(draw: st.DrawFn) -> Camera:
    model = draw(st.sampled_from(["pinhole", "fisheye", "mirror"]))
    count = draw(st.sampled_from([0, 4] if model == "fisheye" else [0, 4, 5, 8, 12, 14]))
    distortion = tuple(draw(st.lists(numbers, min_size=count, max_size=count)))
    mirror = Mirror((*draw(st.tuples(numbers, numbers)), 40.0), 10.0, draw(st.sampled_from(["back", "ahead"])))
    return Camera(
        model,
        draw(st.integers(16, 16384)),
        draw(st.integers(16, 16384)),
        draw(st.floats(1.0, 1e5)),
        draw(st.floats(1.0, 1e5)),
        draw(numbers),
        draw(numbers),
        distortion,
        mirror if model == "mirror" else None,
    )


@st.composite
def rotations(draw: st.DrawFn) -> Any:
    q = np.array(draw(st.tuples(st.floats(0.1, 1.0), numbers, numbers, numbers)))
    w, x, y, z = q / np.linalg.norm(q)
    rows = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return tuple(tuple(float(v) for v in row) for row in rows)


@st.composite
def calibrations(draw: st.DrawFn, several: bool) -> Calibration:
    colours = draw(st.text("RGB", min_size=2, max_size=5))
    count = len(colours) - 1
    angles = sorted(draw(st.sets(st.integers(10, 1500), min_size=count, max_size=count)))
    rings = []
    for angle in angles:
        x, y = draw(st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)))
        rings.append(Cone(angle / 1000, (x, y, math.sqrt(1 - x * x - y * y)), draw(vectors)))
    corrections = None
    if draw(st.booleans()):
        samples = st.lists(st.floats(-0.4, 0.4), min_size=3, max_size=3).map(tuple)
        corrections = tuple(RingCorrection(draw(samples), draw(st.none() | samples)) for _ in rings)
    sigma = draw(st.none() | st.floats(1e-6, 10.0))
    covariance = None if sigma is None else tuple(map(tuple, (sigma * np.eye(6 * count)).tolist()))
    first, *more = draw(st.lists(st.integers(0, 255), unique=True, min_size=1, max_size=3)) if several else [0]
    others = tuple(HeadCamera(number, draw(cameras()), draw(rotations()), draw(vectors)) for number in more)
    pattern = draw(st.none() | st.just({"kind": "fringe", "period_mm": 8.0})) if several else None
    if pattern is not None:
        colours, rings, corrections, covariance = "", [], None, None
    shifts = st.tuples(*[st.floats(0.0, 2.0)] * 3)
    moved, known = draw(shifts), draw(st.none() | shifts)
    if pattern is not None:
        moved, known = (0.0, 0.0, 0.0), None
    return Calibration(
        draw(cameras()),
        colours,
        tuple(rings),
        draw(st.floats(1.0, 5000.0)),
        covariance,
        corrections,
        others,
        first,
        pattern,
        translucency_mm=moved,
        translucency_sigma_mm=known,
    )


@pytest.mark.parametrize("several", [False, True])
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_what_was_written_is_read_back(several: bool, data: st.DataObject) -> None:
    written = data.draw(calibrations(several))
    read = through_json(written)
    assert replace(read, rings=()) == replace(written, rings=())
    for now, then in zip(read.rings, written.rings, strict=True):
        assert now.vertex_mm == then.vertex_mm
        assert now.half_angle == pytest.approx(then.half_angle, rel=1e-14)  # by way of degrees
        assert now.axis == then.axis
    simple = not written.others and written.pattern is None and written.camera_id == 0
    assert written.to_dict()["format"] == f"annulus-calibration/{1 if simple else 2}"


def test_the_examples_are_what_they_are_named() -> None:
    one, two = (json.loads((DATA / f"calibration-{n}.json").read_text()) for n in (1, 2))
    assert (one["format"], two["format"]) == ("annulus-calibration/1", "annulus-calibration/2")
    assert Calibration.from_dict(one).only().to_dict().keys() == one.keys()
    read = Calibration.from_dict(two)
    assert [camera.id for camera in read.cameras] == [0, 1] and read.kind == "slits" and len(read.rings) == 7
    assert read.camera == read.cameras[0].camera and read.cameras[0].rotation == ((1, 0, 0), (0, 1, 0), (0, 0, 1))
    assert read.corrections is not None and "correction" in two["rings"][0]
    assert read.to_dict().keys() == two.keys()


def test_a_residual_correction_is_read_by_either_name() -> None:
    data = _two().to_dict()
    for ring in data["rings"]:
        ring["fine"] = ring.pop("correction")
    assert Calibration.from_dict(data).corrections == CORRECTIONS
    assert "fine" in _corrected().to_dict()["rings"][0]


def test_a_file_of_before_has_neither_section() -> None:
    data = Calibration(CAMERA, "RGB", RINGS, 76.2).to_dict()
    assert "covariance" not in data and "fine" not in data["rings"][0] and "cameras" not in data
    read = Calibration.from_dict(data)
    assert read.covariance is None and read.corrections is None and read.only() is read


def test_what_knows_one_camera_says_so_in_one_line() -> None:
    with pytest.raises(AnnulusError, match="the head has 2 cameras, expected one") as refused:
        _two().only()
    assert "\n" not in str(refused.value)
    with pytest.raises(AnnulusError, match="projects fringe, expected slits"):
        replace(_corrected(), pattern={"kind": "fringe"}).only()
    for parse in (camera_alone, head_from_dict):
        with pytest.raises(ValueError, match="the head has 2 cameras, expected one"):
            parse(_two().to_dict())


def test_a_point_of_the_first_camera_is_where_the_other_sees_it() -> None:
    """The convention of OpenCV and of files: X_i = R_i X_0 + t_i, not its inverse."""
    other = through_json(_two()).others[0]
    assert np.array(other.rotation) @ [10.0, 0.0, 100.0] + other.translation_mm == pytest.approx([-40.0, 10.0, 101.5])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c[1].update(id=0), r'"cameras\[1\].id" is 0, and so is another'),
        (lambda c: c[1].update(id=1.5), r'"cameras\[1\].id" is 1.5, expected a whole number'),
        (lambda c: c[1].pop("id"), r'"cameras\[1\].id" is missing'),
        (lambda c: c[1].update(fx="wide"), r'"cameras\[1\].fx" is \'wide\''),
        (lambda c: c[1].pop("rotation"), r'"cameras\[1\].rotation" is missing'),
        (lambda c: c[1].pop("translation_mm"), r'"cameras\[1\].translation_mm" is missing'),
        (lambda c: c[1].update(rotation=[[1, 0, 0], [0, 1, 0]]), r"rotation. must be three rows"),
        (lambda c: c[1].update(rotation=[[1, 0, 0], [0, 1, 0], [0, 0]]), r"rotation\[2\]. must be a list of 3"),
        (lambda c: c[0].update(rotation=c[1]["rotation"]), r'"cameras\[0\]" is the first camera'),
        (lambda c: c[0].update(translation_mm=[0, 0, 1]), r'"cameras\[0\]" is the first camera'),
        (lambda c: c.clear(), r'"cameras" must be a list of 1..16'),
        (lambda c: c.append(None), r"cameras\[2\] must be an object"),
    ],
)
def test_a_list_of_cameras_that_is_wrong_is_named(change: Any, words: str) -> None:
    data = copy.deepcopy(_two().to_dict())
    change(data["cameras"])
    with pytest.raises(ValueError, match=words) as refused:
        Calibration.from_dict(data)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "rows",
    [
        [[0, 1, 0], [1, 0, 0], [0, 0, 1]],  # left for right
        [[1.001, 0, 0], [0, 1, 0], [0, 0, 1.001]],
        [[1, 0, 0], [0.0001, 1, 0], [0, 0, 1]],
        [[0, 0, 0]] * 3,
    ],
)
def test_a_rotation_is_one(rows: list[list[float]]) -> None:
    data = _two().to_dict()
    data["cameras"][1]["rotation"] = rows
    with pytest.raises(ValueError, match=r'"cameras\[1\].rotation" is no rotation: it is off by'):
        Calibration.from_dict(data)


def test_sections_that_do_not_fit_are_named() -> None:
    for key, value, words in [
        ("format", "annulus-calibration/3", '"format" is'),
        ("pattern", {"kind": "dots"}, "expected one of slits, line, lines, fringe"),
        ("rings", [], '"rings" must list 2 slits, one between each two of 3'),
        ("covariance", [[1.0]], "12 rows"),
        ("covariance", [[math.nan] * 12] * 12, r'"covariance\[0\]", number 1, is nan'),
        ("covariance", [[float(i == j) + 2.0 * (i + j == 1) for j in range(12)] for i in range(12)], "does not fit"),
    ]:
        data = _corrected().to_dict()
        data[key] = value
        with pytest.raises(ValueError, match=words):
            Calibration.from_dict(data)
    for correction, words in [
        ({}, "offset_rad"),
        ({"offset_rad": [0.0, 0.0]}, "3..4096"),
        ({"offset_rad": [0.0] * 4, "shift_mm": [0.0] * 3}, "list of 4"),
    ]:
        data = _corrected().to_dict()
        data["rings"][1]["fine"] = correction
        with pytest.raises(ValueError, match=words):
            Calibration.from_dict(data)
    data = _corrected().to_dict()
    del data["rings"][1]["fine"]
    with pytest.raises(ValueError, match=r"rings\[1\].* has no correction"):
        Calibration.from_dict(data)


def test_more_rings_than_are_read_are_refused() -> None:
    data = replace(_corrected(), colours="", covariance=None, corrections=None, pattern={"kind": "line"}).to_dict()
    ring = data["rings"][0]
    for many in (64, 65):
        data["rings"] = [ring | {"theta_full_deg": 10.0 + n} for n in range(many)]
        if many == 64:
            assert len(Calibration.from_dict(data).rings) == 64
    with pytest.raises(ValueError, match='"rings" lists 65, expected at most 64'):
        Calibration.from_dict(data)
