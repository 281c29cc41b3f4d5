"""A head is brought into service, kept alive, and brought back by itself after resets and faults."""

import pytest

from annulus_pipe.link.head import EdgeSeen, HeadControl, HeadEvent, LampsCut, PhaseChanged
from annulus_pipe.link.messages import (
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Commit,
    Edge,
    Fault,
    FaultCode,
    Identify,
    Interlock,
    InterlockFlag,
    Ping,
    Polarity,
    Preamble,
    Slides,
    SlidesLit,
    Stage,
    StatusCode,
    Wiring,
)
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.pins import Pins, pins_of
from annulus_pipe.link.preamble import preamble_of
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import EdgeFlag, Lamp

MS = 1_000_000
FINE = EdgeFlag(0)
STAGE = Stage(1, 4, 4_000_000, 3_800_000, 2_800_000, 50, 0, 450_000, 500_000, 575_000, 250_000)


class Bench:
    def __init__(self, head: HeadControl, controller: ScriptedController | None = None) -> None:
        self.head = head
        self.controller = controller or ScriptedController()
        self.now = 10**12
        self.news: list[HeadEvent] = []

    def run(self, milliseconds: int) -> None:
        for _ in range(milliseconds):
            self.now += MS
            self.controller.receive(self.head.pending(self.now), self.now)
            self.news += self.head.receive(self.controller.take(), self.now)

    def commands(self) -> list[type]:
        return [type(command) for command in self.controller.executed if type(command) is not Ping]

    def all(self, kind: type) -> list:
        return [news for news in self.news if isinstance(news, kind)]

    def edge(self, number: int, flags: EdgeFlag = FINE) -> None:
        origin = self.controller.tick_origin_ns
        assert origin is not None
        tick = (self.now - origin) // 10
        self.controller.emit(Edge(number, tick, number % 5, Lamp.PROJECTOR, 450_000, 500_000, 0, 1, flags))


def test_a_head_is_running_within_ten_milliseconds_of_its_first_answer() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(10)
    assert bench.head.phase is Phase.RUNNING and bench.controller.armed
    steps = [c for c in bench.commands() if c in (Identify, Arm, Stage, Commit)]
    assert steps == [Identify, Arm, Stage, Commit, Arm]  # dark before it is changed, whoever was here before


def test_the_controller_hears_the_host_far_more_often_than_its_timeout() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(100)
    silent, longest = 0, 0
    for _ in range(3000):
        heard = len(bench.controller.executed)
        bench.run(1)
        silent = 0 if len(bench.controller.executed) > heard else silent + 1
        longest = max(longest, silent)
    assert longest <= 100


def test_after_a_reset_the_lamps_are_armed_again_under_a_new_generation() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    before = bench.head.generation
    bench.controller.reset()
    bench.run(15)
    assert bench.head.phase is Phase.RUNNING and bench.controller.armed
    assert bench.head.generation == before + 1 and bench.head.rearms == 1 and bench.head.boot_epoch == 2
    assert PhaseChanged(Phase.SEARCHING, "the controller restarted") in bench.news


def test_edges_are_placed_in_host_time_also_those_heard_before_the_clock_locked() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(3)
    bench.edge(0)
    fell = bench.now
    bench.run(40)
    (seen,) = bench.all(EdgeSeen)
    assert abs(seen.host_ns - fell) <= 2 * MS and seen.boot_epoch == 1 and seen.flash.boot == 7


def test_after_a_reset_no_edge_is_placed_by_the_old_lifes_clock() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(500)
    bench.controller.reset()
    bench.run(1)
    bench.edge(0)
    fell = bench.now
    bench.run(40)
    (seen,) = bench.all(EdgeSeen)
    assert abs(seen.host_ns - fell) <= 2 * MS and seen.boot_epoch == 2


def test_edges_of_a_life_that_ended_before_its_clock_locked_are_never_placed() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(2)
    bench.edge(0)
    bench.run(1)
    bench.controller.reset()
    bench.run(50)
    assert bench.all(EdgeSeen) == [] and bench.head.edges_unplaced == 1


