"""The turntable at its pins: every step of every move, where it says that it stands, and what ends it."""

import itertools
import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass

from annulus_pipe.controller import (
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_STEP,
    TICK_HZ,
    TICKS_PER_US,
    TURNTABLE_LAG_MS,
    TURNTABLE_LEAD_MS,
    TURNTABLE_POSITION_MAX_STEPS,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Move,
    StatusCode,
    StopCause,
    Turntable,
    TurntableDone,
    TurntableFlag,
    TurntableStop,
    TurntableStopped,
    TurntableStopReply,
)
from tools.attack.boards import MS, insist
from tools.attack.interlock import is_open
from tools.attack.kept import Asked, Kept, Told
from tools.attack.play import Player
from tools.attack.scenes import Scene

US = TICKS_PER_US
CUT = 250 * US  # from an interlock that opens to the last step
MET = 2  # ticks by which a period may be shorter than asked
UNDER_WAY = 6  # steps beyond the braking distance
AT_ONCE = 3  # steps at a hard switch
LEAD, LAG = TURNTABLE_LEAD_MS * MS, TURNTABLE_LAG_MS * MS
FREE = Turntable(-TURNTABLE_POSITION_MAX_STEPS, TURNTABLE_POSITION_MAX_STEPS, 0, 0, TurntableFlag(0))
END_PINS = ((TurntableFlag.END_LOW, PIN_END_LOW, -1), (TurntableFlag.END_HIGH, PIN_END_HIGH, 1))


@dataclass(slots=True)
class Run:
    """One accepted move."""

    asked: Asked
    config: Turntable
    start: int  # steps, where it stood
    done: Told
    until: int  # tick at which it surely stood
    cause: int  # 0: it arrived
    steps: list[tuple[int, int]]  # tick, +1 or -1
    followed: bool  # by another move of the same scene

    @property
    def move(self) -> Move:
        assert isinstance(self.asked.command, Move)
        return self.asked.command

    @property
    def way(self) -> int:
        return 1 if self.move.position > self.start else -1

    def braking(self) -> int:
        """Steps from the period asked for down to the start of the ramp."""
        if not self.config.acceleration or self.move.period >= self.config.start_period:
            return 0
        fast, slow = TICK_HZ / self.move.period, TICK_HZ / self.config.start_period
        return math.ceil((fast**2 - slow**2) / (2 * self.config.acceleration))

    def fastest(self, steps: int) -> float:
        """The shortest period so many steps from the beginning or the end."""
        if not self.config.acceleration or self.move.period >= self.config.start_period:
            return self.move.period
        speed = math.sqrt((TICK_HZ / self.config.start_period) ** 2 + 2 * self.config.acceleration * steps)
        return max(self.move.period, TICK_HZ / speed)


