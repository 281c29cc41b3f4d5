"""The controller's edges in host time, and which frame each of them ends.

A controller restarts, an event is lost, a sync pulse is missed or doubled: its own count of edges is not the camera's
of frames. So every edge gets an `ordinal`, which counts periods of host time: it goes on over all of these, and two
edges that are n periods apart differ by n in it. Where too long went by without an edge to say how many periods that
was, it leaps, and whoever compares sees that nothing fits any more.
"""

from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

from annulus_pipe.vocabulary import EdgeFlag, Flash

EDGES_KEPT = 256  # ten seconds at 25 fps: more than a frame ever waits
SPANS_KEPT = 64
NEAR = 0.25  # of a period: edges whose count and time differ by less agree
BRIDGED = 0.2  # of a period: how far off a span without edges may be, and still be counted
PLACED_NS = 4_000_000  # how well an edge is placed in host time, at worst
CLOCKS = 20e-6  # by how much controller and host change their pace
SOUND_WITHIN = 8  # edges back
BASE_EDGES = 4096  # the period is measured over one to two times as many
CYCLE = 5  # frames: four projector flashes to one of the LED, until a cycle was seen
LEAP = 1 << 24  # frames; 8 days at 25 fps

_IRREGULAR = int(EdgeFlag.IRREGULAR)  # as plain numbers: asked for every frame
_PREAMBLE = int(EdgeFlag.PREAMBLE)
_NO_CYCLE = _PREAMBLE | int(EdgeFlag.DISARMED)  # a controller that is not armed stays at slot 0
_NO_FLASH = int(EdgeFlag.LATE_LOAD) | _IRREGULAR
_NO_INTERVAL = _IRREGULAR | int(EdgeFlag.FIRST)


@dataclass(frozen=True, slots=True, order=True)
class PlacedEdge:
    """An edge in host time, by which it sorts."""

    host_ns: int
    boot_epoch: int
    index: int
    flash: Flash = field(compare=False)
    ordinal: int = field(default=0, compare=False)


