"""Promises of the microwave gate, its trigger and the interlock."""

import itertools
import random

from annulus_pipe.controller import CODES, PIN_INTERLOCK, PIN_MICROWAVE, PIN_SYNC, PIN_TRIGGER
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstDone,
    BurstReply,
    BurstStop,
    Clear,
    Edge,
    Fault,
    FaultCode,
    Pattern,
    StatusCode,
)
from annulus_pipe.selftest.rig.board import MS, Board, Played, Scene, expect
from annulus_pipe.selftest.rig.promises import all_near, arm, camera, ok, promised, span

BOTH = (PIN_MICROWAVE, PIN_TRIGGER)
TRIGGER_TICKS = 100
CUT_TICKS = 5  # interlock open to gate low
OPENINGS = 12
AFTER = 20 * MS  # a train of this module is over by then


def chips(code: BurstCode) -> str:
    return CODES[code.name.lower().replace("_", "-")]


def played_chips(board: Board, played: Played, chip0: float, chip: int, length: int) -> str:
    """What stands on the pin in the middle of each chip; the edges are checked to be on the grid."""
    changes = [(tick, level) for tick, pin, level in played.transitions if pin == PIN_MICROWAVE]
    for tick, _ in changes:
        if chip0 - chip <= tick <= chip0 + chip * (length + 1):
            off = (tick - chip0 + chip / 2) % chip - chip / 2
            expect(abs(off) <= board.slack(chip * length), f"an edge {off:+.1f} ticks off its chip")
    level, bits, at = 0, [], 0
    for index in range(length):
        while at < len(changes) and changes[at][0] <= chip0 + chip * index + chip / 2:
            level = changes[at][1]
            at += 1
        bits.append(str(level))
    return "".join(bits)


def first_chip(played: Played, code: str, chip: int) -> float:
    """Chip 0, by the first rise."""
    return played.rises(PIN_MICROWAVE)[0] - chip * code.index("1")


