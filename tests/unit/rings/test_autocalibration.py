"""Rings from frames of a clean pipe: what is found, how well it is known, and when nothing can be."""

import math
from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.corrections import fit_corrections, ring_corrections
from annulus_pipe.rings.calibration.cross_validation import hold_out, measure
from annulus_pipe.rings.calibration.observations import Observations, observe
from annulus_pipe.rings.polar import ring_pixels
from annulus_pipe.vocabulary import AnnulusError

CAMERA = Camera("pinhole", 1664, 1232, 470.0, 470.0, 832.0, 616.0)
FISHEYE = Camera("fisheye", 1664, 1232, 520.0, 520.0, 810.0, 630.0, (0.02, -0.01, 0.002, 0.0))
RADIUS = 76.2
LEAN, STAND = math.radians(10), 10.0
LEANS = [(1, 1), (-1, -1), (1, -1), (-1, 1), (0, 1.2), (0, -1.2)]
POSES = tuple(Pose(a * LEAN, b * LEAN, a * STAND, b * STAND) for a, b in LEANS)


def _ring(theta_full_deg: float, x: float, y: float, vertex: tuple[float, float, float]) -> Cone:
    return Cone(math.radians(theta_full_deg / 2), (x, y, math.sqrt(1 - x * x - y * y)), vertex)


RINGS = (
    _ring(37.9, -0.016, 0.015, (1.1, -1.2, -56.5)),
    _ring(47.5, -0.017, 0.014, (1.4, -1.0, -56.0)),
    _ring(57.7, -0.015, 0.011, (1.0, 0.1, -54.2)),
)


def _seen(
    poses: tuple[Pose, ...] = POSES,
    rings: tuple[Cone, ...] = RINGS,
    camera: Camera = CAMERA,
    radius: float = RADIUS,
    noise_px: float = 0.0,
    steps: int = 120,
) -> Observations:
    rng = np.random.default_rng(0)
    frame, ring, places = [], [], []
    for j, pose in enumerate(poses):
        for k, cone in enumerate(rings):
            pixels = ring_pixels(camera, cone, pose, radius, steps)
            pixels = pixels[np.isfinite(pixels).all(axis=1)]
            frame += [j] * len(pixels)
            ring += [k] * len(pixels)
            places.append(pixels + rng.normal(0.0, noise_px, pixels.shape))
    centre = np.array([camera.cx, camera.cy])
    return observe(camera, np.array(frame), np.array(ring), np.vstack(places), centre)


def _worst(found: tuple[Cone, ...], true: tuple[Cone, ...] = RINGS) -> tuple[float, float]:
    """deg of the full angle, mm of a vertex's component."""
    pairs = list(zip(found, true, strict=True))
    return (
        max(abs(math.degrees(2 * (a.half_angle - b.half_angle))) for a, b in pairs),
        max(float(np.abs(np.subtract(a.vertex_mm, b.vertex_mm)).max()) for a, b in pairs),
    )


@pytest.mark.parametrize("camera", [CAMERA, FISHEYE], ids=["pinhole", "fisheye"])
def test_rings_and_poses_are_found_from_nothing_but_the_camera_and_the_radius(camera: Camera) -> None:
    solution = calibrate(_seen(camera=camera), RADIUS)
    angle, vertex = _worst(solution.rings)
    assert angle < 5e-7 and vertex < 2e-6  # what the solver stops at
    for found, true in zip(solution.poses, POSES, strict=True):
        assert np.allclose([found.rx, found.ry], [true.rx, true.ry], rtol=0, atol=5e-9)
        assert np.allclose([found.tx, found.ty], [true.tx, true.ty], rtol=0, atol=5e-7)


def test_a_single_ring_is_enough() -> None:
    solution = calibrate(_seen(rings=RINGS[1:2]), RADIUS)
    angle, vertex = _worst(solution.rings, RINGS[1:2])
    assert angle < 5e-7 and vertex < 2e-6


def test_two_opposed_poses_are_enough_and_two_alike_are_not() -> None:
    angle, vertex = _worst(calibrate(_seen(POSES[:2]), RADIUS).rings)
    assert angle < 5e-7 and vertex < 2e-6
    alike = calibrate(_seen((Pose(), Pose(0.002, 0.0, 0.1, 0.0)), noise_px=0.05), RADIUS)
    assert np.sqrt(np.diag(alike.covariance).reshape(-1, 6)[:, 3:].max()) > 0.05 * RADIUS  # and it says so
    with pytest.raises(AnnulusError, match="one frame"):
        calibrate(_seen(POSES[:1]), RADIUS)


def test_a_tenth_of_false_slits_moves_nothing() -> None:
    seen = _seen()
    rng = np.random.default_rng(1)
    wrong = rng.random(len(seen)) < 0.1
    rays = seen.rays.copy()
    rays[wrong] = rays[rng.permutation(np.flatnonzero(wrong))]  # each at some other slit's place
    angle, vertex = _worst(calibrate(replace(seen, rays=rays), RADIUS).rings)
    assert angle < 5e-7 and vertex < 2e-6


