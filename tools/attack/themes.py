"""Scenes that chance alone makes too rarely: a host that falls silent, single bursts one upon another, a turntable."""

import random
from dataclasses import replace

from annulus_pipe.controller import (
    MICROWAVE_PULSE_MAX_TICKS,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_INTERLOCK,
    TICKS_PER_US,
    TURNTABLE_PERIOD_MIN_TICKS,
    TURNTABLE_POSITION_MAX_STEPS,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    Clear,
    Move,
    Turntable,
    TurntableFlag,
    TurntableStop,
)
from tools.attack.boards import MS, Edge

US = TICKS_PER_US
FARTHEST = 300  # steps from where it stood at reset, so that a scene's moves end with it
Sent = list[tuple[int, str, int, object]]


def silence(rng: random.Random, actions: Sent, timeout: int, end: int) -> Sent:
    """The host says nothing for a while, mostly for longer than it may; then it is back, or not."""
    length = int(timeout * rng.choice((0.5, 1.5, 3, rng.uniform(0.9, 1.3))))
    begin = rng.randrange(max(1, end - timeout))
    until = end if rng.random() < 0.3 else begin + length
    return [action for action in actions if action[1] != "send" or not begin <= action[0] < until]


def bursts(rng: random.Random, line: int, end: int) -> Sent:
    """Single bursts at the limit of duty, each as soon as the one before can have ended."""
    at = rng.randrange(end)
    chip = rng.choice((MICROWAVE_PULSE_MAX_TICKS, MICROWAVE_PULSE_MAX_TICKS // 3))
    burst = Burst(code=BurstCode.SINGLE, chip=chip, repeat=1, period=chip * 20, trigger_offset=0)
    gap = rng.choice((181 * US, 300 * US, 620 * US))
    actions: Sent = []
    for _ in range(rng.randrange(10, 40)):
        actions.append((at, "send", line, burst))
        at += gap + rng.randrange(10 * US)
    return [action for action in actions if action[0] < end]


def turntable(rng: random.Random) -> Turntable:
    start = rng.choice((0, 20_000, 50_000, 200_000))
    return Turntable(
        lowest=rng.choice((-TURNTABLE_POSITION_MAX_STEPS, -FARTHEST, -100)),
        highest=rng.choice((TURNTABLE_POSITION_MAX_STEPS, FARTHEST, 100)),
        acceleration=rng.choice((0, 40_000, 200_000, 1_000_000)) if start else 0,
        start_period=start,
        switches=TurntableFlag(rng.randrange(8)),
    )


def moves(rng: random.Random, line: int, end: int, outputs: ArmFlag, inputs: list[Edge]) -> Sent:
    """There and back, and what ends it on the way; adds what the switches and the interlock do to `inputs`."""
    actions: Sent = []
    closed = {pin: 0 for pin in (PIN_END_LOW, PIN_END_HIGH)}
    may_open = all(pin != PIN_INTERLOCK for _, pin, _ in inputs)
    at = rng.randrange(10 * MS)
    while at < end and len(actions) < 40:
        period = rng.choice((TURNTABLE_PERIOD_MIN_TICKS, rng.randrange(TURNTABLE_PERIOD_MIN_TICKS, 60_000)))
        position = rng.choice((-FARTHEST, FARTHEST, rng.randrange(-FARTHEST, FARTHEST)))
        actions.append((at, "send", line, Move(position=position, period=period, hold=rng.randrange(2))))
        on_the_way = at + rng.randrange(300 * US, 40 * MS)
        what = rng.random()
        if what < 0.2:
            actions.append((on_the_way, "send", line, TurntableStop()))
        elif what < 0.5:
            pin = rng.choice((PIN_END_LOW, PIN_END_HIGH))
            begin = max(on_the_way, closed[pin])
            closed[pin] = begin + rng.choice((50, 10 * US, MS, 30 * MS)) + rng.randrange(US)
            inputs += [(begin, pin, 1), (closed[pin], pin, 0)]
            closed[pin] += US
        elif what < 0.65 and may_open:
            may_open = rng.random() < 0.5
            shut = on_the_way + rng.choice((50, MS, 10 * MS))
            inputs += [(on_the_way, PIN_INTERLOCK, 1), (shut, PIN_INTERLOCK, 0)]
            again = Move(position=-position, period=period, hold=0)
            actions += [(on_the_way + MS // 2, "send", line, again), (shut + MS, "send", line, Clear())]
            actions.append((shut + 2 * MS, "send", line, Arm(outputs=outputs)))
            on_the_way = shut + 3 * MS
        elif what < 0.75:
            actions.append((on_the_way, "send", line, Arm(outputs=ArmFlag(0))))
            actions.append((on_the_way + 5 * MS, "send", line, Arm(outputs=outputs)))
        elif what < 0.85:
            actions.append((on_the_way, "send", line, replace(turntable(rng), lowest=-FARTHEST, highest=FARTHEST)))
        at = on_the_way + rng.randrange(5 * MS, 60 * MS)
    return actions
