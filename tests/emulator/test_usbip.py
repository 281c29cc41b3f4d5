"""The emulator's USB/IP server, from a client that does what vhci-hcd may do. tests/guest has the real one."""

import socket
import struct
from collections.abc import Iterator

import pytest
from emulated import MS, EmulatedBoard, arm

from annulus_pipe.controller import PIN_LED
from annulus_pipe.link.codec import Frame, encode
from annulus_pipe.link.messages import Ping

SUBMIT, UNLINK, RET_SUBMIT, RET_UNLINK = 1, 2, 3, 4
OK, EPIPE, ECONNRESET = 0, -32, -104
OUT, IN = 0, 1
CONTROL, NOTICE, DATA = 0, 1, 2
SET_CONFIGURATION = struct.pack("<BBHHH", 0, 9, 1, 0, 0)


class Kernel:
    """The far end of one connection; answers are waited for in the board's time."""

    def __init__(self, board: EmulatedBoard, port: int) -> None:
        self._board = board
        self._line = socket.create_connection(("127.0.0.1", port))
        self._line.setblocking(False)
        self._unread = b""
        self._ended = False
        self._inward: set[int] = set()  # numbers whose answers carry data
        self.replies: dict[int, tuple[int, int, bytes]] = {}  # by number: kind, status, data

    def close(self) -> None:
        self._line.close()

    def listen(self) -> None:
        self._board.run(self._board.now + MS)
        try:
            while new := self._line.recv(65536):
                self._unread += new
            self._ended = True
        except BlockingIOError:
            pass

    def take(self, size: int) -> bytes:
        for _ in range(500):
            if len(self._unread) >= size or self._ended:
                break
            self.listen()
        taken, self._unread = self._unread[:size], self._unread[size:]
        return taken

    def ended(self) -> bool:
        for _ in range(500):
            if self._ended:
                break
            self.listen()
        return self._ended

    def imports(self, busid: bytes) -> int:
        """The status of the answer; 0: the device is ours."""
        self._line.sendall(struct.pack(">HHI32s", 0x0111, 0x8003, 0, busid))
        version, code, status = struct.unpack(">HHI", self.take(8))
        assert (version, code) == (0x0111, 3)
        if status == 0:
            self.take(312)
        return int(status)

    def devices(self) -> bytes:
        self._line.sendall(struct.pack(">HHI", 0x0111, 0x8005, 0))
        return self.take(10_000)

    def submit(self, number: int, way: int, endpoint: int, what: bytes | int = b"", setup: bytes = bytes(8)) -> None:
        if way == IN:
            self._inward.add(number)
        data = what if isinstance(what, bytes) else b""
        size = what if isinstance(what, int) else len(what)
        self._line.sendall(
            struct.pack(">10I8s", SUBMIT, number, 1 << 16 | 2, way, endpoint, 0, size, 0, 0, 0, setup) + data
        )

    def unlink(self, number: int, which: int) -> None:
        self._line.sendall(struct.pack(">6I24x", UNLINK, number, 1 << 16 | 2, 0, 0, which))

    def answer(self, number: int) -> tuple[int, int, bytes]:
        """Kind, status and data of what came for this number; others are kept."""
        while number not in self.replies:
            head = self.take(48)
            assert len(head) == 48, f"nothing came for {number}"
            kind, which, _, _, _, status, size = struct.unpack(">5IiI", head[:28])
            self.replies[which] = (
                kind,
                status,
                self.take(size) if kind == RET_SUBMIT and which in self._inward else b"",
            )
        return self.replies.pop(number)

    def ask(self, number: int, setup: bytes) -> tuple[int, bytes]:
        way = IN if setup[0] & 0x80 else OUT
        self.submit(number, way, CONTROL, struct.unpack_from("<H", setup, 6)[0], setup)
        kind, status, data = self.answer(number)
        assert kind == RET_SUBMIT
        return status, data


@pytest.fixture
def port(board: EmulatedBoard) -> int:
    return board.serve_usbip()


@pytest.fixture
def kernel(board: EmulatedBoard, port: int) -> Iterator[Kernel]:
    kernel = Kernel(board, port)
    assert kernel.imports(b"1-1") == 0
    yield kernel
    kernel.close()


