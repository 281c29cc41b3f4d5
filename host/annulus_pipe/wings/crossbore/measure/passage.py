"""A capacitive log of what sensors said each at its own time: readings, places, roll, and where the head was.

    passage = Passage()
    passage.place(t_s, z_mm); passage.roll(t_s, roll_deg); passage.read(t_s, (c1, c2, c3, reference))
    for run in passage.runs(): detect(on_grid(run.log))

Where the odometer was zeroed, or a controller restarted, places jump: a run ends there, and another begins.
"""

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.wings.crossbore.measure.grid import ROWS_MIN, SPAN_MM, Log
from annulus_pipe.wings.crossbore.measure.readings import SECTORS

JUMP_MM, JUMP_MM_S = 20.0, 1000.0  # faster than any winch
APART_S = 0.6  # two places or rolls further apart say nothing of what is between; an odometer says one each 0.2 s
PF_MAX, Z_MAX_MM, ROLL_MAX_DEG = 1000.0, 1e8, 1e6  # what is beyond is no reading
KEPT_MAX = 20_000  # of each kind, of a head that stands still
OFFSETS_APART_MM = 60.0  # .. and two places of the head off the axis


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """rolled : (N,) whether the head's roll was known; without it a direction says nothing of the pipe."""

    log: Log
    rolled: BoolArray

    def rolled_at(self, odometer_mm: float) -> bool:
        return bool(self.rolled[int(np.argmin(np.abs(self.log.odometer_mm - odometer_mm)))])


class Passage:
    """ahead_mm : the sectors' middle, ahead of the odometer's zero. keep_mm : of pipe, of late; None: all of it.

    A row without a place is left out. All times are seconds of one clock, rising for each kind.
    """

    def __init__(self, ahead_mm: float = 0.0, keep_mm: float | None = None) -> None:
        self._ahead, self._keep = ahead_mm, keep_mm
        most = None if keep_mm is None else KEPT_MAX
        self._rows: deque[tuple[float, ...]] = deque(maxlen=most)  # t, c1..c3, reference, loss1..loss3
        self._places: deque[tuple[float, float]] = deque(maxlen=most)
        self._rolls: deque[tuple[float, float]] = deque(maxlen=most)
        self._offs: deque[tuple[float, float, float]] = deque(maxlen=most)  # odometer, x, y

    def read(self, t_s: float, c_pf: Sequence[float], loss_ff: Sequence[float] = ()) -> None:
        """c_pf : the three sectors and the reference, NaN for one that failed."""
        numbers = (value if abs(value) <= PF_MAX else math.nan for value in c_pf)  # which are readings the grid knows
        self._rows.append((t_s, *numbers, *(loss_ff or (math.nan,) * SECTORS)))

    def place(self, t_s: float, z_mm: float) -> None:
        if not abs(z_mm) < Z_MAX_MM:
            return
        self._places.append((t_s, z_mm))
        if self._keep is None:
            return
        while abs(z_mm - self._places[0][1]) > self._keep:
            self._places.popleft()
        for track in (self._rows, self._rolls):
            while track and track[0][0] < self._places[0][0]:
                track.popleft()

    def roll(self, t_s: float, roll_deg: float) -> None:
        """Clockwise, looking ahead."""
        if abs(roll_deg) < ROLL_MAX_DEG:
            self._rolls.append((t_s, roll_deg))

    def off(self, z_mm: float, x_mm: float, y_mm: float) -> None:
        """How far off the pipe's axis the sectors' middle was when the odometer said z_mm; x right, y down."""
        self._offs.append((z_mm, x_mm, y_mm))

    def __len__(self) -> int:
        return len(self._rows)

    def runs(self) -> list[Run]:
        """Those long enough to be judged: with more than half of their readings sound."""
        if len(self._rows) < ROWS_MIN or len(self._places) < 2:
            return []
        rows, places = _in_time(self._rows), _in_time(self._places)
        dt, dz = np.diff(places[:, 0]), np.diff(places[:, 1])
        cuts = np.flatnonzero(np.abs(dz) > JUMP_MM + JUMP_MM_S * dt) + 1
        runs = (self._run(rows, part) for part in np.split(places, cuts))
        return [run for run in runs if run is not None]

    def _run(self, rows: FloatArray, places: FloatArray) -> Run | None:
        if len(places) < 2:
            return None
        z = _between(rows[:, 0], places)
        placed = np.isfinite(z)
        sound = placed & (rows[:, 1:5] > 0).all(axis=1)
        if np.count_nonzero(sound) < max(ROWS_MIN, 0.5 * np.count_nonzero(placed)):
            return None
        rows, z = rows[placed], z[placed]
        if not SPAN_MM[0] <= np.ptp(z) <= SPAN_MM[1]:
            return None
        roll, rolled = np.zeros(len(rows)), np.zeros(len(rows), bool)
        if len(self._rolls) > 1:
            rolls = _in_time(self._rolls)
            rolls[:, 1] = np.unwrap(rolls[:, 1], period=360.0)
            rolled = np.isfinite(_between(rows[:, 0], rolls))
            roll = np.interp(rows[:, 0], rolls[:, 0], rolls[:, 1])
        loss = rows[:, 5:8] if np.isfinite(rows[:, 5:8]).all(axis=1).mean() > 0.5 else None
        off = _off(z, np.array(self._offs)) if len(self._offs) > 1 else None
        return Run(Log(rows[:, 0], z + self._ahead, rows[:, 1:4], rows[:, 4], roll, loss, off), rolled)


def _in_time(readings: Iterable[tuple[float, ...]]) -> FloatArray:
    """Readings of one kind from several sensors, in the order of their times."""
    table = np.array(list(readings))
    return np.asarray(table[np.argsort(table[:, 0], kind="stable")])


def _between(at: FloatArray, readings: FloatArray) -> FloatArray:
    """NaN before the first, after the last, and where two lie too far apart. readings : (N, 2) time, value."""
    after = np.clip(np.searchsorted(readings[:, 0], at), 1, len(readings) - 1)
    gap = readings[after, 0] - readings[after - 1, 0]
    known = (at >= readings[0, 0]) & (at <= readings[-1, 0]) & (gap <= APART_S)
    return np.where(known, np.interp(at, readings[:, 0], readings[:, 1]), np.nan)


def _off(z: FloatArray, offsets: FloatArray) -> FloatArray | None:
    """(N, 2) where the head was known all along; None where for more than a tenth it was not."""
    line = offsets[np.argsort(offsets[:, 0], kind="stable")]
    after = np.clip(np.searchsorted(line[:, 0], z), 1, len(line) - 1)
    known = line[after, 0] - line[after - 1, 0] <= OFFSETS_APART_MM
    if known.mean() < 0.9:
        return None
    return np.stack([np.interp(z, line[:, 0], line[:, k]) for k in (1, 2)], axis=1)
