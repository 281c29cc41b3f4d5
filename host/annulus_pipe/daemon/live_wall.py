"""The wall as it grows while a scan is under way: two grids of radii, of bounded memory whatever the length.

"recent" has rows of RECENT_STEP_MM and holds the last RECENT_ROWS of them; "whole" holds the scan from its beginning,
in rows whose length doubles when WHOLE_ROWS are full. Columns are degrees, clockwise from 12 o'clock.

A cell is the median of its votes: the newest word of each ring that saw it, which is the mean of that ring's points
there in one frame. So a ring that is wrong has one vote of (mostly) five however long it looks, also where the head
stands still; a mean, or a median of all points, would be won by whoever looked the longest. Patterns of fewer than
VOTES_LEAST rings have the last few frames' words of each. The points are where the live profiles have them: registered
with nothing, and their own pose's.

    wall = LiveWall(calibration, scan)
    wall.add(profile)                       # each one, .4 ms; nothing that is allocated stays
    for body, part in wall.say(now): ..     # often; says at most one thing at a time
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.wall.profile import Profile

COLUMNS = 360
RECENT_STEP_MM, RECENT_ROWS = 5.0, 2000
WHOLE_ROWS = 2048
VOTES_LEAST, VOTES_MOST = 5, 8  # of a cell: 2 bytes each
UNSEEN = -32768
HUNDREDTHS = 100.0  # of a mm, in which a deviation is told
REACH_OF_RADIUS = 40.0  # from the head, along the pipe: what is farther off is no wall
ROW_MOST = 1 << 30  # either way
SAY_S = 0.5  # between two words on what has changed, and two slices of what has not
PACE_S = 0.05  # between any two: a viewer's queue holds two messages
SLICE_ROWS, AT_ONCE_ROWS = 32, 256  # in a message that repeats the map in turn; in one of new rows, or for a new viewer
HOLE_ROWS = 16
NOTHING = -(1 << 40)  # the row where none lies

Rows = NDArray[np.int64]
Said = tuple[dict[str, Any], bytes]


class LiveWall:
    """Both grids. `say` is asked only while somebody listens; what it had to say until then it says later."""

    def __init__(self, calibration: Calibration, scan: int) -> None:
        """`scan`: a number drawn for it."""
        rings = max(1, len(calibration.rings))
        self._radius_mm = float(calibration.pipe_radius_mm)
        self._rings, self._turns = rings, max(1, -(-VOTES_LEAST // rings))
        votes = min(VOTES_MOST, rings * self._turns)
        self._grids = (
            LiveGrid("recent", RECENT_STEP_MM, RECENT_ROWS, votes),
            LiveGrid("whole", RECENT_STEP_MM, WHOLE_ROWS, votes),
        )
        self._votes = votes
        self._frames = 0
        self._next_s = 0.0
        self.begin(scan)

    def begin(self, scan: int) -> None:
        """Another scan: nothing is seen of it yet."""
        self._scan = scan
        for grid in self._grids:
            grid.clear()

    def add(self, profile: Profile) -> None:
        """A frame's points."""
        x, y, z = profile.points_mm.astype(np.float64).T
        deviation = np.rint((np.hypot(x, y) - self._radius_mm) * HUNDREDTHS)
        near = np.abs(z - profile.z_mm) < REACH_OF_RADIUS * self._radius_mm
        near &= (np.abs(deviation) < -UNSEEN) & (np.abs(z) < ROW_MOST * RECENT_STEP_MM)
        if not near.any():
            return
        column = np.minimum((np.degrees(np.arctan2(x, -y)) % 360.0).astype(np.int64), COLUMNS - 1)
        vote = (profile.ring.astype(np.int64) + self._rings * (self._frames % self._turns)) % self._votes
        self._frames += 1
        for grid in self._grids:
            grid.add(z[near], column[near], vote[near], deviation[near])

    def say_again(self) -> None:
        """Somebody listens who has heard nothing yet: everything, and soon."""
        for grid in self._grids:
            grid.anew()

    def say(self, now: float, in_turn: bool = True) -> Iterator[Said]:
        """At most one word: body and cells of topic wall. in_turn : also what has not changed, a slice at a time, for
        who missed it."""
        if now < self._next_s:
            return
        for grid in sorted(self._grids, key=lambda one: one.said_s):
            first, cells = grid.next(now, in_turn)
            if len(cells):
                self._next_s = now + PACE_S
                yield word(self._scan, grid, first, cells, self._radius_mm)
                return

    def deviation_mm(self, of: str) -> tuple[float, Rows, FloatArray]:
        """A grid as it stands: its step in mm, its rows (R,) and their cells (R, COLUMNS), NaN where not seen."""
        grid = next(one for one in self._grids if one.of == of)
        rows = grid.known()
        cells = grid.cells(rows)
        return grid.step_mm, rows, np.where(cells == UNSEEN, np.nan, cells / HUNDREDTHS)


