"""A slide that is not round, corrected by frames in a clean pipe; geometry alone, no image."""

import json
import math

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM

from annulus_pipe.geometry.cone import intersect_cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.calibration.reference import Reference, learn
from annulus_pipe.wall.profile import Profile


def artefact(k, azimuth):
    return math.radians(0.15) * np.sin(7 * azimuth + k) + math.radians(0.05) * np.sin(31 * azimuth)


def profile(pose: Pose, hole=None) -> Profile:
    """Where the cones of the calibration put points that a bent slide threw on the pipe."""
    azimuth = np.arange(720) * (2 * math.pi / 720) + 0.001
    points, rings = [], []
    start = pose.to_pipe(np.zeros((1, 3)))[0]
    for k, cone in enumerate(CALIBRATION.rings):
        angle = cone.half_angle + artefact(k, azimuth)
        light = np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=1)
        start, way = pose.to_pipe(np.array([cone.vertex_mm]))[0], light @ pose.rotation
        a, b, c = (way[:, :2] ** 2).sum(axis=1), way[:, :2] @ start[:2], start[:2] @ start[:2] - RADIUS_MM**2
        wall = pose.to_camera(start + ((-b + np.sqrt(b * b - a * c)) / a)[:, None] * way)
        seen, _ = intersect_cone(wall / np.linalg.norm(wall, axis=1, keepdims=True), cone)
        kept = np.ones(720, bool) if hole is None else np.abs(azimuth - hole) > 0.1
        points.append(pose.to_pipe(seen)[kept])
        rings.append(np.full(kept.sum(), k))
    ring = np.concatenate(rings).astype(np.uint8)
    return Profile(
        0,
        0.0,
        pose,
        np.concatenate(points).astype(np.float32),
        np.zeros((len(ring), 3), np.uint8),
        ring,
        np.zeros(len(ring), np.uint16),
        0.1,
    )


POSES = [Pose(), Pose(0.02, -0.01, 1.0, -1.5), Pose(-0.015, 0.02, -2.0, 0.5)]


def test_the_slides_own_angles_come_out_whatever_the_pose():
    truth = np.array([artefact(k, np.arange(720) * (2 * math.pi / 720)) for k in range(5)])
    for pose in POSES:
        found = np.array(learn([profile(pose)], CALIBRATION).offset_rad)
        assert np.abs(found - truth).max() < math.radians(0.0006)


def test_frames_kept_out_are_corrected_as_well_and_one_frame_checks_nothing():
    reference = learn([profile(pose) for pose in POSES], CALIBRATION)
    assert reference.before_mm > 0.8 and reference.after_mm < 0.05 * reference.before_mm
    assert math.isnan(learn([profile(Pose())], CALIBRATION).after_mm)


def test_where_no_frame_looked_nothing_is_known():
    reference = learn([profile(Pose(), hole=2.0)], CALIBRATION)
    assert 0.92 < reference.known < 0.98
    assert math.isnan(reference.offset_rad[2][round(2.0 / (2 * math.pi) * 720)])


def test_a_reference_bends_the_calibration_and_says_how_far_it_reaches():
    reference = learn([profile(Pose())], CALIBRATION)
    bent = reference.applied(CALIBRATION)
    assert bent.corrections is not None and bent.corrections[3].offset_rad == pytest.approx(reference.offset_rad[3])
    twice = reference.applied(bent)
    assert twice.corrections is not None and twice.corrections[3].offset_rad[5] == pytest.approx(
        2 * reference.offset_rad[3][5]
    )
    angle, shift = reference.distance([Pose(0.03, 0.0, 3.0, 4.0)])
    assert angle == pytest.approx(0.03) and shift == pytest.approx(5.0)


def test_a_reference_survives_its_file_and_a_damaged_one_is_named():
    reference = learn([profile(Pose(), hole=2.0), profile(POSES[1])], CALIBRATION)
    data = json.loads(json.dumps(reference.to_dict()))
    again = Reference.from_dict(data)
    assert np.allclose(np.array(again.offset_rad), np.array(reference.offset_rad), atol=1e-9, equal_nan=True)
    assert again.poses == reference.poses and again.after_mm == reference.after_mm
    for key, value in (("rings", []), ("poses", [[1, 2]]), ("radius_mm", "wide"), ("format", "other")):
        with pytest.raises(ValueError, match=key):
            Reference.from_dict({**data, key: value})
