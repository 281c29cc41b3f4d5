"""Bursts of the image a user flashes: chips, trigger, trains and what cuts them, read off its pins."""

import itertools
import random

import pytest
from emulated import MS, EmulatedBoard, arm

from annulus_pipe.controller import PIN_INTERLOCK, PIN_MICROWAVE, PIN_TRIGGER
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstDone,
    BurstReply,
    BurstStop,
    Clear,
    Fault,
    FaultCode,
    Pattern,
    StatusCode,
)

SEEN_TICKS = 4  # BOARD_INTERLOCK_SEEN_TICKS of board.h

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
    changes = [(tick, level) for tick, pin, level in board.transitions if pin == PIN_MICROWAVE]
    assert {(tick - chip0) % chip for tick, _ in changes if chip0 <= tick <= chip0 + chip * length} <= {0}
    level, bits, at = 0, [], 0
    for index in range(length):
        while at < len(changes) and changes[at][0] <= chip0 + chip * index + chip // 2:
            level = changes[at][1]
            at += 1
        bits.append(str(level))
    return "".join(bits)


@pytest.mark.deep(but=1)
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
    assert board.rises(PIN_TRIGGER) == [chip0 + offset + 100_000 * burst for burst in range(3)]
    assert set(board.widths(PIN_TRIGGER)) == {100}
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


@pytest.mark.parametrize(
    ("chip", "width", "count"),
    [
        (30, 30, 40),
        (3_000, 3_000, 40),
        pytest.param(30, 30, 1_000, marks=pytest.mark.deep),
        pytest.param(3_000, 3_000, 1_000, marks=pytest.mark.deep),
    ],
)
def test_the_shortest_and_the_longest_pulse(board: EmulatedBoard, chip: int, width: int, count: int) -> None:
    arm(board, ArmFlag.MICROWAVE)
    reply = board.request(Burst(code=BurstCode.SINGLE, chip=chip, repeat=count, period=100_000, trigger_offset=0))
    assert reply.status == StatusCode.OK
    board.run_alive(board.now + (count + 10) * MS, every=100 * MS)
    rises, falls = board.rises(PIN_MICROWAVE), board.falls(PIN_MICROWAVE)
    assert len(rises) == count
    assert {fall - rise for fall, rise in zip(falls, rises, strict=True)} == {width}
    assert {later - earlier for earlier, later in itertools.pairwise(rises)} == {100_000}
    assert [done.done for done in board.heard(BurstDone)] == [count]


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
        assert board.rises(PIN_TRIGGER) == [chip0 + 7, chip0 + 7 + period]


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
    assert len(board.rises(PIN_MICROWAVE)) == 7 * done.done
    assert len(board.falls(PIN_MICROWAVE)) == 7 * done.done


@pytest.mark.deep(but=1)
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
        assert len(board.rises(PIN_MICROWAVE)) == len(board.falls(PIN_MICROWAVE)) == 7 * done
        assert len(board.rises(PIN_TRIGGER)) == len(board.falls(PIN_TRIGGER)) == done
        assert set(board.widths(PIN_TRIGGER)) <= {100}
    assert done == 10  # the last one had run out before it was stopped


@pytest.mark.parametrize("times", [6, pytest.param(100, marks=pytest.mark.deep)])
def test_a_train_cut_by_the_interlock_counts_exactly_the_bursts_that_were_sent(
    board: EmulatedBoard, times: int
) -> None:
    arm(board)
    rng = random.Random(12)
    for _ in range(times):
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
        board.transitions.clear()
        board.events.clear()
        burst = Burst(code=BurstCode.SINGLE, chip=500, repeat=60_000, period=10_000, trigger_offset=0)
        assert board.request(burst).status == StatusCode.OK
        opens = board.now + rng.randrange(1_000, 600_000)
        board.input((opens, PIN_INTERLOCK, 1), (opens + 100_000, PIN_INTERLOCK, 0))
        board.run(opens + 200_000)
        widths = board.widths(PIN_MICROWAVE)
        [done] = board.heard(BurstDone)
        assert done.fault == FaultCode.INTERLOCK
        assert done.done == sum(width == 500 for width in widths)
        assert board.request(Clear()).status == StatusCode.OK


