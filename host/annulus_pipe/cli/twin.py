"""`annulus twin`: the simulated head."""

import json
from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, print_fields, progress, verbs
from annulus_pipe.vocabulary import AnnulusError

app = verbs()

Inverted = Annotated[str, typer.Option(help="Pins whose wiring wants the other level, as sync,projector,led.")]
Trigger = Annotated[
    str, typer.Option(help="What the camera takes: none, xtrig, pulse; with an outside clock xtrig_on_sync, ..")
]
Board = Annotated[
    str, typer.Option(help="native: the core in this process; emulated: the shipped image on an emulated RP2040.")
]


@app.command("run", epilog="Example: annulus twin run --fps 10 -o head, then annulus daemon --config head/head.toml")
def run(
    fps: Annotated[float, typer.Option(min=1.0, max=60.0, help="Frames per second.")] = 10.0,
    seed: Annotated[int, typer.Option(min=0, help="Of the world.")] = 1,
    faults: Annotated[Path | None, typer.Option(help="A TOML file, or a name as in `twin soak`.")] = None,
    roll_deg: Annotated[float, typer.Option(min=0.0, max=30.0, help="The head rolls so far either way.")] = 6.0,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="Folder for head.toml, calibration and truth.")
    ] = None,
    board: Board = "native",
    head: Annotated[
        str,
        typer.Option(
            help="ring: one camera; stereo: two beside the projector; fringe: one behind a static sinusoid; "
            "fringe-mirror: four about one."
        ),
    ] = "ring",
    buried_m: Annotated[
        float | None,
        typer.Option(min=5.0, max=100.0, help="Pipe in the ground, so long, with sewers; the head has sectors."),
    ] = None,
    inverted: Inverted = "none",
    trigger: Trigger = "none",
) -> None:
    """Run a simulated head in real time and print the head.toml for it, or write it. Ends with Ctrl-C."""
    from annulus_pipe.capture.timing import trigger_named
    from annulus_pipe.link.pins import pins_of

    wired, takes = pins_of(inverted), trigger_named(trigger)  # before what takes seconds to import
    from annulus_pipe.twin.head import run_head

    run_head(
        fps=fps,
        seed=seed,
        faults=faults,
        board=board,
        roll_deg=roll_deg,
        out=out,
        head=head,
        buried_m=buried_m,
        pins=wired,
        trigger=takes,
    )


@app.command("soak", epilog="Example: annulus twin soak --frames 1000000 --faults all --seed 1 --json")
def soak(
    frames: Annotated[int, typer.Option(min=100, max=10_000_000, help="Camera frames.")] = 20_000,
    seed: Annotated[int, typer.Option(min=0)] = 1,
    faults: Annotated[str, typer.Option(help="A TOML file, or a name: none, standard, rough, all, ..")] = "standard",
    without: Annotated[
        list[str] | None, typer.Option(help="A witness not to ask: arrival, order, count, lamp, torn, ..")
    ] = None,
    witnesses: Annotated[
        bool, typer.Option("--witnesses", help="What each witness is good for: short soaks with it and without.")
    ] = False,
    jobs: Annotated[int, typer.Option(min=0, max=256, help="Processes; 0: one a core.")] = 0,
    board: Board = "native",
    inverted: Inverted = "none",
    trigger: Trigger = "none",
    as_json: Json = False,
) -> None:
    """Labels and places under faults in virtual time: real firmware, link and labelling, scored against truth."""
    from annulus_pipe.capture.timing import trigger_named
    from annulus_pipe.link.pins import pins_of

    wired, takes = pins_of(inverted), trigger_named(trigger)  # before what takes seconds to import
    from annulus_pipe.twin.soak import soak

    if witnesses:
        _witnesses(seed, as_json)
        return
    with progress() as report:
        result = soak(
            frames,
            seed,
            faults=faults,
            without=without or (),
            board=board,
            jobs=jobs or None,
            progress=report,
            pins=wired,
            trigger=takes,
        )
    if as_json:
        print(json.dumps(result))
    else:
        for key, value in result.items():
            print(f"{key:<24} {value}")
    if result["wrong"]:
        raise typer.Exit(1)


