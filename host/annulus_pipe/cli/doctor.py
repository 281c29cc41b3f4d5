"""`annulus doctor`: is this machine fit for a head, and what to do where it is not."""

from pathlib import Path
from typing import Annotated

import typer

from annulus_pipe.cli.show import Json, print_findings

EXAMPLE = "Example: annulus doctor --config head.toml"


def doctor(
    config: Annotated[Path | None, typer.Option(help="head.toml: look at all that it names, too.")] = None,
    folder: Annotated[
        Path | None, typer.Option(help="Where recordings go, for the disk's speed; head.toml's, or the present folder.")
    ] = None,
    where: Annotated[
        bool, typer.Option("--where", help="Only print the folder of udev rule, systemd unit and image.")
    ] = False,
    as_json: Json = False,
) -> None:
    """What of this machine a head would stumble over: ports, boards, cameras, disk, clock, memory, versions.

    Status 1 where something is not right; a dash is neither. Writes 128 MB for the disk's speed and takes them away.
    """
    if where:
        from annulus_pipe.shipped import UDEV, shipped

        print(shipped(UDEV).parent)
        return
    from annulus_pipe import doctor as room

    print_findings(room.examine(config, folder), as_json)
