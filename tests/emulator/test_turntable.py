"""The turntable of the image a user flashes, step by step at its pins: ramps, and everything that stops it."""

import itertools
import math
import random

import pytest
from emulated import BOOTED, MS, EmulatedBoard

from annulus_pipe.controller import (
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_INTERLOCK,
    PIN_STEP,
    TICK_HZ,
    TICKS_PER_US,
    TURNTABLE_LAG_MS,
    TURNTABLE_LEAD_MS,
    TURNTABLE_POSITION_MAX_STEPS,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Clear,
    Fault,
    FaultCode,
    Move,
    Reply,
    StateFlag,
    Status,
    StatusCode,
    StatusReply,
    StopCause,
    Turntable,
    TurntableDone,
    TurntableFlag,
    TurntableStop,
    TurntableStopped,
)

US = TICKS_PER_US
LEAD, LAG = TURNTABLE_LEAD_MS * MS, TURNTABLE_LAG_MS * MS
ROUND = 250 * US  # of the main loop, at most, and its sleep
UNDER_WAY = 3  # steps that are made after it was decided that none shall begin
MET = 2  # ticks by which a period may differ
BOTH = TurntableFlag.END_LOW | TurntableFlag.END_HIGH
FAST, START, STEEP = 12_000, 200_000, 40_000  # 8333 steps/s from 500 steps/s at 40000 steps/s^2: 866 steps of ramp


def configuration(
    *, lowest: int = -100_000, highest: int = 100_000, acceleration: int = STEEP, start: int = START, switches: int = 0
) -> Turntable:
    return Turntable(lowest, highest, acceleration, start, TurntableFlag(switches))


def ready(board: EmulatedBoard, *, ends: bool = True, **changes: int) -> None:
    """Interlock closed, both end switches closed, configured."""
    if ends:
        board.input((board.now, PIN_END_LOW, 0), (board.now, PIN_END_HIGH, 0))
    board.identify()
    assert board.request(configuration(**changes)).status == StatusCode.OK


def start(board: EmulatedBoard, position: int, period: int = FAST, hold: int = 0) -> Reply:
    return board.request(Move(position=position, period=period, hold=hold))


def until_it_stands(board: EmulatedBoard, within: int = 2000 * MS) -> int:
    """The position it tells."""
    end = board.now + within
    while not board.heard(TurntableDone):
        assert board.now < end
        board.run_alive(board.now + 10 * MS)
    [done] = board.heard(TurntableDone)
    return done.position


def intervals(board: EmulatedBoard) -> list[int]:
    return [b - a for a, b in itertools.pairwise(board.rises(PIN_STEP))]


def forget(board: EmulatedBoard) -> None:
    board.transitions.clear()
    board.events.clear()


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("target", [-300, 3_000, -3_000, 700, 5, 1, 0])
def test_a_move_speeds_up_and_slows_down_step_by_step_and_is_never_faster_than_asked(
    board: EmulatedBoard, target: int
) -> None:
    ready(board)
    assert start(board, target).status == StatusCode.OK
    assert until_it_stands(board) == target
    gaps = intervals(board)
    assert len(board.rises(PIN_STEP)) == len(board.falls(PIN_STEP)) == abs(target)
    assert all(gap >= FAST - MET for gap in gaps)
    fastest = gaps.index(min(gaps)) if gaps else 0
    assert all(later <= earlier + MET for earlier, later in itertools.pairwise(gaps[: fastest + 1]))
    assert all(later >= earlier - MET for earlier, later in itertools.pairwise(gaps[fastest:]))
    assert all(gap <= START + MET for gap in gaps)
    for gap in (gaps[:1] + gaps[-1:]) if len(gaps) > 10 else []:
        assert gap >= 0.6 * START
    # nowhere faster than the ramp from either end allows, but for the steps that were under way
    for at, gap in enumerate(gaps):
        steps = min(at, len(gaps) - 1 - at) + 2 * UNDER_WAY
        assert gap >= 0.98 * TICK_HZ / math.sqrt((TICK_HZ / START) ** 2 + 2 * STEEP * steps)
    if abs(target) >= 3_000:
        assert min(gaps) <= FAST + MET
    assert board.heard(TurntableStopped) == []


