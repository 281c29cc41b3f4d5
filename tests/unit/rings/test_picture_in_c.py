"""From a frame to slits in C against tests/reference/rings_picture.py and rings_slits.py, and against OpenCV, on
frames that no pipe shows."""

import functools

import cv2
import numpy as np
import pytest
import rings_picture
import rings_slits
from hostile_frames import DIRECTIONS, KINDS, frame, heads, mosaic_of, spoilt
from hypothesis import given
from hypothesis import strategies as st
from repeated import few

from annulus_pipe.numeric.mosaic import ORDERS, Mosaic
from annulus_pipe.rings.pedestal import _pedestal, _without_veil
from annulus_pipe.rings.polar import ACROSS, PolarGrid, Unroller, laid_out, polar_grid, sampled
from annulus_pipe.rings.slits import FAINT, FrameSlits, smoothing

seeds = st.integers(0, 2**32 - 1)
orders = st.sampled_from([None, *ORDERS])
SPOILT = ["spoilt"] * 4  # more often than others: these have slits


@functools.cache
def room(head: str) -> tuple[PolarGrid, Unroller, FrameSlits]:
    """One memory for all frames of a head, as in use: what one frame leaves there must not be seen in the next."""
    grid = polar_grid(heads()[head], DIRECTIONS)
    return grid, Unroller(grid), FrameSlits(grid)


def picture(head: str, kind: str, seed: int, order: str | None) -> tuple[np.ndarray | Mosaic, np.ndarray]:
    """What is reconstructed, and the colours that it stands for."""
    camera = heads()[head].camera
    image = spoilt(head, seed) if kind == "spoilt" else frame(kind, seed, camera.height, camera.width)
    if order is None:
        return image, image
    mosaic = mosaic_of(image, order)
    return mosaic, rings_picture.colours(mosaic.cells, order)


@few
@given(seeds, st.integers(3, 40), st.integers(3, 40), st.sampled_from(ORDERS), st.sampled_from(list(KINDS)))
def test_a_mosaics_colours_are_opencvs(seed: int, height: int, width: int, order: str, kind: str) -> None:
    mosaic = Mosaic(np.ascontiguousarray(frame(kind, seed, height, width)[..., 0]), order)
    np.testing.assert_array_equal(rings_picture.colours(mosaic.cells, order), mosaic.bgr())


@few
@given(st.sampled_from(["slits", "one ring", "mirror", "lines"]), st.sampled_from([*KINDS, "spoilt"]), seeds, orders)
def test_lines_are_the_references_and_opencvs_to_the_bit(head: str, kind: str, seed: int, order: str | None) -> None:
    grid, unroller, _ = room(head)
    given_image, image = picture(head, kind, seed, order)
    unrolled = unroller(given_image)
    black, gain, start, stop = rings_picture.look(image, grid)
    assert (unroller._black.tolist(), unroller._gain.tolist()) == (black.tolist(), gain.tolist())
    assert (unrolled.first, unrolled.first + unrolled.length) == (start, stop)
    plane = rings_picture.strongest(image, black, gain)
    lines = rings_picture.sampled(plane, grid)[:, start:stop]
    top = rings_picture.averaged(lines)
    read = np.arange(start, stop) < grid.stop[:, None]
    np.testing.assert_array_equal(unrolled.top[read], top[read])
    assert (unrolled.bright, unrolled.noise) == pytest.approx(rings_picture.level(unrolled.top, grid.stop - start))
    np.testing.assert_array_equal(sampled(plane, grid)[1:-1, start:stop], lines)

    at, part = np.divmod(rings_picture.places(grid), rings_picture.PARTS)
    closed = np.arange(-1, DIRECTIONS + 1) % DIRECTIONS
    fractions = (rings_picture.PARTS * part[..., 1] + part[..., 0]).astype(np.uint16)
    theirs = cv2.remap(plane, at[closed].astype(np.int16), fractions[closed], cv2.INTER_LINEAR)
    blurred = cv2.GaussianBlur(theirs[:, start:stop], (1, 3), sigmaX=1.0, sigmaY=ACROSS)[1:-1]
    inside = rings_picture.inside(at, plane.shape)[closed, start:stop]
    whole = inside[1:-1] & inside[2:] & inside[:-2]  # of one that is half outside OpenCV takes half
    np.testing.assert_array_equal(top[whole], blurred[whole])


