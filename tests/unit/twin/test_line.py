"""A head's serial line takes a host as it comes: late, early, twice, gone."""

import socket
import time
from collections.abc import Callable

import pytest
import serial

from annulus_pipe.twin.line import Line, PtyLine, TcpLine


def soon(is_so: Callable[[], bool]) -> bool:
    end = time.monotonic() + 30.0
    while not is_so():
        if time.monotonic() > end:
            return False
        time.sleep(0.002)
    return True


@pytest.mark.parametrize("make", [PtyLine, TcpLine])
def test_bytes_go_both_ways_through_pyserial(make: Callable[[], Line]) -> None:
    line = make()
    with serial.serial_for_url(line.url, timeout=30.0) as host:
        heard = b""

        def listen() -> bool:
            nonlocal heard
            heard += line.read()
            return heard == bytes(range(256))

        host.write(bytes(range(256)))
        assert soon(listen)
        assert line.write(b"answer\0") == 7
        assert host.read(7) == b"answer\0"
        assert line.read() == b""
    line.close()


def test_without_a_host_bytes_are_gone_and_the_next_host_starts_afresh() -> None:
    line = TcpLine()
    place = ("127.0.0.1", int(line.url.rsplit(":", 1)[1]))
    assert line.write(b"nobody hears") == 12
    first = socket.create_connection(place)
    assert soon(lambda: line.read() == b"" and len(line.waitables()) == 2)
    second = socket.create_connection(place)  # takes it over
    second.sendall(b"second")
    assert soon(lambda: line.read() == b"second")
    assert first.recv(10) == b""
    line.write(b"hello")
    assert second.recv(10) == b"hello"
    second.close()
    assert soon(lambda: line.read() == b"" and len(line.waitables()) == 1)
    assert line.write(b"nobody again") == 12
    first.close()
    line.close()


def test_a_host_that_does_not_read_stops_the_line_and_not_the_head() -> None:
    line = TcpLine()
    with socket.create_connection(("127.0.0.1", int(line.url.rsplit(":", 1)[1]))):
        assert soon(lambda: line.read() == b"" and len(line.waitables()) == 2)
        sizes = [line.write(b"x" * 65536) for _ in range(2000)]
    assert 0 in sizes
    line.close()