def test_it_lists_one_device_gives_it_to_one_client_and_hangs_up_on_who_speaks_nonsense(
    board: EmulatedBoard, port: int
) -> None:
    listed = Kernel(board, port).devices()
    assert struct.unpack(">HHII", listed[:12]) == (0x0111, 5, 0, 1)
    assert listed[12 + 256 :][:32].rstrip(b"\0") == b"1-1"
    numbers = struct.unpack(">IIIHHHBBBBBB", listed[12 + 288 : 12 + 312])
    assert numbers == (1, 2, 2, 0x2E8A, 0x000A, 0x0100, 0xEF, 2, 1, 0, 1, 2)
    assert listed[12 + 312 :] == bytes((2, 2, 0, 0, 10, 0, 0, 0))  # communications, data
    assert Kernel(board, port).imports(b"2-1") != 0
    kernel = Kernel(board, port)
    assert kernel.imports(b"1-1") == 0
    assert Kernel(board, port).imports(b"1-1") != 0
    stranger = Kernel(board, port)
    stranger._line.sendall(b"GET / HTTP/1.1\r\n\r\n")
    assert stranger.ended()
    kernel._line.sendall(bytes(48))
    assert kernel.ended()


def test_requests_and_bytes_go_both_ways_and_what_is_not_wanted_any_more_is_taken_back(
    board: EmulatedBoard, kernel: Kernel
) -> None:
    status, device = kernel.ask(1, struct.pack("<BBHHH", 0x80, 6, 0x0100, 0, 64))
    assert (status, len(device), device[8:12]) == (OK, 18, b"\x8a\x2e\x0a\x00")
    assert kernel.ask(2, struct.pack("<BBHHH", 0x80, 6, 0x0600, 0, 10)) == (EPIPE, b"")
    assert kernel.ask(3, SET_CONFIGURATION) == (OK, b"")
    assert kernel.ask(4, struct.pack("<BBHHH", 0x80, 8, 0, 0, 1)) == (OK, b"\1")
    kernel.submit(5, IN, NOTICE, 8)
    kernel.submit(6, IN, DATA, 128)
    kernel.unlink(7, 6)
    assert kernel.answer(7) == (RET_UNLINK, ECONNRESET, b"")
    kernel.ask(8, struct.pack("<BBHHH", 0x21, 0x22, 3, 0, 0))
    for number in range(10, 40, 2):
        kernel.submit(number, IN, DATA, 128)
        kernel.submit(number + 1, OUT, DATA, encode(Frame(Ping(), number)))
        assert kernel.answer(number + 1)[:2] == (RET_SUBMIT, OK)
        kind, status, data = kernel.answer(number)
        assert (kind, status) == (RET_SUBMIT, OK)
        assert 0 < len(data) < 64
    assert 6 not in kernel.replies
    kernel.unlink(9, 10)  # has ended long ago
    assert kernel.answer(9) == (RET_UNLINK, OK, b"")
    kernel.unlink(51, 50)  # on its way is taken back before it comes, as a kernel does
    kernel.submit(50, IN, DATA, 64)
    assert kernel.answer(51) == (RET_UNLINK, ECONNRESET, b"")
    kernel.ask(52, struct.pack("<BBHHH", 0x21, 0x22, 3, 0, 0))
    assert 50 not in kernel.replies, "it has been given back: an answer would end the connection"
    board.usb_do("detach")
    assert kernel.ended()  # a device that leaves the bus ends the connection


def test_a_client_that_goes_away_is_a_bus_reset_and_the_next_one_is_welcome(
    board: EmulatedBoard, port: int, kernel: Kernel
) -> None:
    kernel.ask(1, SET_CONFIGURATION)
    assert kernel.ask(2, struct.pack("<BBHHH", 0x80, 8, 0, 0, 1)) == (OK, b"\1")
    kernel.close()
    board.run(board.now + MS)
    while board.usb["state"] != "offered":
        board.run(board.now + MS)
    another = Kernel(board, port)
    assert another.imports(b"1-1") == 0
    assert another.ask(1, struct.pack("<BBHHH", 0x80, 8, 0, 0, 1)) == (OK, b"\0")


@pytest.mark.deep(gate="tests/emulator/test_usb.py::test_both_lines_work_at_once_and_one_of_them_commands")
def test_the_other_line_works_on(board: EmulatedBoard, kernel: Kernel) -> None:
    kernel.ask(1, SET_CONFIGURATION)
    arm(board, ratio=0, period=1_000_000, delay=100_000, width=100_000)
    board.pulse(board.now + MS)
    kernel.close()
    board.run_alive(board.now + 5 * MS)
    assert len(board.rises(PIN_LED)) == 1
