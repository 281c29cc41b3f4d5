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

from annulus_pipe.archive.chain import believed_states, joined, likeliest, row_costs
from annulus_pipe.archive.detail import COLUMNS, Detail, believed, detail_of, smoothed
from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.archive.whereabouts import SCALE, STRETCH_MM, MatchedStretch, find
from annulus_pipe.numeric.arrays import BoolArray, ComplexArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError

# Guarded as a whole by tests/unit/archive/test_compare.py and the benchmark `archive`, topic growth. Most were tried at
# a quarter and at four times their value on four pairs of that file: where one of its tests fails then, it is named.
RADII_ALIKE = 0.1  # of the radius: by more two nominal radii are not of one pipe; test_pipes_of_two_sizes_do_not_match

# Chains of places: what is tried for each row, and what a chain pays.
COARSE_MM = 2.0  # from place to place in the first chains: a twelfth of what texture is alike over
FINE_MM = 0.5  # .. and in the last, before places are smoothed; finer, test_a_bare_pipe.. has growth that is made up
NEAR_MM = 16.0  # reach of the last chain beside the one before: eight of its steps
ABOUT_MM = 24.0  # reach beside stretches that were found: their bins and what a cable strays by in a metre
FAR_MM = 60.0  # .. and where there are none: slips that nobody saw
OUTSIDE = 100.0  # log-likelihood beyond that reach: no row's detail buys it
STATES_MAX = 600  # places tried for a row: bounds time and memory; with more the steps are longer
STEP_COST = 3.0  # log-likelihood of a step to the next place or roll; dearer, test_a_bare_pipe..
SLIP_COST = 24.0  # .. of a leap of the place: a slip shorter than 2 mm is no slip but drift
TURN_COST = 16.0  # .. of a leap of the roll: a head may jerk, and rows with little detail must not
GONE_COST = 0.05  # .. at most, a mm: what is gone, or new, is no reason to be elsewhere; what is still there is

# Rolls
ROLL_STEP_DEG = 0.25  # from roll to roll in their chain: an eighth of a column
ROLL_NEAR_DEG = 4.0  # reach beside what both sensors say ..
ROLL_FREE_DEG = 10.0  # .. and beside stretches, where one has none
JUMP_DEG = 0.7  # from row to row, from which on a head jumped: the smoothing does not tie these rows together

# Slips: where the place leaps and stays so
SLIP_MM = 2.5  # from which on it counts as one
SLIP_ROWS = 3  # over which it takes place
STAYS_MM = 60.0  # .. before and after which it must stay so long: what comes back is a misfit

# The cable's scale, of pairs of rows that were found again
KNOWN = 1.0  # log-likelihood by which a row was found again
KNOWN_MOST = 400  # rows asked: 80 000 pairs; bounds time
KNOWN_LEAST = 10  # pairs: fewer say no scale
APART_MM = (300.0, 2000.0)  # that the two lie apart: nearer their places say it badly, farther a slip lies between
AGREE_MM = 1.0  # by which two rows without a slip between them are off

# Smoothing, and what places and rolls may be off
CABLE_MM = 1.0  # a root of a metre: random walk of a cable beside its scale
HEAD_DEG = 0.3  # a root of a metre: random walk of a head's roll beside its sensor
HEAD_FREE_DEG = 4.0  # .. of a head whose roll no sensor said
ROUNDS = 3  # of Newton's steps: places and rolls have then settled; with one, test_what_is_said_of_places..
MISFIT = 1.5  # by which errors are larger than the costs say: neighbours are alike; less, test_what_is_said_of_places..
# Sigma of the smoothing of both, rows and columns: blurs both alike, and noise to a quarter. Less,
# test_rows_find_their_place..
CALM = 1.0
ALIKE_CELLS = 4 * math.pi * CALM**2  # .. after which so many say one thing
SLIPS_A_M = 0.25  # slips that nothing shows, a metre ..
SLIP_USUAL_MM = 12.0  # .. and how far: likelihood falls off with it
ASTRAY_MM = 60.0  # as far as a row may lie from where it was put
BARE = 0.5  # share of rows found again below which a wall is bare ..
# .. and its places may be off by so much more: its defects' growth misleads. Less, test_a_bare_pipe..
BARE_MISFIT = 1.5

