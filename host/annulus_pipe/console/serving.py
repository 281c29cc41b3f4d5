"""The page's sockets: uvicorn, with what it leaves open closed: how many connect, and how long one may say nothing."""

import asyncio
import resource
import socket
from dataclasses import replace
from typing import Any

from annulus_pipe.console.program import Program, say
from annulus_pipe.console.viewing import SAID_MAX
from annulus_pipe.console.web import application
from annulus_pipe.extras import need
from annulus_pipe.stream.access import require_secret
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

CONNECTIONS_MAX = 200
REQUEST_S = 15.0  # for a request's first line and headers to come
FILES_MAX = 4096
PING_S = 5.0
SEND_BUFFER = 1 << 19  # bytes in the kernel for one connection: more is delay, and memory nobody counts


def serve(program: Program) -> None:
    """Until Ctrl-C or SIGTERM. Raises AnnulusError where it cannot listen."""
    server, listening = prepared(program)
    say(f"the console is at {replace(program.door, port=listening.getsockname()[1]).url}")
    server.run(sockets=[listening])


def prepared(program: Program) -> tuple[Any, socket.socket]:
    """uvicorn's server, and the socket that it is to be run with."""
    door = program.door
    uvicorn = need("uvicorn")
    need("starlette")
    need("websockets")
    config = uvicorn.Config(
        application(program),
        host=door.host,
        port=door.port,
        http=_http(),
        ws=_websocket(),
        loop="asyncio",
        log_config=None,
        log_level="critical",
        access_log=False,
        server_header=False,
        proxy_headers=False,
        ws_max_size=SAID_MAX,
        ws_per_message_deflate=False,
        ws_ping_interval=PING_S,
        ws_ping_timeout=3 * PING_S,
        timeout_keep_alive=30,
        timeout_graceful_shutdown=1,
        h11_max_incomplete_event_size=16 << 10,
        ssl_certfile=door.tls_cert,
        ssl_keyfile=door.tls_key,
        backlog=1024,
    )
    try:
        if door.tls_key is not None:
            require_secret(door.tls_key)
        config.load()
    except (OSError, ValueError) as error:  # ssl.SSLError is an OSError
        why = one_line(str(error))
        raise AnnulusError(f"{door.tls_cert}, {door.tls_key}: no certificate and its key ({why})") from None
    _let_many_in()
    return uvicorn.Server(config), _listening(door.host, door.port)


def _listening(host: str, port: int) -> socket.socket:
    listening = None
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind, protocol)
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
    except OSError as error:
        if listening is not None:
            listening.close()
        why = error.strerror or error
        raise AnnulusError(
            f"cannot listen at {host}:{port} ({why}), expected this machine's, and a free port"
        ) from None
    return listening


def _let_many_in() -> None:
    """As many files as may be: who is turned away takes one for a moment."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = FILES_MAX if hard == resource.RLIM_INFINITY else min(hard, FILES_MAX)
    if soft != resource.RLIM_INFINITY and soft < most:
        resource.setrlimit(resource.RLIMIT_NOFILE, (most, hard))


def _http() -> Any:
    from uvicorn.protocols.http.h11_impl import H11Protocol

    class Http(H11Protocol):  # type: ignore[misc]  # uvicorn is there with its extra only
        """At most CONNECTIONS_MAX; each says what it wants in time."""

        _waited: asyncio.TimerHandle | None = None

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            if len(self.connections) > CONNECTIONS_MAX:
                transport.abort()
                return
            _bounded(transport)
            self._waited = self.loop.call_later(REQUEST_S, self._waits_no_more)

        def connection_lost(self, exc: Exception | None) -> None:
            if self._waited is not None:
                self._waited.cancel()
            super().connection_lost(exc)

        def _waits_no_more(self) -> None:
            if self.cycle is None and self in self.connections:
                self.transport.abort()

    return Http


def _websocket() -> Any:
    from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

    class WebSocket(WebSocketsSansIOProtocol):  # type: ignore[misc]
        """Can be ended at once: one that takes nothing never comes to an end by itself."""

        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            self.app_state = {**self.app_state, "abort": transport.abort}  # type: ignore[has-type]

        def keepalive_timeout(self) -> None:
            super().keepalive_timeout()
            self.transport.abort()

    return WebSocket


def _bounded(transport: Any) -> None:
    under = transport.get_extra_info("socket")
    if under is not None:
        under.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        under.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
