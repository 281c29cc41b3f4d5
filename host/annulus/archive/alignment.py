"""Two maps of one pipe laid over each other: for every row of the second its place on the first, and its roll.

Coarse from whereabouts, then row by row: the cheapest chain of places, then of rolls, then of finer places, each with
slips allowed, and at last both smoothed between slips as a cable and a head move (a random walk), which also gives
what they may be off. The first map is the frame: its z, its clock.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter1d, median_filter

from annulus.archive.chain import joined, likeliest, row_costs
from annulus.archive.detail import COLUMNS, Detail, believed, detail_of, smoothed
from annulus.archive.wall_map import WallMap
from annulus.archive.whereabouts import STRETCH_MM, Stretch, find
from annulus.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus.numeric.robust import robust_sigma
from annulus.vocabulary import AnnulusError

RADII_ALIKE = 0.1  # of the radius: by more two nominal radii are not of one pipe
COARSE_MM, FINE_MM, NEAR_MM = 2.0, 0.5, 16.0  # steps and reach of the chains of places
ABOUT_MM, FAR_MM, OUTSIDE = 24.0, 60.0, 100.0  # reach beside stretches that were found, without any; cost beyond
STATES_MAX = 600
ROLL_STEP_DEG, ROLL_NEAR_DEG, ROLL_FREE_DEG = 0.25, 4.0, 10.0
STEP_COST, SLIP_COST, TURN_COST = 3.0, 24.0, 16.0  # of log-likelihood: a slip shorter than 2 mm is no slip but drift
SLIP_MM = 2.5  # from which on it counts as a slip; ..
SCALE_MM = 1000.0  # over which the cable's scale is measured
SLIP_ROWS, SLIP_ROWS_MAX, SLIP_SURE = 3, 400, 5.0  # beside a slip that may be of either side; log-likelihood
STAYS_MM = 60.0  # .. before and after which it must stay so long
JUMP_DEG = 0.7
CABLE_MM, HEAD_DEG = 1.0, 0.3  # random walk a root of a metre: cable beside its scale, head beside its sensor
HEAD_FREE_DEG = 4.0  # .. of a head whose roll no sensor said
OVAL_MM, OVAL_ALIKE_MM = 0.03, 400.0  # of ovality between years; over which its error is alike
IMU_DEG, IMU_ALIKE_MM = 0.15, 400.0
MISFIT = 1.5  # by which errors are larger than the costs say: neighbouring cells are alike
CALM = 1.0  # sigma of the smoothing of both, rows and columns: blurs both alike, and noise to a quarter
ALIKE_CELLS = 4 * math.pi * CALM**2  # .. after which so many say one thing
ROUNDS = 3
DRIFT_Z, ALONE_MM = (
    0.005,
    200.0,
)  # mm a mm that a cable may be off between rows that know where they are; so far it is not
SURE, SHIFTS = 8.0, 24  # sigma by which the detail must agree better here than turned elsewhere
STRETCHES_MIN, GAIN_MIN = 1, 20.0


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where the second's rows lie on the first.

    z_mm, roll_deg (Z2,): column c of row i lies at z_mm[i], clock c + roll_deg[i] of the first; NaN where the first has
    no row. sigma_z_mm, sigma_roll_deg (Z2,), k = 1. slips: rows before which the cable slipped. scale: mm of the first
    a mm of the second, between slips. reversed: the second's head went the other way, its rows are counted from the far
    end and its clock runs the other way: column c lies at roll_deg - c. sure: sigma by which the wall's detail agrees.
    """

    z_mm: FloatArray
    roll_deg: FloatArray
    sigma_z_mm: FloatArray
    sigma_roll_deg: FloatArray
    slips: tuple[int, ...]
    scale: float
    reversed: bool
    sure: float
    noise_mm: float


