"""Defects that the summaries of both folders of results list, on the first's z and clock, and which change is whose.

A defect is called as in its report: D3. Every one comes out: paired with the other year's by what lies at its place,
with its growth, or with the verdict that it is new, gone, or not seen in both. Ovality is told by its stations.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from annulus_pipe.archive.alignment import Alignment
from annulus_pipe.archive.floors import SHAPE, Floor
from annulus_pipe.archive.growth import LEAST_MM, Change, GrowthVerdict
from annulus_pipe.archive.ovality import Ovality
from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.storage.results_folder import SUMMARY, ListedPlace, places, read_summary, unreadable

SLACK_DEG = 5.0  # round, beside half an arc, by which two programs see a defect's middle otherwise
OVAL, BUMP = "ovality", "bump"  # kinds, as a summary calls them


@dataclass(frozen=True, slots=True)
class Listed:
    """year: 0 the first's, 1 the second's. name: D3. floor: on the first; slack_mm: what its place may be off; inside:
    whether the first has rows there."""

    year: int
    name: str
    kind: str
    floor: Floor
    slack_mm: float
    inside: bool

    @property
    def all_round(self) -> bool:
        return self.floor.arc_deg >= 360.0

    def lies_at(self, one: Change) -> bool:
        return (
            abs(one.z_mm - self.floor.z_mm) <= max(one.length_mm, self.floor.length_mm) / 2 + self.slack_mm
            and self.floor.off_deg(one.clock_deg) <= max(one.arc_deg, self.floor.arc_deg) / 2 + SLACK_DEG
        )


def read_listed(folder: Path) -> tuple[ListedPlace, ...]:
    """Defects of a folder's summary.json; none of a map alone. AnnulusError, one line, for a file that is none."""
    if not (folder.is_dir() and (folder / SUMMARY).exists()):
        return ()
    try:
        return places(read_summary(folder), "defects")
    except (OSError, ValueError) as error:
        raise unreadable(folder / SUMMARY, error) from None


def laid_out(
    first: Sequence[ListedPlace], second: Sequence[ListedPlace], wall: WallMap, alignment: Alignment
) -> list[Listed]:
    """Both lists on the first. wall: the second's map."""
    out = [Listed(0, f"D{k}", one.kind, _floor(one), 0.0, True) for k, one in enumerate(first, 1)]
    known = np.flatnonzero(np.isfinite(alignment.z_mm))
    z, place = wall.z_mm[known], alignment.z_mm[known]
    roll, k2 = np.unwrap(alignment.roll_deg[known], period=360.0), 2 * alignment.sigma_z_mm[known]
    way = -1.0 if alignment.reversed else 1.0
    for k, one in enumerate(second, 1):
        floor = _floor(one)
        beyond = floor.z_mm - float(np.clip(floor.z_mm, z[0], z[-1]))
        there = float(np.interp(floor.z_mm, z, place)) + way * alignment.scale * beyond
        clock = float(np.interp(floor.z_mm, z, roll)) + way * floor.clock_deg
        out.append(
            Listed(
                1,
                f"D{k}",
                one.kind,
                replace(floor, z_mm=there, clock_deg=clock % 360.0),
                float(np.interp(floor.z_mm, z, k2)),
                beyond == 0.0,
            )
        )
    return out


def _floor(one: ListedPlace) -> Floor:
    depth = one.depth_mm or 0.0
    return Floor(
        one.z_mm,
        one.clock_deg,
        max(one.length_mm, 1.0),
        max(one.arc_deg, 1.0),
        -depth if one.kind == BUMP else depth,
        SHAPE,
        math.nan,
        math.nan,
    )


def named(changes: Sequence[Change], listed: Sequence[Listed], oval: Ovality, radius_mm: float) -> tuple[Change, ...]:
    """All changes with the names of the listed defects that lie there, and one more for what no change of the wall's
    detail can tell of: ovality, by its stations; what goes all round; what lies beyond the first's ends."""
    rows: list[tuple[Change, tuple[list[str], list[str]]]] = [(change, ([], [])) for change in changes]
    apart: list[tuple[Listed, int]] = []
    for one in listed:
        at = [] if one.all_round else [k for k in range(len(changes)) if one.lies_at(rows[k][0])]
        if not at:
            at = [k for other, k in apart if (other.year, other.kind) == (0, one.kind) and one.lies_at(rows[k][0])][:1]
        if not at:
            at = [len(rows)]
            apart.append((one, at[0]))
            rows.append((_of_ovality(one, oval, radius_mm) if one.kind == OVAL else _untold(one), ([], [])))
        for k in at:
            rows[k][1][one.year].append(one.name)
    whole = [replace(change, first=" ".join(mine), second=" ".join(theirs)) for change, (mine, theirs) in rows]
    return tuple(sorted(whole, key=lambda change: change.z_mm))


def _untold(one: Listed) -> Change:
    floor = one.floor
    depths = (floor.height_mm, math.nan) if one.year == 0 else (math.nan, floor.height_mm)
    verdict = GrowthVerdict.UNDECIDED if one.inside else GrowthVerdict.UNSEEN
    return Change(floor.z_mm, floor.clock_deg, floor.length_mm, floor.arc_deg, *depths, math.nan, math.nan, verdict)


def _of_ovality(one: Listed, oval: Ovality, radius_mm: float) -> Change:
    """Depth and growth are of a diameter from the mean diameter, as a report says them."""
    at = oval.at(one.floor.z_mm, one.floor.length_mm / 2)
    if at is None:
        return replace(_untold(one), verdict=GrowthVerdict.UNSEEN)
    then, now, k2 = (float(part[at]) * radius_mm / 50.0 for part in (oval.first, oval.second, oval.change_k2))
    stands = abs(now - then) > max(LEAST_MM, k2)
    verdict = (GrowthVerdict.GROWN if now > then else GrowthVerdict.LESS) if stands else GrowthVerdict.SAME
    return replace(
        _untold(one),
        depth_first_mm=then,
        depth_second_mm=now,
        growth_mm=now - then,
        growth_k2_mm=k2 if stands else max(k2, abs(now - then)),
        verdict=verdict,
    )
