"""The main loop sleeps between two rounds, and wakes."""

from emulated import MS, EmulatedBoard, configuration

from annulus_pipe.controller import PIN_INTERLOCK, PIN_SYNC
from annulus_pipe.link.messages import Arm, ArmFlag, Commit, Fault, FaultCode, Ping, StatusCode

STORM = 13_000  # ticks: longer than a round
EVERY = 20  # ticks from one edge of it to the next: the processor does nothing but count them


def test_a_storm_of_interrupts_as_it_falls_asleep_does_not_outlast_its_alarm(board: EmulatedBoard) -> None:
    """With the alarm gone by before the loop slept, nothing woke it for 80 ms: the microwave starved."""
    board.identify()
    for command in (configuration(host_timeout=5000), Commit(generation=1), Arm(outputs=ArmFlag.MICROWAVE)):
        assert board.request(command).status == StatusCode.OK
    for after in range(0, 60, 2):
        board.run_to("sleep_round")
        begins = board.now + after
        edges = [(begins + i * EVERY, PIN_SYNC, i % 2) for i in range(STORM // EVERY)]
        board.input(*edges, (begins + STORM + EVERY, PIN_SYNC, 1))
        board.run(begins + STORM + 6 * MS)
        assert board.heard(Fault) == [], f"{after} ticks after the sleep was begun"
        board.request(Ping())


def test_a_sync_line_that_rings_holds_up_no_round(board: EmulatedBoard) -> None:
    """A million edges a second: each interrupts the processor for a microsecond. The interlock is seen all the same."""
    board.identify()
    for command in (configuration(host_timeout=5000), Commit(generation=1), Arm(outputs=ArmFlag.MICROWAVE)):
        assert board.request(command).status == StatusCode.OK
    begins = board.now + MS
    board.input(*((begins + i * 50, PIN_SYNC, i % 2) for i in range(20 * MS // 50)))
    board.run(begins + 15 * MS)
    board.request(Ping())
    assert board.heard(Fault) == []
    opens = board.now + 100
    board.input((opens, PIN_INTERLOCK, 1), (opens + 10, PIN_INTERLOCK, 0))
    board.run(opens + 5 * MS)
    (fault,) = board.heard(Fault)
    assert fault.fault == FaultCode.INTERLOCK
    assert 0 <= fault.tick + board.origin - opens < MS // 2
