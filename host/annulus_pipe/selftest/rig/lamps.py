"""Promises of the sync follower and the lamps."""

import random

from annulus_pipe.controller import LAMP_WIDTH_MAX_TICKS, PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_SYNC, PIN_TRIGGER
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    Commit,
    Edge,
    Fault,
    FaultCode,
    Preamble,
    StageReply,
    Status,
    StatusCode,
    StatusReply,
    SyncFound,
    SyncLost,
)
from annulus_pipe.selftest.rig.board import LATENCY, MS, Board, Fine, Played, Scene, expect
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
from annulus_pipe.vocabulary import EdgeFlag, Lamp

FAST = 200_000  # 500 Hz, the fastest
GLITCHES = (4, 5, 100, 400)  # ticks low; the rig plays none shorter
HOLD_OFF_ENDS = 3  # ticks around where it should
AT_LEAST = 4  # flashes before a host that fell silent is noticed


def rejected(board: Board) -> int:
    reply = board.request(Status())
    assert isinstance(reply, StatusReply)
    return reply.rejected


@promised("Outputs before anything is armed", "all low", PIN_SYNC, *LAMPS, unit="")
def nothing_fires_before_it_is_armed(board: Board) -> str:
    configure(board, period=1_000_000, width=100_000)
    edges = frames(3, 1_000_000)
    for watch in (LAMPS, (PIN_MICROWAVE, PIN_TRIGGER)):
        played = board.play(Scene(until=4_000_000, edges=camera(edges), watch=watch))
        changed = sorted({pin for _, pin, _ in played.transitions})
        expect(not changed, f"GP{', GP'.join(map(str, changed))} moved")
    return "all low"


@promised("Sync edge to lamp, line flooded, train running", "delay + 9, jitter 0", PIN_SYNC, *LAMPS, PIN_MICROWAVE)
def no_jitter_under_a_flood_and_a_train(board: Board) -> str:
    count, delay, width, train = 75, 30_000, 20_000, 70_000
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=4, period=FAST, delay=delay, width=width)
    ok(board, Burst(code=BurstCode.MPSL25, chip=50, repeat=60_000, period=train, trigger_offset=-25))
    rng = random.Random(7)
    edges = [2 * MS + i * FAST + i * 7 % 13 + 13 * rng.randrange(-4, 4) for i in range(count)]
    scene = Scene(until=edges[-1] + FAST, edges=camera(edges), watch=(*LAMPS, PIN_MICROWAVE), flood=True)
    played = board.play(scene)
    seen = follows(board, [tick for tick, _ in lit(played)], played.falls_played(PIN_SYNC), delay)
    widths = played.widths(PIN_PROJECTOR) + played.widths(PIN_LED)
    expect(all_near(board, widths, width), f"{seen}; widths {span(widths)} in place of {width}")
    pins = [pin for _, pin in lit(played)]
    expect(pins == [PIN_LED if i % 5 == 4 else PIN_PROJECTOR for i in range(count)], f"{seen}; lamps out of order")
    gate = [tick for tick, pin, _ in played.transitions if pin == PIN_MICROWAVE]
    off = [(tick - gate[0] + 25) % train % 50 - 25 for tick in gate]
    expect(all(abs(o) <= board.slack(gate[-1] - gate[0]) for o in off), f"{seen}; chips off their grid by {span(off)}")
    return f"{seen}, {count} edges"


def _delay_and_width(board: Board, delay: int, width: int) -> str:
    period = 1_000_000 if delay + 2 * width < 400_000 else 8_000_000
    arm(board, ratio=1, period=period, delay=delay, width=width)
    edges = frames(4, period)
    played = board.play(Scene(until=int(edges[-1]) + delay + width + MS, edges=camera(edges), watch=LAMPS))
    seen = follows(board, [tick for tick, _ in lit(played)], played.falls_played(PIN_SYNC), delay)
    widths = played.widths(PIN_PROJECTOR) + played.widths(PIN_LED)
    expect(len(widths) == 4 and all_near(board, widths, width), f"{seen}; widths {span(widths)} in place of {width}")
    return f"{seen}, width {span(widths)}"


@promised("Lamp at once, for 10 ms", "delay + 9, 1 000 000 wide", PIN_SYNC, *LAMPS)
def a_lamp_may_begin_at_its_edge(board: Board) -> str:
    return _delay_and_width(board, 0, 1_000_000)


