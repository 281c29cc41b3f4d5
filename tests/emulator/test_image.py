"""Promises of the image a user flashes, read off its pins in ticks of 10 ns."""

import itertools
import random
import subprocess
from pathlib import Path

import pytest
from emulated import (
    BOOTED,
    DIRECTION,
    ENABLE,
    INTERLOCK,
    LED,
    MICROWAVE,
    MS,
    ODOMETER_A,
    ODOMETER_B,
    PROJECTOR,
    ROOT,
    STATUS,
    STEP,
    SYNC,
    TRIGGER,
    EmulatedBoard,
    EmulatorFault,
    configuration,
)

from annulus.link.codec import Frame, encode
from annulus.link.messages import (
    Arm,
    ArmFlag,
    BootCause,
    Booted,
    Bootloader,
    Burst,
    BurstCode,
    BurstDone,
    BurstReply,
    BurstStop,
    Clear,
    Commit,
    Edge,
    EdgeFlag,
    Fault,
    FaultCode,
    Lamp,
    Move,
    Pattern,
    Ping,
    PingReply,
    Reset,
    StageDone,
    Status,
    StatusCode,
    StatusReply,
)

LATENCY = 9  # from the pin's edge to the lamp's, beyond the programmed delay: the constant of the README
PERIOD = 4_000_000
OUTPUTS = (PROJECTOR, LED, MICROWAVE, TRIGGER)


def arm(board: EmulatedBoard, outputs: ArmFlag = ArmFlag.LAMPS, **changes: int) -> None:
    board.identify()
    for command in (configuration(**changes), Commit(generation=changes.get("generation", 1)), Arm(outputs=outputs)):
        assert board.request(command).status == StatusCode.OK


def edges_from(board: EmulatedBoard, count: int, period: int = PERIOD, jitter: int = 13) -> list[int]:
    """Edges one period apart but for a few ticks, so that every phase of the state machines meets one."""
    first = board.now + MS
    return [first + i * period + (i * 7) % jitter for i in range(count)]


def lamps_after(board: EmulatedBoard, edges: list[int]) -> list[int]:
    """Which lamp rose after each edge, and nothing else may have."""
    rises = sorted((tick, pin) for pin in (PROJECTOR, LED) for tick in board.rises(pin))
    assert len(rises) == len(edges)
    return [pin for _, pin in rises]


# ---- start ----


def test_it_boots_through_its_second_stage_and_says_who_it_is(board: EmulatedBoard) -> None:
    who = board.identify()
    assert who.status == StatusCode.OK
    assert who.board == b"rp2040\0\0"
    assert who.tick_hz == 100_000_000
    assert who.cause == BootCause.POWER_ON
    assert [event.cause for event in board.heard(Booted)] == [BootCause.POWER_ON]
    assert board.bad == 0


def test_every_output_is_low_until_something_is_armed(board: EmulatedBoard) -> None:
    board.identify()
    for edge in edges_from(board, 3):
        board.pulse(edge)
    board.run(board.now + 14_000_000)
    assert [pin for _, pin, _ in board.transitions if pin != ENABLE] == []
    assert board.rises(ENABLE) != []


def test_budgets_hold_and_the_stack_has_room(image: Path, board: EmulatedBoard) -> None:
    arm(board, ArmFlag.LAMPS)
    for edge in edges_from(board, 5):
        board.pulse(edge)
    board.run_alive(board.now + 24_000_000)
    size = subprocess.run(
        ["arm-none-eabi-size", "-A", str(image.with_suffix(".elf"))], capture_output=True, text=True, check=True
    ).stdout
    sections = {line.split()[0]: int(line.split()[1]) for line in size.splitlines() if line.startswith(".")}
    flash = sections[".boot2"] + sections[".text"] + sections.get(".data", 0)
    ram = sections.get(".data", 0) + sections[".bss"]
    print(f"flash {flash} of 32768, static RAM {ram} of 8192, stack {board.stack} of 4096 bytes")
    assert flash <= 32 * 1024
    assert ram <= 8 * 1024
    assert board.stack <= 2048


