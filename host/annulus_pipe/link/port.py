"""The line itself: tty, pty or `socket://host:port`, for one program at a time. Nothing here waits to write.

A tty is locked twice: TIOCEXCL keeps out programs that know nothing of locks (a terminal, ModemManager), flock those
that run as root and every other annulus. Both end with the process, however it ends. A pty is only locked by flock: its
other end keeps it open, and the flag would outlive us. A socket's far end is somebody else's to guard; that no two
programs of this machine talk to it at once is seen to by an abstract socket of that name.
"""

import contextlib
import errno
import fcntl
import os
import select
import socket
import termios
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol, TypeVar

import serial
from serial.urlhandler import protocol_socket

from annulus_pipe.vocabulary import AnnulusError

BAUD = 1_000_000
READ_S = 0.002  # at most this long in one read, so that repeats are sent in time
READ_MAX = 4096
WRITE_S = 0.5  # a line that takes no byte for so long is broken

Item = TypeVar("Item")


class Talker(Protocol[Item]):
    """What a Port can pump: a Session-like thing that turns bytes into news and time into bytes."""

    def receive(self, data: bytes, now: int) -> list[Item]: ...

    def pending(self, now: int) -> bytes: ...


class Port:
    """A pyserial port whose failures are AnnulusErrors. `now` everywhere is its clock's: time.monotonic_ns(), or
    that of the world in which a simulated port lives.

    It begins with one 0x00. Until a fresh ttyACM is in raw mode the kernel echoes to the controller what the controller
    said; the delimiter ends that, so that the first command does not go on where the echo stopped.
    """

    def __init__(self, url: str) -> None:
        """Waits as long as opening takes: for a host that does not answer 5 s, see `PortOpening`."""
        self.url = url
        self.bytes_read = 0
        self.waitable: int | None  # readable when bytes have come; None: only `read` can wait for them
        self._unsent = bytearray()
        self._moved_s = time.monotonic()  # when the line last took a byte, or had none to take
        try:
            self._serial, self.waitable = _opened(url)
        except (serial.SerialException, OSError, ValueError) as error:
            if isinstance(error, OSError) and error.errno in (errno.EBUSY, errno.EAGAIN):
                raise AnnulusError(
                    f"{url}: in use by another program{_holder(url)}, expected a free port. Stop that program first."
                ) from None
            raise AnnulusError(
                f"{url}: cannot be opened ({_reason(error)}), expected a serial port or socket://host:port."
                " Is the head plugged in?"
            ) from None
        self._readable = select.poll()
        if self.waitable is not None:
            self._readable.register(self.waitable, select.POLLIN)
        self.now_ns: Callable[[], int] = getattr(self._serial, "now_ns", time.monotonic_ns)
        try:
            self.write(b"\0")
        except AnnulusError:
            self.close()
            raise

    def read(self, timeout_s: float) -> bytes:
        """What is there, or what comes first within the time; empty when nothing does."""
        try:
            data = self._read_file(timeout_s) if self.waitable is not None else self._read_serial(timeout_s)
        except (serial.SerialException, OSError, TypeError) as error:
            raise AnnulusError(f"{self.url}: the line went away ({_reason(error)}), expected the controller") from None
        self.bytes_read += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Never waits: what the line does not take now goes first with the next call."""
        self._unsent += data
        now = time.monotonic()
        if not self._unsent:
            self._moved_s = now
            return
        try:
            if self.waitable is None:
                self._serial.write(bytes(self._unsent))
                sent = len(self._unsent)
            else:
                sent = os.write(self.waitable, self._unsent)
        except BlockingIOError:
            sent = 0
        except (serial.SerialException, OSError) as error:
            raise AnnulusError(f"{self.url}: the line went away ({_reason(error)}), expected the controller") from None
        del self._unsent[:sent]
        if sent:
            self._moved_s = now
        elif now - self._moved_s > WRITE_S:
            raise AnnulusError(f"{self.url}: takes no bytes for {WRITE_S:g} s, expected a controller that reads")

    def pump(self, talker: Talker[Item], timeout_s: float = READ_S) -> list[Item]:
        """Write what is due, read what comes within the time, hand it over. Call it in a loop."""
        self.write(talker.pending(self.now_ns()))
        data = self.read(timeout_s)
        return talker.receive(data, self.now_ns())

    def _read_file(self, timeout_s: float) -> bytes:
        if not self._readable.poll(max(0.0, timeout_s) * 1000):
            return b""
        assert self.waitable is not None
        with contextlib.suppress(BlockingIOError):
            data = os.read(self.waitable, READ_MAX)
            if not data:
                raise OSError("nobody is at its other end")
            return data
        return b""

    def _read_serial(self, timeout_s: float) -> bytes:
        self._serial.timeout = max(0.0, timeout_s)
        data = bytes(self._serial.read(1))
        if data:
            self._serial.timeout = 0
            data += bytes(self._serial.read(READ_MAX))
        return data

    def close(self) -> None:
        """What the line has not taken is dropped: the kernel would wait up to 30 s for it."""
        if self._unsent:
            with contextlib.suppress(serial.SerialException, OSError, termios.error):
                self._serial.reset_output_buffer()
        if _is_tty(self._serial):
            with contextlib.suppress(OSError, termios.error):
                fcntl.ioctl(self._serial.fileno(), termios.TIOCNXCL)
        self._serial.close()


class PortOpening:
    """A port on its way, for a loop that must not wait: names are looked up, hosts called and drivers opened in a
    thread of its own, which ends with that.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self._lock = threading.Lock()
        self._port: Port | None = None
        self._problem: AnnulusError | None = None
        self._wanted = True
        threading.Thread(target=self._open, name=f"opening {url}", daemon=True).start()

    def poll(self) -> Port | None:
        """The port, once; None until it is open. Raises AnnulusError when it cannot be opened."""
        with self._lock:
            if self._problem is not None:
                raise self._problem
            port, self._port = self._port, None
            return port

    def abandon(self) -> None:
        """Nobody waits any more: what is opened after all is closed again."""
        with self._lock:
            self._wanted = False
            if self._port is not None:
                self._port.close()

    def _open(self) -> None:
        try:
            port = Port(self.url)
        except AnnulusError as error:
            with self._lock:
                self._problem = error
            return
        with self._lock:
            if self._wanted:
                self._port = port
            else:
                port.close()


