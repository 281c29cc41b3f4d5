"""Microwave gate, digitizer trigger and interlock. A look begins at the trigger, whose own edge the next burst shows;
with the interlock's input jumpered to the gate, the first pulse opens the interlock, and its length is the reaction.
"""

from annulus_pipe.controller import (
    CODES,
    MICROWAVE_DUTY_MAX_PERMILLE,
    MICROWAVE_PULSE_MAX_TICKS,
    PIN_INTERLOCK,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_TRIGGER,
    TICK_HZ,
    TRIGGER_TICKS,
)
from annulus_pipe.link.messages import Arm, ArmFlag, Burst, BurstCode, FaultCode, StateFlag, StatusCode
from annulus_pipe.selftest.promise import Row, judged, not_wired
from annulus_pipe.selftest.scope import BEGIN_TICKS, LOOK_TICKS, OWED_S, Scope, ScopeLook, ScopeTrigger

GROUND_WIRE = "GP7 (pin 10) to ground (pin 13)"
GATE_WIRE = "GP7 (pin 10) to GP5 (pin 7)"
LEAD = 40  # ticks from the trigger to chip 0
CHIP = 30
PULSES = (30, 100, MICROWAVE_PULSE_MAX_TICKS)
SHOWN_CODES = ("mpsl25", "barker13")
OFFSETS = (-40, 0, 60)
REACTION_MAX = 5  # ticks from the interlock's pin to the gate
RESOLUTION = 1
REACTIONS = 50
MICROWAVE_ROWS = (
    ("Microwave pulses", "exact"),
    ("Codes, chip by chip", "on the chip grid, error 0"),
    ("Trigger offset and length", "exact"),
)
REACTION_ROW = ("Interlock opens to microwave low", f"{REACTION_MAX} ticks at most")
ARMING_ROW = ("Interlock open", "microwave cannot be armed")


def interlock_closed(scope: Scope) -> bool:
    return StateFlag.INTERLOCK_OPEN not in scope.status().state


def gate_opens_interlock(scope: Scope) -> bool:
    """Is GP7 wired to GP5? One shortest pulse tells: it is, when the interlock then opens."""
    scope.quiet(OWED_S)
    _fire(scope, "single", CHIP)
    answer = scope.status().fault is FaultCode.INTERLOCK
    scope.disarm()
    return answer


def open_row(scope: Scope) -> Row:
    what, promise = ARMING_ROW
    answer = scope.client.ask(Arm(ArmFlag.MICROWAVE))
    refused = answer is not None and answer.reply.status is StatusCode.UNSAFE
    scope.disarm()
    return judged(what, promise, "refused" if refused else "armed", refused, unit="")


def microwave_rows(scope: Scope) -> list[Row]:
    """With the interlock's input at ground."""
    rows = [_pulse(scope, ticks) for ticks in PULSES]
    rows += [_code(scope, code) for code in SHOWN_CODES]
    rows += [_offset(scope, offset) for offset in OFFSETS]
    return rows


def reaction_row(scope: Scope) -> Row:
    """With the interlock's input at the gate."""
    what, promise = REACTION_ROW
    times: list[int] = []
    latched = 0
    for _ in range(REACTIONS):
        scope.begin(ScopeTrigger(PIN_TRIGGER, 1), PIN_LED)
        _fire(scope, "single", MICROWAVE_PULSE_MAX_TICKS)
        latched += scope.status().fault is FaultCode.INTERLOCK
        taken, _ = scope.taken()
        look = scope.fetch()
        scope.disarm()
        opened, dark = look.rises(PIN_INTERLOCK), look.falls(PIN_MICROWAVE)
        if taken == 0 or len(opened) != 1 or len(dark) != 1:
            return judged(what, promise, "a pulse that was not cut", False)
        times.append(dark[0] - opened[0])
    kept = max(times) <= REACTION_MAX + RESOLUTION and latched == REACTIONS
    text = f"{min(times)} .. {max(times)} ticks, {len(times)} times; fault latched {latched} times"
    return judged(what, promise, text, kept, min(times), max(times), latched)


def unwired_rows(*, gate: bool) -> list[Row]:
    """What the other place of the one wire would have shown."""
    return [not_wired(*row, GROUND_WIRE) for row in MICROWAVE_ROWS] if gate else [not_wired(*REACTION_ROW, GATE_WIRE)]


def _pause(scope: Scope, on_ticks: int) -> None:
    """What the duty limit wants to see dark after so much light, and a little."""
    scope.quiet(1.2 * on_ticks * 1000 / MICROWAVE_DUTY_MAX_PERMILLE / TICK_HZ + 0.001)


