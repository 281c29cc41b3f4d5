"""The one command, `annulus`. Parses, calls one door, prints; imports each room only when its command is called."""

import json
import math
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus.cli import bore, burst, calibrate, doctor, firmware, head, joint, pattern, record, tai, twin
from annulus.cli import dogbones as dogbones  # its commands are of joint's group
from annulus.cli.fringe import BY, By
from annulus.cli.show import Json, print_findings, progress, tell
from annulus.cli.terminal import escaped
from annulus.numeric.compiling import telling
from annulus.untrusted import one_line
from annulus.vocabulary import AnnulusError

app = typer.Typer(
    help="Acquire and reconstruct scans of plastic pipes.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _noun in (head, burst, calibrate, pattern, tai, joint, bore, firmware, twin, record):
    app.add_typer(_noun.app, name=_noun.__name__.rpartition(".")[2])


@app.callback(invoke_without_command=True)
def about(
    version: Annotated[bool, typer.Option("--version", help="Print the version and the commit it is of.")] = False,
) -> None:
    """Acquire and reconstruct scans of plastic pipes."""
    if version:
        from importlib.metadata import version as version_of

        from annulus.shipped import commit

        print(f"annulus {version_of('annulus')}, commit {commit()}")
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
    from annulus.capture.timing import FrameTiming

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


@app.command(epilog="Example: annulus reconstruct scans/main-street --calibration head-7.json -o results")
def reconstruct(
    scan: Annotated[Path, typer.Argument(help="Scan folder (frames.csv and images) or recording (.mcap).")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder for the results; made if need be.")],
    calibration: Annotated[
        Path | None, typer.Option(help="calibration.json of the head. A recording carries its own.")
    ] = None,
    colour: Annotated[
        Path | None,
        typer.Option(help="The pipe's colours, from `annulus calibrate colour`; each frame's own if not given."),
    ] = None,
    reference: Annotated[
        Path | None, typer.Option(help="The pattern's artefacts, from `annulus calibrate reference`, to take out.")
    ] = None,
    vibration_filter: Annotated[
        bool, typer.Option("--vibration-filter", help="Take out what shakes periodically along the pipe, and say what.")
    ] = False,
    fps: Annotated[float | None, typer.Option(min=0.01, help="Frames a second, to name vibrations in hertz.")] = None,
    by: Annotated[
        By, typer.Option(help="Heights of a plate under fringes: by the calibrated slide, or by two cameras alone.")
    ] = By.SLIDE,
    workers: Annotated[int | None, typer.Option(min=1, max=64, help="Processes; one a core if not given.")] = None,
    as_json: Json = False,
) -> None:
    """From frames to the pipe wall: cloud, mesh, maps, stations, defects and a report.

    The calibration's kind chooses the method. A head that projects fringes writes depth.npz beside the rest, its finest
    map; before a plate frames.csv has x_mm in place of z_mm.
    """
    from annulus.report import Account, prepare_folder, write
    from annulus.reprocess import Processes, fringes_on, make_ready, open_job, reprocess

    wall = fringes_on(scan, calibration)
    if by is By.CAMERAS and wall != "plate":
        why = "projects no fringes" if wall is None else "lights a pipe"
        which = "without --calibration" if calibration is None else f"with {calibration}: its head {why}"
        raise AnnulusError(f"--by cameras does not go {which}, expected a head that projects fringes on a plate")
    if wall:
        for option, given in (
            ("--colour", colour),
            ("--reference", reference),
            ("--vibration-filter", vibration_filter),
        ):
            if given:
                raise AnnulusError(f"{option} does not go with {calibration or scan}: its head projects fringes")
        if wall == "pipe" or calibration is None:
            _reconstruct_fringe_pipe(scan, calibration, out, as_json)
        else:
            _reconstruct_fringe(scan, calibration, out, by, as_json)
        return
    job = open_job(scan, calibration, colour=colour, reference=reference)
    prepare_folder(out)
    make_ready(job.calibration, tell)
    with progress() as bars:
        done = reprocess(job, Processes(workers), bars)
        survey = done.survey(vibration=vibration_filter, fps=fps, progress=bars)
    summary = write(survey, Account(str(scan), done.frames, done.drops, done.timing_ms, done.findings), out)
    if as_json:
        print(json.dumps(summary))
    else:
        _print_summary(summary, out)


def _reconstruct_fringe_pipe(scan: Path, calibration: Path | None, out: Path, as_json: bool) -> None:
    from annulus.report import Account, prepare_folder, write
    from annulus.reprocess import open_fringe_pipe, reconstruct_fringe_pipe

    job = open_fringe_pipe(scan, calibration)
    prepare_folder(out)
    with progress() as bars:
        found = reconstruct_fringe_pipe(job, bars)
    counts = job.scan.counts()
    account = Account(str(scan), counts, {"frames_unknown": counts["unknown"]}, found.timing_ms, found.findings)
    seen = found.map
    depth = {
        "phi_deg": seen.phi_deg, "z_mm": seen.z_mm, "radius_mm": seen.radius_mm, "sigma_mm": seen.sigma_mm,
        "at_least": seen.at_least, "light": seen.dc, "modulation": seen.modulation,
    }  # fmt: skip
    summary = write(found.survey, account, out, depth=depth)
    if as_json:
        print(json.dumps(summary))
    else:
        _print_summary(summary, out)


def _reconstruct_fringe(scan: Path, calibration: Path, out: Path, by: By, as_json: bool) -> None:
    from annulus.report import Account, prepare_folder, write_plate
    from annulus.reprocess import open_fringe, reconstruct_fringe

    job = open_fringe(scan, calibration, "cameras" if by is By.CAMERAS else "slide")
    prepare_folder(out)
    with progress() as bars:
        plate = reconstruct_fringe(job, bars)
    counts = job.scan.counts()
    summary = write_plate(
        plate, Account(str(scan), counts, {"frames_unknown": counts["unknown"]}, plate.timing_ms), out
    )
    if as_json:
        print(json.dumps(summary))
        return
    print(f"by         {BY[By(plate.by)]}")
    height, sigma, places = (summary[key] for key in ("height_mm", "sigma_mm", "places"))
    print(f"frames     {', '.join(f'{n} {label}' for label, n in counts.items())}")
    print(
        f"motion     {places['length_mm']:.2f} mm in {places['flashes']} flashes; x_mm up to "
        f"{places['off_odometer_mm']:.3f} mm off what the frames say"
    )
    print(f"points     {summary['points']}, {100 * summary['completeness']:.1f} % of what the slide lit")
    print(f"height     {height['min']:.2f}..{height['max']:.2f} mm, median {height['median']:.3f}")
    print(f"known to   ± {2 * sigma['p50']:.3f} mm (k=2, median), ± {2 * sigma['p95']:.3f} in the worst twentieth")
    for reason, cells in summary["untold"].items():
        print(f"not told   {cells} places: {reason}")
    for warning in summary["warnings"]:
        print(f"warning    {warning['text']}")
    print(f"report     {out / 'report.html'}")


def _up(mm: float) -> str:
    """An uncertainty is rounded up."""
    return f"{max(math.ceil(100 * mm - 1e-9), 1) / 100:.2f}"


def _print_summary(data: Mapping[str, Any], out: Path) -> None:
    diameter = data["diameter_mm"]
    counts = ", ".join(f"{n} {label}" for label, n in data["frames"].items())
    print(f"frames     {counts}")
    if diameter["mean"] is not None:
        k2 = f" ± {_up(diameter['k2'])}" if diameter.get("k2") is not None else ""
        print(f"diameter   {diameter['mean']:.2f}{k2} mm mean (k=2), {diameter['min']:.2f}..{diameter['max']:.2f} mm")
    print(f"points     {data['points']}")
    for d in data["defects"]:
        k2 = f" ± {_up(d['depth_k2_mm'])}" if d.get("depth_k2_mm") is not None else ""
        least = "" if d.get("floor_seen", True) else ">= "
        print(
            f"{d['kind']:<10} {least}{d['depth_mm']:.2f}{k2} mm at {d['z_mm']:.0f} mm, "
            f"clock {d['clock']}, {d['length_mm']:.0f} mm long, {d['arc_deg']:.0f} deg"
            + (f", {d['hidden_mm']:.0f} mm of it hidden" if d["hidden_mm"] >= 0.5 else "")
        )
    if not data["defects"]:
        print("defects    none" + (" that is sure" if data["undecided"] else ""))
    for f in data["features"]:
        where = "all round" if f["arc_deg"] >= 360 else f"clock {f['clock']}, {f['arc_deg']:.0f} deg"
        print(f"{f['kind']:<10} at {f['z_mm']:.0f} mm, {where}" + (f": {f['remark']}" if f["remark"] else ""))
    for d in data["undecided"]:
        print(f"undecided  {d['depth_mm']:.2f} ± {_up(d['depth_k2_mm'])} mm at {d['z_mm']:.0f} mm, clock {d['clock']}")
    if "vibration" in data:
        for line in data["vibration"]["lines"]:
            hertz = "" if line["hertz"] is None else f" ({line['hertz']:.2f} Hz)"
            print(f"vibration  {line['cycles_per_m']:.1f} cycles/m{hertz}, {line['amplitude_mm']:.3f} mm, taken out")
        if not data["vibration"]["lines"]:
            print(f"vibration  {data['vibration']['note'] or 'none found'}")
    for warning in data["warnings"]:
        print(f"warning    {warning['text']}")
    print(f"report     {out / 'report.html'}")


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
    from annulus.demo import run_demo

    run_demo(seconds, out, open_report, head=head)


@app.command(epilog="Example: annulus daemon --config head.toml")
def daemon(
    config: Annotated[Path, typer.Option(help="head.toml: port, camera, timing, recording; see host/annulus/daemon.")],
    check: Annotated[
        bool, typer.Option("--check", help="Only look whether all is there and fits; lamps stay dark. Status 1 if not.")
    ] = False,
    log: Annotated[Path | None, typer.Option(help="Log file, in place of the one head.toml names.")] = None,
    job: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=TEXT", help="Who, where, what, for the recording: --job where='Elm Street'."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print what --check found as JSON.")] = False,
) -> None:
    """Run a head: capture, label, record, reconstruct and publish until Ctrl-C."""
    if check:
        _print_findings(config, as_json)
        return
    from annulus.daemon import run_daemon

    raise typer.Exit(run_daemon(config, log, job or ()))


def _print_findings(config: Path, as_json: bool) -> None:
    from annulus.daemon.check import check_head

    print_findings(check_head(config), as_json)


app.command(epilog=doctor.EXAMPLE)(doctor.doctor)


def main() -> None:
    """Entry point: one clear line for what a user can mend, exit status 0 only for success."""
    with escaped(), telling(tell):
        _run()


def _run() -> None:
    try:
        app()
    except AnnulusError as error:
        print(f"annulus: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("annulus: interrupted", file=sys.stderr)
        sys.exit(130)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    except Exception as error:
        if os.environ.get("ANNULUS_DEBUG"):
            raise
        what = f"{type(error).__name__}: {one_line(str(error))}"
        print(f"annulus: internal error, {what} (ANNULUS_DEBUG=1 shows where; please report it)", file=sys.stderr)
        sys.exit(70)
