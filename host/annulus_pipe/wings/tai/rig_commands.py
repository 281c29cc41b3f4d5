"""`annulus twin rig`: the simulated thermoacoustic rig."""

import threading
from typing import Annotated

import typer

from annulus_pipe.cli.show import progress, verbs
from annulus_pipe.cli.twin import Board

app = verbs()


@app.command("rig", epilog="Example: annulus twin rig --phantom wires")
def rig(
    phantom: Annotated[str, typer.Option(help="inclusions, core, wires, shapes.")] = "inclusions",
    radius_mm: Annotated[
        float, typer.Option(min=1.0, max=500.0, help="Receiver to the axis it turns about, mm.")
    ] = 25.0,
    sound_speed: Annotated[float, typer.Option(min=300.0, max=6000.0, help="m/s.")] = 1480.0,
    steps_per_turn: Annotated[int, typer.Option(min=3, max=1_000_000, help="Of the turntable.")] = 400,
    board: Board = "native",
) -> None:
    """Run a simulated thermoacoustic rig and print what `annulus tai acquire` wants. Ends with Ctrl-C."""
    from annulus_pipe.wings.tai.simulated.rig import rig_named

    with progress() as report:
        running = rig_named(phantom, radius_mm, sound_speed, steps_per_turn, board, report)
    print(f"annulus tai acquire --port {running.port_url} --scope {running.scope_name} -o raw.hdf5", flush=True)
    try:
        running.run(threading.Event())
    except KeyboardInterrupt:
        pass
    finally:
        running.close()
