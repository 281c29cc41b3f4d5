"""`annulus reprocess`: many scans, in ranges, on this machine or on the machines of a cluster."""

import contextlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from annulus_pipe.cli.reference import ReferenceDiameter, References, ReferenceU, sections_and_file
from annulus_pipe.cli.show import Bars, Json, progress, tell
from annulus_pipe.hooks import opened
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.reprocess.executors import Executor
    from annulus_pipe.storage.place import StoragePath
    from annulus_pipe.wall.reference import ReferenceSection

EXAMPLE = "Example: annulus reprocess scans/*.mcap -o season --workers 4"
NAME_MAX = 200  # characters of a folder's name


class EngineChoice(StrEnum):
    LOCAL = "local"
    DASK = "dask"


@dataclass(frozen=True, slots=True)
class _With:
    """Files that go with every scan."""

    calibration: Path | None
    colour: Path | None
    reference: Path | None
    sections: "tuple[ReferenceSection, ...]"


def reprocess(
    scans: Annotated[list[str], typer.Argument(metavar="SCANS..", help="Scan folders or recordings, or URLs of them.")],
    out: Annotated[str, typer.Option("--out", "-o", metavar="PLACE", help="Folder or URL; a folder in it a scan.")],
    engine: Annotated[
        EngineChoice, typer.Option(help="local: processes of this machine. dask: workers of the scheduler named.")
    ] = EngineChoice.LOCAL,
    scheduler: Annotated[
        str | None, typer.Option(metavar="URL", help="tcp://127.0.0.1:8786, or tls://host:8786 with the three files.")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=256, help="Processes of --engine local; at most one a core if not given.")
    ] = None,
    tls_ca: Annotated[Path | None, typer.Option(help="Whose certificates are believed, PEM.")] = None,
    tls_cert: Annotated[Path | None, typer.Option(help="This side's certificate, PEM.")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Its key, PEM.")] = None,
    calibration: Annotated[
        Path | None, typer.Option(help="calibration.json of the head. A recording carries its own.")
    ] = None,
    colour: Annotated[Path | None, typer.Option(help="The pipe's colours, from `annulus calibrate colour`.")] = None,
    reference: References = None,
    reference_diameter: ReferenceDiameter = None,
    reference_u: ReferenceU = None,
    show_as: Annotated[
        Bars,
        typer.Option("--progress", help='How progress is told: a bar, or {"what", "done", "total"} a line of stderr.'),
    ] = Bars.BAR,
    as_json: Json = False,
) -> None:
    """Scans to the results that `annulus reconstruct` makes of each, in ranges, the same to the bit.

    What was measured of a range stays in PLACE/SCAN/ranges, by the address of all it follows from. The same command
    again goes on where the last one ended. A scan that fails does not stop the others, and status 1 says so at the end.
    """
    named = folders(scans)
    place, executor = _place(out), _executor(engine, scheduler, workers, tls_ca, tls_cert, tls_key)
    sections, artefacts = sections_and_file(reference, reference_diameter, reference_u)
    given = _With(calibration, colour, artefacts, sections)
    rows = []
    try:
        with progress(show_as) as bars:
            for scan, name in named.items():
                before = f"{name}: " if len(named) > 1 else ""
                rows.append(_one(scan, place / name, executor, given, lambda what, *n, of=before: bars(of + what, *n)))
    except KeyboardInterrupt:
        tell(f"what is done is kept in {place}: the same command goes on from there")
        raise
    wrong = [row for row in rows if not row["ok"]]
    if as_json:
        print(json.dumps({"place": str(place), "scans": rows}))
    else:
        for row in rows:
            done = f"{row['ranges']} ranges, {row['made']} of them new" if row["results"] else ""
            print(f"{'ok' if row['ok'] else 'NOT OK':<8}{row['scan']}  {row['results'] or ''}  {done}".rstrip())
        for row in wrong:
            tell(f"annulus: {row['why']}")
    if wrong:
        raise typer.Exit(1)


