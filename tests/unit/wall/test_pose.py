"""The pipe is found from a wall with holes, noise and lies."""

import numpy as np
import pytest

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.pose import fit_pose

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
    assert worst[0] < 0.2 and worst[1] < 0.015 * INCH


def least_squares_told(points, pose):
    """The best there is: on clean points only, radius known, a Gauss-Newton from the truth on."""
    x = np.array([pose.rx, pose.ry, pose.tx, pose.ty])

    def residual(x):
        return np.hypot(*Pose(*x).to_pipe(points)[:, :2].T) - R

    for _ in range(4):
        step = np.eye(4) * [1e-5, 1e-5, 1e-3, 1e-3]
        slope = np.stack([(residual(x + d) - residual(x - d)) / (2 * d.sum()) for d in step], axis=1)
        x = x - np.linalg.lstsq(slope, residual(x), rcond=None)[0]
    return x


@pytest.mark.parametrize(
    ("turn", "hole", "wild"),
    [(315, 0.0, 0.0), (315, 0.35, 0.0), (180, 0.0, 0.0), (315, 0.0, 0.1), (180, 0.2, 0.1)],
    ids=["clean", "hole", "half of it missing", "outliers", "all of that"],
)
def test_it_is_as_good_as_least_squares_told_the_clean_points(turn, hole, wild):
    """A hole's floor lies two sigma of the noise away; 200 seeds of this are in tools/bench/metrology."""
    pose = Pose(np.radians(10), np.radians(10), INCH, -INCH)
    unit = np.degrees(1) * np.array([1, 1, 0, 0]) + np.array([0, 0, 1, 1]) / INCH * 20
    ours, best = [], []
    for seed in range(12):
        rng = np.random.default_rng([seed, 77])
        n = 2500
        phi, z = rng.uniform(0, np.radians(turn), n), rng.uniform(-3 * INCH, 3 * INCH, n)
        holed = (np.abs(phi - 2) < hole) & (np.abs(z - 12) < INCH)
        r = R + 0.306 * INCH * holed
        points = pose.to_camera(np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1))
        points += rng.uniform(-0.25 * INCH, 0.25 * INCH, (n, 3))
        lies = rng.random(n) < wild
        points[lies] = rng.uniform(-6 * INCH, 6 * INCH, (lies.sum(), 3))
        p = fit_pose(points, R, np.ones(n)).pose
        ours.append((np.array([p.rx, p.ry, p.tx, p.ty]) - [pose.rx, pose.ry, pose.tx, pose.ty]) * unit)
        best.append((least_squares_told(points[~holed & ~lies], pose) - [pose.rx, pose.ry, pose.tx, pose.ty]) * unit)
    assert np.sqrt(np.mean(np.square(ours))) < 1.12 * np.sqrt(np.mean(np.square(best)))


def test_the_covariance_is_what_repetition_shows():
    pose = Pose(0.02, -0.03, 2.0, -1.0)
    fits = [fit_pose(wall(pose, noise=0.3, n=600, seed=s, length=(60, 160)), R, np.ones(600)) for s in range(60)]
    spread = np.std([[f.pose.rx, f.pose.ry, f.pose.tx, f.pose.ty] for f in fits], axis=0)
    stated = np.sqrt(np.mean([np.diag(f.covariance) for f in fits], axis=0))
    assert (np.abs(np.log(stated / spread)) < np.log(1.25)).all()
    assert fits[0].covariance[1, 2] < 0 or fits[0].covariance[0, 3] > 0  # a lean is made up for by a shift


def test_one_ring_does_not_pretend_to_know_the_lean():
    """Points on one circle stay on the wall whichever way the head is turned about its middle."""
    rng = np.random.default_rng(4)
    phi = rng.uniform(0, 2 * np.pi, 700)
    pose = Pose(0.02, -0.015, 1.5, -2.0)
    circle = np.stack([R * np.cos(phi), R * np.sin(phi), np.full(700, 90.0)], axis=1)
    points = pose.to_camera(circle) + rng.normal(0, 0.03, (700, 3))
    fit = fit_pose(points, R, np.ones(700), one_ring=True)
    lean = np.sqrt(np.diag(fit.covariance)[:2])
    assert (lean > 0.03).all()
    wall_points = fit.pose.to_pipe(points)
    assert abs(np.hypot(*wall_points[:, :2].T).mean() - R) < 0.02 and np.abs(wall_points[:, :2].mean(axis=0)).max() < 5
    middle = fit.pose.to_pipe(pose.to_camera(np.array([[0.0, 0.0, 90.0]])))
    assert np.abs(middle[0, :2]).max() < 0.002  # what can be known is
    here = np.array([[0.0, 90.0, 1.0, 0.0], [-90.0, 0.0, 0.0, 1.0]])  # the axis at the ring, to first order
    known = np.sqrt(np.diag(here @ fit.covariance @ here.T))
    assert (known < 0.006).all()


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
    assert degrees < 0.006 and mm < 0.05
    assert fit.robust_sigma_mm < 0.25


def test_a_tenth_of_lies_does_no_harm():
    pose = Pose(-0.02, 0.03, -2.0, 3.0)
    points = wall(pose, noise=0.05)
    points[::10] += np.random.default_rng(3).uniform(-30, 30, (len(points[::10]), 3))
    degrees, mm = error(fit_pose(points, R, np.ones(len(points))).pose, pose)
    assert degrees < 0.0015 and mm < 0.002


def test_a_wrong_seed_is_forgiven():
    pose = Pose(0.02, 0.01, 1.0, 2.0)
    points = wall(pose, noise=0.05)
    for seed in (Pose(0.3, -0.3, 30.0, -30.0), Pose(0.7, 0.7, 60.0, 60.0)):
        degrees, mm = error(fit_pose(points, R, np.ones(len(points)), seed).pose, pose)
        assert degrees < 0.0012 and mm < 0.0025


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
