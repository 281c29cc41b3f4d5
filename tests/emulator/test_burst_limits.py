"""What holds over many trains and however one ends, read off the pins: the duty limit over time, whole bursts only."""

import itertools
import random

import pytest
from emulated import BOOTED, MS, EmulatedBoard, arm

from annulus_pipe.controller import PIN_MICROWAVE, PIN_TRIGGER
from annulus_pipe.link.messages import (
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstDone,
    BurstReply,
    BurstStop,
    Clear,
    Command,
    Fault,
    FaultCode,
    Identify,
    Pattern,
    Reset,
    StatusCode,
)

LIMIT = 20  # at least so many ticks from a rise to a later one for every tick that the gate was high in between
MICROWAVE = 3  # `detail` of a fault


def worst_duty(board: EmulatedBoard) -> float:
    """On GP5, over any window from a rise to a later one."""
    rises, widths = board.rises(PIN_MICROWAVE), board.widths(PIN_MICROWAVE)
    on = [0, *itertools.accumulate(widths)]
    return max(
        ((on[b] - on[a]) / (rises[b] - rises[a]) for a in range(len(rises)) for b in range(a + 1, len(rises))),
        default=0.0,
    )


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(3))
def test_single_bursts_in_a_row_keep_the_duty_limit_whatever_happens_between_them(
    board: EmulatedBoard, seed: int
) -> None:
    """Single bursts of 30 us, one after the other, were all sent: 15.1 % on the pin with a limit of 5 %."""
    rng = random.Random(seed)
    arm(board, ArmFlag.MICROWAVE)
    single = Burst(code=BurstCode.SINGLE, chip=3_000, repeat=1, period=60_000, trigger_offset=0)
    again: list[Command] = [Clear(), Arm(outputs=ArmFlag.MICROWAVE)]
    for _ in range(150):
        board.send(single)
        if rng.random() < 0.3:
            board.send(Arm(outputs=ArmFlag(0)))
        for command in again:
            board.send(command)
        board.run(board.now + rng.choice((45_000, 60_000, 90_000)))
    board.run(board.now + 3 * MS)
    assert len(board.rises(PIN_MICROWAVE)) > 20
    assert worst_duty(board) <= 1 / LIMIT
    refusals = [reply for reply in board.replies if isinstance(reply, BurstReply) and reply.status == StatusCode.DUTY]
    assert len(refusals) > 20
    assert {reply.detail for reply in refusals} == {MICROWAVE}
    assert {(fault.fault, fault.detail) for fault in board.heard(Fault)} == {(FaultCode.LIMIT, MICROWAVE)}


def test_what_a_cut_burst_owes_is_paid_also_after_a_reset(board: EmulatedBoard) -> None:
    """64 pulses of 30 us owe 38 ms; disarming in the middle, clearing and a reset were three ways around that."""
    arm(board, ArmFlag.MICROWAVE)
    chips = bytes([0x55] * 16 + [0] * 16)
    dense = Burst(code=BurstCode.UPLOADED, chip=3_000, repeat=1, period=3_840_000, trigger_offset=0)
    assert board.request(Pattern(length=128, chips=chips)).status == StatusCode.OK
    first = board.request(dense)
    assert isinstance(first, BurstReply)
    assert first.status == StatusCode.OK
    for command in (Arm(outputs=ArmFlag(0)), Arm(outputs=ArmFlag.MICROWAVE)):
        assert board.request(command).status == StatusCode.OK
    cut = len(board.rises(PIN_MICROWAVE))
    assert 0 < cut < 64
    assert board.request(dense).status == StatusCode.DUTY
    board.request(Clear())
    board.request(Arm(outputs=ArmFlag.MICROWAVE))
    board.run(board.origin + first.start + dense.period)
    assert len(board.rises(PIN_MICROWAVE)) == cut
    assert board.request(dense).status == StatusCode.OK
    assert board.request(Reset(magic=0x7E5E7B00)).status == StatusCode.OK
    reset_at = board.now
    board.run(board.now + BOOTED)
    sent = len(board.rises(PIN_MICROWAVE))
    board.request(Identify(protocol=1, schema=SCHEMA_HASH))
    for command in (Pattern(length=128, chips=chips), Arm(outputs=ArmFlag.MICROWAVE)):
        assert board.request(command).status == StatusCode.OK
    assert board.request(dense).status == StatusCode.DUTY
    board.run(
        reset_at + 82 * MS
    )  # 76.8 from the reset itself, which comes when the answer is out: a start is dark, too
    assert len(board.rises(PIN_MICROWAVE)) == sent
    board.request(Clear())
    board.request(Arm(outputs=ArmFlag.MICROWAVE))
    assert board.request(dense).status == StatusCode.OK
    board.run(board.now + 5 * MS)
    assert len(board.rises(PIN_MICROWAVE)) == sent + 64
    assert set(board.widths(PIN_TRIGGER)) <= {100}


