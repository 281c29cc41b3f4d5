"""What any head promises, seen through its own line and by its own measurements."""

import itertools
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from head_bench import Bench

from annulus_pipe.controller import (
    FRAME_PERIOD_MIN_TICKS,
    LAMP_DUTY_MAX_PERMILLE,
    LAMP_WIDTH_MAX_TICKS,
    MICROWAVE_PULSE_MAX_TICKS,
    MICROWAVE_PULSE_MIN_TICKS,
    PIN_LED,
    PIN_STEP,
    PIN_SYNC,
    TICK_HZ,
    TICKS_PER_US,
    TURNTABLE_PERIOD_MIN_TICKS,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    BootCause,
    Burst,
    BurstCode,
    BurstDone,
    BurstStop,
    Clear,
    Commit,
    Edge,
    Fault,
    FaultCode,
    Measure,
    Move,
    Ping,
    PingReply,
    Reread,
    RereadReply,
    Stage,
    StageReply,
    StateFlag,
    StatusCode,
)
from annulus_pipe.link.session import EventsLost
from annulus_pipe.selftest.lamps import LATENCY, lamp_rows
from annulus_pipe.selftest.microwave import interlock_closed, microwave_rows
from annulus_pipe.selftest.promise import PromiseVerdict
from annulus_pipe.selftest.scope import OWED_S, ScopeTrigger
from annulus_pipe.vocabulary import Lamp

PERIOD = TICK_HZ // 100
MS = 1000 * TICKS_PER_US


def stage(*, generation: int = 1, ratio: int = 4, timeout_ms: int = 0, width: int = 100_000, **changes: int) -> Stage:
    """100 frames a second, everything exposes always; both lamps alike."""
    fields = {"frame_period": PERIOD, "exposure": PERIOD, "readout": 0, "tolerance": 100} | changes
    return Stage(
        generation=generation,
        ratio=ratio,
        host_timeout=timeout_ms,
        projector_delay=50,
        projector_width=width,
        led_delay=50,
        led_width=width,
        **fields,
    )


