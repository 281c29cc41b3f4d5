"""The options that name what a scan is held against: the pattern's artefacts, and sections of known diameter."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from annulus.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus.wall.reference import ReferenceSection

References = Annotated[
    list[str] | None,
    typer.Option(
        "--reference",
        metavar="FROM:TO|FILE",
        help="A section of known diameter, mm along the pipe, as 0:120 (also twice: start and end); or the pattern's "
        "artefacts to take out, a file from `annulus calibrate reference`.",
    ),
]
ReferenceDiameter = Annotated[
    float | None, typer.Option("--reference-diameter", metavar="MM", help="Inner diameter of the section, mm.")
]
ReferenceU = Annotated[
    float | None,
    typer.Option("--reference-u", metavar="MM", help="What that diameter may be off, mm (k = 2); 0.05 if not given."),
]
U_MM = 0.05  # of a sleeve measured with a three-point bore gauge


def sections_and_file(
    words: Sequence[str] | None, diameter_mm: float | None, k2_mm: float | None
) -> "tuple[tuple[ReferenceSection, ...], Path | None]":
    """What --reference names. Raises AnnulusError, one line."""
    spans = [word for word in words or () if ":" in word and not Path(word).exists()]
    files = [word for word in words or () if word not in spans]
    if len(files) > 1:
        raise AnnulusError(f"--reference {files[1]}: a file of the pattern's artefacts was named already")
    if not spans:
        for option, value in (("--reference-diameter", diameter_mm), ("--reference-u", k2_mm)):
            if value is not None:
                raise AnnulusError(f"{option} goes with --reference FROM:TO, mm along the pipe, as --reference 0:120")
        return (), Path(files[0]) if files else None
    if diameter_mm is None:
        raise AnnulusError(
            f"--reference {spans[0]} needs --reference-diameter, the section's inner diameter in mm, as 152.40"
        )
    from annulus.wall.reference import sections_of

    try:
        sections = sections_of(spans, diameter_mm, U_MM if k2_mm is None else k2_mm, "--reference")
    except ValueError as error:
        raise AnnulusError(str(error)) from None
    return sections, Path(files[0]) if files else None