def test_without_a_ramp_the_period_is_what_was_asked_at_once(board: EmulatedBoard) -> None:
    ready(board, acceleration=0, start=0)
    assert start(board, 100).status == StatusCode.OK
    assert until_it_stands(board) == 100
    assert set(intervals(board)) <= set(range(FAST - MET, FAST + MET + 1))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("how", ["turntable_stop", "disarm"])
@pytest.mark.parametrize(("seed", "moves"), [(0, 1), (0, 3), (1, 3), (2, 3)])
def test_a_stop_brakes_along_the_ramp_and_tells_where_it_stands(
    board: EmulatedBoard, how: str, seed: int, moves: int
) -> None:
    """A stage that had begun to move could not be stopped by anything."""
    rng = random.Random(seed)
    ready(board)
    stood = 0
    for sign in (1, -1, 1)[:moves]:
        forget(board)
        assert start(board, stood + sign * 50_000).status == StatusCode.OK
        board.run_alive(board.now + rng.randrange(MS, 300 * MS))
        told = board.now
        before = len(board.rises(PIN_STEP))
        board.request(TurntableStop() if how == "turntable_stop" else Arm(outputs=ArmFlag(0)))
        position = until_it_stands(board)
        made = len(board.rises(PIN_STEP))
        assert position == stood + sign * made
        gaps = intervals(board)
        speed = TICK_HZ / min(gaps)
        braking = (speed**2 - (TICK_HZ / START) ** 2) / (2 * STEEP)
        answered = 12 * speed * MS / TICK_HZ / 10  # steps until the command has come
        assert made - before <= braking + answered + 2 * UNDER_WAY
        after = [b - a for a, b in itertools.pairwise(t for t in board.rises(PIN_STEP) if t > told + MS)]
        assert all(later >= earlier - MET for earlier, later in itertools.pairwise(after))
        [event] = board.heard(TurntableStopped)
        assert (event.position, event.cause, event.lost) == (position, StopCause.STOPPED, 0)
        stood = position
    assert board.heard(Fault) == []


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("sign", "pin", "cause"), [(1, PIN_END_HIGH, StopCause.END_HIGH), (-1, PIN_END_LOW, StopCause.END_LOW)]
)
@pytest.mark.parametrize(("hard", "turns"), [(True, 1), (False, 4), (True, 4)])
def test_an_end_switch_stops_motion_towards_it_however_short_the_touch(
    board: EmulatedBoard, sign: int, pin: int, cause: StopCause, hard: bool, turns: int
) -> None:
    rng = random.Random(pin + hard)
    other = PIN_END_LOW + PIN_END_HIGH - pin
    switches = BOTH | (TurntableFlag.END_HARD if hard else TurntableFlag(0))
    stood = 0
    ready(board)
    for _ in range(turns):
        forget(board)
        assert board.request(configuration(switches=switches)).status == StatusCode.OK
        assert start(board, sign * 40_000).status == StatusCode.OK
        board.input((board.now + MS, other, 1), (board.now + 2 * MS, other, 0))  # the one behind it
        board.run_alive(board.now + rng.randrange(20 * MS, 220 * MS))
        touched = board.now + rng.randrange(1, 30_000)
        board.input((touched, pin, 1), (touched + rng.choice((50, 5_000, 500_000)), pin, 0))
        position = until_it_stands(board)
        made = len(board.rises(PIN_STEP))
        assert position == stood + sign * made
        after = sum(tick > touched + ROUND for tick in board.rises(PIN_STEP))
        speed = TICK_HZ / min(intervals(board))
        assert after <= (UNDER_WAY if hard else (speed**2 - (TICK_HZ / START) ** 2) / (2 * STEEP) + 2 * UNDER_WAY)
        [event] = board.heard(TurntableStopped)
        assert (event.position, event.cause, event.lost) == (position, cause, int(hard))
        assert bool(StateFlag.TURNTABLE_LOST & state(board)) is hard
        stood = position
    board.input((board.now, pin, 1))
    board.run(board.now + MS)
    refused = start(board, stood + sign)
    assert (refused.status, refused.detail) == (StatusCode.UNSAFE, cause)
    forget(board)
    assert start(board, stood - sign * 20).status == StatusCode.OK  # away from it
    assert until_it_stands(board) == stood - sign * 20


