"""Promises of what a head's wiring may choose: pins upside down, triggered cameras, an interlock of two inputs."""

import itertools
import random

from annulus_pipe.controller import (
    INTERLOCK_DISAGREE_MS,
    PIN_CAMERA_TRIGGER,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_SYNC,
    PIN_TRIGGER,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    CameraTrigger,
    Clear,
    Commit,
    Edge,
    Fault,
    FaultCode,
    Interlock,
    InterlockFlag,
    InterlockReply,
    Polarity,
    PolarityFlag,
    Preamble,
    StatusCode,
)
from annulus_pipe.selftest.rig.board import MS, Board, EdgeIn, Played, Scene, expect
from annulus_pipe.selftest.rig.lamps import rejected
from annulus_pipe.selftest.rig.microwave import BOTH, CUT_TICKS, TRIGGER_TICKS, fire
from annulus_pipe.selftest.rig.motion import ROUND
from annulus_pipe.selftest.rig.promises import (
    LAMPS,
    all_near,
    arm,
    camera,
    configuration,
    configure,
    follows,
    frames,
    lit,
    ok,
    promised,
    span,
)

LATE = 60  # ticks of an edge to the trigger it begins, beyond its delay
TURNED_LAMPS = PolarityFlag.SYNC | PolarityFlag.PROJECTOR | PolarityFlag.LED
TURNED_BURST = PolarityFlag.MICROWAVE | PolarityFlag.TRIGGER
NONE = PolarityFlag(0)
CLOCK, EXPOSED = 250_000, 60_011  # of a triggered camera; odd, so that no multiple of a count hides a tick
FLASHES = {"period": CLOCK, "delay": 1_000, "width": 30_000, "tolerance": 5, "readout": 0}  # that fit between two
ON, PERIOD = 3_000, 60_000  # of a train that is cut in a pulse
CUTS = ((PIN_INTERLOCK, 1, 8), (PIN_INTERLOCK_ANTIVALENT, 0, 19))  # unsafe level, and ticks to dark: firmware/README.md
OPENINGS = 6
DISAGREED = (INTERLOCK_DISAGREE_MS + 2) * MS


def wired(board: Board, inverted: PolarityFlag, *, trigger: int = 0, begins: int = 0, **timing: int) -> None:
    """Such a head's configuration, in force."""
    stage = configuration(**timing)
    ok(board, stage, Polarity(1, inverted), CameraTrigger(1, trigger, begins), Commit(1), Preamble(0, 0, 0))


def low_pulses(played: Played, pin: int) -> list[tuple[float, float]]:
    """(fall, width) of every whole one, of an output that is lit at low."""
    changes = [(tick, level) for tick, p, level in played.transitions if p == pin]
    return [(t, u - t) for (t, level), (u, _) in itertools.pairwise(changes) if not level]


def faults(played: Played) -> list[FaultCode]:
    return [fault.fault for fault in played.heard(Fault)]


# ---- upside down ----


@promised("Lamps and sync upside down", "delay + 9, dark is high", PIN_SYNC, *LAMPS)
def lamps_upside_down_follow_an_edge_that_rises(board: Board) -> str:
    delay, width, frame = 70_000, 30_000, 1_000_000
    board.play(Scene(until=5 * MS, edges=[(MS, PIN_SYNC, 0)]))  # at rest, from here on
    wired(board, TURNED_LAMPS, ratio=1, period=frame, delay=delay, width=width)
    ok(board, Arm(ArmFlag.LAMPS))
    edges = frames(8, frame)
    rising = [item for tick in edges for item in ((tick, PIN_SYNC, 1), (tick + 3_000, PIN_SYNC, 0))]
    played = board.play(Scene(until=int(edges[-1]) + frame, edges=rising, watch=LAMPS))
    flashes = sorted((*pulse, pin) for pin in LAMPS for pulse in low_pulses(played, pin))
    rose = [tick for tick, _, level in played.edges if level]
    seen = follows(board, [tick for tick, _, _ in flashes], rose, delay)
    expect(all_near(board, [w for _, w, _ in flashes], width), f"{seen}; widths {span([w for _, w, _ in flashes])}")
    expect([pin for _, _, pin in flashes] == [*LAMPS] * 4, f"{seen}; lamps out of order")
    expect(len(played.transitions) == 2 * len(flashes), f"{seen}; lit between them")
    return f"{seen}, {len(edges)} edges"


