"""`annulus console`: the page from which a head is run."""

import contextlib
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from annulus_pipe.cli.running import At, Config, DaemonKey, KeyFile, configured, named_by
from annulus_pipe.cli.show import tell
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.console.program import Door

EXAMPLE = "Example: annulus console --config head.toml --surveys scans"


def console(
    daemon: At = None,
    config: Config = None,
    demo: Annotated[bool, typer.Option("--demo", help="Start a simulated head and a daemon for it.")] = False,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Folder for what --demo writes; a temporary one if not given.")
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(min=1.0, max=60.0, help="Frames per second of --demo; measured if not given: what holds here."),
    ] = None,
    key_file: KeyFile = None,
    daemon_key: DaemonKey = None,
    host: Annotated[str, typer.Option(help="Address to serve the page at; any but loopback needs TLS.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to serve the page at; 0: any.")] = 8600,
    tls_cert: Annotated[Path | None, typer.Option(help="Certificate, PEM.")] = None,
    tls_key: Annotated[Path | None, typer.Option(help="Its key, PEM.")] = None,
    name: Annotated[list[str] | None, typer.Option(help="A name by which browsers reach this machine.")] = None,
    login: Annotated[bool, typer.Option("--login", help="Ask for the password on loopback, too.")] = False,
    new_password: Annotated[bool, typer.Option("--new-password", help="Make and print another password.")] = False,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="Serve Foxglove's viewer, too, on loopback; needs the extra foxglove.")
    ] = False,
    surveys: Annotated[
        list[Path] | None, typer.Option(help="Folder of recordings and results to show; may be repeated.")
    ] = None,
) -> None:
    """Serve the page from which a head is run, until Ctrl-C."""
    from annulus_pipe.console.demo import simulated
    from annulus_pipe.console.program import Daemon, Program
    from annulus_pipe.console.serving import serve
    from annulus_pipe.extras import need

    if sum((daemon is not None, config is not None, demo)) != 1:
        raise AnnulusError("expected one of --demo, --config head.toml and --daemon PUBLISH,CONTROL")
    for needed in ("uvicorn", "starlette", "websockets"):
        need(needed)
    door = _door(host, port, tls_cert, tls_key, tuple(name or ()), login or new_password, new_password)
    folders = list(surveys or ())
    with contextlib.ExitStack() as stack:
        if demo:
            fps = fps or _paced()
            folder = out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="annulus-console-")))
            tell(f"a simulated head and its daemon come up; what they say is in {folder / 'demo.log'}")
            where = Daemon(*stack.enter_context(simulated(folder, fps)))
            folders.append(folder / "scans")
        elif config is not None:
            where = configured(config, key_file)
        else:
            where = named_by(daemon or "", key_file, daemon_key)
        program = stack.enter_context(Program(where, door, demo=demo, surveys=folders))
        if foxglove:
            program.open_to_foxglove()
            tell("Foxglove's viewer connects to ws://127.0.0.1:8765; whatever page runs in a browser here may, too")
        with contextlib.suppress(KeyboardInterrupt):  # that is how it ends
            serve(program)


def _paced() -> float:
    """What this machine holds, as `annulus demo` measures it."""
    from annulus_pipe.demo import measure_pace
    from annulus_pipe.twin.worlds import demo_world

    world = demo_world()
    tell("measuring this machine")
    pace = measure_pace(world)
    tell(pace.why)
    return pace.fps


def _door(
    host: str, port: int, tls_cert: Path | None, tls_key: Path | None, names: tuple[str, ...], login: bool, new: bool
) -> "Door":
    from annulus_pipe.console.access import Password, is_loopback, password_file
    from annulus_pipe.console.program import Door

    if (tls_cert is None) != (tls_key is None):
        raise AnnulusError("--tls-cert and --tls-key belong together: give both or neither")
    if not is_loopback(host) and tls_cert is None:
        raise AnnulusError(f"--host {host} is reached from outside: it needs --tls-cert and --tls-key")
    password = None
    if login or not is_loopback(host):
        password = Password(password_file())
        if new or not password.is_there:
            print(f"password   {password.made()}", flush=True)
            tell(f"it is shown this once; its hash is kept in {password.path}, --new-password makes another")
    return Door(host, port, tls_cert, tls_key, names, password)
