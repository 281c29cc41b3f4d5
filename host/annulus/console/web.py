"""Routes."""

import asyncio
import contextlib
import json
import secrets
from importlib.resources import files
from pathlib import Path
from typing import Any

import zmq

from annulus.console import wire
from annulus.console.commands import Commands, NoDaemon
from annulus.console.feed import Feed
from annulus.console.hub import WANTS, Hub, Viewer
from annulus.console.live import Live
from annulus.daemon.control import ClientKeys
from annulus.extras import need

STATIC = Path(str(files("annulus.console"))) / "static"
LANGUAGES = ("en", "de")
ALIVE_S = 0.5


class State:
    """What all routes know."""

    def __init__(self, publish: str, control: str, keys: ClientKeys | None = None, demo: bool = False) -> None:
        self.context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self.feed = Feed(self.context, publish, keys)
        self.hub = Hub()
        self.live = Live(self.feed, self.hub)
        self.commands = Commands(self.context, control, keys)
        self.demo = demo


def application(state: State) -> Any:
    need("starlette")
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import FileResponse, JSONResponse, Response
    from starlette.routing import Mount, Route, WebSocketRoute
    from starlette.staticfiles import StaticFiles
    from starlette.websockets import WebSocket, WebSocketDisconnect

    async def page(request: Request) -> Response:
        return FileResponse(STATIC / "index.html")

    async def session(request: Request) -> Response:
        who = {"token": "demo", "name": "", "id": "demo", "needs_login": False}
        return JSONResponse({"ok": True, **who, "languages": LANGUAGES})

    async def arm(request: Request) -> Response:
        return JSONResponse({"ok": True, "confirm": secrets.token_urlsafe(16), "expires_s": 10})

    async def do(request: Request) -> Response:
        asked = json.loads(await request.body())
        asked.pop("confirm", None)
        asked.pop("who", None)
        try:
            answer = await state.commands.ask(asked)
        except NoDaemon as error:
            return JSONResponse({"ok": False, "error": str(error)}, 504)
        return JSONResponse(wire.plain(answer), 200 if answer.get("ok") else 409)

    async def ws(websocket: WebSocket) -> None:
        await websocket.accept()
        viewer = Viewer("demo")
        hello = {"version": "0.1.0", "demo": state.demo, "languages": LANGUAGES, "cameras": []}
        viewer.tell("status", wire.status("hello", hello))
        state.hub.add(viewer)
        state.live.welcome(viewer)
        sending = asyncio.create_task(send(websocket, viewer))
        try:
            while True:
                said = json.loads(await websocket.receive_text())
                if "want" in said:
                    viewer.wants = frozenset(said["want"]) & frozenset(WANTS)
                if "hidden" in said:
                    viewer.hidden = bool(said["hidden"])
                state.hub.changed()
        except WebSocketDisconnect:
            pass
        finally:
            state.hub.remove(viewer)
            sending.cancel()

    async def send(websocket: WebSocket, viewer: Viewer) -> None:
        while True:
            message = viewer.take()
            if message is None:
                await viewer.ready.wait()
            else:
                await websocket.send_bytes(message)

    async def beat() -> None:
        while True:
            state.feed.listen()
            about = state.live.alive()
            for viewer in list(state.hub.viewers):
                viewer.newest("alive", "status", wire.status("alive", {**about, "you": {"dropped": viewer.dropped}}))
            await asyncio.sleep(ALIVE_S)

    @contextlib.asynccontextmanager
    async def lifespan(app: Any) -> Any:
        state.feed.run(asyncio.get_running_loop())
        task = asyncio.create_task(beat())
        yield
        task.cancel()
        state.feed.close()
        state.commands.close()

    return Starlette(
        lifespan=lifespan,
        routes=[
            Route("/", page),
            Route("/api/session", session),
            Route("/api/arm", arm, methods=["POST"]),
            Route("/api/do", do, methods=["POST"]),
            WebSocketRoute("/ws", ws),
            Mount("/static", StaticFiles(directory=STATIC)),
        ],
    )


def serve(state: State, host: str, port: int) -> None:
    """Until Ctrl-C."""
    uvicorn = need("uvicorn")
    config = uvicorn.Config(
        application(state),
        host=host,
        port=port,
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=512,
        ws_per_message_deflate=False,
        timeout_graceful_shutdown=1,
    )
    uvicorn.Server(config).run()