@pytest.mark.deep(but=1)
def test_it_says_the_limits_this_host_was_made_for(bench: Bench) -> None:
    who = bench.client.identity
    assert who.tick_hz == TICK_HZ
    assert (who.lamp_width_max, who.lamp_duty_max) == (LAMP_WIDTH_MAX_TICKS, LAMP_DUTY_MAX_PERMILLE)
    assert (who.pulse_min, who.pulse_max) == (MICROWAVE_PULSE_MIN_TICKS, MICROWAVE_PULSE_MAX_TICKS)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    ("wrong", "status"),
    [
        (stage(frame_period=FRAME_PERIOD_MIN_TICKS - 1), StatusCode.OUT_OF_RANGE),
        (stage(width=LAMP_WIDTH_MAX_TICKS + 1), StatusCode.OUT_OF_RANGE),
        (stage(width=PERIOD * LAMP_DUTY_MAX_PERMILLE // 1000 + 1), StatusCode.DUTY),
        (stage(exposure=PERIOD // 2, readout=PERIOD // 4), StatusCode.WINDOW),
        (stage(timeout_ms=49), StatusCode.OUT_OF_RANGE),
        (Move(10, TURNTABLE_PERIOD_MIN_TICKS - 1, 0), StatusCode.OUT_OF_RANGE),
        (Commit(9), StatusCode.BAD_STATE),
        (Burst(BurstCode.SINGLE, 100, 1, 100_000, 0), StatusCode.BAD_STATE),  # not armed
        (Measure(1, 30, 0, 2, 0), StatusCode.OUT_OF_RANGE),
    ],
    ids=lambda value: type(value).__name__.lower() if isinstance(value, Stage | Move | Burst) else None,
)
def test_what_is_beyond_a_limit_is_refused(bench: Bench, wrong: Stage, status: StatusCode) -> None:
    assert bench.status_of(wrong) is status


@pytest.mark.deep(but=1)
def test_a_configuration_is_in_force_only_once_committed(bench: Bench) -> None:
    answer = bench.client.request(stage(generation=7, readout=PERIOD // 5))
    assert isinstance(answer, StageReply)
    assert (answer.window_open, answer.window_close) == (0, PERIOD - PERIOD // 5)
    status = bench.scope.status()
    assert status.generation == 0
    assert StateFlag.STAGED in status.state
    assert bench.status_of(Commit(7)) is StatusCode.OK
    bench.scope.quiet(0.01)
    assert bench.scope.status().generation == 7


@pytest.mark.deep(but=1)
def test_nothing_is_armed_before_it_may_be(firing: Bench) -> None:
    assert firing.status_of(Arm(ArmFlag.LAMPS)) is StatusCode.BAD_STATE  # nothing configured
    closed = interlock_closed(firing.scope)
    assert firing.status_of(Arm(ArmFlag.MICROWAVE)) is (StatusCode.OK if closed else StatusCode.UNSAFE)


@pytest.mark.deep(but=1)
def test_the_tick_goes_on_at_its_rate(bench: Bench) -> None:
    first = bench.client.request(Ping())
    began = bench.client.now_s()
    bench.scope.quiet(1.0)
    second = bench.client.request(Ping())
    took = bench.client.now_s() - began
    assert isinstance(first, PingReply)
    assert isinstance(second, PingReply)
    assert (second.tick - first.tick) % 2**32 == pytest.approx(took * TICK_HZ, abs=5 * MS)  # both round trips


@pytest.mark.deep(but=1)
def test_edges_are_told_without_a_gap_at_their_period_and_in_the_lamps_order(jumpered: Bench) -> None:
    jumpered.configure(stage())
    jumpered.client.request(Arm(ArmFlag.LAMPS))
    jumpered.scope.heard.clear()
    jumpered.scope.run_steps(60, PERIOD)
    edges = jumpered.heard(Edge)
    assert [later.edge - edge.edge for edge, later in itertools.pairwise(edges)] == [1] * 59
    assert not [h for h in jumpered.scope.heard if isinstance(h, EventsLost)]
    assert [edge.slot for edge in edges] == [i % 5 for i in range(60)]
    assert [edge.lamp for edge in edges] == [Lamp.LED if i % 5 == 4 else Lamp.PROJECTOR for i in range(60)]
    gaps = [(later.tick - edge.tick) % 2**32 for edge, later in itertools.pairwise(edges)]
    assert max(gaps) - min(gaps) <= 2
    assert abs(gaps[0] - PERIOD) <= 4


@pytest.mark.deep(but=1)
def test_the_last_events_can_be_asked_for_again(jumpered: Bench) -> None:
    jumpered.scope.run_steps(70, PERIOD)
    following = jumpered.scope.status().events
    again = jumpered.client.request(Reread((following - 64) % 65536, 64))
    assert isinstance(again, RereadReply)
    assert ((following - again.first) % 65536, again.count) == (64, 64)
    assert not [h for h in jumpered.client.poll(0.1) if isinstance(h, EventsLost)]


@pytest.mark.deep(but=1)
def test_a_flash_follows_its_edge_by_a_constant(jumpered: Bench) -> None:
    """By its own measurement: delay and width to the tick."""
    jumpered.configure(stage(ratio=0, width=120))
    jumpered.scope.begin(ScopeTrigger(PIN_STEP, 1, PERIOD // 2 - 100), PIN_SYNC, looks=20)
    jumpered.client.request(Arm(ArmFlag.LAMPS))
    jumpered.scope.steps(25, PERIOD)
    taken, differs = jumpered.scope.wait()
    assert (taken, differs) == (20, False)
    look = jumpered.scope.fetch()
    (fell,), (on,), (off,) = look.falls(PIN_SYNC), look.rises(PIN_LED), look.falls(PIN_LED)
    latency = LATENCY[jumpered.client.identity.board.rstrip(b"\0").decode()]
    assert abs(on - fell - 50 - latency) <= 1
    assert abs(off - on - 120) <= 1
    jumpered.scope.disarm()
    jumpered.scope.stand(1.0)


@pytest.mark.deep(but=1)
def test_a_silent_host_leaves_it_dark_and_a_latched_fault_wants_clearing(jumpered: Bench) -> None:
    jumpered.configure(stage(ratio=0, timeout_ms=50))
    jumpered.scope.heard.clear()
    jumpered.scope.steps(25, PERIOD)
    jumpered.client.request(Arm(ArmFlag.LAMPS))
    jumpered.scope.quiet(0.2)
    (fault,) = jumpered.heard(Fault)
    assert fault.fault is FaultCode.HOST_TIMEOUT
    assert 50 * MS <= fault.detail <= 51 * MS
    later = [edge for edge in jumpered.heard(Edge) if (edge.tick - fault.tick) % 2**32 < 2**31]
    assert {edge.lamp for edge in later} <= {Lamp.DARK}
    assert StateFlag.TURNTABLE_MOVING not in jumpered.scope.status().state
    assert jumpered.status_of(Arm(ArmFlag.LAMPS)) is StatusCode.UNSAFE
    assert jumpered.status_of(Clear()) is StatusCode.OK
    jumpered.scope.heard.clear()
    jumpered.scope.run_steps(5, PERIOD)  # nothing is armed by clearing
    assert [edge.lamp for edge in jumpered.heard(Edge)] == [Lamp.DARK] * 5
    assert jumpered.status_of(Arm(ArmFlag.LAMPS)) is StatusCode.OK
    jumpered.scope.disarm()
    jumpered.scope.stand(1.0)


@pytest.mark.deep(but=1)
def test_a_reset_forgets_everything_and_says_so(bench: Bench) -> None:
    bench.configure(stage(generation=5))
    before = bench.client.identity
    bench.restart()
    after = bench.client.identity
    assert after.boot != before.boot
    assert after.cause is BootCause.HOST_RESET
    status = bench.scope.status()
    assert status.generation == 0
    assert not status.state & (StateFlag.LAMPS_ARMED | StateFlag.MICROWAVE_ARMED)


@pytest.mark.deep(but=1)
def test_bursts_are_counted_and_stopped_between_two(firing: Bench) -> None:
    if not interlock_closed(firing.scope):
        pytest.skip("needs the interlock closed: GP7 (pin 10) to ground (pin 13)")
    firing.scope.quiet(OWED_S)
    firing.client.request(Arm(ArmFlag.MICROWAVE))
    assert firing.scope.fire(Burst(BurstCode.MPSL25, 50, 20, PERIOD, 0)) is StatusCode.OK
    firing.scope.listen(0.01)
    end = firing.client.now_s() + 2.0
    while not firing.heard(BurstDone) and firing.client.now_s() < end:
        firing.scope.listen(0.01)
    (done,) = firing.heard(BurstDone)
    assert (done.done, done.fault) == (20, FaultCode.NONE)
    firing.scope.heard.clear()
    firing.scope.listen(0.05)
    assert firing.scope.fire(Burst(BurstCode.MPSL25, 50, 1000, PERIOD, 0)) is StatusCode.OK
    firing.scope.listen(0.05)
    assert firing.status_of(BurstStop()) is StatusCode.OK
    end = firing.client.now_s() + 1.0
    while not firing.heard(BurstDone) and firing.client.now_s() < end:
        firing.scope.listen(0.01)
    (done,) = firing.heard(BurstDone)
    assert 0 < done.done < 100
    assert done.fault is FaultCode.NONE


@pytest.mark.deep(but=1)
def test_nothing_measured_breaks_a_promise(jumpered: Bench) -> None:
    """The self-test, short: what it measures of this head it would also print."""
    board = jumpered.client.identity.board.rstrip(b"\0").decode()
    rows = lamp_rows(jumpered.scope, board, 20)
    if interlock_closed(jumpered.scope):
        rows += microwave_rows(jumpered.scope)
    jumpered.scope.end()
    assert [row for row in rows if row.verdict is not PromiseVerdict.KEPT] == []


def test_an_outside_analyser_finds_the_same_flashes(
    jumpered: Bench, capture: Callable[[Callable[[], None]], Path]
) -> None:
    """sigrok's own timing decoder, on a logic analyser's capture or the emulator's VCD."""

    def flash() -> None:
        jumpered.configure(stage(ratio=0, width=100_000))
        jumpered.client.request(Arm(ArmFlag.LAMPS))
        jumpered.scope.run_steps(10, PERIOD)
        jumpered.scope.disarm()

    file = capture(flash)
    kind = ["-I", "vcd"] if file.suffix == ".vcd" else []
    command = ["sigrok-cli", "-i", str(file), *kind, "-P", "timing:data=led", "-A", "timing=time"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    scale = {"s": 1.0, "ms": 1e-3, "μs": 1e-6, "ns": 1e-9}
    times = [float(number) * scale[unit] for number, unit in re.findall(r"([\d.]+) (s|ms|μs|ns)\b", said)]
    assert sum(abs(t - 1e-3) < 1e-6 for t in times) == 10
    assert sum(abs(t - 9e-3) < 1e-6 for t in times) == 9
