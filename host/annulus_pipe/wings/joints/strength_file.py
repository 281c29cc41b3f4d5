"""Files of dogbones and joints: strengths and light through dogbones (CSV), and a joint's features.json."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.storage.numbers import number as parsed
from annulus_pipe.storage.numbers import read_bounded, require_cells
from annulus_pipe.untrusted import mapping, parse_json, shown
from annulus_pipe.vocabulary import AnnulusError

CSV_MAX, JSON_MAX = 1 << 20, 1 << 25
COLUMNS = ("angle_deg", "energy_j")
RESULTS = ("joint", "angle_deg", "result")
ANGLES_MIN = 8  # in features.json


def read_strengths(path: Path) -> tuple[FloatArray, FloatArray]:
    """(n,) angle_deg and (n,) energy_j, as they stand: whether they are enough is not asked here.

    A head of column names, then one dogbone a line; other columns are left alone. Raises AnnulusError with the line.
    """
    rows = csv.reader(io.StringIO(read_bounded(path, CSV_MAX).decode("utf-8-sig", errors="replace"), newline=""))
    found: list[list[float]] = []
    try:
        head = [name.strip() for name in next(rows, [])]
        missing = [name for name in COLUMNS if name not in head]
        if missing:
            raise AnnulusError(
                f"{path}: no column {' and '.join(missing)} among {shown(','.join(head))}, "
                f"expected {' and '.join(COLUMNS)}"
            )
        places = [head.index(name) for name in COLUMNS]
        found.extend(
            [_number(path, rows.line_num, row, head, place) for place in places]
            for row in rows
            if any(cell.strip() for cell in row)
        )
    except csv.Error as error:
        raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
    table = np.array(found, float).reshape(-1, len(COLUMNS))
    return table[:, 0], table[:, 1]


def read_transmission(path: Path) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(Z,) z_mm, (n,) degrees and (n, Z) mV of light through n dogbones: columns z_mm and dogbone_<degrees>."""
    rows = csv.reader(io.StringIO(read_bounded(path, CSV_MAX).decode("utf-8-sig", errors="replace"), newline=""))
    found: list[list[float]] = []
    try:
        head = [name.strip() for name in next(rows, [])]
        angles = [_degrees(path, name) for name in head[1:]]
        if head[:1] != ["z_mm"] or not angles:
            raise AnnulusError(f"{path}: columns {shown(','.join(head))}, expected z_mm, dogbone_<degrees>, ..")
        found.extend(
            [_number(path, rows.line_num, row, head, place) for place in range(len(head))]
            for row in rows
            if any(cell.strip() for cell in row)
        )
    except csv.Error as error:
        raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
    if len(found) < 2:
        raise AnnulusError(f"{path}: {len(found)} places, expected a line scan")
    table = np.array(found, float)
    return table[:, 0], np.array(angles), table[:, 1:].T


def read_results(path: Path) -> tuple[list[str], FloatArray, BoolArray]:
    """Of each dogbone: its joint's folder, angle_deg (n,) and whether it was good (n,). Columns joint, angle_deg,
    result; others are left alone."""
    rows = csv.reader(io.StringIO(read_bounded(path, CSV_MAX).decode("utf-8-sig", errors="replace"), newline=""))
    joints: list[str] = []
    angles: list[float] = []
    good: list[bool] = []
    try:
        head = [name.strip() for name in next(rows, [])]
        missing = [name for name in RESULTS if name not in head]
        if missing:
            raise AnnulusError(f"{path}: no column {' and '.join(missing)}, expected {', '.join(RESULTS)}")
        joint, angle, result = (head.index(name) for name in RESULTS)
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            angles.append(_number(path, rows.line_num, row, head, angle))
            outcome = row[result].strip()
            if outcome not in ("good", "bad"):
                raise AnnulusError(f"{path}: line {rows.line_num}: result is {shown(outcome)}, expected good or bad")
            joints.append(row[joint].strip())
            good.append(outcome == "good")
    except csv.Error as error:
        raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
    return joints, np.array(angles, float), np.array(good, bool)


def _degrees(path: Path, name: str) -> float:
    try:
        value = float(name.removeprefix("dogbone_")) if name.startswith("dogbone_") else np.nan
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise AnnulusError(f"{path}: column {shown(name)}, expected dogbone_<degrees>")
    return value


def read_features(path: Path, names: Sequence[str]) -> tuple[FloatArray, dict[str, FloatArray]]:
    """(P,) phi_deg, rising within one turn, and the named features (P,) of a features.json, NaN where it says null."""
    try:
        content = mapping(parse_json(read_bounded(path, JSON_MAX), JSON_MAX), "features")
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None
    phi = _curve(path, content.get("phi_deg"), "phi_deg")
    if len(phi) < ANGLES_MIN or not (np.diff(phi) > 0).all() or phi[-1] - phi[0] >= 360:
        raise AnnulusError(f"{path}: phi_deg: expected {ANGLES_MIN} or more degrees, rising, within one turn")
    curves = {}
    for name in names:
        if name not in content:
            raise AnnulusError(f"{path}: no feature {shown(name)}; is it of `annulus joint image`?")
        curves[name] = _curve(path, content[name], name)
        if len(curves[name]) != len(phi):
            raise AnnulusError(f"{path}: {name} has {len(curves[name])} values, expected {len(phi)} as phi_deg has")
    return phi, curves


def _number(path: Path, line: int, row: Sequence[str], head: Sequence[str], place: int) -> float:
    try:
        require_cells(row, len(head))
    except ValueError as error:
        raise AnnulusError(f"{path}: line {line}: {error}") from None
    value = parsed(row[place].strip())
    if not np.isfinite(value):
        raise AnnulusError(f"{path}: line {line}: {head[place]} is {shown(row[place].strip())}, expected a number")
    return value


def _curve(path: Path, given: object, name: str) -> FloatArray:
    values = given if isinstance(given, list) else []
    if not values or not all(v is None or (isinstance(v, int | float) and not isinstance(v, bool)) for v in values):
        raise AnnulusError(f"{path}: {name} is {shown(given)}, expected a list of numbers by angle")
    return np.array([np.nan if v is None else v for v in values], float)