@promised("A burst upside down, and the interlock in a pulse", "as written; 5 at most", PIN_INTERLOCK, *BOTH)
def a_burst_upside_down_is_played_and_cut_alike(board: Board) -> str:
    wired(board, TURNED_BURST)
    ok(board, Arm(ArmFlag.MICROWAVE))
    played = fire(board, Burst(BurstCode.BARKER13, chip=50, repeat=2, period=100_000, trigger_offset=0))
    widths = [width for _, width in low_pulses(played, PIN_MICROWAVE)]
    runs = [250, 100, 50, 50] * 2
    as_written = len(widths) == len(runs) and all(all_near(board, [w], r) for w, r in zip(widths, runs, strict=True))
    expect(as_written, f"chips of {span(widths)}")
    triggers = [width for _, width in low_pulses(played, PIN_TRIGGER)]
    expect(len(triggers) == 2 and all_near(board, triggers, TRIGGER_TICKS), f"triggers {span(triggers)}")
    ok(board, Burst(BurstCode.SINGLE, chip=ON, repeat=60_000, period=PERIOD, trigger_offset=0))
    opens = PERIOD - ON // 2  # it rises as a pulse ends
    edges = [(opens, PIN_INTERLOCK, 1), (opens + 100, PIN_INTERLOCK, 0)]
    played = board.play(Scene(until=3 * MS, edges=edges, watch=BOTH, cue=PIN_MICROWAVE))
    took = _cut(board, played, PIN_INTERLOCK, 1)
    expect(took <= CUT_TICKS + board.slack(), f"high {took:.1f} after it opened")
    return f"as written; {took:.1f} after it opened"


def _cut(board: Board, played: Played, pin: int, dark: int) -> float:
    """Ticks from this input's opening to the gate's one change after it, which is to dark."""
    opened = next(tick for tick, p, _ in played.edges if p == pin)
    after = [(tick - opened, level) for tick, p, level in played.transitions if p == PIN_MICROWAVE and tick > opened]
    expect([level for _, level in after] == [dark], f"{len(after)} changes after it opened in a pulse")
    expect(faults(played) == [FaultCode.INTERLOCK], f"faults {faults(played)}")
    expect(board.request(Arm(ArmFlag.MICROWAVE)).status is StatusCode.UNSAFE, "armed again without a clear")
    ok(board, Clear())
    return after[0][0]


@promised("Pins turned over while anything is armed", "refused", unit="")
def no_pin_is_turned_over_while_anything_is_armed(board: Board) -> str:
    wired(board, PolarityFlag.LED)
    ok(board, configuration(generation=2), Polarity(2, NONE), Arm(ArmFlag.LAMPS))
    for command in (Polarity(2, PolarityFlag.LED), Commit(2)):
        got = board.request(command).status
        expect(got is StatusCode.BAD_STATE, f"{type(command).__name__.lower()}: {got.name.lower()}")
    ok(board, configuration(generation=3), Commit(3))  # which keeps the pins
    return "refused; a commit that keeps them is not"


# ---- the controller is the cameras' clock ----


