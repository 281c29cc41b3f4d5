"""What holds over many trains and however one ends, read off the pins: the duty limit over time, whole bursts only."""

import itertools
import random

import pytest
from emulated import MS, EmulatedBoard, arm

from annulus.controller import PIN_MICROWAVE, PIN_TRIGGER
from annulus.link.messages import (
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    BurstReply,
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
    board.run(board.now + 6 * MS)
    sent = len(board.rises(PIN_MICROWAVE))
    board.request(Identify(protocol=1, schema=SCHEMA_HASH))
    for command in (Pattern(length=128, chips=chips), Arm(outputs=ArmFlag.MICROWAVE)):
        assert board.request(command).status == StatusCode.OK
    assert board.request(dense).status == StatusCode.DUTY
    board.run(board.now + 80 * MS)
    assert len(board.rises(PIN_MICROWAVE)) == sent
    board.request(Clear())
    board.request(Arm(outputs=ArmFlag.MICROWAVE))
    assert board.request(dense).status == StatusCode.OK
    board.run(board.now + 5 * MS)
    assert len(board.rises(PIN_MICROWAVE)) == sent + 64
    assert set(board.widths(PIN_TRIGGER)) <= {100}