def status(board: EmulatedBoard) -> StatusReply:
    reply = board.request(Status())
    assert isinstance(reply, StatusReply)
    return reply


def state(board: EmulatedBoard) -> StateFlag:
    return status(board).state


@pytest.mark.deep(gate="tests/emulator/test_turntable.py::test_without_a_ramp_the_period_is_what_was_asked_at_once")
def test_switches_that_are_not_there_are_not_looked_at(board: EmulatedBoard) -> None:
    ready(board, ends=False)
    assert start(board, 500).status == StatusCode.OK
    assert until_it_stands(board) == 500
    assert board.heard(TurntableStopped) == []


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("ramp", [True, False])
@pytest.mark.parametrize(("seed", "times"), [(0, 2), (0, 4), (1, 4), (2, 4)])
def test_an_opened_interlock_ends_it_at_once_and_takes_its_power_away(
    board: EmulatedBoard, seed: int, times: int, ramp: bool
) -> None:
    """It went on to its target, hours away, with the interlock open and a fault latched."""
    rng = random.Random(10 * seed + ramp)
    board.identify()
    if ramp:
        ready(board)
    stood = 0
    for sign in (1, -1, 1, -1)[:times]:
        forget(board)
        assert start(board, stood + sign * 30_000, hold=1).status == StatusCode.OK
        board.run_alive(board.now + rng.randrange(MS, 150 * MS))
        opens = board.now + rng.randrange(1, 30_000)
        board.input((opens, PIN_INTERLOCK, 1), (opens + rng.choice((100, 100_000)), PIN_INTERLOCK, 0))
        board.run(opens + 20 * MS)
        assert max(board.rises(PIN_STEP), default=0) <= opens + ROUND
        enabled = [(tick, level) for tick, pin, level in board.transitions if pin == PIN_ENABLE]
        assert enabled[-1][1] == 1
        assert opens < enabled[-1][0] <= opens + ROUND
        assert [pin for tick, pin, level in board.transitions if tick > opens + ROUND and level == 1] == []
        [done] = board.heard(TurntableDone)
        assert done.position == stood + sign * len(board.rises(PIN_STEP))
        assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.INTERLOCK]
        [event] = board.heard(TurntableStopped)
        fast = len(board.rises(PIN_STEP)) > 10
        assert (event.cause, event.position) == (StopCause.FAULT, done.position)
        assert event.lost == 0 if not ramp else event.lost == 1 or not fast
        assert start(board, 0).status == StatusCode.UNSAFE
        assert board.request(Clear()).status == StatusCode.OK
        stood = done.position
    board.input((board.now, PIN_INTERLOCK, 1))
    board.run(board.now + MS)
    assert start(board, 0).status == StatusCode.UNSAFE


@pytest.mark.deep(
    gate="tests/emulator/test_turntable.py::test_an_opened_interlock_ends_it_at_once_and_takes_its_power_away"
)
def test_a_host_that_falls_silent_while_it_moves_ends_it(board: EmulatedBoard) -> None:
    ready(board)
    assert start(board, 100_000).status == StatusCode.OK
    told = board.now
    board.run(told + 520 * MS)
    assert told + 400 * MS < max(board.rises(PIN_STEP)) <= told + 500 * MS + ROUND
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.HOST_TIMEOUT]
    assert until_it_stands(board) == len(board.rises(PIN_STEP))


