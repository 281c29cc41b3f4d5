"""Promises about the lamps when edges come at the wrong moment, or too often, or not at all: read off the pins."""

import random
import shutil
import subprocess
from pathlib import Path

import pytest
from emulated import BOOTED, LATENCY, MS, EmulatedBoard, arm, configuration

from annulus_pipe.controller import PIN_LED, PIN_SYNC
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Commit,
    Edge,
    EdgeFlag,
    Fault,
    FaultCode,
    Lamp,
    Ping,
    StageReply,
    StateFlag,
    Status,
    StatusCode,
    StatusReply,
    SyncFound,
    SyncLost,
)

# ---- how long a lamp may be on ----


def test_a_flash_may_take_half_of_the_shortest_interval_and_not_of_the_period(board: EmulatedBoard) -> None:
    """Half of 40 ms was granted with edges accepted from 20 ms on: at 50 Hz the LED shone 99.9 % of the time."""
    board.identify()
    timing = {"ratio": 0, "period": 40 * MS, "tolerance": 500, "delay": 0, "readout": 0}
    refused = board.request(configuration(**timing, width=10 * MS + 1))
    assert isinstance(refused, StageReply)
    assert (refused.status, refused.detail) == (StatusCode.DUTY, Lamp.LED)
    arm(board, **timing, width=10 * MS)
    edges = [board.now + MS + i * (20 * MS + 3) for i in range(5)]
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 20 * MS)
    assert board.widths(PIN_LED) == [10 * MS] * 5


def image_with(image: Path, scratch: Path, file: str, right: str, wrong: str) -> Path:
    """The image under test with one line gone wrong: what one guard let through is the next one's to stop."""
    firmware = scratch / "firmware"
    shutil.copytree(image.parents[1], firmware, ignore=shutil.ignore_patterns("build", "corpus"))
    source = firmware / file
    assert right in source.read_text()
    source.write_text(source.read_text().replace(right, wrong))
    build = ["make", "--silent", "-C", str(firmware), "image", "GIT=broken00", "BUILD=build"]
    subprocess.run(build, check=True, stdout=subprocess.DEVNULL)
    return firmware / "build/annulus.uf2"


def limit_faults(board: EmulatedBoard) -> list[int]:
    """Of which lamps."""
    return [fault.detail for fault in board.heard(Fault) if fault.fault == FaultCode.LIMIT]


@pytest.mark.deep(
    gate="tests/emulator/test_image_lamps.py::test_an_edge_while_a_flash_is_loaded_is_not_given_the_next_ones"
)
def test_a_core_that_checks_nothing_gets_no_flash_over_the_duty_limit(image: Path, tmp_path: Path) -> None:
    line = "const uint32_t next_edge = holdoff_ticks(config);"
    careless = image_with(image, tmp_path, "core/sequencer.c", line, "const uint32_t next_edge = config->frame_period;")
    board = EmulatedBoard(careless)
    board.run(BOOTED)
    arm(board, ratio=0, period=40 * MS, tolerance=500, delay=0, readout=0, width=10 * MS + 1)
    for i in range(5):
        board.pulse(board.now + (20 * i + 1) * MS)
    board.run_alive(board.now + 110 * MS)
    assert board.rises(PIN_LED) == []
    assert limit_faults(board) == [Lamp.LED]
    status = board.request(Status())
    assert isinstance(status, StatusReply)
    assert status.fault == FaultCode.LIMIT
    assert not status.state & StateFlag.LAMPS_ARMED
    board.close()


@pytest.mark.deep(
    gate="tests/emulator/test_image_lamps.py::test_no_edge_is_accepted_while_a_lamp_is_on_whatever_was_configured_before"
)
def test_a_hold_off_that_holds_nothing_off_gets_no_lamp_over_its_duty(image: Path, tmp_path: Path) -> None:
    line = "(ticks > HOLDOFF_OVERHEAD) ? (ticks - HOLDOFF_OVERHEAD) / 2U : 0U"
    leaky = image_with(image, tmp_path, "rp2040/lamps.c", line, "(ticks > HOLDOFF_OVERHEAD) ? 100U : 0U")
    board = EmulatedBoard(leaky)
    board.run(BOOTED)
    width = 10 * MS
    arm(board, ratio=0, period=40 * MS, tolerance=500, delay=0, readout=0, width=width)
    for i in range(200):
        board.pulse(board.now + (i + 1) * MS, low=1_000)
    board.run_alive(board.now + 210 * MS)
    assert limit_faults(board) == []  # what it owes leaves an edge dark, and disarms nobody
    rises, falls = board.rises(PIN_LED), board.falls(PIN_LED)
    assert len(rises) >= 8
    for begin in rises:
        for end in (fall for fall in falls if fall > begin):
            on = sum(max(0, min(fall, end) - max(rise, begin)) for rise, fall in zip(rises, falls, strict=True))
            assert on <= (end - begin) // 2 + width
    board.close()


