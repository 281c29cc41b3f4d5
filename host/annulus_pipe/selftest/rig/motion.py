"""Promises of the turntable and the odometer."""

import itertools
import math
import random

from annulus_pipe.controller import (
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_INTERLOCK,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_STEP,
    PIN_SYNC,
    TICK_HZ,
    TURNTABLE_LAG_MS,
    TURNTABLE_LEAD_MS,
    TURNTABLE_POSITION_MAX_STEPS,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Clear,
    Edge,
    Fault,
    FaultCode,
    Health,
    HealthReply,
    Move,
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
from annulus_pipe.selftest.rig.board import MS, US, Board, EdgeIn, Played, Scene, expect
from annulus_pipe.selftest.rig.promises import camera, configure, ok, promised, span

UNDER_WAY = 3  # steps that are made after it was decided that none shall begin
MET = 2  # ticks by which a period may differ
ROUND = 600 * US  # of the main loop, at most, beside commands; README
FAST, START, STEEP = 12_000, 200_000, 40_000  # 8333 steps/s from 500 steps/s at 40000 steps/s^2: 866 steps of ramp
LEAD, LAG = TURNTABLE_LEAD_MS * MS, TURNTABLE_LAG_MS * MS
STAMP = 20 * US  # DIRECTION and ENABLE are stamped by an interrupt of the rig
NO_SWITCH = TurntableFlag(0)
GRAY = ((1, 1), (0, 1), (0, 0), (1, 0))  # A falls first: up, from both high


def turntable(
    *,
    lowest: int = -400_000_000,
    highest: int = 400_000_000,
    acceleration: int = STEEP,
    start: int = START,
    switches: TurntableFlag = NO_SWITCH,
) -> Turntable:
    return Turntable(lowest, highest, acceleration, start, switches)


def status(board: Board) -> StatusReply:
    reply = board.request(Status())
    assert isinstance(reply, StatusReply)
    return reply


def stands(played: Played) -> int:
    """The position it reported when it stood."""
    reported = [done.position for done in played.heard(TurntableDone)]
    expect(len(reported) == 1, f"turntable_done reported {len(reported)} times")
    return reported[0]


def gaps(played: Played) -> list[float]:
    return [b - a for a, b in itertools.pairwise(played.rises(PIN_STEP))]


def levels(played: Played, pin: int) -> list[tuple[float, int]]:
    return [(tick, level) for tick, p, level in played.transitions if p == pin]


@promised("25 steps of 200 us, then let go", "25 steps, period within 2, ENABLE high after", PIN_STEP, PIN_ENABLE)
def the_turntable_makes_its_steps_and_lets_go(board: Board) -> str:
    at = status(board).turntable
    move = Move(position=at + 25, period=20_000, hold=0)
    played = board.play(Scene(until=MS, watch=(PIN_STEP,), orders=[(MS // 2, move)], after=10 * MS + LEAD + LAG))
    rises = played.rises(PIN_STEP)
    seen = f"{len(rises)} steps, period {span(gaps(played))}"
    expect(stands(played) == at + 25 and len(rises) == 25, seen)
    expect(all(abs(gap - 20_000) <= MET + board.slack(20_000) for gap in gaps(played)), seen)
    enable = levels(played, PIN_ENABLE)
    expect([level for _, level in enable] == [0, 1], f"{seen}, ENABLE {[level for _, level in enable]}")
    (on, _), (off, _) = enable
    lead, lag = rises[0] - on, off - rises[-1]
    seen += f", ENABLE {lead / MS:.2f} ms before and {lag / MS:.2f} ms after"
    expect(lead > LEAD - STAMP and lag > LAG - STAMP, seen)
    return seen


@promised("Ramps of 1500 steps there and back", "every step, monotone, never faster than asked", PIN_STEP)
def a_ramp_speeds_up_and_slows_down(board: Board) -> str:
    ok(board, turntable())
    stood, fastest_seen = status(board).turntable, math.inf
    for target in (1_500, -1_500):
        move = Move(position=stood + target, period=FAST, hold=0)
        played = board.play(Scene(until=MS, watch=(PIN_STEP,), orders=[(MS // 2, move)], after=500 * MS))
        made, between = len(played.rises(PIN_STEP)), gaps(played)
        expect(stands(played) == stood + target and made == abs(target), f"{made} steps of {abs(target)}")
        slack = MET + board.slack(START)
        fastest = between.index(min(between))
        expect(min(between) >= FAST - slack, f"shortest interval {min(between):.1f}")
        up = all(b <= a + slack for a, b in itertools.pairwise(between[: fastest + 1]))
        down = all(b >= a - slack for a, b in itertools.pairwise(between[fastest:]))
        expect(up and down, "intervals not monotone")
        for i, gap in enumerate(between):
            steps = min(i, len(between) - 1 - i) + 2 * UNDER_WAY
            expect(
                gap >= 0.98 * TICK_HZ / math.sqrt((TICK_HZ / START) ** 2 + 2 * STEEP * steps), "faster than its ramp"
            )
        stood += target
        fastest_seen = min(fastest_seen, min(between))
    return f"2 x 1500 steps, shortest interval {fastest_seen:.1f}"


@promised("turntable_stop from full speed", "within the braking distance", PIN_STEP, unit="steps")
def a_stop_brakes_along_the_ramp(board: Board) -> str:
    ok(board, turntable())
    at = status(board).turntable
    stop_at = 150 * MS
    orders = [(MS // 2, Move(position=at + 50_000, period=FAST, hold=0)), (stop_at, TurntableStop())]
    played = board.play(Scene(until=stop_at, watch=(PIN_STEP,), orders=orders, after=300 * MS))
    made = len(played.rises(PIN_STEP))
    reported = played.heard(TurntableStopped)
    expect(stands(played) == at + made, f"reported {stands(played) - at} steps, {made} made")
    expect(len(reported) == 1 and (reported[0].cause, reported[0].lost) == (StopCause.STOPPED, 0), "no stop reported")
    between = gaps(played)
    last_fast = max(i for i, gap in enumerate(between) if gap <= min(between) + MET)
    braking = ((TICK_HZ / min(between)) ** 2 - (TICK_HZ / START) ** 2) / (2 * STEEP)
    took = made - 1 - last_fast
    expect(took <= braking + 2 * UNDER_WAY, f"{took} steps to stand, {braking:.0f} of ramp")
    down = all(b >= a - MET - board.slack(START) for a, b in itertools.pairwise(between[last_fast:]))
    expect(down, "intervals not monotone")
    return f"{took} of {braking:.0f} + {2 * UNDER_WAY}, position true"


def _end_switch(board: Board, sign: int, pin: int, cause: StopCause) -> str:
    switches = TurntableFlag.END_LOW | TurntableFlag.END_HIGH | TurntableFlag.END_HARD
    ok(board, turntable(switches=switches))
    at = status(board).turntable
    touched = 120 * MS
    scene = Scene(
        until=touched,
        watch=(PIN_STEP,),
        after=200 * MS,
        orders=[(MS // 2, Move(position=at + sign * 40_000, period=FAST, hold=0))],
        edges=[(touched, pin, 1), (touched + 50, pin, 0)],
    )
    played = board.play(scene)
    made = len(played.rises(PIN_STEP))
    expect(stands(played) == at + sign * made, f"reported {abs(stands(played) - at)} steps, {made} made")
    late = sum(tick > touched + ROUND for tick in played.rises(PIN_STEP))
    reported = played.heard(TurntableStopped)
    expect(len(reported) == 1 and reported[0].cause is cause and reported[0].lost == 1, "no end switch reported")
    expect(late <= UNDER_WAY, f"{late} steps after it and a round")
    return f"{late} steps after it"


@promised("Upper end switch touched for 0.5 us", "3 steps and a round at most", PIN_STEP, PIN_END_HIGH, unit="steps")
def the_upper_end_switch_stops_it_however_short_the_touch(board: Board) -> str:
    return _end_switch(board, 1, PIN_END_HIGH, StopCause.END_HIGH)


@promised("Lower end switch touched for 0.5 us", "3 steps and a round at most", PIN_STEP, PIN_END_LOW, unit="steps")
def the_lower_end_switch_stops_it_however_short_the_touch(board: Board) -> str:
    return _end_switch(board, -1, PIN_END_LOW, StopCause.END_LOW)


@promised(
    "Move towards an end switch that is reached",
    "refused, with which; away is allowed",
    PIN_STEP,
    PIN_END_HIGH,
    unit="",
)
def no_move_towards_an_end_that_is_reached(board: Board) -> str:
    ok(board, turntable(switches=TurntableFlag.END_HIGH))
    at = status(board).turntable
    board.play(Scene(until=3 * MS, edges=[(MS, PIN_END_HIGH, 1)]))
    refused = board.request(Move(position=at + 5, period=20_000, hold=0))
    expect(
        (refused.status, refused.detail) == (StatusCode.UNSAFE, StopCause.END_HIGH), f"answered {refused.status.name}"
    )
    away = Move(position=at - 5, period=20_000, hold=0)
    played = board.play(Scene(until=MS, watch=(PIN_STEP,), orders=[(MS // 2, away)], after=LEAD + 10 * MS))
    expect(len(played.rises(PIN_STEP)) == 5, f"{len(played.rises(PIN_STEP))} steps away of 5")
    return "refused; 5 steps away"


@promised(
    "Interlock opens while it moves",
    "no step after 0.25 ms and a round, ENABLE high",
    PIN_STEP,
    PIN_ENABLE,
    PIN_INTERLOCK,
    unit="ms",
)
def an_opened_interlock_ends_motion_and_takes_its_power(board: Board) -> str:
    ok(board, turntable())
    at = status(board).turntable
    opens = 80 * MS
    scene = Scene(
        until=opens,
        watch=(PIN_STEP,),
        after=100 * MS,
        orders=[(MS // 2, Move(position=at + 30_000, period=FAST, hold=1))],
        edges=[(opens, PIN_INTERLOCK, 1), (opens + 100, PIN_INTERLOCK, 0)],
    )
    played = board.play(scene)
    last = max(played.rises(PIN_STEP), default=0.0) - opens
    enable = levels(played, PIN_ENABLE)
    off = enable[-1][0] - opens if enable else math.inf
    seen = f"last step {last / MS:+.3f}, ENABLE high {off / MS:+.3f}"
    expect(last <= ROUND and bool(enable) and enable[-1][1] == 1 and 0 < off <= ROUND + STAMP, seen)
    expect(stands(played) == at + len(played.rises(PIN_STEP)), f"{seen}; reported another position")
    faults = [fault.fault for fault in played.heard(Fault)]
    expect(faults == [FaultCode.INTERLOCK], f"{seen}; faults {faults}")
    expect(board.request(Move(at, 20_000, 0)).status is StatusCode.UNSAFE, f"{seen}; moves again without a clear")
    ok(board, Clear())
    return seen


@promised("A host that falls silent while it moves", "no step after 500 ms and a round", PIN_STEP, unit="ms")
def a_silent_host_ends_motion(board: Board) -> str:
    configure(board)  # with the host timeout there is unless another is given
    ok(board, turntable())
    at = status(board).turntable
    move = Move(position=at + 100_000, period=FAST, hold=0)
    played = board.play(Scene(until=MS, watch=(PIN_STEP,), orders=[(MS // 2, move)], after=560 * MS, silent=True))
    rises = played.rises(PIN_STEP)
    lasted = (rises[-1] - rises[0]) / MS if rises else 0.0
    seen = f"{lasted:.1f} from its first step to its last"
    expect(400 < lasted <= 500 + ROUND / MS, seen)
    expect([f.fault for f in played.heard(Fault)] == [FaultCode.HOST_TIMEOUT], f"{seen}; no host_timeout")
    expect(stands(played) == at + len(rises), f"{seen}; reported another position")
    return seen


@promised("Disarming while it moves", "brakes, and stands where it says", PIN_STEP, unit="steps")
def disarming_brakes_a_move(board: Board) -> str:
    ok(board, turntable())
    at = status(board).turntable
    told_at = 100 * MS
    orders = [(MS // 2, Move(position=at - 50_000, period=FAST, hold=0)), (told_at, Arm(ArmFlag(0)))]
    played = board.play(Scene(until=told_at, watch=(PIN_STEP,), orders=orders, after=300 * MS))
    made = len(played.rises(PIN_STEP))
    expect(stands(played) == at - made, f"reported {at - stands(played)} steps, {made} made")
    reported = played.heard(TurntableStopped)
    expect(len(reported) == 1 and (reported[0].cause, reported[0].lost) == (StopCause.STOPPED, 0), "no stop reported")
    last = gaps(played)[-1]
    expect(last >= 0.6 * START, f"last interval {last:.0f}: it did not brake")
    return f"{made} of 50000, all reported"


@promised("End switches that are not configured", "not looked at", PIN_STEP, PIN_END_LOW, PIN_END_HIGH, unit="steps")
def switches_that_are_not_configured_are_not_looked_at(board: Board) -> str:
    ok(board, turntable(acceleration=0, start=0))
    at = status(board).turntable
    open_ends: list[EdgeIn] = [(MS // 4, PIN_END_LOW, 1), (MS // 4, PIN_END_HIGH, 1)]
    orders = [(MS, Move(position=at + 50, period=FAST, hold=0))]
    played = board.play(Scene(until=MS, watch=(PIN_STEP,), edges=open_ends, orders=orders, after=15 * MS))
    made = len(played.rises(PIN_STEP))
    expect(stands(played) == at + 50 and made == 50 and not played.heard(TurntableStopped), f"{made} of 50")
    between = gaps(played)
    expect(all(abs(gap - FAST) <= MET + board.slack(FAST) for gap in between), f"50 steps, period {span(between)}")
    return f"50 of 50, period {span(between)}"


@promised("Positions beyond the limits", "refused", PIN_STEP, unit="")
def positions_beyond_the_limits_are_refused(board: Board) -> str:
    far = TURNTABLE_POSITION_MAX_STEPS
    for position in (1_431_655_766, -1_431_655_766, far + 1, -far - 1, 2**31 - 1, -(2**31)):
        got = board.request(Move(position, 10_000, 0)).status
        expect(got is StatusCode.OUT_OF_RANGE, f"{position}: {got.name.lower()}")
    at = status(board).turntable
    ok(board, turntable(lowest=at - 4, highest=at + 6))
    for position in (at + 7, at - 5):
        got = board.request(Move(position, 20_000, 0)).status
        expect(got is StatusCode.OUT_OF_RANGE, f"beyond a soft limit: {got.name.lower()}")
    moving = bool(StateFlag.TURNTABLE_MOVING & status(board).state)
    expect(not moving, "it moves")
    return "8 of 8"


@promised("The place, asked while it moves", "never goes back, and ends where it stands", PIN_STEP, unit="steps")
def a_place_asked_while_it_moves_never_goes_back(board: Board) -> str:
    ok(board, turntable(acceleration=0, start=0))
    at = status(board).turntable
    asks = [(LEAD + 2 * MS + i * 3 * MS, Status()) for i in range(12)]
    orders = [(MS // 2, Move(position=at + 400, period=FAST, hold=0)), *asks]
    played = board.play(Scene(until=LEAD + 60 * MS, watch=(PIN_STEP,), orders=orders, after=LAG))
    asked = [reply.turntable - at for reply in played.replies if isinstance(reply, StatusReply)]
    seen = f"{len(asked)} times, {asked[0]} .. {asked[-1]} of 400"
    expect(asked == sorted(asked) and asked[0] >= 0 and asked[-1] <= 400, seen)
    expect(stands(played) == at + 400 == at + len(played.rises(PIN_STEP)), seen)
    return seen


@promised("Direction", "follows the sign of the move", PIN_STEP, PIN_DIRECTION, unit="")
def direction_is_that_of_the_move(board: Board) -> str:
    at = status(board).turntable
    orders = [(MS // 2, Move(at + 3, 20_000, 0)), (10 * MS, Move(at - 3, 20_000, 0))]
    played = board.play(Scene(until=10 * MS, watch=(PIN_STEP,), orders=orders, after=10 * MS))
    rises = played.rises(PIN_STEP)
    changes = levels(played, PIN_DIRECTION)
    expect(len(rises) == 9, f"{len(rises)} steps of 9")
    up, down = rises[:3], rises[3:]
    fell = [tick for tick, level in changes if level == 0]
    expect(bool(fell) and up[-1] < fell[-1] < down[0] + STAMP, f"changes {changes}")
    return "3 up, 6 down"


# ---- odometer ----


class OdometerWheel:
    """Turns the wheel: input edges for a step at a tick, and the truth."""

    def __init__(self) -> None:
        self.place = 0

    def step(self, tick: float, by: int) -> list[EdgeIn]:
        before, after = GRAY[self.place % 4], GRAY[(self.place + by) % 4]
        self.place += by
        lines = zip((PIN_ODOMETER_A, PIN_ODOMETER_B), before, after, strict=True)
        return [(tick, pin, level) for pin, old, level in lines if old != level]

    def home(self, tick: float) -> list[EdgeIn]:
        """To where both lines are high, as they stand between two scenes."""
        edges = []
        while self.place % 4:
            edges += self.step(tick, -1)
            tick += 2_000
        return edges


@promised(
    "Any motion, read at every edge", "exact at every edge", PIN_SYNC, PIN_ODOMETER_A, PIN_ODOMETER_B, unit="counts"
)
def the_odometer_is_exact_at_every_edge(board: Board) -> str:
    configure(board, period=400_000)
    begins = status(board).odometer
    cable, rng, truth, edges = OdometerWheel(), random.Random(2), [], []
    tick = 2.0 * MS
    for _ in range(30):
        direction = rng.choice((1, 1, -1))
        for _ in range(rng.randrange(1, 60)):
            tick += rng.randrange(200, 4_000)
            edges += cable.step(tick, direction)
        tick += 400_000
        edges += camera([tick])
        truth.append(cable.place)
        tick += 5_000
    edges += cable.home(tick)
    played = board.play(Scene(until=int(tick) + 5 * MS, edges=edges))
    read = [edge.odometer - begins for edge in played.heard(Edge)]
    wrong = sum(a != b for a, b in zip(read, truth, strict=False)) + abs(len(read) - len(truth))
    expect(wrong == 0, f"{wrong} of {len(truth)} wrong")
    return f"{len(truth)} edges, {truth[-1]} counts at the last"


@promised("300 counts there and back, without a camera", "0", PIN_ODOMETER_A, PIN_ODOMETER_B, unit="counts")
def there_and_back_reads_zero(board: Board) -> str:
    begins, cable, edges, tick = status(board).odometer, OdometerWheel(), [], 1.0 * MS
    for by in [1] * 300 + [-1] * 300:
        tick += 2_000
        edges += cable.step(tick, by)
    board.play(Scene(until=int(tick) + 3 * MS, edges=edges))
    read = status(board).odometer - begins
    expect(read == 0, f"{read}")
    return "0"


@promised(
    "Both lines at once, 30 times",
    "30 counted as impossible, reported without a flood",
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    unit="counts",
)
def lines_that_change_together_are_counted(board: Board) -> str:
    def impossible() -> int:
        reply = board.request(Health())
        assert isinstance(reply, HealthReply)
        return reply.odometer_impossible

    before, begins, cable, edges = impossible(), status(board).odometer, OdometerWheel(), []
    for i in range(30):
        edges += cable.step(MS + i * MS, 2)
    played = board.play(Scene(until=140 * MS, edges=edges))
    counted = impossible() - before
    reported = [fault for fault in played.heard(Fault) if fault.fault is FaultCode.ODOMETER]
    seen = f"{counted} counted, {len(reported)} times reported"
    expect(counted == 30 and 1 <= len(reported) <= 3, seen)
    expect(status(board).odometer == begins, f"{seen}; the place moved")
    return seen
