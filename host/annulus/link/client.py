"""One controller behind a serial line: tty, pty or `socket://host:port`. No thread; bytes move when a method is called.

    with Client("/dev/ttyACM0") as client:              # opened and identified, or AnnulusError says why not
        client.request(Arm(ArmFlag.LAMPS))
        for happening in client.poll(0.1): ...

The daemon, which keeps a head in service, drives a HeadControl over the same Port: `port.pump(head)`.
"""

import os
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType
from typing import Protocol, Self, TypeVar

import serial

from annulus.link.codec import Corrupt
from annulus.link.head import PING_NS, refusal, schema_problem
from annulus.link.messages import Command, IdentifyReply, Ping, Reply, StatusCode
from annulus.link.problems import too_old
from annulus.link.session import Answer, LinkEvent, Session, Unanswered, identify
from annulus.vocabulary import AnnulusError

BAUD = 1_000_000
IDENTIFY_S = 1.0
REQUEST_S = 2.0
READ_S = 0.002  # at most this long in one read, so that repeats are sent in time
READ_MAX = 4096
WRITE_S = 0.5
HAPPENINGS_MAX = 1024  # kept between two polls; older ones are dropped and counted

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
        self.url = url
        self.bytes_read = 0
        try:
            self._serial = serial.serial_for_url(url, baudrate=BAUD, timeout=READ_S, write_timeout=WRITE_S)
        except (serial.SerialException, OSError, ValueError) as error:
            raise AnnulusError(
                f"{url}: cannot be opened ({_reason(error)}), expected a serial port or socket://host:port."
                " Is the head plugged in?"
            ) from None
        self.now_ns: Callable[[], int] = getattr(self._serial, "now_ns", time.monotonic_ns)
        try:
            self.write(b"\0")
        except AnnulusError:
            self.close()
            raise

    def read(self, timeout_s: float) -> bytes:
        """What is there, or what comes first within the time; empty when nothing does."""
        try:
            self._serial.timeout = max(0.0, timeout_s)
            data = bytes(self._serial.read(1))
            if data:
                self._serial.timeout = 0
                data += bytes(self._serial.read(READ_MAX))
        except (serial.SerialException, OSError, TypeError) as error:
            raise AnnulusError(f"{self.url}: the line went away ({_reason(error)}), expected the controller") from None
        self.bytes_read += len(data)
        return data

    def write(self, data: bytes) -> None:
        if not data:
            return
        try:
            self._serial.write(data)
        except serial.SerialTimeoutException:
            raise AnnulusError(
                f"{self.url}: takes no bytes for {WRITE_S:g} s, expected a controller that reads"
            ) from None
        except (serial.SerialException, OSError) as error:
            raise AnnulusError(f"{self.url}: the line went away ({_reason(error)}), expected the controller") from None

    def pump(self, talker: Talker[Item], timeout_s: float = READ_S) -> list[Item]:
        """Write what is due, read what comes within the time, hand it over. Call it in a loop."""
        self.write(talker.pending(self.now_ns()))
        data = self.read(timeout_s)
        return talker.receive(data, self.now_ns())

    def close(self) -> None:
        self._serial.close()


class Client:
    """Requests and answers over a Port, for commands and tests. The daemon uses Port and HeadControl instead."""

    def __init__(self, url: str, *, timeout_s: float = IDENTIFY_S, diagnostics: bool = False) -> None:
        """Open and identify. `diagnostics`: a controller with another schema is accepted (it will refuse to arm)."""
        self.session = Session()
        self.dropped = 0  # happenings nobody polled
        self._next_ping_ns = 0
        self._happenings: deque[LinkEvent] = deque(maxlen=HAPPENINGS_MAX)
        self._port = Port(url)
        try:
            self.identity = self._identify(timeout_s)
            problem = schema_problem(self.identity)
            if problem and not diagnostics:
                raise AnnulusError(f"{url}: {problem}")
        except BaseException:
            self._port.close()
            raise

    def request(self, command: Command, timeout_s: float = REQUEST_S) -> Reply:
        """The reply to a command that was carried out. AnnulusError when refused (why), not answered or not known."""
        if not self.session.knows(type(command)):
            raise AnnulusError(f"{self._port.url}: {too_old(type(command))}")
        answer = self.ask(command, timeout_s)
        if answer is None:
            name = type(command).__name__.lower()
            raise AnnulusError(f"{self._port.url}: no answer to {name} within {timeout_s:g} s, expected one")
        if answer.reply.status is not StatusCode.OK:
            raise AnnulusError(f"{self._port.url}: {refusal(answer)}")
        return answer.reply

    def ask(self, command: Command, timeout_s: float = REQUEST_S) -> Answer | None:
        """The answer, whatever its status; None when none came. Other happenings wait for `poll`."""
        ticket = self.session.send(command)
        deadline = self.now_s() + timeout_s
        while self.now_s() < deadline:
            found: Answer | None = None
            for happening in self._turn(READ_S):
                if isinstance(happening, Answer) and happening.ticket == ticket:
                    found = happening
                elif isinstance(happening, Unanswered) and happening.ticket == ticket:
                    return None
                else:
                    self._keep(happening)
            if found is not None:
                return found
        return None

    def poll(self, timeout_s: float = 0.0) -> list[LinkEvent]:
        """What happened since the last poll, waiting up to `timeout_s` for the first."""
        deadline = self.now_s() + timeout_s
        while True:
            for happening in self._turn(min(READ_S, max(0.0, deadline - self.now_s()))):
                self._keep(happening)
            if self._happenings or self.now_s() >= deadline:
                happenings = list(self._happenings)
                self._happenings.clear()
                return happenings

    def keep_alive(self) -> None:
        """A ping whose answer nobody waits for, at most every PING_NS; call it as often as you like.

        The controller goes dark when it hears nothing for its host timeout.
        """
        now = self._port.now_ns()
        if now >= self._next_ping_ns and not self.session.backlog:
            self._next_ping_ns = now + PING_NS
            self.session.send(Ping())

    def now_s(self) -> float:
        """Of the port's clock."""
        return self._port.now_ns() * 1e-9

    def close(self) -> None:
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _identify(self, timeout_s: float) -> IdentifyReply:
        answer = self.ask(identify(), timeout_s)
        if answer is not None and isinstance(answer.reply, IdentifyReply):
            deadline = self.now_s() + timeout_s
            while not self.session.informed and self.now_s() < deadline:
                for happening in self._turn(READ_S):
                    self._keep(happening)
            return answer.reply
        url = self._port.url
        if not self._port.bytes_read:
            raise AnnulusError(f"{url}: no answer to identify within {timeout_s:g} s. Is this the controller?")
        damaged = sum(isinstance(happening, Corrupt) for happening in self._happenings)
        raise AnnulusError(
            f"{url}: {self._port.bytes_read} bytes came within {timeout_s:g} s, {damaged} damaged frames and no answer"
            f" to identify; expected an annulus controller at {BAUD} baud"
        )

    def _turn(self, timeout_s: float) -> list[LinkEvent]:
        happenings = self._port.pump(self.session, timeout_s)
        return happenings + self.session.expire(self._port.now_ns())

    def _keep(self, happening: LinkEvent) -> None:
        self.dropped += len(self._happenings) == HAPPENINGS_MAX
        self._happenings.append(happening)


def _reason(error: Exception) -> str:
    """The operating system's words, without pyserial's wrapping."""
    if isinstance(error, OSError) and error.errno:
        return os.strerror(error.errno)
    return (str(error) or type(error).__name__).splitlines()[0]