@few
@given(st.sampled_from([*KINDS, *SPOILT]), seeds, orders, st.integers(1, 9), st.integers(0, 9), st.floats(0.0, 1.0))
def test_a_pedestal_is_the_references(
    kind: str, seed: int, order: str | None, step: int, half: int, lit: float
) -> None:
    given_image, image = picture("slits", kind, seed, order)
    rows, columns = (-(-(size - step // 4) // step) for size in image.shape[:2])
    under, bright = rings_picture.pedestal(image, step, half, lit)
    room, cells = np.empty((3, rows, columns), np.uint8), laid_out(given_image)
    found = [_pedestal(*cells, step, half, lit, (under + off) / (bright or 1.0), *room) for off in (-1e-6, 1e-6)]
    # worth more than a trace less, and not more than a trace more
    assert found == ([1, 0] if bright else [under > 0.0] * 2)


@few
@given(
    st.sampled_from([*KINDS, "spoilt"]), seeds, *[st.integers(7, 60)] * 2, st.integers(1, 5), *[st.integers(0, 6)] * 2
)
def test_the_light_that_is_no_stripes_is_taken_off_as_by_the_reference(
    kind: str, seed: int, height: int, width: int, step: int, half: int, smooth: int
) -> None:
    image = spoilt("slits", seed)[:height, :width] if kind == "spoilt" else frame(kind, seed, height, width)
    image = np.ascontiguousarray(image)
    rows, columns = (-(-(size - step // 2) // step) for size in (height, width))
    half, smooth = (min(most, rows - 1, columns - 1) for most in (half, smooth))
    out, small, sums = np.empty_like(image), np.empty((4, rows, columns, 3), np.uint8), np.empty(3 * columns, np.uint32)
    work = np.empty((2, width), np.int32), np.empty(columns, np.uint64), np.empty((2, 3 * width), np.uint16)
    _without_veil(image, step, half, smooth, small, sums, *work, out)
    # weights of 1/256 in both directions and a level's sixteenths: less than a level, to which it is rounded
    assert np.abs(out - rings_picture.without_veil(image, step, half, smooth)).max() < 1.5


@few
@given(st.sampled_from(["slits", "fisheye", "one ring", "mirror"]), st.sampled_from([*KINDS, *SPOILT]), seeds, orders)
def test_slits_are_the_references(head: str, kind: str, seed: int, order: str | None) -> None:
    grid, unroller, table = room(head)
    given_image, image = picture(head, kind, seed, order)
    unrolled = unroller(given_image)
    table.find(unrolled)
    floor = np.float32(max(FAINT * unrolled.bright, 4.0 * unrolled.noise, 2.0))
    away = grid.first + grid.step * unrolled.first, grid.step
    stop = grid.stop - unrolled.first
    every, crowded = rings_slits.scan(unrolled.top, stop, away, smoothing(grid.spacing_px), floor, grid.spacing_px)
    expected, found = rings_slits.dark_ones(every), table.slits()
    assert (found.crowded, found.shallow) == (crowded, len(every) - len(expected))
    assert found.direction.tolist() == [slit.direction for slit in expected]
    np.testing.assert_allclose(found.position - unrolled.first, [s.place for s in expected], rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(found.width, [s.width for s in expected], rtol=0.0, atol=1e-4)
    np.testing.assert_allclose(found.edge_blur, [s.blur for s in expected], rtol=1e-5)
    ways = np.stack([grid.cosine, grid.sine], axis=1)
    light = rings_slits.light(image, grid.centre, away, ways, expected)
    np.testing.assert_allclose([found.inside, found.outside], light, rtol=0.0, atol=1e-4)  # grey levels
    np.testing.assert_allclose(table.bright[: table.size], light.max(axis=2).sum(axis=0), rtol=0.0, atol=2e-4)
