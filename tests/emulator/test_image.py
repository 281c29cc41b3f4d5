"""Promises of the image a user flashes, read off its pins in ticks: start, lamps, odometer, turntable, line."""

import itertools
import random
import subprocess
from pathlib import Path

import pytest
from emulated import BOOTED, LATENCY, MS, ROOT, ROUND_MAX, EmulatedBoard, EmulatorFault, arm, edges_from, lamps_after

from annulus_pipe.controller import (
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_PROJECTOR,
    PIN_STEP,
    PIN_SYNC,
    PIN_TRIGGER,
    TURNTABLE_LAG_MS,
    TURNTABLE_LEAD_MS,
)
from annulus_pipe.link.codec import Frame, encode
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    BootCause,
    Booted,
    Burst,
    BurstCode,
    BurstReply,
    Edge,
    EdgeFlag,
    Lamp,
    Move,
    Ping,
    PingReply,
    Status,
    StatusCode,
    StatusReply,
    TurntableDone,
)

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
    for edge in edges_from(board, 2):
        board.pulse(edge)
    board.run(board.now + 6_000_000)
    assert [pin for _, pin, _ in board.transitions if pin != PIN_ENABLE] == []
    assert board.rises(PIN_ENABLE) != []


def test_budgets_hold_and_the_stack_has_room(image: Path, board: EmulatedBoard) -> None:
    arm(board, ArmFlag.LAMPS)
    for edge in edges_from(board, 2):
        board.pulse(edge)
    board.run_alive(board.now + 8_000_000)
    size = subprocess.run(
        ["arm-none-eabi-size", "-A", str(image.with_suffix(".elf"))], capture_output=True, text=True, check=True
    ).stdout
    sections = {line.split()[0]: int(line.split()[1]) for line in size.splitlines() if line.startswith(".")}
    application = sections[".text"]
    ram = application + sections[".bss"] + sections[".noinit"]
    longest = board.rounds[0]
    print(f"application {application} of 65536, RAM {ram} of 98304, stack {board.stack} of 1024 bytes")
    print(f"loader {sections['.loader']} of 4096 bytes, longest round {longest / 100:.0f} of 500 us")
    print(f"the controller's clock starts {board.origin / MS:.1f} ms after power, of {BOOTED / MS:.0f}")
    assert board.origin <= BOOTED
    assert application <= 64 * 1024
    assert ram <= 96 * 1024
    assert sections[".loader"] <= 4096
    assert board.stack <= 1024
    assert longest <= ROUND_MAX


@pytest.mark.deep(gate="tests/emulator/test_image.py::test_budgets_hold_and_the_stack_has_room")
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


# ---- sync and lamps ----


@pytest.mark.deep(gate="tests/emulator/test_image.py::test_no_jitter_under_a_flood_and_a_burst_train")
def test_a_lamp_follows_its_edge_by_its_delay_and_one_constant(board: EmulatedBoard) -> None:
    arm(board, ratio=0, delay=300_000, width=123_457)
    edges = edges_from(board, 50)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 2_000_000)
    rises, falls = board.rises(PIN_LED), board.falls(PIN_LED)
    assert {rise - edge for rise, edge in zip(rises, edges, strict=True)} == {300_000 + LATENCY}
    assert {fall - rise for fall, rise in zip(falls, rises, strict=True)} == {123_457}


@pytest.mark.deep(gate="tests/emulator/test_image.py::test_no_jitter_under_a_flood_and_a_burst_train")
@pytest.mark.parametrize(("delay", "width"), [(50_000, 100), (0, 2), (0, 1_000_000), (1, 3), (1_234_567, 2_000_000)])
def test_delays_and_widths_are_exact(board: EmulatedBoard, delay: int, width: int) -> None:
    period = 1_000_000 if delay + 2 * width < 400_000 else 8_000_000
    arm(board, ratio=1, period=period, delay=delay, width=width)
    edges = edges_from(board, 6, period)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 2 * delay + 2 * width + MS)
    rises = sorted(board.rises(PIN_PROJECTOR) + board.rises(PIN_LED))
    falls = sorted(board.falls(PIN_PROJECTOR) + board.falls(PIN_LED))
    assert [rise - edge - LATENCY for rise, edge in zip(rises, edges, strict=True)] == [delay] * 6
    assert [fall - rise for fall, rise in zip(falls, rises, strict=True)] == [width] * 6


@pytest.mark.deep(gate="tests/emulator/test_image.py::test_no_jitter_under_a_flood_and_a_burst_train")
@pytest.mark.parametrize("ratio", [0, 1, 4, 15])
def test_lamps_come_in_their_order(board: EmulatedBoard, ratio: int) -> None:
    arm(board, ratio=ratio, period=1_000_000, width=100_000, led_width=50_000)
    edges = edges_from(board, 2 * (ratio + 1) + 1, 1_000_000)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 2_000_000)
    expected = [PIN_LED if i % (ratio + 1) == ratio else PIN_PROJECTOR for i in range(len(edges))]
    assert lamps_after(board, edges) == expected
    reported = board.heard(Edge)
    assert [edge.slot for edge in reported] == [i % (ratio + 1) for i in range(len(edges))]
    assert [edge.lamp for edge in reported] == [Lamp.LED if pin == PIN_LED else Lamp.PROJECTOR for pin in expected]
    for pin, width in ((PIN_PROJECTOR, 100_000), (PIN_LED, 50_000)):
        assert set(board.widths(pin)) <= {width}


