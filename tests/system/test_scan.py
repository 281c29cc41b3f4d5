"""Promises of a scan, kept across processes: the simulated head in real time, a quarter-size camera, all else real."""

import os
import pty
import resource
import signal
import threading
import time
import tty
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.capture.camera import HeldRequest
from annulus_pipe.capture.photometry import Light, measure
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.daemon.account import ScanReport
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.config import HeadConfig, RecordConfig
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.session import Session
from annulus_pipe.daemon.state import State
from annulus_pipe.demo import REMARK, demo_config
from annulus_pipe.job import JobSheet
from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import StateFlag, Status
from annulus_pipe.record.codec import Codec
from annulus_pipe.record.recording import Recording, open_part, open_recording
from annulus_pipe.reprocess.relabel import Audit, audit
from annulus_pipe.scans.origin import origin_of
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.head import HeadHandle, start_head
from annulus_pipe.twin.worlds import World, demo_world
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.profile import Profile

pytestmark = pytest.mark.alone

FPS = 8.0
WORLD = demo_world(travel_mm=330.0).scaled(416)


class Rig(Observer):
    """A scan on a head, with hands on both."""

    def __init__(self, head: HeadHandle, out: Path, world: World = WORLD, **changes: object) -> None:
        self.head = head
        config = replace(demo_config(head, world, out), **changes)
        self.profiles: list[Profile] = []
        self.told: list[str] = []
        self.states: list[State] = []
        self.session = Session(config, observer=self, name="scan")

    def profile(self, profile: Profile) -> None:
        self.profiles.append(profile)

    def event(self, kind: str, text: str) -> None:
        self.told.append(text)

    def state(self, state: State, why: str) -> None:
        self.states.append(state)

    def run(self, until: Callable[["Rig"], bool]) -> ScanReport:
        """Scan until the condition holds; a minute at most."""
        end = time.monotonic() + 60.0
        report = self.session.run(lambda: until(self) or time.monotonic() > end)
        assert time.monotonic() < end, self.told
        return report

    @property
    def worker_pids(self) -> list[int]:
        pool = self.session.reconstruction
        return pool.pids if pool is not None and pool.ready else []


@pytest.fixture
def head() -> Iterator[HeadHandle]:
    with start_head(WORLD, FPS, seed=5, speed_mm_s=25.0) as head:
        yield head


def frames_are_what_they_are_called(recording: Recording) -> int:
    """Pictures of frames with a label show that lamp. Returns how many were checked."""
    expected = {Label.PROJECTOR: Light.PROJECTOR, Label.LED: Light.LED}
    known = [frame for frame in recording.frames if frame.label in expected]
    for frame in known:
        assert measure(recording.read_raw(frame)[0]).light is expected[frame.label], frame
    return len(known)


def test_a_scan_is_labelled_recorded_and_reconstructed(head: HeadHandle, tmp_path: Path) -> None:
    rig = Rig(head, tmp_path)
    report = rig.run(lambda rig: rig.session.labelled >= 40)
    recording = open_recording(tmp_path / "scan.mcap")
    assert not recording.torn and report.recordings == (tmp_path / "scan.mcap",)
    again = audit(tmp_path / "scan.mcap")  # the labels follow from what the recording has of them
    assert again.frames >= len(recording.frames) and again.to_dict() | {"frames": 0} == Audit().to_dict()
    assert {"start", "end"} <= {note["why"] for note in recording.notes("/identity")}
    told = origin_of(open_scan(tmp_path / "scan.mcap"))  # head.toml's job, and when it was
    assert told.job == JobSheet(pipe="simulated", remarks=REMARK) and told.utc[0] < told.utc[1]
    assert frames_are_what_they_are_called(recording) == report.frames["projector"] + report.frames["led"] >= 40
    assert len(recording.frames) == sum(report.frames.values())
    # one LED frame in five, whatever was dropped; in an optical preamble any, and they have no place in the lamp cycle
    slots = [recording.label(f)["slot"] for f in recording.frames if f.label is Label.LED]
    assert 4 in slots and set(slots) <= {4, None}
    # every projector frame became a profile, in order, at its own station
    stations = {f.index: f.z_mm for f in recording.frames if f.label is Label.PROJECTOR}
    assert [p.frame for p in rig.profiles] == sorted(p.frame for p in rig.profiles)
    assert len(rig.profiles) + report.drops.get("worker_busy", 0) == len(stations)
    assert all(p.z_mm == stations[p.frame] for p in rig.profiles)
    assert sum(p.pose is not None for p in rig.profiles) > 0.9 * len(rig.profiles)
    assert [n["frame"] for n in recording.notes("/profile")] == [p.frame for p in rig.profiles]
    moved = [f.z_mm for f in recording.frames if f.label is not Label.UNKNOWN]
    assert moved == sorted(moved) and moved[-1] > 20.0
    assert recording.calibration == load_calibration(tmp_path / "calibration.json").to_dict()
    assert rig.states == [State.POWERING, State.IDLE, State.ARMED, State.SCANNING, State.ENDING, State.OFF]
    assert not any(report.telemetry["in_hand"].values()), "every frame is accounted for"
    # and the lamps are off, by the head's own pins and by its word
    assert head.counters()["lamps_on"] == []
    with Client(head.port_url) as client:
        assert StateFlag.LAMPS_ARMED not in client.request(Status()).state  # type: ignore[attr-defined]


