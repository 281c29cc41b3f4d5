"""The bundle's loops in C against tests/reference/rings_calibration.py: places on lines, how they move, sums."""

import numpy as np
import pytest
import rings_calibration
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.rings.calibration.contours import AROUND, COURSE_LEAST, _course_medians
from annulus_pipe.rings.calibration.kernels import (
    PROBE_PX,
    Guess,
    Lines,
    Residuals,
    errors,
    gather,
    gather_sectors,
    of_head,
)
from annulus_pipe.rings.calibration.observations import RAY_STEP_PX, _place

few = settings(max_examples=25, deadline=None, derandomize=True)
R, PX = 76.2, 600.0  # a camera of so many pixels a radian


def scene(seed: int, sectors: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A ring's numbers (11,), its sectors, and rays and origins of a slit near it."""
    rng = np.random.default_rng(seed)
    numbers = np.array([rng.uniform(0.6, 1.2), *rng.normal(0, 0.01, 2), *rng.normal(0, 3, 2), rng.uniform(-60, -20)])
    numbers = np.concatenate([numbers, rng.normal(0, 0.05, 2), rng.normal(0, 4, 2), [R]])
    turn, seen = rng.uniform(0, 2 * np.pi), np.arctan2(R, numbers[5] + R / np.tan(numbers[0]))
    angle = seen + rng.normal(0, 3 / PX) + np.array([-1.0, 0.0, 1.0]) * RAY_STEP_PX / PX
    rays = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)
    by_sector = np.stack([rng.normal(0, 1e-3, sectors), rng.normal(0, 0.1, sectors)])
    return numbers, by_sector, rays, rng.normal(0, 0.2, (3, 3))


def lines_of(numbers: np.ndarray, sectors: np.ndarray, rays: np.ndarray, origins: np.ndarray) -> tuple[Lines, Guess]:
    nothing = np.zeros(1, np.int64)
    rx, ry = numbers[6:8]
    turns = np.array([[np.cos(rx), np.sin(rx), np.cos(ry), np.sin(ry)]])
    lines = Lines(nothing, nothing, rays[None], origins[None], np.array([5.0]))
    return lines, Guess(numbers[None, :6], numbers[None, 6:10], turns, R, sectors[None])


@few
@given(seed=st.integers(0, 2**32 - 1), sectors=st.sampled_from([0, 5]))
def test_an_error_and_how_it_moves_are_the_references(seed: int, sectors: int) -> None:
    numbers, by_sector, rays, origins = scene(seed, sectors)
    out = Residuals(np.zeros(1), np.zeros(1), np.zeros(1), np.zeros((1, 19)))
    errors(*lines_of(numbers, by_sector, rays, origins), out)
    try:
        at = rings_calibration.place(rays, origins, numbers, by_sector, np.zeros(6))
    except ValueError:  # no crossing within reach of the root finder
        return
    # Newton's last step was less than 1e-4 px, and its error is the square of that
    assert out.places[0] == pytest.approx(at, abs=1e-6)
    middle = rings_calibration.middle(rays, origins, at, numbers, by_sector, 5.0, PROBE_PX)
    if not sectors:  # where a sector ends the angle has a corner
        assert out.middles[0] == pytest.approx(middle, rel=1e-3, abs=1e-6)
        moved = rings_calibration.moved(rays, origins, numbers, by_sector)
        np.testing.assert_allclose(out.rows[0, :17], moved, rtol=1e-4, atol=1e-3 * np.abs(moved).max())
    assert out.error[0] == out.middles[0] - out.places[0]
    assert (out.rows[0, 17:] == 0.0).all()  # other loops'


