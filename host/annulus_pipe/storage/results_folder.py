"""The figures of a results folder, as `annulus reconstruct` left it or as somebody changed it: summary.json and
stations.csv, bounded and looked at before anybody believes them. ValueError, one line, for what is wrong in one;
`unreadable` makes of it the line that names the file.
"""

import csv
import io
import math
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.numbers import number as parsed
from annulus_pipe.storage.numbers import require_cells
from annulus_pipe.untrusted import mapping, number, one_line, parse_json, printable, read_file, shown, whole, within
from annulus_pipe.untrusted import text as raw_text
from annulus_pipe.vocabulary import AnnulusError

FORMAT = "annulus-summary/1"
SUMMARY, STATIONS = "summary.json", "stations.csv"
JSON_MAX, CSV_MAX = 1 << 27, 1 << 28  # bytes
MANY_MAX = 1 << 31  # places that one row stands for
PLACES_MAX, STATIONS_MAX = 100_000, 2_000_000  # stations: CSV_MAX of them; 4 mm apart they are 8 km
TEXT_MAX = 2000
MM_MAX = 1e8
# Of a scan's length: so much more than a station's may be missing at an end, for the map of a long pipe, whose ends the
# summary has, is coarser than its stations. Guarded by tests/regression/table_cut_short.
END_PART = 0.001
STATION_COLUMNS = (
    "z_mm",
    "diameter_min_mm",
    "diameter_max_mm",
    "diameter_mean_mm",
    "ovality_f1216_percent",
    "shape_ovality_f1216_percent",
    "valid_fraction",
    "diameter_k2_mm",
)
LATER_COLUMNS = (  # files of before 2026 lack them
    "diameter_x_mm",
    "diameter_y_mm",
    "circumference_mm",
    "circumference_k2_mm",
    "area_mm2",
    "area_k2_mm2",
)
_PLACE = {
    "kind",
    "z_mm",
    "clock_deg",
    "clock",
    "length_mm",
    "arc_deg",
    "z_from_mm",
    "z_to_mm",
    "depth_mm",
    "depth_k2_mm",
    "area_mm2",
    "all_round",
    "floor_seen",
    "hidden_mm",
    "clock_from_to",
    "remark",
    "severity",
}


@dataclass(frozen=True, slots=True)
class ListedPlace:
    """A defect, a feature or an undecided place of summary.json. None where the file says nothing or null.

    measures: of a feature, (name with unit, value, k2).
    """

    kind: str
    z_mm: float
    z_from_mm: float
    z_to_mm: float
    clock_deg: float
    arc_deg: float
    length_mm: float
    depth_mm: float | None = None
    depth_k2_mm: float | None = None
    area_mm2: float | None = None
    hidden_mm: float | None = None
    floor_seen: bool = True
    remark: str = ""
    severity: str = ""
    decision: str = ""
    measures: tuple[tuple[str, float, float | None], ...] = ()

    @property
    def is_all_round(self) -> bool:
        return self.arc_deg >= 360.0


@dataclass(frozen=True, slots=True)
class UnseenStretch:
    """Wall that a scan did not see, of summary.json."""

    z_from_mm: float
    z_to_mm: float
    clock_deg: float
    arc_deg: float


def read_summary(folder: Path) -> Mapping[str, Any]:
    """summary.json of a pipe's results, its form looked at and nothing else of it. Raises OSError and ValueError."""
    summary = mapping(parse_json(read_file(folder / SUMMARY, JSON_MAX), JSON_MAX), "summary")
    if summary.get("format") != FORMAT:
        raise ValueError(f"its format is {shown(summary.get('format'))}, expected {FORMAT}")
    if "scanned_mm" not in summary and "height_mm" in summary:
        raise ValueError("results of a plate; expected those of a pipe")
    return summary


def scanned(summary: Mapping[str, Any]) -> tuple[float, float]:
    """From where to where, mm."""
    ends = mapping(summary.get("scanned_mm"), "scanned_mm")
    first, last = (within(ends.get(name), f"scanned_mm.{name}", -MM_MAX, MM_MAX) for name in ("from", "to"))
    if last < first:
        raise ValueError(f"scanned_mm ends at {last:g}, before it begins at {first:g}")
    return first, last