@pytest.mark.deep(gate="tests/system/test_scan.py::test_a_scan_is_labelled_recorded_and_reconstructed")
def test_a_worker_killed_in_mid_scan_costs_its_frames_and_they_are_reported(head: HeadHandle, tmp_path: Path) -> None:
    rig = Rig(head, tmp_path, workers=1)
    victim: list[int] = []
    held: list[int] = []

    def until(rig: Rig) -> bool:
        pool = rig.session.reconstruction
        if victim and not held and pool is not None and pool.in_hand:
            held.append(pool.in_hand)
            os.kill(victim[0], signal.SIGKILL)
        if not victim and len(rig.profiles) >= 5:
            victim.append(rig.worker_pids[0])
            os.kill(victim[0], signal.SIGSTOP)  # so that what it has at the next look stays in its hands
        died = next(
            (i for i, text in enumerate(rig.told) if "killed by SIGKILL" in text and "takes over" in text), None
        )
        return died is not None and rig.profiles[-1].frame > last_lost(rig.told) + 5

    report = rig.run(until)
    lost = [text for text in rig.told if text.startswith("frame ") and "SIGKILL" in text]
    assert report.drops["worker_died"] == len(lost) == held[0] >= 1
    assert report.drops["workers_replaced"] == 1
    recording = open_recording(tmp_path / "scan.mcap")
    assert frames_are_what_they_are_called(recording) >= 10
    have = {p.frame for p in rig.profiles}
    recorded = {f.index for f in recording.frames if f.label is Label.PROJECTOR}
    assert {int(text.split()[1].rstrip(":")) for text in lost} <= recorded - have  # they can be had later


def last_lost(told: list[str]) -> int:
    return max((int(t.split()[1].rstrip(":")) for t in told if t.startswith("frame ") and "SIGKILL" in t), default=0)


@pytest.mark.deep(gate="tests/system/test_scan.py::test_a_scan_is_labelled_recorded_and_reconstructed")
def test_a_recorder_killed_in_mid_scan_is_replaced_and_both_files_are_readable(
    head: HeadHandle, tmp_path: Path
) -> None:
    rig = Rig(head, tmp_path, calibration=None)
    killed: list[int] = []

    def until(rig: Rig) -> bool:
        pool = rig.session.recorder
        if not killed and rig.session.labelled >= 18 and pool is not None:
            killed.append(rig.session.labelled)
            os.kill(pool.pids[0], signal.SIGKILL)
        return bool(killed) and (tmp_path / "scan-002.mcap").exists() and rig.session.labelled >= killed[0] + 30

    report = rig.run(until)
    first, second = open_part(tmp_path / "scan.mcap"), open_part(tmp_path / "scan-002.mcap")
    whole = open_recording(tmp_path / "scan.mcap")
    assert whole.torn and {f.index for f in whole.frames} == {f.index for f in (*first.frames, *second.frames)}
    assert first.torn and not second.torn
    assert len(first.frames) >= 15 and len(second.frames) >= 1
    gone = report.drops.get("recorder_died", 0) + report.drops.get("recorder_busy", 0)
    assert len(first.frames) + len(second.frames) + gone >= sum(report.frames.values())
    assert report.drops["recorders_replaced"] == 1