@few
@given(st.integers(0, 2**32 - 1), st.floats(), st.integers(0, 10), st.sampled_from([0, 1, 5]))
def test_rubbish_gives_none_and_touches_no_other_memory(seed: int, rubbish: float, which: int, sectors: int) -> None:
    numbers, by_sector, rays, origins = scene(seed, sectors)
    numbers[which] = rubbish
    lines, guess = lines_of(numbers, by_sector, rays, origins)
    far = np.array([-(2**62), 2**62])
    lines = Lines(far, far[::-1].copy(), *(np.tile(one, (2, 1, 1)) for one in lines[2:4]), np.array([rubbish, 5.0]))
    out = Residuals(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros((2, 17)))
    lines.rays[1, 2, 0] = rubbish
    errors(lines, guess, out)
    errors(Lines(*lines[:4], None), guess, out)
    weight = np.array([rubbish, 1.0])
    gather(far, far, far, weight, out.error, out.rows, np.zeros((1, 2, 3, 17, 17)), np.zeros((1, 2, 3, 17)))
    gather_sectors(far, far, weight, out.rows, np.zeros((4, 15)))
    of_head(far, np.zeros((1, 3, 3)), np.zeros((2, 0)), np.zeros(0), out.error, out.rows)


@few
@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 12]))
def test_sums_are_numpys(seed: int, tints: int) -> None:
    rng = np.random.default_rng(seed)
    n, c, k, f, wide = 40, 2, 3, 4, 17 + tints
    camera, ring, frame = (rng.integers(0, size, n) for size in (c, k, f))
    weight, error, rows = rng.random(n) * (rng.random(n) > 0.2), rng.normal(0, 1, n), rng.normal(0, 1, (n, wide))
    tint, shift, turns = rng.normal(0, 1, (n, tints)), rng.normal(0, 1, tints), rng.normal(0, 1, (c, 3, 3))
    left, expected = error - tint @ shift, rows.copy()
    expected[camera == 0, 11:17] = 0.0
    expected[camera == 1, 11:14] = rows[camera == 1, 11:14] @ turns[1]
    expected[:, 17:] = tint
    of_head(camera, turns, tint, shift, error, rows)
    np.testing.assert_allclose(error, left, atol=1e-12)
    np.testing.assert_allclose(rows, expected, atol=1e-12)
    blocks, right = np.zeros((c, k, f, wide, wide)), np.zeros((c, k, f, wide))
    gather(frame, ring, camera, weight, error, rows, blocks, right)
    for at in np.ndindex(c, k, f):
        mine = (camera == at[0]) & (ring == at[1]) & (frame == at[2])
        np.testing.assert_allclose(blocks[at], np.triu((rows[mine] * weight[mine, None]).T @ rows[mine]), atol=1e-12)
        np.testing.assert_allclose(right[at], (weight[mine] * error[mine]) @ rows[mine], atol=1e-12)
    shared, own = np.zeros((5, 7 + 4 * f)), rng.integers(0, 5, n)
    gather_sectors(frame, own, weight, rows, shared)
    each = np.zeros((n, 7 + 4 * f))
    each[:, :6], each[:, -1] = rows[:, :6], rows[:, 10]
    for i in range(n):
        each[i, 6 + 4 * frame[i] :][:4] = rows[i, 6:10]
    expected = np.array([((weight * rows[:, 0])[own == s, None] * each[own == s]).sum(axis=0) for s in range(5)])
    np.testing.assert_allclose(shared, expected, atol=1e-12)
    vectors = rng.normal(0, 1, (n, 3, 3))
    placed = np.where((camera == 1)[:, None, None], vectors @ turns[1].T + [1.0, 2.0, 3.0], vectors)
    _place(camera, 1, turns[1].copy(), np.array([1.0, 2.0, 3.0]), vectors)
    np.testing.assert_allclose(vectors, placed, atol=1e-12)


@few
@given(st.integers(0, 2**32 - 1), st.sampled_from([17, 18, 40]), st.sampled_from([0.0, 0.5, 0.95]))
def test_a_course_is_numpys_medians(seed: int, directions: int, unseen: float) -> None:
    rng = np.random.default_rng(seed)
    curve, out = rng.integers(0, 9, (2, directions)) / 4.0, np.full((2, directions), np.nan)
    curve[rng.random(curve.shape) < unseen] = np.nan
    _course_medians(curve, AROUND, COURSE_LEAST, out)
    for k, j in np.ndindex(out.shape):
        near = curve[k, (j + np.arange(-AROUND, AROUND + 1)) % directions]
        near = near[np.isfinite(near)]
        np.testing.assert_array_equal(out[k, j], np.median(near) if len(near) >= COURSE_LEAST else np.nan)