@promised("Lamp after 12 ms, for the longest there is", "delay + 9, 2 000 000 wide", PIN_SYNC, *LAMPS)
def the_longest_flash_is_exact(board: Board) -> str:
    return _delay_and_width(board, 1_234_567, LAMP_WIDTH_MAX_TICKS)


@promised("Lamp after 0.5 ms, for 1 us", "delay + 9, 100 wide", PIN_SYNC, *LAMPS)
def a_short_flash_is_exact(board: Board) -> str:
    return _delay_and_width(board, 50_000, 100)


@promised("Shortest flashes, 2 and 3 ticks", "2 and 3 wide", PIN_SYNC, PIN_PROJECTOR)
def the_shortest_flashes_are_exact(board: Board) -> str:
    seen = []
    for generation, width in enumerate((2, 3), 1):
        ok(board, Arm(ArmFlag(0)))
        arm(board, ratio=15, period=1_000_000, delay=1, width=width, generation=generation)
        edge, widths = 2 * MS, list[float]()
        for _ in range(3):
            fine = Fine(PIN_PROJECTOR, edge - 100, 800)
            widths += board.play(Scene(until=edge + 10 * MS, edges=camera([edge]), fine=fine)).widths(PIN_PROJECTOR)
        seen.append(span(widths))
        expect(len(widths) == 3 and all_near(board, widths, width), f"{' and '.join(seen)} wide")
    return f"{' and '.join(seen)} wide, 3 of each"


@promised("Order of the lamps, ratio 0, 1, 4 and 15", "every slot its lamp", PIN_SYNC, *LAMPS, unit="")
def lamps_come_in_their_order(board: Board) -> str:
    for generation, ratio in enumerate((0, 1, 4, 15), 1):
        ok(board, Arm(ArmFlag(0)))
        arm(board, ratio=ratio, period=FAST, delay=30_000, width=20_000, led_width=10_000, generation=generation)
        edges = frames(2 * (ratio + 1) + 1, FAST)
        played = board.play(Scene(until=int(edges[-1]) + FAST, edges=camera(edges), watch=LAMPS))
        expected = [PIN_LED if i % (ratio + 1) == ratio else PIN_PROJECTOR for i in range(len(edges))]
        pins = [pin for _, pin in lit(played)]
        letters = "".join("L" if pin == PIN_LED else "P" for pin in pins)
        expect(pins == expected, f"ratio {ratio}: {letters}")
        reported = [PIN_LED if edge.lamp is Lamp.LED else PIN_PROJECTOR for edge in played.heard(Edge)]
        expect(reported == expected, f"ratio {ratio}: the events tell otherwise")
        expect(
            [e.slot for e in played.heard(Edge)] == [i % (ratio + 1) for i in range(len(edges))],
            f"ratio {ratio}: slots",
        )
    return "every slot its lamp"


@promised("Time stamp of an edge", "0 or +1 from the edge", PIN_SYNC)
def an_edge_is_stamped_to_the_tick_or_the_next(board: Board) -> str:
    configure(board, period=1_000_000)
    edges = [2 * MS + i * 1_000_007 + i * 7 % 13 for i in range(24)]
    played = board.play(Scene(until=edges[-1] + MS, edges=camera(edges)))
    reported = played.heard(Edge)
    expect(len(reported) == len(edges), f"{len(reported)} of {len(edges)} edges reported")
    off = [played.tick_of(e.tick) - fall for e, fall in zip(reported, played.falls_played(PIN_SYNC), strict=True)]
    seen = f"apart by {max(off) - min(off):.1f} at most"
    expect(max(off) - min(off) <= 1 + board.slack(edges[-1]), seen)
    return f"{seen}, {len(off)} edges"


