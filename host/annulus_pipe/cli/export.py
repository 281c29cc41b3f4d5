"""`annulus export`: results for other programs."""

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, progress
from annulus_pipe.vocabulary import AnnulusError


class To(StrEnum):
    ALL = "all"
    POF_CSV = "pof-csv"
    XLSX = "xlsx"
    LAZ = "laz"
    GLB = "glb"
    DXF = "dxf"
    E57 = "e57"
    RADII = "radii"
    RADII_GZ = "radii-gz"


def export(
    results: Annotated[Path, typer.Argument(help="Folder that `annulus reconstruct` wrote.")],
    to: Annotated[
        list[To] | None, typer.Option("--to", help="What to write, again for more; all: each whose packages are there.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for the files. [default: RESULTS/export]")
    ] = None,
    as_json: Json = False,
) -> None:
    """Results in other programs' forms, from a results folder alone.

    pof-csv, xlsx: anomalies and features in the Pipeline Operators Forum's column order. laz, e57: the cloud in metres,
    z up. glb: the wall's coloured surface, metres, y up. dxf: stations and centre line in space, defects on an unrolled
    plan, mm. radii: 1080 radii a station (radii-gz: packed).

    Not PACP: only software that NASSCO has certified may write its exchange files, and its codes are of what a trained
    operator judges, not of what was measured. Not IFC: it describes a pipe as designed, of catalogue parts; a measured
    wall would be a bare mesh in it, which GLB is already.
    """
    from annulus_pipe.export import FORMS, available, open_results, write
    from annulus_pipe.extras import EXTRA_OF, adds

    if not to:
        raise AnnulusError(f"say what to write: --to {' --to '.join(FORMS)}, or --to all")
    there = available()
    wanted = [name for name in FORMS if name in {str(one) for one in to} or (To.ALL in to and name in there)]
    found = open_results(results)
    with progress() as bars:
        files = write(found, wanted, out or results / "export", bars)
    skipped = {name: form for name, form in FORMS.items() if To.ALL in to and form.common and name not in wanted}
    if as_json:
        print(json.dumps({"files": [str(file) for file in files], "skipped": list(skipped)}))
        return
    for file in files:
        print(f"{file.stat().st_size:>11} bytes  {file}")
    for name, form in skipped.items():
        print(f"{name:<10} not written: {adds(EXTRA_OF[form.needs[0]])}")