def word(scan: int, grid: "LiveGrid", first: int, cells: NDArray[np.int16], radius_mm: float) -> Said:
    """Body and cells of topic wall: rows of one of the two grids, how far the radius departs from the nominal one."""
    like = {"scan": scan, "of": grid.of, "step_mm": grid.step_mm, "first": first, "rows": len(cells)}
    return {**like, "columns": COLUMNS, "radius_mm": radius_mm}, cells.astype("<i2").tobytes()


class LiveGrid:
    """One of the two. Row r lies at (r + 0.5) step_mm and is kept at r modulo the number of rows there are, until one
    that needs the place comes; or, of the whole, until all rows become twice as long.
    """

    def __init__(self, of: str, step_mm: float, rows: int, votes: int) -> None:
        self.of, self.step_mm = of, step_mm
        self._first_step_mm, self._grows = step_mm, of == "whole"
        self._votes = np.empty((rows, COLUMNS, votes), np.int16)
        self._medians = np.empty((rows, COLUMNS), np.int16)  # the votes' medians, where not stale
        self._row: Rows = np.empty(rows, np.int64)
        self._stale, self._changed = np.empty(rows, bool), np.empty(rows, bool)
        self.clear()

    def clear(self) -> None:
        self.step_mm = self._first_step_mm
        self._votes.fill(UNSEEN)  # which also makes all of its memory ours from the beginning
        self._medians.fill(UNSEEN)
        self._row.fill(NOTHING)
        self._stale.fill(False)
        self._changed.fill(False)
        self.said_s = self._sliced_s = -SAY_S  # what changed; a slice
        self._turn = NOTHING  # the row from which the next slice begins
        self._hurried = 0  # rows still to be said at once
        self._news: Rows = np.zeros(0, np.int64)  # what had changed when it was last looked

    def add(self, z_mm: FloatArray, column: Rows, vote: Rows, deviation: FloatArray) -> None:
        """Points (N,) of one frame; deviation in HUNDREDTHS of a mm."""
        row = np.floor(z_mm / self.step_mm).astype(np.int64)
        if self._grows:
            known = self._row[self._row != NOTHING]
            low = min(int(row.min()), int(known.min(initial=row.min())))
            high = max(int(row.max()), int(known.max(initial=row.max())))
            while high - low >= len(self._row):
                self._double()
                low, high, row = low >> 1, high >> 1, row >> 1
        at = row % len(self._row)
        there, which = np.unique(row, return_index=True)
        places = at[which]
        fresh = self._row[places] != there
        if fresh.any():
            self._empty(places[fresh], there[fresh])
        votes = self._votes.shape[2]
        cell = (at * COLUMNS + column) * votes + vote
        order = np.argsort(cell)
        cell = cell[order]
        starts = np.flatnonzero(np.diff(cell, prepend=-1))
        mean = np.add.reduceat(deviation[order], starts) / np.diff(starts, append=len(cell))
        self._votes.reshape(-1)[cell[starts]] = np.rint(mean).astype(np.int16)
        self._stale[places] = self._changed[places] = True

    def anew(self) -> None:
        """All of it is to be said, and soon."""
        self._news = self._news[:0]
        self._turn, self._hurried = NOTHING, int(np.count_nonzero(self._row != NOTHING))

    def next(self, now: float, in_turn: bool) -> tuple[int, NDArray[np.int16]]:
        """First row and cells of what is to be said now: (0 rows, ..) is nothing."""
        hurried = self._hurried > 0
        if not len(self._news) and now - self.said_s >= SAY_S and not hurried:
            self.said_s, self._news = now, np.sort(self._row[self._changed])
        if len(self._news):
            run = _run(self._news, AT_ONCE_ROWS)
            self._news = self._news[len(run) :]
            return self._published(run)
        if hurried or (in_turn and now - self._sliced_s >= SAY_S):
            rows = self.known()
            if len(rows):
                self._sliced_s = now
                rest = rows[rows >= self._turn]
                run = _run(rest if len(rest) else rows, AT_ONCE_ROWS if hurried else SLICE_ROWS)
                self._turn = int(run[-1]) + 1
                self._hurried = max(0, self._hurried - len(run))
                return self._published(run)
        return 0, np.empty((0, COLUMNS), np.int16)

    def known(self) -> Rows:
        """The rows that there are, in order."""
        return np.sort(self._row[self._row != NOTHING])

    def cells(self, rows: Rows) -> NDArray[np.int16]:
        """(R, COLUMNS) of rows (R,), UNSEEN where nothing is."""
        at = rows % len(self._row)
        stale = at[self._stale[at]]
        if len(stale):
            self._medians[stale] = medians(self._votes[stale])
            self._stale[stale] = False
        there: BoolArray = self._row[at] == rows
        return np.asarray(np.where(there[:, None], self._medians[at], UNSEEN), np.int16)

    def _published(self, run: Rows) -> tuple[int, NDArray[np.int16]]:
        """From the first to the last of these rows, the holes between them too."""
        rows = np.arange(run[0], run[-1] + 1)
        at = rows % len(self._row)
        self._changed[at[self._row[at] == rows]] = False
        return int(run[0]), self.cells(rows)

    def _empty(self, places: Rows, rows: Rows) -> None:
        self._votes[places] = UNSEEN
        self._row[places] = rows

    def _double(self) -> None:
        """Rows of twice the length: a ring's vote is the mean of its two, where it had two."""
        rows = self.known()
        votes = self._votes[rows % len(self._row)]
        self._votes.fill(UNSEEN)
        self._row.fill(NOTHING)
        self.step_mm *= 2.0
        for half in (rows % 2 == 0, rows % 2 == 1):
            row, new = rows[half] >> 1, votes[half]
            at = row % len(self._row)
            old = self._votes[at]
            both = (old.astype(np.int32) + new) >> 1
            self._votes[at] = np.where(old == UNSEEN, new, np.where(new == UNSEEN, old, both)).astype(np.int16)
            self._row[at] = row
        self._stale[:] = self._changed[:] = self._row != NOTHING
        self.anew()


