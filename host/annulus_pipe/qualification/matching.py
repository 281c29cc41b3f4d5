"""Which dug place is which listed one: one to one, by place along and round the pipe, after a shift of the chainage.

A dig's z is measured by tape from something at hand, a survey's by the odometer from its own zero: they differ by a
shift that is the same for all digs of one study. It is found where names or places allow, within a bound that the
user states, and it is 0 otherwise. Depth takes no part in it, so that what is matched says nothing of how well.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import optimize
from annulus_pipe.qualification.digs import Dig, DugKind

# What the middle of a place may be off, beside half its extent: a tape on an uneven pipe and an odometer's slip over a
# few metres; a dial drawn on the outside and a head's roll. Guarded by tests/unit/qualification/test_matching.py.
SLACK_MM, SLACK_DEG = 30.0, 20.0
SHIFTS_TRIED = 24  # of those that most digs vote for
OTHER_KIND, UNSURE, NAMED = 1.0, 0.25, -1.0  # what adds to a distance of 0 to 2
FORBIDDEN = 1e6
PAIRS_MAX = 2_000_000  # of a dig and a place near it: tables of 16 MB, seconds


@dataclass(frozen=True, slots=True)
class SurveyPlace:
    """A place that a survey lists. name : D3 as its report numbers defects, ?1 an undecided one. NaN: not stated.
    at_least : depth_mm is a lower limit."""

    name: str
    kind: str
    z_mm: float
    clock_deg: float
    length_mm: float
    arc_deg: float
    depth_mm: float
    depth_k2_mm: float
    at_least: bool = False
    undecided: bool = False


@dataclass(frozen=True, slots=True)
class UnseenWall:
    """Wall that the survey did not see: it says nothing of what is there."""

    z_from_mm: float
    z_to_mm: float
    clock_deg: float
    arc_deg: float

    def covers(self, z_mm: float, clock_deg: float) -> bool:
        return self.z_from_mm <= z_mm <= self.z_to_mm and turned_by(clock_deg, self.clock_deg) <= self.arc_deg / 2


@dataclass(frozen=True, slots=True)
class Matching:
    """by_dig : index of the place that each matched dig is. shift_mm : what is added to a dig's z; basis : names,
    places or none. remarks : what a reader of it should know."""

    shift_mm: float
    basis: str
    by_dig: Mapping[int, int]
    remarks: tuple[str, ...] = field(default=())


def turned_by(one_deg: float, other_deg: float) -> float:
    """Between two clock positions, 0 to 180 degrees."""
    return abs((one_deg - other_deg + 180.0) % 360.0 - 180.0)


def match(digs: Sequence[Dig], places: Sequence[SurveyPlace], radius_mm: float, bound_mm: float) -> Matching:
    """radius_mm : of the pipe, which makes an angle of a width. bound_mm : the largest shift there may be."""
    if not places:
        return Matching(0.0, "none", {})
    if len(digs) * len(places) > PAIRS_MAX:
        raise ValueError(f"{len(digs)} digs among {len(places)} listed places, expected at most {PAIRS_MAX} pairs")
    table = _Table(digs, places, radius_mm)
    shift, remarks = _named_shift(digs, places, bound_mm)
    basis = "names" if shift is not None else "none"
    if shift is None:
        shift, again = _voted_shift(table, bound_mm)
        remarks += again
        basis = "places" if shift else "none"
    pairs = table.paired(shift)
    apart = [places[j].z_mm - digs[i].z_mm for i, j in pairs.items() if digs[i].kind is not DugKind.SOUND]
    if basis != "names" and len(apart) > 1 and abs(float(np.median(apart))) <= bound_mm:
        shift, basis = float(np.median(apart)), "places"
        pairs = table.paired(shift)
    return Matching(shift, basis, pairs, tuple(remarks))


class _Table:
    """Digs against the places that any of them may be: how far apart they are, for any shift."""

    def __init__(self, digs: Sequence[Dig], places: Sequence[SurveyPlace], radius_mm: float) -> None:
        self.z = np.array([one.z_mm for one in digs])
        self.place_z = np.array([one.z_mm for one in places])
        self.real = np.array([one.kind is not DugKind.SOUND for one in digs])
        length = np.nan_to_num([one.length_mm for one in digs])
        arc = np.degrees(np.nan_to_num([one.width_mm for one in digs]) / radius_mm)
        place_arc = np.array([360.0 if one.kind == DugKind.OVALITY else one.arc_deg for one in places])
        self.reach = np.maximum(length[:, None], np.array([one.length_mm for one in places])) / 2 + SLACK_MM
        turn_reach = np.maximum(arc[:, None], place_arc) / 2 + SLACK_DEG
        clock, place_clock = np.array([one.clock_deg for one in digs]), np.array([one.clock_deg for one in places])
        turned = np.abs((clock[:, None] - place_clock + 180.0) % 360.0 - 180.0)
        aside = np.where(place_arc >= 360.0, 0.0, turned / turn_reach)
        kind, place_kind = np.array([one.kind.value for one in digs]), np.array([one.kind for one in places])
        self.kinds_agree = (kind[:, None] == DugKind.ANY.value) | (kind[:, None] == place_kind)
        name, place_name = np.array([one.name for one in digs]), np.array([one.name for one in places])
        other = np.where(self.kinds_agree, 0.0, OTHER_KIND) + np.where(name[:, None] == place_name, NAMED, 0.0)
        unsure = np.array([UNSURE if one.undecided else 0.0 for one in places])
        self.cost = np.where(aside <= 1.0, aside**2 + other + unsure, FORBIDDEN)

    def costs(self, shift: float) -> FloatArray:
        along = np.abs(self.z[:, None] + shift - self.place_z) / self.reach
        return np.where((along <= 1.0) & (self.cost < FORBIDDEN), self.cost + along**2, FORBIDDEN)

    def paired(self, shift: float) -> dict[int, int]:
        costs = self.costs(shift)
        rows, columns = optimize.linear_sum_assignment(costs)
        return {int(i): int(j) for i, j in zip(rows, columns, strict=True) if costs[i, j] < FORBIDDEN}

    def count(self, shift: float) -> int:
        """Digs of a defect that a listed one of their kind is paired with."""
        return sum(bool(self.real[i] and self.kinds_agree[i, j]) for i, j in self.paired(shift).items())


def _named_shift(digs: Sequence[Dig], places: Sequence[SurveyPlace], bound_mm: float) -> tuple[float | None, list[str]]:
    named = {one.name: one for one in places}
    apart = [(one, named[one.name].z_mm - one.z_mm) for one in digs if one.name in named]
    beyond = [
        f"dig {one.name} lies {abs(by):.0f} mm from the survey's {one.name}" for one, by in apart if abs(by) > bound_mm
    ]
    kept = [by for _, by in apart if abs(by) <= bound_mm]
    return (float(np.median(kept)) if kept else None), beyond


def _voted_shift(table: _Table, bound_mm: float) -> tuple[float, list[str]]:
    """The shift at which two digs or more, and more than without any, find a place of their kind; else 0."""
    allowed = (table.cost < FORBIDDEN) & table.real[:, None] & table.kinds_agree
    apart = (table.place_z - table.z[:, None])[allowed]
    apart = np.sort(apart[np.abs(apart) <= bound_mm])
    if not len(apart):
        return 0.0, []
    last = np.searchsorted(apart, apart + 2 * SLACK_MM, side="right")
    votes = last - np.arange(len(apart))
    first = np.argsort(-votes, kind="stable")[:SHIFTS_TRIED]
    tried = sorted({float(np.median(apart[i : last[i]])) for i in first}, key=abs)
    counts = [(table.count(shift), shift) for shift in tried]
    most, best = max(counts, key=lambda one: (one[0], -abs(one[1])))
    if most < 2 or most <= table.count(0.0):
        return 0.0, []
    rival = next((s for count, s in counts if count == most and abs(s - best) > 2 * SLACK_MM), math.nan)
    if math.isfinite(rival):
        return best, [f"a shift of {rival:+.0f} mm fits as many digs as {best:+.0f} mm"]
    return best, []