def test_the_same_source_makes_the_same_bytes(tmp_path: Path) -> None:
    made = []
    for name in ("one", "two"):
        build = tmp_path / name
        subprocess.run(
            ["make", "--silent", "-C", str(ROOT / "firmware"), "image", f"BUILD={build}"],
            check=True,
            stdout=subprocess.DEVNULL,
        )
        made.append([(build / f"annulus.{kind}").read_bytes() for kind in ("uf2", "elf")])
    assert made[0] == made[1]


def test_an_image_with_a_damaged_second_stage_does_not_start(image: Path, tmp_path: Path) -> None:
    bytes_ = bytearray(image.read_bytes())
    bytes_[40] ^= 1
    damaged = tmp_path / "damaged.uf2"
    damaged.write_bytes(bytes_)
    with pytest.raises((EmulatorFault, BrokenPipeError)):
        EmulatedBoard(damaged).run(1)


# ---- sync and lamps ----


def test_a_lamp_follows_its_edge_by_its_delay_and_one_constant(board: EmulatedBoard) -> None:
    arm(board, ratio=0, delay=300_000, width=123_457)
    edges = edges_from(board, 50)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 2_000_000)
    rises, falls = board.rises(LED), board.falls(LED)
    assert {rise - edge for rise, edge in zip(rises, edges, strict=True)} == {300_000 + LATENCY}
    assert {fall - rise for fall, rise in zip(falls, rises, strict=True)} == {123_457}


@pytest.mark.parametrize(("delay", "width"), [(0, 2), (0, 1_000_000), (1, 3), (50_000, 100), (1_234_567, 2_000_000)])
def test_delays_and_widths_are_exact(board: EmulatedBoard, delay: int, width: int) -> None:
    arm(board, ratio=1, period=8_000_000, delay=delay, width=width)
    edges = edges_from(board, 6, 8_000_000)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 5_000_000)
    rises = sorted(board.rises(PROJECTOR) + board.rises(LED))
    falls = sorted(board.falls(PROJECTOR) + board.falls(LED))
    assert [rise - edge - LATENCY for rise, edge in zip(rises, edges, strict=True)] == [delay] * 6
    assert [fall - rise for fall, rise in zip(falls, rises, strict=True)] == [width] * 6


@pytest.mark.parametrize("ratio", [0, 1, 4, 15])
def test_lamps_come_in_their_order(board: EmulatedBoard, ratio: int) -> None:
    arm(board, ratio=ratio, width=100_000, led_width=50_000)
    edges = edges_from(board, 2 * (ratio + 1) + 1)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 2_000_000)
    expected = [LED if i % (ratio + 1) == ratio else PROJECTOR for i in range(len(edges))]
    assert lamps_after(board, edges) == expected
    reported = board.heard(Edge)
    assert [edge.slot for edge in reported] == [i % (ratio + 1) for i in range(len(edges))]
    assert [edge.lamp for edge in reported] == [Lamp.LED if pin == LED else Lamp.PROJECTOR for pin in expected]
    for pin, width in ((PROJECTOR, 100_000), (LED, 50_000)):
        assert {fall - rise for fall, rise in zip(board.falls(pin), board.rises(pin), strict=True)} <= {width}


def test_an_edge_is_stamped_to_the_tick_or_the_next(board: EmulatedBoard) -> None:
    arm(board)
    edges = edges_from(board, 40)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + MS * 10)
    errors = {event.tick + board.origin - edge for event, edge in zip(board.heard(Edge), edges, strict=True)}
    assert errors <= {0, 1}


def test_glitches_and_double_pulses_are_refused_counted_and_change_nothing(board: EmulatedBoard) -> None:
    arm(board, ratio=1, tolerance=100)
    edges = edges_from(board, 12)
    rng = random.Random(3)
    refused = 0
    for edge in edges:
        board.pulse(edge, low=300)
        for at in (edge + 1_000, edge + rng.randrange(2_000, 3_500_000)):  # the hold-off is 3.6 M ticks
            board.pulse(at, low=rng.choice((1, 2, 3, 100, 400)))
            refused += 1
    board.run_alive(edges[-1] + 3_900_000)
    rises = sorted(board.rises(PROJECTOR) + board.rises(LED))
    assert [rise - edge for rise, edge in zip(rises, edges, strict=True)] == [300_000 + LATENCY] * 12
    assert [event.flags & EdgeFlag.LATE_LOAD for event in board.heard(Edge)] == [0] * 12
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert status.edges == 12
    assert status.rejected == refused


