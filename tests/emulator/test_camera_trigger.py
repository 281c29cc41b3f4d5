"""Promises about the trigger for cameras: read off the pins. The end of each is the sync edge."""

import itertools

import pytest
from emulated import BOOTED, LATENCY, MS, EmulatedBoard, configuration

from annulus_pipe.controller import PIN_CAMERA_TRIGGER, PIN_LED, PIN_PROJECTOR, PIN_SYNC
from annulus_pipe.link.messages import (
    RESET_MAGIC,
    Arm,
    ArmFlag,
    CameraTrigger,
    CameraTriggerReply,
    Commit,
    Edge,
    EdgeFlag,
    Polarity,
    PolarityFlag,
    Reset,
    Status,
    StatusCode,
    StatusReply,
    Wiring,
    WiringReply,
)

PERIOD, WIDTH = 250_000, 60_011  # 400 Hz; odd, so that no multiple of the follower's count hides a tick
NONE = PolarityFlag(0)


def start(
    board: EmulatedBoard,
    *,
    generation: int = 1,
    inverted: PolarityFlag = NONE,
    width: int = WIDTH,
    period: int = PERIOD,
    delay: int = 0,
) -> None:
    stage = configuration(
        generation=generation, ratio=1, period=period, delay=1000, width=30_000, tolerance=5, readout=0
    )
    assert board.request(stage).status is StatusCode.OK
    assert board.request(Polarity(generation, inverted)).status is StatusCode.OK
    assert board.request(CameraTrigger(generation, width, delay)).status is StatusCode.OK
    assert board.request(Commit(generation)).status is StatusCode.OK


def triggers(board: EmulatedBoard, inverted: bool) -> tuple[list[int], list[int]]:
    """Begins and ends of all since the pin was last at rest."""
    begins, ends = board.rises(PIN_CAMERA_TRIGGER), board.falls(PIN_CAMERA_TRIGGER)
    return (ends, begins) if inverted else (begins, ends)


@pytest.mark.parametrize(
    "inverted, count",
    [
        (PolarityFlag(0), 40),
        pytest.param(PolarityFlag(0), 1000, marks=pytest.mark.deep),
        pytest.param(PolarityFlag.CAMERA_TRIGGER, 1000, marks=pytest.mark.deep),
        pytest.param(PolarityFlag(63), 200, marks=pytest.mark.deep),
    ],
)
def test_triggers_are_exact_and_each_ones_end_is_an_edge_with_its_flash(
    board: EmulatedBoard, inverted: PolarityFlag, count: int
) -> None:
    turned = PolarityFlag.CAMERA_TRIGGER in inverted
    lamps = {PIN_PROJECTOR: PolarityFlag.PROJECTOR, PIN_LED: PolarityFlag.LED}
    board.pull(
        *(
            (pin, 1)
            for pin, flag in {**lamps, PIN_CAMERA_TRIGGER: PolarityFlag.CAMERA_TRIGGER}.items()
            if flag in inverted
        )
    )
    if PolarityFlag.SYNC in inverted:
        board.input((board.now, PIN_SYNC, 0))
    board.identify()
    board.transitions.clear()
    start(board, inverted=inverted)
    board.run(board.now + MS)
    assert board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.OK
    board.events.clear()
    armed = board.now
    board.run_alive(board.now + count * PERIOD)
    begins, ends = triggers(board, turned)
    begins, ends = begins[: len(ends)], ends[: len(begins)]
    assert len(ends) >= count
    assert {later - earlier for earlier, later in itertools.pairwise(begins[1:])} == {PERIOD}
    assert {end - begin for begin, end in zip(begins[1:], ends[1:], strict=True)} == {WIDTH}
    assert WIDTH <= ends[0] - begins[0] < WIDTH + 20_000, "the first one is longer"
    lit = sorted(
        (tick, pin)
        for pin, flag in lamps.items()
        for tick in (board.falls(pin) if flag in inverted else board.rises(pin))
        if tick > armed
    )
    followed = [end for end in ends if end > armed][: len(lit)]
    assert [tick - end for (tick, _), end in zip(lit, followed, strict=True)] == [1000 + LATENCY] * len(lit)
    assert [pin for _, pin in lit][:4] == [PIN_PROJECTOR, PIN_LED] * 2 and len(lit) >= count - 2
    reported = {board.origin + edge.tick for edge in board.heard(Edge) if edge.lamp}
    assert all(min(tick - end for tick in reported if tick >= end) <= 1 for end in followed[:-2])
    assert not any(edge.flags & (EdgeFlag.IRREGULAR | EdgeFlag.LATE_LOAD) for edge in board.heard(Edge))


