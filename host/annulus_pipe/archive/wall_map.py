"""A wall map from a file: `wall.npz` of a results folder, that folder itself, or a map of another program's.

Needed are `deviation_um` [z, clock], whole numbers from the radius `radius_mm`, and `z_step_mm`; `z_mm`, `clock_deg`,
`imu_roll_deg`, `shadowed`, `scale_part`, `oval_part` and `format` may be there. Rows lie along the pipe, columns
clockwise from 12 o'clock looking forward. Everything is checked before it is believed: AnnulusError, one line, names
the file.
"""

import math
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.storage.arrays import require_plain_npz
from annulus_pipe.untrusted import shown, within
from annulus_pipe.vocabulary import AnnulusError

FORMAT = "annulus-wall/1"
BEYOND_UM = 32767  # a deviation of it, either way, is that or more: no measure; -32768 is not seen
# Of a map that somebody hands in:
ROWS_MIN = 16  # fewer have nothing to be found by
ROWS_MAX = 200_000  # 400 m of rows 2 mm apart; bounds memory
COLUMNS_MIN = 16  # fewer show no wave of ovality and no defect
COLUMNS_MAX = 3600  # a tenth of a degree; bounds memory
CELLS_MAX = 1 << 27  # rows times columns: half a gigabyte as float32
MOST = {  # bytes of each array that is read
    "format": 4 * 200,
    "deviation_um": 2 * CELLS_MAX,
    "shadowed": CELLS_MAX,
    "z_step_mm": 8,
    "radius_mm": 8,
    "scale_part": 8,
    "oval_part": 8,
    "z_mm": 8 * ROWS_MAX,
    "clock_deg": 8 * COLUMNS_MAX,
    "imu_roll_deg": 8 * ROWS_MAX,
}
STEP_MM = (0.05, 100.0)  # between rows
RADIUS_MM = (5.0, 5000.0)  # of a pipe that anybody scans
PLACE_MM = 1e8  # either way along: 100 km
ROLL_DEG = 1e6  # either way: a sensor may count turns
PART = (0.0, 1.0)  # of the radius
EVEN = 0.01  # of a step: by so much rows may lie beside an even grid


@dataclass(frozen=True, slots=True)
class WallMap:
    """What one scan says of the wall.

    deviation_mm (Z, A) from `radius_mm`, outwards positive, NaN where not seen; row i lies at first_mm + i * step_mm
    along the pipe, column c at first_deg + c * 360 / A clockwise. imu_roll_deg (Z,): how far 12 o'clock of the columns
    is turned, NaN where no sensor said.
    """

    name: str
    deviation_mm: Float32Array
    first_mm: float
    step_mm: float
    radius_mm: float
    imu_roll_deg: FloatArray
    first_deg: float = 0.0
    scale_part: float = math.nan  # of the radius, k = 1: what all radii may be off alike; NaN where nobody said
    oval_part: float = math.nan  # the same of the long radius' excess over the mean

    @property
    def z_mm(self) -> FloatArray:
        """(Z,) places of the rows."""
        return np.asarray(self.first_mm + self.step_mm * np.arange(len(self.deviation_mm)), np.float64)

    @property
    def column_deg(self) -> float:
        return 360.0 / int(self.deviation_mm.shape[1])

    def turned_about(self) -> "WallMap":
        """The same wall as a head would have it that went the other way: rows from the far end, columns clockwise
        looking that way. Its z is counted from the last row, as negative places."""
        step = self.column_deg
        return WallMap(
            self.name,
            np.ascontiguousarray(self.deviation_mm[::-1, ::-1]),
            -float(self.z_mm[-1]),
            self.step_mm,
            self.radius_mm,
            -self.imu_roll_deg[::-1],
            -(self.first_deg + 360.0 - step),
            self.scale_part,
            self.oval_part,
        )


def read_map(path: Path) -> WallMap:
    """The map in a file or in a results folder. AnnulusError, one line, for anything else."""
    file = path / "wall.npz" if path.is_dir() else path
    if not file.exists():
        expected = "a folder with wall.npz, as reconstruct writes it" if file != path else "a wall map (.npz)"
        raise AnnulusError(f"{path}: no wall map there, expected {expected}")
    try:
        if not file.is_file():
            raise ValueError("not a file")
        require_plain_npz(file, MOST)
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in MOST if name in archive.files}
        return _believed(str(path), arrays)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        ArithmeticError,
        AttributeError,
        LookupError,
        RuntimeError,
        TypeError,
        SystemError,  # of numpy, for text of no characters
    ):
        raise AnnulusError(f"{path}: no whole .npz, expected a wall map (deviation_um, z_step_mm, radius_mm)") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}; expected a wall map (deviation_um, z_step_mm, radius_mm)") from None


