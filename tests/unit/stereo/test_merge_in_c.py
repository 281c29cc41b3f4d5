"""A head's loops in C against tests/reference: what cameras would see, what slits say of that, the wall from all."""

from types import SimpleNamespace

import numpy as np
import pytest
import stereo_merge
import stereo_view
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.pose import Pose, rotation_x, rotation_y, rotation_z
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.stereo.lens import lens_numbers
from annulus_pipe.stereo.merge import KNOWN, Sight, merge
from annulus_pipe.stereo.points import to_pipe
from annulus_pipe.stereo.reconstructor import _spread
from annulus_pipe.stereo.view import Expected, _as_usual, _expect, _off, _table

few = settings(max_examples=12, deadline=None, derandomize=True)
LINES, R = 40, 76.2
DISTORTIONS = {
    "fisheye": (-0.012, 0.003, 0.0, 0.0),
    "pinhole": (-0.1, 0.02, 1e-3, -2e-3, 0.01, 0.02, 0.0, 0.0, 1e-3, 0.0, -1e-3, 2e-3),
}


def camera(rng, model):
    of = Camera(model, 800, 600, 280.0, 281.0, 401.0, 299.0, DISTORTIONS[model])
    rotation = rotation_x(rng.normal(0, 0.05)) @ rotation_y(rng.normal(0, 0.05)) @ rotation_z(rng.uniform(-3, 3))
    where = SimpleNamespace(centre=(399.0, 301.0), first=20.0, step=2.0, cosine=np.empty(LINES))
    shift = rng.normal(0, 8, 3) * [1.0, 1.0, 0.3]
    one = SimpleNamespace(camera=of, rotation=rotation, translation=shift, lines=LINES)
    one.centre, one.first, one.step = where.centre, where.first, where.step
    one.lens = lens_numbers(of, rotation, shift, where)
    return one


def head(seed, steps, model="fisheye"):
    """Two rings, their generators, where those meet a clean pipe, NaN where they meet none, and two cameras."""
    rng = np.random.default_rng(seed)
    turn = np.arange(steps) * (2 * np.pi / steps)
    cones = np.array([[rng.normal(0, 5), rng.normal(0, 5), -2.0, 0.0, 0.0, 1.0, half] for half in (0.7, 0.85)])
    ways = [
        np.stack([np.sin(h) * np.cos(turn), np.sin(h) * np.sin(turn), np.full(steps, np.cos(h))], axis=1)
        for h in cones[:, 6]
    ]
    pose = Pose(*rng.normal(0, 0.02, 2), *rng.normal(0, 3, 2))
    start = to_pipe(cones[:, :3], pose, np.array(ways), R)
    start[rng.random(start.shape) < 0.03] = np.nan
    return [camera(rng, model) for _ in range(2)], cones, np.array(ways), start, pose, rng


def expected_in_c(view, cones, ways, start, pose):
    by_generator, by_line = np.empty((4, *start.shape)), np.full((3, len(cones), LINES), np.nan)
    work = np.empty(9 * start.shape[1] + 18)
    _expect(view.lens, cones, ways, start, pose.rotation, pose.translation, by_generator, by_line, work)
    return by_generator, by_line


@few
@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 36, 42]), st.sampled_from(["fisheye", "pinhole"]))
def test_what_a_clean_pipe_would_show(seed, steps, model):
    views, cones, ways, start, pose, _ = head(seed, steps, model)
    by_generator, by_line = expected_in_c(views[0], cones, ways, start, pose)
    of_generator, of_line = stereo_view.expect(views[0], cones, ways, start, pose)
    np.testing.assert_allclose(by_generator, of_generator, rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(by_line, of_line, rtol=1e-6, atol=1e-7)


def test_between_nodes_cubics_lead():
    views, cones, ways, start, pose, _ = head(5, 720)
    by_generator, _ = expected_in_c(views[1], cones, ways, start, pose)
    some = np.arange(0, 720, 29)
    of_generator, _ = stereo_view.expect(views[1], cones, ways[:, some], start[:, some], pose)
    assert np.nanmax(np.abs(by_generator[1][:, some] - of_generator[1])) < 4e-3  # samples, two a px
    assert (np.isnan(by_generator[1][:, some]) == np.isnan(of_generator[1])).all()


@few
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 0.05, 1.0, 8.0]),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([0.0, 0.2, 2.0]),
    st.sampled_from([0.02, 0.5, 30.0]),
    st.sampled_from([1, 2]),
    st.booleans(),
)
def test_the_wall_is_the_references(seed, noise, missing, edges, most, cameras, gated):
    views, cones, ways, start, pose, rng = head(seed, 36)
    views = views[:cameras]
    expected = [
        Expected(g, *by_line) for g, by_line in (stereo_view.expect(v, cones, ways, start, pose) for v in views)
    ]
    sights = []
    for e in expected:
        place = (
            e.course
            + np.cumsum(rng.normal(0, noise / 5, e.course.shape), axis=1)
            + rng.normal(0, noise, e.course.shape)
        )
        place[rng.random(place.shape) < missing] = np.nan
        edge = np.where(rng.random(place.shape) < 0.3, edges, 0.0)
        sights.append(Sight(place, np.hypot(rng.uniform(0.02, 0.05, place.shape), edge), edge, 0.01))
    usable = rng.random((cameras, *start.shape)) < 0.8 if gated else None
    limit = np.full(len(cones), most)
    found = merge(views, expected, sights, cones[:, :3], ways, start, limit, usable)
    reference = stereo_merge.merge(views, expected, sights, cones[:, :3], ways, start, limit, usable)
    distance, sigma, camera_of, heaviest, line, state, apart = reference
    np.testing.assert_array_equal(found.state, state)
    np.testing.assert_array_equal(found.heaviest, heaviest)
    np.testing.assert_array_equal(found.line, line)
    np.testing.assert_array_equal(found.camera, camera_of)
    np.testing.assert_allclose(found.distance_mm, distance, rtol=1e-7)
    np.testing.assert_allclose(found.sigma_mm, sigma, rtol=1e-6)
    np.testing.assert_allclose(found.apart, apart, rtol=1e-4, atol=1e-9)


