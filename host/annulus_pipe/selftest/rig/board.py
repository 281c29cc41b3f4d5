"""What a promise is tried on: a board whose inputs can be played tick by tick and whose outputs are seen as exactly.

A promise is a function of a `Board`. The rig is one (`on_rig`), the emulator another (tests/emulator); so what is
proven on the emulator is asked of silicon by the same lines of code. Time within a scene is in the controller's own
ticks since the scene began, whichever clock measured it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol, TypeVar

from annulus_pipe.link.messages import Command, Event, IdentifyReply, Reply

EdgeIn = tuple[float, int, int]  # tick, pin, level
E = TypeVar("E", bound=Event)

LATENCY = 9  # ticks from the sync edge to the lamp beyond the delay asked for: firmware/README.md
US, MS = 100, 100_000  # ticks


@dataclass(frozen=True, slots=True)
class Fine:
    """Four neighbouring pins, written down in every tick for a while: for pulses too short for a time stamp."""

    first: int
    begin: int
    ticks: int


@dataclass(frozen=True, slots=True)
class Scene:
    """What is done to a board.

    `orders`: commands, and ticks before which they are not sent; on the rig the host's own delays come on top, and the
    scene lasts for `after` ticks more from the answer to the last of them. `flood`: noise and questions at line speed
    all the while. `silent`: not a word else.
    """

    until: int
    edges: Sequence[EdgeIn] = ()
    watch: tuple[int, ...] = ()  # pins wanted to the tick: three at most; a fourth is known to two ticks
    orders: Sequence[tuple[int, Command]] = ()
    after: int = 0
    flood: bool = False
    silent: bool = False
    fine: Fine | None = None
    cue: int | None = None  # a watched pin: the ticks of `edges` count from its first rise after the scene began


@dataclass(slots=True)
class Played:
    """What came of it."""

    edges: list[EdgeIn]  # as they were really played
    transitions: list[EdgeIn] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    replies: list[Reply | None] = field(default_factory=list)  # to the orders
    origin: float | None = None  # the controller's count at tick 0; None: no edge reported it

    def rises(self, pin: int) -> list[float]:
        return [tick for tick, p, level in self.transitions if p == pin and level]

    def falls(self, pin: int) -> list[float]:
        return [tick for tick, p, level in self.transitions if p == pin and not level]

    def pulses(self, pin: int) -> list[tuple[float, float]]:
        """(rise, width) of every whole pulse."""
        changes = [(tick, level) for tick, p, level in self.transitions if p == pin]
        return [(t, u - t) for (t, level), (u, _) in itertools.pairwise(changes) if level]

    def widths(self, pin: int) -> list[float]:
        return [width for _, width in self.pulses(pin)]

    def falls_played(self, pin: int) -> list[float]:
        return [tick for tick, p, level in self.edges if p == pin and not level]

    def heard(self, kind: type[E]) -> list[E]:
        return [event for event in self.events if isinstance(event, kind)]

    def tick_of(self, count: int) -> float:
        """Tick in this scene of a time the controller reported."""
        assert self.origin is not None, "no edge of the sync input reported when the scene began"
        return (count - self.origin + 2**31) % 2**32 - 2**31


class Board(Protocol):
    """`slack`: ticks by which a time measured over so many ticks may be off; 0 on the emulator."""

    def slack(self, span: float = 0) -> float: ...

    def identify(self) -> IdentifyReply: ...

    def request(self, command: Command) -> Reply: ...

    def play(self, scene: Scene) -> Played: ...


class NotKeptError(Exception):
    """A promise does not hold, and in what."""


def expect(is_kept: bool, observed: str) -> None:
    if not is_kept:
        raise NotKeptError(observed)
