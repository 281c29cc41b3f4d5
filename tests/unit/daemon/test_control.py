"""Promises of the control socket: every request is answered once, and none that is wrong breaks anything."""

import random
import threading
import time
from collections.abc import Iterator

import msgpack
import pytest
import zmq

from annulus_pipe.daemon.control import (
    CARRIED_MAX,
    PHOTO_MAX,
    REQUEST_MAX,
    TEXT_MAX,
    ClientKeys,
    ControlClient,
    ControlSocket,
    Do,
    Request,
)
from annulus_pipe.daemon.state import State
from annulus_pipe.job import JobSheet
from annulus_pipe.stream.access import Doorkeeper, Keys
from annulus_pipe.vocabulary import AnnulusError


class Daemon:
    """The socket and the loop around it, on a thread of its own."""

    def __init__(self, address: str = "tcp://127.0.0.1:*", keys: Keys | None = None) -> None:
        self.context = zmq.Context()
        self.door = Doorkeeper(self.context)
        self.socket = ControlSocket(self.door, address, keys)
        self.asked: list[Request] = []
        self.malformed = 0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self) -> None:
        while not self._done.wait(0.001):
            self.door.admit()
            self.malformed += self.socket.poll(self.obey, lambda: State.IDLE, lambda: "ok")

    def obey(self, request: Request) -> None:
        if request.do is Do.STOP:
            raise AnnulusError("no scan is under way")
        self.asked.append(request)

    def ended(self) -> "Daemon":
        """What it counted is final."""
        self._done.set()
        self._thread.join()
        return self

    def close(self) -> None:
        self.ended()
        self.socket.close()
        self.door.close()
        self.context.destroy(linger=0)


@pytest.fixture
def daemon() -> Iterator[Daemon]:
    daemon = Daemon()
    yield daemon
    daemon.close()


def test_requests_are_obeyed_and_refusals_are_one_line(daemon: Daemon) -> None:
    with ControlClient(daemon.socket.address) as head:
        assert head.state() is State.IDLE
        assert head.start() is State.IDLE
        head.mark("joint", clock_deg=90)
        head.mark("here")
        head.zero()
        with pytest.raises(AnnulusError, match="no scan is under way"):
            head.stop()
    assert daemon.asked == [
        Request(Do.STATE),
        Request(Do.START),
        Request(Do.MARK, "joint", 90.0),
        Request(Do.MARK, "here"),
        Request(Do.ZERO),
    ]
    assert daemon.ended().malformed == 0


@pytest.mark.parametrize(
    "packed, says",
    [
        (b"", "msgpack"),
        (b"\xc1", "msgpack"),
        (b"\x80" * 3, "msgpack"),
        (msgpack.packb(7), "mapping"),
        (msgpack.packb({"do": "explode"}), "start, stop, pause"),
        (msgpack.packb({}), "start, stop, pause"),
        (msgpack.packb({"do": ["start"]}), "start, stop, pause"),
        (msgpack.packb({"do": "start", "text": "x"}), "nothing more"),
        (msgpack.packb({"do": "mark", "colour": "red"}), "text, clock_deg and photo"),
        (msgpack.packb({"do": "mark", "photo": b"GIF89a"}), "JPEG"),
        (msgpack.packb({"do": "mark", "photo": b"\xff\xd8\xff" + bytes(PHOTO_MAX)}), "at most"),
        (msgpack.packb({"do": "job", "job": {"client": "x" * 5000}}), str(REQUEST_MAX)),
        (msgpack.packb({"do": "job", "job": {"colour": "red"}}), "colour"),
        (msgpack.packb({"do": "job"}), "job"),
        (msgpack.packb({"do": "lamps", "lamps": {"led_width_us": "2"}}), "led_width_us"),
        (msgpack.packb({"do": "lamps", "lamps": {"led_width_us": float("inf")}}), "led_width_us"),
        (msgpack.packb({"do": "lamps", "lamps": {"host_timeout_ms": 9}}), "host_timeout_ms"),
        (msgpack.packb({"do": "start", "record": False, "hold_s": 3600}), "hold_s"),
        (msgpack.packb({"do": "command", "who": {"id": "1"}}), "id and a name"),
        (msgpack.packb({"do": "command", "who": {"id": "1", "name": "  "}}), "not empty"),
        (msgpack.packb({"do": "command", "take": 1, "who": {"id": "1", "name": "A"}}), "true or false"),
        (msgpack.packb({"do": "mark", "text": "x" * (TEXT_MAX + 1)}), "text"),
        (msgpack.packb({"do": "mark", "text": 3}), "text"),
        (msgpack.packb({"do": "mark", "clock_deg": float("nan")}), "clock_deg"),
        (msgpack.packb({"do": "mark", "clock_deg": True}), "clock_deg"),
        (bytes(REQUEST_MAX + 1), str(REQUEST_MAX)),
    ],
)
def test_what_is_wrong_is_answered_with_what_is_wrong(daemon: Daemon, packed: bytes, says: str) -> None:
    with ControlClient(daemon.socket.address) as head:
        head._socket.send(packed)
        answer = msgpack.unpackb(head._socket.recv())
        assert answer["ok"] is False and says in answer["error"] and "\n" not in answer["error"]
        assert head.state() is State.IDLE
    assert daemon.ended().malformed == 1