def test_no_edge_is_accepted_while_a_lamp_is_on_whatever_was_configured_before(board: EmulatedBoard) -> None:
    """A second change of the hold-off before any edge had no room: its flash outlasted the first one's."""
    board.identify()
    for period, tolerance, width, generation in ((2 * MS, 400, 1_000, 1), (40 * MS, 100, 15 * MS, 2)):
        changes = {"ratio": 0, "period": period, "tolerance": tolerance, "width": width, "generation": generation}
        for command in (configuration(**changes, delay=0, readout=0), Commit(generation=generation)):
            assert board.request(command).status == StatusCode.OK
        board.run(board.now + MS)
    assert board.request(Arm(outputs=ArmFlag.LAMPS)).status == StatusCode.OK
    for i in range(120):
        board.pulse(board.now + (i + 1) * MS + 100, low=1_000)
    board.run_alive(board.now + 140 * MS)
    on = list(zip(board.rises(PIN_LED), board.falls(PIN_LED), strict=True))
    edges = board.heard(Edge)
    accepted = [event.tick + board.origin for event in edges]
    assert [(a, rise) for a in accepted for rise, fall in on if rise <= a < fall] == []
    assert [event.flags for event in edges[:2]] == [EdgeFlag.LATE_LOAD | EdgeFlag.FIRST, EdgeFlag.IRREGULAR]
    assert {fall - rise for rise, fall in on} == {15 * MS}
    assert len(on) == len(edges) - 1 == 4
    assert limit_faults(board) == []


@pytest.mark.deep(
    gate="tests/emulator/test_image_lamps.py::test_an_edge_while_a_flash_is_loaded_is_not_given_the_next_ones"
)
@pytest.mark.timeout(300)  # half of the tick counter's turn is waited for: 20 s of a free core
def test_the_first_flash_after_a_pause_of_22_seconds_is_whole(board: EmulatedBoard) -> None:
    """The tick of the load was compared across half of the counter's turn: it was cut and called late."""
    delay = 0
    arm(board, ratio=0, period=2 * MS, delay=delay, width=20_000, host_timeout=5_000)
    edges = [board.now + MS]
    board.pulse(edges[0])
    board.run_alive(board.now + 22_000 * MS, every=4_000 * MS)
    edges.append(board.now + MS)
    board.pulse(edges[1])
    board.run(board.now + 5 * MS)
    assert [rise - edge for rise, edge in zip(board.rises(PIN_LED), edges, strict=True)] == [delay + LATENCY] * 2
    assert board.widths(PIN_LED) == [20_000] * 2
    assert [(event.lamp, event.flags) for event in board.heard(Edge)] == [(Lamp.LED, EdgeFlag.FIRST)] * 2


# ---- what is said of the edges ----


@pytest.mark.parametrize("count", [200, pytest.param(1_500, marks=pytest.mark.deep)])
def test_an_edge_in_the_middle_of_a_round_is_no_lost_sync(board: EmulatedBoard, count: int) -> None:
    """An edge stamped after the round's own tick was read seemed 43 s old: one in 200, every 8 s at 25 fps."""
    period = 2 * MS
    arm(board, ratio=4, period=period, delay=30_000, width=20_000)
    rng = random.Random(5)
    first = board.now + MS
    edges = [first + i * period + rng.randrange(-4_000, 4_000) for i in range(count)]
    board.input(*[item for edge in edges for item in ((edge, PIN_SYNC, 0), (edge + 3_000, PIN_SYNC, 1))])
    board.run_alive(edges[-1] + MS)
    assert len(board.heard(Edge)) == count
    assert len(board.heard(SyncFound)) == 1
    assert board.heard(SyncLost) == []


# ---- an edge at the very moment at which the processor changes its mind ----

FRAME = 2 * MS


