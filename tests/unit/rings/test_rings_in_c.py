"""From slits to points in C against tests/reference/rings_names.py, rings_points.py and rings_belief.py: colours,
names, points, what is believed and how far; and tables that hold anything."""

from dataclasses import replace

import numpy as np
import rings_belief
import rings_names
import rings_points
from hostile_frames import DIRECTIONS, heads
from hypothesis import example, given
from hypothesis import strategies as st
from repeated import few

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.decode import NONE, UNKNOWN, Candidates, StripeColours, StripeNames, readings
from annulus_pipe.rings.lines import MARGIN, PLACE, SKIP, STRONG, name_lines
from annulus_pipe.rings.outliers import NamedSlits, Outliers
from annulus_pipe.rings.polar import polar_grid
from annulus_pipe.rings.reconstructor import OVER_EXPOSED, RING_POINTS, _for_fit, _keep
from annulus_pipe.rings.slits import FrameSlits
from annulus_pipe.rings.triangulate import CandidatePoints, RingOptics, deviations, meet_rings, ring_optics
from annulus_pipe.rings.uncertainty import KeptSlits, PointErrors
from annulus_pipe.wall.pose import Fit

seeds = st.integers(0, 2**32 - 1)
rubbish = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1e300, 1e300, 3.5])
GRIDS = {name: polar_grid(heads()[name], DIRECTIONS) for name in ("slits", "one ring", "mirror")}
OPTICS = {name: ring_optics(heads()[name], grid) for name, grid in GRIDS.items()}
CORRECTED = np.random.default_rng(0).normal(0.0, [2e-3, 0.2], (5, 12, 2))  # rad, mm


@few
@given(
    seeds,
    st.integers(0, 1300),
    st.sampled_from(["RGB", "RG", "R", "GB"]),
    st.sampled_from([0, 3, 40, 255]),
    st.sampled_from([None, "right", "another head's"]),
)
@example(0, 1, "RGB", 255, None)
def test_colours_are_the_references(seed: int, size: int, colours: str, faint: int, before: str | None) -> None:
    rng = np.random.default_rng(seed)
    used = ["RGB".index(letter) for letter in colours]
    stripes = rng.normal(rng.integers(0, faint + 1, 3), 0.1 * faint, (2 * size, 3))
    stripes[np.arange(2 * size), rng.choice(used, 2 * size)] += rng.integers(0, 200)
    stripes = np.where(rng.random((2 * size, 1)) < 0.1, 0.0, np.clip(stripes, 0.0, 255.0))
    mixed = np.array([[0.9, 0.3, 0.1], [0.2, 0.9, 0.3], [0.0, 0.4, 0.9]])
    of = used if before == "right" else [0, 1, 2, 0]
    seen = StripeColours(rng.random(3), mixed[of]) if before else None
    light = np.full((6, size + 3), np.nan)
    light[:, :size] = stripes[:, ::-1].reshape(2, size, 3).transpose(0, 2, 1).reshape(6, size)
    out = np.full((2, size + 3), 77, np.uint8)
    StripeNames(light, colours, seen, out).name(size)
    gain, reference = (seen.gain, seen.reference) if before == "right" else rings_names.learnt(stripes, used)
    np.testing.assert_array_equal(out[:, :size].ravel(), rings_names.named(stripes, gain, reference, used))
    assert (out[:, size:] == 77).all()


def slits_on_lines(rng: np.random.Generator, lines: int, most: int, rings: int) -> tuple[np.ndarray, ...]:
    """direction (N,), colours (2, N), a pattern (K + 1,), and deviations (N, K) if each slit were each ring."""
    direction = np.repeat(np.arange(lines), rng.integers(0, most + 1, lines))
    pattern = rng.integers(0, 3, rings + 1).astype(np.uint8)
    colour = rng.choice(np.array([0, 1, 2, UNKNOWN], np.uint8), (2, len(direction)), p=[0.3, 0.3, 0.3, 0.1])
    deviation = rng.normal(0.0, rng.choice([0.02, 0.3]), (len(direction), rings))
    return direction, colour, pattern, np.where(rng.random(deviation.shape) < 0.1, np.nan, deviation)


