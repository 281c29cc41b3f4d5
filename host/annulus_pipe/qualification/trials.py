"""Did the head detect what was laid? Truths and reports of one pull through one pipe, matched one to one.

A truth and a report may be the same thing where their places agree within a gate, along the pipe and on the
circumference. Of all such pairings that with the most pairs is taken, and among those the one that lies closest: pairs
are chosen all at once, for a nearest report taken one truth at a time may belong to the next. Kinds do not gate, they
only break ties: a loss reported as a bump was detected, and not identified.

A truth in a hole of the survey is left out whether or not something was reported there: leaving out only those that
were missed would raise the probability of detection. Nothing here knows the bench's score, which rests on other rules.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.late import optimize
from annulus_pipe.vocabulary import AnnulusError

# Between the middles of a truth and of its report, beside half of the longer of the two: what an odometer is off over a
# spool of some metres, and a clock of 10 degrees on pipes of up to 280 mm. `pod plan` lays defects farther apart than
# twice as much. tests/unit/qualification/test_trials.py holds both sides of it.
GATE_MM = 25.0
KIND_APART = 1.0  # what another kind adds to the square of a distance in gates: it decides between near ties only
UNDECIDED_APART = 0.5  # .. and a place that was listed without a name
CLUSTER_MAX = 4_000_000  # pairs of one group of neighbours: 2000 truths within each other's gates are a mistake
# The wall about a truth, FRAME_MM wide: with more of it unseen it lies in a hole of the survey. Its own footprint says
# nothing of that: a rim hides up to 0.7 of a pocket 3 mm deep and 20 long, and nothing before or beside it.
FRAME_MM, HIDDEN_PART = 10.0, 0.5
FRAME_STEPS = 12  # along and round, by which that part is measured
# Where defects lie side by side many a truth has a neighbour by any zero, up to 7 of 10: if by another zero so
# many times as many have one, the zero is wrong. Guarded by tests/regression/spool_by_another_zero.
CHANCE_TIMES, CHANCE_LEAST = 1.2, 8
UNIT_PART = 0.7  # of the pairs: as many of which agree by another unit, and the unit is wrong
UNIT_OFF = 1.15  # within which a ratio of depths is that of two units; an inch is 25.4 times off
WHOLE_CIRCLE_DEG = 345.0  # an arc that goes all round: its clock says nothing
# Two pulls of so many trials, or so many reported depths, that agree in all digits are one: depths of a second pass
# differ in the third. Below, small spools of one plan may well agree. Guarded by test_trials.py.
ALIKE_LEAST, DEPTHS_ALIKE_LEAST = 20, 4
KINDS = ("loss", "bump")  # of a place on the wall, as summary.json names them; out of round is a stretch of the pipe


class TrialState(StrEnum):
    """What became of a truth."""

    DETECTED = "detected"
    MISSED = "missed"
    UNDECIDED = "undecided"  # reported as a place that may be nothing: a miss, counted by itself
    NOT_SEEN = "not seen"  # lies in a hole of the survey: left out
    OUTSIDE = "outside"  # not scanned: left out


JUDGED = (TrialState.DETECTED, TrialState.MISSED, TrialState.UNDECIDED)


@dataclass(frozen=True, slots=True)
class TrueDefect:
    """One that is known. NaN where nobody measured it; width_mm along the circumference.

    depth_u_mm : expanded uncertainty (k = 2) of depth_mm. beside_joint : None where nobody said. laid : False of one
    that was dug up because a survey reported it: it tells of sizes, and of detection nothing.
    """

    name: str
    kind: str
    z_mm: float
    clock_deg: float
    depth_mm: float
    length_mm: float = math.nan
    width_mm: float = math.nan
    beside_joint: bool | None = None
    pipe: str = ""
    laid: bool = True
    depth_u_mm: float = math.nan


@dataclass(frozen=True, slots=True)
class Reported:
    """One line of a survey's list. at_least : its depth is a lower limit. listed : False of an undecided place."""

    kind: str
    z_mm: float
    clock_deg: float
    depth_mm: float = math.nan
    depth_k2_mm: float = math.nan
    length_mm: float = math.nan
    arc_deg: float = math.nan
    at_least: bool = False
    listed: bool = True


@dataclass(frozen=True, slots=True)
class UnseenPlace:
    """A place of the wall that the survey did not see."""

    z_from_mm: float
    z_to_mm: float
    clock_deg: float = 0.0
    arc_deg: float = 360.0


