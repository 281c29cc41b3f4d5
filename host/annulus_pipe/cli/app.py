"""The one command, `annulus`. Parses, calls one door, prints; imports each room only when its command is called."""

import errno
import json
import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from annulus_pipe.cli import console as console_page
from annulus_pipe.cli import doctor
from annulus_pipe.cli.back import back_view, joined_with
from annulus_pipe.cli.export import export
from annulus_pipe.cli.manual import docs
from annulus_pipe.cli.nouns import add_nouns
from annulus_pipe.cli.pdf import PaperSize, on_paper
from annulus_pipe.cli.reference import ReferenceDiameter, References, ReferenceU, sections_and_file
from annulus_pipe.cli.reprocess import EXAMPLE as REPROCESS_EXAMPLE
from annulus_pipe.cli.reprocess import reprocess
from annulus_pipe.cli.sample import sample
from annulus_pipe.cli.show import Bars, Json, print_findings, progress
from annulus_pipe.cli.terminal import OutputError, end_of_output, escaped
from annulus_pipe.cli.tune import EXAMPLE as TUNE_EXAMPLE
from annulus_pipe.cli.tune import tune
from annulus_pipe.cli.unity import EXAMPLE as UNITY_EXAMPLE
from annulus_pipe.cli.unity import unity
from annulus_pipe.hooks import opened
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.wall.conformity import Criteria


class By(StrEnum):
    SLIDE = "slide"
    CAMERAS = "cameras"


app = typer.Typer(
    help="Acquire and reconstruct scans of plastic pipes.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
add_nouns(app)
app.command(epilog="Example: annulus export results --to xlsx --to laz -o hand-over")(export)

app.command(epilog=REPROCESS_EXAMPLE)(reprocess)
app.command(epilog=UNITY_EXAMPLE)(unity)
app.command("docs", epilog="Example: annulus docs first-scan --no-open")(docs)
app.command("sample", epilog="Example: annulus sample -o pipe.mcap && annulus reconstruct pipe.mcap -o results")(sample)


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[bool, typer.Option("--version", help="Print the version and the commit it is of.")] = False,
) -> None:
    """Acquire and reconstruct scans of plastic pipes."""
    if version:
        from importlib.metadata import version as version_of

        from annulus_pipe.shipped import commit

        print(f"annulus {version_of('annulus-pipe')}, commit {commit()}")
        raise typer.Exit


@app.command(
    epilog="Example: annulus timing --fps 25 --exposure-us 38000 --readout-us 28000 --delay-us 2500 --width-us 4000"
)
def timing(
    fps: Annotated[float, typer.Option(help="Frames per second.")],
    exposure_us: Annotated[float, typer.Option(help="Exposure of a row, us.")],
    readout_us: Annotated[float, typer.Option(help="Readout, first to last line, us.")],
    delay_us: Annotated[float | None, typer.Option(help="Falling edge to lamp on, us.")] = None,
    width_us: Annotated[float | None, typer.Option(help="Lamp on to lamp off, us.")] = None,
    as_json: Json = False,
) -> None:
    """When may a flash fire? Draws the window in which all rows expose; refuses a flash outside it."""
    from annulus_pipe.capture.timing import FrameTiming

    if (delay_us is None) != (width_us is None):
        raise AnnulusError("--delay-us and --width-us describe one flash: give both or neither")
    mode = FrameTiming(fps, exposure_us, readout_us)
    if as_json:
        mode.check_window()
        if delay_us is not None and width_us is not None:
            mode.check_flash(delay_us, width_us)
        answer = {"period_us": mode.period_us, "window_opens_us": mode.opens_us, "window_closes_us": mode.closes_us}
        print(json.dumps(answer))
        return
    print(f"{mode}: after the sync signal falls,")
    print(f"  the last row opens at  T = 1/fps - T_ex = {mode.opens_us:g} us")
    print(f"  the first row closes at    1/fps - T_ro = {mode.closes_us:g} us")
    print(mode.drawing(delay_us, width_us))
    mode.check_window()
    if delay_us is not None and width_us is not None:
        mode.check_flash(delay_us, width_us)
        print(f"flash {delay_us:g}..{delay_us + width_us:g} us fits: every row sees all of it")
    else:
        print(f"longest flash: {mode.closes_us - mode.opens_us:g} us, delay {mode.opens_us:g} us")


