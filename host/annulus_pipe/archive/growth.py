"""What grew between two scans, place by place, with what it may be off (k = 2), and where no growth can be told.

Growth is the height of a floor fitted to the difference of both maps; a place is listed as grown where it stands out of
everything that differs for other reasons and is more than LEAST_MM. A defect of either year without such a floor gets
the growth of its own shape, and the verdict that no change can be told, or that one of the scans did not see it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from annulus_pipe.archive.difference import Difference, Laid
from annulus_pipe.archive.floors import BAR_SIGMA, Floor, FloorSearch
from annulus_pipe.numeric.arrays import Float32Array

LEAST_MM = 0.15  # two heads, calibrated apart, and what lies between rows, make up to this much; benchmark `growth`
OWN_SHAPE_MM = 0.2  # .. by the shape of a defect that is there: its steep sides take part in what lies between rows
DEFECT_BELLS_MM = (8.0, 20.0)
DEFECT_MM = 0.3  # from which on what stands out of one map is listed as a defect
SHARED_MM = 0.015  # k = 1: of two calibrations, whatever the noise
SHARED_PART = 0.02  # of a height, k = 1: of its floor's shape, whatever the noise
SKIRT_PART = 0.4  # of the higher one's height
ROWS_LEAST = 2.5  # rows that growth must be long
# What lies at a defect's side is its own flank, and no defect, where it is less than all three:
SIDE_PART = 0.2  # of the defect's depth
SIDE_SIZE = 0.6  # of its length or arc
SIDE_CELLS = 5.0  # cells, whatever its size: noise is not larger
DISPLACED_MM = 3.0  # from which on rows are off
SAME_SIZE = 1.4  # by so much a defect's sizes may differ and be the same
TORN_MM = 12.0  # from a defect's end to a slip
SEEN_MIN = 0.35  # of a defect, in both
ABSENT_MM = 0.15  # a depth below it is none: of a new defect before, of one that is gone after ..
ABSENT_PART = 0.2  # .. and so is one below this part of what it is in the other year


class GrowthVerdict(StrEnum):
    """What two scans say of one place."""

    NEW = "new"
    GROWN = "grown"
    LESS = "less"
    GONE = "gone"
    SAME = "no change that can be told"
    UNSEEN = "not seen in both"
    UNDECIDED = "undecided"


CHANGED = (GrowthVerdict.NEW, GrowthVerdict.GROWN, GrowthVerdict.LESS, GrowthVerdict.GONE)


@dataclass(frozen=True, slots=True)
class Change:
    """One place, in the first's z and clock. Depths and growth outwards positive: a loss is positive, a dent negative,
    and both grow away from 0. length and arc: at 1/e of the depth. NaN where nobody knows. first, second: what it is
    called in each report, "" where that has none."""

    z_mm: float
    clock_deg: float
    length_mm: float
    arc_deg: float
    depth_first_mm: float
    depth_second_mm: float
    growth_mm: float
    growth_k2_mm: float
    verdict: GrowthVerdict
    first: str = ""
    second: str = ""

    @property
    def called(self) -> str:
        """In both reports; "" where neither lists it."""
        if not (self.first or self.second):
            return ""
        return f"{self.first or 'not listed'} then, {self.second or 'not listed'} now"


@dataclass(frozen=True, slots=True)
class Growth:
    """changes: every defect of either year, along the pipe. least_mm (Z, A): the smallest growth that could be told of
    a place of 25 mm there; infinite where one did not see. Its median and worst twentieth over what both saw."""

    changes: tuple[Change, ...]
    least_mm: Float32Array
    least_median_mm: float
    least_p95_mm: float
    seen_fraction: float


def grown(
    laid: Laid, progress: Callable[[str, int, int], None], listed: Sequence[tuple[int, Floor]] = ()
) -> tuple[Growth, Difference]:
    """Everything that two scans laid together say, and the difference it was read from. listed: places that others saw
    a defect at, of the second (0) or the first (1), of which something must be said."""
    what = "measuring growth"
    progress(what, 0, 5)
    difference = laid.difference()
    z, column = difference.z_mm, difference.column_mm
    defects: list[tuple[int, Floor]] = []
    for year, field in enumerate((difference.second, difference.first)):
        found = FloorSearch(field, difference.sigma_of(year), z, column, DEFECT_BELLS_MM).floors(DEFECT_MM)
        defects += [(year, floor) for floor in found]
        progress(what, 1 + year, 5)
    # what grew, and where it may have, has taken part in what each row was said to have on the whole
    rough = FloorSearch(difference.grown, difference.sigma, z, column).floors(LEAST_MM)
    progress(what, 3, 5)
    if rough or defects:
        difference = laid.difference(_standing([*rough, *(floor for _, floor in defects)]))
    search = FloorSearch(difference.grown, difference.sigma, z, column)
    least = np.maximum(search.least_mm, LEAST_MM).astype(np.float32)
    changed = search.floors(LEAST_MM)
    progress(what, 4, 5)
    changes, covered, between = [], [], []
    pairs = _pairs(defects)
    for one, other in pairs:
        if abs(one.z_mm - other.z_mm) > DISPLACED_MM:
            changes.append(_by_heights(one, other))
            covered += [one, other]
    changed = [floor for floor in changed if not any(one.holds(floor.z_mm, floor.clock_deg, 1.5) for one in covered)]
    for floor in changed:
        k2 = _k2(floor.sigma_mm, floor.height_mm)
        if abs(floor.height_mm) <= max(LEAST_MM, k2):
            continue
        if _between_rows(floor, defects, difference.step_mm, difference.column_deg):
            between.append(floor)
            continue
        if _torn(floor, defects, laid.torn_mm):
            continue
        before = _height(difference.first, difference, floor)
        after = before + floor.height_mm
        changes.append(_change(floor, before, after, floor.height_mm, k2, _verdict(before, after)))
        covered.append(floor)
    for one, other in pairs:  # steep ones, of which the difference is mostly what lies between rows
        if any(one.holds(floor.z_mm, floor.clock_deg) for floor in between) and not any(
            floor.holds(one.z_mm, one.clock_deg) or one.holds(floor.z_mm, floor.clock_deg) for floor in covered
        ):
            change = _by_heights(one, other)
            own = _along(difference.grown, difference.sigma, difference, one)[0]
            if change.verdict in CHANGED and own * np.sign(change.growth_mm) > LEAST_MM / 2:
                changes.append(change)
                covered += [one, other]
    for year, floor in (*defects, *listed):
        if not any(one.holds(floor.z_mm, floor.clock_deg) or floor.holds(one.z_mm, one.clock_deg) for one in covered):
            alone = all(abs(one.z_mm - floor.z_mm) > one.length_mm / 2 for one in covered)
            lost = bool(laid.lost[int(np.argmin(np.abs(difference.z_mm - floor.z_mm)))])
            change = _unchanged(
                difference, floor, year, alone, GrowthVerdict.UNDECIDED if lost else GrowthVerdict.UNSEEN
            )
            if _torn(floor, defects, laid.torn_mm) and change.verdict is not GrowthVerdict.UNSEEN:
                change = replace(change, growth_mm=np.nan, growth_k2_mm=np.nan, verdict=GrowthVerdict.UNDECIDED)
            changes.append(change)
            covered.append(floor)
    progress(what, 5, 5)
    seen = np.isfinite(difference.grown)
    known = least[np.isfinite(least) & seen]
    median, p95 = (float(np.percentile(known, q)) for q in (50, 95)) if known.size else (np.nan, np.nan)
    changes.sort(key=lambda one: one.z_mm)
    return Growth(tuple(changes), least, median, p95, float(seen.mean())), difference


def _pairs(defects: list[tuple[int, Floor]]) -> list[tuple[Floor, Floor]]:
    """Defects of the first and of the second that are one by their place and shape. Where they lie a little beside each
    other rows are off, and their difference would say that one is gone and another new."""
    second, first = ([floor for k, floor in defects if k == year] for year in (0, 1))

    def alike(one: Floor, other: Floor) -> bool:
        sizes = one.length_mm / other.length_mm, one.arc_deg / other.arc_deg
        return (
            one.height_mm * other.height_mm > 0
            and one.off_deg(other.clock_deg) < (one.arc_deg + other.arc_deg) / 8
            and abs(one.z_mm - other.z_mm) < (one.length_mm + other.length_mm) / 2
            and all(1 / SAME_SIZE < size < SAME_SIZE for size in sizes)
        )

    every = [(one, other) for one in first for other in second if alike(one, other)]
    out: list[tuple[Floor, Floor]] = []
    for one, other in sorted(every, key=lambda pair: abs(pair[0].z_mm - pair[1].z_mm)):
        if not any(one is taken or other is used for taken, used in out):
            out.append((one, other))
    return out


def _by_heights(one: Floor, other: Floor) -> Change:
    """Of a defect of the first and the same of the second, each as deep as its own map says."""
    growth, sigma = other.height_mm - one.height_mm, float(np.hypot(one.sigma_mm, other.sigma_mm))
    k2 = _k2(sigma, max(abs(one.height_mm), abs(other.height_mm)))
    if abs(growth) > max(LEAST_MM, k2):
        return _change(one, one.height_mm, other.height_mm, growth, k2, _verdict(one.height_mm, other.height_mm))
    return _change(one, one.height_mm, other.height_mm, growth, k2, GrowthVerdict.SAME)


def _standing(floors: list[Floor]) -> list[Floor]:
    """Without those that a higher one in the same rows may have made, by what it took part in."""
    return [
        one
        for one in floors
        if not any(
            abs(one.height_mm) < SKIRT_PART * abs(other.height_mm)
            and abs(one.z_mm - other.z_mm) < (one.length_mm + other.length_mm) / 2
            and not other.holds(one.z_mm, one.clock_deg)
            for other in floors
        )
    ]


def _torn(floor: Floor, defects: list[tuple[int, Floor]], torn_mm: Sequence[float]) -> bool:
    """Whether it lies at a defect that a slip goes through, or beside, and nothing but the defect says where."""
    return any(
        one.holds(floor.z_mm, floor.clock_deg, 1.8)
        and any(abs(at - one.z_mm) < one.length_mm / 2 + TORN_MM for at in torn_mm)
        for _, one in defects
    )


def _between_rows(floor: Floor, defects: list[tuple[int, Floor]], step_mm: float, column_deg: float) -> bool:
    """Whether it may be no more than what lies between rows: of a bead, or at a steep defect's side."""
    if floor.length_mm < ROWS_LEAST * step_mm:
        return True
    return any(
        one.holds(floor.z_mm, floor.clock_deg, 1.8)
        and abs(floor.height_mm) < SIDE_PART * abs(one.height_mm)
        and (
            floor.length_mm < min(SIDE_SIZE * one.length_mm, SIDE_CELLS * step_mm)
            or floor.arc_deg < min(SIDE_SIZE * one.arc_deg, SIDE_CELLS * column_deg)
        )
        for _, one in defects
    )