def test_noise_in_any_number_of_parts_breaks_nothing(daemon: Daemon) -> None:
    rng, context = random.Random(5), zmq.Context()
    socket = context.socket(zmq.DEALER)
    socket.connect(daemon.socket.address)
    for number in range(200):
        parts = [rng.randbytes(rng.randrange(50)) for _ in range(rng.randrange(1, 6))]
        socket.send_multipart(parts)
        if number % 20 == 19:
            while socket.poll(50):
                socket.recv_multipart()
    with ControlClient(daemon.socket.address) as head:
        assert head.state() is State.IDLE
    end = time.monotonic() + 30.0
    while daemon.malformed < 200 and time.monotonic() < end:
        time.sleep(0.01)
    assert daemon.ended().malformed == 200
    context.destroy(linger=0)


def test_a_dealer_without_a_delimiter_is_answered_too(daemon: Daemon) -> None:
    context = zmq.Context()
    socket = context.socket(zmq.DEALER)
    socket.connect(daemon.socket.address)
    socket.send(msgpack.packb({"do": "state"}))
    assert msgpack.unpackb(socket.recv()) == {"ok": True, "state": "idle", "health": "ok", "error": ""}
    context.destroy(linger=0)


def test_what_no_request_can_be_is_not_even_taken_in_and_others_are_served_on(daemon: Daemon) -> None:
    with ControlClient(daemon.socket.address) as head:
        assert head.state() is State.IDLE
        context = zmq.Context()
        socket = context.socket(zmq.DEALER)
        socket.connect(daemon.socket.address)
        socket.send(bytes(CARRIED_MAX + 1))
        time.sleep(0.2)
        assert head.state() is State.IDLE
        context.destroy(linger=0)


def test_nobody_there_is_one_line_and_the_next_answer_is_the_next_requests() -> None:
    with ControlClient("tcp://127.0.0.1:9") as head:
        for _ in range(2):
            with pytest.raises(AnnulusError, match="no answer within") as caught:
                head.ask({"do": "state"}, timeout_s=0.05)
            assert "\n" not in str(caught.value)


def test_outside_needs_keys_and_only_those_known_are_served() -> None:
    with zmq.Context() as context, pytest.raises(AnnulusError, match="CURVE"):
        ControlSocket(Doorkeeper(context), "tcp://0.0.0.0:*", None)
    server, friend, stranger = zmq.curve_keypair(), zmq.curve_keypair(), zmq.curve_keypair()
    public, secret = (key.decode() for key in server)
    daemon = Daemon(keys=Keys(public, secret, frozenset({friend[0].decode()})))
    try:
        with ControlClient(daemon.socket.address, ClientKeys(public, friend[0].decode(), friend[1].decode())) as head:
            assert head.state() is State.IDLE
        for keys in (None, ClientKeys(public, stranger[0].decode(), stranger[1].decode())):
            with ControlClient(daemon.socket.address, keys) as head, pytest.raises(AnnulusError, match="no answer"):
                head.ask({"do": "state"}, timeout_s=0.3)
        assert len(daemon.asked) == 1
    finally:
        daemon.close()


def test_the_health_is_told_to_who_asks(daemon: Daemon) -> None:
    with ControlClient(daemon.socket.address) as head:
        assert head.health() == "ok"


def test_a_field_of_the_job_is_emptied_where_it_is_told_to_be() -> None:
    request = Request.unpack(msgpack.packb({"do": "job", "job": {"client": "B", "site": "", "sdr": None}}))
    assert request.job == JobSheet(client="B") and request.emptied == {"site", "sdr"}