def _believed(name: str, arrays: Mapping[str, NDArray[Any]]) -> WallMap:
    for needed in ("deviation_um", "z_step_mm", "radius_mm"):
        if needed not in arrays:
            raise ValueError(f"has no {needed}")
    if "format" in arrays and str(arrays["format"]) != FORMAT:
        raise ValueError(f"is of the form {shown(str(arrays['format']))}, not of {FORMAT}")
    deviation = arrays["deviation_um"]
    if deviation.dtype != np.int16 or deviation.ndim != 2:
        raise ValueError(f"deviation_um is {deviation.dtype} {shown(deviation.shape)}, not int16 [z, clock]")
    rows, columns = deviation.shape
    if not (ROWS_MIN <= rows <= ROWS_MAX and COLUMNS_MIN <= columns <= COLUMNS_MAX and deviation.size <= CELLS_MAX):
        raise ValueError(
            f"has {rows} x {columns} cells, not {ROWS_MIN}..{ROWS_MAX} x {COLUMNS_MIN}..{COLUMNS_MAX}, "
            f"{CELLS_MAX} in all"
        )
    step = _one(arrays["z_step_mm"], "z_step_mm", *STEP_MM)
    radius = _one(arrays["radius_mm"], "radius_mm", *RADIUS_MM)
    unknown = (deviation <= -BEYOND_UM) | (deviation >= BEYOND_UM)
    if "shadowed" in arrays:
        shadowed = arrays["shadowed"]
        if shadowed.shape != deviation.shape or shadowed.dtype != np.bool_:
            raise ValueError("shadowed is not a yes or no for every cell")
        unknown |= shadowed
    if unknown.all():
        raise ValueError("nothing of the wall was seen")
    first = 0.0
    if "z_mm" in arrays:
        z = _axis(arrays["z_mm"], "z_mm", rows)
        first = within(float(z[0]), "z_mm", -PLACE_MM, PLACE_MM)
        if np.abs(z - first - step * np.arange(rows)).max() > EVEN * step * max(1.0, rows / 1000):
            raise ValueError("z_mm does not rise evenly by z_step_mm")
    first_deg = 0.0
    if "clock_deg" in arrays:
        clock = _axis(arrays["clock_deg"], "clock_deg", columns)
        first_deg = within(float(clock[0]), "clock_deg", -360.0, 360.0)
        if np.abs(clock - first_deg - 360.0 / columns * np.arange(columns)).max() > EVEN:
            raise ValueError("clock_deg is not even round the pipe")
    roll = np.full(rows, np.nan)
    if "imu_roll_deg" in arrays:
        recorded = arrays["imu_roll_deg"]
        if recorded.shape != (rows,) or recorded.dtype.kind != "f" or recorded.dtype.itemsize > 8:
            raise ValueError("imu_roll_deg is not a number a row")
        with np.errstate(invalid="ignore"):  # a NaN that signals
            roll = recorded.astype(np.float64)
        roll[~(np.abs(roll) < ROLL_DEG)] = np.nan
    away = deviation.astype(np.float32)
    away /= np.float32(1000)
    away[unknown] = np.nan
    parts = [_part(arrays, part) for part in ("scale_part", "oval_part")]
    return WallMap(name, away, first, step, radius, roll, first_deg, *parts)


def _one(value: NDArray[Any], name: str, low: float, high: float) -> float:
    if value.shape or value.dtype.kind not in "fiu" or value.dtype.itemsize > 8:
        raise ValueError(f"{name} is not one number")
    return within(float(value), name, low, high)


def _part(arrays: Mapping[str, NDArray[Any]], name: str) -> float:
    """NaN where the file does not say, or says that nobody knows."""
    value = arrays.get(name)
    if value is None or (value.dtype.kind == "f" and not value.shape and np.isnan(value)):
        return math.nan
    return _one(value, name, *PART)


def _axis(value: NDArray[Any], name: str, count: int) -> FloatArray:
    if value.shape != (count,) or value.dtype.kind not in "fiu" or value.dtype.itemsize > 8:
        raise ValueError(f"{name} is not {count} numbers")
    if not np.isfinite(value).all():
        raise ValueError(f"{name} is not {count} numbers")
    return value.astype(np.float64)
