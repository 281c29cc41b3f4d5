"""Browsers of a console, for its tests."""

import contextlib
import json
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from annulus_pipe.console.program import Program
from annulus_pipe.console.serving import prepared

ORIGIN = "http://127.0.0.1:8600"


@dataclass
class Browser:
    """A page of this console: its cookie, its token."""

    client: Any
    token: str = ""
    origin: str = ORIGIN

    def session(self) -> dict[str, Any]:
        told: dict[str, Any] = self.client.get("/api/session").json()
        self.token = told["token"]
        return told

    def post(self, path: str, body: Any = None, **headers: str) -> Any:
        text = body if isinstance(body, str | bytes) else json.dumps(body if body is not None else {})
        usual = {"Origin": self.origin, "X-Annulus-Token": self.token, "Content-Type": "application/json"}
        kept = {name: value for name, value in {**usual, **headers}.items() if value != "-"}
        return self.client.post(path, content=text, headers=kept)

    def do(self, do: str, **more: Any) -> Any:
        return self.post("/api/do", {"do": do, **more})

    def lit(self, do: str, **more: Any) -> Any:
        """By both steps."""
        return self.do(do, confirm=self.post("/api/arm").json()["confirm"], **more)

    def view(self, **headers: str) -> Any:
        """`/ws`, as a context."""
        kept = {name: value for name, value in {"Origin": self.origin, **headers}.items() if value != "-"}
        return self.client.websocket_connect(f"ws{self.origin.removeprefix('http')}/ws", headers=kept)


@contextlib.contextmanager
def running(program: Program) -> Iterator[str]:
    server, listening = prepared(program)
    thread = threading.Thread(target=lambda: server.run(sockets=[listening]), daemon=True)
    thread.start()
    wait_for(lambda: server.started)
    try:
        yield "{}:{}".format(*listening.getsockname()[:2])
    finally:
        server.should_exit = True
        thread.join(30.0)
        assert not thread.is_alive()


def wait_for(what: Callable[[], object], seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end, f"not within {seconds:g} s"
        time.sleep(0.01)


def status(message: bytes) -> tuple[str, Mapping[str, Any]]:
    said = json.loads(message[1:])
    return said["topic"], said["body"]