@promised("Glitches and double edges", "refused, counted, no flash", PIN_SYNC, *LAMPS, unit="edges")
def glitches_are_refused_and_counted(board: Board) -> str:
    count = 6
    arm(board, ratio=1, tolerance=100)
    edges = [2 * MS + i * 4_000_000 for i in range(count)]
    rng = random.Random(3)
    before, extra, pulses = rejected(board), 0, camera(edges, low=300)
    for edge in edges:
        for at in (edge + 1_000, edge + rng.randrange(2_000, 3_500_000)):  # the hold-off is 3.6 M ticks
            pulses += camera([at], low=rng.choice(GLITCHES))
            extra += 1
    played = board.play(Scene(until=edges[-1] + 3_900_000, edges=pulses, watch=LAMPS))
    falls = played.falls_played(PIN_SYNC)
    seen = follows(board, [t for t, _ in lit(played)], [min(falls, key=lambda f: abs(f - e)) for e in edges], 300_000)
    refused = rejected(board) - before
    reported = played.heard(Edge)
    expect(len(reported) == count, f"{len(reported)} edges reported of {count}")
    expect(refused == extra, f"{refused} of {extra} counted")
    expect(not any(e.flags & EdgeFlag.LATE_LOAD for e in reported), "a flash came late")
    return f"{refused} of {extra} refused; {seen}"


@promised("Hold-off", "ends within 3 of where it should", PIN_SYNC, PIN_LED)
def the_hold_off_ends_where_it_is_said_to(board: Board) -> str:
    arm(board, ratio=0, period=400_000, tolerance=100, delay=50_000, width=20_000)
    near = HOLD_OFF_ENDS + round(board.slack())
    offs = (-40, -near - 1, -near, near, near + 1, 40)
    edges = []
    for i, off in enumerate(offs):
        edges += [2 * MS + i * 10 * MS, 2 * MS + i * 10 * MS + 360_000 + off]
    played = board.play(Scene(until=int(edges[-1]) + 5 * MS, edges=camera(edges, low=1_000), watch=(PIN_LED,)))
    rises = played.rises(PIN_LED)
    second = [any(abs(rise - edge - 50_000 - LATENCY) < 100 for rise in rises) for edge in edges[1::2]]
    wrong = [off for off, taken in zip(offs, second, strict=True) if taken != (off > 0)]
    expect(
        not wrong,
        f"an edge {wrong[0]:+d} ticks from its end was {'refused' if wrong[0] > 0 else 'taken'}" if wrong else "",
    )
    return f"edges {-near} refused, {near:+d} taken"


@promised("Disarming", "ends the flash and lets no other", PIN_SYNC, PIN_LED, unit="ms")
def disarming_ends_the_flash_being_timed(board: Board) -> str:
    arm(board, ratio=0, width=2_000_000, period=8_000_000)
    edges = [2 * MS, 2 * MS + 8_000_000]
    scene = Scene(until=edges[-1] + 25 * MS, edges=camera(edges), watch=(PIN_LED,), orders=[(7 * MS, Arm(ArmFlag(0)))])
    played = board.play(scene)
    widths = played.widths(PIN_LED)
    expect(len(widths) == 1, f"{len(widths)} flashes")
    expect(0 < widths[0] < 2_000_000, f"{widths[0] / MS:.2f} ms long: not ended")
    return f"ended {widths[0] / MS:.2f} ms into 20"


@promised("A flash over half of the shortest interval", "refused; half is granted", PIN_SYNC, PIN_LED)
def a_flash_may_take_half_of_the_shortest_interval(board: Board) -> str:
    timing = {"ratio": 0, "period": 40 * MS, "tolerance": 500, "delay": 0, "readout": 0}
    refused = board.request(configuration(**timing, width=10 * MS + 1))
    assert isinstance(refused, StageReply)
    expect((refused.status, refused.detail) == (StatusCode.DUTY, Lamp.LED), f"one tick more: {refused.status.name}")
    arm(board, ArmFlag.LAMPS, **timing, width=10 * MS)
    edges = [2 * MS + i * (20 * MS + 3) for i in range(5)]
    played = board.play(Scene(until=edges[-1] + 20 * MS, edges=camera(edges), watch=(PIN_LED,)))
    widths = played.widths(PIN_LED)
    expect(len(widths) == 5 and all_near(board, widths, 10 * MS), f"{len(widths)} flashes, {span(widths)}")
    return f"refused; 5 of {span(widths)}"


