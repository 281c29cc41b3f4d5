"""When a host asks for an optical preamble, and what it asks for (protocol/README.md, Edges and lamps)."""

from dataclasses import dataclass, replace

from annulus_pipe.controller import TICK_HZ, TICK_NS
from annulus_pipe.link.messages import Preamble, Stage

ORDER_NS = 500_000_000  # between two orders at least, and the length of one: frames that wait hear the next one speak
CYCLES_MAX = 0xFFFF


def preamble_of(stage: Stage, frames: int, interval_s: float) -> Preamble:
    """`frames` long, every `interval_s` or a lamp cycle more; an interval of 0: on arming and on order only."""
    cycle_s = (stage.ratio + 1) * stage.frame_period / TICK_HZ
    cycles = max(1, min(CYCLES_MAX, round(interval_s / cycle_s))) if interval_s > 0.0 else 0
    return Preamble(frames, cycles, 0)


@dataclass(slots=True)
class PreambleOrders:
    """Orders beside the preambles that come by themselves: one at a time, not more often than ORDER_NS and their length
    let.
    """

    wanted: Preamble | None
    period_ticks: int  # from frame to frame
    count: int = 0
    _asked: bool = False
    _next_ns: int = 0
    _ticket: int | None = None  # under way

    def ask(self) -> None:
        self._asked = self.wanted is not None

    def forget(self) -> None:
        self._asked, self._ticket = False, None

    def due(self, now: int) -> Preamble | None:
        """To be sent now, and told by `sent`."""
        if self.wanted is None or not self._asked or self._ticket is not None or now < self._next_ns:
            return None
        return replace(self.wanted, now=1)

    def sent(self, ticket: int, now: int) -> None:
        length_ns = self.wanted.length * self.period_ticks * TICK_NS if self.wanted is not None else 0
        self.count += 1
        self._asked, self._ticket, self._next_ns = False, ticket, now + max(ORDER_NS, length_ns)

    def ended(self, ticket: int) -> None:
        """Answered, or not: one that does not come is no trouble, the next doubt asks again."""
        if ticket == self._ticket:
            self._ticket = None
