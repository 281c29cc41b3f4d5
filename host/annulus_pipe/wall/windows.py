"""A pipe too long to be surveyed at once, in windows: what each of them looks at, and which part of its survey is kept.

A window is a stretch of pipe between two cuts. It is surveyed with a halo of two diameters on either side, so that
whatever lies at a cut has all its neighbours on both sides of it, and only what lies between the cuts is kept
(`within.py`). Rows of all windows are of one length, on one grid, and cuts lie between rows: what was kept of two
neighbours stands side by side without a seam. What lies across a cut is found by both, and told once (`joined.py`).

Where windows are cut follows from the points alone: not from who works on them, nor how many do.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray, IntArray
from annulus_pipe.wall.grid import z_step_of
from annulus_pipe.wall.profile import Profile

HALO_OF_RADIUS = 4.0  # of the nominal radius: two diameters, beside either end
CORE_OF_RADIUS = 4.0  # .. and the least that a window keeps
CUT_MM = 100.0  # a cut lies at a multiple: a whole number of rows and of stations of every grid
POINTS_MAX = 2_000_000  # of a window: 300 bytes a point while it is surveyed; tools/bench/speed/long_scan.py
STRAY = 1.0  # percent of a frame's points that may lie anywhere
WHOLE_ROWS_MAX = 10_000  # of the map of the whole
ROW_STEPS_MM = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)  # of that map, where rows are to be joined


@dataclass(frozen=True, slots=True)
class Reach:
    """Of one frame: how many points it has, and from where to where along the pipe they lie, mm, strays left out."""

    points: int
    low_mm: float
    high_mm: float

    @classmethod
    def of(cls, profile: Profile) -> "Reach | None":
        """None of a frame without a point."""
        if profile.pose is None or not len(profile.points_mm):
            return None
        low, high = np.percentile(profile.points_mm[:, 2].astype(np.float64), [STRAY, 100.0 - STRAY])
        return cls(len(profile.points_mm), float(low), float(high))


@dataclass(frozen=True, slots=True)
class Window:
    """The first from minus, the last to plus infinity. frames : numbers of those whose points lie in it or in its halo,
    rising. thinned : how many more did, and were left out, so evenly as may be, for there were too many."""

    first_mm: float
    last_mm: float
    frames: tuple[int, ...]
    thinned: int = 0


@dataclass(frozen=True, slots=True)
class WindowPlan:
    """Windows in the order of the pipe; the length of a row of each and of the map of the whole, mm."""

    windows: tuple[Window, ...]
    z_step_mm: float
    whole_step_mm: float


def plan(reaches: Sequence[Reach | None], radius_mm: float, points_max: int = POINTS_MAX) -> WindowPlan:
    """How a scan is cut, or is not: one window of all frames where they have no more points than `points_max` together.

    reaches : of every projector frame, in their order. radius_mm : nominal.
    """
    at = np.array([i for i, one in enumerate(reaches) if one is not None], np.int64)
    known = _SortedFrames.of([one for one in reaches if one is not None])
    total = int(known.points.sum())
    if total <= points_max:
        return WindowPlan((Window(-math.inf, math.inf, tuple(range(len(reaches)))),), math.nan, math.nan)
    begin, end = float(known.low_mm[0]), float(known.farthest_mm[-1])
    first = known.windows(begin, end, radius_mm, CUT_MM, points_max)
    used = sum(len(frames) for _, _, frames, _ in first) / sum(len(frames) + more for _, _, frames, more in first)
    step = z_step_of(round(total * used), end - begin)
    whole = next(
        (s for s in (step, *ROW_STEPS_MM) if s % step == 0.0 and (end - begin) / s <= WHOLE_ROWS_MAX), ROW_STEPS_MM[-1]
    )
    cuts = first if whole <= CUT_MM else known.windows(begin, end, radius_mm, whole, points_max)
    windows = tuple(Window(a, b, tuple(int(i) for i in at[frames]), more) for a, b, frames, more in cuts)
    return WindowPlan(windows, step, float(whole))


@dataclass(frozen=True, slots=True)
class _SortedFrames:
    """Frames with points, sorted by where those begin."""

    own_points: IntArray  # as they came
    order: IntArray  # which of those each is
    points: IntArray
    low_mm: FloatArray
    high_mm: FloatArray
    farthest_mm: FloatArray  # running maximum: as far as this frame or one before it reaches

    @classmethod
    def of(cls, reaches: Sequence[Reach]) -> "_SortedFrames":
        low, high = np.array([one.low_mm for one in reaches]), np.array([one.high_mm for one in reaches])
        points = np.array([one.points for one in reaches], np.int64)
        order = np.argsort(low, kind="stable")
        high = high[order]
        return cls(points, order, points[order], low[order], high, np.maximum.accumulate(high) if len(high) else high)

    def windows(
        self, begin: float, end: float, radius_mm: float, cut_mm: float, most: int
    ) -> list[tuple[float, float, IntArray, int]]:
        """From, to, frames and how many more were left out, of every window between cuts at multiples of `cut_mm`."""
        halo, least = HALO_OF_RADIUS * radius_mm, max(CORE_OF_RADIUS * radius_mm, cut_mm)
        cuts, place = [-math.inf], begin
        while (place := self.farthest_cut(place, halo, least, cut_mm, most)) + least <= end:
            cuts.append(place)
        out = []
        for first, last in pairwise([*cuts, math.inf]):
            inside = np.sort(self.between(first - halo, last + halo))
            kept = _thinned(inside, self.own_points, most)
            out.append((first, last, kept, len(inside) - len(kept)))
        return out

    def between(self, first_mm: float, last_mm: float) -> IntArray:
        """Those that have points there, as they came."""
        a, b = self._stretch(first_mm, last_mm)
        return np.asarray(self.order[a:b][self.high_mm[a:b] >= first_mm])

    def _stretch(self, first_mm: float, last_mm: float) -> tuple[int, int]:
        begin = np.searchsorted(self.farthest_mm, first_mm, side="left")
        return int(begin), int(np.searchsorted(self.low_mm, last_mm, side="right"))

    def farthest_cut(self, begin: float, halo: float, least: float, cut_mm: float, most: int) -> float:
        """The farthest cut that keeps a window's points few enough; the nearest that may be where none does; infinity
        where all that is left is few enough."""
        a, _ = self._stretch(begin - halo, math.inf)
        entered = np.cumsum(np.where(self.high_mm[a : a + most] >= begin - halo, self.points[a : a + most], 0))
        over = int(np.searchsorted(entered, most, side="right"))
        if over >= len(entered):
            return math.inf
        nearest = cut_mm * math.ceil((begin + least) / cut_mm)
        return max(nearest, cut_mm * math.floor((float(self.low_mm[a + over]) - halo) / cut_mm))


def _thinned(inside: IntArray, points: IntArray, most: int) -> IntArray:
    """Every n-th of the frames where they have too many points: where a head stood still, all see the same."""
    n = max(1, math.ceil(int(points[inside].sum()) / (2 * most)))  # the nearest cut may hold more, up to twice as many
    return inside[::n]
