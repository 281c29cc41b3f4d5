"""Promises of a scan whose camera, or the camera's intake, goes away: the hole is counted, and the scan goes on."""

import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from select import select

import pytest

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.daemon.account import ScanReport
from annulus_pipe.daemon.camera_config import CameraConfig
from annulus_pipe.daemon.config import SLOTS, HeadConfig
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.session import Session
from annulus_pipe.daemon.state import State
from annulus_pipe.record.recording import open_recording
from annulus_pipe.twin.camera_server import CameraServer

pytestmark = pytest.mark.alone

FPS = 50.0
SIDES = {"width": 96, "height": 64}
TIMING = FrameTiming(FPS, 18_000.0, 10_000.0)


class Plug:
    """A served camera that can be pulled out and put back in; its count begins anew each time."""

    def __init__(self) -> None:
        self._done, self._thread = threading.Event(), threading.Thread()
        self.address = ""
        self.put_in()

    def put_in(self) -> None:
        hello = {**SIDES, "encoding": "bayer_rggb8", "timing": asdict(TIMING)}
        server = CameraServer(hello, Counter())
        self.address = server.address
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._serve, args=(server, self._done), daemon=True)
        self._thread.start()

    def pull_out(self) -> None:
        self._done.set()
        self._thread.join()

    @staticmethod
    def _serve(server: CameraServer, done: threading.Event) -> None:
        due, number = time.monotonic(), 0
        while not done.is_set():
            readable, _, _ = select(server.waitables(), [], [], max(0.0, due - time.monotonic()))
            server.serve(readable)
            if time.monotonic() >= due:
                slot = server.take()
                if slot is not None:
                    server.slots[slot] = number % 256
                    told = {"SensorTimestamp": time.monotonic_ns(), "FrameSequence": number}
                    server.deliver(slot, server.generation, told)
                due, number = due + 1 / FPS, number + 1
        server.close()


class Watched(Observer):
    """When frames came, and what was told."""

    def __init__(self, config: HeadConfig) -> None:
        self.session = Session(config, observer=self, name="scan")
        self.frames_s: list[float] = []
        self.told: list[str] = []
        self.states: list[State] = []

    def frame(self, header: object, image: object) -> None:
        self.frames_s.append(time.monotonic())

    def event(self, kind: str, text: str) -> None:
        self.told.append(text)

    def state(self, state: State, why: str) -> None:
        self.states.append(state)

    def run(self, course: Callable[["Watched"], Iterator[Callable[[], bool]]]) -> ScanReport:
        """`course` does something and yields what it then waits for."""
        steps, end = course(self), time.monotonic() + 60.0
        waiting: list[Callable[[], bool]] = [lambda: bool(self.frames_s)]

        def over() -> bool:
            assert time.monotonic() < end, self.told
            if waiting[0]():
                following = next(steps, None)
                if following is None:
                    return True
                waiting[0] = following
            return False

        return self.session.run(over)

    def intake(self) -> int:
        pid = self.session._feeds[0].pid
        assert pid is not None
        return pid


@contextmanager
def head(out: Path) -> Iterator[tuple[Plug, Watched]]:
    plug = Plug()
    camera = CameraConfig("remote", plug.address, **SIDES, timing=TIMING)
    try:
        yield plug, Watched(replace(HeadConfig((camera,)), record_folder=out))
    finally:
        plug.pull_out()


def accounted(watched: Watched, report: ScanReport, out: Path) -> None:
    """Every frame is somewhere, and no slot was left behind."""
    assert not any(report.telemetry["in_hand"].values())
    assert watched.session._power is not None and watched.session._power.shared.ring.free == SLOTS
    assert len(open_recording(out / "scan.mcap").frames) == sum(report.frames.values())


def test_a_camera_pulled_out_and_put_back_costs_its_frames_and_nothing_else(tmp_path: Path) -> None:
    away_s = 1.2

    def course(watched: Watched) -> Iterator[Callable[[], bool]]:
        plug.pull_out()
        out_s = time.monotonic()
        yield lambda: watched.session.state is State.FAULT and time.monotonic() > out_s + away_s
        plug.put_in()
        before = len(watched.frames_s)
        yield lambda: len(watched.frames_s) >= before + 20
        yield lambda: watched.session.state is State.ARMED

    with head(tmp_path) as (plug, watched):
        report = watched.run(course)
    accounted(watched, report, tmp_path)
    assert report.drops["camera_gone"] == 1 and "cameras_replaced" not in report.drops
    assert report.drops["camera_away"] >= (away_s - 0.1) * FPS
    assert any("camera 0 is gone" in text for text in watched.told) and any("is back after" in t for t in watched.told)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_an_intake_that_is_killed_or_stopped_is_replaced_and_its_slots_come_back(how: int, tmp_path: Path) -> None:
    times = 3
    gone: list[int] = []

    def course(watched: Watched) -> Iterator[Callable[[], bool]]:
        for _ in range(times):
            gone.append(watched.intake())
            os.kill(gone[-1], how)
            before = len(watched.frames_s)
            yield lambda: watched.session._feeds[0].pid not in gone
            yield lambda before=before: len(watched.frames_s) >= before + 30  # type: ignore[misc]
        gone.append(watched.intake())

    with head(tmp_path) as (_, watched):
        report = watched.run(course)
    accounted(watched, report, tmp_path)
    assert report.drops["cameras_replaced"] == report.drops["camera_gone"] == times
    assert report.drops["camera_away"] >= times
    assert not any(Path(f"/proc/{pid}").exists() for pid in gone), "nothing is left behind"
