"""What the boot we know cannot have said.

A loss of power leaves the boot byte as it was once in 256 times. On USB the plug tells; on the UART nothing does, and
the one event that would, `booted`, may be lost. So whatever only grows is watched: the count of edges, and time.
`LinkSession` watches the sequence of events, and a nonce settles it (protocol/README.md, Identity).
"""

from annulus_pipe.controller import TICK_NS
from annulus_pipe.link.clock import ClockMap
from annulus_pipe.link.messages import Edge
from annulus_pipe.vocabulary import EdgeIndex, Flash, Slot, Tick

JUMP_NS = 50_000_000  # far more than any map is uncertain; a clock that runs is within one round trip
_FUTURE = 1 << 31  # of counts modulo 2^32


class BootWatch:
    """Each method returns why this is another boot, in a few words; empty when it may be the same."""

    def __init__(self) -> None:
        self._edges = 0  # so many have been told
        self._counted = 0  # and so many counted by a status, which overtakes what it counts

    def restart(self) -> None:
        """Another boot: everything begins at zero."""
        self._edges = self._counted = 0

    def edge(self, number: int, recovered: bool) -> str:
        """Edges come in order, but for those read again."""
        if recovered:
            return ""
        went_back = (number - self._edges) % (2 * _FUTURE) >= _FUTURE
        self._edges = (number + 1) % (2 * _FUTURE)
        return f"edge {number} came a second time" if went_back else ""

    def status(self, edges: int) -> str:
        """A status counts the edges told before it, and perhaps more: replies go before events."""
        seen = (self._edges, self._counted)
        went_back = any((edges - before) % (2 * _FUTURE) >= _FUTURE for before in seen)
        self._counted = edges
        return f"its count of edges went back to {edges}" if went_back else ""

    def ping(self, clock: ClockMap, tick: int, sent_ns: int, received_ns: int) -> str:
        """The tick was read between sending and receiving."""
        if not clock.locked:
            return ""
        expected = clock.to_tick((sent_ns + received_ns) // 2)
        if expected is None:
            return ""
        middle = (sent_ns + received_ns) // 2
        off_ns = abs(clock.extend(tick, middle) - expected) * TICK_NS - (received_ns - sent_ns)
        return "its clock jumped" if off_ns > JUMP_NS else ""

    def moment(self, clock: ClockMap, tick: int, received_ns: int) -> str:
        """Nothing is heard before it happened."""
        host_ns = clock.to_host(clock.extend(tick, received_ns)) if clock.locked else None
        return "it told of the future" if host_ns is not None and host_ns > received_ns + JUMP_NS else ""


def flash_from(edge: Edge, tick: Tick, boot: int, epoch: int = 0) -> Flash:
    """The vocabulary's Flash of an Edge event, its tick extended to 64 bits."""
    lamp = (edge.lamp, edge.delay, edge.width)
    return Flash(
        EdgeIndex(edge.edge), tick, Slot(edge.slot), *lamp, edge.odometer, edge.generation, boot, edge.flags, epoch
    )