@dataclass(frozen=True, slots=True)
class SeenWall:
    """Which cells of a survey's map were seen: (Z, A) bool, rows step_mm apart from first_mm on, columns clockwise from
    first_deg on."""

    cells: BoolArray
    first_mm: float
    step_mm: float
    first_deg: float = 0.0

    def at(self, z_mm: FloatArray, clock_deg: FloatArray) -> BoolArray:
        """Of places (N,); False beyond its ends."""
        rows, columns = self.cells.shape
        row = np.rint((z_mm - self.first_mm) / self.step_mm).astype(np.int64)
        column = np.rint((clock_deg - self.first_deg) % 360.0 * columns / 360.0).astype(np.int64) % columns
        inside = (row >= 0) & (row < rows)
        return np.asarray(inside & self.cells[np.clip(row, 0, rows - 1), column])


@dataclass(frozen=True, slots=True)
class Pull:
    """One survey of one pipe. depth_limit_mm : the least depth it lists; NaN where it does not say. holes, seen : what
    it did not see, as places or by its map."""

    name: str
    pipe: str
    from_mm: float
    to_mm: float
    bore_radius_mm: float
    depth_limit_mm: float = math.nan
    head: str = ""
    version: str = ""
    date: str = ""
    holes: tuple[UnseenPlace, ...] = ()
    seen: SeenWall | None = field(default=None, compare=False, repr=False)

    @property
    def inspected_mm(self) -> float:
        return self.to_mm - self.from_mm

    @property
    def seen_mm(self) -> float:
        """Of its length what was seen: a hole takes its part of the circle. Holes that overlap take theirs twice."""
        hidden = 0.0
        for one in self.holes:
            along = min(one.z_to_mm, self.to_mm) - max(one.z_from_mm, self.from_mm)
            hidden += max(along, 0.0) * min(max(one.arc_deg, 0.0), 360.0) / 360.0
        return max(self.inspected_mm - hidden, 0.0)


@dataclass(frozen=True, slots=True)
class Trial:
    """A truth and what became of it in one pull. reported : the kind, "" where nothing was."""

    truth: TrueDefect
    pull: str
    state: TrialState
    reported: str = ""
    reported_depth_mm: float = math.nan
    reported_k2_mm: float = math.nan
    at_least: bool = False
    depth_limit_mm: float = math.nan

    @property
    def is_identified(self) -> bool:
        return self.state is TrialState.DETECTED and self.reported == self.truth.kind


@dataclass(frozen=True, slots=True)
class Trials:
    """Of any number of pulls. false_calls : listed where nothing lay, beside the pull's name; undecided_elsewhere :
    places without a name there; of_other_kinds : reports of no place on the wall (ovality), which are not judged."""

    trials: tuple[Trial, ...]
    pulls: tuple[Pull, ...] = ()
    false_calls: tuple[tuple[str, Reported], ...] = ()
    undecided_elsewhere: int = 0
    of_other_kinds: int = 0

    @property
    def _names(self) -> set[str]:
        """Of its pulls; a list of hits and misses is one by its file's name."""
        return {one.name for one in self.pulls} | {one.pull for one in self.trials}

    @property
    def _alike(self) -> set[tuple[str, ...]]:
        """Of each pull that has enough of them, its trials by what they came to, whatever they are called."""
        out: dict[str, list[str]] = {}
        depths: dict[str, int] = {}
        for one in self.trials:
            came = f"{one.truth.kind} {one.truth.depth_mm:.9g} {one.state} {one.reported_depth_mm:.9g}"
            out.setdefault(one.pull, []).append(came)
            depths[one.pull] = depths.get(one.pull, 0) + math.isfinite(one.reported_depth_mm)
        return {
            tuple(rows) for pull, rows in out.items() if len(rows) >= ALIKE_LEAST or depths[pull] >= DEPTHS_ALIKE_LEAST
        }

    def joined(self, other: "Trials") -> "Trials":
        """With those of another pull. AnnulusError where both have the same, or differ in what one truth is."""
        twice = self._names & other._names
        if twice:
            raise AnnulusError(f"{min(twice)}: its trials are there twice. Expected each pull once.")
        known = {(one.truth.pipe, one.truth.name): one.truth for one in self.trials if math.isfinite(one.truth.z_mm)}
        shared = any((one.truth.pipe, one.truth.name) in known for one in other.trials)
        if not shared and self._alike & other._alike:  # targets that are known to be one count once anyway
            raise AnnulusError(
                f"{min(other._names)}: has the trials of {min(self._names)} anew. Expected each pull once."
            )
        for one in other.trials:
            same = known.get((one.truth.pipe, one.truth.name), one.truth)
            if (same.kind, same.z_mm, same.depth_mm) != (one.truth.kind, one.truth.z_mm, one.truth.depth_mm):
                raise AnnulusError(
                    f"{one.truth.name} of {one.truth.pipe or 'a pipe without a name'}: {same.depth_mm:g} mm deep at"
                    f" {same.z_mm:.0f} mm, and in {one.pull} {one.truth.depth_mm:g} at {one.truth.z_mm:.0f}. Expected a"
                    " name of its own for each spool."
                )
        return Trials(
            self.trials + other.trials,
            self.pulls + other.pulls,
            self.false_calls + other.false_calls,
            self.undecided_elsewhere + other.undecided_elsewhere,
            self.of_other_kinds + other.of_other_kinds,
        )