def _witnesses(seed: int, as_json: bool) -> None:
    from annulus_pipe.twin.witnesses import witnesses

    with progress() as report:
        rows = witnesses(seed=seed, progress=report)
    if as_json:
        print(json.dumps(rows))
        return
    print(f"{'witness':<10} {'faults':<16} {'wrong':>6} {'without it':>11}")
    for row in rows:
        print(f"{row['witness']:<10} {row['faults']:<16} {row['wrong']:>6} {row['wrong_without']:>11}")


@app.command(
    "scan",
    epilog="Example: annulus twin scan --world butt --seed 3 --frames 26 -o scan && annulus reconstruct scan -o out "
    "--calibration scan/calibration.json && annulus twin scan --world clean --diameter 153.2 "
    "--temperature 30 -o piece-2",
)
def scan(
    out: Annotated[Path, typer.Option("-o", "--out", help="New folder for the scan.")],
    world: Annotated[
        str,
        typer.Option(
            help="demo, clean, mirror-2inch, -3inch, -4inch, stereo, stereo-3inch; fringe, fringe-modules, "
            "fringe-mirror, fringe-ball: heads that project a sinusoid; butt, coupling, branch, bend or water: pipes "
            "of several pieces, drawn from the seed."
        ),
    ] = "demo",
    frames: Annotated[int, typer.Option(min=2, max=100_000, help="Camera frames, every fifth lit by the LED.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of the world.")] = 1,
    defects: Annotated[bool, typer.Option(help="Whether the pipe has any.")] = True,
    lean: Annotated[
        float | None, typer.Option(min=0.0, max=15.0, help="Degrees the head leans at most; 8 to calibrate it.")
    ] = None,
    translucent: Annotated[
        float | None,
        typer.Option(min=0.01, max=5.0, help="mm that red light goes on in the wall before it is scattered; PE: 0.56."),
    ] = None,
    diameter: Annotated[
        float | None,
        typer.Option(metavar="MM", help="Inner diameter of the pipe at 20 degrees; the calibration stays the head's."),
    ] = None,
    spool: Annotated[
        Path | None,
        typer.Option(metavar="CSV", help="The pipe has these defects, a file as `annulus pod plan` writes it."),
    ] = None,
    temperature: Annotated[
        float | None, typer.Option(metavar="CELSIUS", help="Of head and pipe; the calibration is that of 20 degrees.")
    ] = None,
    backward: Annotated[
        bool, typer.Option("--backward", help="As a head with its own calibration sees the pipe that looks back.")
    ] = False,
    apart_mm: Annotated[
        float | None,
        typer.Option(min=0.0, max=2000.0, help="So far behind the forward head, on its carrier: with its odometer."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Write a simulated scan as a scan folder, with its calibration (of an opaque pipe) and the truth."""
    from annulus_pipe.twin.reference_pipe import at_temperature, of_diameter, with_spool
    from annulus_pipe.twin.scan import world_named, write_scan

    if apart_mm is not None and not backward:
        raise AnnulusError("--apart-mm goes with --backward")
    drawn = world_named(world, seed, defects, lean, translucent)
    counted = None
    if backward:
        from annulus_pipe.twin.back_to_back import looking_back

        if spool is not None or diameter is not None:
            raise AnnulusError("--backward does not go with --spool or --diameter")
        drawn, counted = looking_back(drawn, apart_mm)
    known = drawn.calibration()
    if diameter is not None:
        drawn = of_diameter(drawn, diameter)
    if spool is not None:
        drawn = with_spool(drawn, spool, frames)
    if temperature is not None:
        drawn = at_temperature(drawn, temperature)
    with progress() as report:
        write_scan(drawn, out, frames, report, known, counted)
    fields: dict[str, object] = {
        "scan": str(out),
        "world": world,
        "frames": frames,
        "travel_mm": round(drawn.travel_mm, 1),
    }
    if diameter is not None or temperature is not None:
        fields["diameter_mm"] = round(2 * drawn.radius_mm, 3)  # as warm as the pipe is
    print_fields({**fields, "calibration": str(out / "calibration.json")}, as_json)
