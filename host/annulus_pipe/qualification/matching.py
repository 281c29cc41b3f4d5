"""Which dug place is which listed one: one to one, as truths and reports of a pull are, after a shift of the chainage.

A dig's z is measured by tape from something at hand, a survey's by the odometer from its own zero: they differ by a
shift that is the same for all digs of one study. It is found where names or places allow, within a bound that the
user states, and it is 0 otherwise. Depth takes no part in it, so that what is matched says nothing of how well.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.qualification.digs import Dig, DugKind
from annulus_pipe.qualification.trials import GATE_MM, Reported, TrueDefect, pairs

SHIFTS_TRIED = 24  # of those that most digs vote for


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
class Matching:
    """by_dig : index of the place that each matched dig is. shift_mm : what is added to a dig's z; basis : names,
    places or none. remarks : what a reader of it should know."""

    shift_mm: float
    basis: str
    by_dig: Mapping[int, int]
    remarks: tuple[str, ...] = field(default=())


def match(digs: Sequence[Dig], places: Sequence[SurveyPlace], radius_mm: float, bound_mm: float) -> Matching:
    """radius_mm : of the pipe, which makes a width of an angle. bound_mm : the largest shift there may be.

    Raises AnnulusError where hundreds of places lie within each other's reach.
    """
    named, remarks = _named_shift(digs, places, bound_mm)
    shift, again = _voted_shift(digs, places, radius_mm, bound_mm)
    basis = "places" if shift else "none"
    if named is None:
        remarks += again
    else:
        by_names, by_places = (_agreeing(digs, places, radius_mm, one) for one in (named, shift))
        if by_places > by_names:  # people number their digs by themselves, and call them D1 too
            lie = f"by them {by_names} digs lie on a listed place of their kind, without them {by_places}"
            remarks = [f"names of digs are not followed: {lie}", *again]
        else:
            if by_places == by_names and abs(shift - named) > 2 * GATE_MM:
                remarks.append(f"a shift of {shift:+.0f} mm fits as many digs as {named:+.0f} mm, by names")
            shift, basis = named, "names"
    paired = _paired(digs, places, radius_mm, shift)
    apart = [places[j].z_mm - digs[i].z_mm for i, j in paired.items() if digs[i].kind is not DugKind.SOUND]
    if basis != "names" and len(apart) > 1 and abs(float(np.median(apart))) <= bound_mm:
        shift, basis = float(np.median(apart)), "places"
        paired = _paired(digs, places, radius_mm, shift)
    return Matching(shift, basis, paired, tuple(remarks))


def as_truth(dig: Dig, shift_mm: float) -> TrueDefect:
    """A dig as it lies in the survey."""
    z = dig.z_mm + shift_mm
    return TrueDefect(dig.name, dig.kind.value, z, dig.clock_deg, dig.depth_mm, dig.length_mm, dig.width_mm, laid=False)


def _paired(digs: Sequence[Dig], places: Sequence[SurveyPlace], radius_mm: float, shift_mm: float) -> dict[int, int]:
    reports = [
        Reported(
            one.kind,
            one.z_mm,
            one.clock_deg,
            length_mm=one.length_mm,
            arc_deg=360.0 if one.kind == DugKind.OVALITY else one.arc_deg,  # its clock is that of its long axis
            listed=not one.undecided,
        )
        for one in places
    ]
    return dict(pairs([as_truth(one, shift_mm) for one in digs], reports, radius_mm))


def _agreeing(digs: Sequence[Dig], places: Sequence[SurveyPlace], radius_mm: float, shift_mm: float) -> int:
    """How many digs find a place of their kind."""
    found = _paired(digs, places, radius_mm, shift_mm).items()
    return sum(digs[i].kind in (DugKind.ANY, places[j].kind) for i, j in found)


def _named_shift(digs: Sequence[Dig], places: Sequence[SurveyPlace], bound_mm: float) -> tuple[float | None, list[str]]:
    named = {one.name: one for one in places}
    apart = [(one, named[one.name].z_mm - one.z_mm) for one in digs if one.name in named]
    beyond = [
        f"dig {one.name} lies {abs(by):.0f} mm from the survey's {one.name}" for one, by in apart if abs(by) > bound_mm
    ]
    kept = [by for _, by in apart if abs(by) <= bound_mm]
    return (float(np.median(kept)) if kept else None), beyond


def _voted_shift(
    digs: Sequence[Dig], places: Sequence[SurveyPlace], radius_mm: float, bound_mm: float
) -> tuple[float, list[str]]:
    """The shift at which two digs or more, and more than without any, find a place of their kind; else 0."""

    apart = _apart(digs, places, bound_mm)
    if not len(apart):
        return 0.0, []
    last = np.searchsorted(apart, apart + 2 * GATE_MM, side="right")
    first = np.argsort(np.arange(len(apart)) - last, kind="stable")[:SHIFTS_TRIED]
    tried = sorted({float(np.median(apart[i : last[i]])) for i in first}, key=abs)
    counts = [(_agreeing(digs, places, radius_mm, shift), shift) for shift in tried]
    most, best = max(counts, key=lambda one: (one[0], -abs(one[1])))
    if most < 2 or most <= _agreeing(digs, places, radius_mm, 0.0):
        return 0.0, []
    rival = next((s for votes, s in counts if votes == most and abs(s - best) > 2 * GATE_MM), None)
    return best, [] if rival is None else [f"a shift of {rival:+.0f} mm fits as many digs as {best:+.0f} mm"]


def _apart(digs: Sequence[Dig], places: Sequence[SurveyPlace], bound_mm: float) -> FloatArray:
    """How far listed places lie behind the dug defects near them, in order, mm."""
    z = np.sort(np.array([one.z_mm for one in places]))
    near = [
        z[np.searchsorted(z, one.z_mm - bound_mm) : np.searchsorted(z, one.z_mm + bound_mm, side="right")] - one.z_mm
        for one in digs
        if one.kind is not DugKind.SOUND
    ]
    return np.sort(np.concatenate(near)) if near else np.empty(0)