def folders(scans: Sequence[str]) -> dict[str, str]:
    """A folder's name for every scan. Raises AnnulusError where two would have one."""
    out: dict[str, str] = {}
    for scan in dict.fromkeys(scans):
        last = scan.rstrip("/").rpartition("/")[2]
        name = last[: -len(".mcap")] if last.lower().endswith(".mcap") else last
        if not name or name in (".", "..") or len(name) > NAME_MAX or "\0" in name:
            name = Path(scan).resolve().name
        if not name:
            raise AnnulusError(f"{scan}: has no name that a folder of results could have")
        other = next((one for one, taken in out.items() if taken == name), None)
        if other is not None:
            raise AnnulusError(
                f"{scan} and {other}: both would be {name} in the results. Give each a place of its own."
            )
        out[scan] = name
    return out


def _place(out: str) -> "StoragePath":
    from annulus_pipe.report import prepare_folder
    from annulus_pipe.storage.place import StoragePath

    place = StoragePath(out)
    if place.local is None:
        return place
    prepare_folder(place.local)
    return StoragePath(place.local.absolute())  # workers have another folder to begin at


def _executor(
    engine: EngineChoice,
    scheduler: str | None,
    workers: int | None,
    ca: Path | None,
    cert: Path | None,
    key: Path | None,
) -> "Executor":
    from annulus_pipe.reprocess.executors import Processes

    if engine is EngineChoice.LOCAL:
        for option, value in (("--scheduler", scheduler), ("--tls-ca", ca), ("--tls-cert", cert), ("--tls-key", key)):
            if value is not None:
                raise AnnulusError(f"{option} goes with --engine dask")
        return Processes(workers, tries=3, apart=True)
    from annulus_pipe.reprocess.cluster import Dask, Tls
    from annulus_pipe.stream.access import require_secret

    if workers is not None:
        raise AnnulusError("--workers goes with --engine local: a cluster has the workers it has")
    if scheduler is None:
        raise AnnulusError("--engine dask needs --scheduler tcp://127.0.0.1:8786, or tls://HOST:PORT with --tls-ca ..")
    files = [one for one in (ca, cert, key) if one is not None]
    if len(files) not in (0, 3):
        raise AnnulusError("--tls-ca, --tls-cert and --tls-key go together")
    if key is not None:
        with contextlib.suppress(OSError):  # it is not there: Dask says so
            require_secret(key)
    return Dask(scheduler, Tls(*files) if files else None, say=tell)


def _one(scan: str, place: "StoragePath", executor: "Executor", given: _With, bars: Any) -> dict[str, Any]:
    row: dict[str, Any] = {
        "scan": scan,
        "ok": False,
        "results": None,
        "why": None,
        "ranges": 0,
        "made": 0,
        "left_out": 0,
    }
    try:
        row |= _reprocessed(scan, place, executor, given, bars)
    except AnnulusError as error:
        row["why"] = str(error)
    return row


def _reprocessed(scan: str, place: "StoragePath", executor: "Executor", given: _With, bars: Any) -> dict[str, Any]:
    from annulus_pipe.reprocess.job import look_at, open_job
    from annulus_pipe.storage.place import where

    path = cast(Path, where(scan))
    wing = opened(path, given.calibration)
    if wing is None:  # what is refused is refused before the rest is imported, and a folder made
        work = open_job(
            path, given.calibration, colour=given.colour, reference=given.reference, sections=given.sections
        )
        look_at(work)
    from annulus_pipe.cli.results import (
        ReportContext,
        WindowFiles,
        measured_by,
        qualification_of,
        refuse,
        write_results,
    )
    from annulus_pipe.report import prepare_folder
    from annulus_pipe.reprocess.whole import surveyed
    from annulus_pipe.scans.origin import origin_of

    if wing is not None:
        refuse(wing[0], {"colour": given.colour, "reference": given.reference or given.sections})
        account = ReportContext(scan, origin_of(wing[0].scan, given.calibration))
        results = measured_by(wing, place, account, executor, bars, keep=True)
        made = {"ranges": results.ranges, "made": results.made, "left_out": 0}
        return {"ok": True, "results": str(place), "why": None, **made}
    origin = origin_of(work.scan, given.calibration)
    if place.local is not None:
        prepare_folder(place.local)
    about = ReportContext(scan, origin, qualification=qualification_of(work.scan))
    done = surveyed(work, place, executor, WindowFiles(about, place), bars, keep=True)
    write_results(done, about, place)
    return {
        "ok": not done.left_out,
        "results": str(place),
        "ranges": done.ranges,
        "made": done.made,
        "left_out": done.left_out,
        "why": f"{scan}: {done.findings[0].text}" if done.left_out else None,
    }
