"""Before every request: where it comes from, whose it is, how large and how often; and what every answer says to a
browser about what the page may do.
"""

import asyncio
import time
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from http.cookies import CookieError, SimpleCookie
from typing import Any

from annulus_pipe.console.access import GETS, NAME_MAX, POSTS, BrowserSession, Rates, RequestOrigins, Sessions
from annulus_pipe.console.answers import ASKED_MAX, Refusal, refused

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]

BODY_S = 10.0  # for a request's body to come
PATH_MAX = 512
FILES = "/api/surveys/file/"  # results, which may hold anything
OPEN = ("/", "/api/session", "/api/login", "/favicon.ico")  # and /static/: for who has not logged in
POLICY = (
    "default-src 'self'; img-src 'self' blob: data:; connect-src 'self'; worker-src 'self' blob:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
FILES_POLICY = (  # a report has all it needs inside; sandboxed it is of no origin, and can ask nothing of us
    "sandbox allow-scripts allow-popups; default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; "
    "script-src 'unsafe-inline' blob:; worker-src blob:; font-src data:; media-src data: blob:; "
    "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)
HEADERS = (
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
)


class Gate:
    """ASGI, in front of an application. `scope["state"]["session"]` is whose request it is, where somebody's."""

    def __init__(self, app: Any, places: RequestOrigins, sessions: Sessions, cookie: str) -> None:
        self._app, self._places, self._sessions, self._cookie = app, places, sessions, cookie
        self._gets, self._posts = Rates(GETS), Rates(POSTS)

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        if scope["type"] == "http":
            send = _with_headers(send, scope["path"])
        try:
            session = self._admit(scope)
            scope.setdefault("state", {})["session"] = session
            if scope["type"] == "http" and scope["method"] == "POST":
                receive = _replayed(await _body(scope, receive))
        except Refusal as refusal:
            await self._turn_away(refusal, scope, receive, send)
            return
        await self._app(scope, receive, send)

    def _admit(self, scope: Message) -> BrowserSession | None:
        """Raises Refusal."""
        now = time.monotonic()
        kind, path = scope["type"], scope["path"]
        method = scope["method"] if kind == "http" else "GET"
        headers = _Headers(scope["headers"])
        peer = scope["client"][0] if scope.get("client") else ""
        host = headers.one("host")
        if host is None or not self._places.is_ours(host):
            raise Refusal(403, f"Host is {str(host)[:60]!r}, expected a name of this console")
        if method not in ("GET", "HEAD", "POST"):
            raise Refusal(405, f"method {method[:20]!r}, expected GET or POST")
        if len(path) > PATH_MAX:
            raise Refusal(404, f"a path of {len(path)} characters, expected at most {PATH_MAX}")
        if not (self._posts if method == "POST" else self._gets).take(peer, now):
            raise Refusal(429, "too many requests, expected fewer a second")
        session = self._sessions.of(_cookie(headers.all("cookie"), self._cookie), now)
        if session is not None:
            session.address = peer[:NAME_MAX]
        if method == "POST" or kind == "websocket":
            origin = headers.one("origin")
            if origin is None or not self._places.is_same(origin, host):
                raise Refusal(403, f"Origin is {str(origin)[:60]!r}, expected this page's")
        is_open = path in OPEN or path.startswith("/static/") or not self._sessions.needs_login
        if not is_open and (session is None or not session.allowed):
            raise Refusal(401, "log in first")
        if method == "POST":
            if session is None:
                raise Refusal(401, "no session, expected the cookie of GET /api/session")
            if not session.is_token(headers.one("x-annulus-token") or ""):
                raise Refusal(403, "X-Annulus-Token is not the session's, expected what GET /api/session says")
            if (headers.one("content-type") or "").partition(";")[0].strip().lower() != "application/json":
                raise Refusal(400, "expected Content-Type: application/json")
        return session

    async def _turn_away(self, refusal: Refusal, scope: Message, receive: Receive, send: Send) -> None:
        answer = refused(str(refusal), refusal.status)
        if scope["type"] == "websocket":
            await receive()  # its connect
            start = {"type": "websocket.http.response.start", "status": refusal.status, "headers": answer.raw_headers}
            await send(start)
            await send({"type": "websocket.http.response.body", "body": answer.body})
        else:
            answer.headers["Connection"] = "close"  # what else it sends is not waited for
            await answer(scope, receive, send)


class _Headers:
    def __init__(self, headers: Iterable[tuple[bytes, bytes]]) -> None:
        self._headers = list(headers)

    def all(self, name: str) -> list[str]:
        return [value.decode("latin-1") for key, value in self._headers if key == name.encode()]

    def one(self, name: str) -> str | None:
        """None also where there are two."""
        found = self.all(name)
        return found[0] if len(found) == 1 else None


def _cookie(headers: list[str], name: str) -> str | None:
    try:
        found = SimpleCookie("; ".join(headers)[:4096]).get(name)
    except CookieError:
        return None
    return None if found is None else found.value


def _with_headers(send: Send, path: str) -> Send:
    policy = FILES_POLICY if path.startswith(FILES) else POLICY

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            more = [*HEADERS, (b"content-security-policy", policy.encode())]
            message["headers"] = [*message.get("headers", ()), *more]
        await send(message)

    return sending


async def _body(scope: Message, receive: Receive) -> bytes:
    length = _Headers(scope["headers"]).one("content-length")
    if length is not None and (not length.isascii() or not length.isdigit() or int(length[:12]) > ASKED_MAX):
        raise Refusal(413, f"more than {ASKED_MAX >> 10} KiB, expected less")
    data = b""
    try:
        async with asyncio.timeout(BODY_S):
            while True:
                message = await receive()
                if message["type"] != "http.request":
                    raise Refusal(400, "broke off")
                data += bytes(message.get("body", b""))
                if len(data) > ASKED_MAX:
                    raise Refusal(413, f"more than {ASKED_MAX >> 10} KiB, expected less")
                if not message.get("more_body"):
                    return data
    except TimeoutError:
        raise Refusal(400, f"the request did not come whole within {BODY_S:g} s") from None


def _replayed(body: bytes) -> Receive:
    left = [body]

    async def receive() -> Message:
        if left:
            return {"type": "http.request", "body": left.pop(), "more_body": False}
        await asyncio.Event().wait()
        raise AssertionError

    return receive