def read_stations(folder: Path, summary: Mapping[str, Any], optional: Sequence[str] = ()) -> dict[str, FloatArray]:
    """stations.csv: column -> (S,), NaN where empty; z_mm rises. `optional` columns are all NaN where the file has them
    not. summary : of the same folder. Raises OSError and ValueError, also where stations are missing."""
    try:
        text = read_file(folder / STATIONS, CSV_MAX).decode("utf-8-sig")
        columns = _columns(csv.reader(io.StringIO(text, newline=""), strict=True), optional)
        if not text.endswith(("\n", "\r")):  # the last number may be half of one
            raise ValueError("its last line has no end: it was cut short")
        _require_all(columns["z_mm"], summary)
        return columns
    except UnicodeDecodeError:
        raise ValueError("not a text file") from None
    except csv.Error as error:
        raise ValueError(f"not a table: {error}") from None


def _columns(rows: Any, optional: Sequence[str]) -> dict[str, FloatArray]:
    head: list[str] = next(rows, [])
    missing = [name for name in STATION_COLUMNS if name not in head]
    if missing:
        raise ValueError(f"has no column {missing[0]}")
    names = [*STATION_COLUMNS, *(name for name in optional if name in head)]
    at, values = [head.index(name) for name in names], array("d")
    for count, row in enumerate((row for row in rows if row), start=1):
        if count > STATIONS_MAX:
            raise ValueError(f"has more than {STATIONS_MAX} rows")
        try:
            require_cells(row, len(head))
        except ValueError as error:
            raise ValueError(f"line {rows.line_num}: {error}") from None
        values.extend(parsed(row[i]) for i in at)
        z = values[-len(at)]
        if not math.isfinite(z) or abs(z) > MM_MAX:
            raise ValueError(f"line {rows.line_num}: z_mm is {shown(row[at[0]])}, expected a number")
    table = np.frombuffer(values, dtype=np.float64).reshape(-1, len(at)).copy()
    table[~(np.abs(table) <= MM_MAX)] = np.nan
    if (np.diff(table[:, 0]) <= 0).any():
        raise ValueError("z_mm does not rise from row to row")
    empty = np.full(len(table), np.nan)
    return {**dict.fromkeys(optional, empty), **dict(zip(names, table.T, strict=True))}


def _require_all(z_mm: FloatArray, summary: Mapping[str, Any]) -> None:
    """ValueError where these are not all stations that the summary is of."""
    count = summary.get("stations")
    if count is not None:
        if whole(count, "stations", 0, STATIONS_MAX) != len(z_mm):
            raise ValueError(f"has {len(z_mm)} stations, expected {count} as {SUMMARY} says")
        return
    # Of before it said so: they reach from end to end, half a station short of either.
    first, last = scanned(summary)
    length = (float(np.diff(z_mm).max()) if len(z_mm) > 1 else last - first) + END_PART * (last - first)
    if not len(z_mm) and last == first:
        return
    if not len(z_mm) or z_mm[0] - first > length or last - z_mm[-1] > length:
        reach = f"reach from {z_mm[0]:g} to {z_mm[-1]:g} mm" if len(z_mm) else "are none"
        raise ValueError(f"its stations {reach}, expected {first:g} to {last:g} mm as {SUMMARY} says")


def texts(found: Any, what: str, above: str = "") -> dict[str, str]:
    """A section of texts and numbers, as texts; sections in it stand one level down: controller.board."""
    out: dict[str, str] = {}
    for name, value in mapping({} if found is None else found, what).items():
        name = text(name, f"a name in {what}", 200)
        if isinstance(value, Mapping) and not above:
            out |= texts(value, what, f"{name}.")
        elif value not in (None, ""):
            many = value if isinstance(value, list) else [value]
            out[above + name] = text(", ".join(_plain(one) for one in many), f"{what}.{name}", TEXT_MAX)
    return out


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else shown(value)


def figures(summary: Mapping[str, Any]) -> dict[str, float]:
    """The whole pipe's figures that there are."""
    out = {}
    for group, names in (
        ("diameter_mm", ("mean", "min", "max", "nominal", "k2")),
        ("ovality", ("max_percent", "shape_max_percent")),
        ("limits", ("depth_mm", "size_mm", "ovality_percent")),
    ):
        found = mapping(summary.get(group) or {}, group)
        for name in names:
            if found.get(name) is not None:
                out[f"{group}.{name}"] = number(found[name], f"{group}.{name}")
    for name in ("seen_percent", "hidden_percent", "noise_mm"):
        if summary.get(name) is not None:
            out[name] = number(summary[name], name)
    return out


