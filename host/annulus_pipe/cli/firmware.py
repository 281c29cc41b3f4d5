"""`annulus firmware`: what runs on the controller."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from annulus_pipe.cli.show import Json, print_fields, progress, verbs
from annulus_pipe.shipped import shipped
from annulus_pipe.vocabulary import AnnulusError

app = verbs()

_Port = Annotated[
    str | None, typer.Option(help="Serial port on which firmware runs: /dev/ttyACM0, socket://host:port.")
]


def _image_path(given: Path | None, **where: Any) -> Path:
    """Of several that come with annulus, the one for the board that is there."""
    from annulus_pipe.flash.update import chip_there

    return given or shipped(chip_there(**where).image)


@app.command("info", epilog="Example: annulus firmware info --port /dev/ttyACM0")
def info(
    file: Annotated[
        Path | None, typer.Argument(help="A UF2 or ELF; the one that comes with annulus if neither is given.")
    ] = None,
    port: _Port = None,
    as_json: Json = False,
) -> None:
    """Version, board, size and protocol of an image, or who answers on a port."""
    from annulus_pipe.flash import update
    from annulus_pipe.flash.image import read_image

    if file is not None and port is not None:
        raise AnnulusError("FILE and --port: expected one of them")
    if port is not None:
        print_fields(update.board_fields(port), as_json)
        return
    fields = update.image_fields(read_image(_image_path(file)))
    waiting, running = update.boot_loader_fields(), update.find_controllers()
    if as_json:
        print(json.dumps({**fields, "boot_loaders": waiting, "controllers": [asdict(c) for c in running]}))
        return
    print_fields(fields, as_json)
    for board in waiting:
        serial = board["serial"] or "serial number not readable"
        print(f"{'boot loader':<22} USB {board['place']} ({board['chip']}, {serial})")
    for controller in running:
        print(f"{'controller':<22} {controller.port} ({controller.serial})")


@app.command("flash", epilog="Example: annulus firmware flash --port /dev/ttyACM0")
def flash(
    file: Annotated[
        Path | None, typer.Argument(help="A UF2 or ELF. The one that comes with annulus if not given.")
    ] = None,
    port: _Port = None,
    serial: Annotated[
        str | None,
        typer.Option(help="Which of several: serial number of a running controller, or place of a boot loader, 1-2.3."),
    ] = None,
    drive: Annotated[
        Path | None, typer.Option(help="Copy to this mounted drive (RPI-RP2, RP2350) instead of talking PICOBOOT.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Also an image that is not annulus, or that this host cannot talk to.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Put an image on a board and read it back.

    The board must wait in its boot loader (hold BOOTSEL while plugging it in), or run annulus on --port. A port that is
    not USB carries the image itself; breaking off is harmless, and the next time goes on from there.
    """
    from annulus_pipe.flash import update
    from annulus_pipe.flash.image import read_image, require_ours

    image = read_image(_image_path(file, port=port, serial=serial, drive=drive))
    if not force:
        require_ours(image)
    with progress() as bars:
        done = update.flash(
            image, port=port, board=serial, drive=drive, progress=bars, say=lambda line: typer.echo(line, err=True)
        )
    print_fields(asdict(done), as_json)


@app.command("monitor", epilog="Example: annulus firmware monitor --port /dev/ttyACM0 --json")
def monitor(
    port: Annotated[str, typer.Option(help="Serial port: /dev/ttyACM0, a pty, socket://host:port.")],
    seconds: Annotated[float, typer.Option(min=0.0, help="How long; 0 = until Ctrl-C.")] = 0.0,
    as_json: Json = False,
) -> None:
    """Every event and fault as it comes, and the counters every second. Keeps nothing armed."""
    from annulus_pipe.flash import update

    try:
        for line in update.monitor(port, seconds or None):
            if as_json:
                print(json.dumps(line), flush=True)
            else:
                rest = " ".join(f"{k}={_short(v)}" for k, v in line.items() if k not in ("t_s", "what"))
                print(f"{line['t_s']:9.3f}  {line['what']:<12} {rest}", flush=True)
    except KeyboardInterrupt:
        return


def _short(value: object) -> str:
    return "|".join(map(str, value)) or "-" if isinstance(value, list) else str(value)