def fire(board: Board, burst: Burst, *, watch: tuple[int, ...] = BOTH, after: int = AFTER) -> Played:
    """One train, from its order to after its end."""
    return board.play(Scene(until=MS, watch=watch, orders=[(MS // 2, burst)], after=after))


def _codes(board: Board, codes: list[BurstCode], offsets: list[int]) -> str:
    arm(board, ArmFlag.MICROWAVE)
    period, worst = 100_000, 0.0
    for code, offset in zip(codes, itertools.cycle(offsets), strict=False):
        text = chips(code)
        played = fire(board, Burst(code=code, chip=50, repeat=3, period=period, trigger_offset=offset))
        expect(bool(played.rises(PIN_MICROWAVE)), f"{code.name.lower()}: nothing came")
        chip0 = first_chip(played, text, 50)
        for burst in range(3):
            seen = played_chips(board, played, chip0 + period * burst, 50, len(text))
            expect(seen == text, f"{code.name.lower()}: {seen}")
        triggers = played.rises(PIN_TRIGGER)
        off = [t - chip0 - offset - period * i for i, t in enumerate(triggers)]
        expect(len(triggers) == 3, f"{code.name.lower()}: {len(triggers)} triggers of 3")
        worst = max(worst, *map(abs, off))
        expect(worst <= board.slack(3 * period), f"{code.name.lower()}: trigger off by {span(off)}")
        expect(
            all_near(board, played.widths(PIN_TRIGGER), TRIGGER_TICKS), f"trigger {span(played.widths(PIN_TRIGGER))}"
        )
        done = [d.done for d in played.heard(BurstDone)]
        expect(done == [3], f"{code.name.lower()}: bursts reported {done}")
    return f"{len(codes)} codes chip by chip, trigger off by {worst:.1f}"


@promised("Built-in codes, 0.5 us chips, and their trigger", "on the chip grid", *BOTH)
def codes_are_played_as_they_are_written(board: Board) -> str:
    return _codes(board, [code for code in BurstCode if code is not BurstCode.UPLOADED], [0, 1, -1, 123, -777])


def _pulse(board: Board, chip: int) -> str:
    arm(board, ArmFlag.MICROWAVE)
    count = 40
    burst = Burst(code=BurstCode.SINGLE, chip=chip, repeat=count, period=100_000, trigger_offset=0)
    played = fire(board, burst, after=count * 100_000 + 10 * MS)
    rises, widths = played.rises(PIN_MICROWAVE), played.widths(PIN_MICROWAVE)
    seen = f"{len(widths)} of {span(widths)}"
    expect(len(widths) == count and all_near(board, widths, chip), seen)
    gaps = [b - a for a, b in itertools.pairwise(rises)]
    expect(all_near(board, gaps, 100_000), f"{seen}, period {span(gaps)}")
    done = [d.done for d in played.heard(BurstDone)]
    expect(done == [count], f"{seen}, reported {done}")
    return seen


@promised("Shortest pulse, 40 times", "40 of 30", *BOTH)
def the_shortest_pulse_is_exact(board: Board) -> str:
    return _pulse(board, 30)


@promised("Longest pulse, 40 times", "40 of 3000", *BOTH)
def the_longest_pulse_is_exact(board: Board) -> str:
    return _pulse(board, 3_000)


@promised("Uploaded patterns, up to 256 chips", "chip by chip", *BOTH, unit="")
def uploaded_patterns_are_played_chip_by_chip(board: Board) -> str:
    arm(board, ArmFlag.MICROWAVE)
    rng = random.Random(11)
    for length, density in ((1, 1.0), (8, 0.5), (129, 0.5), (255, 0.5), (256, 0.1), (256, 0.9)):
        bits = [1 if rng.random() < density else 0 for _ in range(length)]
        bits[0] = 1  # so that the pin tells where it begins
        if length == 255:
            bits = [(i + 1) % 2 for i in range(length)]  # the most runs there can be
        packed = sum(bit << i for i, bit in enumerate(bits)).to_bytes(32, "little")
        ok(board, Pattern(length=length, chips=packed))
        period = max(20 * 30 * sum(bits), 31 * length) + 100
        burst = Burst(code=BurstCode.UPLOADED, chip=30, repeat=2, period=period, trigger_offset=7)
        played = fire(board, burst, after=2 * period + AFTER)
        text = "".join(map(str, bits))
        expect(bool(played.rises(PIN_MICROWAVE)), f"{length} chips: nothing came")
        chip0 = played.rises(PIN_MICROWAVE)[0]
        for number in range(2):
            seen = played_chips(board, played, chip0 + number * period, 30, length)
            expect(seen == text, f"{length} chips: {seen}")
        off = [t - chip0 - 7 - number * period for number, t in enumerate(played.rises(PIN_TRIGGER))]
        expect(
            len(off) == 2 and all(abs(o) <= board.slack(period) for o in off),
            f"{length} chips: trigger off {span(off)}",
        )
    return "6 patterns"


@promised("A train begins when its answer says", "0 off", PIN_SYNC, *BOTH)
def a_train_begins_when_its_reply_says(board: Board) -> str:
    arm(board, ArmFlag.MICROWAVE)
    edges = [MS + i * 10 * MS for i in range(4)]
    burst = Burst(code=BurstCode.SINGLE, chip=100, repeat=3, period=100_000, trigger_offset=0)
    played = board.play(
        Scene(until=edges[-1] + MS, edges=camera(edges), watch=BOTH, orders=[(12 * MS, burst)], after=AFTER)
    )
    [reply] = played.replies
    assert isinstance(reply, BurstReply)
    expect(bool(played.rises(PIN_MICROWAVE)) and bool(played.heard(Edge)), "nothing came")
    off = played.rises(PIN_MICROWAVE)[0] - played.tick_of(reply.start)
    expect(abs(off) <= 1 + board.slack(50 * MS), f"{off:+.1f} off")
    return f"{off:+.1f} off"


@promised("A train asked to stop, at six moments", "whole bursts, all counted", *BOTH, unit="bursts")
def a_stopped_train_sends_whole_bursts_and_says_how_many(board: Board) -> str:
    arm(board, ArmFlag.MICROWAVE)
    rng = random.Random(7)
    seen = []
    for period, offset in ((11_000, 0), (11_000, -5_000), (50_000, 600), (300_000, -777)):
        burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=1_000, period=period, trigger_offset=offset)
        stop = MS + rng.randrange(5 * MS, 30 * MS)
        played = board.play(
            Scene(until=stop, watch=BOTH, orders=[(MS // 2, burst), (stop, BurstStop())], after=12 * period + 3 * MS)
        )
        done = [d.done for d in played.heard(BurstDone)]
        rises, triggers = len(played.widths(PIN_MICROWAVE)), len(played.widths(PIN_TRIGGER))
        expect(len(done) == 1, f"reported {done}")
        expect(rises == 7 * done[0], f"{rises} pulses in place of {7 * done[0]}")
        expect(triggers == done[0], f"{triggers} triggers of {done[0]} bursts")
        expect(
            all_near(board, played.widths(PIN_TRIGGER), TRIGGER_TICKS), f"trigger {span(played.widths(PIN_TRIGGER))}"
        )
        seen.append(done[0])
    return f"{', '.join(map(str, seen))}, all whole"


@promised("A train that fills its period", "its last pulse ends by itself", *BOTH)
def the_last_pulse_of_a_train_ends_by_itself(board: Board) -> str:
    arm(board, ArmFlag.MICROWAVE)
    burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=4, period=18_428, trigger_offset=-17_178)
    played = fire(board, burst)
    widths = played.widths(PIN_MICROWAVE)
    expect(len(widths) == 28 and abs(max(widths) - 150) <= board.slack(150), f"{len(widths)} of {span(widths)}")
    triggers = played.widths(PIN_TRIGGER)
    expect(len(triggers) == 4 and all_near(board, triggers, TRIGGER_TICKS), f"triggers {span(triggers)}")
    return f"{len(widths)} pulses, longest {max(widths):.1f}"


@promised("Interlock opens to gate low, within a pulse", "5 at most", PIN_INTERLOCK, *BOTH)
def an_open_interlock_cuts_until_cleared(board: Board) -> str:
    arm(board)
    rng = random.Random(5)
    worst, on = 0.0, 3_000
    for _ in range(OPENINGS):
        ok(board, Arm(ArmFlag.MICROWAVE))
        ok(board, Burst(code=BurstCode.SINGLE, chip=on, repeat=60_000, period=20 * on, trigger_offset=0))
        opens = rng.randrange(20, on - 20)  # of the pulse
        edges = [(opens, PIN_INTERLOCK, 1), (opens + rng.choice((5, 100, 1_000)), PIN_INTERLOCK, 0)]
        played = board.play(Scene(until=5 * MS, edges=edges, watch=BOTH, cue=PIN_MICROWAVE))
        opened = played.edges[0][0]
        after = [tick - opened for tick, pin, _ in played.transitions if pin == PIN_MICROWAVE and tick > opened]
        expect(len(after) == 1, f"{len(after)} changes after it opened in a pulse")
        worst = max(worst, *after)
        expect(worst <= CUT_TICKS + board.slack(), f"low {worst:.1f} after it opened")
        faults = [fault.fault for fault in played.heard(Fault)]
        expect(faults == [FaultCode.INTERLOCK], f"faults {faults}")
        expect(board.request(Arm(ArmFlag.MICROWAVE)).status is StatusCode.UNSAFE, "armed again without a clear")
        ok(board, Clear())
    return f"{worst:.1f} at most, {OPENINGS} openings"


@promised("Shortest pulses behind an open interlock", "none rises", PIN_INTERLOCK, *BOTH)
def nothing_rises_behind_an_open_interlock(board: Board) -> str:
    arm(board)
    rng = random.Random(7)
    worst = 0.0
    for _ in range(OPENINGS):
        ok(board, Arm(ArmFlag.MICROWAVE))
        ok(board, Burst(code=BurstCode.SINGLE, chip=30, repeat=60_000, period=600, trigger_offset=200))
        opens = 6_000 + rng.randrange(560, 610)  # about the next rise but ten
        edges = [(opens, PIN_INTERLOCK, 1), (opens + 60_000, PIN_INTERLOCK, 0)]
        played = board.play(Scene(until=3 * MS, edges=edges, watch=BOTH, cue=PIN_MICROWAVE))
        opened = played.edges[0][0]
        late = [tick - opened for pin in BOTH for tick in played.rises(pin) if tick > opened]
        worst = max(worst, *late, 0.0)
        expect(worst <= CUT_TICKS + 1 + board.slack(), f"a rise {worst:.1f} after it opened")
        expect(bool(played.rises(PIN_MICROWAVE)), "no train ran")
        ok(board, Clear())
    return f"none later than {worst:.1f}, {OPENINGS} openings"


@promised("A train cut by the interlock", "bursts counted as they were", PIN_INTERLOCK, *BOTH, unit="bursts")
def a_cut_train_counts_the_bursts_that_were_sent(board: Board) -> str:
    arm(board)
    rng = random.Random(12)
    counted = []
    for _ in range(4):
        ok(board, Arm(ArmFlag.MICROWAVE))
        opens = 30 * MS + rng.randrange(1_000, 600_000)
        burst = Burst(code=BurstCode.SINGLE, chip=500, repeat=60_000, period=10_000, trigger_offset=0)
        scene = Scene(
            until=opens + 3 * MS,
            orders=[(MS // 2, burst)],
            watch=BOTH,
            edges=[(opens, PIN_INTERLOCK, 1), (opens + 100_000, PIN_INTERLOCK, 0)],
        )
        played = board.play(scene)
        reported = played.heard(BurstDone)
        whole = sum(abs(width - 500) <= board.slack() for width in played.widths(PIN_MICROWAVE))
        expect(
            len(reported) == 1 and reported[0].fault is FaultCode.INTERLOCK, f"reported {[d.done for d in reported]}"
        )
        expect(reported[0].done == whole, f"{reported[0].done} reported, {whole} sent whole")
        counted.append(whole)
        ok(board, Clear())
    return f"{', '.join(map(str, counted))}, reported alike"


@promised("Arming with the interlock open", "refused", PIN_INTERLOCK, unit="")
def the_microwave_cannot_be_armed_with_the_interlock_open(board: Board) -> str:
    arm(board)
    board.play(Scene(until=3 * MS, edges=[(MS, PIN_INTERLOCK, 1)]))
    board.request(Arm(ArmFlag(0)))
    board.request(Clear())
    status = board.request(Arm(ArmFlag.MICROWAVE)).status
    board.play(Scene(until=3 * MS, edges=[(MS, PIN_INTERLOCK, 0)]))
    expect(status is StatusCode.UNSAFE, f"answered {status.name.lower()}")
    return "refused"


@promised("Single bursts as fast as the line takes them", "5 % of any time at most", *BOTH, unit="permille")
def the_duty_limit_holds_however_fast_bursts_are_asked_for(board: Board) -> str:
    arm(board, ArmFlag.MICROWAVE)
    pulse, pulses = 3_000, 64
    packed = sum(1 << i for i in range(0, 2 * pulses, 2)).to_bytes(32, "little")
    ok(board, Pattern(length=2 * pulses - 1, chips=packed))
    on = pulse * pulses  # it owes 38 ms: any line asks sooner
    burst = Burst(code=BurstCode.UPLOADED, chip=pulse, repeat=1, period=20 * on, trigger_offset=0)
    orders = []
    for i in range(24):
        again = (burst, Arm(ArmFlag(0)), Clear(), Arm(ArmFlag.MICROWAVE))
        orders += [(MS + 8 * MS * i, command) for command in again]
    played = board.play(Scene(until=2 * MS, watch=BOTH, orders=orders, after=3 * MS))
    pulses_played = played.pulses(PIN_MICROWAVE)
    expect(bool(pulses_played), "nothing came")
    most = 0.0
    for i, (begin, _) in enumerate(pulses_played):  # from a burst's first rise to any later one's
        if i and begin - pulses_played[i - 1][0] < 4 * pulse:
            continue
        lit, before = 0.0, begin
        for rise, width in pulses_played[i:]:
            if lit and rise - before > 4 * pulse:
                most = max(most, 1000 * lit / (rise - begin))
            lit, before = lit + width, rise
    bursts = 1 + sum(b[0] - a[0] > 4 * pulse for a, b in itertools.pairwise(pulses_played))
    refused = sum(reply is not None and reply.status is StatusCode.DUTY for reply in played.replies)
    seen = f"{most:.1f}; {bursts} bursts, {refused} refused"
    expect(most <= 50.1 and bursts > 1 and refused > 0, seen)
    return seen