class Motor:
    """What is known of the turntable across one player's scenes."""

    def __init__(self, player: Player) -> None:
        self.player = player
        self.position = 0
        self.up = False
        self.enable = [(0, 1)]  # transitions since the scene began, and the level before
        self.config = FREE

    def judge(self, kept: Kept, told: list[Told], scene: Scene, latched: list[int], whole: bool, longest: int) -> None:
        """`longest`: ticks of the scene's longest round, in which nothing is looked at."""
        steps = self._steps()
        assert kept.last
        if kept.boots:
            self.position, self.config = kept.last.turntable, FREE
            return
        before, self.position = self.position, self.position + sum(way for _, way in steps)
        insist(
            kept.last.turntable == self.position,
            f"the turntable says {kept.last.turntable}, its steps lead to {self.position}",
        )
        self._refused(kept, scene)
        runs = self._runs(kept, told, steps, before) if whole else []
        slow = longest + sum(end - begin for begin, end in kept.stalls)
        for run in runs:
            self._arrival(run)
            self._pace(run, bool(kept.stalls))
            self._power(run, latched, kept)
            self._ended(run, kept, latched, slow)
            self._cause(run, kept, scene)
            if not kept.stalls:
                self._switches(run, scene, kept.began, longest)

    # ---- from the pins ----

    def _steps(self) -> list[tuple[int, int]]:
        steps = []
        self.enable = self.enable[-1:]
        for tick, pin, level in self.player.motor:
            if pin == PIN_DIRECTION:
                self.up = bool(level)
            elif pin == PIN_ENABLE:
                self.enable.append((tick, level))
            elif pin == PIN_STEP and level:
                on, enable = self.enable[-1]
                insist(enable == 0, "a step without power", tick)
                insist(tick - on >= LEAD, f"a step {(tick - on) / US:.0f} us after the power came", tick)
                steps.append((tick, 1 if self.up else -1))
        self.player.motor.clear()
        return steps

    def _levels(self, low: int, high: int) -> set[int]:
        """Of ENABLE, from one tick to another."""
        at = bisect_right(self.enable, (low, 1)) - 1
        return {level for tick, level in self.enable[max(0, at) :] if tick <= high}

    # ---- what was accepted ----

    def _refused(self, kept: Kept, scene: Scene) -> None:
        """What an open interlock and a reached switch forbid."""
        for asked in kept.asked:
            command, accepted = asked.command, asked.reply and asked.reply.status == StatusCode.OK
            if isinstance(command, Turntable) and accepted:
                self.config = command
            powered = isinstance(command, Arm) and command.outputs & ArmFlag.MICROWAVE
            if accepted and (isinstance(command, Move) or powered):
                closed = not is_open(kept, scene, asked.sent, asked.answered)
                insist(closed, f"{command} accepted, and the interlock was open", asked.sent)
            if isinstance(command, Move) and accepted:
                insist(
                    self.config.lowest <= command.position <= self.config.highest,
                    f"{command} accepted beyond {self.config}",
                    asked.sent,
                )

    def _runs(self, kept: Kept, told: list[Told], steps: list[tuple[int, int]], position: int) -> list[Run]:
        accepted = [
            a for a in kept.asked if isinstance(a.command, Move) and a.reply and a.reply.status == StatusCode.OK
        ]
        dones = [item for item in told if isinstance(item.event, TurntableDone)]
        stops = {i.index + 1: i.event.cause for i in told if isinstance(i.event, TurntableStopped)}
        if any(isinstance(a.command, (Move, Turntable)) and a.reply is None for a in kept.asked):
            return []
        insist(len(accepted) == len(dones), f"{len(accepted)} moves accepted, {len(dones)} ended")
        runs, config, at = [], FREE, 0
        for asked, done in zip(accepted, dones, strict=True):
            for other in kept.asked[: kept.asked.index(asked)]:
                if isinstance(other.command, Turntable) and other.reply and other.reply.status == StatusCode.OK:
                    config = other.command
            until = self._through(done.tick, kept)
            assert isinstance(asked.command, Move) and isinstance(done.event, TurntableDone)
            end = bisect_right(steps, (until, -2))  # a round later the next move may have begun
            for fewer in range(bisect_right(steps, (done.tick, -2)), end):
                if position + sum(way for _, way in steps[at:fewer]) == done.event.position:
                    end = fewer
                    break
            mine, at = steps[at:end], end
            followed = asked is not accepted[-1]
            runs.append(Run(asked, config, position, done, until, stops.get(done.index, 0), mine, followed))
            position += sum(way for _, way in mine)
            insist(done.event.position == position, f"{done.event}: its steps lead to {position}", done.tick)
        insist(at == len(steps), "steps of no move", steps[at][0] if at < len(steps) else 0)
        return runs

    def _through(self, tick: int, kept: Kept) -> int:
        """A round that was under way at a tick is through by then: the main loop may have been held in it."""
        until = tick + self.player.board.round_max
        for begin, end in sorted(kept.stalls):  # one may begin within another
            if tick <= begin <= until:
                until = max(until, end + self.player.board.round_max)
        return until

    # ---- one move ----

    def _arrival(self, run: Run) -> None:
        insist(all(way == run.way for _, way in run.steps), f"{run.move}: a step the wrong way", run.done.tick)
        far = abs(run.move.position - run.start)
        insist(len(run.steps) <= far, f"{run.move} from {run.start}: {len(run.steps)} steps", run.done.tick)
        arrived = len(run.steps) == far
        insist(arrived or run.cause != 0, f"{run.move}: ended after {len(run.steps)} steps of {far}", run.done.tick)

    def _pace(self, run: Run, slow: bool) -> None:
        ticks = [tick for tick, _ in run.steps]
        along_the_ramp = not slow and run.cause != StopCause.FAULT and not run.config.switches & TurntableFlag.END_HARD
        for made, (first, second) in enumerate(itertools.pairwise(ticks), 1):
            steps = made
            if along_the_ramp:
                steps = min(made, len(ticks) - made)
            least = run.fastest(steps + UNDER_WAY)
            insist(
                second - first >= least - MET,
                f"{run.move}, {run.config}: step {made} of {len(ticks)} after {second - first} ticks, due {least:.0f}",
                second,
            )

    def _power(self, run: Run, latched: list[int], kept: Kept) -> None:
        """ENABLE once it stands and from a fault on; and for how long the rotor may swing."""
        first = run.steps[0][0] if run.steps else run.done.tick  # before that it may have waited to be read
        cut = [tick for tick in latched if first < tick <= run.done.tick]
        if run.steps or run.move.hold:
            wanted = 1 if cut or run.cause == StopCause.FAULT else 0
            levels = self._levels(run.done.tick, run.until)
            insist(wanted in levels, f"{run.move}: ENABLE is not {wanted}", run.done.tick)
        last = run.steps[-1][0] if run.steps else run.done.tick
        margin = run.until - run.done.tick
        gone_at = next((tick for tick, level in self.enable if level and tick > last), 1 << 62)
        early = bool(run.steps) and gone_at < last + LAG
        told_by = self._through(gone_at, kept)  # a fault is stamped once all is cut, in that round
        faulty = any(gone_at - margin <= when <= told_by for when in latched)
        insist(not early or faulty, f"{run.move}: the power gone {(gone_at - last) / US:.0f} us after a step", gone_at)
        if not run.move.hold and not run.followed and not kept.stalls:
            gone = self._levels(run.until + LAG + margin, 1 << 62)
            insist(gone == {1}, f"{run.move}: the power stays on", run.done.tick)
        for tick in cut:
            if run.steps and tick > run.steps[0][0]:
                insist(self._levels(tick, tick) == {1}, "ENABLE still low at a latched fault", tick)
                insist(run.steps[-1][0] <= tick, "a step after a latched fault", run.steps[-1][0])

    def _ended(self, run: Run, kept: Kept, latched: list[int], slow: int) -> None:
        """An opened interlock at once, an order along the ramp."""
        if not run.steps:
            return
        first, last = run.steps[0][0], run.steps[-1][0]
        for tick in kept.opened:
            if first <= tick:
                insist(
                    last <= tick + CUT + slow, f"a step {(last - tick) / US:.0f} us after the interlock opened", last
                )
        if run.cause == StopCause.FAULT:
            insist(any(first < tick <= run.until for tick in latched), "cause fault, none told", run.done.tick)
        for asked in kept.asked:
            if not isinstance(asked.command, TurntableStop) or not isinstance(asked.reply, TurntableStopReply):
                continue
            if first < asked.sent and asked.answered < run.done.tick:
                more = abs(run.start + len(run.steps) * run.way - asked.reply.position)
                insist(more <= run.braking() + UNDER_WAY, f"{run.move}: {more} steps after it was told to stop", last)

    def _cause(self, run: Run, kept: Kept, scene: Scene) -> None:
        """Nothing ends a move but what its report names."""
        if run.cause == StopCause.STOPPED:
            orders = [a for a in kept.asked if run.asked.sent <= a.sent <= run.until]
            told_to = any(
                isinstance(a.command, TurntableStop) or (isinstance(a.command, Arm) and not a.command.outputs)
                for a in orders
            )
            insist(told_to, f"{run.move}: stopped, and nobody told it to", run.done.tick)
        for flag, pin, way in END_PINS:
            if run.cause == (StopCause.END_LOW if way < 0 else StopCause.END_HIGH):
                touched = any(
                    which == pin and run.asked.sent <= kept.began + tick <= run.until for tick, which, _ in scene.inputs
                )
                watched = run.way == way and run.config.switches & flag
                insist(bool(touched and watched), f"{run.move}: ended by a switch not touched", run.done.tick)

    def _switches(self, run: Run, scene: Scene, began: int, longest: int) -> None:
        ticks = [tick for tick, _ in run.steps]
        for flag, pin, way in END_PINS:
            if not run.config.switches & flag or run.way != way or not ticks:
                continue
            hard = run.config.switches & TurntableFlag.END_HARD
            most = (AT_ONCE if hard else run.braking() + UNDER_WAY) + longest // run.move.period
            for tick, which, level in scene.inputs:
                tick += began
                if (which, level) == (pin, 1) and ticks[0] <= tick < ticks[-1]:
                    more = len(ticks) - bisect_left(ticks, tick)
                    insist(more <= most, f"{run.move}, {run.config}: {more} steps after its end switch", tick)
