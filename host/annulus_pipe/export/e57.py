"""The cloud as E57: metres, z up, colour; a large cloud as several scans of one file, so that memory is bounded.

E57 has no place for ring, frame and sigma, which LAZ has. Nor has the cloud an intensity.
"""

from pathlib import Path

import numpy as np

from annulus_pipe.export.axes import in_space, z_up
from annulus_pipe.export.results import Results
from annulus_pipe.extras import need

CHUNK = 5_000_000  # points a scan; pye57 makes room for as many, however few there are


def write(results: Results, path: Path) -> None:
    pye57 = need("pye57")
    cloud = results.cloud.vertices
    with pye57.E57(str(path), mode="w") as file:
        for at in range(0, len(cloud), CHUNK):
            part = np.asarray(cloud[at : at + CHUNK])
            points = 1e-3 * z_up(in_space(part, results.folder / "cloud.ply"))
            data = {f"cartesian{name}": np.ascontiguousarray(points[:, i]) for i, name in enumerate("XYZ")}
            data |= {f"color{name.capitalize()}": np.ascontiguousarray(part[name]) for name in ("red", "green", "blue")}
            file.write_scan_raw(data, name=f"annulus cloud, points {at} to {at + len(part) - 1}")
