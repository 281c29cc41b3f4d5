"""`/ws`: a viewer is sent what waits for it, and says what it wants."""

import asyncio
import contextlib
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from annulus_pipe import untrusted
from annulus_pipe.console.access import BrowserSession, Bucket
from annulus_pipe.console.answers import refused
from annulus_pipe.console.hub import STATUS, WANTS, Viewer
from annulus_pipe.console.program import Program

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

VIEWERS_MAX = 64
OF_ONE_MAX = 24  # of a session; those without one count as one
SAID_MAX = 512  # bytes
SAID_RATE = (10.0, 30.0)  # a second, and at once


async def view(websocket: "WebSocket", program: Program) -> None:
    """One viewer, from its coming to its going."""
    session: BrowserSession | None = websocket.scope["state"]["session"]
    mine = "" if session is None else session.id
    others = [viewer for viewer in program.hub.viewers if viewer.session == mine]
    if len(program.hub.viewers) >= VIEWERS_MAX or len(others) >= OF_ONE_MAX:
        await websocket.send_denial_response(refused("too many pages are open, expected fewer", 503))
        return
    await websocket.accept()
    viewer = Viewer(mine, program.live.catch_up)
    viewer.answered_s = time.monotonic()
    viewer.tell(STATUS, program.hello())
    program.live.welcome(viewer)
    program.hub.add(viewer)
    sending = asyncio.create_task(_send(websocket, viewer, program))
    try:
        await _listen(websocket, viewer, program)
    finally:
        program.hub.remove(viewer)
        program.stuck.pop(viewer, None)
        sending.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await sending


def cut_off(program: Program, session: str) -> None:
    """Its viewers: it logged out."""
    for viewer in list(program.hub.viewers):
        if viewer.session == session and viewer in program.stuck:
            program.stuck[viewer][1]()


async def _send(websocket: "WebSocket", viewer: Viewer, program: Program) -> None:
    from starlette.websockets import WebSocketDisconnect

    end = websocket.scope["state"].get("abort", lambda: None)
    try:
        while True:
            message = viewer.take()
            if message is None:
                program.stuck[viewer] = float("inf"), end
                await viewer.ready.wait()
            else:
                program.stuck[viewer] = time.monotonic(), end
                await websocket.send_bytes(message)
    except (WebSocketDisconnect, RuntimeError):  # it went while it was being sent to
        end()


async def _listen(websocket: "WebSocket", viewer: Viewer, program: Program) -> None:
    rate = Bucket(*SAID_RATE, time.monotonic())
    while True:
        message = await websocket.receive()
        if message["type"] == "websocket.disconnect":
            return
        viewer.answered_s = time.monotonic()
        try:
            if not rate.take(viewer.answered_s):
                raise ValueError("more than ten messages a second")
            wants, hidden = parse(message.get("text"))
        except ValueError as error:
            await websocket.close(1008, untrusted.one_line(str(error))[:100])
            return
        if wants is not None or hidden is not None:
            viewer.want(wants, hidden)
            program.hub.changed()


def parse(text: str | None) -> tuple[frozenset[str] | None, bool | None]:
    """What a page says: (wants, hidden), None each where it does not say. Raises ValueError."""
    if text is None:
        raise ValueError("bytes, expected a text")
    message: Mapping[str, Any] = untrusted.mapping(
        untrusted.sayable(untrusted.parse_json(text, SAID_MAX)), "what a page says"
    )
    strange = message.keys() - {"want", "hidden", "here"}
    if strange:
        raise ValueError(f"{untrusted.shown(min(strange))} is unknown, expected want, hidden or here")
    wants, hidden = message.get("want"), message.get("hidden")
    if wants is not None and (not isinstance(wants, list) or not all(one in WANTS for one in wants)):
        raise ValueError(f"want must be a list of {', '.join(WANTS)}")
    if hidden is not None and not isinstance(hidden, bool):
        raise ValueError("hidden must be true or false")
    return None if wants is None else frozenset(wants), hidden
