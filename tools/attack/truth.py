"""What must hold, whatever was done: protocol/README.md and firmware/README.md, judged by pins, events and answers.

Knows nothing of how the firmware does it. Every check raises BrokenPromiseError with the tick it is about.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable

from annulus_pipe.link.messages import (
    EVENT_RING,
    Arm,
    ArmFlag,
    Burst,
    Edge,
    Fault,
    FaultCode,
    Reread,
    RereadReply,
    Reset,
    StatusCode,
    SyncLost,
)
from annulus_pipe.vocabulary import EdgeFlag
from tools.attack import interlock, products_truth, updates
from tools.attack.boards import MS, Board, BrokenPromiseError, insist
from tools.attack.edges import Edges, asked_at
from tools.attack.kept import Asked, Kept, Told, accepted
from tools.attack.limits import Limits
from tools.attack.motor import Motor
from tools.attack.odometer import odometer
from tools.attack.play import Player
from tools.attack.scenes import Scene
from tools.attack.silence import silence, unplugged
from tools.attack.trains import trains

US = MS // 1000
WATCHDOG = 100 * MS
STALLED = 2 * MS  # a round after the main loop stood still: within the guard's credit


class Truth:
    """Judges one player's scenes one after another; limits over time go on across them."""

    def __init__(self, player: Player) -> None:
        self.player = player
        self.board: Board = player.board
        self.limits = Limits(player)
        self.motor = Motor(player)
        self.edges = Edges(player)
        self.longest = 0  # ticks a round took
        self.round = 0  # and of the scene's rounds the longest

    def judge(self, scene: Scene) -> list[str]:
        """What was broken, each check's first."""
        kept = self.player.kept
        checks: list[Callable[[], None]] = [
            lambda: self.limits.judge(kept),
            lambda: self._interlock(kept, scene),
            lambda: self._boots(kept, scene),
            lambda: updates.judge(kept, self.board.name),
            lambda: unplugged(kept, scene.line, self.board),
            lambda: self._answers(kept),
            self._round,
        ]
        if kept.boots == 0:
            first, (made, _) = self._first(kept), self._count(kept)
            told = [kept.told[index] for index in sorted(kept.told) if first <= index < first + made]
            whole = self._is_whole(kept)
            checks += [
                lambda: self._sequence(kept),
                lambda: self._armed(kept, told),
                lambda: silence(
                    kept, told, scene.line, self.edges.configs(kept), self._latched(kept, told), self.board
                ),
                lambda: self.motor.judge(
                    kept, told, scene, [i.tick for i in told if products_truth.is_latching(i.event)], whole, self.round
                ),
                lambda: self._faults(kept, told),
                lambda: self.edges.judge(kept, told, scene, whole),
                lambda: self._sync(told, kept),
                lambda: trains(kept, told, self.board.now) if whole and self._knows_trains(kept) else None,
                lambda: self._counters(kept, told, whole),
                lambda: self._odometer(kept, told, scene, whole),
                lambda: products_truth.camera_trigger(kept, told_edges(told) if whole else None),
                lambda: products_truth.first_fault_stays(kept, told) if whole else None,
                lambda: interlock.says(kept, told, scene) if whole else None,
                lambda: interlock.disagrees(kept, told, scene, self.board) if whole else None,
                lambda: self._rereads(kept),
            ]
        else:
            self.edges.slots.lost()
            both = [*kept.before, *(kept.told[index] for index in sorted(kept.told))]
            checks.append(lambda: self._armed(kept, both))
            checks.append(lambda: self.motor.judge(kept, [], scene, [], whole=False, longest=0))
        broken = []
        for check in checks:
            try:
                check()
            except BrokenPromiseError as error:
                broken.append(str(error))
        return broken

    def _round(self) -> None:
        self.round, self.board.longest = self.board.longest, 0
        self.longest = max(self.longest, self.round)
        most = STALLED if self.player.kept.stalls else self.board.round_max  # then it has all that came meanwhile to do
        insist(self.round <= most, f"a round of the main loop took {self.round / US:.0f} us, budget {most / US:.0f}")

    # ---- at the pins alone ----

    def _interlock(self, kept: Kept, scene: Scene) -> None:
        slow = self.board.round_max + sum(end - begin for begin, end in kept.stalls)
        interlock.cuts(kept, scene, slow)

    def _odometer(self, kept: Kept, told: list[Told], scene: Scene, whole: bool) -> None:
        if products_truth.measured(kept):
            assert kept.first
            products_truth.frozen_odometer(kept, told, scene, kept.first.odometer, kept.lost)
        else:
            later = [item for item in told if isinstance(item.event, Edge)][1:]  # the first may be one after a scene's
            frozen = any(products_truth.is_frozen(item.event) for item in later)
            insist(bool(kept.stalls) or not frozen, "odometer_frozen, and nobody measured")
            odometer(kept, told, scene, whole)

    # ---- what was answered ----

    def _boots(self, kept: Kept, scene: Scene) -> None:
        stalled = any(end - begin > WATCHDOG - 5 * MS for begin, end in kept.stalls)
        resets = [a for a in kept.asked if isinstance(a.command, Reset) or updates.leaves(a)]
        insist(kept.boots <= max(1, len(resets)) or stalled, f"the controller began anew {kept.boots} times")
        if resets:
            insist(kept.boots > 0 or not accepted(resets[0]), "told to reset, and did not")
            return
        insist(kept.boots == 0 or stalled, "the controller began anew, and nobody held its main loop for 100 ms")

    def _answers(self, kept: Kept) -> None:
        for asked in kept.asked:
            if self.player.level < asked.command.SINCE:
                continue  # an older controller need not know it
            excused = kept.boots or kept.unplugged or asked.line in kept.noise
            held = any(self._may_be_cut(kept, asked, end) for _, end in kept.stalls)
            insist(bool(asked.reply) or bool(excused) or held, f"no answer to {asked.command} sent at {asked.sent}")

    @staticmethod
    def _may_be_cut(kept: Kept, asked: Asked, end: int) -> bool:
        """The line's buffer ran over while the main loop stood still: what came then is lost, and with it, where that
        was the end of a frame, the one that follows it on the line."""
        later = [other.sent for other in kept.asked if other.line == asked.line and other.sent > end]
        return asked.sent < end + 50 * MS or (bool(later) and asked.sent == min(later))

    def _first(self, kept: Kept) -> int:
        """Index of the scene's first event."""
        assert kept.first
        newest = self.player.next_index
        return newest - ((newest - kept.first.events) & 0xFFFF)

    def _count(self, kept: Kept) -> tuple[int, int]:
        """Events made in the scene, and those of them that are here."""
        assert kept.first
        assert kept.last
        made = (kept.last.events - kept.first.events) & 0xFFFF
        return made, sum(index >= self._first(kept) for index in kept.told)

    def _is_whole(self, kept: Kept) -> bool:
        made, here = self._count(kept)
        return here >= made

    def _knows_trains(self, kept: Kept) -> bool:
        """A pulled plug takes answers with it, and with them when a train began."""
        return not kept.unplugged or all(a.reply for a in kept.asked if isinstance(a.command, Burst))

    def _sequence(self, kept: Kept) -> None:
        """Those that are not here must be counted, or a line was pulled."""
        assert kept.first
        assert kept.last
        made, here = self._count(kept)
        lost = (kept.last.overruns - kept.first.overruns) & 0xFFFF
        excused = lost + (made if kept.unplugged else 0)
        insist(here >= made - excused - 1, f"{made} events were made, {here} told, {lost} counted as overrun")

    # ---- when something may be lit ----

    def _armed(self, kept: Kept, told: list[Told]) -> None:
        arms = [
            (asked, asked.command.outputs if isinstance(asked.command, Arm) else ArmFlag(0))
            for asked in kept.asked
            if isinstance(asked.command, Arm | Reset)
        ]
        ends = [(item.tick, item.tick) for item in told if products_truth.is_latching(item.event)]

        def permitted(tick: int, output: ArmFlag) -> bool:
            for order, (asked, outputs) in enumerate(arms):
                if not outputs & output or asked.sent > tick:
                    continue
                if asked.reply and asked.reply.status != StatusCode.OK:
                    continue
                darkened = any(
                    later.answered < tick and not what & output
                    for later, what in arms[order + 1 :]
                    if later.reply and later.reply.status == StatusCode.OK
                )
                latched = any(asked.answered <= low and high < tick - US for low, high in ends)
                if not darkened and not latched:
                    return True
            return False

        for pin, output in ((3, ArmFlag.LAMPS), (4, ArmFlag.LAMPS), (5, ArmFlag.MICROWAVE), (6, ArmFlag.MICROWAVE)):
            for rise, _ in kept.pulses.get(pin, ()):
                insist(permitted(rise, output), f"GP{pin} rose, but nobody had it armed", rise)

    def _faults(self, kept: Kept, told: list[Told]) -> None:
        slow = sum(end - begin for begin, end in kept.stalls)
        for item in told:
            if not isinstance(item.event, Fault):
                continue
            match item.event.fault:
                case FaultCode.INTERLOCK:
                    insist(
                        any(tick <= item.tick for tick in kept.opened),
                        "fault interlock, which nobody opened",
                        item.tick,
                    )
                case FaultCode.WATCHDOG:
                    insist(slow > MS, "fault watchdog, and nobody held the main loop", item.tick)
        latched = self._latched(kept, told)
        for tick in kept.opened:
            disarmed = any(isinstance(a.command, Arm) and tick < a.sent <= tick + slow for a in kept.asked)
            if disarmed or not self._surely_armed(kept, tick, latched):
                continue
            insist(
                any(tick - US <= when <= tick + slow + 10 * MS for when in latched),
                "the interlock opened on an armed controller, which latched nothing",
                tick,
            )

    def _latched(self, kept: Kept, told: list[Told]) -> list[int]:
        return [*kept.unplugged, *(item.tick for item in told if products_truth.is_latching(item.event))]

    def _surely_armed(self, kept: Kept, tick: int, latched: list[int]) -> bool:
        before = [a for a in kept.asked if isinstance(a.command, Arm) and a.sent < tick]
        if not before or not before[-1].reply or before[-1].answered >= tick:
            return False
        last = before[-1].reply
        if any(isinstance(a.command, Arm) and a.sent < tick <= a.answered for a in kept.asked):
            return False
        return bool(getattr(last, "outputs", 0)) and not any(before[-1].sent <= when <= tick for when in latched)

    # ---- the camera ----

    def _sync(self, told: list[Told], kept: Kept) -> None:
        at_edge = {item.event.edge: item.tick for item in told if isinstance(item.event, Edge)}
        periods = [c.frame_period for c in self.edges.configs(kept)]
        slow = sum(end - begin for begin, end in kept.stalls)
        for item in told:
            if isinstance(item.event, SyncLost) and item.event.last_edge in at_edge:
                silent = item.tick - at_edge[item.event.last_edge]
                insist(silent >= 2.5 * min(periods) - US, f"sync_lost {silent / US:.1f} us after an edge", item.tick)
                insist(
                    silent <= 3 * max(periods) + slow, f"sync_lost only {silent / MS:.1f} ms after an edge", item.tick
                )

    # ---- counters ----

    def _counters(self, kept: Kept, told: list[Told], whole: bool) -> None:
        first, last = kept.first, kept.last
        assert first
        assert last
        accepted, refused = last.edges - first.edges, last.rejected - first.rejected
        counts = self.board.name == "native" or not kept.stalls  # the emulator's stall holds interrupts up as well
        (least, early), (late, most) = asked_at(kept, first), asked_at(kept, last)
        sure = bisect_right(kept.falls, late) - bisect_left(kept.falls, early) - len(kept.doubtful)
        most = bisect_right(kept.falls, most) - bisect_left(kept.falls, least)
        insist(
            sure <= accepted + refused <= most or not counts,
            f"{len(kept.falls)} edges fell, {accepted} counted and {refused} refused",
        )
        if whole:
            edges = [item.event for item in told if isinstance(item.event, Edge)]
            insist(len(edges) == accepted, f"{accepted} edges counted, {len(edges)} told")
            flags = sum(bool(edge.flags & EdgeFlag.LATE_LOAD) for edge in edges)
            insist(flags == last.late - first.late, f"{flags} late flashes told, {last.late - first.late} counted")
        if not kept.noise and not kept.unplugged and not kept.stalls:
            insist(
                last.bad_frames == first.bad_frames, f"{last.bad_frames - first.bad_frames} bad frames, none was sent"
            )

    def _rereads(self, kept: Kept) -> None:
        """As many as promised came, each after it was promised."""
        if kept.unplugged:
            return
        promised: dict[int, list[int]] = {}
        newest = self.player.next_index
        for asked in kept.asked:
            if (
                isinstance(asked.command, Reread)
                and isinstance(asked.reply, RereadReply)
                and asked.line == self.player.line
            ):
                for i in range(asked.reply.count if asked.reply.status == StatusCode.OK else 0):
                    index = newest - ((newest - asked.reply.first - i) & 0xFFFF)
                    promised.setdefault(index, []).append(asked.sent)
        for index, when in promised.items():
            if newest - index > EVENT_RING:
                continue  # may have left the ring since it was promised
            came = [tick for tick in kept.times_told.get(index, ()) if tick >= when[0]]
            insist(
                len(came) >= len(when),
                f"event {index} was promised {len(when)} times by reread and came {len(came)} times",
            )


def told_edges(told: list[Told]) -> list[int]:
    return [item.tick for item in told if isinstance(item.event, Edge)]
