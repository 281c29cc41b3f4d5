"""Two scans of one pipe compared: read, aligned, measured, and said as a value, as JSON and in words."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.archive.alignment import Alignment, align
from annulus_pipe.archive.difference import LOST_MM, Difference, lay
from annulus_pipe.archive.growth import CHANGED, Change, Growth, GrowthVerdict, grown
from annulus_pipe.archive.listed import laid_out, named, read_listed
from annulus_pipe.archive.ovality import MeanDiameter, Ovality, mean_diameter, ovality
from annulus_pipe.archive.wall_map import WallMap, read_map
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.rounding import DISTANCE, MEASURE, PERCENT, off, quoted, span
from annulus_pipe.storage.results_folder import ListedPlace

FORMAT = "annulus-growth/1"
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Comparison:
    """first, second as read; alignment of the second on the first; growth; difference on the first's grid; ovality;
    the mean diameter."""

    first: WallMap
    second: WallMap
    alignment: Alignment
    growth: Growth
    difference: Difference
    ovality: Ovality
    diameter: MeanDiameter

    @property
    def changed(self) -> list[Change]:
        return [one for one in self.growth.changes if one.verdict in CHANGED]

    @property
    def overlap_mm(self) -> tuple[float, float]:
        """From where to where on the first both saw the wall."""
        seen = np.flatnonzero(np.isfinite(self.difference.grown).any(axis=1))
        return (
            (float(self.first.z_mm[seen[0]]), float(self.first.z_mm[seen[-1]])) if len(seen) else (math.nan, math.nan)
        )

    def sentence(self) -> str:
        """What these two scans say, for people."""
        least = f"the smallest growth that could be told is {off(self.growth.least_median_mm, MEASURE)}"
        if not self.changed:
            return f"No growth that these two scans could tell; {least}."
        kinds = [one.verdict for one in self.changed]
        counted = ", ".join(f"{kinds.count(kind)} {kind}" for kind in CHANGED if kind in kinds)
        return f"{len(kinds)} place{'s' if len(kinds) > 1 else ''} changed ({counted}); {least}."

    def ovality_sentence(self) -> str:
        """Where ovality changed most."""
        oval, at = self.ovality, self.ovality.worst
        if at is None:
            return "Ovality: no station was seen by both."
        remark = " and that is no more than may be off" if abs(oval.change[at]) <= oval.change_k2[at] else ""
        return (
            f"Ovality changed most at {quoted(oval.z_mm[at], DISTANCE)}, from {quoted(oval.first[at], PERCENT)} to "
            f"{quoted(oval.second[at], PERCENT)}, by {quoted(oval.change[at], PERCENT, oval.change_k2[at])}{remark}."
        )

    def diameter_sentence(self) -> str:
        """What the pipe's size did, as far as two heads that drift each by its own can tell."""
        one = self.diameter
        if not math.isfinite(one.change):
            return "Mean diameter: no row was seen by both."
        proviso = "" if one.is_sure else ", and that is no more than the two scans' scales may be off"
        if math.isnan(one.change_k2):
            proviso = "; one of the two does not say how sure its scale is, so nothing follows from that"
        return (
            f"Mean diameter: {quoted(one.first, MEASURE)} then, {quoted(one.second, MEASURE)} now, a change of "
            f"{quoted(one.change, MEASURE, one.change_k2)}{proviso}."
        )

    def remarks(self) -> list[str]:
        """What a reader must know beside: short overlap, direction, places that one did not see."""
        out = []
        if self.alignment.reversed:
            out.append("The second was scanned from the other end: its rows and its clock were turned about.")
        if self.alignment.slips:
            leaps = f"{len(self.alignment.slips)} place{'s' if len(self.alignment.slips) > 1 else ''}"
            out.append(f"One cable slipped against the other at {leaps}.")
        first, last = self.overlap_mm
        z = self.first.z_mm
        if last - first < 0.9 * (z[-1] - z[0]):
            out.append(f"Both saw only {span(first, last, DISTANCE)} of the first; nothing is said of the rest.")
        unseen = sum(one.verdict is GrowthVerdict.UNSEEN for one in self.growth.changes)
        if unseen:
            out.append(f"{unseen} defect{'s' if unseen > 1 else ''} that one scan has lie where the other did not see.")
        undecided = sum(one.verdict is GrowthVerdict.UNDECIDED for one in self.growth.changes)
        if undecided:
            out.append(
                f"{undecided} defect{'s are' if undecided > 1 else ' is'} undecided: nothing says to "
                f"{LOST_MM:.0f} mm where in the other scan to look, or it goes all round, which is not compared."
            )
        return out

    def to_dict(self) -> dict[str, Any]:
        """JSON: z_of_second and roll_of_second for every row of the second, growth of every place that changed, in the
        first's z and clock; null where nobody knows."""
        one, size = self.alignment, self.growth
        first, last = self.overlap_mm
        return {
            "format": FORMAT,
            "first": _about(self.first),
            "second": _about(self.second),
            "frame": "z and clock of the first map; outwards positive",
            "says": self.sentence(),
            "remarks": self.remarks(),
            "second_reversed": one.reversed,
            "overlap_mm": [_number(first), _number(last)],
            "scale_of_second": _number(one.scale, 6),
            "slip_rows_of_second": list(one.slips),
            "agreement_sigma": _number(one.sure, 1),
            "z_k2_median_mm": _number(2 * _median(one.sigma_z_mm)),
            "roll_k2_median_deg": _number(2 * _median(one.sigma_roll_deg)),
            "growth": [_change_dict(change) for change in self.changed],
            "unchanged": [_change_dict(change) for change in size.changes if change.verdict not in CHANGED],
            "ovality": {
                "definition": "ASTM F1216, of the pipe's shape without defects",
                "says": self.ovality_sentence(),
                "z_mm": _numbers(self.ovality.z_mm),
                "first_percent": _numbers(self.ovality.first),
                "second_percent": _numbers(self.ovality.second),
                "change_percent": _numbers(self.ovality.change),
                "change_k2_percent": _numbers(self.ovality.change_k2),
            },
            "diameter": {
                "says": self.diameter_sentence(),
                "first_mm": _number(self.diameter.first),
                "second_mm": _number(self.diameter.second),
                "change_mm": _number(self.diameter.change),
                "change_k2_mm": _number(self.diameter.change_k2),
            },
            "limits": {
                "least_growth_median_mm": _number(size.least_median_mm),
                "least_growth_p95_mm": _number(size.least_p95_mm),
                "seen_by_both_fraction": _number(size.seen_fraction, 4),
            },
            "z_of_second": _numbers(one.z_mm),
            "roll_of_second": _numbers(one.roll_deg),
            "z_of_second_k2_mm": _numbers(2 * one.sigma_z_mm),
            "roll_of_second_k2_deg": _numbers(2 * one.sigma_roll_deg),
        }

    def lines(self) -> list[str]:
        """For a terminal: a line a change, then what may be off."""
        out = [
            f"{one.verdict:<10} {quoted(one.growth_mm, MEASURE, one.growth_k2_mm)} at {quoted(one.z_mm, DISTANCE)}, "
            f"clock {one.clock_deg:.0f}°: {quoted(one.depth_first_mm, MEASURE)} then, "
            f"{quoted(one.depth_second_mm, MEASURE)} now{one.called and f'; {one.called}'}"
            for one in self.changed
        ]
        out += [
            f"{'listed':<10} {one.called} at {quoted(one.z_mm, DISTANCE)}, clock {one.clock_deg:.0f}°: {one.verdict}"
            + (f", within ± {off(one.growth_k2_mm, MEASURE)}" if one.verdict is GrowthVerdict.SAME else "")
            for one in self.growth.changes
            if one.called and one.verdict not in CHANGED
        ]
        out.append(f"says       {self.sentence()}")
        out.append(f"ovality    {self.ovality_sentence().removeprefix('Ovality ')}")
        out.append(f"diameter   {self.diameter_sentence().removeprefix('Mean diameter: ')}")
        out.append(
            f"aligned    ± {2 * _median(self.alignment.sigma_z_mm):.1f} mm along, "
            f"± {2 * _median(self.alignment.sigma_roll_deg):.2f}° round (k=2, median); second's mm are "
            f"{self.alignment.scale:.4f} of the first's"
        )
        return out + [f"remark     {remark}" for remark in self.remarks()]