def test_the_hold_off_ends_where_it_is_said_to(board: EmulatedBoard) -> None:
    arm(board, ratio=0, period=400_000, tolerance=100, delay=50_000, width=20_000)
    edge = board.now + 2 * MS
    accepted = {}
    for off in (-40, -6, -4, -3, 3, 4, 6, 40):
        before = len(board.rises(LED))
        board.pulse(edge, low=1_000)
        board.pulse(edge + 360_000 + off, low=1_000)
        board.run_alive(edge + 800_000)
        accepted[off] = len(board.rises(LED)) - before == 2
        edge = board.now + 5 * MS
    assert accepted == {off: off > 0 for off in accepted}


def test_disarming_ends_the_flash_being_timed(board: EmulatedBoard) -> None:
    arm(board, ratio=0, width=2_000_000, period=8_000_000)
    edge = board.now + MS
    board.pulse(edge)
    board.run(edge + 500_000)
    assert len(board.rises(LED)) == 1
    board.request(Arm(outputs=ArmFlag(0)))
    assert 0 < board.falls(LED)[0] - board.rises(LED)[0] < 2_000_000 - 100_000
    board.pulse(edge + 8_000_000)
    board.run(edge + 12_000_000)
    assert len(board.rises(LED)) == 1


def test_a_stalled_processor_costs_a_dark_frame_and_never_a_wrong_one(board: EmulatedBoard) -> None:
    arm(board, ratio=1, period=400_000, delay=50_000, width=20_000)
    edges = edges_from(board, 40, 400_000, jitter=1)
    for edge in edges:
        board.pulse(edge, low=1_000)
    board.run(edges[9] + 300_000)
    board.stall(1_000_000)  # 10 ms: the flash loaded for edge 10 fires, 11 and 12 find none
    board.run_alive(edges[-1] + 300_000, every=2 * MS)
    reported = board.heard(Edge)
    assert len(reported) == len(edges)
    fired = {tick: pin for pin in (PROJECTOR, LED) for tick in board.rises(pin)}
    late = 0
    for event, edge in zip(reported, edges, strict=True):
        pin = fired.pop(edge + 50_000 + LATENCY, None)
        if event.flags & EdgeFlag.LATE_LOAD:
            late += 1
            assert pin is None
            assert event.lamp == Lamp.DARK
        else:
            assert pin == (LED if event.lamp == Lamp.LED else PROJECTOR)
            assert event.slot == (1 if pin == LED else 0)
    assert fired == {}
    assert 1 <= late <= 3


@pytest.mark.timeout(900)  # 40 virtual seconds, both directions busy: a minute and a half of a free core
@pytest.mark.parametrize("edge_count", [20_000])
def test_no_jitter_under_a_flood_and_a_burst_train(board: EmulatedBoard, edge_count: int) -> None:
    period, delay, width = 200_000, 30_000, 20_000  # 500 Hz, the fastest
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=4, period=period, delay=delay, width=width)
    burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=60_000, period=70_000, trigger_offset=-25)
    start = board.request(burst)
    assert isinstance(start, BurstReply)
    assert start.status == StatusCode.OK
    rng = random.Random(7)
    first = board.now + MS
    edges = [first + i * period + rng.randrange(-50, 50) for i in range(edge_count)]
    for begin in range(0, edge_count, 250):
        some = edges[begin : begin + 250]
        board.input(*[item for edge in some for item in ((edge, SYNC, 0), (edge + 3_000, SYNC, 1))])
        for edge in some[::25]:
            for _ in range(50):  # noise at line speed, real commands in between
                board.write(encode(Frame(Status(), rng.randrange(256))) + rng.randbytes(80) + b"\0")
            board.run(edge + 24 * period)
    board.run(edges[-1] + period)
    rises = sorted(board.rises(PROJECTOR) + board.rises(LED))
    assert {rise - edge for rise, edge in zip(rises, edges, strict=True)} == {delay + LATENCY}
    falls = sorted(board.falls(PROJECTOR) + board.falls(LED))
    assert {fall - rise for fall, rise in zip(falls, rises, strict=True)} == {width}
    assert lamps_after(board, edges) == [LED if i % 5 == 4 else PROJECTOR for i in range(edge_count)]
    chip0 = board.rises(MICROWAVE)[0]
    assert {(tick - chip0) % 70_000 % 50 for tick in board.rises(MICROWAVE) + board.falls(MICROWAVE)} == {0}
    assert {(tick - chip0) % 70_000 for tick in board.rises(TRIGGER)} == {70_000 - 25}
    assert len(board.sent) > 0.4 * (board.now - first) / 1_000  # the line out was busy as well
    assert board.resets == []


