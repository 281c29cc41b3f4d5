"""Frames that no pipe shows, and small heads of every kind to look at them with."""

import functools
from collections.abc import Callable

import line_heads
import numpy as np
from drawn import Paint, calibration, draw
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.mosaic import Mosaic
from annulus_pipe.twin.worlds import World
from annulus_pipe.twin.worlds.mirror import mirror_world
from tests import kept

Image = NDArray[np.uint8]
Rng = np.random.Generator
DIRECTIONS = 72


@functools.cache
def worlds() -> dict[str, World]:
    """Of heads that the twin draws."""
    return {
        "mirror": mirror_world().scaled(333),
        "line": line_heads.head(*line_heads.ONE_RING).scaled(299),
        "lines": line_heads.head(*line_heads.TWO_RINGS).scaled(333),
        "plane": line_heads.head(*line_heads.PLANE).scaled(301),
    }


@functools.cache
def heads() -> dict[str, Calibration]:
    """By kind; of sizes that are no multiple of anything."""
    return {
        "slits": calibration("pinhole", 0.2),
        "fisheye": calibration("fisheye", 0.213),
        "one ring": calibration("pinhole", 0.19, colours="RG", theta_deg=(46.0,)),
    } | {name: world.calibration() for name, world in worlds().items()}


def _plain(level: int) -> Callable[[Rng, int, int], Image]:
    return lambda rng, h, w: np.full((h, w, 3), level, np.uint8)


def _board(rng: Rng, h: int, w: int) -> Image:
    y, x = np.mgrid[0:h, 0:w] // rng.choice([1, 2, 3, 5, 11])
    return np.repeat((255 * ((x + y) % 2)).astype(np.uint8)[..., None], 3, axis=2)


def _stripes(rng: Rng, h: int, w: int) -> Image:
    along = np.mgrid[0:h, 0:w][rng.integers(2)] // rng.choice([1, 1, 2, 7])
    return np.where((along % 2)[..., None], rng.integers(0, 256, 3), rng.integers(0, 256, 3)).astype(np.uint8)


def _points(rng: Rng, h: int, w: int) -> Image:
    image = np.full((h, w, 3), rng.choice([0, 0, 3]), np.uint8)
    for _ in range(rng.choice([1, 40, 3000])):
        image[rng.integers(h), rng.integers(w), rng.integers(3)] = 255
    return image


def _rings(rng: Rng, h: int, w: int) -> Image:
    """Coloured stripes round some place, dark slits between, noise: a pattern that is not this head's."""
    y, x = np.mgrid[0:h, 0:w]
    away = np.hypot(x - w * rng.uniform(0.4, 0.6), y - h * rng.uniform(0.4, 0.6))
    period, dark = rng.choice([4.0, 6.3, 9.0, 14.5]), rng.uniform(0.2, 0.7)
    image = rng.integers(0, 256, (w, 3))[(away / period).astype(int) % w] * rng.uniform(0.05, 1.5)
    image[away % period < dark * period] = rng.integers(0, 40)
    image = image * rng.choice([1.0, 1.0, 0.2], 3) + rng.integers(0, 30, 3)  # a channel may be weak, each has its black
    return np.clip(image + rng.normal(0.0, rng.choice([0.0, 2.0, 20.0]), image.shape), 0, 255).astype(np.uint8)


KINDS: dict[str, Callable[[Rng, int, int], Image]] = {
    "black": _plain(0),
    "white": _plain(255),
    "grey": lambda rng, h, w: _plain(int(rng.integers(1, 255)))(rng, h, w),
    "noise": lambda rng, h, w: rng.integers(0, 256, (h, w, 3), dtype=np.uint8),
    "faint noise": lambda rng, h, w: np.clip(rng.normal(4.0, 2.0, (h, w, 3)), 0, 255).astype(np.uint8),
    "board": _board,
    "stripes": _stripes,
    "points": _points,
    "rings": _rings,
}


def frame(kind: str, seed: int, height: int, width: int) -> Image:
    """(H, W, 3) BGR."""
    return KINDS[kind](np.random.default_rng(seed), height, width)


def mosaic_of(image: Image, order: str) -> Mosaic:
    """What a sensor gives whose pixels see only one colour each."""
    cells = np.empty(image.shape[:2], np.uint8)
    for n, letter in enumerate(order):
        row, column = divmod(n, 2)
        cells[row::2, column::2] = image[row::2, column::2, "bgr".index(letter)]
    return Mosaic(cells, order)


@functools.cache
def seen(head: str) -> Image:
    """What such a head sees of a pipe."""
    if head in worlds():
        return kept.picture(lambda: line_heads.picture(worlds()[head], 40.0), worlds()[head], 40.0)
    return draw(heads()[head], Pose(0.02, -0.01, 1.5, -2.0), paint=Paint(blur_px=0.6), slit_px=3.0)


def spoilt(head: str, seed: int) -> Image:
    """The same with patches of something else in it: some slits are cut, shaded, doubled, or not there at all."""
    rng, image = np.random.default_rng(seed), seen(head).copy()
    height, width = image.shape[:2]
    for _ in range(rng.integers(1, 6)):
        y, x = rng.integers(0, height - 8), rng.integers(0, width - 8)
        patch = image[y : y + rng.integers(8, height // 2), x : x + rng.integers(8, width // 2)]
        what = rng.integers(4)
        if what == 0:
            patch[:] = frame(str(rng.choice(list(KINDS))), int(rng.integers(2**32)), *patch.shape[:2])
        elif what == 1:
            patch[:] = patch * rng.uniform(0.0, 1.0)
        elif what == 2:
            patch[:] = np.roll(patch, rng.integers(-6, 7), axis=rng.integers(2))
        else:
            patch[:] = np.minimum(patch.astype(int) * rng.integers(1, 9), 255)
    return np.clip(image + rng.normal(0.0, rng.choice([0.0, 1.0, 6.0]), image.shape), 0, 255).astype(np.uint8)
