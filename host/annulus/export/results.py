"""A results folder as `annulus reconstruct` left it, or as somebody changed it: every figure is looked at.

summary.json, stations.csv and centreline.json are small and read at once; the cloud, the mesh and the wall map when a
form asks for them. AnnulusError, one line, names the file.
"""

import csv
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from annulus.export.ply import Ply, open_ply
from annulus.export.wall_map import WallMap, read_wall
from annulus.numeric.arrays import FloatArray
from annulus.record.numbers import number as parsed
from annulus.untrusted import mapping, number, one_line, parse_json, printable, read_file, shown, within
from annulus.untrusted import text as raw_text
from annulus.vocabulary import AnnulusError

FORMAT = "annulus-summary/1"
JSON_MAX, CSV_MAX = 1 << 27, 1 << 28  # bytes
PLACES_MAX, STATIONS_MAX, POINTS_MAX, PIECES_MAX = 100_000, 200_000, 1_000_000, 10_000
TEXT_MAX = 2000
MM_MAX = 1e8
CLOUD_FIELDS = ("x", "y", "z", "red", "green", "blue", "radius", "frame", "ring", "sigma")
MESH_FIELDS = ("x", "y", "z", "red", "green", "blue", "quality")
STATION_COLUMNS = (
    "z_mm", "diameter_min_mm", "diameter_max_mm", "diameter_mean_mm", "ovality_f1216_percent",
    "shape_ovality_f1216_percent", "valid_fraction", "diameter_k2_mm",
)  # fmt: skip
_PLACE = {
    "kind", "z_mm", "clock_deg", "clock", "length_mm", "arc_deg", "z_from_mm", "z_to_mm", "depth_mm", "depth_k2_mm",
    "area_mm2", "all_round", "floor_seen", "hidden_mm", "clock_from_to", "remark", "severity",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Place:
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
    measures: tuple[tuple[str, float, float | None], ...] = ()

    @property
    def is_all_round(self) -> bool:
        return self.arc_deg >= 360.0


@dataclass(frozen=True, slots=True)
class Marked:
    """What an operator marked. z_mm: of the head at that moment; None where the file says null."""

    name: str
    z_mm: float | None
    clock_deg: float | None
    text: str
    utc: str


@dataclass(frozen=True)
class Results:
    """One folder. z_mm along the pipe; clock angles clockwise from 12 looking forward; space x right, y down."""

    folder: Path
    source: str
    created: str
    made_by: str
    job: Mapping[str, str]
    origin: Mapping[str, str]  # of the recording: when, by which head and programs
    points: int
    scanned_mm: tuple[float, float]
    nominal_mm: float
    figures: Mapping[str, float]  # of the whole pipe, by their names in the summary
    defects: tuple[Place, ...]
    features: tuple[Place, ...]
    undecided: tuple[Place, ...]
    observations: tuple[Marked, ...]
    warnings: tuple[str, ...]
    stations: Mapping[str, FloatArray]  # column -> (S,), NaN where empty

    @property
    def radius_mm(self) -> float:
        return self.nominal_mm / 2

    @cached_property
    def cloud(self) -> Ply:
        return self._ply("cloud.ply", CLOUD_FIELDS)

    @cached_property
    def mesh(self) -> Ply:
        return self._ply("mesh.ply", MESH_FIELDS)

    @cached_property
    def wall(self) -> WallMap:
        path = self.folder / "wall.npz"
        try:
            return read_wall(path)
        except (OSError, ValueError) as error:
            raise _told(path, error) from None

    @cached_property
    def course(self) -> Mapping[str, Any]:
        """centreline.json as it is, its line and pieces looked at."""
        path = self.folder / "centreline.json"
        try:
            return _course(parse_json(read_file(path, JSON_MAX), JSON_MAX))
        except (OSError, ValueError) as error:
            raise _told(path, error) from None

    def station_at(self, column: str, first_mm: float, last_mm: float) -> FloatArray:
        """What the stations between two distances say, without those that say nothing."""
        z, values = self.stations["z_mm"], self.stations[column]
        return values[(z >= first_mm) & (z <= last_mm) & np.isfinite(values)]

    def _ply(self, name: str, fields: tuple[str, ...]) -> Ply:
        path = self.folder / name
        try:
            return open_ply(path, fields)
        except (OSError, ValueError) as error:
            raise _told(path, error) from None


def open_results(folder: Path) -> Results:
    """Raises AnnulusError, one line, for what is no folder of a pipe's results, or a damaged one."""
    path = folder / "summary.json"
    try:
        summary = mapping(parse_json(read_file(path, JSON_MAX), JSON_MAX), "summary")
        if summary.get("format") != FORMAT:
            raise ValueError(f"its format is {shown(summary.get('format'))}, expected {FORMAT}")
        if "scanned_mm" not in summary and "height_mm" in summary:
            raise ValueError("results of a plate; exports are of pipes")
        found = _summary(summary)
    except (OSError, ValueError) as error:
        raise _told(path, error) from None
    path = folder / "stations.csv"
    try:
        stations = _stations(read_file(path, CSV_MAX))
    except (OSError, ValueError) as error:
        raise _told(path, error) from None
    return Results(folder=folder, stations=stations, **found)


def text(value: object, what: str, longest: int) -> str:
    """A text that terminals, spreadsheets and drawings show and do not obey."""
    return printable(raw_text(value, what, longest))


def _told(path: Path, error: Exception) -> AnnulusError:
    why = error.strerror if isinstance(error, OSError) and error.strerror else one_line(str(error))
    return AnnulusError(f"{path}: {why or type(error).__name__}. Expected results of `annulus reconstruct`.")


def _summary(summary: Mapping[str, Any]) -> dict[str, Any]:
    scanned = mapping(summary.get("scanned_mm"), "scanned_mm")
    first, last = (within(scanned.get(name), f"scanned_mm.{name}", -MM_MAX, MM_MAX) for name in ("from", "to"))
    if last < first:
        raise ValueError(f"scanned_mm ends at {last:g}, before it begins at {first:g}")
    diameter = mapping(summary.get("diameter_mm"), "diameter_mm")
    versions = mapping(summary.get("versions", {}), "versions")
    return {
        "source": text(summary.get("source", ""), "source", TEXT_MAX),
        "created": text(summary.get("created", ""), "created", 100),
        "made_by": f"annulus {text(versions.get('annulus', 'of unknown version'), 'versions.annulus', 100)}",
        "job": _said(summary.get("job"), "job"),
        "origin": _said(summary.get("origin"), "origin"),
        "points": int(within(summary.get("points"), "points", 0, 1e12)),
        "scanned_mm": (first, last),
        "nominal_mm": within(diameter.get("nominal"), "diameter_mm.nominal", 1.0, 1e5),
        "figures": _figures(summary),
        "defects": _places(summary, "defects"),
        "features": _places(summary, "features"),
        "undecided": _places(summary, "undecided"),
        "observations": _observations(summary.get("observations") or []),
        "warnings": _warnings(summary.get("warnings", [])),
    }


def _said(found: Any, what: str, above: str = "") -> dict[str, str]:
    """A section of texts and numbers, as texts; sections in it stand one level down: controller.board."""
    out: dict[str, str] = {}
    for name, value in mapping({} if found is None else found, what).items():
        name = text(name, f"a name in {what}", 200)
        if isinstance(value, Mapping) and not above:
            out |= _said(value, what, f"{name}.")
        elif value not in (None, ""):
            many = value if isinstance(value, list) else [value]
            out[above + name] = text(", ".join(_plain(one) for one in many), f"{what}.{name}", TEXT_MAX)
    return out


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else f"{value:g}" if isinstance(value, float) else shown(value)


def _figures(summary: Mapping[str, Any]) -> dict[str, float]:
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


def _warnings(found: Any) -> tuple[str, ...]:
    if not isinstance(found, list) or len(found) > PLACES_MAX:
        raise ValueError("warnings must be a list")
    return tuple(text(mapping(one, "a warning").get("text", ""), "a warning's text", TEXT_MAX) for one in found)


def _observations(found: Any) -> tuple[Marked, ...]:
    """Summaries of before have none."""
    if not isinstance(found, list) or len(found) > PLACES_MAX:
        raise ValueError(f"observations must be a list of at most {PLACES_MAX}")
    return tuple(
        _marked(mapping(one, f"observations, entry {i + 1},"), f"observations[{i}]") for i, one in enumerate(found)
    )


def _marked(found: Mapping[str, Any], what: str) -> Marked:
    z, clock = found.get("z_mm"), found.get("clock_deg")
    return Marked(
        name=text(found.get("mark") or "", f"{what}.mark", 100),
        z_mm=None if z is None else number(z, f"{what}.z_mm", MM_MAX),
        clock_deg=None if clock is None else within(clock, f"{what}.clock_deg", -360.0, 360.0) % 360.0,
        text=text(found.get("text") or "", f"{what}.text", TEXT_MAX),
        utc=text(found.get("utc") or "", f"{what}.utc", 100),
    )


def _places(summary: Mapping[str, Any], name: str) -> tuple[Place, ...]:
    found = summary.get(name)
    if not isinstance(found, list) or len(found) > PLACES_MAX:
        raise ValueError(f"{name} must be a list of at most {PLACES_MAX}")
    return tuple(_place(mapping(one, f"{name}, entry {i + 1},"), f"{name}[{i}]") for i, one in enumerate(found))


def _place(found: Mapping[str, Any], what: str) -> Place:
    def mm(name: str, low: float = -MM_MAX) -> float:
        return within(found.get(name), f"{what}.{name}", low, MM_MAX)

    def maybe(name: str) -> float | None:
        value = found.get(name)
        return None if value is None else within(value, f"{what}.{name}", 0.0, 1e12)

    z, length = mm("z_mm"), mm("length_mm", 0.0)
    first, last = (mm(name) if name in found else z + half for name, half in (("z_from_mm", -length / 2),
                                                                               ("z_to_mm", length / 2)))  # fmt: skip
    severity = found.get("severity")
    return Place(
        kind=text(found.get("kind"), f"{what}.kind", 100),
        z_mm=z, z_from_mm=first, z_to_mm=last, length_mm=length,
        clock_deg=within(found.get("clock_deg"), f"{what}.clock_deg", -360.0, 360.0) % 360.0,
        arc_deg=within(found.get("arc_deg"), f"{what}.arc_deg", 0.0, 360.0),
        depth_mm=maybe("depth_mm"), depth_k2_mm=maybe("depth_k2_mm"), area_mm2=maybe("area_mm2"),
        hidden_mm=maybe("hidden_mm"), floor_seen=found.get("floor_seen") is not False,
        remark=text(found.get("remark") or "", f"{what}.remark", TEXT_MAX),
        severity="" if severity is None else ", ".join(_said({"severity": severity}, what).values()),
        measures=tuple(_measures(found, what)),
    )  # fmt: skip


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


def _stations(data: bytes) -> dict[str, FloatArray]:
    try:
        rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        missing = [name for name in STATION_COLUMNS if name not in (rows.fieldnames or ())]
        if missing:
            raise ValueError(f"has no column {missing[0]}")
        values: list[list[float]] = []
        for row in rows:
            values.append([parsed(row[name] or "") for name in STATION_COLUMNS])
            if len(values) > STATIONS_MAX:
                raise ValueError(f"has more than {STATIONS_MAX} rows")
            if not math.isfinite(values[-1][0]) or abs(values[-1][0]) > MM_MAX:
                raise ValueError(f"line {rows.line_num}: z_mm is {shown(row['z_mm'])}, expected a number")
    except UnicodeDecodeError:
        raise ValueError("not a text file") from None
    except csv.Error as error:
        raise ValueError(f"not a table: {error}") from None
    table = np.array(values, dtype=np.float64).reshape(-1, len(STATION_COLUMNS))
    table[~(np.abs(table) <= MM_MAX)] = np.nan
    if (np.diff(table[:, 0]) <= 0).any():
        raise ValueError("z_mm does not rise from row to row")
    return dict(zip(STATION_COLUMNS, table.T, strict=True))


def _course(found: Any) -> Mapping[str, Any]:
    course = mapping(found, "centre line")
    if course.get("format") != "annulus-centreline/1":
        raise ValueError(f"its format is {shown(course.get('format'))}, expected annulus-centreline/1")
    line = course.get("line_mm")
    if not isinstance(line, list) or not 0 < len(line) <= POINTS_MAX:
        raise ValueError(f"line_mm must be a list of 1 to {POINTS_MAX} points")
    for i, point in enumerate(line):
        if not isinstance(point, list) or len(point) != 4:
            raise ValueError(f"line_mm, point {i + 1}, is not chainage, x, y, z")
        for value in point:
            within(value, f"line_mm, point {i + 1},", -MM_MAX, MM_MAX)
    pieces = course.get("pieces")
    if not isinstance(pieces, list) or len(pieces) > PIECES_MAX:
        raise ValueError("pieces must be a list")
    return course
