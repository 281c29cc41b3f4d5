"""A near-field scan while it is made: a line a point, on the disk before the next one is measured.

    # annulus near-field scan 1
    # {"angles": 100, ..}                       the plan, and the controller's boot
    i,j,amplitude_mv,phase_mv                   angle and place by index
    0,0,312.41,88.20

Whatever ends a scan, what was measured is here; a last line without its end was not. `write_raster` makes the raster of
a log that is whole.
"""

import json
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import IO, Any, Self

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.numbers import read_bounded
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.untrusted import mapping, parse_json, shown
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.raster_file import BYTES_MAX, CHANNELS

FIRST = "# annulus near-field scan 1"
PLAN_MAX = 4096  # bytes


class RasterLog:
    """points : {(i, j): mV by channel in order}."""

    def __init__(self, path: Path, plan: Mapping[str, Any], channels: Sequence[str]) -> None:
        """A new log. AnnulusError where there is one already."""
        self.path, self.plan, self.channels = path, dict(plan), tuple(channels)
        self.points: dict[tuple[int, int], tuple[float, ...]] = {}
        head = f"{FIRST}\n# {json.dumps(self.plan, sort_keys=True)}\ni,j,{','.join(channels)}\n"
        try:
            self._file: IO[bytes] = path.open("xb")
        except FileExistsError:
            raise AnnulusError(f"{path}: is there already, expected a new name, or to be told to resume it") from None
        except OSError as error:
            raise AnnulusError(f"{path}: cannot be written ({error.strerror})") from None
        self._append(head.encode())

    @classmethod
    def resumed(cls, path: Path) -> Self:
        """The log of a scan that ended early. AnnulusError naming the line that is wrong."""
        one = cls.__new__(cls)
        content = read_bounded(path, BYTES_MAX)
        whole = content[: content.rfind(b"\n") + 1]
        lines = whole.decode("utf-8", "replace").split("\n")[:-1]
        if len(lines) < 3 or lines[0] != FIRST or not lines[1].startswith("# "):
            raise AnnulusError(f"{path}: is no log of `annulus joint scan`, expected one to go on with")
        try:
            one.plan = dict(mapping(parse_json(lines[1][2:].encode(), PLAN_MAX), "plan"))
        except ValueError as error:
            raise AnnulusError(f"{path}: line 2: {error}") from None
        names = tuple(lines[2].split(","))
        if names[:2] != ("i", "j") or not names[2:] or any(name not in CHANNELS for name in names[2:]):
            raise AnnulusError(f"{path}: line 3 is {shown(lines[2])}, expected i,j and {' or '.join(CHANNELS)}")
        one.path, one.channels, one.points = path, names[2:], {}
        for number, line in enumerate(lines[3:], start=4):
            fields = line.split(",")
            try:
                place, values = (int(fields[0]), int(fields[1])), tuple(float(field) for field in fields[2:])
            except (ValueError, IndexError):
                place, values = (0, 0), ()
            if len(values) != len(one.channels) or not all(map(math.isfinite, values)):
                raise AnnulusError(f"{path}: line {number} is {shown(line)}, expected {','.join(names)}")
            one.points[place] = values
        one._file = path.open("r+b")
        one._file.truncate(len(whole))
        one._file.seek(0, os.SEEK_END)
        return one

    def add(self, i: int, j: int, values: Mapping[str, float]) -> None:
        """Keep a point, on disk when this returns."""
        readings = tuple(values[name] for name in self.channels)
        self._append(f"{i},{j},{','.join(f'{value:.6g}' for value in readings)}\n".encode())
        self.points[i, j] = readings

    def close(self) -> None:
        self._file.close()

    def _append(self, line: bytes) -> None:
        try:
            self._file.write(line)
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise AnnulusError(f"{self.path}: cannot be written ({error.strerror}); what it has stays") from None


def write_raster(path: Path, log: RasterLog, angle_deg: FloatArray, z_mm: FloatArray) -> None:
    """The raster (.npz) of a whole log, as `read_raster` takes it; replaced in one go."""
    arrays = {name: np.full((len(angle_deg), len(z_mm)), np.nan) for name in log.channels}
    for (i, j), values in log.points.items():
        for name, value in zip(log.channels, values, strict=True):
            arrays[name][i, j] = value
    try:
        with written_whole(path) as file:
            np.savez(file, angle_deg=angle_deg, z_mm=z_mm, **arrays)  # type: ignore[arg-type]
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror}); the points are in {log.path}") from None
