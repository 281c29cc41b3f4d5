"""What a scan is held against: the options that name it, and `annulus reference check`, for the workshop."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from annulus_pipe.cli.show import Bars, Json, progress, verbs
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.wall.reference import ReferenceSection

app = verbs()

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
    spans = [word for word in words or () if ":" in word and not word.endswith((".json", ".toml"))]
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
    from annulus_pipe.wall.reference import sections_of

    try:
        sections = sections_of(spans, diameter_mm, U_MM if k2_mm is None else k2_mm, "--reference")
    except ValueError as error:
        raise AnnulusError(str(error)) from None
    return sections, Path(files[0]) if files else None


@app.command(
    "check",
    epilog="Example: annulus reference check sleeve.mcap --reference 0:120 --reference-diameter 152.40 "
    "--reference-u 0.02",
)
def check(
    scan: Annotated[Path, typer.Argument(help="Scan folder or recording (.mcap) that shows the section.")],
    calibration: Annotated[
        Path | None, typer.Option(help="calibration.json of the head. A recording carries its own.")
    ] = None,
    reference: References = None,
    reference_diameter: ReferenceDiameter = None,
    reference_u: ReferenceU = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=64, help="Processes; at most one a core if not given.")
    ] = None,
    as_json: Json = False,
) -> None:
    """What the head reads of a section of known diameter, and what of its optics has drifted. Writes nothing.

    Status 1 where a section was not seen, is of another size than any drift explains, or reads wrong for sure.
    """
    from annulus_pipe.reprocess.engine import reprocess
    from annulus_pipe.reprocess.executors import Processes
    from annulus_pipe.reprocess.job import open_job
    from annulus_pipe.reprocess.optics import prior_of
    from annulus_pipe.wall.scale import drift_lines, find_scale

    sections, artefacts = sections_and_file(reference, reference_diameter, reference_u)
    work = open_job(scan, calibration, reference=artefacts, sections=sections)
    if not work.sections:
        raise AnnulusError(f"{scan}: no section of known diameter is named, expected --reference FROM:TO, as 0:120")
    with progress(Bars.BAR) as bars:
        done = reprocess(work, Processes(workers), bars)
    scale = find_scale(done.profiles, work.calibration, work.sections, prior_of(work.scan))
    if scale is None:
        raise AnnulusError(f"{scan}: what this kind of head has drifted by cannot be told from its rings")
    lines, wrong = drift_lines(scale, work.sections)
    answer: dict[str, Any] = {
        "scan": str(scan),
        "right": not wrong,
        "lines": lines,
        "sections": [
            {
                "from_mm": one.from_mm,
                "to_mm": one.to_mm,
                "diameter_mm": one.diameter_mm,
                "k2_mm": one.diameter_k2_mm,
                "reads_mm": round(mm, 3),
                "reads_k2_mm": round(scale.observed_k2_mm, 3),
            }
            for one, mm in scale.references
        ],
    }
    print(json.dumps(answer) if as_json else "\n".join(lines))
    if wrong:
        raise typer.Exit(1)
