"""What a survey wrote: its list, its numbers with their k = 2, its stations and its cloud, read from its files."""

import csv
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench.blind.surface import Array

NOT_SEEN_UM = -32768  # of wall.npz
NAMELESS = "not established"  # kind of a feature: something goes all round, and it has no name
TYPES = {"float": "<f4", "double": "<f8", "uchar": "u1", "ushort": "<u2", "uint": "<u4", "int": "<i4", "short": "<i2"}


@dataclass(frozen=True, slots=True)
class Listed:
    """One line of a list. numbers : name without "k2" -> (value, k2 or NaN). at_least : its depth is a lower bound."""

    group: str  # defect | feature | undecided
    kind: str
    z_mm: float
    length_mm: float
    clock_deg: float
    arc_deg: float
    numbers: dict[str, tuple[float, float]]
    at_least: bool = False
    words: str = ""

    @property
    def reported(self) -> str:
        """As it stands in the list, for people."""
        values = ", ".join(f"{name} {value:.2f}+-{k2:.2f}" for name, (value, k2) in self.numbers.items())
        least = ">= " if self.at_least else ""
        name = f"{self.kind} {self.words}".strip()
        return f"{name} at {self.z_mm:.0f} mm, clock {self.clock_deg:.0f}: {least}{values}"


@dataclass(frozen=True, slots=True)
class Results:
    """`places` are those of the verdict at which nothing is established; `objects`, whether any was told of."""

    listed: tuple[Listed, ...]
    places: tuple[dict[str, Any], ...]
    decision: str
    items: tuple[dict[str, Any], ...]
    from_mm: float
    to_mm: float
    depth_limit_mm: float
    size_limit_mm: float
    objects: bool
    stations: dict[str, Array]
    points_mm: Array  # (N, 3)
    sigma_mm: Array  # (N,)
    scale_part: float = 0.0  # of the radius, k = 1: what the survey says that all its radii may be off alike
    seen: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (Z, A) bool, of the map; none where there is none
    seen_z_mm: Array = field(default_factory=lambda: np.zeros(0))


def read_results(folder: Path) -> Results:
    summary = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    verdict = summary.get("conformity") or {}
    groups = (("defects", "defect"), ("features", "feature"), ("undecided", "undecided"))
    listed = tuple(listed_of(one, group) for name, group in groups for one in summary[name])
    points, sigma = read_cloud(folder / "cloud.ply")
    with np.load(folder / "wall.npz") as wall:
        seen, seen_z = wall["deviation_um"] != NOT_SEEN_UM, np.array(wall["z_mm"])
        scale_part = float(wall["scale_part"]) if "scale_part" in wall.files else 0.0
    return Results(
        listed,
        tuple(verdict.get("not_established", ())),
        str(verdict.get("decision", "")),
        tuple(verdict.get("items", ())),
        summary["scanned_mm"]["from"],
        summary["scanned_mm"]["to"],
        summary["limits"]["depth_mm"] or np.inf,
        summary["limits"]["size_mm"] or np.inf,
        any(one["kind"] == "object" for one in summary["warnings"]),
        read_stations(folder / "stations.csv"),
        points,
        sigma,
        scale_part,
        seen,
        seen_z,
    )


def listed_of(one: dict[str, Any], group: str) -> Listed:
    """A defect, feature or undecided place of summary.json. A feature without a name is undecided."""
    if one["kind"] == NAMELESS:
        group = "undecided"
    numbers = {}
    for name, value in one.items():
        stem, _, unit = name.rpartition("_")
        if f"{stem}_k2_{unit}" in one and value is not None:
            k2 = one[f"{stem}_k2_{unit}"]
            numbers[name] = (float(value), np.nan if k2 is None else float(k2))
    return Listed(
        group,
        str(one["kind"]),
        float(one["z_mm"]),
        float(one["length_mm"]),
        float(one["clock_deg"]),
        float(one["arc_deg"]),
        numbers,
        one.get("floor_seen") is False,
        str(one.get("remark", "")),
    )


def read_stations(path: Path) -> dict[str, Array]:
    """Columns by name; NaN where a cell is empty."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    return {name: np.array([float(row[name] or "nan") for row in rows]) for name in (rows[0] if rows else ())}


def read_cloud(path: Path) -> tuple[Array, Array]:
    """(N, 3) points and (N,) sigma of a binary PLY, mm."""
    with path.open("rb") as file:
        count, fields, line = 0, [], b""
        while not line.startswith(b"end_header"):
            line = file.readline()
            words = line.decode("ascii", "replace").split()
            if words[:2] == ["element", "vertex"]:
                count = int(words[2])
            elif words[:1] == ["property"]:
                fields.append((words[2], TYPES[words[1]]))
        data = np.frombuffer(file.read(), np.dtype(fields), count)
    points = np.stack([data[name].astype(np.float64) for name in "xyz"], axis=1)
    return points, data["sigma"].astype(np.float64)
