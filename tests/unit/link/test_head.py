"""A head is brought into service, kept alive, and brought back by itself after resets and faults."""

from annulus.link.head import EdgeSeen, HeadControl, HeadEvent, LampsCut, Phase, PhaseChanged
from annulus.link.messages import (
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    Commit,
    Edge,
    Fault,
    FaultCode,
    Identify,
    Ping,
    Stage,
    StatusCode,
)
from annulus.testing.scripted import ScriptedController
from annulus.vocabulary import EdgeFlag, Lamp

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
