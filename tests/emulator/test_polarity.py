"""Promises about pins that the wiring inverts: read off the pads, whose drivers lie the other way round.

An active-low driver is lit at low, so it is kept dark by a resistor to 3.3 V while nobody drives the pin.
"""

from collections.abc import Iterable

import pytest
from emulated import LATENCY, MS, EmulatedBoard, arm, configuration

from annulus_pipe.controller import PIN_INTERLOCK, PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_SYNC, PIN_TRIGGER
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    Clear,
    Commit,
    Edge,
    Polarity,
    PolarityFlag,
    PolarityReply,
    Reset,
    Status,
    StatusCode,
    StatusReply,
    Wiring,
    WiringReply,
)

GATES = (PIN_PROJECTOR, PIN_LED, PIN_MICROWAVE, PIN_TRIGGER)
OUTPUTS = PolarityFlag(62)  # all of them
RESET_MAGIC = 0x7E5E7B00


def pulled(board: EmulatedBoard, pins: Iterable[int] = GATES) -> None:
    board.pull(*((pin, 1) for pin in pins))


def put_in_force(board: EmulatedBoard, inverted: PolarityFlag, generation: int = 1, **timing: int) -> None:
    assert board.request(configuration(generation=generation, **timing)).status is StatusCode.OK
    assert board.request(Polarity(generation, inverted)).status is StatusCode.OK
    assert board.request(Commit(generation)).status is StatusCode.OK
    board.run(board.now + MS)


def lit(board: EmulatedBoard, pin: int) -> list[tuple[int, int]]:
    """Of an active-low driver: (from, how long)."""
    falls, rises = board.falls(pin), board.rises(pin)
    rises = [tick for tick in rises if falls and tick > falls[0]]
    return [(fall, rise - fall) for fall, rise in zip(falls, rises, strict=True)]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("inverted", [PolarityFlag.PROJECTOR, PolarityFlag.LED | PolarityFlag.SYNC, PolarityFlag(31)])
def test_a_lamp_follows_its_edge_by_the_same_constant_whichever_pins_are_inverted(
    board: EmulatedBoard, inverted: PolarityFlag
) -> None:
    flags = {PIN_PROJECTOR: PolarityFlag.PROJECTOR, PIN_LED: PolarityFlag.LED}
    pulled(board, [pin for pin, flag in flags.items() if flag in inverted])
    idle = 0 if PolarityFlag.SYNC in inverted else 1
    board.input((board.now, PIN_SYNC, idle))
    board.identify()
    put_in_force(board, inverted, ratio=1, delay=70_000, width=30_000)
    assert board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.OK
    edges = [board.now + MS + i * 4_000_000 + 3 * i for i in range(8)]
    for edge in edges:
        board.input((edge, PIN_SYNC, 1 - idle), (edge + 2000, PIN_SYNC, idle))
    board.run_alive(edges[-1] + 5 * MS)
    board.run(edges[-1] + 10 * MS)
    flashes = {
        pin: lit(board, pin) if flag in inverted else list(zip(board.rises(pin), board.widths(pin), strict=True))
        for pin, flag in flags.items()
    }
    assert flashes[PIN_PROJECTOR] == [(edge + 70_000 + LATENCY, 30_000) for edge in edges[0::2]]
    assert flashes[PIN_LED] == [(edge + 70_000 + LATENCY, 30_000) for edge in edges[1::2]]
    told = [board.origin + edge.tick for edge in board.heard(Edge)][-len(edges) :]
    assert all(0 <= tick - edge <= 1 for tick, edge in zip(told, edges, strict=True))
    status = board.request(Status())
    assert isinstance(status, StatusReply) and status.rejected == 0


