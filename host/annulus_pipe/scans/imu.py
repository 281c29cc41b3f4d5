"""What an inertial sensor said of each frame of a scan folder: `imu.csv` beside frames.csv, where there is one.

Columns: index, dtheta_x_deg, dtheta_y_deg, dtheta_z_deg (how far the head turned since the row before, about the
camera's x, y, z: a rotation vector) and, where wanted, ax_g, ay_g, az_g (what an accelerometer reads, in g). One row a
frame, rising; a frame without a row, or with empty fields, is not known. Rows of frames that frames.csv does not list
count towards the next one.
"""

import csv
import io
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from annulus_pipe.geometry.pose import composed
from annulus_pipe.storage.numbers import number, require_cells, whole
from annulus_pipe.storage.place import Where, read_whole
from annulus_pipe.vocabulary import AnnulusError

TABLE = "imu.csv"
TURN = ("dtheta_x_deg", "dtheta_y_deg", "dtheta_z_deg")
GRAVITY = ("ax_g", "ay_g", "az_g")  # may be missing
COLUMNS = ("index", *TURN)
TABLE_MAX = 256 << 20  # bytes; a day at 25 fps has 150 MB
TURN_MAX_DEG, GRAVITY_MAX_G = 180.0, 100.0

Three = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Motion:
    """Turned since the listed frame before, a rotation vector in degrees; what the accelerometer read, g. Both about
    and along the camera's x, y, z; None where not known."""

    turned_deg: Three | None = None
    gravity_g: Three | None = None


def read_motion(folder: Where, listed: Iterable[int]) -> Mapping[int, Motion]:
    """Of every listed frame index, what imu.csv says; empty without that file. Raises AnnulusError naming the line."""
    table = folder / TABLE
    try:
        data = read_whole(table, TABLE_MAX)
    except FileNotFoundError:
        return {}
    except OSError as error:
        raise AnnulusError(f"{table}: cannot be read ({error.strerror}).") from None
    except ValueError as error:
        raise AnnulusError(f"{table}: {error}.") from None
    return _since_listed(_rows(table, data), sorted(set(listed)))


def _rows(table: Where, data: bytes) -> dict[int, Motion]:
    try:
        rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        columns = [name.strip() for name in rows.fieldnames or ()]
        if len(set(columns)) < len(columns):
            raise AnnulusError(f"{table}: line 1: a column is there twice. Expected {','.join(COLUMNS)}.")
        missing = [name for name in COLUMNS if name not in columns]
        if missing:
            raise AnnulusError(f"{table}: line 1: no column {', '.join(missing)}. Expected {','.join(COLUMNS)}.")
        rows.fieldnames = columns
        motions: dict[int, Motion] = {}
        last = -1
        for row in rows:
            try:
                require_cells(row, len(columns))
                index = whole((row["index"] or "").strip(), "index")
                if index <= last:
                    raise ValueError(f"index {index} comes after {last}, expected rising ones")
                motions[index] = Motion(
                    _three(row, TURN, TURN_MAX_DEG, "degrees"), _three(row, GRAVITY, GRAVITY_MAX_G, "g")
                )
            except ValueError as error:
                raise AnnulusError(f"{table}: line {rows.line_num}: {error}.") from None
            last = index
    except UnicodeDecodeError:
        raise AnnulusError(f"{table}: not a text file. Expected {','.join(COLUMNS)}.") from None
    except csv.Error as error:
        raise AnnulusError(f"{table}: line {rows.reader.line_num}: {error}.") from None
    return motions


def _three(row: Mapping[str, str | None], names: tuple[str, str, str], most: float, unit: str) -> Three | None:
    """None where any of the three is not there."""
    texts = [(row.get(name) or "").strip() for name in names]
    for name, text in zip(names, texts, strict=True):
        if text and not abs(number(text)) <= most:
            raise ValueError(f'{name} is "{text[:40]}", expected {unit} within {most:g}, or nothing where not known')
    x, y, z = texts
    return (float(x), float(y), float(z)) if x and y and z else None


def _since_listed(motions: Mapping[int, Motion], listed: list[int]) -> dict[int, Motion]:
    """By listed frame. A turn since the row before says nothing where a frame between has none."""
    out: dict[int, Motion] = {}
    wanted, known, turns = set(listed), True, list[Three]()
    for index in sorted({*motions, *listed}):
        motion = motions.get(index, Motion())
        known = known and motion.turned_deg is not None
        if motion.turned_deg is not None:
            turns.append(motion.turned_deg)
        if index in wanted:
            x, y, z = np.degrees(composed(np.radians(turns))) if known else (math.nan,) * 3
            out[index] = Motion((float(x), float(y), float(z)) if known else None, motion.gravity_g)
            known, turns = True, []
    return out
