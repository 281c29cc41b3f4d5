"""Optical preambles on the shipped image: what the pins did is what the edges told, in the order that was promised."""

import random

import pytest
from emulated import LATENCY, MS, EmulatedBoard, configuration, edges_from

from annulus_pipe.controller import PIN_LED, PIN_PROJECTOR
from annulus_pipe.link.messages import Arm, ArmFlag, Commit, Edge, Fault, FaultCode, Preamble, StatusCode
from annulus_pipe.vocabulary import EdgeFlag, Lamp

LAMPS = (Lamp.PROJECTOR, Lamp.LED, Lamp.DARK, Lamp.PROJECTOR)  # of two bits of the sequence
DELAY, WIDTH, FRAME = 300_000, 200_000, 1_000_000


def arm_with(board: EmulatedBoard, preamble: Preamble, **changes: int) -> None:
    board.identify()
    for command in (
        configuration(**{"period": FRAME} | changes),
        Commit(generation=changes.get("generation", 1)),
        preamble,
        Arm(outputs=ArmFlag.LAMPS),
    ):
        assert board.request(command).status == StatusCode.OK


def watch(board: EmulatedBoard, edges: list[int]) -> list[Edge]:
    """The edges as they were told, each lit as the pins were."""
    before = len(board.heard(Edge))
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 45 * MS)
    told = board.heard(Edge)[before:]
    assert len(told) == len(edges)
    for pin, lamp in ((PIN_PROJECTOR, Lamp.PROJECTOR), (PIN_LED, Lamp.LED)):
        lit = [tick + LATENCY + edge.delay for tick, edge in zip(edges, told, strict=True) if edge.lamp == lamp]
        assert [rise for rise in board.rises(pin) if rise > edges[0]] == lit
        assert board.widths(pin)[len(board.rises(pin)) - len(lit) :] == [WIDTH] * len(lit)
    return told


def places(told: list[Edge]) -> list[tuple[bool, int]]:
    return [(EdgeFlag.PREAMBLE in edge.flags, edge.slot) for edge in told]


def follows_the_sequence(told: list[Edge]) -> bool:
    """From some state of the register on."""
    preambles = [edge for edge in told if EdgeFlag.PREAMBLE in edge.flags]
    for seed in range(1, 1 << 15):
        bits = seed
        for edge in preambles:
            if LAMPS[bits & 3] != edge.lamp:
                break
            bits = ((bits << 2) | (((bits >> 13) ^ (bits >> 12)) & 3)) & 0x7FFF
        else:
            return True
    return False


@pytest.mark.parametrize("count", [45, pytest.param(80, marks=pytest.mark.deep)])
def test_a_preamble_comes_on_arming_and_after_every_interval_and_the_pins_follow_its_sequence(
    board: EmulatedBoard, count: int
) -> None:
    arm_with(board, Preamble(15, 2, 0))
    told = watch(board, edges_from(board, count, FRAME))
    one = [*((True, slot) for slot in range(15)), *((False, slot % 5) for slot in range(10))]
    assert places(told) == (one * 4)[:count]
    assert follows_the_sequence(told)
    lit = [edge.lamp for edge in told if EdgeFlag.PREAMBLE in edge.flags]
    assert min(lit.count(lamp) for lamp in Lamp) >= count // 20
    assert [fault for fault in board.heard(Fault) if fault.fault != FaultCode.ODOMETER] == []


@pytest.mark.parametrize("count", [50, pytest.param(120, marks=pytest.mark.deep)])
def test_an_order_at_any_moment_of_a_frame_disturbs_no_flash(board: EmulatedBoard, count: int) -> None:
    """The flash of the next edge is loaded already, and this edge's may still be waited for: taking it back then left
    both dark.
    """
    arm_with(board, Preamble(0, 0, 0), period=1_000_000)
    rng = random.Random(1)
    edges = [board.now + MS + i * 1_000_000 for i in range(count)]
    for edge in edges:
        board.pulse(edge)
    orders = 0
    for edge in edges[3:-12:9]:  # long enough for a second one, which nobody ordered
        board.run(edge + rng.randrange(-50_000, 600_000))
        assert board.request(Preamble(3, 0, 1)).status == StatusCode.OK
        orders += 1
    board.run_alive(edges[-1] + 45 * MS)
    told = board.heard(Edge)
    for pin, lamp in ((PIN_PROJECTOR, Lamp.PROJECTOR), (PIN_LED, Lamp.LED)):
        assert board.rises(pin) == [t + LATENCY + e.delay for t, e in zip(edges, told, strict=True) if e.lamp == lamp]
        assert set(board.widths(pin)) == {WIDTH}
    begun = [edge for edge in told if EdgeFlag.PREAMBLE in edge.flags and edge.slot == 0]
    assert len(begun) == orders and follows_the_sequence(told)
    assert not any(EdgeFlag.LATE_LOAD in edge.flags for edge in told)


def test_disarming_ends_a_preamble_and_a_commit_waits_for_its_end(board: EmulatedBoard) -> None:
    arm_with(board, Preamble(15, 0, 0))
    told = watch(board, edges_from(board, 4, FRAME))
    for command in (configuration(generation=2, ratio=1, period=FRAME), Commit(generation=2)):
        assert board.request(command).status == StatusCode.OK
    told += watch(board, edges_from(board, 14, FRAME))
    assert [edge.generation for edge in told] == [1] * 15 + [2] * 3
    assert places(told)[15:] == [(False, 0), (False, 1), (False, 0)]
    assert board.request(Preamble(15, 0, 1)).status == StatusCode.OK
    told = watch(board, edges_from(board, 5, FRAME))
    assert places(told)[1:] == [(True, slot) for slot in range(4)]
    assert board.request(Arm(outputs=ArmFlag(0))).status == StatusCode.OK
    told = watch(board, edges_from(board, 3, FRAME))
    restful = EdgeFlag.IRREGULAR | EdgeFlag.FIRST  # of an edge that comes after the pause
    assert all(edge.flags & ~restful == EdgeFlag.DISARMED and edge.lamp == Lamp.DARK for edge in told)


def test_with_ratio_0_the_projector_takes_no_part(board: EmulatedBoard) -> None:
    arm_with(board, Preamble(31, 0, 0), ratio=0)
    told = watch(board, edges_from(board, 31, FRAME))
    assert {edge.lamp for edge in told} == {Lamp.LED, Lamp.DARK}


def test_whoever_identifies_has_no_preamble(board: EmulatedBoard) -> None:
    arm_with(board, Preamble(15, 1, 0))
    watch(board, edges_from(board, 3, FRAME))
    board.identify()
    told = watch(board, edges_from(board, 20, FRAME))
    assert places(told)[1:] == [(False, slot % 5) for slot in range(19)]
