"""A scan as it comes: the same heights as from all frames at once, in memory that does not know the scan's length."""

import tracemalloc
from collections.abc import Iterator

import numpy as np
from plates import DISTANCE_MM, LEFT, SLIDE, drawn

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.wings.fringe.measure import FringeView, Points, heights, spline, stream
from annulus_pipe.wings.fringe.measure.track import GOOD

STEP_MM = 9.0
AHEAD = np.array([1.0, 0.0, 0.0])
STRIP_MM = 10.0


def strips(length_mm: float) -> Iterator[Points]:
    for x in np.arange(0.0, length_mm, STRIP_MM):
        yield Points.plate(np.arange(x, x + STRIP_MM, 1.0), np.arange(-8.0, 8.0, 1.0), DISTANCE_MM)


def frames(count: int) -> Iterator[tuple[Float32Array, FloatArray]]:
    for n in range(count):
        yield drawn(np.array([n * STEP_MM]), 1.0)[0], n * STEP_MM * AHEAD


def peak(count: int) -> int:
    image = drawn(np.zeros(1))[0]
    tracemalloc.start()
    passed = sum(1 for _ in stream(((image, n * STEP_MM * AHEAD) for n in range(count)), LEFT, SLIDE, strips(1e9)))
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert passed * STRIP_MM > (count - 1) * STEP_MM
    return most


def test_strips_are_as_from_all_frames_at_once() -> None:
    view = FringeView.of(LEFT, SLIDE, np.arange(14)[:, None] * STEP_MM * AHEAD)
    images = spline(drawn(np.arange(14) * STEP_MM, 1.0))
    whole = 0
    for points, found in stream(frames(14), LEFT, SLIDE, strips(140.0)):
        together = heights(view, images, points)
        good = (found.flag == GOOD) & (together.flag == GOOD)
        np.testing.assert_allclose(found.height_mm[good], together.height_mm[good], atol=1e-3)
        whole += bool(good.all())
    assert whole >= 8


def test_memory_does_not_grow_with_the_scan() -> None:
    list(stream(frames(8), LEFT, SLIDE, strips(60.0)))  # what is loaded once
    assert peak(45) < 1.1 * peak(15)
