"""The anomaly list as CSV: UTF-8 with a mark at its head, for spreadsheets take it for another coding without."""

import csv
from datetime import time
from pathlib import Path

from annulus_pipe.export.results import Results
from annulus_pipe.export.tally import COLUMNS, Cell, Column, tally
from annulus_pipe.numeric.rounding import MEASURE, digits

FORMULA = ("=", "+", "-", "@", "\t", "\r")  # what a spreadsheet begins to compute at, or looks behind


def write(results: Results, path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8-sig", errors="replace") as file:
        table = csv.writer(file)
        table.writerow([column.heading for column in COLUMNS])
        for line in tally(results):
            table.writerow([_written(cell, column) for cell, column in zip(line, COLUMNS, strict=True)])


def _written(cell: Cell, column: Column) -> str:
    match cell:
        case None:
            return ""
        case time():
            return f"{cell:%H:%M}"
        case float():
            return digits(cell, column.quantity or MEASURE)
        case int():
            return str(cell)
        case _:
            return harmless(cell)


def harmless(text: str) -> str:
    """A text that no spreadsheet takes for a formula: an apostrophe before what begins like one, as they do it."""
    return f"'{text}" if text.startswith(FORMULA) else text
