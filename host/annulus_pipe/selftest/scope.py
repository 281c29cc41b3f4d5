"""The controller as its own logic analyser: looks of four neighbouring pins, a sample a tick."""

import struct
from dataclasses import dataclass

from annulus_pipe.controller import PIN_STEP, TICK_HZ, TURNTABLE_LEAD_MS
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    Clear,
    Measure,
    Move,
    Samples,
    SamplesReply,
    StateFlag,
    Status,
    StatusCode,
    StatusReply,
)
from annulus_pipe.link.session import LinkEvent
from annulus_pipe.vocabulary import AnnulusError

LOOK_TICKS = 512
BEGIN_TICKS = 2  # from the edge to the first sample of a look without delay
WORDS_A_REPLY = 8
TICKS_A_WORD = 8
PATIENCE_S = 1.0
POLL_S = 0.01
OWED_S = 0.1  # after a reset, as if the longest burst had just ended: 77 ms
SETTLE_S = 0.005


@dataclass(frozen=True, slots=True)
class ScopeLook:
    """Levels of the pins `first` .. `first + 3`, the first sample `begin` ticks after the edge that began the look."""

    first: int
    begin: int
    samples: tuple[int, ...]

    def changes(self, pin: int) -> list[tuple[int, int]]:
        """(ticks since the edge, level) of every change of a pin within the look."""
        levels = [(sample >> (pin - self.first)) & 1 for sample in self.samples]
        return [(self.begin + i, levels[i]) for i in range(1, len(levels)) if levels[i] != levels[i - 1]]

    def rises(self, pin: int) -> list[int]:
        return [tick for tick, level in self.changes(pin) if level]

    def falls(self, pin: int) -> list[int]:
        return [tick for tick, level in self.changes(pin) if not level]


@dataclass(frozen=True, slots=True)
class ScopeTrigger:
    """What begins a look: an edge of a pin, and how long after it the look begins."""

    pin: int
    level: int
    delay: int = 0


class Scope:
    """One controller at the bench. Whatever else comes over the line meanwhile is kept in `heard`."""

    def __init__(self, client: Client, port: str) -> None:
        self.client = client
        self.port = port
        self.heard: list[LinkEvent] = []

    def status(self) -> StatusReply:
        reply = self.client.request(Status())
        assert isinstance(reply, StatusReply)
        return reply

    def begin(self, edge: ScopeTrigger, first: int, looks: int = 1) -> None:
        self.client.request(Measure(looks, edge.pin, edge.level, first, edge.delay))
        self._edge, self._first, self._looks = edge, first, looks

    def end(self) -> None:
        """The odometer counts on."""
        self.client.ask(Arm(ArmFlag(0)))
        self.client.ask(Measure(0, 0, 0, 0, 0))

    def taken(self) -> tuple[int, bool]:
        """Looks so far, and whether the latest differs from the first."""
        reply = self._samples(0, 0)
        return reply.looks, reply.differs == 1

    def wait(self, patience_s: float = PATIENCE_S) -> tuple[int, bool]:
        """Until all looks are there or one differs, or nothing more comes."""
        end = self.client.now_s() + patience_s
        taken, differs = self.taken()
        while taken < self._looks and not differs and self.client.now_s() < end:
            self.listen(POLL_S)
            taken, differs = self.taken()
        return taken, differs

    def fetch(self, latest: bool = False) -> ScopeLook:
        samples: list[int] = []
        for word in range(0, LOOK_TICKS // TICKS_A_WORD, WORDS_A_REPLY):
            words = struct.unpack(f"<{WORDS_A_REPLY}I", self._samples(int(latest), word).bits)
            samples += [(w >> shift) & 15 for w in words for shift in range(28, -1, -4)]
        return ScopeLook(self._first, self._edge.delay + BEGIN_TICKS, tuple(samples))

    def alike(self, edge: ScopeTrigger, first: int, looks: int) -> list[tuple[ScopeLook, int]]:
        """So many looks while edges come: each look that was seen, and how often. Fewer when the edges end."""
        seen: list[tuple[ScopeLook, int]] = []
        while looks > 0:
            self.begin(edge, first, looks)
            taken, differs = self.wait()
            if taken == 0:
                break
            seen.append((self.fetch(), taken - differs))
            if differs:
                seen.append((self.fetch(latest=True), 1))
            elif taken < looks:
                break
            looks -= taken
        return seen

    def fire(self, burst: Burst) -> StatusCode:
        """Start a train. Whoever does it too soon after another finds a fault latched: the limit holds over time."""
        answer = self.client.ask(burst)
        if answer is None:
            raise AnnulusError(f"{self.port}: no answer to burst, expected one")
        return answer.reply.status

    def steps(self, count: int, period: int) -> None:
        """Let STEP make so many pulses, from now on, one every `period` ticks."""
        self.client.request(Move(self.status().turntable + count, period, 0))

    def stand(self, patience_s: float) -> None:
        """Until the steps are over."""
        end = self.client.now_s() + patience_s
        while StateFlag.TURNTABLE_MOVING in self.status().state:
            if self.client.now_s() > end:
                raise AnnulusError(f"{self.port}: STEP (GP{PIN_STEP}) still moves, expected it to stand")
            self.listen(POLL_S)
        self.quiet(SETTLE_S)  # what the last edge has to tell

    def run_steps(self, count: int, period: int) -> None:
        self.steps(count, period)
        self.stand(1e-3 * TURNTABLE_LEAD_MS + count * period / TICK_HZ + PATIENCE_S)

    def listen(self, seconds: float) -> None:
        """Take in events, and keep the controller from thinking we had gone."""
        self.client.keep_alive()
        self.heard += self.client.poll(seconds)

    def quiet(self, seconds: float) -> None:
        """The same without a word to the controller."""
        end = self.client.now_s() + seconds
        while (left := end - self.client.now_s()) > 0:
            self.heard += self.client.poll(min(left, POLL_S))

    def disarm(self) -> None:
        self.client.request(Arm(ArmFlag(0)))
        self.client.request(Clear())

    def _samples(self, latest: int, word: int) -> SamplesReply:
        reply = self.client.request(Samples(latest, word))
        assert isinstance(reply, SamplesReply)
        return reply