def slits_of(seed, n, rings):
    rng = np.random.default_rng(seed)
    course, by_radius, by_angle = rng.uniform(0, 300, (3, rings, LINES))
    course[rng.random(course.shape) < 0.2] = np.nan
    by_angle[rng.random(course.shape) < 0.2] = np.nan
    direction, ring = np.sort(rng.integers(0, LINES, n)), rng.integers(-1, rings, n)
    return (
        rng,
        course,
        by_radius - 150.0,
        by_angle - 30.0,
        direction,
        ring,
        rng.uniform(0, 300, n),
        rng.uniform(2, 9, n),
    )


@few
@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 200]), st.sampled_from([1, 2, 7]))
def test_slits_against_that(seed, n, rings):
    rng, course, by_radius, by_angle, direction, ring, position, width = slits_of(seed, n, rings)
    could_be = rng.random((n, rings)) < 0.5
    off, deviation = np.empty((2, n, rings))
    _off(direction, position, could_be, course, by_radius, 12.0, off, deviation)
    expected = stereo_view.off(direction, position, could_be, course, by_radius, 12.0)
    np.testing.assert_allclose(off, expected[0], rtol=1e-12)
    np.testing.assert_allclose(deviation, expected[1], rtol=1e-12)
    usual = np.array(width)
    _as_usual(ring, direction, by_angle, np.empty(rings), usual)
    np.testing.assert_allclose(usual, stereo_view.as_usual(ring, direction, by_angle, width), rtol=1e-9)
    bend, offset = rng.normal(0, 1e-2, (2, rings, LINES))
    place, which = np.full((rings, LINES), np.nan), np.full((rings, LINES), -1)
    _table(ring, direction, position, width, 6.0, bend, offset, place, which)
    in_table = stereo_view.table(ring, direction, position, width, 6.0, bend, offset)
    np.testing.assert_array_equal(which, in_table[1])
    np.testing.assert_allclose(place, in_table[0], rtol=1e-12)


@few
@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 1, 30, 300]), st.sampled_from([0.0, 0.05, 0.3]))
def test_how_far_a_place_may_be_off(seed, n, least):
    rng, *_, width = slits_of(seed, n, 3)
    which = np.where(rng.random((3, 90)) < 0.8, rng.integers(-1, max(n, 1), (3, 90)), -1) if n else np.full((3, 90), -1)
    stray = np.where(rng.random((3, 90)) < 0.03, np.nan, rng.normal(0, 0.05, (3, 90)))
    inside, outside = rng.uniform(0, 250, (2, n, 3))
    sigma, edge = np.full(which.shape, np.nan), np.zeros(which.shape)
    _spread(which, stray, width, inside, outside, width / 3, least, SIGMA_OF_MAD, np.empty(270), sigma, edge)
    expected = stereo_view.spread(which, stray, width, inside, outside, width / 3, least)
    np.testing.assert_allclose(sigma, expected[0], rtol=1e-9)
    np.testing.assert_allclose(edge, expected[1], rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e300, -1e300])
def test_rubbish_harms_nothing(value):
    """Numbers that no calibration and no picture has: an answer, whatever it is, and no memory but what is given."""
    views, cones, ways, start, pose, rng = head(3, 36)
    wild = np.where(rng.random(start.shape) < 0.3, value, start)
    by_generator, by_line = expected_in_c(views[0], cones, ways, wild, pose)
    by_generator[:, rng.random(start.shape) < 0.3] = value
    by_line[:, rng.random((len(cones), LINES)) < 0.3] = value
    place, sigma = np.where(rng.random(by_line[0].shape) < 0.5, value, by_line[0]), np.full(by_line[0].shape, value)
    sight, e = Sight(place, sigma, np.abs(place), value), Expected(by_generator, *by_line)
    with np.errstate(all="ignore"):
        found = merge(views[:1], [e], [sight], cones[:, :3], ways, wild, np.ones(len(cones)))
    assert ((found.state >= KNOWN) & (found.camera >= 0) & (found.line >= 0) & (found.line <= LINES)).all()
    far = np.array([-(2**62), -5, LINES, 2**62])
    off, deviation = np.empty((2, 4, 2))
    _off(far, np.full(4, value), np.ones((4, 2), np.bool_), by_line[0], by_line[1], 9.0, off, deviation)
    place, which = np.full((2, LINES), np.nan), np.full((2, LINES), -1)
    _table(far, far, np.full(4, value), np.full(4, value), value, by_line[0], by_line[1], place, which)
    assert (which == -1).all()
    _as_usual(far, far, by_line[2], np.empty(2), np.full(4, value))
    slits = np.full((2, LINES), 2**62)
    of_slits, light = np.full(4, value), np.full((4, 3), value)
    _spread(slits, place, of_slits, light, light, of_slits, 0.1, 1.5, np.empty(3 * LINES), np.array(place), place)
