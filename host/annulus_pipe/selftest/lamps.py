"""Lamps and sync follower. STEP, jumpered to the sync input, plays the camera: a look begins at its rise, half a period
before the falling edge that counts, so that edge and flash stand in one look, seen through the same flip-flops.
"""

import itertools
from typing import TypeVar

from annulus_pipe.controller import (
    LAMP_WIDTH_MAX_TICKS,
    PIN_LED,
    PIN_PROJECTOR,
    PIN_STEP,
    PIN_SYNC,
    TICK_HZ,
    TICKS_PER_US,
)
from annulus_pipe.link.messages import Arm, ArmFlag, Commit, Edge, Fault, FaultCode, Stage, StateFlag, StatusCode
from annulus_pipe.link.session import EventReceived
from annulus_pipe.selftest.promise import Row, judged, not_wired
from annulus_pipe.selftest.scope import LOOK_TICKS, Scope, ScopeLook, ScopeTrigger
from annulus_pipe.vocabulary import Lamp

Told = TypeVar("Told", Edge, Fault)

WIRE = "GP8 (pin 11) to GP2 (pin 4)"
LATENCY = {"rp2040": 9, "native": 0}  # ticks beyond the delay, a constant of the board
RESOLUTION = 1  # ticks: the clock that measures is the one that fires
PERIOD = 200_000  # 500 Hz, the fastest
BEFORE = 100  # ticks from the begin of a look to the falling edge, about
DELAY, WIDTH = 50, 120
WIDTHS = (2, 3, 10, 100, 10_000, 100_000, LAMP_WIDTH_MAX_TICKS)
ORDER_PERIOD = 4_000_000  # so slow that every look is fetched before the next edge
ORDER_EDGES = 11
HOLD_OFF_TICKS = 4  # the edge falls so long before or after its end
HOLD_OFF_STEPS = 40
TOLERANCE = 100  # permille
TIMEOUT_MS = 50
TIMEOUT_SLACK_MS = 1.0
STAMP_SPREAD = 2  # ticks: 0 or +1 at either end of an interval


