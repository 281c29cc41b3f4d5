"""The one command, `annulus`. Parses, calls one door, prints; imports each room only when its command is called."""

import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus.vocabulary import AnnulusError

app = typer.Typer(
    help="Acquire and reconstruct scans of plastic pipes.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
twin_app = typer.Typer(help="The simulated head.", no_args_is_help=True)
app.add_typer(twin_app, name="twin")
head_app = typer.Typer(help="Talk to one controller: configure, arm, fire a burst.", no_args_is_help=True)
app.add_typer(head_app, name="head")

Port = Annotated[str, typer.Option(help="Serial port of the controller: /dev/ttyACM0, a pty, socket://host:port.")]
Json = Annotated[bool, typer.Option("--json", help="Print the answer as JSON.")]


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int], None]]:
    """A progress bar on stderr, fed with (what, done, total)."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description:<24}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    bars = Progress(*columns, console=Console(stderr=True))
    tasks: dict[str, Any] = {}

    def report(what: str, done: int, total: int) -> None:
        bars.start()
        if what not in tasks:
            tasks[what] = bars.add_task(what, total=total)
        bars.update(tasks[what], completed=done, total=total)

    try:
        yield report
    finally:
        if tasks:
            bars.stop()


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
    workers: Annotated[int | None, typer.Option(min=1, max=64, help="Processes; one a core if not given.")] = None,
    as_json: Json = False,
) -> None:
    """From frames to the pipe wall: cloud, mesh, maps, stations, defects and a report."""
    from annulus.report.reconstruct import reconstruct as run

    with _progress() as progress:
        summary = run(scan, calibration, out, workers=workers, progress=progress)
    _print_summary(summary, out, as_json)


def _print_summary(summary: Any, out: Path, as_json: bool) -> None:
    data = json.loads((out / "summary.json").read_text())
    if as_json:
        print(json.dumps(data))
        return
    diameter = data["diameter_mm"]
    counts = ", ".join(f"{n} {label}" for label, n in data["frames"].items())
    print(f"frames     {counts}")
    if diameter["mean"] is not None:
        print(f"diameter   {diameter['mean']:.2f} mm mean, {diameter['min']:.2f}..{diameter['max']:.2f} mm")
    print(f"points     {data['points']}")
    for d in data["defects"]:
        print(
            f"{d['kind']:<10} {d['depth_mm']:.2f} mm at {d['z_mm']:.0f} mm, clock {d['clock']}, "
            f"{d['length_mm']:.0f} mm long, {d['arc_deg']:.0f} deg"
        )
    if not data["defects"]:
        print("defects    none")
    print(f"report     {out / 'report.html'}")


@app.command(epilog="Example: annulus demo --seconds 12 --out /tmp/demo --no-open")
def demo(
    seconds: Annotated[
        float | None,
        typer.Option(min=2.0, max=600.0, help="Length of the scan, s. [default: 15, longer on a slow machine]"),
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("annulus-demo"),
    open_report: Annotated[bool, typer.Option("--open/--no-open", help="Open the report when done.")] = True,
) -> None:
    """The whole main job on a simulated head: scan, label, record, reconstruct, report."""
    from annulus.demo import run_demo

    run_demo(seconds, out, open_report)


@app.command(epilog="Example: annulus daemon --config head.toml")
def daemon(
    config: Annotated[Path, typer.Option(help="head.toml: port, camera, timing, recording; see host/annulus/daemon.")],
) -> None:
    """Run a head: capture, label, record, reconstruct and publish until Ctrl-C."""
    from annulus.daemon import run_daemon

    run_daemon(config)


@twin_app.command("run", epilog="Example: annulus twin run --fps 10 --seed 3")
def twin_run(
    fps: Annotated[float, typer.Option(min=1.0, max=60.0, help="Frames per second.")] = 10.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the world.")] = 1,
    faults: Annotated[Path | None, typer.Option(help="TOML file of faults to inject.")] = None,
) -> None:
    """Run a simulated head in real time and print where a daemon finds it. Ends with Ctrl-C."""
    from annulus.twin.head import run_head

    run_head(fps=fps, seed=seed, faults=faults)


@twin_app.command("soak", epilog="Example: annulus twin soak --frames 20000 --seed 1 --json")
def twin_soak(
    frames: Annotated[int, typer.Option(min=100, max=10_000_000, help="Camera frames.")] = 20_000,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    faults: Annotated[str, typer.Option(help="A TOML file, or a named set: none, standard, rough.")] = "standard",
    as_json: Json = False,
) -> None:
    """Pairing under faults in virtual time: real firmware, real link, real labels, scored against truth."""
    from annulus.twin.soak import soak

    with _progress() as progress:
        result = soak(frames, seed, faults=faults, progress=progress)
    if as_json:
        print(json.dumps(result))
    else:
        for key, value in result.items():
            print(f"{key:<24} {value}")
    if result["wrong"]:
        raise typer.Exit(1)


@head_app.command("status", epilog="Example: annulus head status --port /dev/ttyACM0 --json")
def head_status(port: Port, as_json: Json = False) -> None:
    """Who is there, and how is it? Changes nothing."""
    from annulus.link.bench import status

    _print_fields(status(port), as_json)


@head_app.command(
    "configure",
    epilog="Example: annulus head configure --port /dev/ttyACM0 --ratio 4 --fps 25 --exposure-us 38000 "
    "--readout-us 28000 --projector-delay-us 2500 --projector-width-us 4000 --led-delay-us 2500 --led-width-us 2000",
)
def head_configure(
    port: Port,
    fps: Annotated[float, typer.Option(help="Frames per second.")],
    exposure_us: Annotated[float, typer.Option(help="Exposure of a row, us.")],
    readout_us: Annotated[float, typer.Option(help="Readout, first to last line, us.")],
    projector_delay_us: Annotated[float, typer.Option(help="Falling edge to projector on, us.")],
    projector_width_us: Annotated[float, typer.Option(help="Projector on to off, us; 0 keeps it dark.")],
    led_delay_us: Annotated[float, typer.Option(help="Falling edge to LED on, us.")],
    led_width_us: Annotated[float, typer.Option(help="LED on to off, us; 0 keeps it dark.")],
    ratio: Annotated[int, typer.Option(min=0, max=15, help="Projector frames to each LED frame.")] = 4,
    as_json: Json = False,
) -> None:
    """Stage, validate and commit the lamp timing. A flash that does not fit the window is refused."""
    from annulus.capture.timing import FrameTiming
    from annulus.link.bench import configure
    from annulus.link.head import stage_from_us

    mode = FrameTiming(fps, exposure_us, readout_us)
    for lamp, delay_us, width_us in (
        ("projector flash", projector_delay_us, projector_width_us),
        ("LED flash", led_delay_us, led_width_us),
    ):
        if width_us != 0:
            mode.check_flash(delay_us, width_us, lamp)
    stage = stage_from_us(
        ratio=ratio, period_us=mode.period_us, exposure_us=exposure_us, readout_us=readout_us,
        projector_us=(projector_delay_us, projector_width_us), led_us=(led_delay_us, led_width_us),
    )  # fmt: skip
    _print_fields(configure(port, stage), as_json)


@head_app.command("arm", epilog="Example: annulus head arm --port /dev/ttyACM0 --hold 10")
def head_arm(
    port: Port,
    hold: Annotated[float, typer.Option(min=0.0, max=86400.0, help="Seconds to stay armed; 0 = until Ctrl-C.")] = 0.0,
) -> None:
    """Arm the lamps, keep the controller fed, and disarm at the end. A fault ends it with status 1."""
    from annulus.link.bench import hold_armed

    hold_armed(port, hold, typer.echo)


@head_app.command("disarm", epilog="Example: annulus head disarm --port /dev/ttyACM0")
def head_disarm(port: Port) -> None:
    """Every output low."""
    from annulus.link.bench import disarm

    disarm(port)
    print("disarmed")


@head_app.command("clear", epilog="Example: annulus head clear --port /dev/ttyACM0")
def head_clear(port: Port) -> None:
    """Clear the latched fault. Refused while its cause lasts; arms nothing."""
    from annulus.link.bench import clear

    print(f"cleared: {clear(port)}")


@head_app.command(
    "burst", epilog="Example: annulus head burst --port /dev/ttyACM0 --code mpsl25-stuffed --chip-us 0.5 --repeat 10"
)
def head_burst(
    port: Port,
    code: Annotated[str, typer.Option(help="single, mpsl25, mpsl25-stuffed, barker13, manchester1, manchester2.")],
    chip_us: Annotated[float, typer.Option(help="Length of a chip, us: 0.1 to 30.")] = 0.5,
    repeat: Annotated[int, typer.Option(min=1, max=65535, help="Bursts.")] = 1,
    period_us: Annotated[float, typer.Option(help="Chip 0 to chip 0, us.")] = 1000.0,
    trigger_offset_us: Annotated[
        float, typer.Option(help="Digitizer trigger after chip 0, us; may be negative.")
    ] = 0.0,
    as_json: Json = False,
) -> None:
    """Arm the microwave, fire a train of bursts, wait for its end, disarm. A fault ends it with status 1."""
    from annulus.link.bench import fire_burst

    _print_fields(
        fire_burst(port, code, chip_us=chip_us, repeat=repeat, period_us=period_us, offset_us=trigger_offset_us),
        as_json,
    )


def _print_fields(fields: dict[str, object], as_json: bool) -> None:
    if as_json:
        print(json.dumps(fields))
        return
    for name, value in fields.items():
        print(f"{name:<22} {value}")


def main() -> None:
    """Entry point: one clear line for what a user can mend, exit status 0 only for success."""
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
        print(
            f"annulus: internal error, {type(error).__name__}: {error} (ANNULUS_DEBUG=1 shows where; please report it)",
            file=sys.stderr,
        )
        sys.exit(70)
