"""The twin's heads under fringes in a pipe (6.8.2): camera and slide in series, modules lit in turn, one slide and a
mirror. Scan, wall and defects against what was drawn."""

import tempfile
import time
from pathlib import Path

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.twin.worlds import World
from annulus_pipe.wings.fringe.heads import mirror_fringe_world, modules_world, series_world
from annulus_pipe.wings.fringe.pipe import open_fringe_pipe, reconstruct_fringe_pipe
from tools.bench.table import Row

EDGE_MM = 1.5  # nearer to a step the truth jumps


def rows() -> list[Row]:
    return [
        *_rows("A, one camera, 8-inch", series_world(travel_mm=46.0), 25),
        *_rows("B, four pairs lit in turn, 6-inch", modules_world(travel_mm=56.0), 80),
        *_rows("C, four cameras, a slide and a mirror, 6-inch", mirror_fringe_world(travel_mm=30.0), 20),
    ]


def _rows(name: str, world: World, frames: int) -> list[Row]:
    with tempfile.TemporaryDirectory() as folder:
        scan = Path(folder) / "scan"
        write_scan(world, scan, frames)
        began = time.process_time()
        found = reconstruct_fringe_pipe(open_fringe_pipe(scan, scan / "calibration.json"))
        seconds = time.process_time() - began
    seen = found.map
    clock, z = (seen.phi_deg + 90.0) % 360.0, seen.z_mm[:, None]
    off = seen.radius_mm - world.radius_mm - world.deviation(clock[None], z)
    away = np.isfinite(off)
    for one in world.features:
        away &= np.abs(one.edge_distance_mm(clock[None] + 0 * z, z + 0 * clock[None], world.radius_mm)) > EDGE_MM
    common = float(np.median(off[away]))
    middle = away & (np.abs(z - np.median(seen.z_mm)) < 15.0)
    rms, aligned, best = _rms(off[away]), _rms(off[away] - common), _rms(off[middle] - common)
    edges = _rms(off[np.isfinite(off)])
    inside, as_it_is = (float(np.mean(np.abs(off[away] - less) < 2 * seen.sigma_mm[away])) for less in (common, 0.0))
    true, defects = len(world.features), len(found.survey.defects)
    return [
        Row(
            f"Model {name}: radius rms; with edges; the median taken out; of that 15 mm about the middle",
            "shown",
            "-",
            f"{rms:.4f}; {edges:.4f}; {aligned:.4f} ({common:+.4f} taken out); {best:.4f} mm",
        ),
        Row(
            "defects listed, of those drawn; k = 2, the median taken out; as it is; CPU",
            "-",
            "all, none else",
            f"{defects} of {true}; {inside:.1%}; {as_it_is:.1%}; {seconds:.0f} s",
            defects == true,
        ),
    ]


def _rms(off: FloatArray) -> float:
    return float(np.sqrt(np.mean(off**2)))