def lamp_rows(scope: Scope, board: str, edges: int) -> list[Row]:
    """All of them; without the jumper they say so."""
    names = {
        "projector": ("Falling edge of sync to projector on", "delay + {} ticks, jitter 0"),
        "led": ("Falling edge of sync to LED on", "delay + {} ticks, jitter 0"),
    }
    latency = LATENCY.get(board, LATENCY["rp2040"])
    promised = {name: (what, text.format(latency)) for name, (what, text) in names.items()}
    configure(scope, ratio=0)
    scope.begin(_at_fall(PERIOD), PIN_SYNC)
    scope.run_steps(3, PERIOD)
    if scope.taken()[0] == 0:
        return [judged("STEP (GP8) moves", "3 steps", "none seen", False)]
    if not scope.fetch().falls(PIN_SYNC):
        return [not_wired(what, promise, WIRE) for what, promise in promised.values()] + [
            not_wired("Lamp widths", "exact", WIRE),
            not_wired("Order of the lamps", "4 projector, 1 LED", WIRE),
            not_wired("Time stamp of an edge", "0 or +1 tick", WIRE),
            not_wired("Hold-off", "ends within 3 ticks of where it should", WIRE),
            not_wired("Silent host to dark", f"{TIMEOUT_MS} ms", WIRE),
        ]
    scope.heard.clear()
    rows = [_latency(scope, *promised["led"], PIN_LED, latency, edges, ratio=0)]
    rows.append(_stamps(scope))
    rows.append(_latency(scope, *promised["projector"], PIN_PROJECTOR, latency, max(15, edges // 8), ratio=15))
    rows += [_width(scope, width) for width in WIDTHS]
    rows.append(_order(scope))
    rows.append(_hold_off(scope))
    rows += _silence(scope)
    return rows


def configure(
    scope: Scope,
    *,
    ratio: int,
    period: int = PERIOD,
    width: int = WIDTH,
    timeout_ms: int = 0,
    tolerance: int = TOLERANCE,
) -> None:
    """Everything exposes always, so that a flash may begin at once. Both lamps get the same."""
    generation = scope.status().generation % 255 + 1
    scope.client.request(Stage(generation, ratio, period, period, 0, tolerance, timeout_ms, DELAY, width, DELAY, width))
    scope.client.request(Commit(generation))


def _at_fall(period: int, later: int = 0) -> ScopeTrigger:
    return ScopeTrigger(PIN_STEP, 1, period // 2 - BEFORE + later)


def _delay_of(look: ScopeLook, pin: int) -> int | None:
    """Falling edge to lamp on, less the delay that was asked for; None: no flash in this look."""
    falls, rises = look.falls(PIN_SYNC), look.rises(pin)
    return rises[0] - falls[0] - DELAY if falls and rises else None


def _latency(scope: Scope, what: str, promise: str, pin: int, latency: int, edges: int, *, ratio: int) -> Row:
    configure(scope, ratio=ratio)
    scope.begin(_at_fall(PERIOD), PIN_SYNC)  # before arming
    scope.client.request(Arm(ArmFlag.LAMPS))
    spare = edges // 2 + 200  # edges that pass while looks are fetched
    scope.steps(edges + spare, PERIOD)
    seen = scope.alike(_at_fall(PERIOD), PIN_SYNC, edges)
    scope.disarm()
    scope.stand((edges + spare) * PERIOD / TICK_HZ + 1.0)
    delays = [(delay, count) for look, count in seen if (delay := _delay_of(look, pin)) is not None]
    looks = sum(count for _, count in seen)
    if not delays:
        return judged(what, promise, f"no flash in {looks} edges", False)
    lowest, highest = min(d for d, _ in delays), max(d for d, _ in delays)
    flashes = sum(count for _, count in delays)
    others = {lamp for look, _ in seen for lamp in (PIN_PROJECTOR, PIN_LED) if look.rises(lamp)} - {pin}
    kept = lowest >= latency - RESOLUTION and highest <= latency + RESOLUTION and highest - lowest <= RESOLUTION
    kept = kept and (ratio > 0 or (flashes == looks and not others))
    measured = f"delay + {lowest}{'' if lowest == highest else f' .. {highest}'} ticks, jitter {highest - lowest}"
    return judged(what, promise, f"{measured}, {flashes} flashes", kept, lowest, highest, flashes)


def _stamps(scope: Scope) -> Row:
    """Of the edges just heard: the intervals between stamps against one another."""
    ticks = [e.tick for e in _events(scope, Edge)]
    gaps = [(b - a) % 2**32 for a, b in itertools.pairwise(ticks)]
    gaps = [gap for gap in gaps if gap < 3 * PERIOD // 2]  # one event lost is no edge late
    what, promise = "Time stamp of an edge", "0 or +1 tick"
    if len(gaps) < 2:
        return judged(what, promise, f"{len(ticks)} edges told of", False)
    spread = max(gaps) - min(gaps)
    text = f"intervals {min(gaps)} .. {max(gaps)} ticks, {len(gaps)} of them"
    kept = spread <= STAMP_SPREAD and abs(min(gaps) - PERIOD) <= STAMP_SPREAD + RESOLUTION
    return judged(what, promise, text, kept, min(gaps), max(gaps), len(gaps))


def _width(scope: Scope, width: int) -> Row:
    """Short ones in one look; for the others one at their begin and one at their end."""
    what, promise = f"Lamp width {_time(width)}", f"{width} ticks, exact"
    period = max(PERIOD, 2 * width + width // 4)
    configure(scope, ratio=0, period=period, width=width)
    later = 0 if width < LOOK_TICKS // 4 else width
    looks = []
    for edge in (_at_fall(period), _at_fall(period, later)):
        scope.begin(edge, PIN_SYNC)
        scope.client.request(Arm(ArmFlag.LAMPS))
        scope.steps(2, period)
        scope.wait(4 * period / TICK_HZ + 1.0)
        looks.append(scope.fetch())
        scope.stand(4 * period / TICK_HZ + 1.0)
        scope.disarm()
    rises, falls = looks[0].rises(PIN_LED), looks[1].falls(PIN_LED)
    if not rises or not falls:
        return judged(what, promise, "no edge where it should be", False)
    measured = falls[0] - rises[0]
    return judged(what, promise, f"{measured} ticks", abs(measured - width) <= RESOLUTION, measured)


def _order(scope: Scope) -> Row:
    configure(scope, ratio=4, period=ORDER_PERIOD)
    edge = _at_fall(ORDER_PERIOD)
    scope.begin(edge, PIN_SYNC)
    scope.client.request(Arm(ArmFlag.LAMPS))
    scope.heard.clear()
    scope.steps(ORDER_EDGES, ORDER_PERIOD)
    seen = ""
    for i in range(ORDER_EDGES):
        if i > 0:
            scope.begin(edge, PIN_SYNC)
        if scope.wait()[0] == 0:
            break
        look = scope.fetch()
        seen += {(1, 0): "P", (0, 1): "L", (0, 0): "-"}.get(
            (len(look.rises(PIN_PROJECTOR)), len(look.rises(PIN_LED))), "?"
        )
    scope.disarm()
    scope.stand(ORDER_EDGES * ORDER_PERIOD / TICK_HZ + 1.0)
    letters = {Lamp.PROJECTOR: "P", Lamp.LED: "L", Lamp.DARK: "-"}
    reported = "".join(letters[e.lamp] for e in _events(scope, Edge))[: len(seen)]
    expected = ("PPPPL" * 3)[:ORDER_EDGES]
    remark = "" if reported == seen else f"; told {reported}"
    return judged(
        "Order of the lamps", "4 projector, 1 LED", f"{seen}{remark}", seen == expected and reported == seen, unit=""
    )


def _hold_off(scope: Scope) -> Row:
    """Edges that come just after its end count, those just before are refused."""
    refused = []
    for end in (PERIOD - HOLD_OFF_TICKS, PERIOD + HOLD_OFF_TICKS):
        period = end * 1000 // (1000 - TOLERANCE)
        period += next(i for i in range(-3, 4) if period + i - (period + i) * TOLERANCE // 1000 == end)
        configure(scope, ratio=0, period=period)
        for _ in range(3):  # it takes force with an edge, or the next: what was set before it may hold for one
            scope.run_steps(1, PERIOD)
            scope.quiet(ORDER_PERIOD / TICK_HZ)
        before = scope.status().rejected
        scope.run_steps(HOLD_OFF_STEPS, PERIOD)
        refused.append(scope.status().rejected - before)
    kept = refused[0] == 0 and abs(refused[1] - HOLD_OFF_STEPS // 2) <= 1
    text = (
        f"{refused[0]} of {HOLD_OFF_STEPS} edges refused {HOLD_OFF_TICKS} ticks after its end,"
        f" {refused[1]} in turn {HOLD_OFF_TICKS} ticks before it"
    )
    return judged("Hold-off", "ends within 3 ticks of where it should", text, kept, *refused, unit="edges")


def _silence(scope: Scope) -> list[Row]:
    configure(scope, ratio=0, timeout_ms=TIMEOUT_MS)
    scope.heard.clear()
    scope.steps(80, PERIOD)
    scope.client.request(Arm(ArmFlag.LAMPS))
    scope.quiet(0.12)
    faults = [e for e in _events(scope, Fault) if e.fault is FaultCode.HOST_TIMEOUT]
    edges = _events(scope, Edge)
    what, promise = "Silent host to dark", f"{TIMEOUT_MS} ms, then nothing lights or moves"
    moves = StateFlag.TURNTABLE_MOVING in scope.status().state
    answer = scope.client.ask(Arm(ArmFlag.LAMPS))
    refused = answer is not None and answer.reply.status is StatusCode.UNSAFE
    scope.disarm()
    scope.stand(1.0)
    if len(faults) != 1:
        return [judged(what, promise, f"{len(faults)} faults host_timeout", False)]
    silent_ms = faults[0].detail / TICKS_PER_US / 1000
    after = [e for e in edges if (e.tick - faults[0].tick) % 2**32 < 2**31]
    lit = sum(e.lamp is not Lamp.DARK for e in after)
    kept = TIMEOUT_MS <= silent_ms <= TIMEOUT_MS + TIMEOUT_SLACK_MS and lit == 0 and not moves
    text = f"{silent_ms:.2f} ms, {lit} flashes after it, the turntable {'moves' if moves else 'stands'}"
    return [
        judged(what, promise, text, kept, silent_ms, lit, unit="ms"),
        judged(
            "Latched fault",
            "nothing is armed before it is cleared",
            "refused" if refused else "armed",
            refused,
            unit="",
        ),
    ]


def _events(scope: Scope, kind: type[Told]) -> list[Told]:
    return [h.event for h in scope.heard if isinstance(h, EventReceived) and isinstance(h.event, kind)]


def _time(ticks: int) -> str:
    us = ticks / TICKS_PER_US
    return f"{us / 1000:g} ms" if us >= 1000 else f"{us:g} us" if us >= 1 else f"{us * 1000:g} ns"