class _Footprint(NamedTuple):
    """Of truths or reports, (N,) each; NaN extents are points."""

    z_mm: FloatArray
    clock_deg: FloatArray
    length_mm: FloatArray
    width_mm: FloatArray
    all_round: FloatArray


def match(truths: Sequence[TrueDefect], reported: Sequence[Reported], pull: Pull, *, zero_mm: float = 0.0) -> Trials:
    """What became of every truth in one pull.

    zero_mm : where in the scan the truths' zero lies. Raises AnnulusError, one line, where truths and reports are not
    of one pipe or not in one unit.
    """
    truths = _of_this_pipe(truths, pull)
    judged = [one for one in reported if one.kind in KINDS]
    moved = [replace(one, z_mm=one.z_mm + zero_mm) for one in truths]
    found = dict(pairs(moved, judged, pull.bore_radius_mm))
    states = [_state(one, judged[found[i]] if i in found else None, pull) for i, one in enumerate(moved)]
    _require_same_pipe(moved, judged, states, len(found), pull, zero_mm)
    trials = tuple(
        _trial(truth, judged[found[i]] if i in found else None, state, pull)
        for i, (truth, state) in enumerate(zip(truths, states, strict=True))
    )
    require_one_unit(trials, pull.name)
    left = [one for j, one in enumerate(judged) if j not in set(found.values())]
    return Trials(
        trials,
        (pull,),
        tuple((pull.name, one) for one in left if one.listed),
        sum(not one.listed for one in left),
        len(reported) - len(judged),
    )


def pairs(truths: Sequence[TrueDefect], reported: Sequence[Reported], radius_mm: float) -> list[tuple[int, int]]:
    """Indices of truth and report that belong together: as many as can be, of these the closest."""
    if not truths or not reported:
        return []
    a, b = _of_truths(truths, radius_mm), _of_reports(reported, radius_mm)
    reach = GATE_MM + max(np.max(a.length_mm), np.max(b.length_mm)) / 2
    where = np.concatenate([a.z_mm, b.z_mm])
    order = np.argsort(where, kind="stable")
    cuts = np.flatnonzero(np.diff(where[order]) > reach) + 1
    found: list[tuple[int, int]] = []
    for first, last in pairwise([0, *cuts.tolist(), len(order)]):
        near = order[first:last]
        ours, theirs = near[near < len(truths)], near[near >= len(truths)] - len(truths)
        if len(ours) * len(theirs) > CLUSTER_MAX:
            raise AnnulusError(
                f"{len(ours)} truths and {len(theirs)} reports lie within each other's reach at"
                f" {where[near[0]]:.0f} mm. Expected defects that lie apart."
            )
        cost = _cost(a, b, ours, theirs, radius_mm)
        for i, j in enumerate(ours):
            cost[i] += [KIND_APART * (reported[k].kind != truths[j].kind) for k in theirs]
        cost += [UNDECIDED_APART * (not reported[k].listed) for k in theirs]
        found += [(int(ours[i]), int(theirs[k])) for i, k in _assigned(cost)]
    return found


def _cost(a: _Footprint, b: _Footprint, ours: IntArray, theirs: IntArray, radius_mm: float) -> FloatArray:
    """(len(ours), len(theirs)) squared distance in gates, infinite beyond one of them."""
    along = np.abs(a.z_mm[ours, None] - b.z_mm[None, theirs])
    longer = np.maximum(a.length_mm[ours, None], b.length_mm[None, theirs])
    turn = np.abs((a.clock_deg[ours, None] - b.clock_deg[None, theirs] + 180.0) % 360.0 - 180.0)
    round_mm = np.radians(turn) * radius_mm
    round_mm[(a.all_round[ours, None] + b.all_round[None, theirs]) > 0] = 0.0
    wider = np.maximum(a.width_mm[ours, None], b.width_mm[None, theirs])
    part_z, part_c = along / (GATE_MM + longer / 2), round_mm / (GATE_MM + wider / 2)
    return np.asarray(np.where((part_z <= 1.0) & (part_c <= 1.0), part_z**2 + part_c**2, np.inf))