def flashes_told(board: EmulatedBoard, edges: list[int], delay: int) -> list[tuple[int, int, Edge]]:
    """(edge, ticks the LED was on after it, what was said of it): every flash begins where its edge says."""
    board.run(board.now + 5 * MS)
    rises, falls = board.rises(PIN_LED), board.falls(PIN_LED)
    on = {rise: fall - rise for rise, fall in zip(rises, falls, strict=True)}
    told = [
        (edge, on.pop(edge + delay + LATENCY, 0), event) for edge, event in zip(edges, board.heard(Edge), strict=True)
    ]
    assert on == {}
    return told


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("delay", "width", "every"), [(0, 1_000, 40), (0, 1_000, 2), (0, 2, 5), (30, 20, 5)])
def test_an_edge_while_a_flash_is_taken_back_takes_it_whole_or_not_at_all(
    board: EmulatedBoard, delay: int, width: int, every: int
) -> None:
    """An edge within twelve cycles after the lamp's machine was looked at was jumped away from: the LED stayed on."""
    arm(board, ratio=0, period=FRAME, tolerance=500, delay=delay, width=width, readout=0)
    edges = []
    for offset in range(0, 500, every):
        begin = board.now + MS
        edges += [begin, begin + FRAME, begin + 2 * FRAME + offset]
        for edge in edges[-3:]:
            board.pulse(edge, low=1_000)
        board.run(begin + 50)
        board.run_to("board_flash_load")
        board.stall(begin + FRAME + 2_000 - board.now)  # the second edge finds nothing ..
        board.run(begin + FRAME + 1_000)
        board.run_to("board_flash_load")  # .. which is why what was loaded after it is taken back ..
        board.stall(begin + 2 * FRAME - board.now)  # .. while the third one comes
        board.run(begin + 3 * FRAME)
        board.send(Ping())
    told = flashes_told(board, edges, delay)
    for _, on, event in told:
        assert (on, event.width) in ((width, width), (0, 0))
        assert (event.lamp == Lamp.LED) == (on > 0) == (not event.flags & EdgeFlag.LATE_LOAD)
    swept = [on > 0 for _, on, _ in told[2::3]]
    assert swept[0] and swept[-1] and not all(swept)  # before it, after it, and within it


@pytest.mark.parametrize("every", [40, pytest.param(4, marks=pytest.mark.deep)])
def test_an_edge_while_a_flash_is_loaded_is_not_given_the_next_ones(board: EmulatedBoard, every: int) -> None:
    delay, width = 0, 700
    arm(board, ratio=0, period=FRAME, tolerance=500, delay=delay, width=width, readout=0)
    edges = []
    for offset in range(0, 600, every):
        begin = board.now + MS
        board.pulse(begin, low=1_000)
        board.run(begin + 50)
        board.run_to("board_flash_load")
        board.stall(begin + FRAME - board.now)
        edges += [begin, begin + FRAME + offset, begin + 2 * FRAME]
        for edge in edges[-2:]:
            board.pulse(edge, low=1_000)
        board.run(begin + FRAME)
        board.run_to("board_status_light")  # the end of this round: the next one sees both edges at once
        board.stall(begin + 2 * FRAME + 2_000 - board.now)
        board.run(begin + 3 * FRAME)
        board.send(Ping())
    told = flashes_told(board, edges, delay)
    for _, on, event in told:
        assert (on, event.width) in ((width, width), (0, 0))
    assert {on for _, on, _ in told[1::3]} == {0, width}


@pytest.mark.parametrize("every", [32, pytest.param(2, marks=pytest.mark.deep)])
def test_an_edge_while_the_lamps_are_armed_or_disarmed_is_told_as_it_was(board: EmulatedBoard, every: int) -> None:
    delay, width = 0, 700
    arm(board, ratio=0, period=FRAME, tolerance=500, delay=delay, width=width, readout=0)
    edges = []
    for offset in range(0, 320, every):
        for function, outputs in (("board_lamps_cut", ArmFlag(0)), ("board_flash_load", ArmFlag.LAMPS)):
            board.run(board.now + FRAME)
            board.send(Arm(outputs=outputs))
            board.run_to(function)
            edges.append(board.now + offset)
            board.pulse(edges[-1], low=1_000)
        board.run(board.now + FRAME)
        edges.append(board.now)
        board.pulse(edges[-1])  # armed and undisturbed
    for i, (_, on, event) in enumerate(flashes_told(board, edges, delay)):
        assert on <= width
        if i % 3 != 0:  # nobody cuts it
            assert (on, event.width) in ((width, width), (0, 0))
        if event.lamp == Lamp.DARK:
            assert on == 0
        if i % 3 == 2:
            assert (on, event.flags) == (width, 0)
