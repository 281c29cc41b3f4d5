"""The catalogue's tables: what their columns are called, in which unit, what stands in them.

A name ends in its unit: _mm, _mm2, _deg (clockwise from 12 o'clock, looking forward), _percent; _k2_mm is the expanded
uncertainty (k = 2); a name without a unit is a text, a count, a share of 1 or yes and no. NULL: nobody said, or nothing
was measured. The names are kept for ever: queries of others stand on them. New ones are added at the end.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

Kind = Literal["text", "number", "whole", "yes", "date", "time", "measures"]


@dataclass(frozen=True, slots=True)
class CatalogueColumn:
    """`kind`: of its values; time is UTC, measures are names (with unit) and numbers."""

    name: str
    kind: Kind
    means: str


def _columns(kind: Kind, /, **means: str) -> list[CatalogueColumn]:
    return [CatalogueColumn(name, kind, text) for name, text in means.items()]


def _key(of: str) -> list[CatalogueColumn]:
    return [
        CatalogueColumn("survey", "text", f"the survey {of}, 12 hexadecimal digits"),
        CatalogueColumn("pipe", "text", "its pipe, as the job says; NULL where nobody said"),
        CatalogueColumn("date", "date", "day of the scan"),
    ]


SURVEYS: Sequence[CatalogueColumn] = [
    *_key("itself"),
    *_columns(
        "text",
        site="where",
        client="who asked for it",
        operator="who scanned",
        launch="where the head went in",
        receive="where it came out",
        direction="of the scan",
        material="of the pipe",
        remarks="of the operator",
    ),
    *_columns(
        "number",
        sdr="outer diameter over wall thickness",
        job_diameter_mm="nominal diameter that the job names",
        nominal_diameter_mm="against which deviations were measured, of the calibration",
    ),
    *_columns(
        "text",
        head="serial number that the job names",
        controller="serial number of the head's controller",
        firmware="version and commit of what ran on it",
        calibration="whose: the recording's own, or a file's name",
        calibrated="how its sections came about, JSON",
        made_with="version of annulus that made the results",
        recorded_with="version of annulus that recorded",
        source="the scan, as it was named",
        results="folder of the results when they were added",
    ),
    *_columns(
        "time",
        begun_utc="first moment of the scan, by the recording computer's clock",
        ended_utc="its last moment",
        created_utc="when the results were made",
        added_utc="when they were added",
    ),
    *_columns("text", date_of="who says the date: job or recording"),
    *_columns("number", scanned_from_mm="distance along the pipe where the scan begins", scanned_to_mm="where it ends"),
    *_columns("whole", points="of the wall"),
    *_columns(
        "number",
        seen_percent="of the wall",
        hidden_percent="of the wall, behind steps",
        noise_mm="of a point, k = 1",
        diameter_mean_mm="of the pipe",
        diameter_min_mm="least",
        diameter_max_mm="greatest",
        diameter_k2_mm="uncertainty of the mean",
        ovality_f1216_percent="greatest, ASTM F1216, as measured",
        shape_ovality_f1216_percent="greatest, of the fitted shape, without defects",
        depth_limit_mm="a defect as deep is found",
        size_limit_mm="a defect as wide is found",
        ovality_limit_percent="an ovality as great is found",
    ),
    *_columns("text", limits="title of the limits it was held against", decision="by them"),
    *_columns(
        "whole",
        station_count="rows in stations",
        defect_count="rows in defects",
        undecided_count="rows in undecided",
        feature_count="rows in features",
        warning_count="warnings of the reconstruction",
    ),
    *_columns(
        "text",
        scan="what tells its scan from all others; versions of one scan have one",
        replaces="the survey it was said to replace",
        digest="SHA-256 of the contents",
    ),
    *_columns(
        "text",
        not_established="where its verdict is open, JSON: limits, z_from_mm, z_to_mm, clock_deg, arc_deg, reason",
    ),
    *_columns("text", certificate="what its head's certificate states of diameters, or why it states nothing"),
    *_columns("number", accuracy_percent="what diameters keep in 19 of 20 by that certificate; NULL: not established"),
    *_columns("text", detection="what its head's study of detection states, or why it states nothing"),
    *_columns("number", temperature_c="of the pipe, degrees Celsius, as the job says"),
]

STATIONS: Sequence[CatalogueColumn] = [
    *_key("it belongs to"),
    *_columns(
        "number",
        z_mm="distance along the pipe",
        diameter_min_mm="least",
        diameter_max_mm="greatest",
        diameter_mean_mm="mean",
        diameter_k2_mm="uncertainty of a diameter",
        ovality_f1216_percent="ASTM F1216, as measured",
        shape_ovality_f1216_percent="ASTM F1216, of the fitted shape: without defects",
        valid_fraction="share of the circle that was seen",
        diameter_x_mm="from 3 to 9 o'clock",
        diameter_y_mm="from 12 to 6 o'clock",
        circumference_mm="inner",
        circumference_k2_mm="its uncertainty",
        area_mm2="inner",
        area_k2_mm2="its uncertainty",
    ),
]

_PLACE: Sequence[CatalogueColumn] = [
    *_columns("whole", number="in the results: 1 is D1, U1 or F1 of the report"),
    *_columns("text", kind="as summary.json calls it"),
    *_columns(
        "number",
        z_mm="distance of its middle",
        z_from_mm="where it begins",
        z_to_mm="where it ends",
        clock_deg="of its middle",
        arc_deg="round the pipe, 360: all round",
        length_mm="along the pipe",
    ),
]
_JUDGED: Sequence[CatalogueColumn] = _columns("text", severity="by the limits named; NULL without", decision="by them")

DEFECTS: Sequence[CatalogueColumn] = [
    *_key("it belongs to"),
    *_PLACE,
    *_columns(
        "number",
        depth_mm="greatest",
        depth_k2_mm="its uncertainty",
        area_mm2="of the wall",
        hidden_mm="length of it that no light reached",
    ),
    *_columns("yes", floor_seen="no: it is at least as deep", sure="no: undecided"),
    *_JUDGED,
]

FEATURES: Sequence[CatalogueColumn] = [
    *_key("it belongs to"),
    *_PLACE,
    *_columns("text", remark="of the reconstruction"),
    *_JUDGED,
    CatalogueColumn("measures", "measures", "what was measured of it: measures['height_mm'], measures['height_k2_mm']"),
]

TABLES: Mapping[str, Sequence[CatalogueColumn]] = {
    "surveys": SURVEYS,
    "stations": STATIONS,
    "defects": DEFECTS,
    "features": FEATURES,
}
"""As they are stored, a file each."""

SUPERSEDED = CatalogueColumn(
    "superseded_by", "text", "the survey of the same scan that counts in its place; only in all_surveys"
)
JOINT_MEASURES: Mapping[str, str] = {
    "height_mm": "of the bead",
    "height_k2_mm": "its uncertainty",
    "width_mm": "of the bead",
    "width_k2_mm": "its uncertainty",
    "gap_mm": "between the pipes' ends",
    "gap_k2_mm": "its uncertainty",
    "hilo_mm": "one pipe's axis beside the other's",
    "hilo_k2_mm": "its uncertainty",
    "angle_deg": "between the axes",
    "angle_k2_deg": "its uncertainty",
    "step_mm": "of the diameter",
    "step_k2_mm": "its uncertainty",
}
"""Of features that `joints` has as columns of its own."""
JOINT_KINDS = ("joint", "gap")

VIEWS: Mapping[str, str] = {
    "surveys": "one row a survey",
    "stations": "one row a station: every few mm along the pipe",
    "defects": "one row a defect that is sure",
    "joints": "features that are joints and gaps",
    "undecided": "places that may be defects; columns of defects",
    "features": "joints, branches, bends, levels and the rest",
    "all_surveys": "the same as surveys with what was superseded; all_stations, all_defects, all_features likewise",
}
"""What may be asked: views of what counts, and with all_ before their names of everything that was ever added."""