def _assigned(cost: FloatArray) -> list[tuple[int, int]]:
    """The pairing of a cost matrix with the most finite pairs, and of these the least cost."""
    allowed = np.isfinite(cost)
    if not allowed.any():
        return []
    least = float(cost[allowed].max() * min(cost.shape) + 1.0)  # more than all that a pair less could save
    rows, columns = optimize.linear_sum_assignment(np.where(allowed, cost, least))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if allowed[i, j]]


def _of_truths(truths: Sequence[TrueDefect], radius_mm: float) -> _Footprint:
    width = np.nan_to_num([one.width_mm for one in truths])
    return _Footprint(
        np.array([one.z_mm for one in truths], float),
        np.array([one.clock_deg for one in truths], float),
        np.nan_to_num([one.length_mm for one in truths]),
        width,
        (width >= math.radians(WHOLE_CIRCLE_DEG) * radius_mm).astype(float),
    )


def _of_reports(reported: Sequence[Reported], radius_mm: float) -> _Footprint:
    arc = np.nan_to_num([one.arc_deg for one in reported])
    return _Footprint(
        np.array([one.z_mm for one in reported], float),
        np.array([one.clock_deg for one in reported], float),
        np.nan_to_num([one.length_mm for one in reported]),
        np.radians(arc) * radius_mm,
        (arc >= WHOLE_CIRCLE_DEG).astype(float),
    )


def _state(truth: TrueDefect, reported: Reported | None, pull: Pull) -> TrialState:
    """truth : as it lies in the scan."""
    if not pull.from_mm <= truth.z_mm <= pull.to_mm:
        return TrialState.OUTSIDE
    if hidden_part(truth, pull) > HIDDEN_PART:
        return TrialState.NOT_SEEN
    if reported is None:
        return TrialState.MISSED
    return TrialState.DETECTED if reported.listed else TrialState.UNDECIDED


def hidden_part(truth: TrueDefect, pull: Pull) -> float:
    """How much of the wall about a truth was not seen, 0..1. It is asked of every truth, reported or not."""
    length, width = (0.0 if math.isnan(one) else one for one in (truth.length_mm, truth.width_mm))
    steps = (np.arange(FRAME_STEPS) + 0.5) / FRAME_STEPS - 0.5
    z, across = (one.ravel() for one in np.meshgrid(steps * (length + 2 * FRAME_MM), steps * (width + 2 * FRAME_MM)))
    about = (np.abs(z) > length / 2) | (np.abs(across) > width / 2)
    z, clock = truth.z_mm + z[about], truth.clock_deg + np.degrees(across[about] / pull.bore_radius_mm)
    hidden = np.zeros(z.shape, bool) if pull.seen is None else ~pull.seen.at(z, clock)
    for one in pull.holes:
        away = np.abs((clock - one.clock_deg + 180.0) % 360.0 - 180.0)
        hidden |= (z >= one.z_from_mm) & (z <= one.z_to_mm) & (away <= one.arc_deg / 2)
    return float(hidden.mean())


def _trial(truth: TrueDefect, reported: Reported | None, state: TrialState, pull: Pull) -> Trial:
    if reported is None or state in (TrialState.OUTSIDE, TrialState.NOT_SEEN):
        return Trial(truth, pull.name, state, depth_limit_mm=pull.depth_limit_mm)
    return Trial(
        truth,
        pull.name,
        state,
        reported.kind,
        reported.depth_mm,
        reported.depth_k2_mm,
        reported.at_least,
        pull.depth_limit_mm,
    )


def _of_this_pipe(truths: Sequence[TrueDefect], pull: Pull) -> Sequence[TrueDefect]:
    if not truths:
        raise AnnulusError(f"{pull.name}: no truths to match. Expected at least one defect that is known.")
    named = {one.pipe for one in truths if one.pipe}
    if not pull.pipe and len(named) > 1:
        raise AnnulusError(
            f"{pull.name}: does not say which pipe it is of, and the truths are of {_few(named)}."
            " Expected results whose job names the pipe."
        )
    if not pull.pipe or not named:
        return truths
    own = [one for one in truths if one.pipe in ("", pull.pipe)]
    if not own:
        raise AnnulusError(
            f"{pull.name}: results of pipe {pull.pipe}, and the truths are of {_few(named)}."
            " Expected those of one pipe."
        )
    return own


