"""Results of a gauge study that nobody scanned: what `annulus reconstruct` would have written, of readings drawn from
a seed. For what is asked of certificates, not of scans."""

import csv
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.storage.results_folder import FORMAT, STATION_COLUMNS

PIECES = {"A": 148.0, "B": 152.4, "C": 157.8}  # mm
OPERATORS = ("maria", "jo")
HEAD = "annulus-7"
FIRST_MM, STATIONS, STEP_MM = 80.0, 20, 5.0


def write_plan(path: Path, pieces: Mapping[str, float] = PIECES, operators: Sequence[str] = OPERATORS) -> Path:
    rows = "".join(f'\n[[piece]]\nname = "{one}"\ndiameter_mm = {mm}\nu_mm = 0.03\n' for one, mm in pieces.items())
    who = f"operators = {json.dumps(list(operators))}\nrepeats = 2\n"
    path.write_text(f'title = "drawn"\nhead = "{HEAD}"\nlaboratory = "Pipe Laboratory"\n{who}{rows}')
    return path


def fill_in(runs: Path, bias_percent: float = -0.18, seed: int = 44, stated: bool = True) -> None:
    """Results for every row of a runs.csv, and its temperatures. stated : whether the results state whose they are."""
    rng = np.random.default_rng(seed)
    with runs.open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row["temperature_c"] = "20"
        mm = PIECES[row["piece"]] * (1 + (bias_percent + rng.normal(0.0, 0.01)) / 100)
        job = {"head": HEAD, "operator": row["operator"], "pipe": row["piece"]} if stated else {}
        write_results(runs.parent / row["results"], mm, job)
    with runs.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def listed(z_mm: float, clock_deg: float, depth_mm: float, k2_mm: float = 0.08) -> dict[str, Any]:
    """A loss of 20 by 20 mm, as summary.json lists it."""
    place = {"kind": "loss", "z_mm": z_mm, "clock_deg": clock_deg, "length_mm": 20.0, "arc_deg": 15.0}
    return place | {"depth_mm": depth_mm, "depth_k2_mm": k2_mm, "floor_seen": True}


def write_results(
    folder: Path,
    diameter_mm: float,
    job: Mapping[str, Any],
    defects: Sequence[Mapping[str, Any]] = (),
    stations: int = STATIONS,
) -> None:
    folder.mkdir(parents=True)
    end = FIRST_MM + stations * STEP_MM
    number = int(folder.name) if folder.name.isdecimal() else 0
    begun = f"{datetime.now(UTC):%Y-%m-%d}T09:{number % 60:02d}:00+00:00"  # today, as certificates are issued today
    summary = {
        "format": FORMAT,
        "job": dict(job),
        "origin": {"begun_utc": begun, "calibration": {"fingerprint": "ab12cd34ef567890"}},
        "frames": {"projector": 13, "led": 3},
        "points": 45_000,
        "scanned_mm": {"from": FIRST_MM, "to": end, "length": end - FIRST_MM},
        "diameter_mm": {"mean": diameter_mm, "nominal": 152.4},
        "scale": {"common_k2_percent": 0.72},
        "stations": stations,
        "limits": {"depth_mm": 0.38, "size_mm": 3.0, "ovality_percent": 0.75},
        "defects": list(defects),
        "undecided": [],
        "not_seen": [],
        "versions": {"annulus": "0.1.0"},
    }
    (folder / "summary.json").write_text(json.dumps(summary))
    values = dict.fromkeys(STATION_COLUMNS, 0.01) | {"valid_fraction": 0.95, "diameter_k2_mm": 0.9}
    with (folder / "stations.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, STATION_COLUMNS, lineterminator="\n")
        writer.writeheader()
        for i in range(stations):
            ends = {"min": -0.02, "mean": 0.0, "max": 0.02}
            sizes = {f"diameter_{name}_mm": f"{diameter_mm + off:.4f}" for name, off in ends.items()}
            writer.writerow(values | sizes | {"z_mm": FIRST_MM + (i + 0.5) * STEP_MM})