def _k2(sigma_mm: float, height_mm: float) -> float:
    return float(2 * np.sqrt(sigma_mm**2 + SHARED_MM**2 + (SHARED_PART * height_mm) ** 2))


def _change(floor: Floor, before: float, after: float, growth: float, k2: float, verdict: GrowthVerdict) -> Change:
    return Change(floor.z_mm, floor.clock_deg, floor.length_mm, floor.arc_deg, before, after, growth, k2, verdict)


def _verdict(before: float, after: float) -> GrowthVerdict:
    if abs(before) < max(ABSENT_MM, ABSENT_PART * abs(after)):
        return GrowthVerdict.NEW
    if abs(after) < max(ABSENT_MM, ABSENT_PART * abs(before)):
        return GrowthVerdict.GONE
    return GrowthVerdict.GROWN if abs(after) > abs(before) else GrowthVerdict.LESS


def _unchanged(difference: Difference, floor: Floor, year: int, alone: bool, otherwise: GrowthVerdict) -> Change:
    """A defect of the second (year 0) or the first alone: its growth by its own shape, or the
    verdict `otherwise` where too little of it was seen to tell."""
    growth, sigma, share = _along(difference.grown, difference.sigma, difference, floor)
    before, after = _height(difference.first, difference, floor), _height(difference.second, difference, floor)
    if share < SEEN_MIN:
        before, after = (np.nan, floor.height_mm) if year == 0 else (floor.height_mm, np.nan)
        return _change(floor, before, after, np.nan, np.nan, otherwise)
    k2 = _k2(sigma, growth)
    if alone and abs(growth) > max(OWN_SHAPE_MM, 3 * k2):  # where a floor of its own could not be fitted
        return _change(floor, before, after, growth, k2, _verdict(before, after))
    return _change(floor, before, after, growth, max(k2, abs(growth)), GrowthVerdict.SAME)  # it may be nothing


