"""Rings of a pipe that lights itself, drawn: lost or drawn aside, but for the light of its own that is taken off."""

import cv2
import numpy as np
import pytest
from drawn import PIPE_MM, Paint, calibration, draw

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.pedestal import Pedestal, without_pedestal
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.wall.profile import Profile

POSE = Pose(0.012, -0.01, 1.0, -1.5)
WHITE, ORANGE = (1.0, 1.0, 1.0), (0.9, 0.45, 0.1)  # RGB that comes back
CAL = calibration()


def frame(albedo: tuple[float, float, float], indirect: float) -> np.ndarray:
    """A pipe of that colour; light of once more the same colour all over it, smooth, so many times the direct light's
    mean around there."""
    paint = Paint(light=((150, 8, 4), (10, 150, 22), (4, 20, 150)), supersample=2)
    direct = draw(CAL, POSE, paint=paint).astype(float) * albedo[::-1]
    around = cv2.GaussianBlur(direct, (0, 0), 40.0) * np.array(albedo[::-1])
    noise = np.random.default_rng(1).normal(0, 1.0, direct.shape)
    return np.clip(np.rint(direct + indirect * around + noise), 0, 255).astype(np.uint8)


def by_ring(profile: Profile) -> tuple[np.ndarray, np.ndarray]:
    """Points of each ring, and how far their median is outside the pipe, mm."""
    off = np.hypot(*profile.points_mm[:, :2].astype(float).T) - PIPE_MM
    count = np.bincount(profile.ring, minlength=5)
    return count, np.array([np.median(off[profile.ring == k]) if count[k] else np.nan for k in range(5)])


def looked(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return by_ring(Reconstructor(CAL, 360).profile(image, frame=0, z_mm=0.0))


def as_it_came(pedestal: Pedestal, image: np.ndarray) -> np.ndarray:
    return image


def test_no_ring_is_lost_where_an_orange_pipe_lights_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    image = frame(ORANGE, 1.5)
    count, off = looked(image)
    assert count.min() > 340 and np.abs(off).max() < 0.2, (count, off)
    monkeypatch.setattr(Pedestal, "taken_off", as_it_came)
    assert looked(image)[0].min() < 20  # what it is for


def test_rings_are_drawn_less_aside_where_a_white_pipe_lights_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    image = frame(WHITE, 1.5)
    fine = slice(2, 5)  # what noise does to a point of the inner rings is as much
    with_it = np.abs(looked(image)[1][fine]).max()
    monkeypatch.setattr(Pedestal, "taken_off", as_it_came)
    assert with_it < 0.5 * np.abs(looked(image)[1][fine]).max()


def test_a_stripe_that_goes_on_beyond_the_last_slit_stays_lit_beside_it() -> None:
    row = np.full((200, 400, 3), 40.0)  # light from everywhere, and one stripe from 100 on with slits up to 180
    row[:, 100:, 1] = 190.0
    for at in (100, 120, 140, 160, 180):
        row[:, at - 4 : at + 4] = 40.0
    image = cv2.GaussianBlur(row, (0, 0), 1.0).astype(np.uint8)
    after = without_pedestal(image, 20.0)
    assert after is not image
    assert after[100, 180].max() <= 2 and after[100, 190:205, 1].min() > 140


@pytest.mark.deep(
    gate="tests/scenes/rings/test_pedestal.py::test_a_stripe_that_goes_on_beyond_the_last_slit_stays_lit_beside_it"
)
def test_a_frame_without_such_light_stays_as_it_is() -> None:
    for light in (1.0, 0.4):
        image = (frame(WHITE, 0.0) * light).astype(np.uint8)
        assert without_pedestal(image, 20.0) is image
    black = np.zeros((200, 300, 3), np.uint8)
    assert without_pedestal(black, 20.0) is black
