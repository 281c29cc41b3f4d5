"""What excavations say of a survey: which listed places are there, how far off their depths are, whether the
specification is borne out, and which dig would tell most next.

A depth is within tolerance when it differs from the dig's by no more than both may be off together: the root of the
sum of squares of the tool's tolerance and the dig's, each at the claim's certainty (API 1163: the combined tolerance).
A dig states k = 2, about 95 %; at another certainty its tolerance is that times the normal distribution's ratio.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from annulus_pipe.numeric.late import special
from annulus_pipe.numeric.rounding import DISTANCE, MEASURE, clock_face, off, quoted
from annulus_pipe.qualification.digs import Dig, DugKind
from annulus_pipe.qualification.line import LEAST, StraightLine, fit_line
from annulus_pipe.qualification.matching import Matching, SurveyPlace, as_truth, match
from annulus_pipe.qualification.sizing import SizedPair, Sizing, size_errors
from annulus_pipe.qualification.trials import GATE_MM, HIDDEN_PART, Pull, hidden_part
from annulus_pipe.qualification.validation import CONFIDENCE, ClaimJudgement, Proportion, judge_claim, proportion
from annulus_pipe.vocabulary import AnnulusError

OWN_CERTAINTY = 0.95  # of a survey's k = 2
NEXT_MAX = 5  # digs that are proposed
# Before any dig, bias and slope may be off by so much: a tolerance, and a half. Wide enough that two digs outweigh it.
PRIOR_SLOPE = 0.5
SCALES = {25.4: "inches", 1000.0: "metres", 10.0: "centimetres", 304.8: "feet"}  # mm each, that a column may be in
WALL_SLACK = 1.25  # of a nominal wall: tolerances of ISO 11922-1 and a nominal size together are less
SCALE_OFF = 0.2  # part by which depths in another unit are off that ratio: their own errors

# No proportion is made of what was missed: where a survey says nothing, nobody digs.
CHOSEN = "Places that were dug because they are listed say nothing of what is missed."


class Dug(StrEnum):
    """What became of a dug place."""

    FOUND = "found"  # listed, and there
    MISSED = "missed"  # there, not listed
    FALSE_CALL = "false call"  # listed, not there
    SOUND = "sound"  # not listed, not there
    UNDECIDED = "undecided"  # the survey made no claim either way
    NOT_SEEN = "not seen"  # of wall that the survey did not see: says nothing of it
    SHALLOW = "below the listing limit"  # there, and no deeper than what the survey lists


@dataclass(frozen=True, slots=True)
class SurveyResults:
    """A survey and what it lists. wall_mm : nominal, NaN where nobody stated it."""

    pull: Pull
    places: tuple[SurveyPlace, ...]
    wall_mm: float = math.nan


@dataclass(frozen=True, slots=True)
class ToolClaim:
    """`certainty` of depths are within a tolerance. basis : who says so, for people.

    tolerances : (kind, mm), of a kind "" for all of them; NaN where a kind's cannot be told. None of them: each place
    within its own k = 2.
    """

    certainty: float
    tolerances: tuple[tuple[str, float], ...]
    basis: str

    @property
    def single_mm(self) -> float:
        """NaN where there is not one for all."""
        every = {mm for _, mm in self.tolerances}
        return every.pop() if len(every) == 1 else math.nan

    def of(self, place: SurveyPlace) -> float:
        if not self.tolerances:
            return place.depth_k2_mm
        by_kind = dict(self.tolerances)
        return by_kind.get(place.kind, by_kind.get("", math.nan))

    def of_dig(self, u_mm: float) -> float:
        """A dig's expanded uncertainty at the claim's certainty; 0 where it states none."""
        if math.isnan(u_mm):
            return 0.0
        if not self.tolerances:
            return u_mm  # k = 2, as the places' own
        return u_mm / 2.0 * float(special.ndtri((1.0 + self.certainty) / 2.0))

    def statement(self) -> str:
        within = [
            f"{f'{kind} ' if kind else ''}± {off(mm, MEASURE)}" if math.isfinite(mm) else f"{kind} not established"
            for kind, mm in self.tolerances
        ]
        what = ", ".join(within) or "each its own k = 2"
        part = f"{100 * self.certainty:.0f} % of depths within {what}"
        return f"Claim: {part} ({self.basis}), the dig's own uncertainty added."


@dataclass(frozen=True, slots=True)
class DugPlace:
    """A dig and what the survey has there. error_mm : reported less dug, NaN where not both are known as numbers;
    tolerance_mm : of both together; within : None where it cannot be told. same_kind : None where nothing is said."""

    dig: Dig
    outcome: Dug
    place: SurveyPlace | None
    same_kind: bool | None
    error_mm: float
    tolerance_mm: float
    within: bool | None

    @property
    def is_sized(self) -> bool:
        return math.isfinite(self.error_mm)


@dataclass(frozen=True, slots=True)
class NextDig:
    """A listed place that was not dug. remains : the part that bias and slope's joint interval would shrink to.
    new_kind : no dig has verified its kind yet."""

    place: SurveyPlace
    remains: float
    new_kind: bool

    def statement(self) -> str:
        place = self.place
        at = f"{place.kind} at {quoted(place.z_mm, DISTANCE)}, clock {clock_face(place.clock_deg)}"
        why = f"no {place.kind} was verified yet; " if self.new_kind else ""
        depth = quoted(place.depth_mm, MEASURE, place.depth_k2_mm, at_least=place.at_least)
        shrinks = f"the region of bias and slope would shrink to {100 * self.remains:.0f} %"
        return f"{place.name}, {at}, {depth} ({why}{shrinks})"


@dataclass(frozen=True, slots=True)
class Unity:
    """A study: every dig, and what all of them say. line None: cannot be told."""

    source: str
    digs: str
    claim: ToolClaim
    shift_mm: float
    shift_basis: str
    rows: tuple[DugPlace, ...]
    judgement: ClaimJudgement
    sizing: Sizing
    line: StraightLine | None
    confirmed: Proportion
    identified: Proportion
    next_digs: tuple[NextDig, ...]
    remarks: tuple[str, ...]

    def count(self, outcome: Dug) -> int:
        return sum(row.outcome is outcome for row in self.rows)

    @property
    def line_statement(self) -> str:
        if self.line is None:
            sized = sum(row.is_sized for row in self.rows)
            why = "" if sized < LEAST else "; these depths lie too near each other"
            return f"Bias and slope cannot be told from {sized} depths, {LEAST} or more of different size needed{why}."
        line = self.line
        agrees = "unity lies in their joint region" if line.is_unity else "unity lies outside of their joint region"
        return (
            f"Reported = {quoted(line.intercept_mm, MEASURE, line.intercept_k_mm)} + ({line.slope:.3f} ± "
            f"{line.slope_k:.3f}) · dug, {100 * line.confidence:.0f} % confidence: {agrees}."
        )

    def statement(self) -> list[str]:
        """What is said of it, most important first."""
        lines = [self.judgement.statement(), self.claim.statement()]
        if self.confirmed.n:
            there = self.confirmed
            lines.append(
                f"{there.hits} of {there.n} listed places that were dug are there: {100 * there.lower:.0f} % to "
                f"{100 * there.upper:.0f} % of all, {100 * there.confidence:.0f} % confidence."
            )
        missed = self.count(Dug.MISSED)
        lines.append(f"{missed} of {missed + self.count(Dug.FOUND)} dug defects not listed. {CHOSEN}")
        lines += [self.line_statement, *self.sizing.statement()]
        if self.next_digs:
            lines.append(f"Next dig: {self.next_digs[0].statement()}.")
        return [*lines, *self.remarks]


def study(
    results: SurveyResults,
    digs: Sequence[Dig],
    name: str,
    claim: ToolClaim,
    bound_mm: float,
    confidence: float = CONFIDENCE,
) -> Unity:
    """Holds digs against results. name : of the file of digs. bound_mm : how far the dig's chainage may be shifted.

    Raises AnnulusError, one line, for digs of another pipe or in other units, and for one deeper than the wall.
    """
    _require_here(results, digs, name, bound_mm)
    _require_depths(results, digs, name)
    near = _near(results, digs, bound_mm)
    matching = match(digs, near, results.pull.bore_radius_mm, bound_mm)
    if not matching.by_dig or (matching.basis == "places" and abs(matching.shift_mm) > GATE_MM):
        _require_units_along(results, digs, name, bound_mm)
    rows = tuple(_row(i, dig, near, matching, results, claim) for i, dig in enumerate(digs))
    _require_units_of_depth(rows, name)
    decided = [row for row in rows if row.within is not None]
    found = [row for row in rows if row.outcome is Dug.FOUND]
    false_calls = sum(row.outcome is Dug.FALSE_CALL for row in rows)
    named = [row for row in found if row.same_kind is not None]
    sized = [row for row in found if row.place is not None and row.same_kind is not False]
    return Unity(
        results.pull.name,
        name,
        claim,
        matching.shift_mm,
        matching.basis,
        rows,
        judge_claim(sum(bool(row.within) for row in decided), len(decided), claim.certainty, confidence),
        size_errors(_pairs(sized), confidence=confidence),
        _line(sized, confidence),
        proportion(len(found), len(found) + false_calls, confidence),
        proportion(sum(bool(row.same_kind) for row in named), len(named), confidence),
        _next_digs(results, rows, claim),
        (*matching.remarks, *_remarks(rows)),
    )


def _near(results: SurveyResults, digs: Sequence[Dig], bound_mm: float) -> list[SurveyPlace]:
    """The places that any dig may be."""
    z = np.sort([one.z_mm for one in digs])
    length = max((one.length_mm for one in digs if math.isfinite(one.length_mm)), default=0.0)
    out = []
    for place in results.places:
        reach = bound_mm + GATE_MM + max(place.length_mm, length) / 2
        first = int(np.searchsorted(z, place.z_mm - reach))
        if first < len(z) and z[first] <= place.z_mm + reach:
            out.append(place)
    return out


def _row(
    i: int, dig: Dig, near: Sequence[SurveyPlace], matching: Matching, results: SurveyResults, claim: ToolClaim
) -> DugPlace:
    place = near[matching.by_dig[i]] if i in matching.by_dig else None
    sound = dig.kind is DugKind.SOUND
    if place is None:
        return DugPlace(dig, _unlisted(dig, matching.shift_mm, results.pull), None, None, math.nan, math.nan, None)
    if place.undecided:
        return DugPlace(dig, Dug.UNDECIDED, place, None, math.nan, math.nan, None)
    if sound:
        return DugPlace(dig, Dug.FALSE_CALL, place, None, math.nan, math.nan, None)
    same = None if dig.kind is DugKind.ANY else dig.kind == place.kind
    error = place.depth_mm - dig.depth_mm if same is not False else math.nan
    if not math.isfinite(error):
        return DugPlace(dig, Dug.FOUND, place, same, math.nan, math.nan, None)
    together = math.hypot(claim.of(place), claim.of_dig(dig.depth_u_mm))
    if place.at_least:  # it may be deeper: only too deep can be told
        beyond = error > together
        return DugPlace(dig, Dug.FOUND, place, same, math.nan, together, False if beyond else None)
    within = abs(error) <= together if math.isfinite(together) else None
    return DugPlace(dig, Dug.FOUND, place, same, error, together, within)


def _unlisted(dig: Dig, shift_mm: float, pull: Pull) -> Dug:
    truth = as_truth(dig, shift_mm)
    if not pull.from_mm <= truth.z_mm <= pull.to_mm or hidden_part(truth, pull) > HIDDEN_PART:
        return Dug.NOT_SEEN
    if dig.kind is DugKind.SOUND:
        return Dug.SOUND
    return Dug.SHALLOW if dig.depth_mm < pull.depth_limit_mm else Dug.MISSED


def _pairs(rows: Sequence[DugPlace]) -> Iterator[SizedPair]:
    for row in rows:
        if row.place is not None and math.isfinite(row.place.depth_mm) and math.isfinite(row.dig.depth_mm):
            u = None if math.isnan(row.dig.depth_u_mm) else row.dig.depth_u_mm
            yield SizedPair(row.place.depth_mm, row.dig.depth_mm, u, row.place.at_least)


def _line(rows: Sequence[DugPlace], confidence: float) -> StraightLine | None:
    """Of the depths that are numbers on both sides, and where the survey says what its own may be off."""
    both = [row for row in rows if row.is_sized and row.place is not None and row.place.depth_k2_mm > 0.0]
    x = np.array([row.dig.depth_mm for row in both])
    y = np.array([row.place.depth_mm for row in both if row.place])
    x_sigma = np.nan_to_num([row.dig.depth_u_mm / 2 for row in both])
    y_sigma = np.array([row.place.depth_k2_mm / 2 for row in both if row.place])
    return fit_line(x, y, x_sigma, y_sigma, confidence)


def _next_digs(results: SurveyResults, rows: Sequence[DugPlace], claim: ToolClaim) -> tuple[NextDig, ...]:
    """Kinds that no dig has verified first; then by what a dig adds to the determinant of the information on bias and
    slope (D-optimal: Atkinson and others, Optimum Experimental Designs, 2007, ch. 11), each place weighted by what its
    own k = 2 and a dig like those before say it may be off; ties to the deeper."""
    dug = {row.place.name for row in rows if row.place is not None}
    verified = {row.place.kind for row in rows if row.place is not None and row.outcome is Dug.FOUND and row.same_kind}
    stated = [row.dig.depth_u_mm / 2 for row in rows if math.isfinite(row.dig.depth_u_mm)]
    dig_sigma = float(np.median(stated)) if stated else 0.0
    sized = [row.place for row in rows if row.is_sized and row.place is not None]
    open_ones = [one for one in results.places if not one.undecided and one.name not in dug]
    scale = max((mm for _, mm in claim.tolerances if mm > 0.0), default=_typical_k2(results.places))
    known = np.diag([1.0 / scale**2, 1.0 / PRIOR_SLOPE**2])
    for one in sized:
        known += _information(one, dig_sigma)
    before = float(np.linalg.det(known))
    out = [
        NextDig(
            one,
            math.sqrt(before / float(np.linalg.det(known + _information(one, dig_sigma)))),
            one.kind not in verified,
        )
        for one in open_ones
    ]
    out.sort(key=lambda one: (not one.new_kind, round(one.remains, 6), -_or_zero(one.place.depth_mm)))
    return tuple(out[:NEXT_MAX])


def _information(place: SurveyPlace, dig_sigma: float) -> np.ndarray:
    """Of one dig on (bias, slope): none of a place whose depth is a lower limit or without an uncertainty."""
    sigma = math.hypot(place.depth_k2_mm / 2, dig_sigma)
    if place.at_least or not (sigma > 0.0 and math.isfinite(place.depth_mm)):
        return np.zeros((2, 2))
    row = np.array([1.0, place.depth_mm]) / sigma
    return np.outer(row, row)


def _typical_k2(places: Sequence[SurveyPlace]) -> float:
    known = [one.depth_k2_mm for one in places if one.depth_k2_mm > 0.0]
    return float(np.median(known)) if known else 1.0


def _or_zero(value: float) -> float:
    return value if math.isfinite(value) else 0.0


def _remarks(rows: Sequence[DugPlace]) -> Iterator[str]:
    defects = [row for row in rows if row.dig.kind is not DugKind.SOUND]
    if len(defects) > 1 and all(row.outcome is Dug.MISSED for row in defects):
        yield "no dug defect is listed where it was dug: another pipe, or another zero of the chainage?"
    without = sum(row.is_sized and math.isnan(row.dig.depth_u_mm) for row in rows)
    if without:
        yield f"{_counted(without, 'dig')} without an uncertainty: what it is off counts as the survey's"
    unsure = sum(row.is_sized and row.within is None for row in rows)
    if unsure:
        yield f"{_counted(unsure, 'reported depth')} without a tolerance of its kind or its own: not judged"
    limits = sum(row.place is not None and row.place.at_least and row.outcome is Dug.FOUND for row in rows)
    if limits:
        yield f"{_counted(limits, 'reported depth')} as a lower limit: only one that is too deep can be judged"
    other = sum(row.same_kind is False for row in rows)
    if other:
        yield f"{_counted(other, 'dug place')} of another kind than the survey lists: the depths are not compared"


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'s' * (count != 1)}"


def _require_here(results: SurveyResults, digs: Sequence[Dig], name: str, bound_mm: float) -> None:
    z = np.array([one.z_mm for one in digs])
    reach = bound_mm + GATE_MM
    if ((z >= results.pull.from_mm - reach) & (z <= results.pull.to_mm + reach)).any():
        return
    _require_units_along(results, digs, name, bound_mm)
    raise AnnulusError(
        f"{name}: its digs lie at {z.min():g} to {z.max():g} mm, none of them in the {results.pull.from_mm:g} to "
        f"{results.pull.to_mm:g} mm that {results.pull.name} is of. Another pipe?"
    )


def _require_units_along(results: SurveyResults, digs: Sequence[Dig], name: str, bound_mm: float) -> None:
    """AnnulusError where no dig is listed at its z_mm, and all are once it is taken for another unit's."""
    real = [one for one in digs if one.kind is not DugKind.SOUND]
    for factor, unit in SCALES.items():
        scaled = [replace(one, z_mm=one.z_mm * factor) for one in real]
        near = _near(results, scaled, 0.0)
        if real and len(match(scaled, near, results.pull.bore_radius_mm, 0.0).by_dig) == len(real):
            raise AnnulusError(
                f"{name}: its digs lie where {results.pull.name} lists places if z_mm is in {unit}, not mm."
            )


def _require_depths(results: SurveyResults, digs: Sequence[Dig], name: str) -> None:
    walled = math.isfinite(results.wall_mm)
    for one in digs:
        loss = walled and one.kind in (DugKind.LOSS, DugKind.ANY)
        most, what = (results.wall_mm, "wall") if loss else (results.pull.bore_radius_mm, "pipe's radius")
        if one.depth_mm > most * (WALL_SLACK if loss else 1.0):
            raise AnnulusError(
                f"{name}: line {one.line}: depth_mm is {one.depth_mm:g}, more than the {what} of {most:.3g} mm."
            )


def _require_units_of_depth(rows: Sequence[DugPlace], name: str) -> None:
    """AnnulusError where the reported depths are the dug ones times a unit's size, and nothing near them."""
    ratio = [
        row.place.depth_mm / row.dig.depth_mm for row in rows if row.is_sized and row.place and row.place.depth_mm > 0
    ]
    for factor, unit in SCALES.items():
        if ratio and all(abs(one / factor - 1.0) <= SCALE_OFF for one in ratio):
            raise AnnulusError(
                f"{name}: reported depths are {np.median(ratio):.3g} times the dug ones. Is depth_mm in {unit}?"
            )
