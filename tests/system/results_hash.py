"""One hash of a folder of results: of what was measured, the clock's readings and the scan's name left out."""

import csv
import hashlib
import json
from pathlib import Path

import numpy as np

SAID = ("defects", "features", "undecided", "diameter_mm", "points", "frames", "warnings")  # of summary.json


def results_hash(folder: Path) -> str:
    digest = hashlib.sha256()
    with np.load(folder / "wall.npz") as wall:
        for name in sorted(wall.files):
            digest.update(f"{name}{wall[name].dtype}{wall[name].shape}".encode() + wall[name].tobytes())
    digest.update((folder / "cloud.ply").read_bytes())
    for row in csv.reader((folder / "stations.csv").read_text().splitlines()):
        digest.update(",".join(row).encode())
    summary = json.loads((folder / "summary.json").read_text())
    digest.update(json.dumps([summary[name] for name in SAID], sort_keys=True).encode())
    return digest.hexdigest()