def align(
    first: WallMap, second: WallMap, progress: Callable[[str, int, int], None] = lambda what, done, total: None
) -> Alignment:
    """The second map on the first. AnnulusError where they do not belong together."""
    if abs(first.radius_mm / second.radius_mm - 1) > RADII_ALIKE:
        raise AnnulusError(
            f"{second.name}: is of a pipe of radius {second.radius_mm:.1f} mm, {first.name} of {first.radius_mm:.1f} "
            "mm. Expected two scans of one pipe."
        )
    columns = min(COLUMNS, first.deviation_mm.shape[1], second.deviation_mm.shape[1])
    mine = detail_of(first, columns)
    best: tuple[float, WallMap, Detail, list[Stretch]] | None = None
    turned = False
    for way in (False, True):
        wall = second.turned_about() if way else second
        theirs = detail_of(wall, columns)
        found = find(first, wall, (mine, theirs), lambda done, total: progress("looking for places", done, total))
        gain = sum(one.gain for one in found)
        if best is None or gain > best[0]:
            best, turned = (gain, wall, theirs, found), way
        if 2 * len(found) * 500.0 > len(wall.deviation_mm) * wall.step_mm:
            break
    assert best is not None
    gain, wall, theirs, found = best
    if len(found) < STRETCHES_MIN or gain < GAIN_MIN:
        raise AnnulusError(_strangers(first, second))
    laid = _Laying(first, wall, mine, theirs, found, progress).done()
    if not laid.sure >= SURE:
        raise AnnulusError(_strangers(first, second))
    if not turned:
        return laid
    rows = len(laid.z_mm)
    return Alignment(
        laid.z_mm[::-1].copy(), laid.roll_deg[::-1].copy(), laid.sigma_z_mm[::-1].copy(),
        laid.sigma_roll_deg[::-1].copy(), tuple(sorted(rows - row for row in laid.slips)), laid.scale, True, laid.sure,
        laid.noise_mm,
    )  # fmt: skip


def _strangers(first: WallMap, second: WallMap) -> str:
    return (
        f"{second.name}: does not match {first.name}: no stretch of its wall is found there, either way along. "
        "Expected two scans of one pipe that overlap by a metre or more, with texture, ovality or defects to go by."
    )


