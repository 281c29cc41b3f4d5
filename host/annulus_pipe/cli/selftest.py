"""`annulus selftest`: a board is asked what it promises, by a second one."""

import json
import sys
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, verbs
from annulus_pipe.vocabulary import AnnulusError

app = verbs()


@app.command("image", epilog="Example: cp $(annulus selftest image) /media/$USER/RPI-RP2")
def image() -> None:
    """Where rig.uf2 lies: hold BOOTSEL while the second Pico is plugged in, and copy it onto its drive."""
    from annulus_pipe.shipped import RIG, shipped

    print(shipped(RIG))


@app.command("rig", epilog="Example: annulus selftest rig --device /dev/ttyACM0 --rig /dev/ttyACM1")
def rig(
    device: Annotated[str, typer.Option(help="Serial port of the controller, or socket://host:port.")],
    rig: Annotated[str, typer.Option(help="Serial port of the second Pico, which runs rig.uf2.")],
    only: Annotated[str | None, typer.Option(help="Only promises whose name has these words.")] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Everything but the jumpers is unplugged: do not ask.")] = False,
    as_json: Json = False,
) -> None:
    """Every promise of the controller that its pins can show, to 10 ns. Status 1: one is broken.

    Eight jumpers, each from a pin to the same pin of the other board, ground among them; eight more for all of it.
    """
    from annulus_pipe.selftest.rig.run import BEFORE_IT_BEGINS, render_table, run_rig, verdict_line

    print(BEFORE_IT_BEGINS, file=sys.stderr)
    if not yes and not (sys.stdin.isatty() and typer.confirm("Is that so?", err=True)):
        raise AnnulusError("nothing was done, expected somebody who says that everything is unplugged (or --yes)")
    test = run_rig(device, rig, only=only, tell=_progress)
    _progress("")
    if as_json:
        print(json.dumps(test.to_dict()))
    else:
        print(f"{test.board} {test.serial_number} {test.firmware} {test.date}")
        print(f"rig {test.rig}, its clock {test.clock_ppm:+.2f} ppm\n\n{render_table(test)}\n")
        print(verdict_line(test))
    if test.broken:
        raise typer.Exit(1)


def _progress(what: str) -> None:
    if sys.stderr.isatty():
        print(f"\r\033[K{what}", end="", file=sys.stderr, flush=True)