@pytest.mark.parametrize("count", [3, pytest.param(40, marks=pytest.mark.deep)])
def test_an_edge_is_stamped_to_the_tick_or_the_next(board: EmulatedBoard, count: int) -> None:
    arm(board, period=1_000_000)
    edges = edges_from(board, count, 1_000_000)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + MS)
    errors = {event.tick + board.origin - edge for event, edge in zip(board.heard(Edge), edges, strict=True)}
    assert errors <= {0, 1}


@pytest.mark.parametrize("count", [3, pytest.param(12, marks=pytest.mark.deep)])
def test_glitches_and_double_pulses_are_refused_counted_and_change_nothing(board: EmulatedBoard, count: int) -> None:
    arm(board, ratio=1, tolerance=100)
    edges = edges_from(board, count)
    rng = random.Random(3)
    refused = 0
    for edge in edges:
        board.pulse(edge, low=300)
        for at in (edge + 1_000, edge + rng.randrange(2_000, 3_500_000)):  # the hold-off is 3.6 M ticks
            board.pulse(at, low=rng.choice((1, 2, 3, 100, 400)))
            refused += 1
    board.run_alive(edges[-1] + 3_900_000)
    rises = sorted(board.rises(PIN_PROJECTOR) + board.rises(PIN_LED))
    assert [rise - edge for rise, edge in zip(rises, edges, strict=True)] == [300_000 + LATENCY] * count
    assert [event.flags & EdgeFlag.LATE_LOAD for event in board.heard(Edge)] == [0] * count
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert status.edges == count
    assert status.rejected == refused


@pytest.mark.deep(
    gate="tests/emulator/test_image.py::test_glitches_and_double_pulses_are_refused_counted_and_change_nothing"
)
def test_the_hold_off_ends_where_it_is_said_to(board: EmulatedBoard) -> None:
    arm(board, ratio=0, period=400_000, tolerance=100, delay=50_000, width=20_000)
    edge = board.now + 2 * MS
    accepted = {}
    for off in (-40, -6, -4, -3, 3, 4, 6, 40):
        before = len(board.rises(PIN_LED))
        board.pulse(edge, low=1_000)
        board.pulse(edge + 360_000 + off, low=1_000)
        board.run_alive(edge + 800_000)
        accepted[off] = len(board.rises(PIN_LED)) - before == 2
        edge = board.now + 5 * MS
    assert accepted == {off: off > 0 for off in accepted}


def test_disarming_ends_the_flash_being_timed(board: EmulatedBoard) -> None:
    arm(board, ratio=0, width=2_000_000, period=8_000_000)
    edge = board.now + MS
    board.pulse(edge)
    board.run(edge + 500_000)
    assert len(board.rises(PIN_LED)) == 1
    board.request(Arm(outputs=ArmFlag(0)))
    assert 0 < board.falls(PIN_LED)[0] - board.rises(PIN_LED)[0] < 2_000_000 - 100_000
    board.pulse(edge + 8_000_000)
    board.run(edge + 12_000_000)
    assert len(board.rises(PIN_LED)) == 1


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
    fired = {tick: pin for pin in (PIN_PROJECTOR, PIN_LED) for tick in board.rises(pin)}
    late = 0
    for event, edge in zip(reported, edges, strict=True):
        pin = fired.pop(edge + 50_000 + LATENCY, None)
        if event.flags & EdgeFlag.LATE_LOAD:
            late += 1
            assert pin is None
            assert event.lamp == Lamp.DARK
        else:
            assert pin == (PIN_LED if event.lamp == Lamp.LED else PIN_PROJECTOR)
            assert event.slot == (1 if pin == PIN_LED else 0)
    assert fired == {}
    assert 1 <= late <= 3


