"""1080 radii a station, a row each, as ASTM F3080 wants at least so many; empty where the wall was not seen.

The wall's map has a column a degree, so that the radii between are drawn straight from one seen column to the next and
never across a gap: there are as many figures as asked for, and no more sight than the map has. radii.json beside says
so for programs.
"""

import csv
import gzip
import json
import math
from pathlib import Path

import numpy as np

from annulus_pipe.export.results import Results
from annulus_pipe.export.stations import radii_of_stations
from annulus_pipe.numeric.arrays import FloatArray

ABOUT = "radii.json"
COUNT = 1080
ANGLES_DEG = np.arange(COUNT) * 360.0 / COUNT
HEADINGS = tuple(f"r_{angle:06.2f}" for angle in ANGLES_DEG)


def write(results: Results, path: Path) -> None:
    packed = path.suffix == ".gz"
    with gzip.open(path, "wt", 4, newline="", encoding="ascii") if packed else path.open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["z_mm", *HEADINGS])
        for z, radius in radii_of_stations(results):
            radii = at_angles(radius, results.wall.clock_deg)
            table.writerow([f"{z:.4f}", *("" if math.isnan(one) else f"{one:.3f}" for one in radii.tolist())])
    path.with_name(ABOUT).write_text(_about(results), encoding="utf-8")


def at_angles(radius_mm: FloatArray, clock_deg: FloatArray) -> FloatArray:
    """(COUNT,) radii at `ANGLES_DEG`, straight between neighbouring columns that were both seen, NaN else."""
    step = 360.0 / len(clock_deg)
    place = (ANGLES_DEG - clock_deg[0]) / step
    before = np.floor(place + 1e-9).astype(np.int64)
    part = np.clip(place - before, 0.0, 1.0)
    part = np.where(part < 1e-9, 0.0, part)  # on a column: that column alone
    low, high = radius_mm[before % len(clock_deg)], radius_mm[(before + 1) % len(clock_deg)]
    return np.asarray(np.where(part == 0.0, low, (1.0 - part) * low + part * high))


def _about(results: Results) -> str:
    """What radii.json says."""
    wall = results.wall
    return (
        json.dumps(
            {
                "format": "annulus-radii/1",
                "unit": "mm",
                "radii": COUNT,
                "step_deg": 360.0 / COUNT,
                "of": "the inner wall's distance from the axis (centreline.json), median over the station's rows",
                "direction": "clockwise looking forward, r_000.00 at 12 o'clock",
                "empty": "not seen, or farther from the nominal radius than wall.npz can say",
                "map_step_deg": 360.0 / len(wall.clock_deg),
                "map_step_mm": wall.z_step_mm,
                "interpolated": "between two neighbouring columns of the map that were both seen; never across a gap",
                "stations": len(results.stations["z_mm"]),
                "source": results.source,
                "made_by": results.made_by,
            },
            indent=1,
        )
        + "\n"
    )
