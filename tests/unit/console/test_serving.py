"""The program as people have it, by its sockets: slow readers, many connections, bytes that are no request, latency."""

import contextlib
import json
import socket
import struct
import time
from collections.abc import Iterator
from typing import Any

import pytest
from browsing import running, status, wait_for
from fake_daemon import FakeDaemon
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from annulus_pipe.console import program as program_module
from annulus_pipe.console import wire
from annulus_pipe.console.feed import LOST_S
from annulus_pipe.console.hub import BACKLOG_MAX
from annulus_pipe.console.program import Daemon, Door, Program
from annulus_pipe.console.serving import CONNECTIONS_MAX
from annulus_pipe.vocabulary import AnnulusError

PATIENCE_S = 30.0  # for what will come, however little of the machine we get
STALL_S = 0.1  # a machine that stood still for longer keeps no promise in seconds


@pytest.fixture
def scanning() -> Iterator[FakeDaemon]:
    with FakeDaemon(fps=25.0, scanning=True) as one:
        yield one


@pytest.fixture
def served(scanning: FakeDaemon) -> Iterator[tuple[str, Program]]:
    program = Program(Daemon(scanning.publish, scanning.control), Door(port=0))
    with running(program) as address:
        yield address, program


def viewer(address: str, **more: Any) -> ClientConnection:
    return connect(
        f"ws://{address}/ws",
        origin=f"http://{address}",
        compression=None,
        max_size=None,
        open_timeout=PATIENCE_S,
        **more,
    )  # type: ignore[arg-type]


def raw(address: str) -> socket.socket:
    host, port = address.split(":")
    return socket.create_connection((host, int(port)), timeout=PATIENCE_S)


def answer_to(address: str, request: bytes, seconds: float = PATIENCE_S) -> bytes:
    """Until the connection is closed, or nothing came for so long."""
    with raw(address) as line:
        line.settimeout(seconds)
        line.sendall(request)
        data = b""
        with contextlib.suppress(TimeoutError, ConnectionResetError):
            while more := line.recv(65536):
                data += more
        return data


def is_up(address: str) -> bool:
    return b"200 OK" in answer_to(address, f"GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n".encode())


