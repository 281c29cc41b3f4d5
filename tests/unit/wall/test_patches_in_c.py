"""Patches of a grid that closes round, in C: as SciPy has them on a grid laid side by side with itself."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from annulus_pipe.wall.patches import closed, grown, label_around, opened, runs, without_holes

few = settings(max_examples=60, deadline=None, derandomize=True)
masks = {
    "seed": st.integers(0, 2**32 - 1),
    "shape": st.tuples(st.integers(1, 9), st.integers(3, 12)),
    "part": st.sampled_from([0.0, 0.05, 0.3, 0.6, 0.9, 1.0]),
}


def drawn(seed: int, shape: tuple[int, int], part: float) -> np.ndarray:
    return np.asarray(np.random.default_rng(seed).random(shape) < part)


def thrice(mask: np.ndarray) -> np.ndarray:
    return np.concatenate([mask] * 3, axis=1)


def middle(wide: np.ndarray) -> np.ndarray:
    columns = wide.shape[1] // 3
    return wide[:, columns : 2 * columns]


@few
@given(**masks, rows=st.integers(0, 4), columns=st.integers(0, 3))
def test_what_grows_and_closes_is_scipys(seed: int, shape: tuple, part: float, rows: int, columns: int) -> None:
    mask = drawn(seed, shape, part)
    box = np.ones((2 * rows + 1, 2 * columns + 1), bool)
    np.testing.assert_array_equal(grown(mask, rows, columns), middle(ndimage.binary_dilation(thrice(mask), box)))
    np.testing.assert_array_equal(grown(mask, rows, columns, closes=False), ndimage.binary_dilation(mask, box))
    wide = np.pad(thrice(mask), ((2 * rows, 2 * rows), (0, 0)))
    done = middle(ndimage.binary_closing(wide, box))[2 * rows : len(wide) - 2 * rows] | mask
    np.testing.assert_array_equal(closed(mask, rows, columns), done)


@few
@given(**masks, rows=st.integers(1, 4), columns=st.integers(1, 4))
def test_what_a_box_fits_in_is_scipys(seed: int, shape: tuple, part: float, rows: int, columns: int) -> None:
    mask = drawn(seed, shape, part)
    if columns <= shape[1]:
        expected = middle(ndimage.binary_opening(thrice(mask), np.ones((rows, columns), bool)))
        np.testing.assert_array_equal(opened(mask, rows, columns), expected)
    else:
        assert not opened(mask, rows, columns).any()


@few
@given(**masks)
def test_patches_are_numbered_as_they_are_met(seed: int, shape: tuple, part: float) -> None:
    mask = drawn(seed, shape, part)
    label, n = label_around(mask)
    assert ((label > 0) == mask).all()
    assert list(dict.fromkeys(label[mask].tolist())) == list(range(1, n + 1))
    wide, many = ndimage.label(thrice(mask), np.ones((3, 3)))
    alike = {frozenset(np.unique(thrice(label)[wide == i]).tolist()) for i in range(1, many + 1)}
    assert all(len(one) == 1 for one in alike)  # no two numbers touch
    for i in range(1, n + 1):  # and one number is one patch
        assert (
            ndimage.label(np.roll(label == i, -int(np.argmin((label == i).any(axis=0))), axis=1), np.ones((3, 3)))[1]
            == 1
            or (label == i).any(axis=0).all()
        )


@few
@given(**masks)
def test_runs_go_round(seed: int, shape: tuple, part: float) -> None:
    mask = drawn(seed, shape, part)
    for line, found in zip(mask, runs(mask), strict=True):
        columns = len(line)
        expected = []
        for j in range(columns):
            left = next((k for k in range(columns) if not line[j - k]), columns)
            right = next((k for k in range(columns) if not line[(j + k) % columns]), columns)
            expected.append(min(left + right - 1, columns) if line[j] else 0)
        assert found.tolist() == expected


@few
@given(**masks)
def test_holes_are_filled_in_the_rows_of_a_place_only(seed: int, shape: tuple, part: float) -> None:
    mask = drawn(seed, shape, part)
    half = shape[1] // 2
    turned = np.roll(ndimage.binary_fill_holes(np.roll(mask, half, axis=1)), -half, axis=1)
    np.testing.assert_array_equal(without_holes(mask), ndimage.binary_fill_holes(mask) | turned)