def test_no_active_low_output_is_lit_but_by_its_flash_from_power_on_through_every_way_to_stop(
    board: EmulatedBoard,
) -> None:
    """Power on, configuration, arming, disarming, a reset, the watchdog, a hard fault: dark is high throughout."""
    pulled(board)
    board.transitions.clear()
    board.input((board.now, PIN_INTERLOCK, 0))
    edges = []
    for stop in ("disarm", "reset", "hang", "fault"):
        board.run(board.now + 100 * MS)  # after a start, which takes 26 ms, a lamp owes 40 ms
        board.identify()
        board.request(Clear())
        put_in_force(board, OUTPUTS, ratio=0, delay=10_000, width=4 * MS)
        assert board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.OK
        edges.append(board.now + MS)
        board.pulse(edges[-1])
        board.run(edges[-1] + 10_000 + MS)  # the LED is lit
        before = len(board.resets)
        if stop == "disarm":
            assert board.request(Arm(ArmFlag(0))).status is StatusCode.OK
        elif stop == "reset":
            board.send(Reset(RESET_MAGIC))
        else:
            board.trap("controller_run", stop)
        while stop != "disarm" and len(board.resets) == before:
            board.run(board.now + MS // 2)
    board.run(board.now + 5 * MS)
    flashes = lit(board, PIN_LED)
    assert [start for start, _ in flashes] == [edge + 10_000 + LATENCY for edge in edges]
    assert [width < 4 * MS for _, width in flashes] == [
        True,
        True,
        False,
        True,
    ]  # one that hangs ends its flash in time
    assert flashes[2][1] == 4 * MS
    for pin in (PIN_PROJECTOR, PIN_MICROWAVE, PIN_TRIGGER):
        assert board.falls(pin) == [], pin


def test_an_inverted_burst_is_the_burst_upside_down_and_ends_with_the_interlock(board: EmulatedBoard) -> None:
    pulled(board, (PIN_MICROWAVE, PIN_TRIGGER))
    board.input((board.now, PIN_INTERLOCK, 0))
    board.run(board.now + 3 * MS)
    board.identify()
    put_in_force(board, PolarityFlag.MICROWAVE | PolarityFlag.TRIGGER)
    assert board.request(Arm(ArmFlag.MICROWAVE)).status is StatusCode.OK
    board.run(board.now + MS)
    burst = Burst(BurstCode.BARKER13, chip=50, repeat=2, period=100_000, trigger_offset=0)
    assert board.request(burst).status is StatusCode.OK
    board.run_alive(board.now + 3 * MS)
    assert [width for _, width in lit(board, PIN_MICROWAVE)] == [250, 100, 50, 50] * 2
    assert [width for _, width in lit(board, PIN_TRIGGER)] == [100] * 2
    assert board.request(Burst(BurstCode.BARKER13, 50, 100, 100_000, 0)).status is StatusCode.OK
    board.run(board.now + 2 * MS)
    opened = board.now + 7
    board.input((opened, PIN_INTERLOCK, 1))
    board.run(opened + 5 * MS)
    assert max(board.falls(PIN_MICROWAVE)) <= opened + 5 and max(board.rises(PIN_MICROWAVE)) <= opened + 5


def test_polarity_does_not_change_while_anything_is_armed_and_a_stage_without_it_keeps_it(board: EmulatedBoard) -> None:
    board.identify()
    wiring = board.request(Wiring())
    assert isinstance(wiring, WiringReply) and (wiring.driven, wiring.inverted) == (0, 0)
    put_in_force(board, PolarityFlag.LED)
    refused = board.request(Polarity(1, PolarityFlag(0)))
    assert isinstance(refused, PolarityReply)
    assert (refused.status, refused.generation) == (StatusCode.BAD_STATE, 0), "nothing is staged"
    assert board.request(configuration(generation=2)).status is StatusCode.OK
    assert board.request(Polarity(2, PolarityFlag(0))).status is StatusCode.OK
    assert board.request(Polarity(3, PolarityFlag(0))).status is StatusCode.BAD_STATE
    assert board.request(Polarity(2, PolarityFlag(64))).status is StatusCode.OUT_OF_RANGE
    assert board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.OK
    assert board.request(Polarity(2, PolarityFlag.LED)).status is StatusCode.BAD_STATE
    assert board.request(Commit(2)).status is StatusCode.BAD_STATE, "it would turn a pin over under an armed lamp"
    assert board.request(configuration(generation=3)).status is StatusCode.OK
    assert board.request(Commit(3)).status is StatusCode.OK, "the same pins"
    assert board.request(Arm(ArmFlag(0))).status is StatusCode.OK
    board.run(board.now + MS)
    wiring = board.request(Wiring())
    assert isinstance(wiring, WiringReply)
    assert (wiring.generation, wiring.inverted, wiring.driven) == (3, PolarityFlag.LED, OUTPUTS)


def test_arming_the_microwave_alone_drives_no_lamp(board: EmulatedBoard) -> None:
    pulled(board, (PIN_PROJECTOR, PIN_LED))
    board.input((board.now, PIN_INTERLOCK, 0))
    board.transitions.clear()
    board.run(board.now + 3 * MS)
    board.identify()
    assert board.request(Arm(ArmFlag.MICROWAVE)).status is StatusCode.OK
    board.run(board.now + MS)
    wiring = board.request(Wiring())
    assert isinstance(wiring, WiringReply)
    assert wiring.driven == PolarityFlag.MICROWAVE | PolarityFlag.TRIGGER
    assert board.falls(PIN_PROJECTOR) == board.falls(PIN_LED) == []
    arm(board)