class EdgeHistory:
    """The edges of the last seconds, and the spans in which no flash is to be trusted. Cameras on one sync line share
    one.
    """

    def __init__(self, preambled: bool = False) -> None:
        """`preambled`: there are preambles, as far as is known from before."""
        self.invalid: deque[tuple[int, int]] = deque(maxlen=SPANS_KEPT)
        self._sound_from_ns = 0  # no span is after this
        self._edges: list[PlacedEdge] = []  # by host time
        self._times: list[int] = []  # theirs
        self._by_index: dict[tuple[int, int], PlacedEdge] = {}
        self._by_ordinal: dict[int, PlacedEdge] = {}
        self.preambled = preambled  # whether a flash of a preamble was ever among them
        self.cycle = CYCLE  # frames after which the lamps repeat themselves
        self._period_ns: float | None = None  # as measured
        self._base: PlacedEdge | None = None  # where that measurement begins ..
        self._next_base: PlacedEdge | None = None  # .. and where it will

    @property
    def edges(self) -> Sequence[PlacedEdge]:
        """By host time."""
        return self._edges

    def edge(self, flash: Flash, host_ns: int, boot_epoch: int) -> None:
        """An edge was heard. Order does not matter: edges that had to be read again come late."""
        index = int(flash.edge)
        if int(flash.flags) & _PREAMBLE:
            self.preambled = True
        elif int(flash.slot) == 0 and not int(flash.flags) & _NO_CYCLE:
            before = self._by_index.get((boot_epoch, index - 1))
            if before is not None and not int(before.flash.flags) & _NO_CYCLE:
                self.cycle = int(before.flash.slot) + 1
        at = bisect_right(self._times, host_ns)
        edge = PlacedEdge(host_ns, boot_epoch, index, flash, self._ordinal(host_ns, boot_epoch, index, at))
        self._edges.insert(at, edge)
        self._times.insert(at, host_ns)
        self._by_index[boot_epoch, index] = edge
        self._by_ordinal.setdefault(edge.ordinal, edge)
        if at == len(self._edges) - 1:
            self._measure(edge)
        if len(self._edges) > EDGES_KEPT:
            self._forget(self._edges.pop(0))
            del self._times[0]

    def invalidate(self, from_ns: int, to_ns: int) -> None:
        """A lamp may have been cut, or switched, in this span: no frame that was open in it gets a label."""
        self.invalid.append((from_ns, to_ns))
        self._sound_from_ns = max(self._sound_from_ns, to_ns)

    def near(self, moment: float, window_ns: float) -> Sequence[PlacedEdge]:
        """Edges inside the window around a moment. Neighbours a half period off are outside, so one is the rule."""
        first = bisect_left(self._times, moment - window_ns)
        return self._edges[first : bisect_right(self._times, moment + window_ns, first)]

    def nearest(self, moment: float) -> PlacedEdge:
        """Of at least one."""
        at = bisect_left(self._times, moment)
        if at and (at == len(self._times) or moment - self._times[at - 1] <= self._times[at] - moment):
            at -= 1
        return self._edges[at]

    def surrounded(self, moment: float, apart_ns: float) -> bool:
        """Whether the edges before and after a moment are here and no further apart than that."""
        at = bisect_left(self._times, moment)
        return 0 < at < len(self._times) and self._times[at] - self._times[at - 1] <= apart_ns

    def opening(self, closing: PlacedEdge) -> PlacedEdge | None:
        """The edge before, by the controller's own count and in the same life."""
        return self._by_index.get((closing.boot_epoch, closing.index - 1))

    def numbered(self, ordinal: int) -> PlacedEdge | None:
        return self._by_ordinal.get(ordinal)

    def lit(self, ordinal: int) -> Flash | None:
        """The flash that lit the frame that ends there, where nothing of it is in doubt."""
        closing = self._by_ordinal.get(ordinal)
        opening = self.opening(closing) if closing is not None else None
        if closing is None or opening is None or closing.ordinal - opening.ordinal != 1:
            return None
        flags = int(opening.flash.flags) | (int(closing.flash.flags) & _IRREGULAR)
        return None if flags & _NO_FLASH or self.cut(opening, closing) else opening.flash

    def cut(self, opening: PlacedEdge, closing: PlacedEdge) -> bool:
        """Whether a lamp may have been cut or switched between these two edges."""
        if opening.host_ns > self._sound_from_ns:
            return False
        return any(start <= closing.host_ns and end >= opening.host_ns for start, end in self.invalid)

    def _ordinal(self, host_ns: int, boot_epoch: int, index: int, at: int) -> int:
        if not self._edges:
            return 0
        beside = self._edges[max(0, at - 1)]
        counted = index - beside.index if boot_epoch == beside.boot_epoch else None
        if self._period_ns is None or self._base is None:
            return beside.ordinal + (LEAP if counted is None else counted)
        measured_ns = max(self._period_ns, self._edges[-1].host_ns - self._base.host_ns)
        drift = PLACED_NS / measured_ns + CLOCKS
        periods = (host_ns - beside.host_ns) / self._period_ns
        if counted is not None and abs(periods - counted) <= NEAR + abs(periods) * drift:
            return beside.ordinal + counted
        for sound in reversed(self._edges[max(0, at - SOUND_WITHIN) : at]):  # from one that fell where edges fall
            if not int(sound.flash.flags) & _NO_INTERVAL:
                beside, periods = sound, (host_ns - sound.host_ns) / self._period_ns
                break
        return beside.ordinal + (round(periods) if abs(periods) * drift <= BRIDGED else LEAP)

    def _measure(self, edge: PlacedEdge) -> None:
        """The period, from the latest edge."""
        if self._base is None or edge.ordinal - self._base.ordinal >= LEAP:
            before = self.opening(edge)
            if before is not None and not int(edge.flash.flags) & _NO_INTERVAL:
                self._base = self._next_base = before
                self._period_ns = float(edge.host_ns - before.host_ns)
            return
        if int(edge.flash.flags) & _NO_INTERVAL:
            return
        if edge.ordinal > self._base.ordinal:
            self._period_ns = (edge.host_ns - self._base.host_ns) / (edge.ordinal - self._base.ordinal)
        if self._next_base is not None and edge.ordinal - self._next_base.ordinal >= BASE_EDGES:
            self._base, self._next_base = self._next_base, edge

    def _forget(self, edge: PlacedEdge) -> None:
        if self._by_index.get((edge.boot_epoch, edge.index)) is edge:
            del self._by_index[edge.boot_epoch, edge.index]
        if self._by_ordinal.get(edge.ordinal) is edge:
            del self._by_ordinal[edge.ordinal]
