"""Another camera's photographs among those of one, and turned ones: found, named, and nobody accused for nothing."""

from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from photographs import DrawnTarget, corners, photograph, poses, read

from annulus_pipe.calibrate.camera import calibrate_camera, image_files
from annulus_pipe.calibrate.strangers import strangers
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.chessboard import cropped, find_target
from annulus_pipe.geometry.intrinsics import TargetObservation, fit_intrinsics
from annulus_pipe.vocabulary import AnnulusError

STEREO = Path(__file__).parents[2] / "data" / "opencv-stereo"
PINHOLE = Camera("pinhole", 640, 480, 530.0, 531.0, 325.0, 236.0, (-0.28, 0.08, 1e-3, -5e-4, 0.0))


@lru_cache(maxsize=1)
def real() -> dict[str, TargetObservation]:
    out = {}
    for file in sorted(STEREO.glob("*.jpg")):
        view = find_target(cv2.imread(str(file)))
        assert view is not None
        view = cropped(view, 9, 6)
        out[file.stem] = TargetObservation(25.0 * view.cells, view.pixels)
    return out


def of(side: str, first: int = 0, count: int = 13) -> dict[str, TargetObservation]:
    named = {name: view for name, view in real().items() if name.startswith(side)}
    return {name: named[name] for name in list(named)[first : first + count]}


def turned(views: dict[str, TargetObservation], x: int, y: int) -> dict[str, TargetObservation]:
    """As their pictures' flips would have been read."""
    size = np.array([639.0, 479.0])
    return {
        name: TargetObservation(v.target_mm * [x * y, 1], v.pixels * [x, y] + size * (np.array([x, y]) < 0))
        for name, v in views.items()
    }


def named(views: dict[str, TargetObservation]) -> dict[str, str]:
    fit = fit_intrinsics(list(views.values()), 640, 480, "pinhole", PINHOLE)
    return {list(views)[i]: why for i, why in strangers(fit, list(views.values()), list(views)).items()}


@pytest.mark.deep(gate="tests/scenes/calibrate/test_strangers.py::test_a_drawn_album_of_one_camera_has_no_strangers")
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_real_album_of_one_camera_has_no_strangers(side: str) -> None:
    assert not named(of(side))
    assert not named(of(side, 3, 7))


def test_a_drawn_album_of_one_camera_has_no_strangers() -> None:
    rng = np.random.default_rng(2)
    for trial in range(12):
        views = [read(v, rng, 0.1, 0.15) for v in corners(PINHOLE, (6, 10, 16)[trial % 3], seed=trial)]
        assert not named({str(i): view for i, view in enumerate(views)})


@pytest.mark.deep(gate="tests/scenes/calibrate/test_strangers.py::test_a_lot_of_turned_photographs_is_left_out_by_name")
def test_photographs_of_two_cameras_in_equal_number_are_refused_by_name() -> None:
    with pytest.raises(AnnulusError, match=r"1[0-3] photographs are another camera's") as caught:
        named(of("left") | of("right"))
    said = str(caught.value)
    assert "\n" not in said
    assert max(said.count("left"), said.count("right")) >= 10
    assert ("left" in said) != ("right" in said)


@pytest.mark.deep(gate="tests/scenes/calibrate/test_strangers.py::test_a_lot_of_turned_photographs_is_left_out_by_name")
def test_a_few_photographs_of_another_camera_are_left_out_by_name() -> None:
    for some in (of("right", 0, 4), of("right", 8, 4), of("right", 6, 2)):
        why = named(of("left") | some)
        assert why.keys() == some.keys()
        assert all("another camera's" in one for one in why.values())


@pytest.mark.deep(gate="tests/scenes/calibrate/test_strangers.py::test_a_drawn_album_of_one_camera_has_no_strangers")
@pytest.mark.parametrize(
    ("x", "y", "said"), [(-1, -1, "turned by 180"), (-1, 1, "mirrored left"), (1, -1, "mirrored top")]
)
def test_a_turned_photograph_is_left_out_by_name(x: int, y: int, said: str) -> None:
    one = turned({"left11": real()["left11"]}, x, y)
    why = named(of("left") | one)
    assert why.keys() == one.keys()
    assert said in why["left11"]


def test_a_lot_of_turned_photographs_is_left_out_by_name() -> None:
    why = named(of("left", 0, 9) | turned(of("left", 9), -1, -1))
    assert why.keys() == of("left", 9).keys()
    assert all("turned by 180" in one for one in why.values())


@pytest.mark.deep(gate="tests/scenes/calibrate/test_strangers.py::test_a_lot_of_turned_photographs_is_left_out_by_name")
def test_photographs_on_their_side_and_mirrored_markers_are_named(tmp_path: Path) -> None:
    target = DrawnTarget(8, 6, markers="6X6")
    for i, pose in enumerate(poses(PINHOLE, target, 6, fill=0.7, off=0.4, seed=2)):
        image = photograph(PINHOLE, target, *pose, blur_px=0.6, seed=i)
        image = np.rot90(image) if i == 1 else image[:, ::-1] if i == 4 else image
        cv2.imwrite(str(tmp_path / f"{i}.png"), image)
    result = calibrate_camera(image_files([tmp_path]), model="pinhole")
    why = {p.file: p.rejected for p in result.photographs if p.rejected}
    assert why.keys() == {"1.png", "4.png"}
    assert "turned by 90 degrees (480x640)" in why["1.png"]
    assert "mirrored" in why["4.png"]
    assert all(p.own_origin for p in result.photographs if not p.rejected)