def test_pictures_and_points_come_at_once(served: tuple[str, Program], stalls: Any) -> None:
    address, _ = served
    late, frames = [], []
    with viewer(address) as page:
        begun = time.monotonic()
        end = begun + 2 * PATIENCE_S
        while time.monotonic() < end and not (len(late) > 60 and len(frames) > 48):
            message = page.recv(PATIENCE_S)
            assert isinstance(message, bytes)
            if message[0] == wire.PICTURE:
                late.append(1e3 * (time.time() - struct.unpack_from("<d", message, 12)[0]))
            elif message[0] == wire.POINTS and not message[1]:
                frames.append(struct.unpack_from("<I", message, 4)[0])
    assert len(late) > 60 and len(frames) > 48
    if (stalled_s := stalls.since(begun)) < STALL_S:
        assert time.monotonic() - begun < 4.0
        assert sorted(late)[len(late) // 2] < 5.0 + 1e3 * stalled_s  # ms; 0.8 are measured on a quiet machine
    assert frames == [f for f in range(frames[0], frames[-1] + 1) if f % 5 != 4]  # none is missing


def test_one_that_never_reads_is_cut_off_and_costs_the_others_nothing(
    served: tuple[str, Program], monkeypatch: pytest.MonkeyPatch, stalls: Any
) -> None:
    monkeypatch.setattr(program_module, "STUCK_S", 2.0)
    address, program = served
    with viewer(address) as page, raw(address) as stuck:
        stuck.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        stuck.sendall(
            f"GET /ws HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        wait_for(lambda: len(program.hub.viewers) == 2)
        pictures, most, begun = 0, 0, time.monotonic()
        end = begun + 2 * PATIENCE_S
        while time.monotonic() < end and len(program.hub.viewers) == 2:
            message = page.recv(PATIENCE_S)
            pictures += message[:1] == bytes([wire.PICTURE])
            most = max(most, *(one.backlog for one in program.hub.viewers))
        seconds = time.monotonic() - begun
    assert len(program.hub.viewers) < 2 and most <= BACKLOG_MAX
    assert pictures
    if stalls.since(begun) < STALL_S:
        assert pictures > 20 * seconds


def test_a_slow_one_is_told_what_it_missed_and_the_cloud_anew(
    served: tuple[str, Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    from annulus_pipe.console import hub

    monkeypatch.setattr(hub, "BACKLOG_MAX", 200_000)
    address, program = served
    with viewer(address, max_queue=1) as page:
        wait_for(lambda: any(one.dropped for one in program.hub.viewers))  # it reads nothing for so long
        end, dropped, anew = time.monotonic() + PATIENCE_S, 0, 0
        while time.monotonic() < end and not (dropped and anew > 1):
            message = page.recv(PATIENCE_S)
            assert isinstance(message, bytes)
            if message[0] == wire.STATUS and status(message)[0] == "alive":
                dropped = status(message)[1]["you"]["dropped"]
            anew += message[0] == wire.POINTS and bool(message[1] & wire.ANEW)
    assert dropped > 0 and anew > 1


def is_open(line: socket.socket) -> bool:
    line.settimeout(0.001)
    try:
        return line.recv(1) != b""
    except TimeoutError:
        return True
    except OSError:
        return False


def test_a_thousand_connections_are_bounded_and_the_page_is_there_after(
    served: tuple[str, Program], monkeypatch: pytest.MonkeyPatch
) -> None:
    from annulus_pipe.console import serving

    monkeypatch.setattr(serving, "REQUEST_S", 300.0)  # none of them is closed because it says nothing
    address, program = served
    with viewer(address) as page:
        with contextlib.ExitStack() as stack:
            lines = []
            for _ in range(1000):
                with contextlib.suppress(OSError):
                    lines.append(stack.enter_context(raw(address)))
            wait_for(lambda: sum(map(is_open, lines)) <= CONNECTIONS_MAX)
            assert page.recv(PATIENCE_S)
        wait_for(lambda: is_up(address))
        wait_for(lambda: program.live.alive()["daemon"])


@pytest.mark.deep(gate="tests/unit/console/test_serving.py::test_nobody_looks_and_the_daemon_makes_no_pictures")
def test_so_many_pages_and_no_more(served: tuple[str, Program]) -> None:
    address, program = served
    with contextlib.ExitStack() as stack:
        pages = [stack.enter_context(viewer(address)) for _ in range(24)]
        with pytest.raises(InvalidStatus) as refused:
            viewer(address)
        assert refused.value.response.status_code == 503
        assert "too many pages" in json.loads(refused.value.response.body or b"")["error"]
        assert len(program.hub.viewers) == len(pages)
    wait_for(lambda: not program.hub.viewers)
    wait_for(lambda: not program.stuck)


def test_a_message_of_over_512_bytes_ends_the_connection(served: tuple[str, Program]) -> None:
    address, _ = served
    with viewer(address) as page:
        page.send("[" + " " * 600 + "]")
        with pytest.raises(ConnectionClosed) as closed:
            while True:
                page.recv(PATIENCE_S)
        assert closed.value.rcvd is not None and closed.value.rcvd.code == 1009


BYTES = [
    b"\x16\x03\x01\x02\x00\x01\x00",
    b"GET\r\n\r\n",
    b"GET / HTTP/9.9\r\n\r\n",
    b"\x00" * 100,
    b"SSH-2.0-x\r\n",
    b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    b"GET / HTTP/1.1\r\n\r\n",
    b"GET /" + b"a" * 40_000 + b" HTTP/1.1\r\nHost: x\r\n\r\n",
    b"GET / HTTP/1.1\r\nX: " + b"a" * 40_000 + b"\r\n\r\n",
    b"POST /api/do HTTP/1.1\r\nHost: localhost\r\nContent-Length: -5\r\n\r\n",
    b"POST /api/do HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\nZZZ\r\n",
]


def test_bytes_that_are_no_request_are_refused(served: tuple[str, Program]) -> None:
    address, _ = served
    for sent in BYTES:
        answer = answer_to(address, sent, 2.0)  # to some of them it waits for more
        assert answer == b"" or answer.split(b" ")[1] in (b"400", b"403", b"401", b"404", b"431"), sent[:40]
    assert is_up(address)


PATHS = [
    "/..",
    "/../../etc/passwd",
    "/static/../web.py",
    "/static/..%2fweb.py",
    "/static/%2e%2e%2fweb.py",
    "//etc/passwd",
]


def test_no_path_leads_out_whatever_a_client_does_to_it(served: tuple[str, Program]) -> None:
    address, _ = served
    for path in PATHS:
        answer = answer_to(address, f"GET {path} HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n".encode())
        assert b" 404 " in answer.split(b"\r\n")[0] and b"root:" not in answer and b"import" not in answer


def test_nobody_looks_and_the_daemon_makes_no_pictures(served: tuple[str, Program], scanning: FakeDaemon) -> None:
    address, _ = served
    made = {b"preview/", b"rows/", b"slits/"}
    wait_for(lambda: b"telemetry" in scanning.subscribed)
    assert not scanning.subscribed & made
    with viewer(address) as page:
        wait_for(lambda: scanning.subscribed >= made)
        page.send('{"want": ["points", "rows"]}')
        wait_for(lambda: scanning.subscribed & made == {b"rows/"})
        page.send('{"hidden": true}')
        wait_for(lambda: not scanning.subscribed & made)
        page.send('{"hidden": false}')
        wait_for(lambda: scanning.subscribed & made == {b"rows/"})
    wait_for(lambda: not scanning.subscribed & made)


def alive(page: ClientConnection) -> dict[str, Any]:
    while True:
        message = page.recv(PATIENCE_S)
        assert isinstance(message, bytes)
        if message[0] == wire.STATUS:
            topic, body = status(message)
            if topic == "alive":
                return dict(body)


def test_a_daemon_that_hangs_is_lost_within_two_seconds_and_found_again(
    served: tuple[str, Program], scanning: FakeDaemon, stalls: Any
) -> None:
    address, _ = served
    with viewer(address) as page:
        while not alive(page)["daemon"]:
            pass
        scanning.silent, begun = True, time.monotonic()
        while (told := alive(page))["daemon"]:
            assert told["age_s"] <= LOST_S
        assert told["age_s"] > LOST_S
        if stalls.since(begun) < STALL_S:
            assert 1.4 < time.monotonic() - begun < 2.2
        scanning.silent, begun = False, time.monotonic()
        while not alive(page)["daemon"]:
            pass
        if stalls.since(begun) < STALL_S:
            assert time.monotonic() - begun < 1.5


def test_a_daemon_that_goes_and_comes_back_is_another(served: tuple[str, Program], scanning: FakeDaemon) -> None:
    """Whatever was heard of the first: also when it had no time to say which scan it was."""
    address, program = served
    where = f"{scanning.publish},{scanning.control}"
    with viewer(address) as page:
        wait_for(lambda: len(program.live._cloud) > 2000)
        scanning.__exit__()
        wait_for(lambda: not program.live.alive()["daemon"])
        while alive(page)["daemon"]:
            pass
        with FakeDaemon(scan=99, address=where):
            while not alive(page)["daemon"]:
                pass
            wait_for(lambda: len(program.live._cloud) == 0)
            wait_for(lambda: program.live._scan == 99)


def test_an_address_that_is_taken_is_said_in_a_line(served: tuple[str, Program]) -> None:
    from annulus_pipe.console.serving import _listening

    port = int(served[0].split(":")[1])
    with pytest.raises(AnnulusError, match=r"cannot listen at 127\.0\.0\.1:"):
        _listening("127.0.0.1", port).listen()
    with pytest.raises(AnnulusError, match=r"cannot listen at 203\.0\.113\.7:"):
        _listening("203.0.113.7", 8600)