class _Laying:
    """The state of one alignment while it is refined: places and rolls of all rows of the second."""

    def __init__(
        self, first: WallMap, second: WallMap, mine: Detail, theirs: Detail, found: list[Stretch],
        progress: Callable[[str, int, int], None],
    ) -> None:  # fmt: skip
        self.first, self.second, self.mine, self.theirs = first, second, mine, theirs
        self.progress = progress
        self.calm: Float32Array = believed(smoothed(mine.own, (CALM, CALM)), mine.own, ALIKE_CELLS)
        self.theirs_calm: Float32Array = smoothed(theirs.own, (CALM, CALM))
        self.columns = mine.own.shape[1]
        self.z = second.z_mm
        own, place, roll, _ = np.array([[s.z_mm, s.first_mm, s.roll_deg, s.gain] for s in found]).T
        slope = _slope(own, place)
        beside = place - slope * own
        self.scale = slope
        self.place = slope * self.z + np.interp(self.z, own, beside)
        near = np.abs(self.z[:, None] - own[None]) <= STRETCH_MM
        alone = ~near.any(axis=1)
        line = np.interp(self.z, own, beside)
        self.low = np.where(alone, line, np.where(near, beside[None], np.inf).min(axis=1)) - np.where(
            alone, FAR_MM, ABOUT_MM
        )
        self.high = np.where(alone, line, np.where(near, beside[None], -np.inf).max(axis=1)) + np.where(
            alone, FAR_MM, ABOUT_MM
        )
        self.beside = np.interp(self.z, own, beside)
        self.with_sensor = mine.roll_deg is not None and theirs.roll_deg is not None
        turn = np.unwrap(roll, period=360.0)
        if self.with_sensor:
            turn = np.full(len(turn), float(np.median(turn)))
        self.sensor = np.interp(self.z, own, turn)
        if self.with_sensor:
            assert theirs.roll_deg is not None
            self.sensor = self.sensor + theirs.roll_deg - self._firsts_roll()
        self.roll = self.sensor
        self.slips: BoolArray = np.zeros(len(self.z), bool)  # before this row
        self.jumps: BoolArray = np.zeros(len(self.z), bool)
        self.sigma = robust_sigma(np.asarray(self.theirs_calm[np.isfinite(self.theirs_calm)], np.float64))

    def done(self) -> Alignment:
        steps = 5 + ROUNDS

        def at(k: int) -> None:
            self.progress("laying them together", k, steps)

        at(0)
        base = self.place - self.beside
        self._chain_of_places(base, self.low, self.high, COARSE_MM)
        at(1)
        self._chain_of_rolls()
        at(2)
        self.sigma = max(robust_sigma(self._left().ravel()), 1e-4)
        near = np.full(len(self.z), NEAR_MM)
        self._chain_of_places(self._evened(), -near, near, FINE_MM)
        self.place = self._evened()
        self.slips = self._slips()
        at(3)
        self._chain_of_rolls()
        at(4)
        for k in range(ROUNDS):
            sigma_z = self._smooth_places()
            sigma_roll = self._smooth_rolls()
            at(5 + k)
        self.sigma = max(robust_sigma(self._left().ravel()), 1e-4)
        sigma_z = np.hypot(sigma_z, self._unsure())
        inside = (self._row() >= 0) & (self._row() <= len(self.first.deviation_mm) - 1)
        z = np.where(inside, self.place, np.nan)
        seen = np.isfinite(self.theirs.own).any(axis=1)
        rows = np.flatnonzero(inside & seen)
        at(steps)
        return Alignment(
            z,
            np.where(inside, (self.roll + 180.0) % 360.0 - 180.0, np.nan),
            np.where(inside, sigma_z, np.nan),
            np.where(inside, sigma_roll, np.nan),
            tuple(int(row) for row in np.flatnonzero(self.slips)),
            self.scale,
            False,
            self._sure() if len(rows) >= 8 else 0.0,
            self.sigma,
        )

    def _firsts_roll(self) -> FloatArray:
        assert self.mine.roll_deg is not None
        return np.asarray(np.interp(self.place, self.first.z_mm, self.mine.roll_deg))

    def _row(self) -> FloatArray:
        return np.asarray((self.place - self.first.first_mm) / self.first.step_mm)

    def _costs(self, places: FloatArray, rolls: FloatArray) -> FloatArray:
        """(Z, K) of each row, less what its cells cost anywhere, so that cells that were not seen neither draw nor
        repel."""
        row_at = (places - self.first.first_mm) / self.first.step_mm
        rows = len(self.first.deviation_mm)
        edge = (row_at > rows - 1 - 1e-6) & (row_at < rows - 1 + 0.5)
        row_at = np.where(edge, rows - 1 - 1e-6, np.where((row_at < 0) & (row_at > -0.5), 0.0, row_at))
        cost, count = row_costs(
            self.theirs_calm, self.calm, *(row_at + 0 * rolls, rolls * self.columns / 360.0 + 0 * row_at), self.sigma
        )
        usual = cost.sum(axis=1, keepdims=True) / np.maximum(count.sum(axis=1, keepdims=True), 1.0)
        return np.asarray((cost - count * usual) / ALIKE_CELLS)

    def _chain_of_places(self, base: FloatArray, low: FloatArray, high: FloatArray, step: float) -> None:
        """low, high (Z,) mm beside base, between which a row lies: else a chain slips away from what is new or gone."""
        least, most = float(low.min()), float(high.max())
        step *= max(1.0, (most - least) / step / STATES_MAX)
        offsets = np.arange(least, most + step / 2, step)
        cost = self._costs(base[:, None] + offsets[None], self.roll[:, None])
        cost[(offsets[None] < low[:, None] - step) | (offsets[None] > high[:, None] + step)] += OUTSIDE
        chain = likeliest(cost, STEP_COST * step / FINE_MM / 4 + STEP_COST / 2, SLIP_COST)
        moved = offsets[chain]
        self.place = base + moved

    def _evened(self) -> FloatArray:
        """(Z,) the places without their steps, and the cable's scale from stretches that slips leave alone."""
        rows = min(max(round(SCALE_MM / self.second.step_mm), 8), len(self.place) // 2)
        slopes = np.sort((self.place[rows:] - self.place[:-rows]) / (rows * self.second.step_mm))
        self.scale = float(slopes[len(slopes) // 5 : -(len(slopes) // 5) or None].mean())
        even = self.scale * self.second.step_mm * np.arange(len(self.place))
        half = max(round(STAYS_MM / self.second.step_mm), 3)
        return np.asarray(even + median_filter(self.place - even, 2 * half + 1, mode="nearest"))

    def _slips(self) -> BoolArray:
        """Rows before which the place leaps and stays so: what leaps and comes back is a misfit."""
        beside = self.place - self.scale * self.second.step_mm * np.arange(len(self.place))
        rows = min(max(round(STAYS_MM / self.second.step_mm), 3), len(beside) // 4)
        middle = np.median(sliding_window_view(beside, rows), axis=1)
        leap = np.zeros(len(beside))
        leap[rows : len(beside) - rows + 1] = np.abs(middle[rows:] - middle[:-rows])
        at_once = np.zeros(len(beside))
        at_once[SLIP_ROWS : -SLIP_ROWS + 1] = np.abs(beside[2 * SLIP_ROWS - 1 :] - beside[: -2 * SLIP_ROWS + 1])
        step = np.abs(np.diff(beside, prepend=beside[0]))
        leap = np.where(at_once > 0.6 * leap, leap, 0.0)
        out = np.zeros(len(beside), bool)
        while leap.max() > SLIP_MM:
            i = int(np.argmax(leap))
            near = slice(max(i - SLIP_ROWS, 0), i + SLIP_ROWS + 1)
            out[near.start + int(np.argmax(step[near]))] = True
            leap[max(i - rows, 0) : i + rows + 1] = 0.0
        out[0] = False
        return out

    def _unsure(self) -> FloatArray:
        """(Z,) mm by which rows beside a slip may be off, as far as they fit either side of it."""
        out, rows = np.zeros(len(self.place)), np.flatnonzero(self.slips)
        if not len(rows):
            return out
        leaps = self.place[rows] - self.place[rows - 1] - self.scale * self.second.step_mm
        every = np.arange(len(out))
        middles = (rows[1:] + rows[:-1]) // 2
        mine = np.searchsorted(middles, every, side="right")
        other = self.place + np.where(every < rows[mine], leaps[mine], -leaps[mine])
        costs = self._costs(np.stack([self.place, other], axis=1), self.roll[:, None])
        against = costs[:, 1] - costs[:, 0]
        for k, row in enumerate(rows):
            for side in (every[row:][:SLIP_ROWS_MAX], every[:row][::-1][:SLIP_ROWS_MAX]):
                sure = np.flatnonzero(np.cumsum(against[side]) > SLIP_SURE)
                reach = max(int(sure[0]) if len(sure) else len(side), 1)
                out[side[:reach]] = np.maximum(out[side[:reach]], abs(leaps[k]) / 2)
        return out

    def _chain_of_rolls(self) -> None:
        reach = ROLL_NEAR_DEG if self.with_sensor else ROLL_FREE_DEG
        rolls = np.arange(-reach, reach + ROLL_STEP_DEG / 2, ROLL_STEP_DEG)
        cost = self._costs(self.place[:, None], self.sensor[:, None] + rolls[None]) + self._oval_cost(
            self.sensor[:, None] + rolls[None]
        )
        chain = likeliest(cost, STEP_COST, TURN_COST)
        self.roll = self.sensor + rolls[chain]
        self.jumps = np.abs(np.diff(rolls[chain], prepend=rolls[chain[0]])) > JUMP_DEG

    def _oval_cost(self, rolls: FloatArray) -> FloatArray:
        mine = np.interp(self.place, self.first.z_mm, self.mine.oval.real) + 1j * np.interp(
            self.place, self.first.z_mm, self.mine.oval.imag
        )
        inside = (self._row() >= 0) & (self._row() <= len(self.first.deviation_mm) - 1)
        off = np.abs(self.theirs.oval[:, None] - mine[:, None] * np.exp(2j * np.radians(rolls))) ** 2
        share = self.second.step_mm / OVAL_ALIKE_MM
        return np.asarray(np.where(inside[:, None], 0.5 * share * np.minimum(off / OVAL_MM**2, 9.0), 0.0))

    def _smooth_places(self) -> FloatArray:
        h = 0.4 * self.first.step_mm
        costs = self._costs(self.place[:, None] + np.array([-h, 0.0, h])[None], self.roll[:, None])
        even = self.scale * self.second.step_mm * np.arange(len(self.z))
        tie = np.where(self.slips[1:], 0.0, 1000.0 / (CABLE_MM**2 * self.second.step_mm))
        moved, sigma = self._newton(costs, h, self.place - even, tie, DRIFT_Z)
        self.place = self.place + np.clip(moved, -2.0, 2.0)
        return sigma

    def _smooth_rolls(self) -> FloatArray:
        h = 0.4 * 360.0 / self.columns
        at = self.roll[:, None] + np.array([-h, 0.0, h])[None]
        costs = self._costs(self.place[:, None], at) + self._oval_cost(at)
        walk = HEAD_DEG if self.with_sensor else HEAD_FREE_DEG
        tie = np.where(self.jumps[1:], 0.0, 1000.0 / (walk**2 * self.second.step_mm))
        moved, sigma = self._newton(costs, h, self.roll - self.sensor, tie, 0.0)
        self.roll = self.roll + np.clip(moved, -2.0, 2.0)
        return sigma

    def _newton(
        self, costs: FloatArray, h: float, now: FloatArray, tie: FloatArray, drift: float
    ) -> tuple[FloatArray, FloatArray]:
        """One step towards the least of all rows' costs and of a random walk of `now`; and what is left unknown."""
        pull = -(costs[:, 2] - costs[:, 0]) / (2 * h)
        bent = (costs[:, 2] - 2 * costs[:, 1] + costs[:, 0]) / h**2
        weight = np.maximum(gaussian_filter1d(bent, 10.0, mode="nearest"), 0.0)
        held = np.zeros(len(now))
        gap = np.diff(now) * tie
        held[:-1] += gap
        held[1:] -= gap
        moved, variance = joined(weight, pull + held, tie)
        return moved, MISFIT * np.sqrt(variance + np.square(self._lost(weight, drift)))

    def _lost(self, weight: FloatArray, drift: float) -> FloatArray:
        """(Z,) how far a row may have drifted from the nearest that knows where it is; drift: a mm."""
        known = np.flatnonzero(weight > 0.2 * np.percentile(weight, 95))
        if not len(known):
            return np.full(len(weight), np.inf)
        rows = np.arange(len(weight))
        k = np.clip(np.searchsorted(known, rows), 1, max(len(known) - 1, 1))
        near = np.minimum(np.abs(rows - known[k - 1]), np.abs(rows - known[np.minimum(k, len(known) - 1)]))
        return np.asarray(drift * np.maximum(near * self.second.step_mm - ALONE_MM, 0.0))

    def _left(self) -> FloatArray:
        """Differences of seen cells, (n,) mm."""
        return self._pairs(0.0)[0]

    def _pairs(self, turned_deg: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Differences, and the plain detail of the second and of the first in the same cells, all (n,) mm."""
        row = np.rint(self._row()).astype(np.int64)
        inside = np.flatnonzero((row >= 0) & (row < len(self.calm)))
        shift = np.rint((self.roll[inside] + turned_deg) * self.columns / 360.0).astype(np.int64)
        take = (np.arange(self.columns)[None] + shift[:, None]) % self.columns
        a = self.theirs_calm[inside] - np.take_along_axis(self.calm[row[inside]], take, axis=1)
        b = self.theirs.plain[inside]
        c = np.take_along_axis(self.mine.plain[row[inside]], take, axis=1)
        seen = np.isfinite(a) & np.isfinite(b) & np.isfinite(c)
        return a[seen].astype(np.float64), b[seen].astype(np.float64), c[seen].astype(np.float64)

    def _sure(self) -> float:
        """Sigma by which both maps' detail agrees better as laid than turned elsewhere."""
        alike = []
        for k in range(SHIFTS):
            _, one, other = self._pairs(0.0 if k == 0 else 30.0 + 300.0 * (k - 1) / (SHIFTS - 2))
            cut = 3 * max(robust_sigma(one), robust_sigma(other), 1e-6) if len(one) else 1.0
            one, other = np.clip(one, -cut, cut), np.clip(other, -cut, cut)
            alike.append(float(np.mean(one * other) / max(np.sqrt(np.mean(one**2) * np.mean(other**2)), 1e-12)))
        rest = np.array(alike[1:])
        return float((alike[0] - rest.mean()) / max(rest.std(ddof=1), 1e-9))


def _slope(x: FloatArray, y: FloatArray) -> float:
    """The median of slopes between far points; 1 where there are too few."""
    if len(x) < 4:
        return 1.0
    i, j = np.triu_indices(len(x), max(len(x) // 4, 1))
    return float(np.clip(np.median((y[j] - y[i]) / (x[j] - x[i])), 0.9, 1.1))
