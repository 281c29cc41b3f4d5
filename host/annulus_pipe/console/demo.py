"""A simulated head and a daemon for it, as child processes, for The console with a simulated head."""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from annulus_pipe.vocabulary import AnnulusError

REMARK = "annulus console, demonstration: head and pipe are simulated, nothing of this was measured"
UP_S = 300.0  # a fresh install compiles the renderer first
END_S = 15.0

# a child that hears SIGTERM when this process is gone, however it went
_RUN = (
    "import signal; from annulus_pipe.stream.orphan import end_with_parent; end_with_parent({parent}, signal.SIGTERM); "
    "from annulus_pipe.cli import main; main()"
)


@contextlib.contextmanager
def simulated(out: Path, fps: float) -> Iterator[tuple[str, str]]:
    """A head and its daemon, which come up; where it publishes and is controlled. `out` holds what they write."""
    publish, control = (f"tcp://127.0.0.1:{port}" for port in _free_ports(2))
    toml = out / "head.toml"
    children: list[subprocess.Popen[bytes]] = []
    try:
        out.mkdir(parents=True, exist_ok=True)
        log = (out / "demo.log").open("wb")
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written ({error.strerror})") from None
    with log:
        try:
            toml.unlink(missing_ok=True)
            children.append(_child(["twin", "run", "--fps", f"{fps:g}", "-o", str(out)], log.fileno()))
            _wait(children, out)
            with toml.open("a") as file:
                file.write(
                    f'\n[publish]\naddress = "{publish}"\n\n[control]\naddress = "{control}"\nautostart = false\n'
                    f'\n[record]\nfolder = "scans"\n\n[job]\nremarks = "{REMARK}"\n'
                )
            (out / "scans").mkdir(exist_ok=True)
            children.append(_child(["daemon", "--config", str(toml)], log.fileno()))
            yield publish, control
        finally:
            for child in reversed(children):
                _end(child)


def _child(arguments: Sequence[str], log: int) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-c", _RUN.format(parent=os.getpid()), *arguments]
    return subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, start_new_session=True)


def _end(child: "subprocess.Popen[bytes]") -> None:
    with contextlib.suppress(ProcessLookupError):
        child.send_signal(signal.SIGINT)
    try:
        child.wait(END_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()


def _wait(children: Sequence["subprocess.Popen[bytes]"], out: Path) -> None:
    end = time.monotonic() + UP_S
    while "head.toml is what" not in (log := (out / "demo.log").read_text(errors="replace")):
        if any(child.poll() is not None for child in children) or time.monotonic() > end:
            last = log.strip().splitlines()[-1:]
            raise AnnulusError(f"the simulated head did not come up: {''.join(last)}")
        time.sleep(0.1)


def _free_ports(count: int) -> list[int]:
    sockets = [socket.socket() for _ in range(count)]
    try:
        for one in sockets:
            one.bind(("127.0.0.1", 0))
        return [int(one.getsockname()[1]) for one in sockets]
    finally:
        for one in sockets:
            one.close()