# ---- microwave ----

CODES = {
    BurstCode.SINGLE: "1",
    BurstCode.MPSL25: "1001001010100000011100111",
    BurstCode.MPSL25_STUFFED: "10000010000010001000100000000000001010100000101010",
    BurstCode.BARKER13: "1111100110101",
    BurstCode.MANCHESTER1: "0101011010010101100110100110011001101001011001010101",
    BurstCode.MANCHESTER2: "0101010110010110100110010101010110011010100101101010",
}


def played(board: EmulatedBoard, chip0: int, chip: int, length: int) -> str:
    """What stands on the pin in the middle of each chip; the edges are checked to be on the grid."""
    changes = [(tick, level) for tick, pin, level in board.transitions if pin == MICROWAVE]
    assert {(tick - chip0) % chip for tick, _ in changes if chip0 <= tick <= chip0 + chip * length} <= {0}
    level, bits, at = 0, [], 0
    for index in range(length):
        while at < len(changes) and changes[at][0] <= chip0 + chip * index + chip // 2:
            level = changes[at][1]
            at += 1
        bits.append(str(level))
    return "".join(bits)


@pytest.mark.parametrize("code", list(CODES), ids=lambda code: code.name)
@pytest.mark.parametrize("offset", [0, 1, -1, 123, -777])
def test_a_code_is_played_as_it_is_written(board: EmulatedBoard, code: BurstCode, offset: int) -> None:
    arm(board, ArmFlag.MICROWAVE)
    command = Burst(code=code, chip=50, repeat=3, period=100_000, trigger_offset=offset)
    reply = board.request(command)
    assert isinstance(reply, BurstReply)
    assert reply.status == StatusCode.OK
    board.run(board.now + 5 * MS)
    chip0 = reply.start + board.origin
    for burst in range(3):
        assert played(board, chip0 + 100_000 * burst, 50, len(CODES[code])) == CODES[code]
    assert board.rises(TRIGGER) == [chip0 + offset + 100_000 * burst for burst in range(3)]
    assert {fall - rise for fall, rise in zip(board.falls(TRIGGER), board.rises(TRIGGER), strict=True)} == {100}
    assert [done.done for done in board.heard(BurstDone)] == [3]


LAGS = range(-24, 25)


def correlate(sent: list[int], template: list[int]) -> list[int]:
    return [sum(sent[i] * template[i - lag] for i in range(25) if 0 <= i - lag < 25) for lag in LAGS]


def test_mpsl25_against_its_template_has_its_peak_and_the_sidelobes_of_theory(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.MICROWAVE)
    reply = board.request(Burst(code=BurstCode.MPSL25, chip=50, repeat=1, period=100_000, trigger_offset=0))
    assert isinstance(reply, BurstReply)
    board.run(board.now + 3 * MS)
    sent = [int(bit) for bit in played(board, reply.start + board.origin, 50, 25)]
    template = [1 if bit == "1" else -1 for bit in CODES[BurstCode.MPSL25]]
    correlation = correlate(sent, template)
    # sent = (template + 1) / 2, so theory says: half of the template's own correlation and of its sum under the overlap
    own = correlate(template, template)
    under = correlate([1] * 25, template)
    assert [2 * value for value in correlation] == [a + b for a, b in zip(own, under, strict=True)]
    assert max(abs(value) for lag, value in zip(LAGS, own, strict=True) if lag) == 2  # what makes the code an MPSL code
    assert correlation[24] == 11
    assert max(abs(value) for lag, value in zip(LAGS, correlation, strict=True) if lag) == 4  # ratio 2.75