def _height(field: Float32Array, difference: Difference, floor: Floor) -> float:
    return _along(field, np.ones_like(difference.sigma), difference, floor)[0]


def _along(
    field: Float32Array, sigma: Float32Array, difference: Difference, floor: Floor
) -> tuple[float, float, float]:
    """Height of a floor's shape in a field, its sigma, and the share of the shape that was seen. NaN of none."""
    z, clock = difference.z_mm, np.asarray(difference.column_deg * np.arange(field.shape[1]), np.float64)
    rows = np.flatnonzero(np.abs(z - floor.z_mm) <= floor.length_mm)
    columns = np.flatnonzero(np.abs((clock - floor.clock_deg + 180) % 360 - 180) <= min(floor.arc_deg, 180.0))
    at = np.ix_(rows, columns)
    shape = floor.shape(z[rows], clock[columns])
    value = field[at].astype(np.float64)
    seen = np.isfinite(value) & np.isfinite(sigma[at])
    share = float((shape * seen).sum() / max(shape.sum(), 1e-9))
    if seen.sum() < 6:
        return np.nan, np.nan, share
    weight = 1.0 / np.square(sigma[at][seen].astype(np.float64))
    design = np.stack([shape[seen], np.ones(int(seen.sum()))], axis=1)
    normal = design.T @ (weight[:, None] * design) + 1e-9 * weight.mean() * np.eye(2)
    solved = np.linalg.solve(normal, design.T @ (weight * value[seen]))
    return float(solved[0]), float(np.sqrt(np.linalg.inv(normal)[0, 0])), share


__all__ = ["BAR_SIGMA", "CHANGED", "Change", "Growth", "GrowthVerdict", "grown"]
