"""A results folder as `annulus reconstruct` left it, or as somebody changed it: every figure is looked at.

summary.json, stations.csv and centreline.json are small and read at once; the cloud, the mesh and the wall map when a
form asks for them. AnnulusError, one line, names the file.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.export.ply import Ply, open_ply
from annulus_pipe.export.wall_map import DeviationMap, read_wall
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.results_folder import (
    JSON_MAX,
    MM_MAX,
    PLACES_MAX,
    STATIONS,
    SUMMARY,
    TEXT_MAX,
    ListedPlace,
    figures,
    places,
    read_stations,
    read_summary,
    scanned,
    text,
    texts,
    unreadable,
)
from annulus_pipe.untrusted import mapping, number, parse_json, read_file, shown, within

POINTS_MAX, PIECES_MAX = 1_000_000, 10_000
CLOUD_FIELDS = ("x", "y", "z", "red", "green", "blue", "radius", "frame", "ring", "sigma")
MESH_FIELDS = ("x", "y", "z", "red", "green", "blue", "quality")


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
    defects: tuple[ListedPlace, ...]
    features: tuple[ListedPlace, ...]
    undecided: tuple[ListedPlace, ...]
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
    def wall(self) -> DeviationMap:
        path = self.folder / "wall.npz"
        try:
            return read_wall(path)
        except (OSError, ValueError) as error:
            raise unreadable(path, error) from None

    @cached_property
    def course(self) -> Mapping[str, Any]:
        """centreline.json as it is, its line and pieces looked at."""
        path = self.folder / "centreline.json"
        try:
            return _course(parse_json(read_file(path, JSON_MAX), JSON_MAX))
        except (OSError, ValueError) as error:
            raise unreadable(path, error) from None

    def station_at(self, column: str, first_mm: float, last_mm: float) -> FloatArray:
        """What the stations between two distances say, without those that say nothing."""
        z, values = self.stations["z_mm"], self.stations[column]
        return values[(z >= first_mm) & (z <= last_mm) & np.isfinite(values)]

    def _ply(self, name: str, fields: tuple[str, ...]) -> Ply:
        path = self.folder / name
        try:
            return open_ply(path, fields)
        except (OSError, ValueError) as error:
            raise unreadable(path, error) from None


def open_results(folder: Path) -> Results:
    """Raises AnnulusError, one line, for what is no folder of a pipe's results, or a damaged one."""
    try:
        summary = read_summary(folder)
        found = _summary(summary)
    except (OSError, ValueError) as error:
        raise unreadable(folder / SUMMARY, error) from None
    try:
        stations = read_stations(folder, summary)
    except (OSError, ValueError) as error:
        raise unreadable(folder / STATIONS, error) from None
    return Results(folder=folder, stations=stations, **found)


def _summary(summary: Mapping[str, Any]) -> dict[str, Any]:
    diameter = mapping(summary.get("diameter_mm"), "diameter_mm")
    versions = mapping(summary.get("versions", {}), "versions")
    return {
        "source": text(summary.get("source", ""), "source", TEXT_MAX),
        "created": text(summary.get("created", ""), "created", 100),
        "made_by": f"annulus {text(versions.get('annulus', 'of unknown version'), 'versions.annulus', 100)}",
        "job": texts(summary.get("job"), "job"),
        "origin": texts(summary.get("origin"), "origin"),
        "points": int(within(summary.get("points"), "points", 0, 1e12)),
        "scanned_mm": scanned(summary),
        "nominal_mm": within(diameter.get("nominal"), "diameter_mm.nominal", 1.0, 1e5),
        "figures": figures(summary),
        "defects": places(summary, "defects"),
        "features": places(summary, "features"),
        "undecided": places(summary, "undecided"),
        "observations": _observations(summary.get("observations") or []),
        "warnings": _warnings(summary.get("warnings", [])),
    }


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
