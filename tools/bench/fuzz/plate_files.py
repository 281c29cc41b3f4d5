"""Single-sided shots and plates made wrong: what is read of a file is decoded, too."""

import json
import tempfile
from functools import cache
from pathlib import Path
from random import Random

import numpy as np

from annulus_pipe.extras import need
from annulus_pipe.wings.tai.measure.budget import Laminate, SingleSidedRig
from annulus_pipe.wings.tai.single_sided import (
    SAMPLES,
    PlateRecord,
    decoded,
    is_plate,
    load_plate,
    read_plate,
    save_plate,
)
from tools.bench.fuzz.mutate import HOSTILE, as_json, of_bytes, of_toml, of_values

TOML = "thickness_mm = 20\n[[delamination]]\nx_mm = 1\ndepth_mm = 6\nwide_mm = 20\n"
TOML += "[[water]]\nx_mm = 9\ndepth_mm = 8\nwide_mm = 9\n"


@cache
def _sample() -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.hdf5"
        shots = np.random.default_rng(0).normal(size=(1, 16, SAMPLES)).astype(np.float32)
        save_plate(path, PlateRecord(shots, "single", 4, SingleSidedRig(), Laminate()))
        return path.read_bytes()


def plate_case(rng: Random) -> bytes:
    if rng.random() < 0.3:
        return b"toml" + of_toml(rng, TOML).encode("utf-8", "surrogatepass")
    return b"hdf5" + (of_bytes(rng, _sample()) if rng.random() < 0.5 else _of_about(rng))


def _of_about(rng: Random) -> bytes:
    """The file with another `about`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.hdf5"
        path.write_bytes(_sample())
        with need("h5py").File(path, "r+") as root:
            about = json.loads(bytes(np.asarray(root["about"])))
            del root["about"]
            wrong = as_json(rng, of_values(rng, about, HOSTILE))
            root.create_dataset("about", data=np.frombuffer(wrong, np.uint8))
        return path.read_bytes()


def plate_read(data: bytes, folder: Path) -> None:
    path = folder / f"a.{data[:4].decode()}"
    path.write_bytes(data[4:])
    if path.suffix == ".toml":
        read_plate(path)
    elif is_plate(path):
        decoded(load_plate(path))
