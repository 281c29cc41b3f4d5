"""Where points lie in an image, in C: as OpenCV has it."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.camera import Camera, Mirror

few = settings(max_examples=30, deadline=None, derandomize=True)


@few
@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0, 4, 5, 8, 12, 14]), fisheye=st.booleans())
def test_pixels_are_opencvs(seed: int, size: int, fisheye: bool) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 40, (30, 3))
    points[:, 2] = rng.uniform(20, 200, 30)
    lens = rng.normal(0, 0.02, 4 if fisheye else size)
    camera = Camera("fisheye" if fisheye else "pinhole", 1664, 1232, 700.0, 701.0, 830.0, 615.0, tuple(lens))
    turn, shift = cv2.Rodrigues(rng.normal(0, 0.1, 3))[0], rng.normal(0, 3, 3)
    moved = (points @ turn.T + shift).reshape(-1, 1, 3)
    k = lens if fisheye else np.pad(lens, (0, max(5 - size, 0)))
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    expected = project(moved, np.zeros(3), np.zeros(3), camera.matrix, k)[0].reshape(-1, 2)
    np.testing.assert_allclose(camera.project(points, turn, shift), expected, rtol=1e-9, atol=1e-6)
    near = camera.project(points, turn, shift, 80.0)
    np.testing.assert_array_equal(np.isnan(near[:, 0]), moved[:, 0, 2] < 80.0)


@few
@given(st.lists(st.tuples(*[st.floats()] * 3), max_size=9), st.sampled_from(["pinhole", "fisheye"]))
def test_rubbish_has_a_pixel_or_none(points: list[tuple[float, float, float]], model: str) -> None:
    camera = Camera(model, 1664, 1232, 700.0, 701.0, 830.0, 615.0, (0.1, 0.01, 0.0, 0.0))  # type: ignore[arg-type]
    assert camera.project(np.array(points).reshape(-1, 3)).shape == (len(points), 2)


def test_what_a_pinhole_has_behind_it_has_no_pixel() -> None:
    camera = Camera("pinhole", 1664, 1232, 700.0, 701.0, 830.0, 615.0)
    pixels = camera.project(np.array([[1.0, 2.0, 4.0], [1.0, 2.0, 0.0], [1.0, 2.0, -4.0]]))
    assert pixels[0] == pytest.approx([830.0 + 700.0 / 4, 615.0 + 701.0 / 2])
    assert np.isnan(pixels[1:]).all()


@few
@given(
    seed=st.integers(0, 2**32 - 1), size=st.sampled_from([0, 5, 8, 14]), model=st.sampled_from(["pinhole", "mirror"])
)
def test_rows_of_places_have_the_pixels_of_their_points(seed: int, size: int, model: str) -> None:
    rng = np.random.default_rng(seed)
    mirror = Mirror((0.3, -0.2, 45.0), 10.0) if model == "mirror" else None
    lens = tuple(rng.normal(0, 0.02, size))
    camera = Camera(model, 1664, 1232, 700.0, 701.0, 830.0, 615.0, lens, mirror)  # type: ignore[arg-type]
    t, radius = np.arange(9) * 0.7, rng.uniform(70.0, 80.0, (3, 9))
    around, rows = np.stack([np.sin(t), -np.cos(t)]), rng.normal(0, 1, (3, 3, 3)) + np.diag([1.0, 1.0, 90.0])
    points = np.einsum("rij,jra->rai", rows, np.concatenate([radius * around[:, None], np.ones((1, 3, 9))]))
    expected = camera.project(points.reshape(-1, 3), nearest_mm=20.0)
    np.testing.assert_allclose(camera.project_rows(radius, around, rows, 20.0), expected, rtol=1e-9, atol=1e-6)