# Ovality, which says where a row lies as far as it did not change in years
OVAL_MM = 0.03  # what it differs by between years, until that is measured
OVAL_LEAST_MM = 0.002  # .. at least: rounding
OVAL_ALIKE_MM = 240.0  # along the pipe: over which its error is alike, at least; its median's length
OVAL_FAR_MM = 4000.0  # .. as far as that is looked for; bounds time
OVAL_CUT = 25.0  # sigma squared: what it says against a place at most, for it may have changed there

# Whether these are two scans of one pipe
STRETCHES_MIN = 1  # stretches of the second found on the first
GAIN_MIN = 20.0  # log-likelihood over chance, of all of them
SURE = 8.0  # sigma by which the detail must agree better as laid than turned elsewhere; more, every test that aligns
SHIFTS = 24  # turns elsewhere that this is held against
_CHUNK = 4096  # rows at once; bounds memory


@dataclass(frozen=True, slots=True)
class Alignment:
    """Where the second's rows lie on the first.

    z_mm, roll_deg (Z2,): column c of row i lies at z_mm[i], clock c + roll_deg[i] of the first; NaN where the first has
    no row. sigma_z_mm, sigma_roll_deg (Z2,), k = 1. slips: rows before which the cable slipped. scale: mm of the first
    a mm of the second, between slips. reversed: the second's head went the other way, its rows are counted from the far
    end and its clock runs the other way: column c lies at roll_deg - c. sure: sigma by which the wall's detail agrees.
    found: the share of rows that were found again by their own detail; of a bare pipe few.
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
    found: float


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
    best: tuple[float, WallMap, Detail, list[MatchedStretch]] | None = None
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
        laid.z_mm[::-1].copy(),
        laid.roll_deg[::-1].copy(),
        laid.sigma_z_mm[::-1].copy(),
        laid.sigma_roll_deg[::-1].copy(),
        tuple(sorted(rows - row for row in laid.slips)),
        laid.scale,
        True,
        laid.sure,
        laid.noise_mm,
        laid.found,
    )


def _strangers(first: WallMap, second: WallMap) -> str:
    return (
        f"{second.name}: does not match {first.name}: no stretch of its wall is found there, either way along. "
        "Expected two scans of one pipe that overlap by a metre or more, with texture, ovality or defects to go by."
    )


class _Laying:
    """The state of one alignment while it is refined: places and rolls of all rows of the second."""

    def __init__(
        self,
        first: WallMap,
        second: WallMap,
        mine: Detail,
        theirs: Detail,
        found: list[MatchedStretch],
        progress: Callable[[str, int, int], None],
    ) -> None:
        self.first, self.second, self.mine, self.theirs = first, second, mine, theirs
        self.progress = progress
        self.calm: Float32Array = believed(smoothed(mine.own, (CALM, CALM)), mine.own, ALIKE_CELLS)
        self.theirs_calm: Float32Array = smoothed(theirs.own, (CALM, CALM))
        self.columns = mine.own.shape[1]
        self.z = second.z_mm
        own, place, roll, _ = np.array([[s.z_mm, s.first_mm, s.roll_deg, s.gain] for s in found]).T
        self.stretches: tuple[FloatArray, FloatArray] = own, place
        self.scale = _slope(own, place)
        self.place: FloatArray = self.scale * self.z + np.interp(self.z, own, place - self.scale * own)
        self.with_sensor = mine.roll_deg is not None and theirs.roll_deg is not None
        turn = np.unwrap(roll, period=360.0)
        if self.with_sensor:
            turn = np.full(len(turn), float(np.median(turn)))
        self.sensor = np.interp(self.z, own, turn)
        if self.with_sensor:
            assert theirs.roll_deg is not None
            self.sensor = self.sensor + theirs.roll_deg - self._firsts_roll()
        self.roll = self.sensor
        self.oval_mm, self.oval_alike_mm = OVAL_MM, OVAL_ALIKE_MM
        self.slips: BoolArray = np.zeros(len(self.z), bool)  # before this row
        self.jumps: BoolArray = np.zeros(len(self.z), bool)
        self.sigma = robust_sigma(np.asarray(self.theirs_calm[np.isfinite(self.theirs_calm)], np.float64))

    def done(self) -> Alignment:
        steps = 5 + ROUNDS

        def at(k: int) -> None:
            self.progress("laying them together", k, steps)

        at(0)
        self._measure_ovality()
        self._chain_of_places(*self._by_stretches(), COARSE_MM)
        at(1)
        self._chain_of_rolls()
        self._measure_scale()
        self._measure_ovality()
        self._chain_of_places(*self._by_stretches(), COARSE_MM)
        self._measure_scale()
        at(2)
        self._measure_ovality()
        self.sigma = max(robust_sigma(self._left().ravel()), 1e-4)
        near = np.full(len(self.z), NEAR_MM)
        self._chain_of_places(self._evened(), -near, near, FINE_MM)
        self.place = self._evened()
        self.slips = self._slips()
        at(3)
        self._chain_of_rolls()
        at(4)
        self._measure_ovality()
        for k in range(ROUNDS):
            sigma_z = self._smooth_places()
            sigma_roll = self._smooth_rolls()
            at(5 + k)
        self.sigma = max(robust_sigma(self._left().ravel()), 1e-4)
        sigma_z = np.hypot(sigma_z, self._astray())
        inside = (self._row() >= 0) & (self._row() <= len(self.first.deviation_mm) - 1)
        z = np.where(inside, self.place, np.nan)
        seen = np.isfinite(self.theirs.own).any(axis=1)
        rows = np.flatnonzero(inside & seen)
        found = float(self._known()[rows].mean()) if len(rows) else 0.0
        if found < BARE:
            sigma_z = BARE_MISFIT * sigma_z
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
            found,
        )

    def _firsts_roll(self) -> FloatArray:
        assert self.mine.roll_deg is not None
        return np.asarray(np.interp(self.place, self.first.z_mm, self.mine.roll_deg))

    def _row(self) -> FloatArray:
        return np.asarray((self.place - self.first.first_mm) / self.first.step_mm)

    def _costs(self, places: FloatArray, rolls: FloatArray) -> FloatArray:
        """(Z, K) of each row's detail; what is gone, or new, costs little wherever the row lies."""
        row_at = (places - self.first.first_mm) / self.first.step_mm
        rows = len(self.first.deviation_mm)
        edge = (row_at > rows - 1 - 1e-6) & (row_at < rows - 1 + 0.5)
        row_at = np.where(edge, rows - 1 - 1e-6, np.where((row_at < 0) & (row_at > -0.5), 0.0, row_at))
        cost = row_costs(
            self.theirs_calm, self.calm, *(row_at + 0 * rolls, rolls * self.columns / 360.0 + 0 * row_at), self.sigma
        )
        return np.minimum(cost / ALIKE_CELLS, GONE_COST * self.second.step_mm)

    def _chain_of_places(self, base: FloatArray, low: FloatArray, high: FloatArray, step: float) -> None:
        """low, high (Z,) mm beside base, between which a row lies: else a chain slips away from what is new or gone."""
        least, most = float(low.min()), float(high.max())
        step *= max(1.0, (most - least) / step / STATES_MAX)
        offsets = np.arange(least, most + step / 2, step)
        places = base[:, None] + offsets[None]
        cost = self._costs(places, self.roll[:, None]) + self._oval_cost(places, self.roll[:, None])
        cost[(offsets[None] < low[:, None] - step) | (offsets[None] > high[:, None] + step)] += OUTSIDE
        chain = likeliest(cost, STEP_COST * step / FINE_MM / 4 + STEP_COST / 2, SLIP_COST)
        moved = offsets[chain]
        self.place = base + moved

    def _by_stretches(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(Z,) places by the cable's scale alone, and from where to where beside them a row may lie, mm."""
        own, place = self.stretches
        beside = place - self.scale * own
        line = np.interp(self.z, own, beside)
        near = np.abs(self.z[:, None] - own[None]) <= STRETCH_MM
        alone = ~near.any(axis=1)
        low = np.where(alone, line - FAR_MM, np.where(near, beside[None], np.inf).min(axis=1) - ABOUT_MM)
        high = np.where(alone, line + FAR_MM, np.where(near, beside[None], -np.inf).max(axis=1) + ABOUT_MM)
        return self.scale * self.z, low, high

    def _known(self) -> BoolArray:
        """(Z,) whether a row was found again."""
        return np.asarray(self._costs(self.place[:, None], self.roll[:, None])[:, 0] < -KNOWN)

    def _measure_scale(self) -> None:
        """By all pairs of rows that were found again: what most of them agree in, for some have a slip between them."""
        known = np.flatnonzero(self._known())
        known = known[:: len(known) // KNOWN_MOST + 1]
        i, j = np.triu_indices(len(known), 1)
        apart = (known[j] - known[i]) * self.second.step_mm
        some = (apart > APART_MM[0]) & (apart < APART_MM[1])
        if some.sum() < KNOWN_LEAST:
            return
        beside, apart = (self.place[known[j]] - self.place[known[i]])[some] - apart[some], apart[some]
        for half, agree_mm in ((SCALE, 3 * AGREE_MM), (3 * AGREE_MM / APART_MM[1], AGREE_MM)):
            tried = np.linspace(self.scale - half, self.scale + half, 41)
            off = (beside[None] - (tried[:, None] - 1) * apart[None]) / agree_mm
            self.scale = float(tried[np.argmax(np.exp(-0.5 * off**2).sum(axis=1))])

    def _evened(self) -> FloatArray:
        """(Z,) the places without their steps."""
        even = self.scale * self.second.step_mm * np.arange(len(self.place))
        half = max(round(STAYS_MM / self.second.step_mm), 3)
        return np.asarray(even + ndimage.median_filter(self.place - even, 2 * half + 1, mode="nearest"))

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

    def _astray(self) -> FloatArray:
        """(Z,) mm, k = 1: how far rows may lie from their place by all chains that were not chosen: slips before or
        after where they were put, slips that nothing showed, drift between rows that know where they are."""
        offsets = np.arange(-ASTRAY_MM, ASTRAY_MM + COARSE_MM / 2, COARSE_MM)
        at = self.place[:, None] + offsets[None]
        costs = (self._costs(at, self.roll[:, None]) + self._oval_cost(at, self.roll[:, None])) / MISFIT**2
        leaps = np.zeros(len(self.place))
        rows = np.flatnonzero(self.slips)
        leaps[rows] = self.place[rows] - self.place[rows - 1] - self.scale * self.second.step_mm
        metres = self.second.step_mm / 1000
        drift = min(CABLE_MM**2 * metres / (2 * COARSE_MM**2), 0.2)
        slip = min(SLIPS_A_M * metres, 0.2)
        likely = believed_states(
            costs, np.rint(leaps / COARSE_MM).astype(np.int64), drift, slip, math.exp(-COARSE_MM / SLIP_USUAL_MM)
        )
        return np.asarray(np.sqrt(likely @ np.square(offsets)))

    def _chain_of_rolls(self) -> None:
        reach = ROLL_NEAR_DEG if self.with_sensor else ROLL_FREE_DEG
        rolls = np.arange(-reach, reach + ROLL_STEP_DEG / 2, ROLL_STEP_DEG)
        at = self.sensor[:, None] + rolls[None]
        cost = self._costs(self.place[:, None], at) + self._oval_cost(self.place[:, None], at)
        chain = likeliest(cost, STEP_COST, TURN_COST)
        self.roll = self.sensor + rolls[chain]
        self.jumps = np.abs(np.diff(rolls[chain], prepend=rolls[chain[0]])) > JUMP_DEG

    def _oval_cost(self, places: FloatArray, rolls: FloatArray) -> FloatArray:
        """(Z, K) of each row, by what ovality differs by there, in units of what it differs by all along."""
        share = self.second.step_mm / self.oval_alike_mm
        first, last = self.first.z_mm[[0, -1]]
        out = np.zeros(np.broadcast_shapes(places.shape, rolls.shape))
        for begin in range(0, len(out), _CHUNK):  # complex, and several of them: not of a long scan at once
            part = slice(begin, begin + _CHUNK)
            mine = self._ovality(places[part]) * np.exp(2j * np.radians(rolls[part]))
            off = np.abs(self.theirs.oval[part, None] - mine) ** 2
            inside = (places[part] >= first) & (places[part] <= last)
            out[part] = np.where(inside, 0.5 * share * np.minimum(off / self.oval_mm**2, OVAL_CUT), 0.0)
        return out

    def _ovality(self, places: FloatArray) -> ComplexArray:
        oval, z = self.mine.oval, self.first.z_mm
        return np.asarray(np.interp(places, z, oval.real) + 1j * np.interp(places, z, oval.imag))

    def _measure_ovality(self) -> None:
        """By how much ovality differs where rows lie now, and over how far that is alike: what changed along metres
        says nothing of where a row lies, what is the same but for noise says a lot."""
        off = self.theirs.oval * np.exp(-2j * np.radians(self.roll)) - self._ovality(self.place)
        off = off[(self.place >= self.first.z_mm[0]) & (self.place <= self.first.z_mm[-1])]
        if len(off) < 8:
            return
        self.oval_mm = max(robust_sigma(np.stack([off.real, off.imag])), OVAL_LEAST_MM)
        off = off / np.maximum(np.abs(off) / (3 * self.oval_mm), 1.0)
        most = min(len(off) // 2, round(OVAL_FAR_MM / self.second.step_mm))
        alike = np.array(
            [
                np.mean(off[k:].real * off[: len(off) - k].real + off[k:].imag * off[: len(off) - k].imag)
                for k in range(most)
            ]
        )
        fallen = np.flatnonzero(alike <= 0)
        upto = int(fallen[0]) if len(fallen) else most
        whole = self.second.step_mm * (2 * float(alike[:upto].sum()) / max(float(alike[0]), 1e-12) - 1)
        self.oval_alike_mm = max(whole, OVAL_ALIKE_MM)

    def _smooth_places(self) -> FloatArray:
        h = 0.4 * self.first.step_mm
        at = self.place[:, None] + np.array([-h, 0.0, h])[None]
        costs = self._costs(at, self.roll[:, None]) + self._oval_cost(at, self.roll[:, None])
        even = self.scale * self.second.step_mm * np.arange(len(self.z))
        tie = np.where(self.slips[1:], 0.0, 1000.0 / (CABLE_MM**2 * self.second.step_mm))
        moved, sigma = self._newton(costs, h, self.place - even, tie)
        self.place = self.place + np.clip(moved, -2.0, 2.0)
        return sigma

    def _smooth_rolls(self) -> FloatArray:
        h = 0.4 * 360.0 / self.columns
        at = self.roll[:, None] + np.array([-h, 0.0, h])[None]
        costs = self._costs(self.place[:, None], at) + self._oval_cost(self.place[:, None], at)
        walk = HEAD_DEG if self.with_sensor else HEAD_FREE_DEG
        tie = np.where(self.jumps[1:], 0.0, 1000.0 / (walk**2 * self.second.step_mm))
        moved, sigma = self._newton(costs, h, self.roll - self.sensor, tie)
        self.roll = self.roll + np.clip(moved, -2.0, 2.0)
        return sigma

    def _newton(self, costs: FloatArray, h: float, now: FloatArray, tie: FloatArray) -> tuple[FloatArray, FloatArray]:
        """One step towards the least of all rows' costs and of a random walk of `now`; and what is left unknown."""
        pull = -(costs[:, 2] - costs[:, 0]) / (2 * h)
        bent = (costs[:, 2] - 2 * costs[:, 1] + costs[:, 0]) / h**2
        weight = np.maximum(ndimage.gaussian_filter1d(bent, 10.0, mode="nearest"), 0.0)
        held = np.zeros(len(now))
        gap = np.diff(now) * tie
        held[:-1] += gap
        held[1:] -= gap
        moved, variance = joined(weight, pull + held, tie)
        return moved, MISFIT * np.sqrt(variance)

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