@promised(
    "Two configurations before an edge, edges at 1 kHz",
    "none taken while a lamp is on",
    PIN_SYNC,
    PIN_LED,
    unit="edges",
)
def no_edge_is_accepted_while_a_lamp_is_on(board: Board) -> str:
    for period, tolerance, width, generation in ((2 * MS, 400, 1_000, 1), (40 * MS, 100, 15 * MS, 2)):
        configure(
            board, ratio=0, period=period, tolerance=tolerance, width=width, generation=generation, delay=0, readout=0
        )
    ok(board, Arm(ArmFlag.LAMPS))
    edges = [2 * MS + i * MS for i in range(120)]
    played = board.play(Scene(until=edges[-1] + 20 * MS, edges=camera(edges, low=1_000), watch=(PIN_LED,)))
    on = played.pulses(PIN_LED)
    accepted = [played.tick_of(event.tick) for event in played.heard(Edge)]
    inside = [a for a in accepted for rise, width in on if rise <= a < rise + width]
    expect(not inside, f"{len(inside)} taken while it was on")
    expect(all_near(board, [width for _, width in on], 15 * MS), f"widths {span([w for _, w in on])}")
    expect(len(on) >= 3, f"{len(on)} flashes")
    return f"0 of {len(accepted)}"


@promised("Edges in the middle of a round", "none lost, no sync_lost", PIN_SYNC, unit="edges")
def an_edge_in_the_middle_of_a_round_is_no_lost_sync(board: Board) -> str:
    arm(board, ratio=4, period=FAST, delay=30_000, width=20_000)
    rng = random.Random(5)
    edges = [2 * MS + i * FAST + rng.randrange(-4_000, 4_000) for i in range(200)]
    played = board.play(Scene(until=edges[-1] + MS, edges=camera(edges)))
    last = max((i for i, event in enumerate(played.events) if isinstance(event, Edge)), default=0)
    reported = len(played.heard(Edge))
    lost = sum(isinstance(event, SyncLost) for event in played.events[:last])  # after the last it is right
    seen = f"{reported} of {len(edges)} reported, {lost} sync_lost"
    expect(reported == len(edges) and lost == 0 and len(played.heard(SyncFound)) <= 1, seen)
    return seen


@promised(
    "Optical preamble of 10 edges, then the cycle", "pins as reported, in their sequence", PIN_SYNC, *LAMPS, unit=""
)
def a_preamble_lights_what_it_tells(board: Board) -> str:
    delay, width, frame = 300_000, 200_000, 1_000_000
    configure(board, ratio=4, period=frame, delay=delay, width=width)
    ok(board, Preamble(10, 2, 0), Arm(ArmFlag.LAMPS))
    edges = frames(25, frame)
    played = board.play(Scene(until=int(edges[-1]) + frame, edges=camera(edges), watch=LAMPS))
    reported = played.heard(Edge)
    expect(len(reported) == len(edges), f"{len(reported)} of {len(edges)} edges reported")
    for pin, lamp in ((PIN_PROJECTOR, Lamp.PROJECTOR), (PIN_LED, Lamp.LED)):
        at = [f for f, e in zip(played.falls_played(PIN_SYNC), reported, strict=True) if e.lamp is lamp]
        follows(board, played.rises(pin), at, delay)
    places = [(EdgeFlag.PREAMBLE in e.flags, e.slot) for e in reported]
    first = [(True, i) for i in range(10)] + [(False, i % 5) for i in range(10)] + [(True, i) for i in range(5)]
    expect(places == first, "its edges or the cycle's are out of place")
    expect(_in_sequence(reported), "lamps in no order of the sequence")
    return "25 edges as reported"


@promised("Preamble: ratio 0, and who identifies", "no projector; and none any more", PIN_SYNC, *LAMPS, unit="")
def a_preamble_leaves_the_projector_out_and_ends_with_its_host(board: Board) -> str:
    frame = 1_000_000
    configure(board, ratio=0, period=frame)
    ok(board, Preamble(10, 0, 0), Arm(ArmFlag.LAMPS))
    edges = frames(12, frame)
    played = board.play(Scene(until=int(edges[-1]) + frame, edges=camera(edges), watch=LAMPS))
    lamps = {edge.lamp for edge in played.heard(Edge)}
    expect(not played.rises(PIN_PROJECTOR) and lamps == {Lamp.LED, Lamp.DARK}, f"lamps {sorted(lamps)}")
    ok(board, Arm(ArmFlag(0)), Preamble(10, 0, 0))
    board.identify()
    arm_again = (configuration(ratio=0, period=frame, generation=2), Commit(2), Arm(ArmFlag.LAMPS))
    ok(board, *arm_again)
    played = board.play(Scene(until=int(edges[3]) + frame, edges=camera(edges[:4]), watch=LAMPS))
    flagged = sum(EdgeFlag.PREAMBLE in edge.flags for edge in played.heard(Edge))
    expect(flagged == 0 and len(played.rises(PIN_LED)) == 4, f"{flagged} edges of a preamble after identify")
    return "12 edges without projector; 4 without a preamble"