@promised(
    "Triggers of a camera, the sync input busy",
    "exact, each end an edge, delay + 9",
    PIN_SYNC,
    *LAMPS,
    PIN_CAMERA_TRIGGER,
)
def a_triggers_end_is_an_edge_and_the_sync_input_is_nobodys(board: Board) -> str:
    board.play(Scene(until=5 * MS, edges=camera([MS + 20_000 * i for i in range(4)])))  # refused, and stay counted
    count, before = 25, rejected(board)
    wired(board, NONE, trigger=EXPOSED, ratio=1, **FLASHES)
    ok(board, Arm(ArmFlag.LAMPS))
    busy = camera([2 * MS + 70_001 * i for i in range(80)], low=300)
    played = board.play(Scene(until=count * CLOCK, edges=busy, watch=(PIN_CAMERA_TRIGGER, *LAMPS)))
    begins, widths = played.rises(PIN_CAMERA_TRIGGER), played.widths(PIN_CAMERA_TRIGGER)
    between = [b - a for a, b in itertools.pairwise(begins)]
    expect(len(widths) >= count - 2, f"{len(widths)} triggers")
    seen = f"{len(widths)} of {span(widths)} every {span(between)}"
    expect(all_near(board, widths, EXPOSED) and all_near(board, between, CLOCK), seen)
    ends = played.falls(PIN_CAMERA_TRIGGER)
    flashes = [tick for tick, _ in lit(played) if tick > ends[0]]
    expect(len(ends) - len(flashes) in (0, 1), f"{seen}; {len(flashes)} flashes")  # the last may come after the scene
    seen += f", {follows(board, flashes, ends[: len(flashes)], FLASHES['delay'])}"
    reported = [edge.tick for edge in played.heard(Edge)]
    apart = [(b - a) % 2**32 - CLOCK for a, b in itertools.pairwise(reported)]
    expect(
        abs(len(reported) - len(ends)) <= 1 and all(abs(off) <= 1 for off in apart), f"{seen}; edges reported otherwise"
    )
    expect(rejected(board) == before, f"{seen}; edges of the sync input were looked at")
    return seen


@promised(
    "Triggers begun by edges, others refused", "delay + 60 at most; edges as ever", PIN_SYNC, *LAMPS, PIN_CAMERA_TRIGGER
)
def an_accepted_edge_begins_a_trigger_and_stays_the_edge(board: Board) -> str:
    count, begins = 20, 150_001
    wired(board, NONE, trigger=EXPOSED, begins=begins, ratio=1, **FLASHES)
    ok(board, Arm(ArmFlag.LAMPS))
    edges = frames(count, CLOCK)
    noise = camera([edge + 60_000 for edge in edges], low=500)  # within the hold-off
    scene = Scene(until=int(edges[-1]) + CLOCK, edges=camera(edges) + noise, watch=(PIN_CAMERA_TRIGGER, *LAMPS))
    played = board.play(scene)
    falls = sorted(played.falls_played(PIN_SYNC))[::2]
    seen = follows(board, [tick for tick, _ in lit(played)], falls, FLASHES["delay"])
    rises, widths = played.rises(PIN_CAMERA_TRIGGER), played.widths(PIN_CAMERA_TRIGGER)
    expect(len(rises) == count and all_near(board, widths, EXPOSED), f"{len(rises)} triggers of {span(widths)}; {seen}")
    late = [rise - fall - begins for rise, fall in zip(rises, falls, strict=True)]
    seen = f"delay + {span(late)}; {seen.replace('delay', 'lamps')}"
    expect(min(late) >= -board.slack(begins) and max(late) <= LATE + board.slack(begins), seen)
    return seen


@promised(
    "Triggers in a slow sync input's place", "no end lost in its hold-off", PIN_SYNC, PIN_CAMERA_TRIGGER, unit="edges"
)
def no_end_of_a_trigger_is_lost_in_a_slow_inputs_hold_off(board: Board) -> str:
    wired(board, NONE, period=4_000_000)
    before, at = rejected(board), 47 * MS
    slower = [configuration(generation=2, period=8_000_000), Commit(2)]  # whose hold-off waits for an edge
    triggered = [configuration(generation=3, **FLASHES), CameraTrigger(3, 100, 0), Commit(3)]
    orders = [(at, command) for command in [*slower, *triggered]]
    scene = Scene(until=at, edges=camera([MS, at - MS]), watch=(PIN_CAMERA_TRIGGER,), orders=orders, after=20 * MS)
    played = board.play(scene)
    expect(all(reply and reply.status is StatusCode.OK for reply in played.replies), "refused")
    ends, reported = len(played.falls(PIN_CAMERA_TRIGGER)), len(played.heard(Edge)) - 2
    seen = f"{reported} of {ends}"
    expect(ends > 5 and abs(reported - ends) <= 1 and rejected(board) == before, seen)
    return seen