def _run(rows: Rows, most: int) -> Rows:
    """The first of rows (R,), in order, that go in one word of at most so many, with holes of HOLE_ROWS at most: a head
    that is fast leaves some. Who has rows where a hole is said has them of a publisher that died.
    """
    some = rows[rows < rows[0] + most]
    ends: Rows = np.flatnonzero(np.diff(some, append=some[-1] + 2 * most + HOLE_ROWS + 2) > HOLE_ROWS + 1)
    run: Rows = some[: 1 + int(ends[0])]
    return run


def medians(votes: NDArray[np.int16]) -> NDArray[np.int16]:
    """(..) the median of votes (.., K), UNSEEN ones passed over; of an even number the mean of the middle two."""
    count = np.count_nonzero(votes != UNSEEN, axis=-1)
    ordered = np.sort(votes, axis=-1)  # what is unseen comes first
    missing = votes.shape[-1] - count
    low, high = missing + (np.maximum(count, 1) - 1) // 2, missing + count // 2
    low, high = (np.minimum(one, votes.shape[-1] - 1)[..., None] for one in (low, high))
    middle = (
        np.take_along_axis(ordered, low, -1)[..., 0].astype(np.int32) + np.take_along_axis(ordered, high, -1)[..., 0]
    ) >> 1
    return np.where(count > 0, middle, UNSEEN).astype(np.int16)
