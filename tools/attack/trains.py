"""Trains at the pins: every pulse and trigger of every burst, to the tick, and as many as `burst_done` says."""

from bisect import bisect_left
from collections.abc import Iterator

from annulus_pipe.controller import CODES, PIN_MICROWAVE, PIN_TRIGGER, TRIGGER_TICKS
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstDone,
    BurstReply,
    BurstStop,
    FaultCode,
    Pattern,
    StatusCode,
)
from tools.attack.boards import insist
from tools.attack.kept import Asked, Kept, Told

Pulse = tuple[int, int]


def trains(kept: Kept, told: list[Told], now: int) -> None:
    started = [a for a in kept.asked if isinstance(a.reply, BurstReply) and a.reply.status == StatusCode.OK]
    ended = [(item.event, item.tick) for item in told if isinstance(item.event, BurstDone)]
    stops = [a.sent for a in kept.asked if isinstance(a.command, BurstStop)]
    insist(len(started) == len(ended), f"{len(started)} trains began, {len(ended)} ended")
    chips, triggers = [*kept.pulses.get(PIN_MICROWAVE, ())], [*kept.pulses.get(PIN_TRIGGER, ())]
    for number, (asked, (end, tick)) in enumerate(zip(started, ended, strict=True)):
        burst = asked.command
        assert isinstance(burst, Burst)
        is_stopped = any(asked.sent <= stop <= tick for stop in stops)
        cut = end.fault != FaultCode.NONE or disarmed_after(kept, asked)
        insist(end.done <= burst.repeat, f"{burst}: {end.done} bursts", tick)
        insist(end.done == burst.repeat or cut or is_stopped, f"{burst}: ended after {end.done}", tick)
        until = now
        if number + 1 < len(started):
            following = started[number + 1]
            until = following.start + min(0, getattr(following.command, "trigger_offset", 0))
        runs = [*runs_of(chips_of(kept, asked))]
        begins = [asked.start + k * burst.period for k in range(end.done + 1)]
        expected = [(begin + a * burst.chip, begin + b * burst.chip) for begin in begins for a, b in runs]
        pulses, chips = split(chips, until)
        match(pulses, expected, end.done * len(runs), cut, f"GP{PIN_MICROWAVE} of {burst}, {end}")
        expected = [(t + burst.trigger_offset, t + burst.trigger_offset + TRIGGER_TICKS) for t in begins]
        pulses, triggers = split(triggers, until)
        match(pulses, expected, end.done, cut, f"GP{PIN_TRIGGER} of {burst}, {end}")
    insist(not chips, "microwave pulses of no train", chips[0][0] if chips else 0)
    insist(not triggers, "triggers of no train", triggers[0][0] if triggers else 0)


def disarmed_after(kept: Kept, burst: Asked) -> bool:
    """Was the microwave disarmed by an order while this train may have run?"""
    later = kept.asked[kept.asked.index(burst) + 1 :]
    return any(isinstance(a.command, Arm) and not a.command.outputs & ArmFlag.MICROWAVE for a in later)


def chips_of(kept: Kept, burst: Asked) -> str:
    assert isinstance(burst.command, Burst)
    if burst.command.code != BurstCode.UPLOADED:
        return list(CODES.values())[burst.command.code - 1]
    patterns = [
        a.command
        for a in kept.asked[: kept.asked.index(burst)]
        if isinstance(a.command, Pattern) and a.reply and a.reply.status == StatusCode.OK
    ]
    bits = int.from_bytes(patterns[-1].chips, "little")
    return "".join("1" if bits >> i & 1 else "0" for i in range(patterns[-1].length))


def runs_of(chips: str) -> Iterator[tuple[int, int]]:
    """First and one past the last chip of each run of on-chips."""
    at = chips.find("1")
    while at >= 0:
        end = chips.find("0", at)
        end = len(chips) if end < 0 else end
        yield at, end
        at = chips.find("1", end)


def split(pulses: list[tuple[int, int]], end: int) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    at = bisect_left(pulses, (end, 0))
    return pulses[:at], pulses[at:]


def match(pulses: list[tuple[int, int]], expected: list[tuple[int, int]], least: int, cut: bool, what: str) -> None:
    """All of `least` pulses, to the tick; more, and a last one cut short, only where the train was cut."""
    for i, (got, want) in enumerate(zip(pulses, expected, strict=False)):
        last_and_cut = cut and i == len(pulses) - 1 and i >= least and got[0] == want[0] and got[1] < want[1]
        insist(got == want or last_and_cut, f"{what}: pulse {i} is {got[0]}..{got[1]}, due was {want[0]}..{want[1]}")
    insist(len(pulses) >= least, f"{what}: {len(pulses)} pulses, due were {least}")
    insist(cut or len(pulses) == least, f"{what}: {len(pulses)} pulses, due were {least}")
    insist(len(pulses) <= len(expected), f"{what}: {len(pulses)} pulses, {len(expected)} at most")