LATE = 60  # ticks: board.h, BOARD_TRIGGER_LATE_TICKS


@pytest.mark.parametrize("count", [30, pytest.param(1000, marks=pytest.mark.deep)])
def test_each_accepted_edge_of_the_sync_input_begins_a_trigger_and_stays_the_edge(
    board: EmulatedBoard, count: int
) -> None:
    """Beside a train of refused edges, and with flashes that follow the edges to the tick as ever."""
    board.identify()
    board.transitions.clear()
    start(board, delay=150_001)
    board.run(board.now + MS)
    assert not board.rises(PIN_CAMERA_TRIGGER)
    assert board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.OK
    board.events.clear()
    first = board.now + PERIOD
    edges = [first + i * PERIOD + 7 * i % 13 for i in range(count)]
    for edge in edges:
        board.pulse(edge)
        board.pulse(edge + 50_000 + edge % 100_000, low=500)
    board.run_alive(edges[-1] + PERIOD)
    late = {begin - edge - 150_001 for edge, begin in zip(edges, board.rises(PIN_CAMERA_TRIGGER), strict=True)}
    assert min(late) >= 0 and max(late) <= LATE, late
    assert set(board.widths(PIN_CAMERA_TRIGGER)) == {WIDTH}
    lit = sorted([*board.rises(PIN_PROJECTOR), *board.rises(PIN_LED)])
    assert [tick - edge for tick, edge in zip(lit, edges, strict=True)] == [1000 + LATENCY] * count
    reported = [edge for edge in board.heard(Edge) if edge.lamp]
    assert all(0 <= board.origin + one.tick - edge <= 1 for one, edge in zip(reported, edges, strict=True))
    status = board.request(Status())
    assert isinstance(status, StatusReply) and status.rejected == count
    again = configuration(generation=2, ratio=1, period=PERIOD, delay=1000, width=30_000, tolerance=5, readout=0)
    assert board.request(again).status is StatusCode.OK
    assert board.request(CameraTrigger(2, WIDTH, 0)).status is StatusCode.BAD_STATE, "armed"
    assert board.request(Arm(ArmFlag(0))).status is StatusCode.OK
    latest = PERIOD - PERIOD * 5 // 1000 - WIDTH - 100
    assert board.request(CameraTrigger(2, WIDTH, latest + 1)).status is StatusCode.OUT_OF_RANGE, "could meet an edge"
    assert board.request(CameraTrigger(2, WIDTH, latest)).status is StatusCode.OK
    for generation, width, delay in ((3, WIDTH, 0), (4, WIDTH, 120_000), (5, 0, 0)):  # and from one to the other
        start(board, generation=generation, width=width, delay=delay)
        board.run(board.now + MS)
        board.transitions.clear()
        began = board.now + MS
        for i in range(5):
            board.pulse(began + i * PERIOD)
        board.run_alive(began + 5 * PERIOD)
        assert len(board.rises(PIN_CAMERA_TRIGGER)) in ((0,) if not width else (5,) if delay else (5, 6, 7)), generation
    assert len(board.heard(Edge)) >= count + 15


def test_the_sync_input_is_nobodys_while_triggers_run_and_counts_again_without_them(board: EmulatedBoard) -> None:
    board.identify()
    start(board, period=4_000_000, width=1_000_000)
    for i in range(6):
        board.pulse(board.now + MS + 900_000 * i)
    board.run(board.now + 100 * MS)
    status = board.request(Status())
    assert isinstance(status, StatusReply) and (status.rejected, status.edges) == (0, 3)
    start(board, generation=2, period=4_000_000, width=0)
    board.run(board.now + MS)
    wiring = board.request(Wiring())
    assert isinstance(wiring, WiringReply) and wiring.camera_trigger == 0
    before, heard = len(board.rises(PIN_CAMERA_TRIGGER)), len(board.heard(Edge))
    edge = board.now + 41 * MS
    board.pulse(edge)
    board.run(edge + 5 * MS)
    assert len(board.rises(PIN_CAMERA_TRIGGER)) == before
    (last,) = board.heard(Edge)[heard:]
    assert 0 <= board.origin + last.tick - edge <= 1


def test_edges_refused_before_there_were_triggers_stay_counted(board: EmulatedBoard) -> None:
    board.identify()
    for i in range(4):
        board.pulse(board.now + MS + 20_000 * i)  # one counts, and three come within its hold-off
    board.run(board.now + 5 * MS)
    for generation, width in ((1, WIDTH), (2, 0)):
        start(board, generation=generation, width=width)
        board.run(board.now + 10 * MS)
        status = board.request(Status())
        assert isinstance(status, StatusReply) and status.rejected == 3, width


def test_a_slow_sync_inputs_hold_off_swallows_no_end_of_the_triggers_that_take_its_place(board: EmulatedBoard) -> None:
    board.identify()
    start(board, period=4_000_000, width=0)
    for i in range(2):  # the second one's hold-off is of this configuration, some 40 ms
        board.pulse(board.now + MS)
        board.run(board.now + 45 * MS if i == 0 else board.now + 2 * MS)
    start(board, generation=2, period=8_000_000, width=0)  # and this one's waits for an edge that does not come
    start(board, generation=3, width=100)
    board.run(board.now + 20 * MS)
    status = board.request(Status())
    assert isinstance(status, StatusReply) and status.rejected == 0
    ends = [tick for tick in board.falls(PIN_CAMERA_TRIGGER) if tick < board.now - MS]
    reported = [board.origin + edge.tick for edge in board.heard(Edge)][2:]
    assert [tick - end for tick, end in zip(reported, ends, strict=False)] == pytest.approx([0.5] * len(ends), abs=0.5)
    assert len(reported) >= len(ends) > 5


def test_a_reset_while_triggers_run_feeds_no_block_that_is_in_reset(board: EmulatedBoard) -> None:
    """The emulator faults where DMA writes to one."""
    for phase in range(2):
        board.identify()
        start(board)
        board.run(board.now + 3 * PERIOD + phase * PERIOD // 3)
        board.request(Reset(magic=RESET_MAGIC))
        board.run(board.now + BOOTED)
    assert len(board.resets) == 2


def test_a_configuration_of_other_flashes_does_not_touch_the_triggers(board: EmulatedBoard) -> None:
    board.identify()
    start(board)
    board.run(board.now + 10 * PERIOD)
    assert board.request(Arm(ArmFlag.LAMPS)).status is StatusCode.OK
    again = configuration(generation=2, ratio=0, period=PERIOD, delay=2000, width=30_000, tolerance=5, readout=0)
    assert board.request(again).status is StatusCode.OK
    assert board.request(CameraTrigger(2, WIDTH + 1, 0)).status is StatusCode.BAD_STATE, "armed"
    assert board.request(Commit(2)).status is StatusCode.OK
    other = configuration(generation=3, ratio=0, period=PERIOD + 1, delay=2000, width=30_000, tolerance=5, readout=0)
    board.run(board.now + 10 * PERIOD)
    assert board.request(other).status is StatusCode.OK
    assert board.request(Commit(3)).status is StatusCode.BAD_STATE, "another period is another clock"
    begins = board.rises(PIN_CAMERA_TRIGGER)
    assert {later - earlier for earlier, later in itertools.pairwise(begins[1:])} == {PERIOD}
    assert len(begins) > 20 and board.rises(PIN_LED)


def test_a_trigger_that_does_not_fit_its_period_is_refused(board: EmulatedBoard) -> None:
    board.identify()
    assert board.request(configuration(period=PERIOD, delay=1000, width=30_000, readout=0)).status is StatusCode.OK
    for width in (1, 99, PERIOD - 99, PERIOD, 2**32 - 1):
        refused = board.request(CameraTrigger(1, width, 0))
        assert isinstance(refused, CameraTriggerReply)
        assert (refused.status, refused.detail) == (StatusCode.OUT_OF_RANGE, 1), width
    for width in (100, PERIOD - 100, 0):
        assert board.request(CameraTrigger(1, width, 0)).status is StatusCode.OK, width
    assert board.request(CameraTrigger(2, 100, 0)).status is StatusCode.BAD_STATE
    board.input((board.now + 1, PIN_SYNC, 0))