@pytest.mark.parametrize(("chip", "width"), [(30, 30), (3_000, 3_000)])
def test_the_shortest_and_the_longest_pulse(board: EmulatedBoard, chip: int, width: int) -> None:
    arm(board, ArmFlag.MICROWAVE)
    reply = board.request(Burst(code=BurstCode.SINGLE, chip=chip, repeat=1000, period=100_000, trigger_offset=0))
    assert reply.status == StatusCode.OK
    board.run_alive(board.now + 1010 * MS, every=100 * MS)
    rises, falls = board.rises(MICROWAVE), board.falls(MICROWAVE)
    assert len(rises) == 1000
    assert {fall - rise for fall, rise in zip(falls, rises, strict=True)} == {width}
    assert {later - earlier for earlier, later in itertools.pairwise(rises)} == {100_000}
    assert [done.done for done in board.heard(BurstDone)] == [1000]


def test_uploaded_patterns_are_played_chip_by_chip(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.MICROWAVE)
    rng = random.Random(11)
    for length, density in ((1, 1.0), (8, 0.5), (129, 0.5), (255, 0.5), (256, 0.1), (256, 0.9)):
        bits = [1 if rng.random() < density else 0 for _ in range(length)]
        if length == 255:
            bits = [(i + 1) % 2 for i in range(length)]  # the most runs there can be
        chips = sum(bit << i for i, bit in enumerate(bits)).to_bytes(32, "little")
        assert board.request(Pattern(length=length, chips=chips)).status == StatusCode.OK
        period = max(20 * 30 * sum(bits), 31 * length) + 100
        board.transitions.clear()
        reply = board.request(Burst(code=BurstCode.UPLOADED, chip=30, repeat=2, period=period, trigger_offset=7))
        assert isinstance(reply, BurstReply)
        assert reply.status == StatusCode.OK
        board.run(board.now + 2 * period + 2 * MS)
        chip0 = reply.start + board.origin
        for burst in range(2):
            assert played(board, chip0 + burst * period, 30, length) == "".join(map(str, bits))
        assert board.rises(TRIGGER) == [chip0 + 7, chip0 + 7 + period]


def test_stopping_lets_the_burst_being_sent_end(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.MICROWAVE)
    assert (
        board.request(Burst(code=BurstCode.MPSL25, chip=50, repeat=1000, period=50_000, trigger_offset=0)).status == 0
    )
    board.run(board.now + 3 * MS)
    board.request(BurstStop())
    board.run(board.now + 3 * MS)
    [done] = board.heard(BurstDone)
    assert 3 <= done.done < 15
    assert len(board.rises(MICROWAVE)) == 7 * done.done
    assert len(board.falls(MICROWAVE)) == 7 * done.done


@pytest.mark.parametrize(("period", "offset"), [(11_000, 0), (11_000, -5_000), (50_000, 600), (300_000, -777)])
def test_a_train_stopped_at_any_moment_sends_whole_bursts_and_says_how_many(
    board: EmulatedBoard, period: int, offset: int
) -> None:
    arm(board, ArmFlag.MICROWAVE)
    rng = random.Random(period + offset)
    done = None
    for wait in (None, 0, *(rng.randrange(12 * period) for _ in range(4)), 13 * period):
        board.transitions.clear()
        board.events.clear()
        if wait is not None:  # first of all with no train at all
            burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=10, period=period, trigger_offset=offset)
            assert board.request(burst).status == StatusCode.OK
            board.run(board.now + wait)
        first = board.request(BurstStop())
        again = board.request(BurstStop())
        assert first.status == again.status == StatusCode.OK
        board.run(board.now + 12 * period + MS)
        reported = board.heard(BurstDone)
        assert len(reported) == (0 if wait is None else 1)
        done = reported[0].done if reported else 0
        assert len(board.rises(MICROWAVE)) == len(board.falls(MICROWAVE)) == 7 * done
        assert len(board.rises(TRIGGER)) == len(board.falls(TRIGGER)) == done
        assert {fall - rise for rise, fall in zip(board.rises(TRIGGER), board.falls(TRIGGER), strict=True)} <= {100}
    assert done == 10  # the last one had run out before it was stopped