@promised("Other flashes while triggers run", "triggers as before; no other period", PIN_LED, PIN_CAMERA_TRIGGER)
def other_flashes_do_not_touch_the_triggers(board: Board) -> str:
    wired(board, NONE, trigger=EXPOSED, ratio=1, **FLASHES)
    ok(board, Arm(ArmFlag.LAMPS))
    again = [configuration(generation=2, ratio=0, **FLASHES), CameraTrigger(2, EXPOSED + 1, 0), Commit(2)]
    other = [configuration(generation=3, ratio=0, **FLASHES | {"period": CLOCK + 1}), Commit(3)]
    orders = [(5 * MS, command) for command in again] + [(20 * MS, command) for command in other]
    scene = Scene(until=20 * MS, watch=(PIN_CAMERA_TRIGGER, PIN_LED), orders=orders, after=10 * MS)
    played = board.play(scene)
    answers = [reply.status for reply in played.replies if reply]
    good, bad = StatusCode.OK, StatusCode.BAD_STATE
    expect(answers == [good, bad, good, good, bad], f"answered {[status.name.lower() for status in answers]}")
    widths, begins = played.widths(PIN_CAMERA_TRIGGER), played.rises(PIN_CAMERA_TRIGGER)
    between = [b - a for a, b in itertools.pairwise(begins)]
    seen = f"{len(widths)} of {span(widths)} every {span(between)}"
    expect(all_near(board, widths, EXPOSED) and all_near(board, between, CLOCK), seen)
    return seen


@promised("Triggers that do not fit their period", "refused", unit="")
def a_trigger_that_does_not_fit_its_period_is_refused(board: Board) -> str:
    ok(board, configuration(period=CLOCK, delay=1_000, width=30_000, readout=0))
    for width in (1, 99, CLOCK - 99, CLOCK, 2**32 - 1):
        got = board.request(CameraTrigger(1, width, 0)).status
        expect(got is StatusCode.OUT_OF_RANGE, f"{width}: {got.name.lower()}")
    ok(board, CameraTrigger(1, 100, 0), CameraTrigger(1, CLOCK - 100, 0), CameraTrigger(1, 0, 0))
    return "5 of 5"


# ---- an interlock of two inputs ----


def use_both(board: Board) -> None:
    reply = ok(board, Interlock(InterlockFlag.ANTIVALENT))
    assert isinstance(reply, InterlockReply)
    expect(reply.inputs == InterlockFlag.ANTIVALENT, f"the inputs say {reply.inputs!r} while both are closed")


@promised(
    "Interlock of two inputs: either opens in a pulse",
    "8 and 19 at most",
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    *BOTH,
)
def either_of_two_inputs_cuts_in_hardware(board: Board) -> str:
    configure(board)
    use_both(board)
    rng, worst = random.Random(13), []
    for pin, unsafe, most in CUTS:
        took = []
        for _ in range(OPENINGS):
            ok(board, Arm(ArmFlag.MICROWAVE))
            ok(board, Burst(BurstCode.SINGLE, chip=ON, repeat=60_000, period=PERIOD, trigger_offset=0))
            opens = rng.randrange(20, ON - 100)
            edges = [(opens, pin, unsafe), (opens + 1_000, pin, 1 - unsafe)]
            played = board.play(Scene(until=3 * MS, edges=edges, watch=BOTH, cue=PIN_MICROWAVE))
            took.append(_cut(board, played, pin, 0))
        worst.append(max(took))
        expect(worst[-1] <= most + board.slack(), f"GP{pin}: low {worst[-1]:.1f} after it opened")
    return f"{worst[0]:.1f} and {worst[1]:.1f}, {OPENINGS} openings each"


@promised(
    "The second input opens alone, a lamp is lit", "dark within a round", PIN_SYNC, PIN_LED, PIN_INTERLOCK_ANTIVALENT
)
def the_second_input_alone_darkens_a_lamp(board: Board) -> str:
    use_both(board)
    arm(board, ratio=0, delay=100_000, width=1_000_000)
    opens = 2 * MS + 400_000
    edges = [*camera([2 * MS]), (opens, PIN_INTERLOCK_ANTIVALENT, 0), (opens + MS, PIN_INTERLOCK_ANTIVALENT, 1)]
    played = board.play(Scene(until=opens + 15 * MS, edges=edges, watch=(PIN_LED,)))
    expect(len(played.falls(PIN_LED)) == 1, f"{len(played.falls(PIN_LED))} flashes")
    took = played.falls(PIN_LED)[0] - opens
    seen = f"{took:.1f} after it opened"
    expect(0 < took <= ROUND and faults(played) == [FaultCode.INTERLOCK], f"{seen}; faults {faults(played)}")
    return seen