def test_a_processor_that_stands_still_leaves_it_without_power(board: EmulatedBoard) -> None:
    ready(board)
    assert start(board, 100_000).status == StatusCode.OK
    board.run(board.now + 50 * MS)
    stuck = board.now
    board.stall(200 * MS)
    board.run(stuck + 180 * MS)
    [reset] = board.resets
    assert reset <= stuck + 102 * MS
    board.run(stuck + 200 * MS + BOOTED)  # until then its own pull-up holds ENABLE
    assert max(board.rises(PIN_STEP)) <= reset
    assert [level for _, pin, level in board.transitions if pin == PIN_ENABLE][-1] == 1


@pytest.mark.deep(gate="tests/emulator/test_turntable.py::test_no_step_rises_without_power_however_close_to_the_cut")
def test_positions_beyond_the_limits_are_refused_from_wherever_it_stands(board: EmulatedBoard) -> None:
    """A move to 1 431 655 766 wrapped three words a step round 2^32 and never ended."""
    board.identify()
    far = TURNTABLE_POSITION_MAX_STEPS
    for position in (1_431_655_766, -1_431_655_766, far + 1, -far - 1, 2**31 - 1, -(2**31)):
        reply = start(board, position, 10_000)
        assert (reply.status, reply.detail) == (StatusCode.OUT_OF_RANGE, 0)
    ready(board, lowest=-40, highest=60)
    for position, ok in ((61, False), (60, True), (-41, False), (-40, True)):
        forget(board)
        assert start(board, position).status == (StatusCode.OK if ok else StatusCode.OUT_OF_RANGE)
        if ok:
            assert board.request(configuration()).status == StatusCode.BAD_STATE
            assert until_it_stands(board) == position
    for detail, changes in enumerate(
        ({"lowest": -far - 1}, {"lowest": 3, "highest": 2}, {"acceleration": 10_000_001}, {"start": 9_999})
    ):
        reply = board.request(configuration(**changes))
        assert (reply.status, reply.detail) == (StatusCode.OUT_OF_RANGE, detail)
    board.transitions.clear()
    assert start(board, far, 10_000).status == StatusCode.OUT_OF_RANGE
    board.request(configuration(lowest=-far, highest=far))
    assert start(board, far, 10_000).status == StatusCode.OK
    board.run_alive(board.now + 20 * MS)
    board.request(TurntableStop())
    forget(board)
    until_it_stands(board)
    assert board.transitions == [] or PIN_DIRECTION not in {pin for _, pin, _ in board.transitions}


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("part", range(8))
def test_no_step_rises_without_power_however_close_to_the_cut(board: EmulatedBoard, part: int) -> None:
    """ENABLE went first, and the machine 5 ticks later: a step between was counted that no driver made."""
    ready(board, acceleration=0, start=0)
    stands = 0
    for before in range(10 * part, 10 * part + 10):
        board.input((board.now, PIN_INTERLOCK, 0))
        board.run(board.now + MS)
        board.request(Clear())
        forget(board)
        assert start(board, stands + 500, hold=1).status == StatusCode.OK
        board.run(board.now + LEAD + MS)
        board.input((board.now, PIN_INTERLOCK, 1))
        board.run_to("board_turntable_cut")
        due = board.rises(PIN_STEP)[-1] + intervals(board)[0]
        board.stall(due - before - board.now)  # the step rises so many ticks into the cut
        board.run(board.now + 2 * MS)
        enabled = False
        for _, pin, level in board.transitions:
            enabled = (level == 0) if pin == PIN_ENABLE else enabled
            assert enabled or pin != PIN_STEP or not level, before
        [done] = board.heard(TurntableDone)
        assert done.position - stands == len(board.rises(PIN_STEP))
        stands = done.position


