"""Every edge of the camera: told once, as it fell; the flash that it took, at the pins; none counted within a hold-off,
and none refused beyond it.
"""

from bisect import bisect_left, bisect_right
from itertools import chain

from annulus_pipe.controller import LAMP_DUTY_MAX_PERMILLE, LAMP_WIDTH_MAX_TICKS, PIN_LED, PIN_PROJECTOR
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Commit,
    Configured,
    Edge,
    Event,
    Fault,
    FaultCode,
    Stage,
    StatusReply,
)
from annulus_pipe.vocabulary import EdgeFlag, Lamp
from tools.attack.boards import MS, Board, insist
from tools.attack.kept import Asked, Kept, Told
from tools.attack.play import Player
from tools.attack.products_truth import is_latching
from tools.attack.scenes import Scene
from tools.attack.slots import Slots, is_order, order_at, orders_kept

US = MS // 1000
LAMP_PINS = {Lamp.PROJECTOR: PIN_PROJECTOR, Lamp.LED: PIN_LED}
Flash = tuple[int, int, int]  # its edge, and from when to when the lamp is on
FLASH_OWES = LAMP_WIDTH_MAX_TICKS * 1000 // LAMP_DUTY_MAX_PERMILLE


def holdoff(config: Stage) -> int:
    """In ticks."""
    return config.frame_period - config.frame_period * config.tolerance // 1000


def asked_at(kept: Kept, reply: StatusReply | None) -> tuple[int, int]:
    """When a status was asked for, and answered."""
    return next((asked.sent, asked.answered) for asked in kept.asked if asked.reply is reply)


