"""`annulus head turntable`: limits, ramp and end switches of the turntable, moves and a stop."""

from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, Port, print_fields, verbs
from annulus_pipe.controller import TURNTABLE_ACCELERATION_MAX, TURNTABLE_POSITION_MAX_STEPS

app = verbs("The turntable: configure, move, stop.")

FAR = TURNTABLE_POSITION_MAX_STEPS


@app.command(
    "configure",
    epilog="Example: annulus head turntable configure --port /dev/ttyACM0 --lowest -200 --highest 4200 "
    "--acceleration 4000 --start-us 5000 --end-low --end-high",
)
def configure(
    port: Port,
    lowest: Annotated[int, typer.Option(min=-FAR, max=FAR, help="Soft limit, steps.")] = -FAR,
    highest: Annotated[int, typer.Option(min=-FAR, max=FAR, help="Soft limit, steps.")] = FAR,
    acceleration: Annotated[
        int, typer.Option(min=0, max=TURNTABLE_ACCELERATION_MAX, help="Steps/s^2; 0: no ramp.")
    ] = 0,
    start_us: Annotated[
        float, typer.Option(min=100.0, max=1e6, help="Step to step where a ramp begins and ends, us.")
    ] = 5000.0,
    end_low: Annotated[bool, typer.Option("--end-low", help="There is a lower end switch, GP11.")] = False,
    end_high: Annotated[bool, typer.Option("--end-high", help="There is an upper end switch, GP12.")] = False,
    end_hard: Annotated[
        bool, typer.Option("--end-hard", help="A switch stops it within three steps, not along the ramp.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Where it may go, and how fast it speeds up; until the next reset. It must stand where its position says."""
    from annulus_pipe.link import operate
    from annulus_pipe.link.messages import TurntableFlag

    switches = TurntableFlag(0)
    for there, flag in (
        (end_low, TurntableFlag.END_LOW),
        (end_high, TurntableFlag.END_HIGH),
        (end_hard, TurntableFlag.END_HARD),
    ):
        switches |= flag if there else TurntableFlag(0)
    print_fields(
        operate.configure_turntable(
            port, lowest=lowest, highest=highest, acceleration=acceleration, start_us=start_us, switches=switches
        ),
        as_json,
    )


@app.command("move", epilog="Example: annulus head turntable move --port /dev/ttyACM0 --to 400 --step-us 500")
def move(
    port: Port,
    to: Annotated[int, typer.Option(min=-FAR, max=FAR, help="Position, steps.")],
    step_us: Annotated[float, typer.Option(min=100.0, max=1e6, help="Step to step, us.")] = 2000.0,
    hold: Annotated[bool, typer.Option("--hold", help="Keep the motor powered afterwards.")] = False,
    as_json: Json = False,
) -> None:
    """To a position counted since the reset, and wait until it stands. Ctrl-C brakes it."""
    from annulus_pipe.link import operate

    print_fields(operate.turn(port, to, step_us, hold=hold), as_json)


@app.command("stop", epilog="Example: annulus head turntable stop --port /dev/ttyACM0")
def stop(port: Port, as_json: Json = False) -> None:
    """Brake along the ramp, whoever moves it, and wait until it stands."""
    from annulus_pipe.link import operate

    print_fields(operate.stop_turntable(port), as_json)