def test_a_train_cut_by_the_interlock_counts_exactly_the_bursts_that_were_sent(board: EmulatedBoard) -> None:
    arm(board)
    rng = random.Random(12)
    for _ in range(100):
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
        board.transitions.clear()
        board.events.clear()
        burst = Burst(code=BurstCode.SINGLE, chip=500, repeat=60_000, period=10_000, trigger_offset=0)
        assert board.request(burst).status == StatusCode.OK
        opens = board.now + rng.randrange(1_000, 600_000)
        board.input((opens, INTERLOCK, 1), (opens + 100_000, INTERLOCK, 0))
        board.run(opens + 200_000)
        widths = [fall - rise for rise, fall in zip(board.rises(MICROWAVE), board.falls(MICROWAVE), strict=True)]
        [done] = board.heard(BurstDone)
        assert done.fault == FaultCode.INTERLOCK
        assert done.done == sum(width == 500 for width in widths)
        assert board.request(Clear()).status == StatusCode.OK


def test_an_open_interlock_cuts_within_one_chip_until_cleared_a_thousand_times(board: EmulatedBoard) -> None:
    arm(board)
    rng = random.Random(5)
    chip = 30
    worst = 0
    for _ in range(1000):
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
        burst = Burst(code=BurstCode.SINGLE, chip=3_000, repeat=2000, period=60_000, trigger_offset=0)
        assert board.request(burst).status == StatusCode.OK
        board.transitions.clear()
        opens = board.now + rng.randrange(1_000, 100_000)
        board.input((opens, INTERLOCK, 1), (opens + rng.choice((5, 100, 30_000)), INTERLOCK, 0))
        board.run(opens + 250_000)
        changes = [(tick, level) for tick, pin, level in board.transitions if pin == MICROWAVE]
        after = [(tick, level) for tick, level in changes if tick > opens]
        if after:
            assert [level for _, level in after] in ([0], [1, 0])
            worst = max(worst, after[-1][0] - opens)
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.UNSAFE
        assert board.request(Clear()).status == StatusCode.OK
    print(f"interlock to dark: {worst} ticks at most")
    assert worst <= chip
    assert {fault.fault for fault in board.heard(Fault)} == {FaultCode.INTERLOCK}


def test_microwave_cannot_be_armed_with_the_interlock_open(board: EmulatedBoard) -> None:
    arm(board)
    board.input((board.now + 10, INTERLOCK, 1))
    board.run(board.now + MS)
    board.request(Arm(outputs=ArmFlag(0)))
    board.request(Clear())
    assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.UNSAFE


# ---- safety ----


def test_a_silent_host_darkens_the_lamps_within_one_frame(board: EmulatedBoard) -> None:
    arm(board, ratio=0, period=1_000_000, delay=100_000, width=100_000, host_timeout=50)
    last_word = board.now
    edges = edges_from(board, 30, 1_000_000)
    for edge in edges:
        board.pulse(edge)
    board.run(edges[-1] + 1_000_000)
    assert board.falls(LED)[-1] <= last_word + 50 * MS + 1_000_000
    assert len(board.rises(LED)) >= 4
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.HOST_TIMEOUT]