def compare(first: Path, second: Path, progress: Progress = lambda what, done, total: None) -> Comparison:
    """What grew from the first scan to the second. Paths of wall maps (.npz) or of folders of results.

    Raises AnnulusError, one line, for what is no wall map and for scans that do not belong together.
    """
    lists = read_listed(first), read_listed(second)
    return compare_maps(read_map(first), read_map(second), progress, lists)


def compare_maps(
    first: WallMap,
    second: WallMap,
    progress: Progress = lambda what, done, total: None,
    lists: tuple[Sequence[ListedPlace], Sequence[ListedPlace]] = ((), ()),
) -> Comparison:
    """The same of maps that were read. lists: the defects that a report of each lists."""
    alignment = align(first, second, progress)
    listed = laid_out(*lists, second, alignment)
    laid = lay(first, second, alignment)
    there = [(1 - one.year, one.floor) for one in listed if one.inside and not one.all_round]
    growth, difference = grown(laid, progress, there)
    oval = ovality(difference, laid, (first.oval_part, second.oval_part))
    size = mean_diameter(laid, (first.scale_part, second.scale_part))
    growth = replace(growth, changes=named(growth.changes, listed, oval, first.radius_mm))
    return Comparison(first, second, alignment, growth, difference, oval, size)


def _about(wall: WallMap) -> dict[str, Any]:
    rows, columns = wall.deviation_mm.shape
    return {
        "map": wall.name,
        "rows": rows,
        "columns": columns,
        "z_step_mm": wall.step_mm,
        "radius_mm": wall.radius_mm,
        "seen_fraction": _number(float(np.isfinite(wall.deviation_mm).mean()), 4),
        "has_roll": bool(np.isfinite(wall.imu_roll_deg).any()),
    }


def _change_dict(one: Change) -> dict[str, Any]:
    return {
        "z_mm": _number(one.z_mm, 1),
        "clock_deg": _number(one.clock_deg, 1),
        "growth_mm": _number(one.growth_mm),
        "growth_k2_mm": _number(one.growth_k2_mm),
        "depth_first_mm": _number(one.depth_first_mm),
        "depth_second_mm": _number(one.depth_second_mm),
        "length_mm": _number(one.length_mm, 1),
        "arc_deg": _number(one.arc_deg, 1),
        "verdict": str(one.verdict),
        "listed_first": one.first.split(),
        "listed_second": one.second.split(),
    }


def _number(value: float, places: int = 3) -> float | None:
    return round(float(value), places) if math.isfinite(value) else None


def _numbers(values: FloatArray) -> list[float | None]:
    return [_number(value, 2) for value in values]


def _median(values: Sequence[float] | FloatArray) -> float:
    known = np.asarray(values)[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan
