"""Promises about slides that are lit in turn, each by an output of its own: read off the image's pins, in ticks."""

from collections.abc import Iterable
from itertools import pairwise

import pytest
from emulated import LATENCY, MS, EmulatedBoard, configuration

from annulus_pipe.controller import PIN_LED, PIN_PROJECTOR, PIN_SLIDE_2, PIN_SLIDE_3, PIN_SLIDE_4, SLIDES_MAX
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Clear,
    Commit,
    Edge,
    Lamp,
    Polarity,
    PolarityFlag,
    Preamble,
    Reset,
    Slides,
    SlidesLit,
    SlidesLitReply,
    StatusCode,
)

SLIDE_PINS = (PIN_PROJECTOR, PIN_SLIDE_2, PIN_SLIDE_3, PIN_SLIDE_4)
LAMPS = (*SLIDE_PINS, PIN_LED)
PERIOD, DELAY, WIDTH = 1_000_000, 300_000, 100_000  # ticks
RESET_MAGIC = 0x7E5E7B00


def put_in_force(board: EmulatedBoard, count: int, generation: int = 1, ratio: int = 4) -> None:
    stage = configuration(generation=generation, ratio=ratio, period=PERIOD, delay=DELAY, width=WIDTH)
    assert board.request(stage).status is StatusCode.OK
    assert board.request(Slides(generation, count)).status is StatusCode.OK
    assert board.request(Commit(generation)).status is StatusCode.OK
    board.run(board.now + MS)


def armed(board: EmulatedBoard) -> None:
    assert board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.OK


def edges_of(board: EmulatedBoard, periods: Iterable[float]) -> list[int]:
    """Edges so many periods from now; the board has run until the last frame is over."""
    edges = [board.now + 2 * MS + round(at * PERIOD) for at in periods]
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + PERIOD - 2 * MS)
    return edges


def flashes(board: EmulatedBoard) -> list[tuple[int, int, int]]:
    """(rise, pin, width) of every lamp, in order."""
    found = [(at, pin, width) for pin in LAMPS for at, width in zip(board.rises(pin), board.widths(pin), strict=True)]
    return sorted(found)


def one_lamp_at_a_time(board: EmulatedBoard) -> bool:
    """Whether in no tick of all that these pins ever did two of them were lit."""
    every = flashes(board)
    return all(rise + width <= later for (rise, _, width), (later, _, _) in pairwise(every))


def pin_of(edge: Edge, count: int) -> int | None:
    """Which output the slot names."""
    if edge.lamp is Lamp.DARK:
        return None
    return PIN_LED if edge.lamp is Lamp.LED else SLIDE_PINS[edge.slot % count]


@pytest.mark.deep(
    gate="tests/emulator/test_slides.py::test_never_two_lamps_at_once_and_none_unless_armed_whatever_comes"
)
@pytest.mark.parametrize(("count", "ratio"), [(4, 4), (2, 4), (3, 3), (3, 15), (1, 4)])
def test_each_slides_lamp_follows_its_edge_by_the_lamps_constant(board: EmulatedBoard, count: int, ratio: int) -> None:
    board.identify()
    put_in_force(board, count, ratio=ratio)
    armed(board)
    edges = edges_of(board, range(2 * ratio + 3))
    slots = [i % (ratio + 1) for i in range(len(edges))]
    pins = [PIN_LED if slot == ratio else SLIDE_PINS[slot % count] for slot in slots]
    assert flashes(board) == [(edge + DELAY + LATENCY, pin, WIDTH) for edge, pin in zip(edges, pins, strict=True)]
    assert [edge.slot for edge in board.heard(Edge)] == slots
    found = board.request(SlidesLit())
    assert isinstance(found, SlidesLitReply) and (found.count, found.driven) == (count, count)


def test_never_two_lamps_at_once_and_none_unless_armed_whatever_comes(board: EmulatedBoard) -> None:
    """Edges that are missing or doubled, a preamble, another count of slides, disarming and arming in the middle of a
    flash, a reset: each flash is the one its edge reports, and nothing is lit when nothing is armed."""
    board.identify()
    put_in_force(board, SLIDES_MAX)
    edges_of(board, range(3))
    assert not flashes(board)
    armed(board)
    edges_of(board, (0, 1, 5, 6, 6.3, 7))  # sync is lost, and one edge comes within a hold-off
    assert board.request(Preamble(3, 0, 1)).status is StatusCode.OK
    edges_of(board, range(5))
    stage = configuration(generation=2, ratio=4, period=PERIOD, delay=DELAY, width=WIDTH)
    assert board.request(stage).status is StatusCode.OK
    assert board.request(Slides(2, 2)).status is StatusCode.BAD_STATE  # armed
    assert board.request(Commit(2)).status is StatusCode.OK
    edges_of(board, range(6))
    reported = [edge for edge in board.heard(Edge) if pin_of(edge, SLIDES_MAX)]
    pins = [pin for _, pin, _ in flashes(board)]
    assert pins == [pin_of(edge, SLIDES_MAX) for edge in reported] and len(pins) >= 13

    board.pulse(board.now + MS)
    board.run(board.now + MS + DELAY + WIDTH // 2)
    assert board.request(Arm(ArmFlag(0))).status is StatusCode.OK
    assert all(len(board.rises(pin)) == len(board.falls(pin)) for pin in LAMPS)  # dark
    before = len(flashes(board))
    edges_of(board, range(2))
    put_in_force(board, 2, generation=3)
    edges_of(board, range(2))
    assert len(flashes(board)) == before
    armed(board)
    at = len(board.heard(Edge))
    edges_of(board, range(6))
    after = [pin_of(edge, 2) for edge in board.heard(Edge)[at:]]
    assert [pin for _, pin, _ in flashes(board)[before:]] == [pin for pin in after if pin]

    before = len(flashes(board))
    board.send(Reset(RESET_MAGIC))
    board.run(board.now + 50 * MS)
    board.identify()
    board.request(Clear())
    edges_of(board, range(3))
    assert len(flashes(board)) == before
    assert one_lamp_at_a_time(board)


@pytest.mark.deep(
    gate="tests/emulator/test_slides.py::test_never_two_lamps_at_once_and_none_unless_armed_whatever_comes"
)
def test_outputs_of_slides_are_driven_for_heads_that_have_them_and_inverted_as_the_projector_is(
    board: EmulatedBoard,
) -> None:
    """An active-low driver with its resistor to 3.3 V is dark throughout but for its flash."""
    board.pull(*((pin, 1) for pin in SLIDE_PINS))
    board.identify()
    board.transitions.clear()
    stage = configuration(generation=1, ratio=4, period=PERIOD, delay=DELAY, width=WIDTH)
    for command in (stage, Polarity(1, PolarityFlag.PROJECTOR), Commit(1)):
        assert board.request(command).status is StatusCode.OK
    board.run(board.now + MS)
    found = board.request(SlidesLit())
    assert isinstance(found, SlidesLitReply) and (found.count, found.driven) == (1, 1)
    stage = configuration(generation=2, ratio=4, period=PERIOD, delay=DELAY, width=WIDTH)
    for command in (stage, Slides(2, SLIDES_MAX), Commit(2)):
        assert board.request(command).status is StatusCode.OK
    armed(board)
    edges = edges_of(board, range(SLIDES_MAX))
    for edge, pin in zip(edges, SLIDE_PINS, strict=True):
        changes = [(tick, level) for tick, where, level in board.transitions if where == pin]
        lit = edge + DELAY + LATENCY
        assert changes == [(lit, 0), (lit + WIDTH, 1)]
