"""Whatever is at the other end of a port, the user gets an answer or one line that says what is wrong."""

import os
import pty
import socket
import termios
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import SimpleNamespace

import pytest

from annulus_pipe.link import port as rooms
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import Arm, ArmFlag, Edge, Ping, PingReply, Stage, Status, StatusCode
from annulus_pipe.link.port import WRITE_S, Port
from annulus_pipe.link.session import EventReceived
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import AnnulusError, EdgeFlag, Lamp


@contextmanager
def far_end(serve: Callable[[int, threading.Event], None]) -> Iterator[str]:
    """A pty whose other end is served by a thread."""
    master, slave = pty.openpty()
    tty.setraw(master)
    tty.setraw(slave)
    os.set_blocking(master, False)
    done = threading.Event()
    thread = threading.Thread(target=serve, args=(master, done))
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        done.set()
        thread.join()
        os.close(master)
        os.close(slave)


def serving(controller: ScriptedController) -> Callable[[int, threading.Event], None]:
    def serve(master: int, done: threading.Event) -> None:
        while not done.wait(0.001):
            with suppress(BlockingIOError):
                controller.receive(os.read(master, 4096), time.monotonic_ns())
            os.write(master, controller.take())

    return serve


def babbling(master: int, done: threading.Event) -> None:
    while not done.wait(0.002):
        os.write(master, b"\x03\x11NMEA $GPGGA,1,2,3\r\n\x00")


def one_line(url: str, timeout_s: float = 0.15) -> str:
    with pytest.raises(AnnulusError) as caught:
        Client(url, timeout_s=timeout_s)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_port_that_is_not_there() -> None:
    assert one_line("/dev/ttyNowhere").startswith("/dev/ttyNowhere: cannot be opened (No such file or directory)")


def test_a_file_that_is_no_port_and_a_url_nobody_speaks() -> None:
    assert "cannot be opened" in one_line(__file__)
    assert "cannot be opened" in one_line("carrier-pigeon://loft")


def test_a_port_that_answers_garbage() -> None:
    with far_end(babbling) as url:
        assert "damaged frames and no answer to identify" in one_line(url)


def test_a_port_that_is_silent() -> None:
    with far_end(lambda master, done: done.wait()) as url:
        assert one_line(url) == f"{url}: no answer to identify within 0.15 s. Is this the controller?"


def test_a_controller_of_another_schema() -> None:
    with far_end(serving(ScriptedController(schema=0x0BADF00D))) as url:
        assert "0badf00d" in one_line(url, 30.0)
        with Client(url, timeout_s=30.0, diagnostics=True) as client:
            assert client.request(Status()).status is StatusCode.OK


def test_requests_are_answered_and_events_wait_for_the_poll() -> None:
    controller = ScriptedController()
    with far_end(serving(controller)) as url, Client(url, timeout_s=30.0) as client:
        assert client.identity.board == b"scripted"
        controller.emit(Edge(3, 1, 0, Lamp.LED, 1, 1, 0, 1, EdgeFlag(0)))
        assert isinstance(client.request(Ping()), PingReply)
        deadline = time.monotonic() + 30.0
        heard: list[EventReceived] = []
        while not heard and time.monotonic() < deadline:
            heard = [h for h in client.poll(0.1) if isinstance(h, EventReceived)]
        assert [h.event for h in heard] == [Edge(3, 1, 0, Lamp.LED, 1, 1, 0, 1, EdgeFlag(0))]


def test_a_refusal_names_the_field_and_its_value() -> None:
    controller = ScriptedController()
    controller.refuse[Stage] = (StatusCode.OUT_OF_RANGE, 1)
    controller.refuse[Arm] = (StatusCode.UNSAFE, 0)
    stage = Stage(1, 99, 4_000_000, 3_800_000, 2_800_000, 50, 0, 1, 1, 1, 1)
    with far_end(serving(controller)) as url, Client(url, timeout_s=30.0) as client:
        with pytest.raises(AnnulusError, match="stage refused: ratio = 99 is out of range"):
            client.request(stage)
        with pytest.raises(AnnulusError, match="arm refused: interlock open or a fault latched"):
            client.request(Arm(ArmFlag.LAMPS))


def test_a_socket_that_closes_is_said_to_have_gone() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        threading.Thread(target=lambda: server.accept()[0].close()).start()
        url = f"socket://127.0.0.1:{server.getsockname()[1]}"
        assert "the line went away" in one_line(url, 30.0)


def test_a_socket_nobody_listens_on() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    assert "cannot be opened" in one_line(f"socket://127.0.0.1:{port}")


def test_a_port_ends_what_the_kernel_echoed_before_it_was_raw() -> None:
    """A fresh tty echoes a frame of the controller: that stood before the first command. Every opening ends it."""
    master, slave = pty.openpty()
    os.set_blocking(master, False)
    try:
        for _ in range(2):
            os.write(master, b"\x05\x87\x11")  # while the tty is as the kernel makes it: cooked and echoing
            port = Port(os.ttyname(slave))
            echoed = b""
            end = time.monotonic() + 30.0
            while not echoed.endswith(b"\0") and time.monotonic() < end:
                with suppress(BlockingIOError):
                    echoed += os.read(master, 100)
            port.close()
            assert echoed.endswith(b"\0")
            assert echoed.count(b"\0") == 1
    finally:
        os.close(master)
        os.close(slave)


def test_a_port_whose_line_is_full_when_it_opens_gets_the_time_that_is_promised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A driver just bound again takes nothing for a moment: only `WRITE_S` of nothing is a broken line."""
    now = [100.0]
    monkeypatch.setattr(rooms, "time", SimpleNamespace(monotonic=lambda: now[0], monotonic_ns=time.monotonic_ns))
    master, slave = pty.openpty()
    termios.tcflow(slave, termios.TCOOFF)
    try:
        port = Port(os.ttyname(slave))
        for _ in range(2):
            now[0] += 0.49 * WRITE_S
            port.write(b"")
        now[0] += 0.03 * WRITE_S
        with pytest.raises(AnnulusError, match=f"takes no bytes for {WRITE_S:g} s"):
            port.write(b"")
        port.close()
    finally:
        os.close(slave)
        os.close(master)