def test_a_stuck_processor_is_reset_by_the_watchdog_with_all_outputs_low(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, width=2_000_000, period=8_000_000)
    before = board.identify().boot
    board.pulse(board.now + MS)
    assert (
        board.request(Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)).status
        == 0
    )
    stuck = board.now
    board.stall(200 * MS)
    board.run(stuck + 180 * MS)
    [reset] = board.resets
    assert stuck + 99 * MS <= reset <= stuck + 102 * MS
    assert [item for item in board.transitions if item[0] > reset and item[1] in OUTPUTS and item[2] == 1] == []
    last = {pin: level for _tick, pin, level in board.transitions}
    assert {last.get(pin, 0) for pin in OUTPUTS} == {0}
    board.run(stuck + 210 * MS)
    who = board.identify()
    assert who.cause == BootCause.WATCHDOG
    assert who.boot != before
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.WATCHDOG]
    assert board.request(Arm(outputs=ArmFlag.LAMPS)).status == StatusCode.UNSAFE


STARVED = 4 * MS  # from the processor's last round to microwave and trigger low, at most


@pytest.mark.parametrize("seed", range(6))
def test_a_stuck_processor_leaves_outputs_low_in_four_ms_and_through_the_reset(board: EmulatedBoard, seed: int) -> None:
    rng = random.Random(seed)
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, period=1_000_000, delay=100_000, width=200_000)
    for edge in (board.now + MS + i * 1_000_000 for i in range(30)):
        board.pulse(edge)
    burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=60_000, period=12_000, trigger_offset=100)
    assert board.request(burst).status == StatusCode.OK
    board.run(board.now + rng.randrange(1_000_000, 3_000_000))
    stuck = board.now
    board.stall(200 * MS)
    board.run(stuck + 180 * MS)
    [reset] = board.resets
    assert stuck < reset <= stuck + 102 * MS
    changes = {pin: [(tick, level) for tick, p, level in board.transitions if p == pin] for pin in OUTPUTS}
    for pin in (MICROWAVE, TRIGGER):
        last, level = changes[pin][-1]
        assert level == 0
        assert last <= stuck + STARVED
    # A flash under way ends by itself, and one more was loaded: it fires on its edge. Nothing after that.
    flashes = [tick for tick, level in changes[LED] if level == 1 and tick > stuck]
    assert len(flashes) <= 1
    assert changes[LED][-1][1] == 0
    assert changes[LED][-1][0] <= stuck + 1_000_000 + 100_000 + LATENCY + 200_000
    assert changes[PROJECTOR] == []
    board.run(stuck + 210 * MS)
    assert board.identify().cause == BootCause.WATCHDOG


def test_a_main_loop_late_by_more_than_its_credit_cuts_the_microwave_and_says_so(board: EmulatedBoard) -> None:
    rng = random.Random(8)
    arm(board)
    for _ in range(8):
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
        board.transitions.clear()
        board.events.clear()
        burst = Burst(code=BurstCode.SINGLE, chip=500, repeat=60_000, period=10_000, trigger_offset=0)
        assert board.request(burst).status == StatusCode.OK
        board.run(board.now + rng.randrange(100_000, 500_000))
        late = board.now
        board.stall(10 * MS)
        board.run(late + 15 * MS)
        assert late + STARVED // 2 - 10_000 <= board.falls(MICROWAVE)[-1] <= late + STARVED
        [done] = board.heard(BurstDone)
        assert done.fault == FaultCode.WATCHDOG
        widths = [fall - rise for rise, fall in zip(board.rises(MICROWAVE), board.falls(MICROWAVE), strict=True)]
        assert done.done == sum(width == 500 for width in widths)
        assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.WATCHDOG]
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.UNSAFE
        assert board.request(Clear()).status == StatusCode.OK
    assert board.resets == []


def test_a_reset_by_the_host_says_so(board: EmulatedBoard) -> None:
    arm(board, ratio=0)
    before = board.identify().boot
    assert board.request(Reset(magic=0x7E5E7B00)).status == StatusCode.OK
    board.run(board.now + 2 * BOOTED)
    who = board.identify()
    assert who.cause == BootCause.HOST_RESET
    assert who.boot == (before + 1) % 256
    assert [event.cause for event in board.heard(Booted)] == [BootCause.POWER_ON, BootCause.HOST_RESET]