def _in_sequence(reported: list[Edge]) -> bool:
    """Lamps of preambles, two bits an edge of a register of 15, from some state of it on."""
    lamps = (Lamp.PROJECTOR, Lamp.LED, Lamp.DARK, Lamp.PROJECTOR)
    wanted = [edge.lamp for edge in reported if EdgeFlag.PREAMBLE in edge.flags]
    for seed in range(1, 1 << 15):
        bits = seed
        for lamp in wanted:
            if lamps[bits & 3] != lamp:
                break
            bits = ((bits << 2) | (((bits >> 13) ^ (bits >> 12)) & 3)) & 0x7FFF
        else:
            return True
    return False


@promised("Host falls silent while the lamps are armed", "dark after 50 ms and one frame", PIN_SYNC, PIN_LED, unit="ms")
def a_silent_host_darkens_the_lamps(board: Board) -> str:
    frame = 400_000
    configure(board, ratio=0, period=frame, delay=100_000, width=100_000, host_timeout=50)
    edges = [MS + i * frame for i in range(60)]
    scene = Scene(
        until=edges[-1] + frame,
        edges=camera(edges),
        watch=(PIN_LED,),
        silent=True,
        orders=[(20 * MS, Arm(ArmFlag.LAMPS))],
    )
    played = board.play(scene)
    faults = [fault for fault in played.heard(Fault) if fault.fault is FaultCode.HOST_TIMEOUT]
    expect(len(faults) == 1, f"{len(faults)} faults host_timeout")
    silent_ms = faults[0].detail / MS
    last = _last_fall(played) / MS
    seen = f"fault after {silent_ms:.2f} ms of silence, dark at {last:.1f}"
    tripped = played.tick_of(faults[0].tick) / MS
    expect(50 <= silent_ms <= 51 and last <= tripped + frame / MS, seen)
    expect(len(played.rises(PIN_LED)) >= AT_LEAST, f"{len(played.rises(PIN_LED))} flashes before")
    expect(board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.UNSAFE, f"{seen}, and it could be armed again")
    return seen


def _last_fall(played: Played) -> float:
    return max(played.falls(PIN_LED), default=0.0)


@promised("A commit while armed", "from slot 0 on, no flash of neither", PIN_SYNC, *LAMPS)
def a_commit_takes_force_at_slot_0(board: Board) -> str:
    arm(board, ratio=4, period=FAST, delay=30_000, width=20_000)
    ok(board, configuration(ratio=4, period=FAST, delay=35_000, width=15_000, generation=2))
    edges = frames(60, FAST)
    scene = Scene(until=int(edges[-1]) + FAST, edges=camera(edges), watch=LAMPS, orders=[(20 * MS, Commit(2))])
    played = board.play(scene)
    reported = played.heard(Edge)
    expect(len(reported) == len(edges), f"{len(reported)} of {len(edges)} edges reported")
    fresh = [e.generation == 2 for e in reported]
    begins = fresh.index(True) if True in fresh else -1
    expect(begins > 0 and all(fresh[begins:]) and reported[begins].slot == 0, f"in force at edge {begins}")
    delays = [35_000 if f else 30_000 for f in fresh]
    beyond = [r - e - d for (r, _), e, d in zip(lit(played), played.falls_played(PIN_SYNC), delays, strict=True)]
    seen = f"delay + {span(beyond)}"
    expect(all_near(board, beyond, LATENCY), seen)
    widths = {PIN_PROJECTOR: played.widths(PIN_PROJECTOR), PIN_LED: played.widths(PIN_LED)}
    both = sorted(round(w, -2) for each in widths.values() for w in each)
    expect(set(both) == {15_000, 20_000}, f"{seen}, widths {sorted(set(both))}")
    return f"{seen} on both sides of it"