@pytest.mark.parametrize("times", [30, pytest.param(1_000, marks=pytest.mark.deep)])
def test_an_open_interlock_cuts_within_one_chip_until_cleared(board: EmulatedBoard, times: int) -> None:
    arm(board)
    rng = random.Random(5)
    chip = 30
    worst = 0
    for _ in range(times):
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
        burst = Burst(code=BurstCode.SINGLE, chip=3_000, repeat=2000, period=60_000, trigger_offset=0)
        assert board.request(burst).status == StatusCode.OK
        board.transitions.clear()
        opens = board.now + rng.randrange(1_000, 100_000)
        board.input((opens, PIN_INTERLOCK, 1), (opens + rng.choice((5, 100, 30_000)), PIN_INTERLOCK, 0))
        board.run(opens + 250_000)
        changes = [(tick, level) for tick, pin, level in board.transitions if pin == PIN_MICROWAVE]
        after = [(tick, level) for tick, level in changes if tick > opens]
        if after:
            assert [level for _, level in after] in ([0], [1, 0])
            worst = max(worst, after[-1][0] - opens)
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.UNSAFE
        assert board.request(Clear()).status == StatusCode.OK
    print(f"interlock to dark: {worst} ticks at most")
    assert worst <= chip
    assert {fault.fault for fault in board.heard(Fault)} == {FaultCode.INTERLOCK}


def start_shortest(board: EmulatedBoard) -> None:
    """A train whose pulses and triggers follow each other as closely as can be."""
    assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
    burst = Burst(code=BurstCode.SINGLE, chip=30, repeat=60_000, period=600, trigger_offset=200)
    assert board.request(burst).status == StatusCode.OK


@pytest.mark.parametrize("times", [120, pytest.param(2_000, marks=pytest.mark.deep)])
def test_nothing_rises_behind_an_open_interlock_while_the_core_asks(board: EmulatedBoard, times: int) -> None:
    """What the core forces upon GUARD takes a cycle in which it drives nothing: in 4 of 700 openings the next chip or
    trigger rose in it, for 10 ns."""
    arm(board)
    rng = random.Random(7)
    for number in range(times):
        start_shortest(board)
        board.transitions.clear()
        opens = board.now + rng.randrange(20_000, 40_000)
        board.input((opens, PIN_INTERLOCK, 1), (opens + 60_000, PIN_INTERLOCK, 0))
        board.run(opens + 70_000)
        both = (PIN_MICROWAVE, PIN_TRIGGER)
        rises = [tick - opens for tick, pin, level in board.transitions if pin in both and level]
        assert max(rises) <= 6, f"opening {number}"
        board.events.clear()
        assert board.request(Clear()).status == StatusCode.OK


@pytest.mark.deep(
    gate="tests/emulator/test_image_microwave.py::test_nothing_rises_behind_an_open_interlock_while_the_core_asks"
)
def test_nothing_rises_behind_an_interlock_that_opens_as_the_core_disarms(board: EmulatedBoard) -> None:
    """A jump forced upon GUARD just as it began to cut let a rise through: in 3 of 1200."""
    arm(board)
    rng = random.Random(3)
    both = (PIN_MICROWAVE, PIN_TRIGGER)
    for number in range(1200):
        start_shortest(board)
        board.run(board.now + rng.randrange(1000))
        board.send(Arm(outputs=ArmFlag(0)))
        board.run_to("board_microwave")
        board.transitions.clear()
        held_up = rng.randrange(600)
        board.stall(held_up)
        board.run(board.now + held_up)
        opens = board.now + number % 100
        board.input((opens, PIN_INTERLOCK, 1), (opens + 60_000, PIN_INTERLOCK, 0))
        board.run(opens + 70_000)
        rises = [tick - opens for tick, pin, level in board.transitions if pin in both and level]
        assert max(rises, default=0) <= 6, f"opening {number}"
        board.events.clear()
        board.request(Clear())