def _few(names: set[str]) -> str:
    return ", ".join(sorted(names)[:3]) + (", .." if len(names) > 3 else "")


def _require_same_pipe(
    truths: Sequence[TrueDefect],
    reported: Sequence[Reported],
    states: Sequence[TrialState],
    matched: int,
    pull: Pull,
    zero_mm: float,
) -> None:
    """AnnulusError where nothing matches although there is much to match, or much less than by another zero, saying
    what would make it. truths : as they lie in the scan, by zero_mm."""
    listed = [one for one in reported if one.listed]
    inside = [one for one, state in zip(truths, states, strict=True) if state is not TrialState.OUTSIDE]
    if not inside:
        ends = min(one.z_mm for one in truths), max(one.z_mm for one in truths)
        raise AnnulusError(
            f"{pull.name}: all truths lie outside of what was scanned: {ends[0]:.0f} to {ends[1]:.0f} mm of"
            f" {pull.from_mm:.0f} to {pull.to_mm:.0f} mm.{_place_unit(truths, pull)}"
        )
    if len(listed) < 3 or len(truths) < 3:
        return
    shift, agree = _best_shift(truths, listed, pull.bore_radius_mm)
    shift += zero_mm
    if matched:
        if agree >= max(CHANCE_LEAST, CHANCE_TIMES * matched):
            raise AnnulusError(
                f"{pull.name}: {matched} of {len(truths)} truths lie where a defect is listed, and {agree} would if"
                f" their zero lay at {shift:.0f} mm of the scan. Expected the spool's zero"
            )
        return
    hint = ""
    if agree >= max(3, UNIT_PART * min(len(listed), len(truths))):
        hint = f" {agree} would match if the truths' zero lay at {shift:.0f} mm of the scan."
    raise AnnulusError(
        f"{pull.name}: none of {len(truths)} truths lies where one of {len(listed)} defects is listed:"
        f" another pipe, another zero or another unit.{hint or _place_unit(truths, pull)}"
    )


def _place_unit(truths: Sequence[TrueDefect], pull: Pull) -> str:
    """What is said of places that another unit would bring into the scan."""
    z = np.array([one.z_mm for one in truths])
    for factor, unit in ((1000.0, "metres"), (25.4, "inches"), (304.8, "feet")):
        inside = np.mean((z * factor >= pull.from_mm) & (z * factor <= pull.to_mm))
        spread = np.ptp(z) * factor if len(z) > 1 else np.inf
        if inside >= UNIT_PART and spread > 0.3 * pull.inspected_mm:
            return f" In {unit} they would lie in it: expected places in mm."
    return ""


def _best_shift(truths: Sequence[TrueDefect], listed: Sequence[Reported], radius_mm: float) -> tuple[float, int]:
    """By how much all truths would have to move along for the most of them to match, mm; how many then do."""
    z, theirs = (np.array([one.z_mm for one in some]) for some in (truths[:200], listed[:200]))
    shifts = np.sort((theirs[None, :] - z[:, None]).ravel())
    counts = np.searchsorted(shifts, shifts + GATE_MM / 2) - np.arange(len(shifts))
    first = int(np.argmax(counts))
    shift = float(np.median(shifts[first : first + int(counts[first])]))
    moved = [replace(one, z_mm=one.z_mm + shift) for one in truths]
    return shift, len(pairs(moved, listed, radius_mm))


def require_one_unit(trials: Sequence[Trial], name: str) -> None:
    """AnnulusError where the depths of what matched differ by the factor of another unit."""
    both = [(one.truth.depth_mm, one.reported_depth_mm) for one in trials if one.state is TrialState.DETECTED]
    ratios = np.array([there / here for here, there in both if here > 0 and there > 0])
    if len(ratios) < 3:
        return
    for factor, say in (
        (25.4, "the truths' depths look like inches"),
        (1 / 25.4, "the reported depths look like inches"),
        (1000.0, "the truths' depths look like metres"),
        (0.001, "the truths' depths look like micrometres"),
        (10.0, "the truths' depths look like centimetres"),
        (1 / 39.37, "the truths' depths look like mils"),
    ):
        off = np.exp(np.abs(np.log(ratios / factor)))
        if np.median(off) < UNIT_OFF and np.mean(off < UNIT_OFF**2) >= UNIT_PART:
            raise AnnulusError(
                f"{name}: what was reported is {np.median(ratios):.3g} times as deep as the truths of"
                f" {len(ratios)} matches: {say}. Expected both in mm."
            )
