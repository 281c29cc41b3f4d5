"""`annulus sample`: a recording to try everything on, from the package `annulus-sample`."""

import json
import shutil
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, print_fields
from annulus_pipe.vocabulary import AnnulusError

PACKAGE = "annulus_sample"


def sample(
    out: Annotated[
        Path, typer.Option("--out", "-o", help="The copy; what is true of its pipe goes beside it, NAME-truth.json.")
    ] = Path("annulus-sample.mcap"),
    as_json: Json = False,
) -> None:
    """Copy the sample recording: a simulated pipe with four known defects, 64 frames, 20 MB."""
    recording, truth = _shipped("scan.mcap"), _shipped("truth.json")
    beside = out.with_name(f"{out.stem}-truth.json")
    for path in (out, beside):
        if path.exists():
            raise AnnulusError(f"{path}: is there already. Choose another name with -o.")
    try:
        shutil.copyfile(recording, out)
        shutil.copyfile(truth, beside)
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written ({error.strerror}).") from None
    known = len(json.loads(beside.read_text(encoding="utf-8"))["features"])
    print_fields({"recording": str(out), "truth": str(beside), "defects": known}, as_json)
    if not as_json:
        print(f"next: annulus reconstruct {out} -o results")


def _shipped(name: str) -> Path:
    try:
        path = Path(str(resources.files(PACKAGE))) / name
    except ModuleNotFoundError:
        path = None
    if path is None or not path.is_file():
        raise AnnulusError(
            "the sample recording is not installed: `pipx inject annulus-pipe annulus_sample-*.whl` adds it to "
            "a program of pipx, `make sample` to a checkout."
        )
    return path