class Edges:
    """Of one player: what was in force goes on across its scenes."""

    def __init__(self, player: Player) -> None:
        self.board: Board = player.board
        self.slots = Slots()
        self.before: Stage | None = None  # in force when the scene began
        self.earlier: list[Stage] = []  # in force since the last scene in which an edge counted began

    def configs(self, kept: Kept) -> list[Stage]:
        """What may have been in force during the scene."""
        staged = [a.command for a in kept.asked if isinstance(a.command, Stage)]
        return [*([self.before] if self.before else []), *staged]

    def judge(self, kept: Kept, told: list[Told], scene: Scene, whole: bool) -> None:
        edges = [(item, item.event) for item in told if isinstance(item.event, Edge)]
        by_generation: dict[int, Stage] = {c.generation: c for c in [scene.config]}
        ambiguous: set[int] = set()
        for asked in kept.asked:
            if isinstance(asked.command, Stage) and asked.command is not scene.config:
                if asked.command.generation in by_generation:
                    ambiguous.add(asked.command.generation)
                by_generation[asked.command.generation] = asked.command
        sure = {generation: config for generation, config in by_generation.items() if generation not in ambiguous}
        if not whole:
            self.slots.lost()
        falls = kept.falls
        taken: list[int] = []
        cuts = self._cuts(kept, told)
        lit: dict[int, list[Flash]] = {PIN_PROJECTOR: [], PIN_LED: []}
        previous: Edge | None = None
        slot_free = True
        for item, edge in edges:
            at = bisect_right(falls, item.tick) - 1
            insist(at >= 0 and item.tick - falls[at] <= self.board.stamp, f"{edge}: no edge fell then", item.tick)
            insist(not taken or falls[at] > taken[-1], f"{edge}: told twice", item.tick)
            tick = falls[at]
            if previous:
                follows = edge.edge == (previous.edge + 1) & 0xFFFFFFFF
                insist(not whole or follows, f"{edge} after {previous}", tick)
                if not follows:
                    self.slots.lost()
                slot_free |= any(is_order(a) and taken[-1] - US <= a.answered and a.sent <= tick for a in kept.asked)
            slot_free |= any(taken and taken[-1] <= when <= tick for when, _ in cuts)
            before = previous if whole else None
            self.slots.edge(edge, before, slot_free, sure, order_at(kept, taken[-2] if len(taken) > 1 else 0, tick))
            slot_free = False
            if edge.flags & EdgeFlag.LATE_LOAD:
                self._late(kept, told, tick, taken[-1] if taken else 0, lit)
            elif edge.lamp in LAMP_PINS:
                rise = tick + edge.delay + self.board.latency
                lit[LAMP_PINS[edge.lamp]].append((tick, rise, rise + edge.width))
                self._flash(kept, edge, rise, tick, cuts)
            taken.append(tick)
            previous = edge
        for pin, wanted in lit.items():
            starts = {rise for _, rise, _ in wanted}
            for rise, fall in kept.pulses.get(pin, ()):
                insist(
                    rise in starts or not whole, f"GP{pin} lit for {fall - rise} ticks, of which no event tells", rise
                )
        if not whole:
            self.slots.lost()  # the last ones, too, may be among those that nobody told
        else:
            self._accepted(kept, taken)
            orders_kept(kept, list(zip(taken, (edge for _, edge in edges), strict=True)))
        self.earlier = [*([] if taken else self.earlier), *self.configs(kept)]
        self.before = by_generation.get(kept.last.generation) if kept.last else None

    def _cuts(self, kept: Kept, told: list[Told]) -> list[tuple[int, int]]:
        """What may end a flash: from when to when it may have acted."""
        orders = [
            (a.sent, a.answered)
            for a in kept.asked
            if isinstance(a.command, Arm) and not a.command.outputs & ArmFlag.LAMPS
        ]
        slow = sum(end - begin for begin, end in kept.stalls)
        pulled = [(tick, tick + 5 * MS) for tick in kept.unplugged]
        # What latched a moment before the plug was pulled is told to nobody.
        late = slow + 5 * MS
        unsaid = [
            tick
            for tick in (*kept.opened, *(end for _, end in kept.stalls))
            if any(tick < pulled < tick + late for pulled in kept.unplugged)
        ]
        return [
            *orders,
            *pulled,
            *(
                (tick, tick + slow + 5 * MS)
                for tick in unsaid
                if any(tick < p < tick + slow + 5 * MS for p, _ in pulled)
            ),
            *((item.tick - MS - slow, item.tick + US) for item in told if is_latching(item.event)),
        ]

    def _flash(self, kept: Kept, edge: Edge, rise: int, tick: int, cuts: list[tuple[int, int]]) -> None:
        pin = LAMP_PINS[edge.lamp]
        pulses = kept.pulses.get(pin, [])
        at = bisect_left(pulses, (rise, 0))
        found = pulses[at] if at < len(pulses) and pulses[at][0] == rise else None
        if found is None:
            insist(any(low <= rise and high >= tick for low, high in cuts), f"{edge}: GP{pin} stayed dark", tick)
        elif found[1] - found[0] != edge.width:
            short = found[1] - found[0] < edge.width and any(low <= found[1] <= high for low, high in cuts)
            insist(short, f"{edge}: GP{pin} was lit for {found[1] - found[0]} ticks, and nothing cut it", tick)

    def _late(self, kept: Kept, told: list[Told], tick: int, previous: int, lit: dict[int, list[Flash]]) -> None:
        """Allowed after a main loop held up, an edge just before, or an order that changes what is loaded."""
        patience = self.board.round_max
        configured = [i for i in told if isinstance(i.event, Configured) and previous <= i.tick <= tick]
        reasons = (
            previous == 0 or tick - previous < patience,
            previous - self.board.origin < FLASH_OWES,  # by then a flash of before a reset is paid for
            len(configured) > 1,  # two hold-offs
            self._owes(kept, told, lit, previous, tick),
            any(begin - patience <= tick and end + patience >= previous for begin, end in kept.stalls),
            any(a.sent <= tick and a.answered >= tick - patience for a in kept.asked if reloads_flash(a)),
            any(abs(item.tick - tick) < patience for item in told if reloads(item.event)),
        )
        insist(any(reasons), "late_load, and nothing held the main loop up", tick)

    def _owes(self, kept: Kept, told: list[Told], lit: dict[int, list[Flash]], previous: int, tick: int) -> bool:
        """Does a lamp owe dark time to the earliest edge after `previous`? Also for a flash that was cut. By itself no
        configuration leaves any: it has changed since the edge of that flash.
        """
        restarts = [sent for sent, done in kept.restarts if previous <= done and sent <= tick]  # end a hold-off
        earliest = min([previous + min(map(holdoff, self.configs(kept))), *restarts])
        configured = max((i.tick for i in told if isinstance(i.event, Configured) and i.tick <= tick), default=0)
        of_events = list(chain(*lit.values()))
        starts = {rise for _, rise, _ in of_events}
        before = max(config.frame_period for config in self.configs(kept))
        untold = [
            (rise - before, rise, fall)
            for pin in LAMP_PINS.values()
            for rise, fall in kept.pulses.get(pin, ())
            if rise < tick and rise not in starts
        ]
        since = configured + self.board.round_max  # an edge within the round in which it changed is of before
        return any(fall + (fall - rise) > earliest and edge <= since for edge, rise, fall in of_events + untold)

    def _accepted(self, kept: Kept, taken: list[int]) -> None:
        """Every edge outside the hold-off counts, but those that are told to have been dropped; none within it."""
        holdoffs = [holdoff(config) for config in self.configs(kept)]
        least, most = min(holdoffs), max(holdoffs)
        # Changed twice before any edge came, the one before holds for one edge more.
        first = min([least, *map(holdoff, self.earlier)]) if self.board.name != "native" else least
        accepted = set(taken)
        last: int | None = None
        (_, low), (high, _) = asked_at(kept, kept.first), asked_at(kept, kept.last)
        refused = 0  # beyond a hold-off
        for fall in kept.falls:
            if not low < fall < high or (fall in kept.doubtful and fall not in accepted):
                continue  # by itself, while its controller was asked how many there were
            if fall in accepted:
                insist(
                    last is None or fall in kept.doubtful or fall - last >= (first if last == taken[0] else least) - 20,
                    f"an edge {fall - (last or 0)} ticks after the last counted",
                    fall,
                )
                last = fall
            elif taken and last == taken[0] and self.board.name != "native":
                continue
            elif last is not None:
                refused += fall - last > most + 20
                insist(refused <= kept.dropped, f"an edge {fall - last} ticks after the last was refused", fall)
        room = bool(kept.stalls) and self.board.name == "native"  # the image has it for all that a watchdog lets come
        insist(kept.dropped == 0 or room, f"{kept.dropped} edges dropped, and nothing held the main loop up")


def reloads_flash(asked: Asked) -> bool:
    return isinstance(asked.command, (Arm, Commit))


def reloads(event: Event) -> bool:
    return isinstance(event, Configured) or (isinstance(event, Fault) and event.fault != FaultCode.LATE_LOAD)
