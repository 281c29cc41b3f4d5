"""Which corner of the target a corner is, where the target tells: by its markers, or by the colours of its corners.

Found corners are numbered from the first that happens to be seen, turned as it happens. A ChArUco target's markers say
where each of them belongs, in part of the target too. A chessboard with an odd number of corners one way and an even
one the other, seen whole, looks different when turned by half a turn: its first corner is that beside a black corner
square, its columns run the long way. Any other chessboard looks the same from two or four sides: it has no first one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.chessboard import TargetView, renumbered
from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.numeric.late import spatial

DICTIONARIES = ("4X4", "5X5", "6X6", "7X7")  # of bits a marker; each contains OpenCV's smaller ones of that size
MARKERS_PX = 1600  # longer sides are shrunk to this to read markers
# By test_origin: part of a target placed rightly, markers of another one not at all.
AGREE = 3  # markers that must say the same of a photograph's place, and more than half of those read
NEAR = 0.3  # of a square: so far from its middle a marker's may be seen


@dataclass(frozen=True, slots=True, eq=False)
class Markers:
    """Markers read in one photograph: their numbers, and (N, 2) pixels of their middles."""

    numbers: NDArray[np.int64]
    pixels: FloatArray


@dataclass(frozen=True, slots=True)
class TargetLayout:
    """A ChArUco target as OpenCV lays it out: squares each way, markers row by row in the light ones. `first_light`:
    the first square is light (of an even number of rows, made before OpenCV 4.6)."""

    columns: int
    rows: int
    first_light: bool


def read_markers(image: Image, dictionary: str) -> Markers:
    """All markers of one of `DICTIONARIES` in (H, W, 3)."""
    scale = min(1.0, MARKERS_PX / max(image.shape))
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1 else image
    known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{dictionary}_1000"))
    corners, numbers, _ = cv2.aruco.ArucoDetector(known).detectMarkers(small)
    if numbers is None:
        return Markers(np.zeros(0, np.int64), np.zeros((0, 2)))
    middles = np.array([np.asarray(four, float).reshape(4, 2).mean(axis=0) for four in corners])
    return Markers(np.asarray(numbers, np.int64).ravel(), (middles + 0.5) / scale - 0.5)


def from_colours(view: TargetView, columns: int, rows: int) -> TargetView:
    """The view numbered from its chessboard's own first corner, or as it was where it has none or is not seen whole.

    columns, rows : of its corners, the long way and the short way.
    """
    if (columns + rows) % 2 == 0 or view.size != (columns, rows):
        return view
    if view.cells[:, 0].max() + 1 != columns:
        view = renumbered(view, 1, np.array([0, view.cells[:, 0].max()]))
    if view.dark:
        view = renumbered(view, 2, np.array([columns - 1, rows - 1]))
    return replace(view, own_origin=True)


def from_markers(views: Sequence[TargetView], seen: Sequence[Markers], columns: int, rows: int) -> list[TargetView]:
    """Views numbered from their ChArUco target's own first corner, each as it was where its markers do not tell.

    columns, rows : of its corners, in either order: the markers tell which way they run, and which layout it is.
    """
    layouts = [
        TargetLayout(across + 1, down + 1, first_light)
        for across, down in {(columns, rows), (rows, columns)}
        for first_light in (False, True)
    ]
    ways = [[_placed(view, markers, layout) for view, markers in zip(views, seen, strict=True)] for layout in layouts]
    best = max(range(len(layouts)), key=lambda n: sum(agree for agree, _ in ways[n]))
    return [
        _inside(placed, layouts[best]) if agree >= AGREE else view
        for view, (agree, placed) in zip(views, ways[best], strict=True)
    ]


def _placed(view: TargetView, markers: Markers, layout: TargetLayout) -> tuple[int, TargetView]:
    """How many markers agree on where the view's corners belong, and it numbered so; 0 where most do not."""
    place = {(int(x), int(y)): at for (x, y), at in zip(view.cells, view.pixels, strict=True)}
    whole = [(x, y) for x, y in place if all(other in place for other in ((x + 1, y), (x, y + 1), (x + 1, y + 1)))]
    home = _light_squares(layout)
    known = markers.numbers < len(home)
    if not whole or not known.any():
        return 0, view
    middles = np.array(
        [np.mean([place[x, y], place[x + 1, y], place[x, y + 1], place[x + 1, y + 1]], axis=0) for x, y in whole]
    )
    far, nearest = spatial.cKDTree(middles).query(markers.pixels[known])
    good = far < NEAR * view.step_px
    squares = np.array(whole)[nearest[good]]
    # The square beyond corner (x, y) is the target's (x + 1, y + 1): its corners are between squares.
    wanted = home[markers.numbers[known][good]] - 1
    best, out = 0, view
    for quarters in range(4):
        # A square is named by its corner of least column and row, another one after a turn: so, by its middle.
        turned = renumbered(replace(view, cells=2 * squares + 1), quarters, np.zeros(2, int)).cells // 2
        shifts, votes = np.unique(wanted - turned, axis=0, return_counts=True)
        if len(votes) and votes.max() > best:
            best = int(votes.max())
            out = renumbered(view, quarters, shifts[votes.argmax()])
    return (best, out) if 2 * best > len(squares) else (0, view)


def _inside(view: TargetView, layout: TargetLayout) -> TargetView:
    """Without corners the target does not have: clutter sometimes adds a row."""
    good = np.all((view.cells >= 0) & (view.cells < [layout.columns - 1, layout.rows - 1]), axis=1)
    return replace(view, cells=view.cells[good], pixels=view.pixels[good], own_origin=True)


@lru_cache(maxsize=8)
def _light_squares(layout: TargetLayout) -> NDArray[np.int64]:
    """(N, 2) column and row of the squares that have markers, by the markers' numbers."""
    y, x = np.divmod(np.arange(layout.columns * layout.rows), layout.columns)
    light = (x + y) % 2 == (0 if layout.first_light else 1)
    return np.stack([x[light], y[light]], axis=1)
