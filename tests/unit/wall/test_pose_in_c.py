"""The fit of the pose in C against tests/reference/wall_pose.py: dents, halves, wild points, few of them, rubbish."""

import numpy as np
import wall_pose
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.pose import Fitter, fit_pose, weight_of

R = 76.2
rubbish = st.floats(width=32) | st.sampled_from([0.0, 76.2, np.nan, np.inf, -np.inf])
few = settings(max_examples=40, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])


def wall(seed, n, turn, noise, dent, oval, wild, length, pose):
    rng = np.random.default_rng(seed)
    phi, z = rng.uniform(0.0, turn, n), rng.uniform(40.0, 40.0 + length, n)
    r = R * (1.0 + oval * np.cos(2.0 * phi)) + np.where((np.abs(phi - 2.0) < 0.4) & (z < 90.0), dent, 0.0)
    r += rng.normal(0.0, noise, n)
    points = pose.to_camera(np.stack([r * np.cos(phi), r * np.sin(phi), z], axis=1))
    lies = rng.random(n) < wild
    points[lies] = rng.uniform(-2.0 * R, 2.0 * R, (int(lies.sum()), 3))
    return points, rng.uniform(0.02, 0.06, n)


def agree(points, sigma, seed, one_ring, radius=R):
    found = fit_pose(points, radius, sigma, seed, one_ring)
    first = None if seed is None else (seed.rx, seed.ry, seed.tx, seed.ty)
    expected = wall_pose.fit(points, 1.0 / np.maximum(sigma, 1e-6) ** 2, radius, first, one_ring)
    assert (found is None) == (expected is None)
    if found is None:
        return
    pose = np.array([found.pose.rx, found.pose.ry, found.pose.tx, found.pose.ty])
    # 1e-9 rad, 1e-7 mm and a millionth of the covariance: sums are in another order, and roundings add up over rounds
    np.testing.assert_allclose(pose[:2], expected[0][:2], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(pose[2:], expected[0][2:], rtol=0.0, atol=1e-7)
    np.testing.assert_allclose(found.robust_sigma_mm, expected[1], rtol=1e-6, atol=1e-9)
    scale = np.sqrt(np.outer(expected[2].diagonal(), expected[2].diagonal()))
    np.testing.assert_allclose(found.covariance / scale, expected[2] / scale, rtol=0.0, atol=1e-6)


@few
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.sampled_from([39, 40, 45, 128, 300, 700]),
    turn=st.sampled_from([1.0, 2.6, np.pi, 5.5, 2.0 * np.pi]),
    noise=st.sampled_from([0.0, 0.03, 0.3, 5.0]),
    dent=st.sampled_from([0.0, 0.0, 0.4, -3.0, 14.0]),
    oval=st.sampled_from([0.0, 0.0, 0.004, 0.03]),
    wild=st.sampled_from([0.0, 0.0, 0.1, 0.5, 1.0]),
    length=st.sampled_from([0.0, 60.0, 400.0]),
    lean=st.tuples(*[st.floats(-0.1, 0.1)] * 2),
    shift=st.tuples(*[st.floats(-20.0, 20.0)] * 2),
    first=st.sampled_from([None, "there", "far"]),
    one_ring=st.booleans(),
)
def test_it_is_the_references(seed, n, turn, noise, dent, oval, wild, length, lean, shift, first, one_ring):
    pose = Pose(*lean, *shift)
    points, sigma = wall(seed, n, turn, noise, dent, oval, wild, length, pose)
    agree(points, sigma, {None: None, "there": pose, "far": Pose(0.7, -0.7, 60.0, 50.0)}[first], one_ring)


@few
@given(
    st.lists(st.tuples(rubbish, rubbish, rubbish), max_size=60),
    st.sampled_from([0.0, 0.03, np.nan, np.inf]),
    st.booleans(),
)
@example([(0.0, 0.0, 0.0)] * 50, 0.03, False)
@example([(76.2, 0.0, 50.0)] * 50, 0.03, True)
@example([(1e300, 1e300, 1e300)] * 50, 0.03, False)
def test_rubbish_has_an_answer_or_none(points, sigma, one_ring):
    points = np.resize(np.array(points or [(0.0, 0.0, 0.0)], float), (44, 3))
    fit_pose(points, R, np.full(44, sigma), None, one_ring)


def test_room_for_more_points_changes_nothing():
    points, sigma = wall(3, 500, 6.0, 0.05, 3.0, 0.0, 0.05, 80.0, Pose(0.02, 0.01, 1.0, 2.0))
    fitter = Fitter(900)
    fitter.points[:], fitter.weight[:] = np.nan, np.nan
    fitter.points[:, :500], fitter.weight[:500] = points.T, weight_of(sigma)
    found, expected = fitter.fit(500, R), fit_pose(points, R, sigma)
    assert found.pose == expected.pose and (found.covariance == expected.covariance).all()
    assert fitter.fit(30, R) is None