def test_errors_are_as_large_as_the_covariance_says() -> None:
    solution = calibrate(_seen(noise_px=0.3), RADIUS)
    cover = solution.covariance
    off = np.concatenate(
        [
            [a.half_angle - b.half_angle, *np.subtract(a.axis[:2], b.axis[:2]), *np.subtract(a.vertex_mm, b.vertex_mm)]
            for a, b in zip(solution.rings, RINGS, strict=True)
        ]
    )
    square = float(off @ np.linalg.solve(cover, off)) / len(off)  # 1 on average over 18 numbers, sd 0.33
    assert 0.5 < square < 2.5
    assert np.allclose(solution.sigma_px, 0.3, rtol=0.15)


def test_a_wrong_radius_scales_everything_and_no_image_can_tell() -> None:
    solution = calibrate(_seen(), 2 * RADIUS)
    assert np.allclose(solution.rings[0].vertex_mm, 2 * np.array(RINGS[0].vertex_mm), rtol=0, atol=1e-7)
    assert math.isinf(solution.off_radius_mm[1])


def test_lumps_of_the_slide_are_learnt_and_help_where_they_were_not_learnt() -> None:
    turn = np.arange(240) * (2 * math.pi / 240)
    lumps = np.radians(0.1) * np.stack([np.sin((7 + 2 * k) * turn + k) for k in range(3)])
    poses = (*POSES, Pose(0.1, -0.03, 4.0, 2.0), Pose(-0.06, 0.12, -3.0, 5.0))
    seen = _lumpy(poses, lumps)
    learn, score = seen.take(np.flatnonzero(seen.frame < 6)), seen.take(np.flatnonzero(seen.frame >= 6))
    score = replace(score, frame=score.frame - 6)
    cones = calibrate(learn, RADIUS)
    tuned, offsets = fit_corrections(learn, cones, directions=360)
    before, after = measure(score, cones, poses[6:]).rms_mm(), measure(score, tuned, poses[6:], offsets).rms_mm()
    assert before > 0.6 and after < 0.0015 * before
    assert _worst(tuned.rings)[1] < 5e-6  # lumps do not lean the cones
    kept = ring_corrections(offsets)
    assert np.allclose([ring.offset_rad for ring in kept], offsets[:, 0], rtol=0, atol=1.5e-7)
    assert kept[0].shift_mm is None


def _lumpy(poses: tuple[Pose, ...], lumps: FloatArray) -> Observations:
    parts = []
    for j, pose in enumerate(poses):
        for k, cone in enumerate(RINGS):
            # one direction of each cone that is a little wider there; ring_pixels turns the other way round
            axis = np.asarray(cone.axis)
            one = np.cross(np.cross(axis, [1.0, 0.0, 0.0]), axis)
            one /= np.linalg.norm(one)
            turn = np.arange(lumps.shape[1]) * (2 * math.pi / lumps.shape[1])
            half = (cone.half_angle + lumps[k])[:, None]
            across = np.cos(turn)[:, None] * one + np.sin(turn)[:, None] * np.cross(axis, one)
            way = (np.cos(half) * axis + np.sin(half) * across) @ pose.rotation
            start = pose.to_pipe(np.array([cone.vertex_mm]))[0]
            a, b = (way[:, :2] ** 2).sum(axis=1), way[:, :2] @ start[:2]
            s = (np.sqrt(b * b - a * (start[:2] @ start[:2] - RADIUS**2)) - b) / a
            pixels = CAMERA.project(pose.to_camera(start + s[:, None] * way))
            parts.append((np.full(len(pixels), j), np.full(len(pixels), k), pixels))
    frame, ring, pixels = (np.concatenate(part) for part in zip(*parts, strict=True))
    return observe(CAMERA, frame, ring, pixels, np.array([CAMERA.cx, CAMERA.cy]))


def test_a_frame_of_another_pipe_shows_in_the_frames_held_out() -> None:
    other = _seen(POSES[5:], radius=1.02 * RADIUS, noise_px=0.1)
    seen = _seen(POSES[:5], noise_px=0.1)
    both = Observations(
        np.concatenate([seen.frame, other.frame + 5]),
        np.concatenate([seen.ring, other.ring]),
        np.concatenate([seen.rays, other.rays]),
        np.concatenate([seen.origins, other.origins]),
        np.concatenate([seen.width, other.width]),
    )
    held = hold_out(both, calibrate(both, RADIUS), 6)
    assert held.off_radius_mm[5] == pytest.approx(0.02 * RADIUS, abs=0.12)


def test_a_ring_that_one_frame_alone_shows_leaves_nothing_to_hold_out() -> None:
    seen = _seen(POSES, noise_px=0.1)
    few = seen.take(np.flatnonzero((seen.ring < len(RINGS) - 1) | (seen.frame == 0)))
    with pytest.raises(AnnulusError, match="the projector's place open"):
        hold_out(few, calibrate(few, RADIUS), len(POSES))
