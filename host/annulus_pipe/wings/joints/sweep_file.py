"""Sweeps over frequency on disk: Touchstone version 1 (.s1p, .s2p) and CSV, and the table that names them.

Our own reader, for scikit-rf would bring pandas and its own parser for a format of one head line and rows of numbers
(Touchstone File Format Specification, Rev 1.1, EIA/IBIS 2002).
"""

import csv
import io
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.numbers import number, read_bounded, require_cells
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError

FILE_MAX = 1 << 23  # bytes: 100 000 frequencies of two ports
TABLE_MAX, SWEEPS_MAX = 1 << 18, 1000
UNITS = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9}
FORMATS = ("ma", "db", "ri")
# Columns of a row of two ports: f, S11, S21, S12, S22 (Rev 1.1: two ports have 21 before 12).
PORTS = {".s1p": 1, ".s2p": 2}
PARAMETERS = {"s11": 0, "s21": 1, "s12": 2, "s22": 3}


class SweepPlace(NamedTuple):
    """Of the table: what was measured there, and where along a dogbone, NaN where it is a point by itself."""

    name: str
    z_mm: float
    path: Path


def read_sweep(path: Path, parameter: str = "s11") -> tuple[FloatArray, FloatArray]:
    """(F,) Hz and (F,) linear magnitude. parameter : of a Touchstone file; a CSV has one.

    Raises AnnulusError with file and line.
    """
    text = read_bounded(path, FILE_MAX).decode("utf-8-sig", errors="replace")
    ports = PORTS.get(path.suffix.lower())
    if ports is None:
        return _csv(path, text)
    if parameter not in PARAMETERS or (ports == 1 and parameter != "s11"):
        raise AnnulusError(
            f"{path}: has no {shown(parameter)}, expected s11" + (", s21, s12 or s22" if ports > 1 else "")
        )
    return _touchstone(path, text, ports, PARAMETERS[parameter])


def _touchstone(path: Path, text: str, ports: int, column: int) -> tuple[FloatArray, FloatArray]:
    unit, form = 1e9, "ma"  # what the format means where its option line says nothing
    rows: list[list[float]] = []
    for line, raw in enumerate(text.splitlines(), 1):
        words = raw.split("!", 1)[0].lower().split()
        if not words:
            continue
        if words[0].startswith("["):
            raise AnnulusError(f"{path}: line {line}: a keyword of version 2, expected Touchstone version 1")
        if words[0].startswith("#"):
            if rows:
                continue  # the first counts
            words = [word for word in [words[0][1:], *words[1:]] if word]
            kinds = [word for word in words if word in ("s", "y", "z", "g", "h")]
            if kinds not in ([], ["s"]):
                raise AnnulusError(f"{path}: line {line}: {kinds[0]} parameters, expected s")
            unit = next((UNITS[word] for word in words if word in UNITS), unit)
            form = next((word for word in words if word in FORMATS), form)
            continue
        values = [number(word) for word in words]
        if len(values) == 5 and ports == 2 and rows:
            break  # the noise parameters of two ports follow the last frequency
        if len(values) != 1 + 2 * ports**2 or not all(map(math.isfinite, values)):
            raise AnnulusError(f"{path}: line {line}: expected {1 + 2 * ports**2} numbers of {ports} port(s)")
        rows.append(values)
    table = np.array(rows, float).reshape(-1, 1 + 2 * ports**2)
    first, second = table[:, 1 + 2 * column], table[:, 2 + 2 * column]
    magnitude = np.hypot(first, second) if form == "ri" else 10 ** (first / 20) if form == "db" else np.abs(first)
    return unit * table[:, 0], magnitude


def _csv(path: Path, text: str) -> tuple[FloatArray, FloatArray]:
    rows = csv.DictReader(io.StringIO(text, newline=""))
    found: list[tuple[float, float]] = []
    try:
        head = [name.strip() for name in rows.fieldnames or []]
        rows.fieldnames = head
        which = next((name for name in ("magnitude", "magnitude_db") if name in head), None)
        if which is None or "frequency_hz" not in head:
            raise AnnulusError(
                f"{path}: columns {shown(','.join(head))}, expected frequency_hz and magnitude or magnitude_db"
            )
        for row in rows:
            require_cells(row, len(head))
            pair = number(row["frequency_hz"].strip()), number(row[which].strip())
            if not all(map(math.isfinite, pair)):
                raise ValueError(f"expected a frequency and a {which}")
            found.append(pair)
    except (csv.Error, ValueError) as error:
        raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
    table = np.array(found, float).reshape(-1, 2)
    return table[:, 0], 10 ** (table[:, 1] / 20) if which == "magnitude_db" else np.abs(table[:, 1])


def read_places(path: Path) -> list[SweepPlace]:
    """A table of sweeps: point, file (beside the table) and, along a dogbone, z_mm. AnnulusError with the line."""
    rows = csv.DictReader(io.StringIO(read_bounded(path, TABLE_MAX).decode("utf-8-sig", errors="replace"), newline=""))
    places: list[SweepPlace] = []
    try:
        head = [name.strip() for name in rows.fieldnames or []]
        rows.fieldnames = head
        if not {"point", "file"} <= set(head):
            raise AnnulusError(f"{path}: columns {shown(','.join(head))}, expected point, file and, along a line, z_mm")
        for row in rows:
            require_cells(row, len(head))
            z = (row.get("z_mm") or "").strip()
            if z and not math.isfinite(number(z)):
                raise ValueError(f"z_mm is {shown(z)}, expected a number or nothing")
            places.append(
                SweepPlace(row["point"].strip(), number(z) if z else math.nan, path.parent / row["file"].strip())
            )
            if len(places) > SWEEPS_MAX:
                raise ValueError(f"more than {SWEEPS_MAX} sweeps")
    except (csv.Error, ValueError) as error:
        raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
    if not places:
        raise AnnulusError(f"{path}: no sweep, expected a line for each")
    return places
