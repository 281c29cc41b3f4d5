"""Which slot is due after which, of the lamp cycle or of an optical preamble, and what lights it: protocol/README.md,
Edges and lamps. Judged by what the edges tell; that they tell the truth is judged at the pins.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from annulus_pipe.link.messages import Arm, Commit, Edge, Identify, Preamble, Stage, StatusCode
from annulus_pipe.vocabulary import EdgeFlag, Lamp
from tools.attack.boards import insist
from tools.attack.kept import Asked, Kept

OFF = Preamble(0, 0, 0)
LAMPS = np.array([Lamp.PROJECTOR, Lamp.LED, Lamp.DARK, Lamp.PROJECTOR])  # of two bits of the sequence
LAMPS_OF_RATIO_0 = np.array([Lamp.DARK, Lamp.LED, Lamp.DARK, Lamp.LED])


def is_order(asked: Asked) -> bool:
    """Does it change what is due?"""
    return isinstance(asked.command, (Arm, Commit, Preamble, Identify))


def in_preamble(edge: Edge) -> bool:
    return bool(edge.flags & EdgeFlag.PREAMBLE)


class Slots:
    """Of one player: the sequence of preambles goes on from scene to scene, until the controller begins anew."""

    def __init__(self) -> None:
        self._registers = self._any()  # states that the sequence may be in
        self._cycles: int | None = None  # complete since the last preamble; None: not known

    @staticmethod
    def _any() -> np.ndarray:
        return np.arange(1, 1 << 15)

    def lost(self) -> None:
        """Edges went by that nobody told."""
        self._registers, self._cycles = self._any(), None

    def edge(
        self, edge: Edge, previous: Edge | None, free: bool, configs: Mapping[int, Stage], order: Preamble | None
    ) -> None:
        """`free`: something between these two edges may have changed what is due. `configs`: by generation, where it is
        sure. `order`: what preambles are to be like, where that is, and has been for an edge more.
        """
        config = configs.get(edge.generation)
        if edge.flags & EdgeFlag.DISARMED:
            self._cycles = None
            insist(edge.lamp == Lamp.DARK, f"{edge}: disarmed and not dark")
            insist(not in_preamble(edge), f"{edge}: a preamble while disarmed")
            return
        if previous and order:
            self._follows(edge, previous, free, configs, order)
        else:
            self._cycles = None
        if config is not None:
            self._lamp(edge, config)
        if in_preamble(edge):
            self._sequence(edge, config, free)

    def _lamp(self, edge: Edge, config: Stage) -> None:
        led = edge.slot == config.ratio
        if in_preamble(edge):
            led = edge.lamp == Lamp.LED
            insist(edge.lamp != Lamp.PROJECTOR or config.ratio > 0, f"{edge}: a projector that was never checked")
        else:
            insist(edge.slot <= config.ratio, f"{edge}: no such slot with ratio {config.ratio}")
        if not edge.flags & EdgeFlag.LATE_LOAD and edge.lamp != Lamp.DARK:
            expected = (config.led_delay, config.led_width) if led else (config.projector_delay, config.projector_width)
            insist((edge.delay, edge.width) == expected, f"{edge}: configured were {expected}")
            insist(edge.lamp == (Lamp.LED if led else Lamp.PROJECTOR), f"{edge}: the other lamp's slot")

    def _follows(self, edge: Edge, previous: Edge, free: bool, configs: Mapping[int, Stage], order: Preamble) -> None:
        """What is due after the edge before."""
        here = (in_preamble(edge), edge.slot)
        if previous.flags & EdgeFlag.DISARMED:
            self._cycles = 0
            begin = (order.length > 0, 0)
            insist(here == begin, f"{edge}: armed, and {due(begin)} was due")
            return
        before = configs.get(previous.generation)
        if free or before is None:
            self._cycles = None
            return
        if in_preamble(previous):
            more = previous.slot + 1 < order.length
            follows, self._cycles = {(more, previous.slot + 1 if more else 0)}, 0
        elif previous.slot < before.ratio:
            follows = {(False, previous.slot + 1)}
        else:
            self._cycles = None if self._cycles is None else self._cycles + 1
            by_itself = order.length > 0 and order.interval > 0
            follows = {(False, 0)} if not by_itself or self._cycles != order.interval else set()
            if by_itself and self._cycles in (None, order.interval):
                follows.add((True, 0))
        insist(here in follows, f"{edge}: {' or '.join(map(due, sorted(follows)))} was due")

    def _sequence(self, edge: Edge, config: Stage | None, free: bool) -> None:
        """One place in the sequence for every edge of a preamble; a load that was taken twice says its lamp twice."""
        if config is not None and not free and not edge.flags & EdgeFlag.LATE_LOAD:
            lamps = (LAMPS if config.ratio else LAMPS_OF_RATIO_0)[self._registers & 3]
            widths = {Lamp.DARK: 0, Lamp.PROJECTOR: config.projector_width, Lamp.LED: config.led_width}
            shown = np.array([lamp if widths[lamp] else Lamp.DARK for lamp in Lamp])[lamps]
            self._registers = self._registers[shown == edge.lamp]
            insist(len(self._registers) > 0, f"{edge}: this is not how the sequence of preambles goes on")
        bits = self._registers
        self._registers = ((bits << 2) | (((bits >> 13) ^ (bits >> 12)) & 3)) & 0x7FFF


def due(what: tuple[bool, int]) -> str:
    return f"slot {what[1]} of a preamble" if what[0] else f"slot {what[1]}"


def order_at(kept: Kept, begin: int, end: int) -> Preamble | None:
    """What preambles were to be like from one tick to another; None where it may have changed between."""
    order = OFF
    for asked in kept.asked:
        if isinstance(asked.command, (Preamble, Identify)) and asked.sent <= end:
            if asked.answered > begin or not asked.reply:
                return None
            if isinstance(asked.command, Identify):
                order = OFF
            elif asked.reply.status == StatusCode.OK:
                order = asked.command
    return order


def orders_kept(kept: Kept, edges: Sequence[tuple[int, Edge]]) -> None:
    """What was ordered to begin now had begun at the next edge, unless something else came between."""
    orders = [asked for asked in kept.asked if is_order(asked)]
    for asked in orders:
        order = asked.command
        if not isinstance(order, Preamble) or not order.now or not order.length or not asked.reply:
            continue
        later = [(tick, edge) for tick, edge in edges if tick > asked.answered]
        if asked.reply.status != StatusCode.OK or len(later) < 2:
            continue
        after = later[1]  # the first one's flash was loaded
        if after[1].flags & EdgeFlag.DISARMED:
            continue
        if any(other is not asked and other.answered > asked.sent and other.sent <= after[0] for other in orders):
            continue
        before = [edge for tick, edge in edges if tick <= asked.sent]
        if before and not before[-1].flags & EdgeFlag.DISARMED:
            begun = any(in_preamble(edge) for tick, edge in edges if asked.sent < tick <= after[0])
            insist(begun or in_preamble(before[-1]), f"{after[1]}: a preamble was ordered at {asked.sent}", after[0])