@promised("Inputs chosen anew", "not while armed; then one again", PIN_INTERLOCK, PIN_INTERLOCK_ANTIVALENT, *BOTH)
def an_armed_head_keeps_its_inputs_and_a_guard_of_one_is_back(board: Board) -> str:
    configure(board)
    use_both(board)
    ok(board, Arm(ArmFlag.MICROWAVE))
    got = board.request(Interlock(InterlockFlag(0))).status
    expect(got is StatusCode.BAD_STATE, f"armed: {got.name.lower()}")
    ok(board, Arm(ArmFlag(0)), Interlock(InterlockFlag(0)), Arm(ArmFlag.MICROWAVE))
    ok(board, Burst(BurstCode.SINGLE, chip=ON, repeat=60_000, period=PERIOD, trigger_offset=0))
    opens = 12 * PERIOD + ON // 2  # in a pulse, and longer than a contradiction may last
    second: list[EdgeIn] = [(PERIOD, PIN_INTERLOCK_ANTIVALENT, 0), (opens + MS, PIN_INTERLOCK_ANTIVALENT, 1)]
    edges = [*second, (opens, PIN_INTERLOCK, 1), (opens + 100, PIN_INTERLOCK, 0)]
    played = board.play(Scene(until=opens + 3 * MS, edges=edges, watch=BOTH, cue=PIN_MICROWAVE))
    took = _cut(board, played, PIN_INTERLOCK, 0)
    expect(took <= CUT_TICKS + 1 + board.slack(), f"low {took:.1f} after it opened")
    return f"refused; then low {took:.1f} after GP7 alone opened"


@promised(
    "Two inputs that contradict each other",
    "a fault after 5, until both are closed",
    PIN_SYNC,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    unit="ms",
)
def inputs_that_disagree_are_a_fault_until_both_are_closed(board: Board) -> str:
    configure(board, period=400_000)
    use_both(board)
    opens = 8 * MS
    edges: list[EdgeIn] = [*camera([2 * MS, 6 * MS]), (opens, PIN_INTERLOCK, 1)]
    played = board.play(Scene(until=opens + DISAGREED, edges=edges))
    expect(faults(played) == [FaultCode.INTERLOCK_DISAGREES], f"faults {faults(played)}")
    lasted = (played.tick_of(played.heard(Fault)[0].tick) - opens) / MS
    seen = f"after {lasted:.2f}"
    expect(INTERLOCK_DISAGREE_MS <= lasted <= INTERLOCK_DISAGREE_MS + ROUND / MS, seen)
    expect(board.request(Clear()).status is StatusCode.UNSAFE, f"{seen}; cleared while they disagree")
    board.play(Scene(until=2 * MS, edges=[(MS, PIN_INTERLOCK_ANTIVALENT, 0)]))
    expect(board.request(Clear()).status is StatusCode.UNSAFE, f"{seen}; cleared while both are open")
    board.play(Scene(until=4 * MS, edges=[(MS, PIN_INTERLOCK_ANTIVALENT, 1), (2 * MS, PIN_INTERLOCK, 0)]))
    ok(board, Clear())
    return seen


@promised(
    "A second input that is not configured", "not looked at", PIN_SYNC, PIN_LED, PIN_INTERLOCK_ANTIVALENT, unit=""
)
def a_second_input_that_is_not_configured_is_not_looked_at(board: Board) -> str:
    arm(board, ratio=0, period=1_000_000)
    edges = frames(5, 1_000_000)
    turns: list[EdgeIn] = [(3 * MS + i * DISAGREED, PIN_INTERLOCK_ANTIVALENT, i % 2) for i in range(6)]
    played = board.play(Scene(until=int(edges[-1]) + 10 * MS, edges=camera(edges) + turns, watch=(PIN_LED,)))
    seen = f"{len(played.rises(PIN_LED))} flashes of {len(edges)}"
    expect(not faults(played) and len(played.rises(PIN_LED)) == len(edges), f"{seen}, faults {faults(played)}")
    return seen
