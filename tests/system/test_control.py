"""Promises of a session that is told what to do: the simulated head in real time, a client on the control socket."""

import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from annulus_pipe.capture.photometry import Light, measure
from annulus_pipe.daemon.account import ScanReport
from annulus_pipe.daemon.config import SocketConfig
from annulus_pipe.daemon.control import ControlClient
from annulus_pipe.daemon.observer import Mark, Observer
from annulus_pipe.daemon.session import Session
from annulus_pipe.daemon.state import State
from annulus_pipe.demo import demo_config
from annulus_pipe.link.messages import Arm, ArmFlag
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.twin.head import HeadHandle, start_head
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import AnnulusError, Label

pytestmark = pytest.mark.alone

WORLD = demo_world(travel_mm=330.0).scaled(208)


class Imu:
    """A sensor that turns with the clock, 36 degrees a second."""

    name = "imu"

    def __init__(self) -> None:
        self.next_ns = 0

    def poll(self) -> list[Sample]:
        now = time.monotonic_ns()
        if now < self.next_ns:
            return []
        self.next_ns = now + 10_000_000
        return [Sample(self.name, now, {"roll_deg": roll(now)}, {"roll_deg": "deg"})]

    def close(self) -> None: ...


def roll(at_ns: int) -> float:
    return 36.0 * (at_ns % 10_000_000_000) / 1e9


class Bystander(Observer):
    """Knows what the client must wait for."""

    def __init__(self) -> None:
        self.states: list[State] = []
        self.told: list[str] = []
        self.marks: list[Mark] = []
        self.reports: list[ScanReport] = []

    def state(self, state: State, why: str) -> None:
        self.states.append(state)

    def event(self, kind: str, text: str) -> None:
        self.told.append(text)

    def mark(self, mark: Mark) -> None:
        self.marks.append(mark)

    def ended(self, report: ScanReport) -> None:
        self.reports.append(report)


@pytest.fixture
def head() -> Iterator[HeadHandle]:
    with start_head(WORLD, 12.0, seed=5, speed_mm_s=25.0) as head:
        yield head


def until(condition: Callable[[], bool], patience_s: float = 60.0) -> None:
    end = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def frames_are_what_they_are_called(recording: Recording) -> int:
    expected = {Label.PROJECTOR: Light.PROJECTOR, Label.LED: Light.LED}
    known = [frame for frame in recording.frames if frame.label in expected]
    for frame in known:
        assert measure(recording.read_raw(frame)[0]).light is expected[frame.label], frame
    return len(known)


