"""`annulus head`: one controller on the operate."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli import turntable
from annulus_pipe.cli.show import Json, Port, print_fields, verbs
from annulus_pipe.controller import CODES

app = verbs()
app.add_typer(turntable.app, name="turntable")


@app.command("status", epilog="Example: annulus head status --port /dev/ttyACM0 --json")
def status(port: Port, as_json: Json = False) -> None:
    """Who is there, and how is it? Changes nothing."""
    from annulus_pipe.link import operate

    print_fields(operate.status(port), as_json)


@app.command(
    "configure",
    epilog="Example: annulus head configure --port /dev/ttyACM0 --ratio 4 --fps 25 --exposure-us 38000 "
    "--readout-us 28000 --projector-delay-us 2500 --projector-width-us 4000 --led-delay-us 2500 --led-width-us 2000",
)
def configure(
    port: Port,
    fps: Annotated[float, typer.Option(help="Frames per second.")],
    exposure_us: Annotated[float, typer.Option(help="Exposure of a row, us.")],
    readout_us: Annotated[float, typer.Option(help="Readout, first to last line, us.")],
    projector_delay_us: Annotated[float, typer.Option(help="Falling edge to projector on, us.")],
    projector_width_us: Annotated[float, typer.Option(help="Projector on to off, us; 0 keeps it dark.")],
    led_delay_us: Annotated[float, typer.Option(help="Falling edge to LED on, us.")],
    led_width_us: Annotated[float, typer.Option(help="LED on to off, us; 0 keeps it dark.")],
    ratio: Annotated[int, typer.Option(min=0, max=15, help="Projector frames to each LED frame.")] = 4,
    inverted: Annotated[
        str | None,
        typer.Option(help="Pins whose wiring wants the other level, as sync,led; none: no pin; absent: as in force."),
    ] = None,
    trigger: Annotated[
        str | None, typer.Option(help="What cameras take, as in head.toml: none, xtrig, ..; wants --inverted as well.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Stage, validate and commit the lamp timing. A flash that does not fit the window is refused."""
    from annulus_pipe.capture.timing import FrameTiming, trigger_named
    from annulus_pipe.link import operate
    from annulus_pipe.link.pins import pins_of
    from annulus_pipe.link.stage import stage_from_us

    mode = FrameTiming(fps, exposure_us, readout_us)
    pins, tolerance = None if inverted is None else pins_of(inverted), 50
    if trigger is not None:
        if pins is None:
            raise typer.BadParameter(
                "wants --inverted as well: none, or the pins that the wiring inverts", param_hint="--trigger"
            )
        if trigger_named(trigger) != "none":
            triggers = mode.triggered(trigger)
            pins, mode = pins.triggering(trigger, triggers.width_us, triggers.delay_us), triggers.flashes_in
            tolerance = triggers.tolerance_permille
    for lamp, delay_us, width_us in (
        ("projector flash", projector_delay_us, projector_width_us),
        ("LED flash", led_delay_us, led_width_us),
    ):
        if width_us != 0:
            mode.check_flash(delay_us, width_us, lamp)
    stage = stage_from_us(
        ratio=ratio,
        period_us=mode.period_us,
        exposure_us=mode.exposure_us,
        readout_us=mode.readout_us,
        projector_us=(projector_delay_us, projector_width_us),
        led_us=(led_delay_us, led_width_us),
        tolerance_permille=tolerance,
    )
    print_fields(operate.configure(port, stage, pins), as_json)


@app.command("arm", epilog="Example: annulus head arm --port /dev/ttyACM0 --hold 10")
def arm(
    port: Port,
    hold: Annotated[float, typer.Option(min=0.0, max=86400.0, help="Seconds to stay armed; 0 = until Ctrl-C.")] = 0.0,
) -> None:
    """Arm the lamps, keep the controller fed, and disarm at the end. A fault ends it with status 1."""
    from annulus_pipe.link import operate

    operate.hold_armed(port, hold, typer.echo)


@app.command("disarm", epilog="Example: annulus head disarm --port /dev/ttyACM0")
def disarm(port: Port) -> None:
    """Every output low."""
    from annulus_pipe.link import operate

    operate.disarm(port)
    print("disarmed")


@app.command("selftest", epilog="Example: annulus head selftest --port /dev/ttyACM0 -o selftest")
def selftest(
    port: Annotated[
        str,
        typer.Option(
            help="Serial port of the controller, socket://host:port, or native:// and emulated:// for a simulated one."
        ),
    ],
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Folder for selftest.html and selftest.json.")] = None,
    edges: Annotated[int, typer.Option(min=20, max=20_000, help="Edges for latency and jitter, at 500 Hz.")] = 1000,
    yes: Annotated[bool, typer.Option("--yes", help="Everything is unplugged: do not ask, move no wire.")] = False,
    as_json: Json = False,
) -> None:
    """The controller times its own outputs: what is promised, and what this board keeps. Status 1: a promise is broken.

    Lamps, source and turntable unplugged, two jumpers: STEP (GP8) to sync (GP2), interlock (GP7) to ground.
    """
    from annulus_pipe.cli.bench import at_the_bench
    from annulus_pipe.selftest.page import render_table, verdict_line, write
    from annulus_pipe.selftest.run import run_selftest

    with at_the_bench(port, yes) as (url, move_wire):
        test = run_selftest(url, name=port, edges=edges, move_wire=move_wire)
    if as_json:
        print(json.dumps(test.to_dict()))
    else:
        print(f"{test.board} {test.serial_number} {test.firmware} {test.date}\n\n{render_table(test.rows)}\n")
        print(verdict_line(test))
    if out is not None:
        print(write(test, out), file=sys.stderr)
    if test.broken:
        raise typer.Exit(1)


@app.command("clear", epilog="Example: annulus head clear --port /dev/ttyACM0")
def clear(port: Port) -> None:
    """Clear the latched fault. Refused while its cause lasts; arms nothing."""
    from annulus_pipe.link import operate

    print(f"cleared: {operate.clear(port)}")


@app.command(
    "burst", epilog="Example: annulus head burst --port /dev/ttyACM0 --code mpsl25-stuffed --chip-us 0.5 --repeat 10"
)
def burst(
    port: Port,
    code: Annotated[str, typer.Option(help=f"{', '.join(CODES)}, or a text of 0 and 1.")],
    chip_us: Annotated[float, typer.Option(help="Length of a chip, us.")] = 0.5,
    repeat: Annotated[int, typer.Option(help="Bursts.")] = 1,
    period_us: Annotated[float, typer.Option(help="Chip 0 to chip 0, us.")] = 1000.0,
    trigger_offset_us: Annotated[
        float, typer.Option(help="Digitizer trigger after chip 0, us; may be negative.")
    ] = 0.0,
    as_json: Json = False,
) -> None:
    """Arm the microwave, fire a train of bursts, wait for its end, disarm. A fault ends it with status 1."""
    from annulus_pipe.link import operate
    from annulus_pipe.link.codes import train_from_us

    train = train_from_us(
        code, chip_us=chip_us, repeat=repeat, period_us=period_us, trigger_offset_us=trigger_offset_us
    )
    train.check()
    print_fields({"code": code} | operate.fire_burst(port, *operate.train_messages(code, train)), as_json)
