"""What a promise is, and what several of them do: configure, arm, play a camera."""

import statistics
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from annulus_pipe.controller import PIN_LED, PIN_PROJECTOR, PIN_SYNC
from annulus_pipe.link.messages import Arm, ArmFlag, Command, Commit, Preamble, Reply, Stage, StatusCode
from annulus_pipe.selftest.rig.board import LATENCY, MS, Board, EdgeIn, NotKeptError, Played, expect

LAMPS = (PIN_PROJECTOR, PIN_LED)
SEVERAL = 3
SHORT = 1_000  # ticks: of which two crystals 100 ppm apart make a tenth of one
MEDIAN_OFF = 0.5  # ticks
Check = Callable[[Board], str]  # what was observed; NotKeptError with the same when it is not as promised


@dataclass(frozen=True, slots=True)
class Promise:
    """One line of the table. `pins`: whose jumpers it needs."""

    name: str
    what: str
    expected: str
    unit: str
    pins: tuple[int, ...]
    check: Check


_promises: list[Promise] = []


def promised(what: str, expected: str, *pins: int, unit: str = "ticks") -> Callable[[Check], Check]:
    """Enter a function into the table; in the order in which the modules are imported."""

    def enter(check: Check) -> Check:
        _promises.append(Promise(check.__name__.replace("_", " "), what, expected, unit, pins, check))
        return check

    return enter


def entered() -> tuple[Promise, ...]:
    return tuple(_promises)


def ok(board: Board, *commands: Command) -> Reply:
    """Every one of them carried out; the last one's answer."""
    for command in commands:
        reply = board.request(command)
        if reply.status is not StatusCode.OK:
            raise NotKeptError(f"{type(command).__name__.lower()} refused: {reply.status.name.lower()} {reply.detail}")
    return reply


def configuration(
    *,
    ratio: int = 4,
    period: int = 4_000_000,
    delay: int | None = None,
    width: int | None = None,
    led_width: int | None = None,
    generation: int = 1,
    host_timeout: int = 0,
    tolerance: int = 100,
    readout: int | None = None,
) -> Stage:
    """Everything exposes all the time but during the readout, so the window is wide. Flashes that fit, unless given."""
    delay = min(300_000, period // 8) if delay is None else delay
    width = min(200_000, period // 10) if width is None else width
    return Stage(
        generation=generation,
        ratio=ratio,
        frame_period=period,
        exposure=period,
        readout=period // 5 if readout is None else readout,
        tolerance=tolerance,
        host_timeout=host_timeout,
        projector_delay=delay,
        projector_width=width,
        led_delay=delay,
        led_width=width if led_width is None else led_width,
    )


def configure(board: Board, *, generation: int = 1, **changes: int) -> None:
    """No preambles: a board that was used before may have some."""
    ok(board, configuration(generation=generation, **changes), Commit(generation), Preamble(0, 0, 0))


def arm(board: Board, outputs: ArmFlag = ArmFlag.LAMPS, **changes: int) -> None:
    configure(board, **changes)
    ok(board, Arm(outputs))


def frames(count: int, period: float, jitter: int = 13, first: int = 2 * MS) -> list[float]:
    """Edges one period apart but for a few ticks, so that every phase of the machines meets one."""
    return [first + i * period + (i * 7) % jitter for i in range(count)]


def camera(ticks: Iterable[float], low: int = 3_000) -> list[EdgeIn]:
    return [item for tick in ticks for item in ((tick, PIN_SYNC, 0), (tick + low, PIN_SYNC, 1))]


def lit(played: Played) -> list[tuple[float, int]]:
    """(rise, pin) of either lamp."""
    return sorted((tick, pin) for pin in LAMPS for tick in played.rises(pin))


def span(values: Sequence[float], digits: int = 1) -> str:
    """Least and greatest, or the one there is."""
    if not values:
        return "none"
    low, high = round(min(values), digits), round(max(values), digits)
    return f"{low:g}" if low == high else f"{low:g} .. {high:g}"


def follows(board: Board, rises: Sequence[float], edges: Sequence[float], delay: int) -> str:
    """Each lamp after its edge by the delay and one constant; what is beyond the delay, as observed."""
    expect(len(rises) == len(edges), f"{len(rises)} flashes after {len(edges)} edges")
    beyond = [rise - edge - delay for rise, edge in zip(rises, edges, strict=True)]
    seen = f"delay + {span(beyond)}"
    expect(all(abs(b - LATENCY) <= board.slack(delay) for b in beyond), seen)
    return seen


def all_near(board: Board, values: Sequence[float], expected: float) -> bool:
    """Each within what the board can tell. Of several short times most are exact, however the clocks stand."""
    if len(values) >= SEVERAL and expected <= SHORT and abs(statistics.median(values) - expected) > MEDIAN_OFF:
        return False
    return all(abs(value - expected) <= board.slack(expected) for value in values)
