"""One controller behind a serial line: tty, pty or `socket://host:port`. No thread; bytes move when a method is called.

    with Client("/dev/ttyACM0") as client:              # opened and identified, or AnnulusError says why not
        client.request(Arm(ArmFlag.LAMPS))
        for happening in client.poll(0.1): ...

The daemon, which keeps a head in service, drives a HeadControl over the same Port: `port.pump(head)`.
"""

from collections import deque
from types import TracebackType
from typing import Self

from annulus_pipe.link.codec import Corrupt
from annulus_pipe.link.head import PING_NS
from annulus_pipe.link.messages import Command, IdentifyReply, Ping, Reply, StatusCode
from annulus_pipe.link.port import BAUD, READ_S, Port
from annulus_pipe.link.problems import refusal, schema_problem, too_old
from annulus_pipe.link.session import Answer, LinkEvent, LinkSession, Unanswered, identify
from annulus_pipe.vocabulary import AnnulusError

IDENTIFY_S = 1.0
REQUEST_S = 2.0
HAPPENINGS_MAX = 1024  # kept between two polls; older ones are dropped and counted


class Client:
    """Requests and answers over a Port, for commands and tests. The daemon uses Port and HeadControl instead."""

    def __init__(self, url: str, *, timeout_s: float = IDENTIFY_S, diagnostics: bool = False) -> None:
        """Open and identify. `diagnostics`: a controller with another schema is accepted (it will refuse to arm)."""
        self.session = LinkSession()
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