@app.command(
    epilog="Example: annulus reconstruct scans/main-street --calibration head-7.json -o results && "
    "annulus reconstruct fore.mcap --back aft.mcap --apart-mm 180 -o results"
)
def reconstruct(
    scan: Annotated[Path, typer.Argument(help="Scan folder (frames.csv and images) or recording (.mcap).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")],
    calibration: Annotated[
        Path | None, typer.Option(help="calibration.json of the head. A recording carries its own.")
    ] = None,
    back: Annotated[
        Path | None, typer.Option(help="A scan of the same wall by a head that looked back: what steps hide from one.")
    ] = None,
    back_calibration: Annotated[
        Path | None, typer.Option(help="calibration.json of the head that looked back, if it carries none.")
    ] = None,
    apart_mm: Annotated[
        float | None,
        typer.Option(min=-5000.0, max=5000.0, help="It sat so far behind the other on one carrier, with one odometer."),
    ] = None,
    turned_deg: Annotated[
        float | None,
        typer.Option(min=-360.0, max=360.0, help=".. and turned so, clockwise looking forward; a bare wall needs it."),
    ] = None,
    colour: Annotated[
        Path | None,
        typer.Option(help="The pipe's colours, from `annulus calibrate colour`; each frame's own if not given."),
    ] = None,
    reference: References = None,
    reference_diameter: ReferenceDiameter = None,
    reference_u: ReferenceU = None,
    vibration_filter: Annotated[
        bool, typer.Option("--vibration-filter", help="Take out what shakes periodically along the pipe, and say what.")
    ] = False,
    fps: Annotated[float | None, typer.Option(min=0.01, help="Frames a second, to name vibrations in hertz.")] = None,
    by: Annotated[
        By, typer.Option(help="Heights of a plate under fringes: by the calibrated slide, or by two cameras alone.")
    ] = By.SLIDE,
    workers: Annotated[
        int | None, typer.Option(min=1, max=64, help="Processes; at most one a core if not given.")
    ] = None,
    job: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=TEXT|FILE",
            help="Who, where, which pipe, over what the scan says: job.toml, or site='Elm St'.",
        ),
    ] = None,
    limits: Annotated[
        Path | None, typer.Option(help="limits.toml: what is accepted of the pipe; no verdict without it.")
    ] = None,
    certificate: Annotated[
        Path | None,
        typer.Option(
            help="certificate.json of `annulus certify`, which the report quotes; the recording's own if none."
        ),
    ] = None,
    pod: Annotated[
        Path | None, typer.Option(help="pod.json, which the report quotes; the recording's own if not given.")
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Write report.pdf too; needs the extra pdf.")] = False,
    paper: Annotated[PaperSize, typer.Option(help="Of report.pdf.")] = PaperSize.A4,
    show_as: Annotated[
        Bars,
        typer.Option("--progress", help='How progress is told: a bar, or {"what", "done", "total"} a line of stderr.'),
    ] = Bars.BAR,
    as_json: Json = False,
) -> None:
    """From frames to the pipe wall: cloud, mesh, maps, stations, defects and a report.

    The calibration's kind chooses the method. A head that projects fringes writes depth.npz beside the rest, its finest
    map; before a plate frames.csv has x_mm in place of z_mm.
    """
    from annulus_pipe.job import job_of

    sheet, criteria = job_of(job or ()), _criteria(limits)
    sections, artefacts = sections_and_file(reference, reference_diameter, reference_u)
    printed = on_paper(pdf, paper)
    wing = opened(scan, calibration, by.value)
    if by is By.CAMERAS and wing is None:
        which = "without --calibration" if calibration is None else f"with {calibration}: its head projects no fringes"
        raise AnnulusError(f"--by cameras does not go {which}, expected a head that projects fringes on a plate")
    if wing is None:
        from annulus_pipe.reprocess.job import look_at, open_job

        # What is refused is refused before the rest is imported, and a folder made.
        work = open_job(scan, calibration, colour=colour, reference=artefacts, sections=sections)
        look_at(work)
    behind = back_view(back, back_calibration, apart_mm, turned_deg)
    from annulus_pipe.cli.results import (
        ReportContext,
        WindowFiles,
        measured_by,
        qualification_of,
        refuse,
        write_results,
    )
    from annulus_pipe.cli.summary import print_summary
    from annulus_pipe.reprocess.executors import Processes
    from annulus_pipe.scans.origin import origin_of
    from annulus_pipe.storage.place import StoragePath

    if wing is not None:
        given = {
            "colour": colour,
            "reference": reference,
            "vibration_filter": vibration_filter,
            "job": job,
            "limits": limits,
        }
        for option, file in (("--certificate", certificate), ("--pod", pod), ("--back", back)):
            if file is not None:
                raise AnnulusError(f"{option} {file}: goes with heads that project rings")
        refuse(wing[0], given)
        account = ReportContext(str(scan), origin_of(wing[0].scan, calibration, sheet), criteria)
        results = measured_by(wing, StoragePath(out.absolute()), account, Processes(workers), show_as, paper=printed)
        if as_json:
            print(json.dumps(results.summary))
        elif results.lines is None:
            print_summary(results.summary, out)
        else:
            print("\n".join([*results.lines, f"report     {out / 'report.html'}"]))
        return
    from annulus_pipe.report import prepare_folder
    from annulus_pipe.reprocess.whole import surveyed

    vouching = qualification_of(work.scan, certificate, pod)
    origin = origin_of(work.scan, calibration, sheet)
    prepare_folder(out)
    with progress(show_as) as bars:
        place, beside = StoragePath(out.absolute()), ReportContext(str(scan), origin, criteria, vouching)
        done = surveyed(
            work, place, Processes(workers), WindowFiles(beside, place), bars, vibration=vibration_filter, fps=fps
        )
        if behind is not None:
            done = joined_with(done, behind, Processes(workers), bars)
    summary = write_results(done, beside, place, printed)
    if as_json:
        print(json.dumps(summary))
    else:
        print_summary(summary, out)