# The lamps' machines look for an edge in a loop of a few cycles, and the order repeats after 5 edges: 75 edges of which
# the i-th is 7 i ticks (mod 13) off meet every slot in every phase, as the machine is deterministic. What the flood and
# the processor add is random: 20 000 edges, 40 s of virtual time, are deep.
@pytest.mark.timeout(900)
@pytest.mark.parametrize("edge_count", [75, pytest.param(20_000, marks=pytest.mark.deep)])
def test_no_jitter_under_a_flood_and_a_burst_train(board: EmulatedBoard, edge_count: int) -> None:
    period, delay, width = 200_000, 30_000, 20_000  # 500 Hz, the fastest
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=4, period=period, delay=delay, width=width)
    burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=60_000, period=70_000, trigger_offset=-25)
    start = board.request(burst)
    assert isinstance(start, BurstReply)
    assert start.status == StatusCode.OK
    rng = random.Random(7)
    first = board.now + MS
    edges = [first + i * period + i * 7 % 13 + 13 * rng.randrange(-4, 4) for i in range(edge_count)]
    for begin in range(0, edge_count, 250):
        some = edges[begin : begin + 250]
        board.input(*[item for edge in some for item in ((edge, PIN_SYNC, 0), (edge + 3_000, PIN_SYNC, 1))])
        for edge in some[::25]:
            for _ in range(50):  # noise at line speed, real commands in between
                board.write(encode(Frame(Status(), rng.randrange(256))) + rng.randbytes(80) + b"\0")
            board.run(edge + 24 * period)
    board.run(edges[-1] + period)
    rises = sorted(board.rises(PIN_PROJECTOR) + board.rises(PIN_LED))
    assert {rise - edge for rise, edge in zip(rises, edges, strict=True)} == {delay + LATENCY}
    falls = sorted(board.falls(PIN_PROJECTOR) + board.falls(PIN_LED))
    assert {fall - rise for fall, rise in zip(falls, rises, strict=True)} == {width}
    assert lamps_after(board, edges) == [PIN_LED if i % 5 == 4 else PIN_PROJECTOR for i in range(edge_count)]
    chip0 = board.rises(PIN_MICROWAVE)[0]
    assert {(tick - chip0) % 70_000 % 50 for tick in board.rises(PIN_MICROWAVE) + board.falls(PIN_MICROWAVE)} == {0}
    assert {(tick - chip0) % 70_000 for tick in board.rises(PIN_TRIGGER)} == {70_000 - 25}
    assert len(board.sent) > 0.4 * (board.now - first) / 1_000  # the line out was busy as well
    assert board.resets == []


# ---- odometer, turntable, line ----


@pytest.mark.deep(
    gate="tests/emulator/test_image_odometer.py::test_any_motion_is_exact_at_every_edge_while_the_host_asks_and_asks"
)
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
                for pin, old, level in zip((PIN_ODOMETER_A, PIN_ODOMETER_B), before, gray[at % 4], strict=True)
                if old != level
            ]
        now += 200_000
        board.input(*steps, (now, PIN_SYNC, 0), (now + 1_000, PIN_SYNC, 1))
        expected.append(count)
        now += 2_000
        board.run(now)
    board.run(now + 2 * MS)
    assert [edge.odometer for edge in board.heard(Edge)] == expected


def test_the_turntable_makes_its_steps_and_lets_go(board: EmulatedBoard) -> None:
    board.identify()
    assert board.request(Move(position=25, period=20_000, hold=0)).status == StatusCode.OK
    board.run(board.now + 7 * MS + TURNTABLE_LEAD_MS * MS)
    assert [event.position for event in board.heard(TurntableDone)] == [25]
    rises = board.rises(PIN_STEP)
    assert len(rises) == 25
    assert {abs(later - earlier - 20_000) for earlier, later in itertools.pairwise(rises)} <= {0, 1, 2}
    assert board.rises(PIN_DIRECTION) != []
    board.run(board.now + TURNTABLE_LAG_MS * MS)
    assert board.rises(PIN_ENABLE)[-1] > rises[-1]
    assert board.request(Move(position=20, period=10_000, hold=1)).status == StatusCode.OK
    board.run(board.now + 2 * MS + TURNTABLE_LEAD_MS * MS)
    assert len(board.rises(PIN_STEP)) == 30
    assert [event.position for event in board.heard(TurntableDone)] == [25, 20]
    assert board.falls(PIN_DIRECTION) != []
    assert board.falls(PIN_ENABLE)[-1] > board.rises(PIN_ENABLE)[-1]


def test_a_ping_returns_the_time_its_last_byte_was_taken(board: EmulatedBoard) -> None:
    board.identify()
    sent = board.now
    reply = board.request(Ping())
    assert isinstance(reply, PingReply)
    arrived = sent + 1_000 * 6  # bytes of a ping on the line
    assert 0 <= reply.tick + board.origin - arrived <= 20_000


@pytest.mark.deep(gate="tests/emulator/test_image.py::test_no_jitter_under_a_flood_and_a_burst_train")
def test_event_sequences_have_no_gap(board: EmulatedBoard) -> None:
    arm(board)
    for edge in edges_from(board, 6):
        board.pulse(edge)
    board.run_alive(board.now + 25_000_000)
    assert board.event_sequences == list(range(len(board.events)))
    assert len(board.heard(Edge)) == 6


# ---- last: the emulator is lost with it, and the next has to warm up ----


def test_an_image_with_a_damaged_second_stage_does_not_start(image: Path, tmp_path: Path) -> None:
    bytes_ = bytearray(image.read_bytes())
    bytes_[40] ^= 1
    damaged = tmp_path / "damaged.uf2"
    damaged.write_bytes(bytes_)
    with pytest.raises((EmulatorFault, BrokenPipeError)):
        EmulatedBoard(damaged).run(1)
