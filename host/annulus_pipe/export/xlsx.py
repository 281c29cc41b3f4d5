"""The anomaly list as a workbook: the tally, the stations, and where all of it comes from."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.export.results import Results
from annulus_pipe.export.tally import COLUMNS, EDITION, OURS, POF, Cell, clock_time, tally
from annulus_pipe.extras import need
from annulus_pipe.job import WORDS
from annulus_pipe.numeric.rounding import DISTANCE, span
from annulus_pipe.storage.results_folder import STATION_COLUMNS

COUNTERS = {  # of a recording, for who mends the head
    f"controller.{name}" for name in ("boot", "epoch", "level", "nonce", "configuration_crc", "schema", "protocol")
}
CELL_MAX = 32_000  # characters; a cell of Excel holds 32 767
ROWS_MAX = 1_048_575  # .. a sheet, below its heading
STATION_HEADINGS = (
    ("Distance [m]", "0.000"),
    ("Least diameter [mm]", "0.00"),
    ("Greatest diameter [mm]", "0.00"),
    ("Mean diameter [mm]", "0.00"),
    ("Ovality as measured, F1216 [%]", "0.00"),
    ("Ovality of the shape, F1216 [%]", "0.00"),
    ("Seen [%]", "0.0"),
    ("Diameter k=2 [mm]", "0.00"),
)

OBSERVED_HEADINGS = (
    ("Mark", "@"),
    ("Head at [m]", "0.000"),
    ("Clock position [hh:mm]", "hh:mm"),
    ("What was said", "@"),
    ("When [UTC]", "@"),
)


def write(results: Results, path: Path) -> None:
    openpyxl = need("openpyxl")
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.title = "Pipe tally"
    _fill(sheet, [column.heading for column in COLUMNS], [column.form for column in COLUMNS], tally(results))
    for cell in sheet[1][len(POF) :]:
        cell.fill = openpyxl.styles.PatternFill("solid", fgColor="E7EEF5")  # columns that are not the POF's
    headings, forms = zip(*STATION_HEADINGS, strict=True)
    _fill(book.create_sheet("Stations"), headings, forms, _stations(results))
    if results.observations:
        headings, forms = zip(*OBSERVED_HEADINGS, strict=True)
        _fill(book.create_sheet("Observations"), headings, forms, _observations(results))
    about = book.create_sheet("Source")
    _fill(about, ["What", "Value"], ["@", "General"], _about(results))
    about.column_dimensions["B"].width = 100
    for row in about.iter_rows(min_row=2, min_col=2, max_col=2):
        row[0].alignment = openpyxl.styles.Alignment(wrap_text=True, vertical="top")
    book.properties.title = "Pipe tally"
    book.properties.creator = results.made_by
    book.save(path)


def _fill(sheet: Any, headings: Sequence[str], forms: Sequence[str], lines: list[list[Cell]]) -> None:
    """Headings in a frozen row with filters; numbers as numbers; a text stays a text, whatever it begins with."""
    from openpyxl.styles import Alignment, Font

    table: list[Sequence[Cell]] = [headings, *lines[:ROWS_MAX]]
    for row, line in enumerate(table, start=1):
        for column, (value, form) in enumerate(zip(line, forms, strict=True), start=1):
            if value is None:
                continue
            cell = sheet.cell(row, column)
            if isinstance(value, str):
                cell.value = value[:CELL_MAX]
                cell.data_type = "s"  # a formula is what openpyxl takes "=1+1" for
                cell.quotePrefix = True
            else:
                cell.value = value
                cell.number_format = form
    for column, cell in enumerate(sheet[1], start=1):
        cell.font, cell.alignment = Font(bold=True), Alignment(wrap_text=True, vertical="top")
        widest = max(
            (len(str(sheet.cell(row, column).value or "")) for row in range(2, min(sheet.max_row, 60) + 1)), default=0
        )
        longest = max(len(word) for word in cell.value.split())
        sheet.column_dimensions[cell.column_letter].width = min(max(10, longest + 2, widest + 2), 60)
    sheet.freeze_panes = "A2"
    sheet.auto_filter.ref = sheet.dimensions


def _stations(results: Results) -> list[list[Cell]]:
    table = np.stack([results.stations[name] for name in STATION_COLUMNS], axis=1)
    table = table * np.array([1e-3, 1, 1, 1, 1, 1, 100, 1])
    return [[float(value) if np.isfinite(value) else None for value in row] for row in table]


def _observations(results: Results) -> list[list[Cell]]:
    """What the operator marked, by where the head stood."""
    return [
        [
            one.name,
            None if one.z_mm is None else one.z_mm / 1000,
            None if one.clock_deg is None else clock_time(one.clock_deg),
            one.text or None,
            one.utc or None,
        ]
        for one in results.observations
    ]


def _about(results: Results) -> list[list[Cell]]:
    first, last = results.scanned_mm
    lines: list[list[Cell]] = [
        ["Column order", f"{EDITION}. Columns of our own: {', '.join(column.heading for column in OURS)}."],
        [
            "Empty columns",
            "What an optical head inside a plastic pipe does not know stays empty: coordinates, "
            "thickness, seam, classification by thickness, ERF, mean depth.",
        ],
        [
            "Log distance",
            "To the middle of the place, along the pipe's centre line, by the head's odometer; its start "
            "and end stand under From and To.",
        ],
        ["Clock position", "Looking forward, 00:00 up. Of an ovality: its long axis."],
        [
            "Depth",
            "Greatest departure of the inner wall from the pipe's fitted shape. k=2: expanded uncertainty, about 95 %.",
        ],
        [
            "Observations",
            "Where there are any: what the operator marked, in their words, at the place where the head "
            "stood then. Nothing of it was measured.",
        ],
        ["Severity", "As summary.json says; empty where no limits were named."],
        ["Scan", results.source],
        ["Results of", results.created],
        ["Made by", results.made_by],
        ["Scanned [m]", span(first, last, DISTANCE, unit=False)],
        ["Points", results.points],
    ]
    lines += [[f"Job: {WORDS.get(name, name)}", value] for name, value in results.job.items()]
    lines += [[f"Recording: {name}", value] for name, value in results.origin.items() if name not in COUNTERS]
    lines += [[name, value] for name, value in results.figures.items()]
    lines += [["Warning", text] for text in results.warnings]
    return lines