class _Socket(protocol_socket.Serial):  # type: ignore[misc]
    """pyserial's, claimed before it is connected, and without the 0.3 s it sleeps when it is closed."""

    is_open: bool
    _claim: socket.socket | None = None

    def open(self) -> None:
        try:
            host, port = self.from_url(self.portstr)
        except (TypeError, KeyError) as error:  # pyserial's own, for a URL without a host or with a port of no use
            raise ValueError(f"expected socket://HOST:PORT ({error})") from None
        address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][4]
        self._claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        try:
            try:
                self._claim.bind("\0annulus line {} {}".format(*address[:2]))
            except OSError:
                raise OSError(errno.EBUSY, os.strerror(errno.EBUSY)) from None
            super().open()
        except BaseException:
            self._claim.close()
            raise

    def close(self) -> None:
        if self.is_open:
            self.is_open = False
            self._socket.close()
        if self._claim is not None:
            self._claim.close()


def _opened(url: str) -> tuple[Any, int | None]:
    """A pyserial port that is ours alone, and its file where bytes written there are the line's bytes."""
    settings = {"baudrate": BAUD, "timeout": READ_S, "write_timeout": WRITE_S}
    if url.lower().startswith("socket://"):
        line = _Socket(url, **settings)
        return line, line.fileno()
    port = serial.serial_for_url(url, exclusive=True, **settings)
    if not _is_tty(port):
        return port, None
    if not os.ttyname(port.fileno()).startswith("/dev/pts/"):
        fcntl.ioctl(port.fileno(), termios.TIOCEXCL)
    return port, port.fileno()


def _is_tty(port: object) -> bool:
    return type(port) is serial.Serial


def _holder(path: str) -> str:
    """Which process has locked that file, where it can be seen: " (process 123, annulus daemon ..)"."""
    try:
        status = os.stat(path)
        wanted = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()
            if "FLOCK" in words and wanted in words:
                pid = words[words.index(wanted) - 1]
                command = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                return f" (process {pid}: {command.strip()[:80]})"
    except OSError:
        pass
    return ""


def _reason(error: Exception) -> str:
    """The operating system's words, without pyserial's wrapping."""
    if isinstance(error, OSError) and error.errno and error.errno > 0:
        return os.strerror(error.errno)
    return (str(error) or type(error).__name__).splitlines()[0]
