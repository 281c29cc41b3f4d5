"""Anomalies and features as lines, in the column order of the Pipeline Operators Forum.

The order is that of the example pipe tally in the POF's "Specifications and requirements for in-line inspection of
pipelines", edition 2016, appendix 6. Those pages are of steel: what a camera inside a plastic pipe does not know
(thickness, seam, coordinates, ERF, class by thickness) keeps its column, empty. Columns of our own stand after the last
of theirs.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import time

import numpy as np

from annulus_pipe.export.results import Results
from annulus_pipe.numeric.rounding import (
    ARC,
    AREA,
    DISTANCE,
    EXTENT,
    MEASURE,
    PERCENT,
    Quantity,
    clock_face,
    digits,
    digits_k2,
    quoted,
)
from annulus_pipe.storage.results_folder import ListedPlace

EDITION = (
    "Pipeline Operators Forum, Specifications and requirements for in-line inspection of pipelines, edition 2016, "
    "appendix 6 (example of a pipe tally)"
)

Cell = str | float | int | time | None


@dataclass(frozen=True, slots=True)
class Column:
    """heading: with its unit. quantity: how its numbers are rounded, None of texts, counts and times. form: how a
    spreadsheet shows them."""

    heading: str
    quantity: Quantity | None = None
    form: str = "@"

    @classmethod
    def of(cls, heading: str, quantity: Quantity) -> "Column":
        return cls(heading, quantity, f"0.{'0' * quantity.places}".rstrip("."))


METRES = Quantity("m", DISTANCE.places)  # a cell along the pipe is in metres already
POF = (
    Column.of("Log distance [m]", METRES),
    Column("Latitude"),
    Column("Longitude"),
    Column("Altitude [m]"),
    Column("Feature type"),
    Column("Feature identification"),
    Column("Comment / Cluster ID"),
    Column("Girth weld Nr", form="0"),
    Column("Joint manufacturing type"),
    Column.of("Joint / component length [m]", METRES),
    Column.of("Internal diameter [mm]", MEASURE),
    Column("Nominal thickness [mm]"),
    Column("Measured/reference thickness [mm]"),
    Column.of("Ovality [%]", PERCENT),
    Column("Bend Y/N"),
    Column.of("Abs. dist. to upstream weld [m]", METRES),
    Column("Clock position seam weld / anomaly [hh:mm]", form="hh:mm"),
    Column("Surface location"),
    Column("Inward/outward"),
    Column.of("Depth / height [mm]", MEASURE),
    Column("Size (length x width) [mm]"),
    Column("Mean depth [mm]"),
    Column.of("Max. depth [mm]", MEASURE),
    Column.of("Length [mm]", EXTENT),
    Column.of("Width [mm]", EXTENT),
    Column("Anomaly dimension classification"),
    Column("ERF (metal losses)"),
    Column("Reference table for performance"),
    Column("Comments"),
)
OURS = (
    Column("No."),
    Column.of("Depth k=2 [mm]", MEASURE),
    Column("Depth is at least"),
    Column.of("From [m]", METRES),
    Column.of("To [m]", METRES),
    Column("Clock from [hh:mm]", form="hh:mm"),
    Column("Clock to [hh:mm]", form="hh:mm"),
    Column.of("Arc [deg]", ARC),
    Column.of("Area [mm2]", AREA),
    Column.of("Hidden length [mm]", EXTENT),
    Column("Severity"),
)
COLUMNS = POF + OURS
_TYPES = {  # the POF's words where it has one
    "loss": ("Anomaly", "Wall loss"),
    "bump": ("Anomaly", "Bump"),
    "ovality": ("Anomaly", "Ovality"),
    "joint": ("Joint", "Joint"),
    "gap": ("Joint", "Gap in a coupling"),
    "branch": ("Off take", "Branch"),
    "tee": ("Tee", "Tee"),
    "bend": ("Bend", "Bend"),
}


def clock_time(angle_deg: float) -> time:
    """Clock position to 5 minutes of the dial, as the report has it, from 00:00 at the top: 100 -> 03:20."""
    hours, minutes = map(int, clock_face(angle_deg).split(":"))
    return time(hours % 12, minutes)


def tally(results: Results) -> list[list[Cell]]:
    """The lines, in order of distance: one for each defect, undecided place and feature; cells as `COLUMNS`."""
    joints = sorted((one for one in results.features if one.kind == "joint"), key=lambda one: one.z_mm)
    bends = [one for one in results.features if one.kind == "bend"]
    named = [(f"D{i + 1}", one, "") for i, one in enumerate(results.defects)]
    named += [(f"U{i + 1}", one, "undecided: not surely there") for i, one in enumerate(results.undecided)]
    named += [(f"F{i + 1}", one, "") for i, one in enumerate(results.features)]
    named.sort(key=lambda item: item[1].z_mm)
    return [[*_theirs(one, note, results, joints, bends), *_own(name, one)] for name, one, note in named]


def _theirs(
    one: ListedPlace, note: str, results: Results, joints: Sequence[ListedPlace], bends: Sequence[ListedPlace]
) -> list[Cell]:
    kind, identity = _TYPES.get(one.kind, (one.kind.capitalize(), one.kind.capitalize()))
    if one.kind == "joint" and "fusion" in one.remark:
        kind = "Weld"  # a socket's joint is none
    before = [joint for joint in joints if joint.z_mm < one.z_mm]
    number = joints.index(one) + 1 if one.kind == "joint" else None
    length = joints[number].z_mm - one.z_mm if number is not None and number < len(joints) else None
    ovality = results.station_at("shape_ovality_f1216_percent", one.z_from_mm, one.z_to_mm)
    loss, swelling = one.kind == "loss", one.kind == "bump"
    width = math.radians(one.arc_deg) * results.radius_mm
    sized = kind == "Anomaly"
    remarks = [one.remark, *(_measure(*measure) for measure in one.measures)]
    if not one.floor_seen:
        remarks.append("its deepest point was not seen")
    cells: list[Cell] = [None] * len(POF)
    cells[0] = one.z_mm / 1000
    cells[4:7] = [kind, identity, note or None]
    cells[7] = number
    cells[9] = None if length is None else length / 1000
    cells[10] = results.nominal_mm
    cells[13] = float(np.max(ovality)) if one.kind == "ovality" and len(ovality) else None
    cells[14] = "Y" if any(bend.z_from_mm <= one.z_mm <= bend.z_to_mm for bend in bends) else "N"
    cells[15] = (one.z_mm - before[-1].z_mm) / 1000 if before else None
    cells[16] = None if one.is_all_round and one.kind != "ovality" else clock_time(one.clock_deg)
    cells[17] = "Int" if loss or swelling else None
    cells[18] = "Inw" if swelling else None
    cells[19] = None if loss or not sized else one.depth_mm
    cells[20] = f"{digits(one.length_mm, EXTENT)}x{digits(width, EXTENT)}" if swelling else None
    cells[22] = one.depth_mm if loss else None
    cells[23] = one.length_mm if sized or one.length_mm else None
    cells[24] = width if loss or swelling else None
    cells[28] = "; ".join(text for text in remarks if text) or None
    return cells


def _measure(name: str, value: float, k2: float | None) -> str:
    what, _, unit = name.rpartition("_")
    return f"{what.replace('_', ' ')} {quoted(value, Quantity(unit, MEASURE.places), k2)}"


def _own(name: str, one: ListedPlace) -> list[Cell]:
    half = one.arc_deg / 2
    known = not one.is_all_round
    return [
        name,
        None if one.depth_k2_mm is None else float(digits_k2(one.depth_k2_mm, MEASURE)),
        None if one.floor_seen else "Y",
        one.z_from_mm / 1000,
        one.z_to_mm / 1000,
        clock_time(one.clock_deg - half) if known else None,
        clock_time(one.clock_deg + half) if known else None,
        one.arc_deg,
        one.area_mm2,
        one.hidden_mm,
        one.severity or None,
    ]
