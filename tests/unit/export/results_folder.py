"""A results folder as `reconstruct` leaves it, of a small pipe whose every number is known."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.report.ply import write_ply

RADIUS_MM, Z_STEP_MM, ROWS = 76.2, 0.5, 400
CLOUD = [
    ("x", "<f4"),
    ("y", "<f4"),
    ("z", "<f4"),
    ("red", "u1"),
    ("green", "u1"),
    ("blue", "u1"),
    ("radius", "<f4"),
    ("frame", "<i4"),
    ("ring", "u1"),
    ("sigma", "<f4"),
    ("camera", "u1"),
]


def place(kind: str, z: float, length: float, clock_deg: float, arc: float, **more: Any) -> dict[str, Any]:
    return {
        "kind": kind,
        "z_mm": z,
        "length_mm": length,
        "clock_deg": clock_deg,
        "arc_deg": arc,
        "clock": "?",
        "z_from_mm": z - length / 2,
        "z_to_mm": z + length / 2,
        **more,
    }


def depth(mm: float, k2: float | None, **more: Any) -> dict[str, Any]:
    return {"depth_mm": mm, "depth_k2_mm": k2, "area_mm2": 100.0, "floor_seen": True, "hidden_mm": 1.5} | more


SUMMARY = {
    "format": "annulus-summary/1",
    "source": "scan <1>",
    "created": "2026-05-04T10:00:00+00:00",
    "points": 1000,
    "scanned_mm": {"from": 100.0, "to": 300.0, "length": 200.0},
    "seen_percent": 98.0,
    "diameter_mm": {"mean": 152.4, "min": 151.0, "max": 155.0, "nominal": 152.4, "k2": 0.1},
    "ovality": {"max_percent": 1.2, "shape_max_percent": 1.0},
    "job": {"client": '=HYPERLINK("x")', "site": "Elm Street", "pipe": "P-12", "operator": {"name": "A. B."}},
    "origin": {"begun_utc": "2026-05-04T09:00:00+00:00", "controller": {"serial": "@77"}},
    "defects": [
        place("loss", 145.5, 32.5, 100.0, 26.0, **depth(3.998, 0.104), severity="major"),
        place("bump", 213.75, 21.5, 215.0, 18.0, **depth(4.0, None, floor_seen=False)),
        place("loss", 245.5, 13.0, 330.0, 80.0, **depth(1.993, 0.273)),
        place("ovality", 280.0, 20.0, 19.99, 360.0, **depth(2.885, 0.192)),
    ],
    "undecided": [place("loss", 260.0, 10.0, 5.0, 20.0, **depth(0.5, 0.4))],
    "features": [
        place("joint", 120.0, 6.0, 0.0, 360.0, height_mm=2.5, height_k2_mm=0.123, remark="-butt fusion"),
        place("branch", 200.0, 40.0, 90.0, 40.0, diameter_mm=38.2, diameter_k2_mm=0.5, remark=""),
        place("bend", 250.0, 60.0, 0.0, 360.0, angle_deg=45.0, angle_k2_deg=0.5, remark="@45 degrees"),
        place("cross bore", 270.0, 8.0, 180.0, 30.0, remark="+a sewer"),
        place("joint", 290.0, 6.0, 0.0, 360.0, remark="coupling"),
    ],
    "observations": [
        {"mark": "M1", "z_mm": 151.0, "clock_deg": 91.2, "text": "=1+1 weeps", "utc": "2026-05-04T09:02:00+00:00"},
        {"mark": "M2", "z_mm": None, "clock_deg": None, "text": "", "utc": None},
    ],
    "versions": {"annulus": "0.1.0"},
    "warnings": [{"kind": "dark", "text": "one frame is dark", "frames": [1]}],
}


def radius_map() -> np.ndarray:
    """(ROWS, 360) mm, NaN where not seen: a notch of 3 mm about 3 o'clock, a gap about 6, an opening about 9."""
    radius = np.full((ROWS, 360), RADIUS_MM)
    radius[:, 85:95] += 3.0
    radius[:, 176:184] = np.nan
    radius[300:320, 265:275] += 60.0  # beyond what the map can say
    return radius


def cloud_of(points: int) -> np.ndarray:
    draw = np.random.default_rng(3)
    t = draw.uniform(0, 2 * np.pi, points)
    records = np.empty(points, dtype=CLOUD)
    radius = RADIUS_MM + draw.normal(0, 0.1, points)
    records["x"], records["y"] = radius * np.sin(t), -radius * np.cos(t)
    records["z"], records["radius"] = draw.uniform(100, 300, points), radius
    for name, most in (("red", 256), ("green", 256), ("blue", 256), ("ring", 5), ("camera", 2), ("frame", 70_000)):
        records[name] = draw.integers(0, most, points)
    records["sigma"] = draw.uniform(0.01, 0.2, points)
    return records


def mesh_of() -> tuple[np.ndarray, np.ndarray]:
    """A tube of 40 x 36 points without ends."""
    rows, columns = 40, 36
    t = np.radians(np.arange(columns) * 10.0)
    records = np.empty(rows * columns, dtype=[*CLOUD[:6], ("quality", "<f4")])
    records["x"], records["y"] = np.tile(RADIUS_MM * np.sin(t), rows), np.tile(-RADIUS_MM * np.cos(t), rows)
    records["z"] = np.repeat(100.0 + 5.0 * np.arange(rows), columns)
    records["red"], records["green"], records["blue"] = np.arange(len(records)) % 256, 128, 3
    records["quality"] = np.linspace(-1, 1, len(records))
    records["quality"][5] = np.nan
    i = np.arange((rows - 1) * columns)
    beside = i // columns * columns + (i + 1) % columns
    return records, np.stack([i, i + columns, beside], axis=1).astype(np.int32)


def write_folder(folder: Path, points: int = 1000) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "summary.json").write_text(json.dumps(SUMMARY))
    write_ply(folder / "cloud.ply", cloud_of(points), note="mm")
    write_ply(folder / "mesh.ply", *mesh_of(), note="mm")
    z = 100.0 + Z_STEP_MM * (np.arange(ROWS) + 0.5)
    with (folder / "stations.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(
            [
                "z_mm",
                "diameter_min_mm",
                "diameter_max_mm",
                "diameter_mean_mm",
                "ovality_f1216_percent",
                "shape_ovality_f1216_percent",
                "valid_fraction",
                "diameter_k2_mm",
            ]
        )
        for i in range(0, ROWS, 10):
            row = [z[i : i + 10].mean(), 151.0, 155.0, 152.4, 1.2, 0.01 * i, 0.98, 0.1]
            table.writerow([f"{value:.4f}" if i != 50 or n in (0, 6) else "" for n, value in enumerate(row)])
    course = {"format": "annulus-centreline/1", "pieces": [], "line_mm": [[s, 0.0, 0.0, s] for s in (100.0, 300.0)]}
    (folder / "centreline.json").write_text(json.dumps(course))
    radius = radius_map()
    away = np.clip(np.rint(1e3 * (radius - RADIUS_MM)), -32767, 32767)
    np.savez_compressed(
        folder / "wall.npz",
        format="annulus-wall/1",
        deviation_um=np.where(np.isnan(away), -32768, away).astype("i2"),
        z_mm=z,
        clock_deg=np.arange(360) + 0.5,
        z_step_mm=Z_STEP_MM,
        radius_mm=RADIUS_MM,
    )
    return folder
