"""`annulus console`: the page from which a head is run."""

import contextlib
import sys
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from annulus.vocabulary import AnnulusError

EXAMPLE = "Example: annulus console --demo"


def console(
    daemon: Annotated[str | None, typer.Option(metavar="PUBLISH,CONTROL", help="The daemon's two addresses.")] = None,
    demo: Annotated[bool, typer.Option("--demo", help="Start a simulated head and a daemon for it.")] = False,
    host: Annotated[str, typer.Option(help="Address to serve the page at.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to serve the page at.")] = 8600,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="Folder for what --demo writes; kept.")] = None,
) -> None:
    """Serve the page from which a head is run, until Ctrl-C."""
    from annulus.console.demo import simulated
    from annulus.console.web import State, serve

    with contextlib.ExitStack() as stack:
        if demo:
            folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="annulus-console-")))
            folder.mkdir(parents=True, exist_ok=True)
            print("starting a simulated head and its daemon", file=sys.stderr, flush=True)
            publish, control = stack.enter_context(simulated(folder))
        elif daemon is not None and daemon.count(",") == 1:
            publish, control = daemon.split(",")
        else:
            raise AnnulusError("expected --daemon PUBLISH,CONTROL or --demo")
        print(f"http://{host}:{port}/", flush=True)
        serve(State(publish, control, demo=demo), host, port)
