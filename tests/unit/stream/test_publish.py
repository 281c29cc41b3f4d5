"""Promises to viewers, and to those who must stay outside."""

import contextlib
import random
import resource
import socket
import threading
import time
from pathlib import Path
from statistics import median

import pytest
import zmq

from annulus_pipe.stream import publish
from annulus_pipe.stream.access import Doorkeeper, Keys, is_loopback
from annulus_pipe.stream.publish import LOOK_S, PATIENCE_S, STUCK_S, VIEWER_QUEUE, Publisher, parse
from annulus_pipe.vocabulary import AnnulusError


@pytest.fixture
def context():
    with zmq.Context() as context:
        yield context
        context.destroy(linger=0)


@pytest.fixture
def door(context):
    door = Doorkeeper(context)
    yield door
    door.close()


def viewer(context: zmq.Context, address: str) -> zmq.Socket:
    socket = context.socket(zmq.SUB)
    socket.subscribe(b"")
    socket.rcvhwm = 1
    socket.connect(address)
    return socket


def greet(door: Doorkeeper, publisher: Publisher, socket: zmq.Socket, seconds: float = 30.0) -> bool:
    """Send until the subscription has arrived; False when nothing does in that time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        door.admit()
        publisher.listen()
        publisher.send("hello", 0, None)
        if socket.poll(10):
            while socket.poll(20):
                socket.recv_multipart()
            return True
    return False


def test_a_viewer_gets_topic_number_body_and_bytes(context, door) -> None:
    publisher = Publisher(door, "tcp://127.0.0.1:*")
    socket = viewer(context, publisher.address)
    assert greet(door, publisher, socket)
    publisher.send("frame", 3, {"index": 7, "z_mm": 1.5}, bytes(range(100)))
    topic = "hello"  # one may still have been under way
    while topic == "hello":
        assert socket.poll(30_000)
        topic, *rest = parse(socket.recv_multipart())
    assert (topic, *rest) == ("frame", 3, {"index": 7, "z_mm": 1.5}, bytes(range(100)))
    publisher.close()


def test_a_viewer_that_sleeps_never_holds_up_the_scan_and_sees_what_it_missed(context, door) -> None:
    publisher = Publisher(door, "tcp://127.0.0.1:*")
    socket = viewer(context, publisher.address)
    assert greet(door, publisher, socket)
    for number in range(400):  # far more than the socket buffers take
        publisher.send("frame", number, None, bytes(1 << 17))
    numbers = []
    while socket.poll(300):
        numbers.append(parse(socket.recv_multipart())[1])
    assert numbers == sorted(set(numbers))
    assert len(numbers) < 400
    assert VIEWER_QUEUE == 2
    publisher.close()


def test_outside_needs_keys(context, door) -> None:
    for address in ("tcp://0.0.0.0:*", "tcp://*:5555", "tcp://192.0.2.1:5555", "tcp://example.org:1"):
        assert not is_loopback(address)
        with pytest.raises(AnnulusError, match="CURVE"):
            Publisher(door, address)
    assert is_loopback("tcp://[::1]:5") and is_loopback("tcp://localhost:5") and is_loopback("tcp://127.3.2.1:5")


def test_only_a_viewer_whose_key_is_known_is_let_in(context, door) -> None:
    public, secret = (key.decode() for key in zmq.curve_keypair())
    friend, stranger = zmq.curve_keypair(), zmq.curve_keypair()
    publisher = Publisher(door, "tcp://127.0.0.1:*", Keys(public, secret, frozenset({friend[0].decode()})))

    def knock(keys: tuple[bytes, bytes] | None, seconds: float) -> bool:
        socket = context.socket(zmq.SUB)
        socket.subscribe(b"")
        if keys is not None:
            socket.curve_publickey, socket.curve_secretkey = keys
            socket.curve_serverkey = public.encode()
        socket.connect(publisher.address)
        return greet(door, publisher, socket, seconds)

    assert knock(friend, 30.0)
    assert not knock(stranger, 0.5)
    assert not knock(None, 0.5)
    publisher.close()


def test_a_bad_address_or_key_is_one_clear_line(context, door) -> None:
    taken = Publisher(door, "tcp://127.0.0.1:*")
    with pytest.raises(AnnulusError, match="cannot publish"):
        Publisher(door, taken.address)
    with pytest.raises(AnnulusError, match="Z85"):
        Keys("x", "y", frozenset())
    taken.close()


@pytest.mark.parametrize("parts", [[], [b"a", b"b"], [b"a", b"\xc1", b""], [b"a", b"\x80", b""], [b"a", b"\x01", b""]])
def test_what_is_not_ours_is_a_value_error(parts: list[bytes]) -> None:
    with pytest.raises(ValueError):
        parse(parts)


def test_two_sockets_behind_one_door_have_each_their_own_list(context, door) -> None:
    pair, friend, other = zmq.curve_keypair(), zmq.curve_keypair(), zmq.curve_keypair()
    public, secret = pair[0].decode(), pair[1].decode()
    publisher = Publisher(door, "tcp://127.0.0.1:*", Keys(public, secret, frozenset({friend[0].decode()})))
    second = context.socket(zmq.PUB)
    door.bind(second, "tcp://127.0.0.1:*", Keys(public, secret, frozenset({other[0].decode()})), "control", 512)

    def knock(keys: tuple[bytes, bytes], seconds: float) -> bool:
        socket = context.socket(zmq.SUB)
        socket.subscribe(b"")
        socket.curve_publickey, socket.curve_secretkey = keys
        socket.curve_serverkey = public.encode()
        socket.connect(publisher.address)
        return greet(door, publisher, socket, seconds)

    assert knock(friend, 30.0)
    assert not knock(other, 0.5)
    publisher.close()


def stranger(address: str) -> socket.socket:
    """Connected, and past ZMTP's greeting."""
    host, port = address.removeprefix("tcp://").split(":")
    line = socket.create_connection((host, int(port)))
    line.settimeout(30.0)
    line.sendall(b"\xff" + bytes(8) + b"\x7f\x03\x00NULL".ljust(55, b"\0"))
    greeting = b""
    while len(greeting) < 64:
        greeting += line.recv(64 - len(greeting))
    return line