def places(summary: Mapping[str, Any], name: str) -> tuple[ListedPlace, ...]:
    found = summary.get(name)
    if not isinstance(found, list) or len(found) > PLACES_MAX:
        raise ValueError(f"{name} must be a list of at most {PLACES_MAX}")
    return tuple(_place(mapping(one, f"{name}, entry {i + 1},"), f"{name}[{i}]") for i, one in enumerate(found))


def unseen(summary: Mapping[str, Any]) -> tuple[UnseenStretch, ...]:
    """What the scan did not see, but for the smallest of a scan that has too many to list: the row that stands for them
    reaches from the first to the last, and most of the wall between was seen. Raises ValueError, also for a summary of
    before that was listed."""
    found = summary.get("not_seen")
    if found is None:
        raise ValueError("it does not list what was not seen: an older annulus made it, reconstruct the scan again")
    if not isinstance(found, list) or len(found) > PLACES_MAX:
        raise ValueError(f"not_seen must be a list of at most {PLACES_MAX}")
    out = []
    for i, one in enumerate(found):
        hole = mapping(one, f"not_seen, entry {i + 1},")
        if whole(hole.get("more", 0), f"not_seen[{i}].more", 0, MANY_MAX):
            continue
        first, last = (
            within(hole.get(end), f"not_seen[{i}].{end}", -MM_MAX, MM_MAX) for end in ("z_from_mm", "z_to_mm")
        )
        clock = within(hole.get("clock_deg"), f"not_seen[{i}].clock_deg", -360.0, 360.0)
        out.append(UnseenStretch(first, last, clock, within(hole.get("arc_deg"), f"not_seen[{i}].arc_deg", 0.0, 360.0)))
    return tuple(out)


def _place(found: Mapping[str, Any], what: str) -> ListedPlace:
    def mm(name: str, low: float = -MM_MAX) -> float:
        return within(found.get(name), f"{what}.{name}", low, MM_MAX)

    def maybe(name: str) -> float | None:
        value = found.get(name)
        return None if value is None else within(value, f"{what}.{name}", 0.0, 1e12)

    z, length = mm("z_mm"), mm("length_mm", 0.0)
    first, last = (
        mm(name) if name in found else z + half for name, half in (("z_from_mm", -length / 2), ("z_to_mm", length / 2))
    )
    severity = found.get("severity")
    return ListedPlace(
        kind=text(found.get("kind"), f"{what}.kind", 100),
        z_mm=z,
        z_from_mm=first,
        z_to_mm=last,
        length_mm=length,
        clock_deg=within(found.get("clock_deg"), f"{what}.clock_deg", -360.0, 360.0) % 360.0,
        arc_deg=within(found.get("arc_deg"), f"{what}.arc_deg", 0.0, 360.0),
        depth_mm=maybe("depth_mm"),
        depth_k2_mm=maybe("depth_k2_mm"),
        area_mm2=maybe("area_mm2"),
        hidden_mm=maybe("hidden_mm"),
        floor_seen=found.get("floor_seen") is not False,
        remark=text(found.get("remark") or "", f"{what}.remark", TEXT_MAX),
        severity="" if severity is None else ", ".join(texts({"severity": severity}, what).values()),
        decision=text(found.get("decision") or "", f"{what}.decision", 100),
        measures=tuple(_measures(found, what)),
    )


def _measures(found: Mapping[str, Any], what: str) -> list[tuple[str, float, float | None]]:
    """height_mm beside height_k2_mm, of what a feature has and no defect."""
    out = []
    for name, value in found.items():
        unit = name.rpartition("_")[2]
        if name in _PLACE or "_k2_" in name or isinstance(value, str | bool | list | Mapping) or value is None:
            continue
        k2 = found.get(f"{name.removesuffix(unit)}k2_{unit}")
        spread = None if k2 is None else number(k2, f"{what}, the k2 of {shown(name)},")
        out.append((text(name, f"{what}'s name", 100), number(value, f"{what}.{shown(name)}"), spread))
    return out


def text(value: object, what: str, longest: int) -> str:
    """A text that terminals, spreadsheets and drawings show and do not obey."""
    return printable(raw_text(value, what, longest))


def unreadable(path: Path, error: Exception) -> AnnulusError:
    """What a user is told of a file of results that is not as it should be."""
    why = error.strerror if isinstance(error, OSError) and error.strerror else one_line(str(error))
    return AnnulusError(f"{path}: {why or type(error).__name__}. Expected results of `annulus reconstruct`.")
