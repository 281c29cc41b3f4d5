"""Routes. Who may ask at all is the gate's affair (gate.py)."""

import asyncio
import base64
import binascii
import contextlib
import time
from collections.abc import AsyncIterator, Callable, Sequence
from typing import TYPE_CHECKING, Any

from annulus_pipe import untrusted
from annulus_pipe.console import bench, surveys, tuning
from annulus_pipe.console.access import (
    CONFIRM_S,
    LOGINS,
    LOGINS_OF_ALL,
    PASSWORD_MAX,
    BrowserSession,
    Bucket,
    Rates,
    named,
)
from annulus_pipe.console.answers import Refusal, accepted, asked_for, refused
from annulus_pipe.console.commands import LIT
from annulus_pipe.console.gate import Gate
from annulus_pipe.console.program import Program, say
from annulus_pipe.console.viewing import cut_off, view
from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from starlette.requests import Request
    from starlette.responses import Response
    from starlette.websockets import WebSocket

PARTS: Sequence[Callable[[Program], Sequence[Any]]] = (surveys.routes, bench.routes, tuning.routes)
"""Each gives a list of Starlette's routes; what a part's endpoint raises is answered as in answers.py."""


WORDS = {404: "not there", 405: "asked by another method than it is"}


def application(program: Program) -> Any:
    """ASGI."""
    from starlette.applications import Starlette
    from starlette.exceptions import HTTPException

    handlers = {AnnulusError: _wrong, HTTPException: _wrong, Exception: _wrong}
    pages = Pages(program)
    app = Starlette(routes=pages.routes(), lifespan=pages.lifespan, exception_handlers=handlers)
    return Gate(app, program.places, program.sessions, program.cookie)


