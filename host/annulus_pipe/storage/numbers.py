"""Small files, rows and numbers that somebody wrote by hand or program."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from annulus_pipe.untrusted import read_file
from annulus_pipe.vocabulary import AnnulusError


def require_cells(row: Sequence[str] | Mapping[Any, Any], columns: int) -> None:
    """ValueError for a row of another number of cells than line 1 has: it was cut short, or a decimal comma parts its
    numbers, and every cell behind would stand for another column.

    row : of csv.reader, or of csv.DictReader as it is by default.
    """
    cells = len(row)
    if isinstance(row, Mapping):
        cells = sum(cell is not None for name, cell in row.items() if name is not None) + len(row.get(None, ()))
    if cells != columns:
        raise ValueError(f"{cells} cell{'s' * (cells != 1)}, expected {columns} as line 1 has")


def whole(text: str, column: str) -> int:
    """Raises ValueError naming the column."""
    if not (text.isascii() and text.isdigit()) or len(text) > 18:
        raise ValueError(f'{column} is "{text[:40]}", expected a whole number')
    return int(text)


def number(text: str) -> float:
    """NaN where it is none; "1_000" and digits of other scripts are none, though Python reads them."""
    try:
        return float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        return math.nan


def read_bounded(path: Path, limit: int) -> bytes:
    """A file of at most so many bytes. AnnulusError with its path for what is none."""
    try:
        return read_file(path, limit)
    except FileNotFoundError:
        raise AnnulusError(f"{path}: no such file") from None
    except OSError as error:
        raise AnnulusError(f"{path}: {error.strerror or error}") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None
