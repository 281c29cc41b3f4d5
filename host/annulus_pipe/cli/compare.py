"""`annulus archive compare`: what grew between two scans of one pipe."""

import json
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, progress
from annulus_pipe.vocabulary import AnnulusError

EXAMPLE = "Example: annulus archive compare results-2024 results-2025 -o growth.json --page growth.html"


def compare(
    first: Annotated[Path, typer.Argument(help="The earlier scan: a wall map (.npz), or a folder of results.")],
    second: Annotated[Path, typer.Argument(help="The later scan.")],
    out: Annotated[Path | None, typer.Option("--out", "-o", help="Alignment and growth as JSON.")] = None,
    page: Annotated[Path | None, typer.Option(help="Map and table as one HTML page.")] = None,
    as_json: Json = False,
) -> None:
    """What grew between two scans of one pipe, with what it may be off (k=2).

    The second is laid on the first by its wall: texture, defects, beads and ovality say where along and how turned each
    row is, whatever cables and heads did. Depths and growth are positive outwards, in mm. Places that do not stand out
    are listed as unchanged, and the smallest growth that could be told is said.
    """
    from annulus_pipe.archive.comparison import compare as compared
    from annulus_pipe.archive.growth_page import write_page

    with progress() as bars:
        found = compared(first, second, bars)
    content = found.to_dict()
    if out is not None:
        try:
            out.write_text(json.dumps(content, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise AnnulusError(f"{out}: cannot be written ({error.strerror or error})") from None
    if page is not None:
        write_page(found, page)
    if as_json:
        print(json.dumps(content, allow_nan=False))
        return
    for line in found.lines():
        print(line)
    for what, file in (("result", out), ("page", page)):
        if file is not None:
            print(f"{what:<10} {file}")