def test_a_latched_fault_is_cleared_and_the_lamps_armed_again() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.armed, bench.controller.fault = False, FaultCode.HOST_TIMEOUT
    origin = bench.controller.tick_origin_ns or 0
    at = bench.now
    bench.controller.emit(Fault((at - origin) // 10, FaultCode.HOST_TIMEOUT, 0))
    bench.run(20)
    assert bench.controller.armed and bench.controller.fault is FaultCode.NONE and bench.head.phase is Phase.RUNNING
    assert any(cut.why == "host_timeout" and abs(cut.from_ns - at) < 2 * MS for cut in bench.all(LampsCut))


def test_a_fault_whose_event_was_lost_is_found_by_the_next_dark_edge() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.armed, bench.controller.fault = False, FaultCode.HOST_TIMEOUT
    bench.edge(9, EdgeFlag.DISARMED)
    bench.run(10)
    assert bench.controller.armed and bench.head.phase is Phase.RUNNING


def test_a_fault_that_comes_back_is_not_cleared_in_a_storm() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.controller.refuse[Arm] = (StatusCode.UNSAFE, 0)
    bench.run(1000)
    assert bench.head.phase is not Phase.RUNNING
    assert len([c for c in bench.controller.executed if isinstance(c, Arm)]) < 25


def test_a_flash_outside_the_window_is_refused_in_the_users_words() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.controller.refuse[Stage] = (StatusCode.WINDOW, int(Lamp.LED))
    bench.run(50)
    assert bench.head.phase is Phase.REFUSED and not bench.controller.armed
    assert bench.head.problem == (
        "led flash 5750..8250 us leaves the window 2000..12000 us in which all rows expose"
        " (25 fps, exposure 38 ms, readout 28 ms)"
    )
    bench.controller.refuse.clear()
    bench.head.configure(STAGE)
    bench.run(20)
    assert bench.head.phase is Phase.RUNNING


def test_a_flash_over_the_duty_limit_is_refused_with_the_limit() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.controller.refuse[Stage] = (StatusCode.DUTY, int(Lamp.LED))
    bench.run(50)
    assert bench.head.problem == (
        "led flash of 2500 us is too long, expected 19000 us at most: 50 % of 38000 us, the shortest interval between"
        " edges (25 fps, tolerance 5 %)"
    )


def test_another_schema_is_never_armed_but_still_asked_for_its_state() -> None:
    bench = Bench(HeadControl(STAGE), ScriptedController(schema=0x12345678))
    bench.run(2000)
    assert bench.head.phase is Phase.MISMATCH and "12345678" in bench.head.problem
    assert not any(isinstance(c, Arm | Stage) for c in bench.controller.executed)
    assert bench.head.status is not None
    bench.controller.schema = SCHEMA_HASH  # it has been flashed
    bench.run(1100)
    assert bench.head.phase is Phase.RUNNING


def test_disarming_holds_until_asked_otherwise() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.head.disarm()
    bench.run(1)
    assert not bench.controller.armed
    bench.controller.reset()
    bench.run(500)
    assert not bench.controller.armed and bench.head.phase is Phase.IDLE
    bench.head.arm()
    bench.run(20)
    assert bench.controller.armed
    arms = [c for c in bench.controller.executed if isinstance(c, Arm) and ArmFlag.LAMPS in c.outputs]
    assert len(arms) == 2


def test_every_change_of_arming_is_said_so_that_no_flash_in_it_is_trusted() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.news.clear()
    bench.head.disarm()
    start = bench.now
    bench.run(10)
    bench.head.arm()
    bench.run(10)
    cuts = [cut for cut in bench.all(LampsCut) if cut.why == "arming changed"]
    assert len(cuts) == 3 and cuts[0].from_ns == start + MS  # off; off again before the new configuration; on
    assert all(cut.from_ns <= cut.to_ns <= bench.now for cut in cuts)


def test_a_dead_line_is_searched_again_and_again_without_piling_up() -> None:
    head = HeadControl(STAGE)
    bench = Bench(head)
    bench.run(50)
    sent = 0
    for _ in range(20_000):
        bench.now += MS
        sent += len(head.pending(bench.now))
        head.receive(b"", bench.now)
    assert head.phase is Phase.SEARCHING and head.session.backlog < 8
    assert sent < 20_000 / 10  # bytes; a storm would be a hundred times that
    bench.run(700)
    assert head.phase is Phase.RUNNING


# ---- who wants it dark ----


def lamps_armed(bench: Bench) -> int:
    """How often they were."""
    return len([c for c in bench.controller.executed if isinstance(c, Arm) and ArmFlag.LAMPS in c.outputs])


def test_a_disarm_that_somebody_else_ordered_stays() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.armed = False  # over the other line
    bench.edge(9, EdgeFlag.DISARMED)
    bench.run(5000)
    assert not bench.controller.armed and lamps_armed(bench) == 1
    assert bench.head.phase is Phase.STOPPED and bench.head.problem == "somebody else switched the lamps off"
    bench.head.arm()
    bench.run(20)
    assert bench.controller.armed and bench.head.phase is Phase.RUNNING


def test_without_an_edge_a_disarm_of_somebody_else_is_found_by_the_next_status_and_stays() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.armed = False
    bench.run(5000)
    assert not bench.controller.armed and bench.head.phase is Phase.STOPPED


def test_a_disarm_while_the_line_was_closed_stays() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.armed = False
    bench.head.reopened()
    bench.run(5000)
    assert not bench.controller.armed and lamps_armed(bench) == 1 and bench.head.phase is Phase.STOPPED


def test_a_line_that_was_closed_and_a_host_timeout_meanwhile_end_with_the_lamps_armed() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.armed, bench.controller.fault = False, FaultCode.HOST_TIMEOUT
    bench.controller.refuse[Arm] = (StatusCode.UNSAFE, 0)
    bench.head.reopened()
    bench.run(3)
    bench.controller.refuse.clear()
    bench.run(500)
    assert bench.controller.armed and bench.head.phase is Phase.RUNNING


def test_a_restart_that_nobody_told_is_no_stop() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.power_cycle()
    bench.run(1500)
    assert bench.controller.armed and bench.head.phase is Phase.RUNNING


def test_a_host_that_takes_the_controller_over_while_it_is_dark_is_given_way() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.controller.armed, bench.controller.fault = False, FaultCode.INTERLOCK
    bench.controller.refuse[Arm] = (StatusCode.SCHEMA, 0)  # as to any line but the session's
    bench.edge(9, EdgeFlag.DISARMED)
    bench.run(3000)
    assert bench.head.phase is Phase.STOPPED and "another host" in bench.head.problem
    bench.controller.refuse.clear()
    bench.run(3000)
    assert not bench.controller.armed


def test_a_start_takes_the_controller_back_from_a_host_that_identified_itself_meanwhile() -> None:
    bench = Bench(HeadControl(STAGE, armed=False))
    bench.run(50)
    bench.controller.refuse[Stage] = (StatusCode.SCHEMA, 0)
    bench.head.arm()
    bench.run(50)
    bench.controller.refuse.clear()  # identifying did it
    bench.run(500)
    assert bench.controller.armed and bench.head.phase is Phase.RUNNING


def test_a_controller_at_work_for_another_host_is_not_disturbed() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.controller.armed = True
    bench.controller.refuse[Identify] = (StatusCode.BAD_STATE, 0)
    bench.run(3000)
    assert bench.controller.armed and bench.head.phase is Phase.SEARCHING and "other line" in bench.head.problem
    assert not any(isinstance(c, Arm | Stage) for c in bench.controller.executed)


# ---- optical preambles ----

PREAMBLE = Preamble(15, 100, 0)


BOTH = Interlock(InterlockFlag.ANTIVALENT)


def test_the_interlocks_inputs_are_told_before_anything_is_armed_and_again_after_a_reset() -> None:
    bench = Bench(HeadControl(STAGE, interlock=BOTH))
    bench.run(20)
    steps = [c for c in bench.commands() if c in (Identify, Arm, Interlock, Stage, Commit)]
    assert steps == [Identify, Arm, Interlock, Stage, Commit, Arm] and bench.head.phase is Phase.RUNNING
    bench.controller.reset()
    bench.run(20)
    assert [c for c in bench.controller.executed if isinstance(c, Interlock)] == [BOTH, BOTH]
    assert bench.head.phase is Phase.RUNNING
    bench = Bench(HeadControl(None, armed=False, interlock=BOTH))
    bench.run(20)
    assert Interlock in bench.commands() and bench.head.phase is Phase.IDLE


def test_a_controller_that_cannot_look_at_the_second_input_is_never_armed() -> None:
    bench = Bench(HeadControl(STAGE, interlock=BOTH), ScriptedController(level=2))
    bench.run(2000)
    assert bench.head.phase is Phase.REFUSED and "older than this annulus and has no interlock" in bench.head.problem
    assert ArmFlag.LAMPS not in [c.outputs for c in bench.controller.executed if isinstance(c, Arm)]


def preambles(bench: Bench) -> list[Preamble]:
    return [c for c in bench.controller.executed if isinstance(c, Preamble)]


def test_preambles_are_set_before_the_lamps_are_armed_and_again_after_a_reset() -> None:
    bench = Bench(HeadControl(STAGE, preamble=PREAMBLE))
    bench.run(20)
    steps = [c for c in bench.commands() if c in (Identify, Arm, Stage, Commit, Preamble)]
    assert steps == [Identify, Arm, Stage, Commit, Preamble, Arm] and bench.head.phase is Phase.RUNNING
    bench.controller.reset()
    bench.run(20)
    assert preambles(bench) == [PREAMBLE, PREAMBLE] and bench.head.phase is Phase.RUNNING
    assert not bench.head.lacks_preamble


def test_a_controller_without_preambles_is_armed_all_the_same() -> None:
    bench = Bench(HeadControl(STAGE, preamble=PREAMBLE), ScriptedController(level=1))
    bench.run(2000)
    assert bench.head.phase is Phase.RUNNING and bench.head.lacks_preamble
    bench.head.order_preamble()
    bench.run(100)
    assert preambles(bench) == [] and bench.head.preambles.count == 0


def test_preambles_ordered_at_every_frame_follow_one_another_and_never_overlap() -> None:
    """Of 600 ms each."""
    bench = Bench(HeadControl(STAGE, preamble=PREAMBLE))
    bench.run(50)
    for _ in range(290):
        bench.head.order_preamble()
        bench.run(40)
    ordered = [c for c in preambles(bench) if c.now]
    assert len(ordered) == bench.head.preambles.count == 20
    assert all(c == Preamble(15, 100, 1) for c in ordered)


def test_an_order_waits_for_the_lamps_and_dies_with_the_scan() -> None:
    bench = Bench(HeadControl(STAGE, armed=False, preamble=PREAMBLE))
    bench.run(50)
    bench.head.order_preamble()
    bench.run(50)
    assert [c.now for c in preambles(bench)] == [0]
    bench.head.disarm()
    bench.head.arm()
    bench.run(50)
    assert [c.now for c in preambles(bench) if c.now] == []


def test_without_preambles_none_is_ordered() -> None:
    bench = Bench(HeadControl(STAGE))
    bench.run(50)
    bench.head.order_preamble()
    bench.run(50)
    assert preambles(bench) == [] and not bench.head.lacks_preamble


def test_the_interval_is_counted_in_lamp_cycles() -> None:
    assert preamble_of(STAGE, 15, 20.0) == Preamble(15, 100, 0)  # of 200 ms
    assert preamble_of(STAGE, 15, 0.0).interval == 0  # by order only
    assert preamble_of(STAGE, 15, 0.01).interval == 1
    assert preamble_of(STAGE, 15, 1e6).interval == 65535


def test_pins_that_the_wiring_inverts_are_said_before_the_commit_and_read_back() -> None:
    pins = pins_of("sync,led")
    bench = Bench(HeadControl(STAGE, pins=pins))
    bench.run(15)
    assert bench.head.phase is Phase.RUNNING and bench.controller.inverted == pins.inverted
    steps = [c for c in bench.commands() if c in (Stage, Polarity, Commit, Wiring)]
    assert steps == [Stage, Polarity, Commit, Wiring]
    bench.controller.reset()
    bench.run(15)
    assert bench.head.phase is Phase.RUNNING and bench.controller.inverted == pins.inverted


def test_a_controller_that_cannot_invert_pins_is_armed_only_where_none_is_inverted() -> None:
    old = Bench(HeadControl(STAGE, pins=pins_of("led")), ScriptedController(level=2))
    old.run(400)
    assert old.head.phase is Phase.REFUSED and "has no polarity" in old.head.problem and not old.controller.armed
    plain = Bench(HeadControl(STAGE), ScriptedController(level=2))
    plain.run(400)
    assert plain.head.phase is Phase.RUNNING and plain.controller.armed


def test_slides_lit_in_turn_are_sent_before_the_commit_and_read_back() -> None:
    bench = Bench(HeadControl(STAGE, pins=Pins(slides=4)))
    bench.run(60)
    assert bench.head.phase is Phase.RUNNING and bench.controller.slides == 4
    asked = bench.commands()
    assert asked.index(Stage) < asked.index(Slides) < asked.index(Commit) < asked.index(SlidesLit) < asked.index(Arm, 3)
    bench.controller.slides = 1  # it is not what was asked for
    bench.head.configure(STAGE)
    bench.controller.reset()
    bench.run(400)
    assert bench.head.phase is Phase.RUNNING and bench.controller.slides == 4  # told anew


@pytest.mark.parametrize("level", [1, 2, 3])
def test_a_controller_without_slides_is_armed_only_where_there_is_one(level: int) -> None:
    old = Bench(HeadControl(STAGE, pins=Pins(slides=2)), ScriptedController(level=level))
    old.run(60)
    assert old.head.phase is Phase.REFUSED and not old.controller.armed
    assert "older than this annulus and has no" in old.head.problem
    usual = Bench(HeadControl(STAGE), ScriptedController(level=level))
    usual.run(60)
    assert usual.head.phase is Phase.RUNNING and not {Slides, SlidesLit} & set(usual.commands())