@few
@given(seeds, st.integers(0, 9), st.integers(0, 12), st.integers(1, 9))
def test_names_are_the_references(seed: int, lines: int, most: int, rings: int) -> None:
    rng = np.random.default_rng(seed)
    direction, colour, pattern, deviation = slits_on_lines(rng, lines, most, rings)
    fit = rings_names.fits(*colour, pattern)
    np.testing.assert_array_equal(readings(*colour, "".join("RGB"[c] for c in pattern)), fit > 0)
    candidates = Candidates(direction, colour, pattern)
    candidates.list_by_colour(len(direction))
    slit, ring = np.nonzero(fit)
    assert candidates.slit[: candidates.size].tolist() == slit.tolist()
    assert candidates.ring[: candidates.size].tolist() == ring.tolist()
    assert candidates.unclear == ((colour != 0) & (colour != 1) & (colour != 2)).any(axis=0).sum()
    candidates.deviation[: candidates.size] = deviation[slit, ring]
    found = candidates.align(len(direction), 0.35)
    np.testing.assert_array_equal(found, rings_names.aligned(direction, fit, deviation, 0.35))
    named = np.flatnonzero(found != NONE)
    assert candidates.left_out == len(found) - len(named)
    at = candidates.chosen[named]
    assert (candidates.slit[at] == named).all() and (candidates.ring[at] == found[named]).all()


@few
@given(seeds, st.integers(0, 9), st.integers(0, 12), st.integers(1, 4))
def test_names_of_lines_of_light_are_the_references(seed: int, lines: int, most: int, rings: int) -> None:
    rng = np.random.default_rng(seed)
    direction, *_, deviation = slits_on_lines(rng, lines, most, rings)
    strength = rng.uniform(0.0, 1.6, len(direction))
    with np.errstate(invalid="ignore"):
        worth = SKIP + STRONG * np.minimum(strength, 1.0)[:, None] - PLACE * (deviation / 0.35) ** 2
        worth = np.where((np.abs(deviation) <= 0.35) & (worth > 0.0), worth, 0.0)
    expected = rings_names.chosen(direction, worth, MARGIN)
    np.testing.assert_array_equal(name_lines(direction, strength, deviation, 0.35), expected)


def table_of(rng: np.random.Generator, head: str, size: int) -> FrameSlits:
    """Slits all over the lines, some beyond their ends."""
    table, length = FrameSlits(GRIDS[head]), GRIDS[head].address.shape[1]
    n = table.size = size
    table.direction[:n] = np.sort(rng.integers(0, DIRECTIONS, n))
    table.position[:n] = rng.uniform(-3.0, length + 9.0, n)
    table.width[:n] = rng.gamma(4.0, 2.0, n)
    return table


def optics_of(head: str, corrected: bool) -> RingOptics:
    optics = OPTICS[head]
    return replace(optics, corrections=np.resize(CORRECTED, (len(optics.cones), 12, 2))) if corrected else optics


@few
@given(seeds, st.sampled_from(list(GRIDS)), st.booleans(), st.integers(1, 70), rubbish)
def test_points_are_the_references(seed: int, head: str, corrected: bool, size: int, anything: float) -> None:
    rng = np.random.default_rng(seed)
    grid, optics, table = GRIDS[head], optics_of(head, corrected), table_of(rng, head, size)
    colour, pattern = np.zeros((2, len(table.direction)), np.uint8), np.zeros(len(optics.cones) + 1, np.uint8)
    candidates = Candidates(table.direction, colour, pattern)
    candidates.list_all(size)
    slit, ring = candidates.slit[: candidates.size], candidates.ring[: candidates.size]
    cones = CandidatePoints(table, candidates, grid, optics)
    cones.place()
    found = cones.points[:, : candidates.size]
    slits = table.direction[:size], table.position[:size], table.width[:size]
    expected = rings_points.points(*slits, slit, ring, grid, optics)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-7)  # mm; at a grazing ray roundings grow
    pose = Pose(*rng.normal(0.0, [0.05, 0.05, 5.0, 5.0]))
    found[:, rng.integers(candidates.size)] = anything
    with np.errstate(invalid="ignore", over="ignore"):
        expected = rings_points.deviations(found, pose.rotation, pose.translation, 70.0)
    cones.deviate(pose, 70.0)
    finite = np.abs(expected) < 1e150  # beyond, the squares are not
    np.testing.assert_allclose(candidates.deviation[: candidates.size][finite], expected[finite], rtol=1e-9, atol=1e-12)
    assert not np.isfinite(candidates.deviation[: candidates.size][np.isnan(expected)]).any()
    three_wide = deviations(found.T.reshape(size, -1, 3), pose, 70.0)
    np.testing.assert_array_equal(three_wide.ravel(), candidates.deviation[: candidates.size])