def test_a_driver_has_time_to_wake_before_the_first_step(board: EmulatedBoard) -> None:
    """The first step came within 50 us of ENABLE: a driver that sleeps until then misses it."""
    ready(board)
    forget(board)
    assert start(board, 30, hold=1).status == StatusCode.OK
    until_it_stands(board)
    [on] = board.falls(PIN_ENABLE)
    assert LEAD <= board.rises(PIN_STEP)[0] - on <= LEAD + 5 * US
    board.run_alive(board.now + 60 * MS)
    forget(board)
    told = board.now
    assert start(board, 0, period=20_000).status == StatusCode.OK  # held: at once
    until_it_stands(board)
    assert board.rises(PIN_STEP)[0] - told <= MS + START // 2
    assert board.falls(PIN_ENABLE) == []
    board.run(board.now + LAG + MS)
    forget(board)
    assert start(board, 0, hold=1).status == StatusCode.OK  # no step, but power
    board.run(board.now + 2 * MS)
    [on] = board.falls(PIN_ENABLE)
    board.events.clear()
    assert start(board, 5, period=20_000).status == StatusCode.OK  # what is left of the lead
    assert until_it_stands(board) == 5
    assert LEAD <= board.rises(PIN_STEP)[0] - on <= LEAD + 5 * US


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("how", ["arrival", "stop", "disarm", "end", "hard end"])
def test_the_rotor_comes_to_rest_before_its_power_goes(board: EmulatedBoard, how: str) -> None:
    """ENABLE went within a round of the last step, while the rotor still swung."""
    ready(board, switches=BOTH | (TurntableFlag.END_HARD if how == "hard end" else TurntableFlag(0)))
    forget(board)
    assert start(board, 60 if how == "arrival" else 5_000).status == StatusCode.OK
    board.run_alive(board.now + 60 * MS)
    if how in ("stop", "disarm"):
        board.request(TurntableStop() if how == "stop" else Arm(outputs=ArmFlag(0)))
    elif how != "arrival":
        board.input((board.now, PIN_END_HIGH, 1))
    until_it_stands(board)
    last = board.falls(PIN_STEP)[-1]
    assert board.now < last + LAG // 2  # told when the last step was made, not when the power goes
    assert StateFlag.TURNTABLE_MOVING not in state(board)
    board.run(last + LAG + 2 * ROUND)
    [off] = board.rises(PIN_ENABLE)
    assert LAG <= off - last <= LAG + 2 * ROUND


@pytest.mark.deep(gate="tests/emulator/test_turntable.py::test_the_rotor_comes_to_rest_before_its_power_goes")
def test_while_the_rotor_swings_a_move_begins_at_once_and_an_interlock_takes_its_power(board: EmulatedBoard) -> None:
    ready(board, acceleration=0)
    forget(board)
    assert start(board, 20).status == StatusCode.OK
    until_it_stands(board)
    board.run(board.falls(PIN_STEP)[-1] + LAG - MS)
    made, told = len(board.rises(PIN_STEP)), board.now
    board.events.clear()
    assert start(board, 0).status == StatusCode.OK
    assert until_it_stands(board) == 0
    assert board.rises(PIN_STEP)[made] - told <= MS
    assert board.rises(PIN_ENABLE) == []
    opens = board.now
    assert opens < board.falls(PIN_STEP)[-1] + LAG
    board.input((opens, PIN_INTERLOCK, 1))
    board.run(opens + MS)
    [off] = board.rises(PIN_ENABLE)
    assert off - opens <= ROUND
    assert [fault.fault for fault in board.heard(Fault)] == [FaultCode.INTERLOCK]


def test_a_place_read_while_it_moves_is_that_of_the_pins_and_never_goes_back(board: EmulatedBoard) -> None:
    ready(board, acceleration=0)
    assert board.request(Move(2_000, 10_000, 0)).status == StatusCode.OK
    rng, before = random.Random(5), 0
    for _ in range(150):
        board.run(board.now + rng.randrange(10_000))
        rises = len(board.rises(PIN_STEP))
        place = status(board).turntable
        assert before <= place and rises <= place <= len(board.rises(PIN_STEP)) + 1
        before = place
    assert before > 150
