"""A daemon that runs, as the command line names it: by its head.toml, or by its two addresses and keys."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.console.program import Daemon
    from annulus_pipe.daemon.control import ClientKeys

PARTS = 2  # of an address: topics and requests

At = Annotated[
    str | None, typer.Option(metavar="PUBLISH,CONTROL", help="The daemon's two addresses, as head.toml has them.")
]
Config = Annotated[Path | None, typer.Option(help="The daemon's head.toml, where it is on this machine.")]
KeyFile = Annotated[
    Path | None, typer.Option(help="This console's secret CURVE key, as head.toml's key_file is the daemon's.")
]
DaemonKey = Annotated[
    str | None, typer.Option(metavar="KEY[,KEY]", help="The daemon's public CURVE key, or those of its two sockets.")
]


def configured(config: Path, key_file: Path | None) -> "Daemon":
    from annulus_pipe.console.program import Daemon
    from annulus_pipe.daemon.config import load_config

    head = load_config(config)
    for section, one in (("publish", head.publish), ("control", head.control)):
        if one is None:
            raise AnnulusError(
                f"{config}: [{section}] is missing, expected its address: without it no console hears or asks"
            )
    assert head.publish is not None and head.control is not None
    publish, control = (
        None if one.keys is None else _keys(key_file, one.keys.public) for one in (head.publish, head.control)
    )
    return Daemon(head.publish.address, head.control.address, publish, control)


def named_by(daemon: str, key_file: Path | None, daemon_key: str | None) -> "Daemon":
    from annulus_pipe.console.program import Daemon

    addresses = daemon.split(",")
    if len(addresses) != PARTS or not all("://" in one for one in addresses):
        raise AnnulusError(f"--daemon {daemon}: expected two addresses, tcp://127.0.0.1:5601,tcp://127.0.0.1:5602")
    if daemon_key is None:
        if key_file is not None:
            raise AnnulusError("--key-file goes with --daemon-key, the daemon's public key")
        return Daemon(addresses[0], addresses[1])
    servers = daemon_key.split(",") * (1 if "," in daemon_key else PARTS)
    if len(servers) != PARTS:
        raise AnnulusError(f"--daemon-key: {len(servers)} keys, expected one or two")
    publish, control = (_keys(key_file, server) for server in servers)
    return Daemon(addresses[0], addresses[1], publish, control)


def _keys(key_file: Path | None, server: str) -> "ClientKeys":
    from annulus_pipe.console.access import client_keys

    if key_file is None:
        raise AnnulusError("the daemon wants keys: --key-file names this console's secret CURVE key")
    return client_keys(key_file, server)
