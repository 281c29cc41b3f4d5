"""wall.npz, the wall map of a results folder, read with suspicion. ValueError, one line."""

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.arrays import require_plain_npz
from annulus_pipe.untrusted import within

FORMAT = "annulus-wall/1"
NOT_SEEN_UM, BEYOND_UM = -32768, 32767  # a deviation of the second, either way, is that or more
ROWS_MAX, COLUMNS_MAX, CELLS_MAX = 1_000_000, 3600, 1 << 28
MM_MAX = 1e8  # 100 km


@dataclass(frozen=True, slots=True)
class DeviationMap:
    """deviation_um (Z, A) int16 from the radius `radius_mm`; z_mm (Z,) rising evenly, clock_deg (A,) cell centres."""

    deviation_um: NDArray[np.int16]
    z_mm: FloatArray
    clock_deg: FloatArray
    z_step_mm: float
    radius_mm: float

    def radii_mm(self, rows: slice) -> FloatArray:
        """(rows, A) distance of the wall from the pipe's axis; NaN where not seen."""
        part = self.deviation_um[rows].astype(np.int32)
        known = (part != NOT_SEEN_UM) & (np.abs(part) < BEYOND_UM)
        return np.where(known, self.radius_mm + 1e-3 * part, np.nan)


def read_wall(path: Path) -> DeviationMap:
    """The map as `reconstruct` wrote it."""
    if path.exists() and not path.is_file():
        raise ValueError("not a file")
    if not path.is_file():
        raise ValueError("is not there; were these results made by an older annulus? `annulus reconstruct` writes it")
    try:
        require_plain_npz(path)
        with np.load(path, allow_pickle=False) as file:
            names = ("format", "deviation_um", "z_mm", "clock_deg", "z_step_mm", "radius_mm")
            missing = [name for name in names if name not in file.files]
            if missing:
                raise ValueError(f"has no {missing[0]}")
            form, deviation, z, clock, step, radius = (file[name] for name in names)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError) as error:
        raise ValueError(f"not whole ({type(error).__name__})") from None
    if form.shape or str(form) != FORMAT:
        raise ValueError(f"is not of the form {FORMAT}")
    if deviation.dtype != np.int16 or deviation.ndim != 2 or not deviation.size:
        raise ValueError(f"deviation_um is {deviation.dtype} {deviation.shape}, expected int16 [z, clock]")
    rows, columns = deviation.shape
    if rows > ROWS_MAX or not 4 <= columns <= COLUMNS_MAX or deviation.size > CELLS_MAX:
        raise ValueError(f"has {rows} x {columns} cells, expected at most {ROWS_MAX} x 4..{COLUMNS_MAX}")
    for name, axis, count in (("z_mm", z, rows), ("clock_deg", clock, columns)):
        if axis.shape != (count,) or axis.dtype.kind != "f" or not np.isfinite(axis).all():
            raise ValueError(f"{name} is not {count} numbers")
        if (np.diff(axis) <= 0).any() or abs(axis).max() > MM_MAX:
            raise ValueError(f"{name} does not rise")
    if clock[0] < 0 or clock[-1] >= 360 or not np.allclose(np.diff(clock), 360 / columns, atol=1e-6):
        raise ValueError("clock_deg is not even round the circle")
    if step.shape or radius.shape or step.dtype.kind != "f" or radius.dtype.kind != "f":
        raise ValueError("z_step_mm and radius_mm must be one number each")
    step_mm = within(float(step), "z_step_mm", 1e-3, 1e6)
    radius_mm = within(float(radius), "radius_mm", 1.0, 1e5)
    return DeviationMap(deviation, z.astype(np.float64), clock.astype(np.float64), step_mm, radius_mm)
