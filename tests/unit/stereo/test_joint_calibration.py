"""Rings, poses, the second camera's place and the colours' shifts, from the same frames of a tube."""

import math

import numpy as np
import pytest
from drawn_head import COLOURS, RADIUS_MM, head

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose, pose_of
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.observations import Observations, joined, observe
from annulus_pipe.rings.polar import ring_pixels
from annulus_pipe.vocabulary import AnnulusError

LEAN = math.radians(11.0)
WAYS = ((1, 1, 12, 12), (-1, -1, -12, -12), (1, -1, 12, -12), (-1, 1, -12, 12), (0, 1.2, 0, 15), (1.2, 0, 15, 0))
POSES = [Pose(a * LEAN, b * LEAN, -8.1 + c, -7.6 + d) for a, b, c, d in WAYS]
SHIFT_PX = np.array([[0.3, 0.2, 0.1, 0.0], [0.0, 0.0, 0.0, 0.0], [-0.3, -0.2, 0.0, 0.1]])


def seen(shifted: bool, off_px: float = 0.0, steps: int = 120) -> Observations:
    """off_px : by so much each twelfth of a ring's image is off, in all poses alike, standard deviation."""
    calibration, parts, random = head(1.0), [], np.random.default_rng(13)
    for of in calibration.cameras:
        turn, moved = np.array(of.rotation), np.array(of.translation_mm)
        rings = [
            Cone(c.half_angle, tuple(turn @ c.axis), tuple(turn @ np.array(c.vertex_mm) + moved))
            for c in calibration.rings
        ]
        frame, ring, pixels = [], [], []
        for j, pose in enumerate(POSES):
            own = pose_of(turn @ pose.rotation[:, 2], turn @ pose.translation + moved)
            for k, cone in enumerate(rings):
                at = ring_pixels(of.camera, cone, own, RADIUS_MM, steps)
                at = at[np.isfinite(at).all(axis=1)]
                frame.append(np.full(len(at), j))
                ring.append(np.full(len(at), k))
                pixels.append(at)
        of_frame, of_ring, places = np.concatenate(frame), np.concatenate(ring), np.vstack(pixels)
        centre = np.array([of.camera.cx, of.camera.cy])
        way = (places - centre) / np.linalg.norm(places - centre, axis=1)[:, None]
        twelfth = (np.degrees(np.arctan2(way[:, 1], way[:, 0])) % 360 // 30).astype(int)
        places = places + (off_px * random.normal(size=(len(rings), 12))[of_ring, twelfth])[:, None] * way
        if shifted:
            way = (places - centre) / np.linalg.norm(places - centre, axis=1)[:, None]
            tint = observe(of.camera, of_frame, of_ring, places, centre, None, COLOURS).tint
            places = places + (tint @ SHIFT_PX.ravel())[:, None] * way
        parts.append(observe(of.camera, of_frame, of_ring, places, centre, None, COLOURS))
    return joined(parts)


@pytest.mark.parametrize("shifted", [False, True])
def test_everything_is_found_from_intrinsics_and_radius(shifted: bool) -> None:
    true, found = head(1.0), calibrate(seen(shifted), RADIUS_MM)
    exact = 10.0 if shifted else 1.0  # lines through the image's centre are not quite normal to the rings
    (placed,) = found.cameras
    turn = np.array(true.others[0].rotation).T
    off = math.acos(min(1.0, (np.trace(placed.rotation.T @ turn) - 1) / 2))
    assert math.degrees(off) < 0.0005 * exact
    assert np.abs(placed.centre_mm + turn @ true.others[0].translation_mm).max() < 0.001 * exact
    for ring, wanted in zip(found.rings, true.rings, strict=True):
        assert math.degrees(2 * abs(ring.half_angle - wanted.half_angle)) < 0.0005 * exact
        assert np.abs(np.subtract(ring.vertex_mm, wanted.vertex_mm)).max() < 0.002 * exact
    wanted_px = SHIFT_PX - SHIFT_PX.mean(axis=0) * [1, 1, 0, 0] if shifted else np.zeros((3, 4))
    assert np.abs(found.colour_shift_px - wanted_px)[:, :2].max() < 0.01 * exact
    assert np.isfinite(found.camera_covariance).all()


def test_what_is_off_alike_in_every_pose_is_counted() -> None:
    true = head(1.0)
    found = calibrate(seen(False, 0.01, 60), RADIUS_MM)
    (placed,) = found.cameras
    turn = np.array(true.others[0].rotation).T
    sigma = np.sqrt(np.diag(found.camera_covariance))[3:]
    off = (placed.centre_mm + turn @ true.others[0].translation_mm) / sigma
    assert np.abs(off).max() < 3.0
    assert (sigma > 0.001).any()


def test_flashes_that_one_camera_has_no_frame_of_tell_what_they_can() -> None:
    both = seen(False)
    lost = ((both.frame == 0) & (both.camera == 0)) | ((both.frame == 3) & (both.camera == 1))
    found = calibrate(both.take(np.flatnonzero(~lost)), RADIUS_MM)
    true = head(1.0).others[0]
    (placed,) = found.cameras
    assert len(found.poses) == len(POSES)
    assert np.abs(placed.centre_mm + np.array(true.rotation).T @ np.array(true.translation_mm)).max() < 0.01
    assert np.nanmax(np.abs(found.error_px)) < 0.05


def test_cameras_without_a_flash_in_common_are_one_line() -> None:
    both = seen(False)
    apart = (both.frame < 3) == (both.camera == 0)
    with pytest.raises(AnnulusError, match="same flash"):
        calibrate(both.take(np.flatnonzero(apart)), RADIUS_MM)