def _fire(scope: Scope, code: str, chip: int, offset: int = -LEAD, repeat: int = 1, period: int = 0) -> None:
    """One train from arming to its end; the shortest period if none is said."""
    bits = CODES[code]
    on_ticks = bits.count("1") * chip
    period = period or max(on_ticks * 1000 // MICROWAVE_DUTY_MAX_PERMILLE, len(bits) * chip + 1000, 2 * LOOK_TICKS)
    scope.client.request(Arm(ArmFlag.MICROWAVE))
    if scope.fire(Burst(BurstCode[code.upper()], chip, repeat, period, offset)) is not StatusCode.OK:
        return  # nothing fires, and that is what will be seen
    scope.quiet(repeat * period / TICK_HZ)
    _pause(scope, on_ticks * repeat)


def _look(
    scope: Scope, edge: ScopeTrigger, code: str, chip: int, offset: int = -LEAD, repeat: int = 1, period: int = 0
) -> ScopeLook:
    scope.begin(edge, PIN_LED)
    _fire(scope, code, chip, offset, repeat, period)
    taken, _ = scope.taken()
    look = scope.fetch()
    scope.client.request(Arm(ArmFlag(0)))
    return look if taken else ScopeLook(PIN_LED, 0, (0,))


def _pulse(scope: Scope, ticks: int) -> Row:
    what, promise = f"Microwave pulse {ticks / 100:g} us", f"{ticks} ticks, exact"
    later = max(0, ticks - LOOK_TICKS // 2)
    rises = _look(scope, ScopeTrigger(PIN_TRIGGER, 1), "single", ticks).rises(PIN_MICROWAVE)
    falls = _look(scope, ScopeTrigger(PIN_TRIGGER, 1, later), "single", ticks).falls(PIN_MICROWAVE)
    if len(rises) != 1 or len(falls) != 1:
        return judged(what, promise, f"{len(rises)} pulses seen", False)
    measured = falls[0] - rises[0]
    return judged(what, promise, f"{measured} ticks", abs(measured - ticks) <= RESOLUTION, measured)


def _code(scope: Scope, code: str) -> Row:
    """All of its edges, look by look, against the grid of its chips."""
    bits = CODES[code]
    seen: list[tuple[int, int]] = []
    for delay in range(0, len(bits) * CHIP + LEAD, LOOK_TICKS):
        look = _look(scope, ScopeTrigger(PIN_TRIGGER, 1, delay), code, CHIP)
        levels = [(sample >> (PIN_MICROWAVE - PIN_LED)) & 1 for sample in look.samples]
        before = seen[-1][1] if seen else 0
        if levels[0] != before:
            seen.append((delay + BEGIN_TICKS, levels[0]))
        seen += look.changes(PIN_MICROWAVE)
    expected = [(i * CHIP, int(b)) for i, (a, b) in enumerate(zip("0" + bits, bits + "0", strict=True)) if a != b]
    what, promise = f"Code {code}, chips of {CHIP / 100:g} us", "on the chip grid, error 0"
    if [level for _, level in seen] != [level for _, level in expected]:
        return judged(what, promise, f"{len(seen)} edges, expected {len(expected)}", False)
    errors = [tick - LEAD - grid for (tick, _), (grid, _) in zip(seen, expected, strict=True)]
    kept = max(map(abs, errors)) <= RESOLUTION
    text = f"{len(seen)} edges, error {min(errors)}{'' if min(errors) == max(errors) else f' .. {max(errors)}'}"
    return judged(what, promise, text, kept, min(errors), max(errors))


def _offset(scope: Scope, offset: int) -> Row:
    """The second of two bursts, a period after the first one's trigger has ended."""
    what = f"Trigger {offset:+d} ticks from chip 0, {TRIGGER_TICKS} long"
    period = 20_000
    lead = 100 + max(0, offset)
    edge = ScopeTrigger(PIN_TRIGGER, 0, period - TRIGGER_TICKS - lead)
    look = _look(scope, edge, "single", 100, offset, repeat=2, period=period)
    rises, falls, gate = look.rises(PIN_TRIGGER), look.falls(PIN_TRIGGER), look.rises(PIN_MICROWAVE)
    if not (len(rises) == len(falls) == len(gate) == 1):
        return judged(what, "exact", f"{len(rises)} triggers, {len(gate)} pulses seen", False)
    measured, length = rises[0] - gate[0], falls[0] - rises[0]
    kept = abs(measured - offset) <= RESOLUTION and abs(length - TRIGGER_TICKS) <= RESOLUTION
    return judged(what, "exact", f"{measured:+d} ticks, {length} long", kept, measured, length)