def subscriber(address: str) -> socket.socket:
    """Past the handshake too."""
    line = stranger(address)
    ready = b"\x05READY\x0bSocket-Type\x00\x00\x00\x03SUB"
    line.sendall(b"\x04" + bytes([len(ready)]) + ready)
    return line


def until_refused(line: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        line.sendall(data)


def disconnected(line: socket.socket, door: Doorkeeper, publisher: Publisher) -> bool:
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        door.admit()
        publisher.listen()
        publisher.send("label", 0, None)
        line.settimeout(0.05)
        try:
            if not line.recv(1 << 16):
                return True
        except TimeoutError:
            continue
        except OSError:
            return True
    return False


@pytest.mark.parametrize("command", [b"\x06", b"\x02"], ids=["handshake", "subscription"])
def test_one_message_longer_than_any_viewer_needs_ends_the_connection(context, door, command: bytes) -> None:
    publisher = Publisher(door, "tcp://127.0.0.1:*")
    line = (stranger if command == b"\x06" else subscriber)(publisher.address)
    line.sendall(command + (600_000_000).to_bytes(8, "big") + b"\x01" + bytes(10_000))
    assert disconnected(line, door, publisher)
    line.close()
    publisher.close()


def test_a_flood_of_subscriptions_costs_little_memory_and_viewers_come_back(context, door) -> None:
    publisher = Publisher(door, "tcp://127.0.0.1:*")
    friend = viewer(context, publisher.address)
    assert greet(door, publisher, friend)
    page_mb = resource.getpagesize() / 1e6
    before = int(Path("/proc/self/statm").read_text().split()[1]) * page_mb
    line = subscriber(publisher.address)
    rng = random.Random(1)
    flood = b"".join(b"\x00\xfa\x01" + rng.randbytes(249) for _ in range(80_000))  # 20 MB
    sender = threading.Thread(target=until_refused, args=(line, flood))
    sender.start()
    end = time.monotonic() + 60.0
    while sender.is_alive() or not publisher.floods:
        assert time.monotonic() < end
        publisher.listen()
        publisher.send("label", 0, None)
        time.sleep(0.002)
    line.close()
    assert publisher.floods >= 1
    grown = int(Path("/proc/self/statm").read_text().split()[1]) * page_mb - before
    assert grown < 60.0, "a gigabyte before"
    assert greet(door, publisher, friend)
    publisher.close()


def test_what_viewers_may_ask_for_is_no_flood(context, door) -> None:
    publisher = Publisher(door, "tcp://127.0.0.1:*")
    viewers = []
    for topic in (b"", b"frame", b"frame/0", b"label", b"sensor/imu", b"sens", b"telemetry", b"health") * 30:
        viewers.append(context.socket(zmq.SUB))
        viewers[-1].subscribe(topic)
        viewers[-1].connect(publisher.address)
    assert greet(door, publisher, viewers[0])
    assert publisher.floods == 0 and publisher._strange == 0
    publisher.close()


def test_no_word_is_lost_to_who_reads(context, door, monkeypatch: pytest.MonkeyPatch, stalls) -> None:
    """On a machine that stands still for longer than PATIENCE_S words are lost, as they are meant to: so here patience
    has no end, and how much of it was needed counts where the machine went on.
    """
    monkeypatch.setattr(publish, "PATIENCE_S", 60.0)
    publisher = Publisher(door, "tcp://127.0.0.1:*")
    reader = context.socket(zmq.SUB)
    reader.rcvhwm = 1000
    reader.subscribe(b"")
    reader.connect(publisher.address)
    assert greet(door, publisher, reader)
    heard: list[int] = []

    def read() -> None:
        while reader.poll(60_000):
            topic, number, _, _ = parse(reader.recv_multipart())
            if topic == "state":
                heard.append(number)
            if topic == "ended":
                return

    thread = threading.Thread(target=read)
    thread.start()
    begun, waited = time.monotonic(), []
    for burst in range(40):  # as after a frame: much at once, then nothing
        longest = 0.0
        for number in range(9):
            sent = time.monotonic()
            if number < 8:
                publisher.send("preview/0", 8 * burst + number, None, bytes(40_000))
            else:
                publisher.send("state", burst, {"state": "scanning"})
            longest = max(longest, time.monotonic() - sent)
        waited.append(longest)
        time.sleep(0.01)
    publisher.send("ended", 0, None)
    thread.join(60.0)
    assert heard == list(range(40))
    if stalls.since(begun) < PATIENCE_S:
        assert median(waited) < PATIENCE_S
    publisher.close()


class Clock:
    """In place of `time`: goes on only while somebody sleeps, so what is waited is counted whoever has the machine."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, seconds: float) -> None:
        self.now_s += seconds
        time.sleep(seconds)


def test_who_does_not_read_costs_the_patience_once_and_not_again_for_a_while(
    context, door, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    publisher = Publisher(door, f"ipc://{tmp_path}/words")  # whose buffers do not grow
    sleeper = viewer(context, publisher.address)
    assert greet(door, publisher, sleeper)
    clock = Clock()
    monkeypatch.setattr(publish, "time", clock)

    def words(count: int) -> float:
        """How long they were waited with, s."""
        begun = clock.now_s
        for number in range(count):
            publisher.send("state", number, {"state": "x" * 5000})
        return clock.now_s - begun

    assert any(words(1) >= PATIENCE_S for _ in range(10_000))
    for _ in range(3):
        assert words(2000) == 0.0, "nobody waits for one that is known not to read"
        clock.now_s += STUCK_S
        assert words(2000) < PATIENCE_S + 2 * LOOK_S
    while sleeper.poll(100):  # libzmq 4.3.5 ends a process that closes while a message of several parts is half sent
        sleeper.recv_multipart()
    publisher.close()
