"""The pipe is found from a wall with holes, noise and lies."""

import numpy as np
import pytest

from annulus.geometry.pose import Pose
from annulus.rings.pose import fit_pose

INCH = 25.4
R = 3 * INCH


def wall(pose, turn=(0.0, 2 * np.pi), n=4000, seed=1, noise=0.0, length=(0.0, 6 * INCH), radius=R):
    """Points on the wall between two angles, camera frame; noise uniform in each coordinate."""
    rng = np.random.default_rng(seed)
    phi, z = rng.uniform(*turn, n), rng.uniform(*length, n)
    r = radius(phi, z) if callable(radius) else radius
    points = np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1)
    return pose.to_camera(points) + rng.uniform(-noise, noise, (n, 3))


def error(found, pose):
    return (
        np.degrees(max(abs(found.rx - pose.rx), abs(found.ry - pose.ry))),
        max(abs(found.tx - pose.tx), abs(found.ty - pose.ty)),
    )


def test_the_sources_test_is_met():
    """Alzuhiri 2022, §3.4.3: 10 degrees about both axes, an inch off, +-0.25 in of noise, 45 degrees missing; found
    there to 0.05 degrees and 0.019 in, by the prototype to 0.11 and 0.004."""
    pose = Pose(np.radians(10), np.radians(10), INCH, -INCH)
    errors = []
    for seed in range(5):
        points = wall(pose, turn=(0.0, np.radians(315)), noise=0.25 * INCH, seed=seed)
        fitted = fit_pose(points, R, np.ones(len(points)))
        assert fitted is not None
        errors.append(error(fitted.pose, pose))
    worst = np.median(errors, axis=0)
    assert worst[0] < 0.2 and worst[1] < 0.01 * INCH * 2


def test_a_hole_and_a_dent_do_not_turn_it():
    def dented(phi, z):
        return (
            R
            + np.where((phi > 1) & (phi < 1.9) & (z > 40) & (z < 110), 14.0, 0)
            - 8 * np.exp(-(((phi - 4) / 0.3) ** 2))
        )

    pose = Pose(0.03, -0.02, 4.0, -3.0)
    points = wall(pose, radius=dented, noise=0.1)
    fit = fit_pose(points, R, np.ones(len(points)))
    degrees, mm = error(fit.pose, pose)
    assert degrees < 0.05 and mm < 0.08
    assert fit.spread_mm < 0.3


def test_an_oval_pipe_does_not_make_the_head_lean():
    pose = Pose(0.03, -0.02, 2.0, -1.5)
    points = wall(pose, radius=lambda phi, z: R + 1.5 * np.cos(2 * phi + 0.4), noise=0.1, length=(60, 160))
    degrees, mm = error(fit_pose(points, R, np.ones(len(points))).pose, pose)
    assert degrees < 0.05 and mm < 0.1


def test_a_tenth_of_lies_does_no_harm():
    pose = Pose(-0.02, 0.03, -2.0, 3.0)
    points = wall(pose, noise=0.05)
    points[::10] += np.random.default_rng(3).uniform(-30, 30, (len(points[::10]), 3))
    degrees, mm = error(fit_pose(points, R, np.ones(len(points))).pose, pose)
    assert degrees < 0.02 and mm < 0.03


def test_a_wrong_seed_is_forgiven():
    pose = Pose(0.02, 0.01, 1.0, 2.0)
    points = wall(pose, noise=0.05)
    for seed in (Pose(0.3, -0.3, 30.0, -30.0), Pose(0.7, 0.7, 60.0, 60.0)):
        degrees, mm = error(fit_pose(points, R, np.ones(len(points)), seed).pose, pose)
        assert degrees < 0.01 and mm < 0.01


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        wall(Pose(), n=30),
        wall(Pose(), turn=(0.0, 1.2)),
        np.random.default_rng(2).uniform(-100, 200, (2000, 3)),
    ],
    ids=["nothing", "few", "a strip", "a cloud"],
)
def test_what_is_no_pipe_has_no_pose(points):
    assert fit_pose(points, R, np.ones(len(points))) is None
