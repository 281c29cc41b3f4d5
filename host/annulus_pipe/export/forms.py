"""Which forms there are, what each needs, and how one is written: made beside, moved into place whole."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from annulus_pipe.export import dxf, e57, glb, laz, pof_csv, radii, xlsx
from annulus_pipe.export.results import Results
from annulus_pipe.untrusted import require_replaceable
from annulus_pipe.vocabulary import AnnulusError

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True)
class Form:
    """file: its name. write(results, path): makes it. needs: packages of an extra."""

    name: str
    file: str
    what: str
    write: Callable[[Results, Path], None]
    needs: tuple[str, ...] = ()
    common: bool = True  # written when all are asked for


FORMS = {
    form.name: form
    for form in (
        Form("pof-csv", "pipe-tally.csv", "anomalies and features in the POF's column order", pof_csv.write),
        Form("xlsx", "pipe-tally.xlsx", "the same as a workbook, with stations", xlsx.write, ("openpyxl",)),
        Form("laz", "cloud.laz", "the cloud, LAS 1.4", laz.write, ("laspy", "lazrs")),
        Form("glb", "mesh.glb", "the wall as a coloured surface, glTF 2.0", glb.write),
        Form("dxf", "pipe.dxf", "stations, centre line and unrolled plan", dxf.write, ("ezdxf",)),
        Form("e57", "cloud.e57", "the cloud, ASTM E2807", e57.write, ("pye57",)),
        Form("radii", "radii.csv", "1080 radii a station", radii.write),
        Form("radii-gz", "radii.csv.gz", "the same, packed, of long pipes", radii.write, common=False),
    )
}


def available() -> tuple[str, ...]:
    """Names of the forms that `all` means here: those whose packages are there."""
    return tuple(name for name, form in FORMS.items() if form.common and all(map(find_spec, form.needs)))


def write(results: Results, names: Sequence[str], out: Path, progress: Progress = lambda *_: None) -> list[Path]:
    """Write these forms into the folder `out`, made if need be. Returns the files.

    Raises AnnulusError, one line: a damaged file of the results, a missing package, a folder that cannot be written.
    Forms written before stay.
    """
    made: list[Path] = []
    for done, name in enumerate(names, start=1):
        form = FORMS[name]
        with _in_place(out, made) as staging:
            form.write(results, staging / form.file)
        progress("exports", done, len(names))
    return made


@contextlib.contextmanager
def _in_place(out: Path, made: list[Path]) -> Iterator[Path]:
    """A folder to write to, whose files are moved into `out`, and added to `made`, when all went well."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".annulus-", dir=out) as staging:
            yield Path(staging)
            for file in sorted(Path(staging).iterdir()):
                _require_replaceable(out / file.name)
                file.replace(out / file.name)
                made.append(out / file.name)
    except (FileExistsError, NotADirectoryError):
        raise AnnulusError(f"{out}: is a file, or lies below one. Expected a folder for the exports.") from None
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written to ({error.strerror or error}).") from None


def _require_replaceable(path: Path) -> None:
    try:
        require_replaceable(path)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None