@pytest.mark.deep(gate="tests/system/test_control.py::test_a_scan_that_cannot_begin_is_told_and_the_daemon_stays")
def test_started_marked_zeroed_stopped_and_started_again(head: HeadHandle, tmp_path: Path) -> None:
    config = replace(
        demo_config(head, WORLD, tmp_path),
        calibration=None,
        autostart=False,
        control=SocketConfig(f"ipc://{tmp_path}/control"),
    )
    seen, failed = Bystander(), []
    session = Session(config, observer=seen, sensors=[Imu()], name="scan")
    done = threading.Event()

    def operate() -> None:
        try:
            with ControlClient(config.control.address) as client:  # type: ignore[union-attr]
                until(lambda: session.state is State.IDLE)
                time.sleep(0.5)
                assert client.state() is State.IDLE and head.counters()["lamps_on"] == []
                assert not list(tmp_path.glob("*.mcap"))
                for wrong in (client.stop, lambda: client.mark("x")):
                    with pytest.raises(AnnulusError, match="no scan is under way"):
                        wrong()
                assert client.start() is State.ARMED
                with pytest.raises(AnnulusError, match="not possible while the head is"):
                    client.start()
                until(lambda: session.labelled >= 15 and (session.telemetry()["z_mm"] or 0.0) > 20.0)
                assert client.state() is State.SCANNING
                client.mark("joint", clock_deg=90.0)
                client.zero()
                zeroed_at = session.labelled
                until(lambda: session.labelled >= zeroed_at + 15)
                assert client.stop() is State.IDLE
                assert head.counters()["lamps_on"] == []
                assert (tmp_path / "scan.mcap").exists() and session.recorder is None
                assert client.start() is State.ARMED
                until(lambda: session.labelled >= 15)
                assert client.stop() is State.IDLE
        except BaseException as error:
            failed.append(error)
        finally:
            done.set()

    operator = threading.Thread(target=operate)
    operator.start()
    report = session.run(done.is_set)
    operator.join()
    if failed:
        raise failed[0]
    once = [State.ARMED, State.SCANNING, State.IDLE]
    assert seen.states == [State.POWERING, State.IDLE, *once, *once, State.ENDING, State.OFF], seen.told
    assert seen.reports[-1] is report and [r.recordings for r in seen.reports] == [
        (tmp_path / "scan.mcap",),
        (tmp_path / "scan-2.mcap",),
    ]
    first, second = (open_recording(r.recordings[0]) for r in seen.reports)
    for recording, of in ((first, seen.reports[0]), (second, seen.reports[1])):
        assert frames_are_what_they_are_called(recording) >= 15
        assert len(recording.frames) == sum(of.frames.values())
        assert not any(of.telemetry["in_hand"].values())
        assert [note["state"] for note in recording.notes("/state")] == ["armed", "scanning"]
        assert of.telemetry["sensors"]["imu"].keys() == {"roll_deg"}
    assert {f.index for f in first.frames}.isdisjoint(f.index for f in second.frames)
    # the mark is where the head was, and the place begins again at zero
    (mark,) = first.notes("/mark")
    assert (mark["text"], mark["clock_deg"]) == ("joint", 90.0) and mark == seen.marks[0].to_dict()
    places = [f.z_mm for f in first.frames if f.label is not Label.UNKNOWN]
    back = [i for i in range(1, len(places)) if places[i] < places[i - 1]]
    assert len(back) == 1 and abs(places[back[0]]) < 5.0
    assert abs(mark["z_mm"] - places[back[0] - 1]) < 15.0
    assert sum(note["kind"] == "odometer" for note in first.notes("/event")) == 1
    assert places[-1] > 10.0
    # samples and the frames' roll
    samples = list(first.notes("/sensor/imu"))
    assert len(samples) > 50 and all(abs(s["values"]["roll_deg"] - roll(s["host_ns"])) < 1e-6 for s in samples)
    assert len(list(first.notes("/sensor/odometer"))) > 5
    rolls = [f.roll_deg for f in first.frames if f.label is not Label.UNKNOWN]
    known = [roll for roll in rolls if roll is not None]
    assert len(known) > 0.9 * len(rolls), "a sensor at 100 Hz"


def test_a_scan_that_cannot_begin_is_told_and_the_daemon_stays(head: HeadHandle, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    config = replace(
        demo_config(head, WORLD, tmp_path),
        record_folder=tmp_path / "file",
        calibration=None,
        autostart=False,
        control=SocketConfig(f"ipc://{tmp_path}/control"),
    )
    seen, done, failed = Bystander(), threading.Event(), []
    session = Session(config, observer=seen)

    def operate() -> None:
        try:
            with ControlClient(config.control.address) as client:  # type: ignore[union-attr]
                until(lambda: session.state is State.IDLE)
                with pytest.raises(AnnulusError, match="Not a directory"):
                    client.start()
                until(lambda: client.state() is State.IDLE)
        except BaseException as error:
            failed.append(error)
        finally:
            done.set()

    operator = threading.Thread(target=operate)
    operator.start()
    session.run(done.is_set)
    operator.join()
    if failed:
        raise failed[0]
    assert head.counters()["lamps_on"] == []


@pytest.mark.deep(gate="tests/system/test_control.py::test_a_scan_that_cannot_begin_is_told_and_the_daemon_stays")
def test_lamps_that_somebody_switches_off_end_the_scan_and_stay_off_until_it_is_started_again(
    head: HeadHandle, tmp_path: Path
) -> None:
    config = replace(
        demo_config(head, WORLD, tmp_path), calibration=None, control=SocketConfig(f"ipc://{tmp_path}/control")
    )
    seen, done, failed = Bystander(), threading.Event(), []
    session = Session(config, observer=seen, name="scan")

    def operate() -> None:
        try:
            with ControlClient(config.control.address) as client:  # type: ignore[union-attr]
                until(lambda: session.labelled >= 10)
                assert session.line is not None
                session.line.head.session.send(Arm(ArmFlag(0)))  # as another program on this line would
                until(lambda: session.state is State.IDLE)
                time.sleep(1.5)
                assert head.counters()["lamps_on"] == [] and session.state is State.IDLE
                assert client.start() is State.ARMED
                until(lambda: session.labelled >= 10)
                assert client.stop() is State.IDLE
        except BaseException as error:
            failed.append(error)
        finally:
            done.set()

    operator = threading.Thread(target=operate)
    operator.start()
    session.run(done.is_set)
    operator.join()
    assert not failed, seen.told
    assert len(seen.reports) == 2
    assert any("somebody else switched the lamps off" in told for told in seen.told)
    assert not any("did not confirm" in told for told in seen.told)