@pytest.mark.deep(gate="tests/system/test_scan.py::test_a_scan_is_labelled_recorded_and_reconstructed")
def test_a_controller_that_restarts_is_armed_again_and_no_label_is_wrong(tmp_path: Path) -> None:
    faults = Faults(events_lost=0.01, frames_dropped=0.02, resets=(100,))
    with start_head(WORLD, FPS, faults, seed=6, speed_mm_s=25.0) as head:
        rig = Rig(head, tmp_path, calibration=None)
        at: list[int] = []

        def until(rig: Rig) -> bool:
            if not at and any("restarted" in text for text in rig.told):
                at.append(rig.session.labelled)
            return bool(at) and rig.session.labelled >= at[0] + 15

        report = rig.run(until)
        recording = open_recording(tmp_path / "scan.mcap")
        assert frames_are_what_they_are_called(recording) >= 30
        assert report.telemetry["place_gaps"] == 1 and report.telemetry["rearms"] >= 1
        moved = np.array([f.z_mm for f in recording.frames if f.label is not Label.UNKNOWN])
        assert (np.diff(moved) > -0.2).all()  # the head does not jump back to where its counter began
        assert head.counters()["lamps_on"] == []


@pytest.mark.deep(gate="tests/system/test_scan.py::test_a_scan_is_labelled_recorded_and_reconstructed")
def test_a_full_disk_costs_the_recording_and_not_the_labels(head: HeadHandle, tmp_path: Path) -> None:
    frame = WORLD.camera.width * WORLD.camera.height
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    rig = Rig(head, tmp_path, calibration=None, slots=30, record=RecordConfig(codec=Codec.RAW))
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (35 * frame, hard))  # the ring still fits, 50 frames on disk do not
        report = rig.run(lambda rig: rig.session.labelled >= 50)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    recording = open_recording(tmp_path / "scan.mcap")
    assert report.drops["disk"] == sum(report.frames.values()) - len(recording.frames) > 5
    assert report.frames["projector"] + report.frames["led"] >= 50
    assert any("frames are labelled but not recorded" in text for text in rig.told)
    assert frames_are_what_they_are_called(recording) >= 20


# ---- without a head ------------------------------------------------------------------------------------------------


class Still:
    """A camera that gives labelled frames of a scan folder's kind, or none at all."""

    def __init__(self, count: int, width: int = 64, height: int = 48) -> None:
        self.width, self.height, self.encoding = width, height, "mono8"
        self.count, self.closed = count, False

    def start(self) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None:
        self.closed = True

    def set_controls(self, controls: object) -> None: ...

    def capture_request(self) -> HeldRequest:
        from annulus_pipe.capture.camera import EndOfFrames

        if self.count == 0:
            raise EndOfFrames
        self.count -= 1
        now = time.monotonic_ns() + 5_000_000
        light = {"Light": "projector", "ZMm": 1.5} if self.count % 2 else {}
        return HeldRequest(np.zeros((self.height, self.width), np.uint8), {"SensorTimestamp": now, **light})


def config(port: str | None, out: Path | None) -> HeadConfig:
    timing = FrameTiming(25.0, 38_000.0, 28_000.0)
    return HeadConfig((CameraConfig("folder", "x", 64, 48, timing=timing),), port=port, record_folder=out)


def test_without_a_controller_frames_bring_their_labels_or_are_unknown(tmp_path: Path) -> None:
    camera = Still(20)
    report = Session(config(None, tmp_path), [camera], name="scan").run(lambda: False)  # type: ignore[list-item]
    assert report.frames == {"projector": 10, "unknown": 10} and report.unknown == {"no controller": 10}
    assert camera.closed
    frames = open_recording(tmp_path / "scan.mcap").frames
    assert [f.label for f in frames].count(Label.PROJECTOR) == 10


def test_a_folder_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AnnulusError, match="Not a directory") as caught:
        Session(config(None, tmp_path / "file"), [Still(3)]).run(lambda: False)  # type: ignore[list-item]
    assert "\n" not in str(caught.value)


def test_a_port_that_is_not_there_or_silent_or_babbling_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match="cannot be opened"):
        Session(config("/dev/no-such-port", None), [Still(3)]).run(lambda: False)  # type: ignore[list-item]
    master, slave = pty.openpty()
    tty.setraw(slave)
    name = os.ttyname(slave)
    with pytest.raises(AnnulusError, match="no answer to identify"):
        Session(config(name, None), [Still(3)]).run(lambda: False)  # type: ignore[list-item]
    done = threading.Event()

    def babble() -> None:
        rng = np.random.default_rng(1)
        os.set_blocking(master, False)
        while not done.wait(0.01):
            try:
                os.write(master, rng.bytes(200))
                os.read(master, 1000)
            except BlockingIOError:
                continue

    babbler = threading.Thread(target=babble)
    babbler.start()
    try:
        with pytest.raises(AnnulusError, match="damaged frames and no answer to identify") as caught:
            Session(config(name, None), [Still(3)]).run(lambda: False)  # type: ignore[list-item]
    finally:
        done.set()
        babbler.join()
        os.close(master)
        os.close(slave)
    assert "\n" not in str(caught.value)