def test_the_shortest_bounce_that_hardware_cuts_and_that_a_shorter_one_is_cut_by_the_core(board: EmulatedBoard) -> None:
    """GUARD looks every second to fourth tick: 40 ns are seen at any phase, of 10 ns bounces some slip through."""
    arm(board)
    both = (PIN_MICROWAVE, PIN_TRIGGER)
    last: dict[int, list[int]] = {SEEN_TICKS: [], 1: []}
    for ticks, phase in itertools.product(last, range(8)):
        start_shortest(board)
        board.transitions.clear()
        opens = board.now + 20_000 + phase
        board.input((opens, PIN_INTERLOCK, 1), (opens + ticks, PIN_INTERLOCK, 0))
        board.run(opens + MS)
        last[ticks].append(max(tick - opens for tick, pin, level in board.transitions if pin in both and level))
        assert any(event.fault is FaultCode.INTERLOCK for event in board.events if isinstance(event, Fault))
        board.events.clear()
        assert board.request(Clear()).status == StatusCode.OK
    print(f"last rise after a bounce of 40 ns: {max(last[SEEN_TICKS])} ticks, of 10 ns: {max(last[1])}")
    assert max(last[SEEN_TICKS]) <= 8
    assert max(last[1]) <= MS // 2  # a round


def test_microwave_cannot_be_armed_with_the_interlock_open(board: EmulatedBoard) -> None:
    arm(board)
    board.input((board.now + 10, PIN_INTERLOCK, 1))
    board.run(board.now + MS)
    board.request(Arm(outputs=ArmFlag(0)))
    board.request(Clear())
    assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.UNSAFE


def test_the_last_pulse_of_a_train_that_fills_its_period_ends_by_itself(board: EmulatedBoard) -> None:
    """Seen to stay high for 81 us, until the main loop stopped the train: the list ended with the pulse."""
    arm(board, ArmFlag.MICROWAVE)
    burst = Burst(code=BurstCode.MPSL25, chip=50, repeat=4, period=18_428, trigger_offset=-17_178)
    assert board.request(burst).status == StatusCode.OK
    board.run_alive(board.now + 5 * MS)
    assert max(board.widths(PIN_MICROWAVE)) == 150
    assert board.widths(PIN_TRIGGER) == [100] * 4


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("call", range(24))
def test_a_main_loop_held_anywhere_counts_no_burst_the_guard_kept_dark(board: EmulatedBoard, call: int) -> None:
    """Held between the look at the guard and the look at the clock it told 7 bursts where 3 were sent."""
    arm(board, ArmFlag.MICROWAVE)
    burst = Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=20_000, trigger_offset=0)
    assert board.request(burst).status == StatusCode.OK
    board.run(board.now + MS)
    for _ in range(call + 1):
        board.run_to("board_tick")
    board.stall(10 * MS)
    board.run(board.now + 15 * MS)
    [done] = board.heard(BurstDone)
    assert done.done == len(board.widths(PIN_MICROWAVE))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("part", range(4))
def test_a_train_disarmed_at_any_tick_counts_every_burst_that_was_whole(board: EmulatedBoard, part: int) -> None:
    """The count was made first and the guard cut 100 ticks later: 31 told, 32 sent, and the trigger of the 34th."""
    arm(board)
    burst = Burst(code=BurstCode.SINGLE, chip=1838, repeat=40, period=36_760, trigger_offset=-34_922)
    for before in range(60 * part, 60 * part + 60, 3):
        assert board.request(Arm(outputs=ArmFlag.MICROWAVE)).status == StatusCode.OK
        board.transitions.clear()
        board.events.clear()
        assert board.request(burst).status == StatusCode.OK
        board.run(board.now + 2 * MS)
        board.send(Arm(outputs=ArmFlag(0)))
        board.run_to("board_microwave")
        ends = board.rises(PIN_MICROWAVE)[0] + 1838
        while ends - before <= board.now:
            ends += burst.period
        board.stall(ends - before - board.now)  # a burst ends so many ticks into the order
        board.run(board.now + 2 * MS)
        [done] = board.heard(BurstDone)
        assert done.fault == FaultCode.NONE
        assert done.done == sum(width == 1838 for width in board.widths(PIN_MICROWAVE)), before
        assert len(board.rises(PIN_TRIGGER)) <= done.done + 1
