"""A capacitive head's log: CSV, plain or gzipped. t_s, odometer_mm, c1_pf .. c3_pf, cref_pf, roll_deg; others if there.

An empty cell is a reading that failed. loss1_ff .. loss3_ff (conductance over omega) and off_x_mm, off_y_mm are taken
where all of them are there.
"""

import csv
import gzip
import io
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.storage.numbers import require_cells
from annulus_pipe.storage.place import opened_file
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError

BYTES_MAX = 400_000_000  # 20 km of pipe, unpacked
NEEDED = ("t_s", "odometer_mm", "c1_pf", "c2_pf", "c3_pf", "cref_pf", "roll_deg")
LOSS, OFFSET = ("loss1_ff", "loss2_ff", "loss3_ff"), ("off_x_mm", "off_y_mm")
PF_MAX = 1000.0
STRAY_MAX = 0.5  # of the rows: with more failed readings it is no log


Columns = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, FloatArray | None, FloatArray | None]


def read_bore_log(path: Path) -> Columns:
    """t_s, odometer_mm (N,), c_pf (N, 3), reference_pf, roll_deg (N,); loss_ff (N, 3), offset_mm (N, 2) or None.

    NaN where a cell is empty. Raises AnnulusError in one line: which row and column, what it is, what was expected.
    """
    rows = csv.reader(io.StringIO(_text(path), newline=""))
    try:
        head = [name.strip() for name in next(rows, [])]
        missing = [name for name in NEEDED if name not in head]
        if missing:
            raise AnnulusError(f"{path}: no column {' and '.join(missing)}, expected {', '.join(NEEDED)}")
        twice = sorted({name for name in head if head.count(name) > 1})
        if twice:
            raise AnnulusError(f"{path}: column {shown(twice[0])} is there twice")
        wanted = [*NEEDED, *(name for group in (LOSS, OFFSET) if set(group) <= set(head) for name in group)]
        at = [head.index(name) for name in wanted]
        table = [
            [_number(path, rows.line_num, head[k], row[k]) for k in at]
            for row in _whole(path, rows, len(head))
            if any(cell.strip() for cell in row)
        ]
    except csv.Error as error:
        raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
    if not table:
        raise AnnulusError(f"{path}: no rows, expected readings")
    column = dict(zip(wanted, np.array(table).T, strict=True))
    c = np.stack([column[name] for name in NEEDED[2:5]], axis=1)
    _check(path, column, c)
    loss = np.stack([column[name] for name in LOSS], axis=1) if LOSS[0] in column else None
    offset = np.stack([column[name] for name in OFFSET], axis=1) if OFFSET[0] in column else None
    return (column["t_s"], column["odometer_mm"], c, column["cref_pf"], column["roll_deg"], loss, offset)


def _check(path: Path, column: dict[str, FloatArray], c: FloatArray) -> None:
    lost = float(np.mean(~np.isfinite(np.column_stack([c, *column.values()])).all(axis=1)))
    if lost > STRAY_MAX:
        raise AnnulusError(f"{path}: {100 * lost:.0f} % of the rows have an empty cell, expected at most 50")
    time = column["t_s"][np.isfinite(column["t_s"])]
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        raise AnnulusError(f"{path}: t_s goes back from {time[back[0]]:g} to {time[back[0] + 1]:g} s, expected rising")
    for name in NEEDED[2:6]:
        middle = float(np.nanmedian(column[name]))
        if not 0 < middle < PF_MAX:
            raise AnnulusError(f"{path}: {name} is {middle:g} in the middle, expected pF, 0 to {PF_MAX:g}")


def _whole(path: Path, rows: Any, columns: int) -> Iterator[list[str]]:
    for row in rows:
        try:
            if any(cell.strip() for cell in row):
                require_cells(row, columns)
        except ValueError as error:
            raise AnnulusError(f"{path}: line {rows.line_num}: {error}") from None
        yield row


def _number(path: Path, line: int, name: str, cell: str) -> float:
    cell = cell.strip()
    if not cell:
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        raise AnnulusError(f"{path}: line {line}: {name} is {shown(cell)}, expected a number") from None
    if not abs(value) < 1e12:
        raise AnnulusError(f"{path}: line {line}: {name} is {shown(cell)}, expected a number")
    return value


def _text(path: Path) -> str:
    try:
        with opened_file(path) as file:
            packed = file.read(2) == b"\x1f\x8b"
            file.seek(0)
            data = (gzip.GzipFile(fileobj=file) if packed else file).read(BYTES_MAX + 1)
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or str(error) or "cut short"
        raise AnnulusError(f"{path}: cannot be read ({reason}), expected a head's log, .csv or .csv.gz") from None
    if len(data) > BYTES_MAX:
        raise AnnulusError(f"{path}: over {BYTES_MAX // 1_000_000} MB, expected a head's log")
    return data.decode("utf-8-sig", errors="replace")