class Pages:
    """The console's own endpoints, and how often somebody may try a password."""

    def __init__(self, program: Program) -> None:
        self._program = program
        self._logins, self._of_all = Rates(LOGINS), Bucket(*LOGINS_OF_ALL, time.monotonic())

    def routes(self) -> list[Any]:
        from starlette.responses import Response
        from starlette.routing import Mount, Route, WebSocketRoute
        from starlette.staticfiles import StaticFiles

        class PageFiles(StaticFiles):
            async def get_response(self, path: str, scope: Any) -> Response:
                answer = await super().get_response(path, scope)
                answer.headers["Cache-Control"] = "no-cache"  # the page is of this program, not of the last one
                return answer

        return [
            Route("/", self.page),
            Route("/favicon.ico", self.nothing),
            Route("/api/session", self.session),
            Route("/api/login", self.login, methods=["POST"]),
            Route("/api/logout", self.logout, methods=["POST"]),
            Route("/api/arm", self.arm, methods=["POST"]),
            Route("/api/do", self.do, methods=["POST"]),
            Route("/api/defect/{scan:int}/{id:int}", self.defect),
            Route("/api/defect/{scan:int}/{id:int}/picture", self.defect_picture),
            Route("/api/frame/{camera:int}/{index:int}", self.frame),
            *(route for part in PARTS for route in part(self._program)),
            WebSocketRoute("/ws", self.viewing),
            Mount("/static", PageFiles(directory=self._program.static)),
        ]

    @contextlib.asynccontextmanager
    async def lifespan(self, app: object) -> AsyncIterator[None]:
        running = asyncio.create_task(self._program.run())
        try:
            yield
        finally:
            running.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await running
            self._program.close()

    async def page(self, request: "Request") -> "Response":
        from starlette.responses import FileResponse

        return FileResponse(self._program.static / "index.html", headers={"Cache-Control": "no-cache"})

    async def nothing(self, request: "Request") -> "Response":
        from starlette.responses import Response

        return Response(status_code=204)

    async def session(self, request: "Request") -> "Response":
        mine: BrowserSession | None = request.state.session
        fresh = mine is None
        if mine is None:
            mine = self._program.sessions.begin(time.monotonic())
        return self._with_cookie(self._session_answer(mine), mine) if fresh else self._session_answer(mine)

    async def login(self, request: "Request") -> "Response":
        asked = await asked_for(request)
        old: BrowserSession = request.state.session
        try:
            name = named(asked.get("name", ""))
            word = untrusted.text(asked.get("password", ""), "password", PASSWORD_MAX)
        except ValueError as error:
            raise Refusal(400, str(error)) from None
        if self._program.door.password is None:
            old.name = name
            return self._session_answer(old)
        now = time.monotonic()
        peer = request.client.host if request.client else ""
        if not self._logins.take(peer, now) or not self._of_all.take(now):
            raise Refusal(429, "too many attempts, expected one in six seconds")
        if not await asyncio.to_thread(self._program.door.password.check, word):
            say(f"a wrong password from {peer}")
            raise Refusal(401, "the password is wrong")
        self._program.sessions.end(old)  # what was known of it before is worth nothing now
        mine = self._program.sessions.begin(now, allowed=True, name=name)
        return self._with_cookie(self._session_answer(mine), mine)

    async def logout(self, request: "Request") -> "Response":
        mine: BrowserSession = request.state.session
        if self._program.lease.holder == mine.id:
            with contextlib.suppress(Refusal):
                await self._program.do({"do": "release"}, mine)
        self._program.sessions.end(mine)
        cut_off(self._program, mine.id)
        return accepted()

    async def arm(self, request: "Request") -> "Response":
        mine: BrowserSession = request.state.session
        return accepted(confirm=mine.arm(time.monotonic()), expires_s=CONFIRM_S)

    async def do(self, request: "Request") -> "Response":
        asked = dict(await asked_for(request))
        mine: BrowserSession = request.state.session
        asked.pop("who", None)
        word = asked.pop("confirm", None)
        if not isinstance(asked.get("do"), str):
            raise Refusal(400, "do is missing, expected what is to be done")
        if asked["do"] in LIT and not mine.confirm(word, time.monotonic()):
            raise Refusal(403, "not confirmed: lamps come on after a second step, within 10 s of the first")
        if asked.get("photo") is not None:
            asked["photo"] = _photo(asked["photo"])
        return accepted(**{key: value for key, value in (await self._program.do(asked, mine)).items() if key != "ok"})

    async def defect(self, request: "Request") -> "Response":
        closeup = _closeup(self._program, request)
        listed = self._program.live.defects.get("defects")
        number = closeup.numbers["id"]
        found = next((one for one in listed or () if isinstance(one, dict) and one.get("id") == number), None)
        seen = found.get("frames", ()) if found is not None else ()
        frames = [
            {"camera": camera, "index": index}
            for index in seen
            for camera in range(max(1, len(self._program.cameras)))
            if isinstance(index, int) and self._program.live.frames.get(camera, index) is not None
        ]
        return accepted(**closeup.for_page(), defect=found, frames=frames, picture=bool(closeup.picture))

    async def defect_picture(self, request: "Request") -> "Response":
        from starlette.responses import Response

        closeup = _closeup(self._program, request)
        if not closeup.picture.startswith(b"\x89PNG"):
            raise Refusal(404, "no picture of it is there")
        return Response(closeup.picture, media_type="image/png", headers={"Cache-Control": "no-store"})

    async def frame(self, request: "Request") -> "Response":
        from starlette.responses import Response

        jpeg = self._program.live.frames.get(request.path_params["camera"], request.path_params["index"])
        if jpeg is None:
            raise Refusal(404, "the frame is not kept any more")
        return Response(jpeg, media_type="image/jpeg", headers={"Cache-Control": "no-store"})

    async def viewing(self, websocket: "WebSocket") -> None:
        await view(websocket, self._program)

    def _session_answer(self, mine: BrowserSession) -> "Response":
        who: dict[str, Any] = {"token": mine.token, "name": mine.name, "id": mine.id}
        return accepted(
            **who,
            needs_login=not mine.allowed,
            password=self._program.door.password is not None,
            languages=self._program.languages(),
            demo=self._program.demo,
        )

    def _with_cookie(self, answer: "Response", mine: BrowserSession) -> "Response":
        tls = self._program.door.tls_cert is not None
        answer.set_cookie(self._program.cookie, mine.cookie, path="/", secure=tls, httponly=True, samesite="strict")
        return answer


async def _wrong(request: "Request", error: Exception) -> "Response":
    from starlette.exceptions import HTTPException

    if isinstance(error, Refusal):
        return refused(str(error), error.status)
    if isinstance(error, AnnulusError):
        return refused(str(error), 409)
    if isinstance(error, HTTPException):
        return refused(WORDS.get(error.status_code, error.detail), error.status_code)
    say(f"{request.url.path}: {type(error).__name__}: {error}")
    return refused(f"internal error, {type(error).__name__}; the console's terminal says more", 500)


def _closeup(program: Program, request: Any) -> Any:
    closeup = program.live.closeups.get((request.path_params["scan"], request.path_params["id"]))
    if closeup is None:
        raise Refusal(404, "no close-up of that defect is there")
    return closeup


def _photo(text: object) -> bytes:
    """A JPEG as base64, with or without what a browser's FileReader puts in front of it."""
    if not isinstance(text, str):
        raise Refusal(400, "photo must be a JPEG in base64")
    try:
        photo = base64.b64decode(text.removeprefix("data:image/jpeg;base64,"), validate=True)
    except (binascii.Error, ValueError):
        raise Refusal(400, "photo must be a JPEG in base64") from None
    if photo[:3] != b"\xff\xd8\xff":
        raise Refusal(400, "photo is no JPEG")
    return photo