ALTERNATING = "10" * 128  # as many pulses as there can be
TRIPLES = "111000000" * 28  # of the shortest chips
RANDOM = "".join(random.Random(3).choices("10", [1, 4], k=250)) + "011100"


def changes_at(bits: str) -> tuple[list[int], list[int]]:
    """Chips at which the gate rises, and at which it falls."""
    rises = [i for i, bit in enumerate(bits) if bit == "1" and (i == 0 or bits[i - 1] == "0")]
    falls = [i + 1 for i, bit in enumerate(bits) if bit == "1" and bits[i + 1 : i + 2] != "1"]
    return rises, falls


def pattern(bits: str) -> Pattern:
    return Pattern(length=len(bits), chips=int(bits[::-1], 2).to_bytes(32, "little"))


def shortest(bits: str, chip: int) -> int:
    """Period by the limit of duty."""
    return max(LIMIT * chip * bits.count("1"), (len(bits) + 1) * chip, 600)


STOPPED = [
    *(("1", 30, 600, offset) for offset in (0, 1, 400, 498, 500, -3, -568, -570)),
    *(("0001", 30, 601, offset) for offset in (88, -481)),
    *(("1001001010100000011100111", 50, 50_000, offset) for offset in (600, 49_897, -777, -48_750)),
    *(("1", 3_000, 50_000_000, offset) for offset in (0, 49_990_000, 49_999_900, -40_000_000)),
    *((ALTERNATING, 30, shortest(ALTERNATING, 30), offset) for offset in (0, -5, -69_100, 76_700)),
    *((TRIPLES, 10, shortest(TRIPLES, 10), offset) for offset in (-20, 16_700)),
    *((RANDOM, 40, shortest(RANDOM, 40), offset) for offset in (-20, 20_000)),
    *(("0000", 10, 600, offset) for offset in (500, -560)),
]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("bits", "chip", "period", "offset"), STOPPED)
def test_a_train_stopped_at_any_moment_ends_with_a_whole_burst_and_nothing_waits(
    board: EmulatedBoard, bits: str, chip: int, period: int, offset: int
) -> None:
    """With a late trigger the main loop waited for up to a period: at 500 ms the watchdog reset the controller."""
    arm(board, ArmFlag.MICROWAVE)
    assert board.request(pattern(bits)).status == StatusCode.OK
    command = Burst(code=BurstCode.UPLOADED, chip=chip, repeat=60_000, period=period, trigger_offset=offset)
    rng = random.Random(f"{bits}{period}{offset}")
    rises, falls = changes_at(bits)
    for attempt in range(2 if period > 10 * MS else 8):
        board.transitions.clear()
        board.events.clear()
        fired = board.request(command)
        assert isinstance(fired, BurstReply)
        assert fired.status == StatusCode.OK
        chip0 = fired.start + board.origin
        wait = rng.randrange(1, max(2 * period, MS)) if attempt else 1
        board.run_alive(max(board.now + wait, min(chip0, board.now + MS)))
        asked = board.now
        board.request(BurstStop(), within=3 * MS // 2)
        while not board.heard(BurstDone):
            assert board.now < asked + 3 * period + 3 * MS
            board.run_alive(board.now + min(period, 20 * MS) + MS // 10)
        board.run(board.now + min(2 * period, 4 * MS))
        [end] = board.heard(BurstDone)
        assert board.rises(PIN_MICROWAVE) == [chip0 + k * period + at * chip for k in range(end.done) for at in rises]
        assert board.falls(PIN_MICROWAVE) == [chip0 + k * period + at * chip for k in range(end.done) for at in falls]
        assert board.rises(PIN_TRIGGER) == [chip0 + k * period + offset for k in range(end.done)]
        assert set(board.widths(PIN_TRIGGER)) == {100}
        begun = (asked - chip0 - min(0, offset)) // period + 1
        late = 1 if bits == ALTERNATING else 0
        assert begun <= end.done <= begun + late + MS // period + 1
        if period > 2 * MS and late == 0:
            assert end.done <= begun + 1
        board.run_alive(max(board.now, chip0 + (end.done + 1) * period))
    assert board.resets == []
    assert board.heard(Fault) == []