def _criteria(limits: Path | None) -> "Criteria | None":
    if limits is None:
        return None
    from annulus_pipe.cli.limits_file import load_limits

    return load_limits(limits)


@app.command(epilog="Example: annulus demo --seconds 12 --out /tmp/demo --no-open")
def demo(
    seconds: Annotated[
        float | None,
        typer.Option(min=2.0, max=600.0, help="Length of the scan, s. [default: 15, longer on a slow machine]"),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results.")] = Path("annulus-demo"),
    head: Annotated[
        str, typer.Option(help="ring: one camera; stereo: two, at right angles about the projector.")
    ] = "ring",
    open_report: Annotated[bool, typer.Option("--open/--no-open", help="Open the report when done.")] = True,
) -> None:
    """The whole main job on a simulated head: scan, label, record, reconstruct, report."""
    from annulus_pipe.demo import run_demo

    run_demo(seconds, out, open_report, head=head)


@app.command(epilog="Example: annulus daemon --config head.toml")
def daemon(
    config: Annotated[
        Path, typer.Option(help="head.toml: port, camera, timing, recording; see host/annulus_pipe/daemon.")
    ],
    check: Annotated[
        bool, typer.Option("--check", help="Only look whether all is there and fits; lamps stay dark. Status 1 if not.")
    ] = False,
    log: Annotated[Path | None, typer.Option(help="Log file, in place of the one head.toml names.")] = None,
    job: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=TEXT|FILE", help="Who, where, which pipe, for the recording: --job site='Elm St'."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what --check found as JSON.")] = False,
) -> None:
    """Run a head: capture, label, record, reconstruct and publish until Ctrl-C."""
    if check:
        _print_findings(config, as_json)
        return
    from annulus_pipe.daemon import run_daemon

    raise typer.Exit(run_daemon(config, log, job or ()))


def _print_findings(config: Path, as_json: bool) -> None:
    from annulus_pipe.daemon.check import check_head

    print_findings(check_head(config), as_json)


app.command(epilog=console_page.EXAMPLE)(console_page.console)
app.command(epilog=doctor.EXAMPLE)(doctor.doctor)
app.command(epilog=TUNE_EXAMPLE)(tune)


def main() -> None:
    """Entry point: one clear line for what a user can mend, exit status 0 only for success."""
    with escaped():
        try:
            try:
                _run()
            finally:
                sys.stdout.flush()
        except OutputError as error:
            sys.exit(end_of_output(error))


def _is_short_of_memory(error: Exception) -> bool:
    """Whether this is how Python, the system or the loader of libraries says that there is no memory left."""
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    signs = {RuntimeError: "can't start new thread", ImportError: "cannot allocate memory"}
    return isinstance(error, MemoryError) or signs.get(type(error), "\0") in str(error).lower()


def _run() -> None:
    try:
        app()
    except AnnulusError as error:
        print(f"annulus: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("annulus: interrupted", file=sys.stderr)
        sys.exit(130)
    except OutputError:
        raise
    except Exception as error:
        if _is_short_of_memory(error):
            print(f"annulus: not enough memory ({one_line(str(error)) or 'none left'}).", file=sys.stderr)
            sys.exit(1)
        if os.environ.get("ANNULUS_DEBUG"):
            raise
        what = f"{type(error).__name__}: {one_line(str(error))}"
        print(f"annulus: internal error, {what} (ANNULUS_DEBUG=1 shows where; please report it)", file=sys.stderr)
        sys.exit(70)