def test_the_boot_loader_is_entered_by_its_rom_call_with_every_output_low(board: EmulatedBoard) -> None:
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, width=2_000_000, period=8_000_000)
    before = board.identify().boot
    burst = Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0)
    assert board.request(burst).status == StatusCode.OK
    assert board.request(Bootloader(magic=0x7E5EB007)).status == StatusCode.BAD_STATE
    assert board.request(Status()).status == StatusCode.OK
    assert board.bootloader is None
    assert board.request(Arm(outputs=ArmFlag(0))).status == StatusCode.OK
    assert board.request(Bootloader(magic=0x7E5E7B00)).status == StatusCode.OUT_OF_RANGE
    assert board.request(Bootloader(magic=0x7E5EB007)).status == StatusCode.OK
    board.run(board.now + 2 * MS)
    assert board.bootloader is not None
    assert board.bootloader["high"] == []
    assert board.bootloader["activity"] == 1 << STATUS
    assert board.bootloader["disabled"] == 0  # drive and PICOBOOT are both there
    rises = [tick for pin in OUTPUTS for tick in board.rises(pin)]
    assert max(rises) < board.bootloader["tick"]
    board.send(Ping())
    board.run(board.now + 50 * MS)
    board.leave_bootloader()
    board.run(board.now + BOOTED)
    who = board.identify()
    assert who.cause == BootCause.HOST_RESET
    assert who.boot == (before + 1) % 256


# ---- odometer, stage, line ----


def test_the_odometer_is_exact_at_every_edge(board: EmulatedBoard) -> None:
    board.identify()
    gray = [(1, 1), (0, 1), (0, 0), (1, 0)]  # A falls first: up, from both high
    now, at, count = board.now + MS, 0, 0
    board.run(now)
    expected = []
    rng = random.Random(2)
    for _ in range(30):
        direction = rng.choice((1, 1, -1))
        steps = []
        for _ in range(rng.randrange(1, 60)):
            before = gray[at % 4]
            at += direction
            count += direction
            now += rng.randrange(200, 4_000)
            steps += [
                (now, pin, level)
                for pin, old, level in zip((ODOMETER_A, ODOMETER_B), before, gray[at % 4], strict=True)
                if old != level
            ]
        now += 200_000
        board.input(*steps, (now, SYNC, 0), (now + 1_000, SYNC, 1))
        expected.append(count)
        now += 2_000
        board.run(now)
    board.run(now + 2 * MS)
    assert [edge.odometer for edge in board.heard(Edge)] == expected


def test_the_stage_makes_its_steps_and_lets_go(board: EmulatedBoard) -> None:
    board.identify()
    assert board.request(Move(position=25, period=20_000, hold=0)).status == StatusCode.OK
    board.run(board.now + 7 * MS)
    assert [event.position for event in board.heard(StageDone)] == [25]
    rises = board.rises(STEP)
    assert len(rises) == 25
    assert {abs(later - earlier - 20_000) for earlier, later in itertools.pairwise(rises)} <= {0, 1, 2}
    assert board.rises(DIRECTION) != []
    assert board.rises(ENABLE)[-1] > rises[-1]
    assert board.request(Move(position=20, period=10_000, hold=1)).status == StatusCode.OK
    board.run(board.now + 2 * MS)
    assert len(board.rises(STEP)) == 30
    assert [event.position for event in board.heard(StageDone)] == [25, 20]
    assert board.falls(DIRECTION) != []
    assert board.falls(ENABLE)[-1] > board.rises(ENABLE)[-1]


def test_a_ping_returns_the_time_its_last_byte_was_taken(board: EmulatedBoard) -> None:
    board.identify()
    sent = board.now
    reply = board.request(Ping())
    assert isinstance(reply, PingReply)
    arrived = sent + 1_000 * 7  # bytes of a ping on the line
    assert 0 <= reply.tick + board.origin - arrived <= 20_000


def test_event_sequences_have_no_gap(board: EmulatedBoard) -> None:
    arm(board)
    for edge in edges_from(board, 6):
        board.pulse(edge)
    board.run_alive(board.now + 25_000_000)
    assert board.event_sequences == list(range(len(board.events)))
    assert len(board.heard(Edge)) == 6