@few
@given(seeds, st.floats(0.0, 1.0), st.floats(0.0, np.pi))
def test_a_ray_meets_a_cone_where_the_reference_says(seed: int, aside: float, half_angle: float) -> None:
    rng = np.random.default_rng(seed)
    starts, ways = rng.normal(0.0, [1.0, 1.0, 30.0], (40, 3)), rng.normal(0.0, [aside, aside, 1.0], (40, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    axis = rng.normal(0.0, [0.1, 0.1, 1.0])
    angles = half_angle, np.pi / 2 - 1e-7, np.pi / 2  # the last two are planes
    cones = np.array([[*rng.normal(0.0, 20.0, 3), *axis / np.linalg.norm(axis), angle] for angle in angles])
    far = np.array(
        [[rings_points.meet(start, way, cone) for cone in cones] for start, way in zip(starts, ways, strict=True)]
    )
    expected = starts[:, None] + far[..., None] * ways[:, None]
    np.testing.assert_allclose(meet_rings(starts, ways, cones), expected, rtol=1e-7, atol=1e-6)


def ring_of_slits(rng: np.random.Generator, rings: int, part: float) -> tuple[np.ndarray, np.ndarray]:
    """direction, ring (N,) of slits, at most one of a ring on a line; some are no ring."""
    seen = rng.random((DIRECTIONS, rings)) < part
    seen &= (np.arange(DIRECTIONS) < rng.integers(1, DIRECTIONS + 1))[:, None]  # an arc of them
    direction, ring = (np.ascontiguousarray(one) for one in np.nonzero(seen))
    return direction, np.where(rng.random(len(ring)) < 0.05, NONE, ring)


@few
@given(seeds, st.integers(1, 6), st.sampled_from([1.0, 0.9, 0.3, 0.05]), st.sampled_from([0.0, 0.05, 0.5]))
def test_what_is_believed_is_the_references(seed: int, rings: int, part: float, scatter: float) -> None:
    rng = np.random.default_rng(seed)
    direction, ring = ring_of_slits(rng, rings, part)
    turn, n = 2 * np.pi / DIRECTIONS * direction, len(ring)
    width = np.maximum(8.0 * (1.0 + 0.2 * np.cos(turn - 1.0)) * (1.0 + rng.normal(0.0, scatter + 1e-3, n)), 0.5)
    bright, radius = rng.choice([200.0, 150.0, 60.0], n), 76.0 + rng.normal(0.0, 10.0 * scatter + 0.1, n)
    chosen, deviation, step = rng.permutation(n).astype(np.int32), np.empty(n), rng.uniform(0.1, 2.0, rings)
    deviation[chosen] = radius / 76.0 - 1.0
    expected, counts, wider = rings_belief.reject(ring, direction, width, bright, radius, step, DIRECTIONS)
    judge = Outliers(NamedSlits(ring, direction, width, bright, chosen, deviation), 76.0, step, DIRECTIONS)
    judge.reject(n)
    np.testing.assert_array_equal(ring, expected)
    assert list(judge.counts().values()) == counts
    np.testing.assert_allclose(judge.wider, wider, rtol=0.0, atol=1e-3)  # px


def fitted(rng: np.random.Generator) -> Fit:
    half = rng.normal(0.0, [1e-4, 1e-4, 0.01, 0.01], (4, 4))
    return Fit(Pose(*rng.normal(0.0, [0.02, 0.02, 3.0, 3.0])), 0.1, half @ half.T)


@few
@given(seeds, st.integers(1, 6), st.sampled_from([1.0, 0.9, 0.5, 0.05]), st.sampled_from([0.0, 0.05, 3.0]))
def test_what_is_kept_and_how_far_it_may_be_off_are_the_references(
    seed: int, rings: int, part: float, apart: float
) -> None:
    rng = np.random.default_rng(seed)
    direction, ring = ring_of_slits(rng, rings, part)
    n, fit = len(ring), fitted(rng)
    turn = 2 * np.pi / DIRECTIONS * direction
    radius = 76.0 + apart * ring + rng.normal(0.0, 0.1, n)
    seen = np.stack([radius * np.cos(turn), radius * np.sin(turn), 90.0 + 20.0 * ring])
    chosen = rng.permutation(n + 4)[:n].astype(np.int32)
    points = rng.normal(0.0, 50.0, (3, n + 4))
    points[:, chosen] = seen
    light, z = rng.uniform(0.0, 300.0, (6, n)), float(rng.normal(0.0, 1e3))
    rotation, shift = fit.pose.rotation, fit.pose.translation

    kept, left, wall = np.empty(n, np.int64), np.empty((3, n)), np.empty((n, 3), np.float32)
    colour, clipped = np.empty((n, 3), np.uint8), np.empty(n, np.bool_)
    of_ring, of_line = np.empty(n, np.uint8), np.empty(n, np.uint16)
    out = kept, left, wall, colour, clipped, of_ring, of_line
    size = _keep(ring, direction, chosen, light, points, rotation, shift, z, OVER_EXPOSED, n, *out)
    sides = light.reshape(2, 3, n)
    which, *expected = rings_points.keep(ring, chosen, sides, points, rotation, shift, z, OVER_EXPOSED)
    assert kept[:size].tolist() == which.tolist()
    np.testing.assert_allclose(wall[:size], expected[0], rtol=2e-7)
    np.testing.assert_array_equal(colour[:size], expected[1])
    np.testing.assert_array_equal(clipped[:size], expected[2])
    assert (of_ring[:size] == ring[which]).all() and (of_line[:size] == direction[which]).all()
    np.testing.assert_array_equal(left[:, :size], points[:, chosen[which]])

    blur, wider = rng.gamma(2.0, 1.0, n), rng.normal(0.0, 0.3, n)
    mm_per_px, calibrated = rng.uniform(0.1, 0.6, rings), rng.uniform(0.0, 0.1, (rings, DIRECTIONS))
    optics = replace(OPTICS["slits"], mm_per_px=mm_per_px)
    width = rng.gamma(4.0, 2.0, n)
    errors = PointErrors(KeptSlits(kept, ring, direction, left, blur, width, wider, clipped), optics, calibrated, 0.02)
    found = errors.sigma(fit, size)
    usual = rings_belief.usual_widths(ring, width, rings, RING_POINTS)
    np.testing.assert_allclose(errors.usual_width, usual, rtol=1e-15)
    mine = ring[which], direction[which], left[:, :size], blur[which], wider[which], clipped[:size]
    placed = rotation, shift, fit.covariance
    sigma, drawn = rings_belief.sigma(*mine, placed, mm_per_px, calibrated, 0.02)
    np.testing.assert_allclose(found, sigma, rtol=1e-6)
    np.testing.assert_allclose(errors.of_rings()[:, 0], drawn, rtol=1e-6, atol=1e-9)

    worth, most = rng.uniform(0.5, 1.0, rings), int(rng.choice([0, 3, 50]))
    out_points, weight, in_ring, counts = (
        np.empty((3, n)),
        np.empty(n),
        np.empty(rings, np.int64),
        np.empty(2, np.int64),
    )
    _for_fit(ring, chosen, points, worth, most, RING_POINTS, n, out_points, weight, in_ring, counts)
    to_fit, of_ring_worth, enough = rings_points.for_fit(ring, chosen, points, worth, most, RING_POINTS)
    assert counts.tolist() == [to_fit.shape[1], enough]
    np.testing.assert_array_equal(out_points[:, : counts[0]], to_fit)
    np.testing.assert_array_equal(weight[: counts[0]], of_ring_worth)
