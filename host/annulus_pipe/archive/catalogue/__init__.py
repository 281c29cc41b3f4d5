"""The catalogue of surveys: Parquet files in one folder, added to by anybody at any time, asked in SQL.

    add(Path("archive"), [Path("results-1"), ..])     # Added or Refused for each
    results_of(Path("archive"), "P-17@2026")          # the folder, to be compared with another
    with open_catalogue(Path("archive")) as catalogue, catalogue.asked("SELECT .. FROM surveys") as answer: ..

`columns` are its tables, `questions` what people ask of them. A folder of results becomes one survey (`survey`), files
that are written once (`store`); many are packed, and whatever is damaged is left out and told (`pieces`). DuckDB over
them reads and can do nothing else (`engine`); a stranger's question is answered by a process of its own (`query` begins
it, `asking` is it).
"""

from annulus_pipe.archive.catalogue.entries import Added, Refused, add, checked, listed, results_of
from annulus_pipe.archive.catalogue.query import open_catalogue

__all__ = ["Added", "Refused", "add", "checked", "listed", "open_catalogue", "results_of"]
