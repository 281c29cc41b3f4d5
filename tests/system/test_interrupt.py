"""Promises of the demo when broken off: recording readable, lamps off, no process left, nothing in shared memory."""

import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from annulus_pipe.record.recording import open_recording
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.twin.head import head_toml, start_head
from annulus_pipe.twin.worlds import demo_world

pytestmark = pytest.mark.alone

DEMO = [sys.executable, str(Path(__file__).with_name("interrupted_demo.py"))]
RNG = random.Random(20261121)
# What the demo says last before the signal, how long after, which signal, how often. SIGINT goes to the whole group,
# as a terminal sends it.
MOMENTS = [
    ("measuring", RNG.uniform(0.0, 1.0), signal.SIGINT, 1),
    ("powering", RNG.uniform(0.0, 1.0), signal.SIGINT, 1),
    ("frame-sync", RNG.uniform(0.0, 2.0), signal.SIGINT, 1),
    ("running", RNG.uniform(0.0, 0.5), signal.SIGINT, 1),
    ("camera timestamps", RNG.uniform(0.0, 2.0), signal.SIGINT, 3),
    ("camera timestamps", RNG.uniform(0.5, 2.0), signal.SIGTERM, 1),
    ("building", RNG.uniform(0.0, 1.0), signal.SIGINT, 1),
]


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("says, after_s, number, times", MOMENTS, ids=[f"{m[0]}-{m[2].name}" for m in MOMENTS])
def test_broken_off_at_any_moment(
    says: str, after_s: float, number: signal.Signals, times: int, traces, tmp_path: Path
) -> None:
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    demo = subprocess.Popen([*DEMO, str(tmp_path), "3"], env=traces.environment, start_new_session=True, **quiet)
    lines: list[str] = []
    said = threading.Event()

    def listen() -> None:
        assert demo.stderr is not None
        for line in demo.stderr:
            lines.append(line)
            if says in line:
                said.set()
        said.set()

    listener = threading.Thread(target=listen)
    listener.start()
    try:
        assert said.wait(120)
        time.sleep(after_s)  # a moment in its life, not a wait for something
        for _ in range(times):
            if number is signal.SIGINT:
                os.killpg(demo.pid, number)
            else:
                demo.send_signal(number)
            time.sleep(0.05)
        status = demo.wait(60)
    finally:
        demo.kill()
        listener.join()
    heard = "".join(lines)
    assert status == 130, heard
    assert "Traceback" not in heard
    assert traces.left() == {}, heard
    recording = tmp_path / "scan.mcap"
    if says in ("camera timestamps", "building"):
        assert recording.exists()
    if recording.exists():
        opened = open_recording(recording)
        assert not opened.torn
        for frame in opened.frames:
            opened.read(frame)
        if says in ("camera timestamps", "building"):
            assert len(opened.frames) >= 10
        told = [note["text"] for note in opened.notes("/event") if note.get("kind") == "head"]
        assert not told or told[-1] == "idle", "the controller did not confirm that the lamps are off"
        assert "running" not in told or told.index("running") < len(told) - 1


@pytest.mark.deep(gate="tests/system/test_interrupt.py::test_broken_off_at_any_moment")
def test_a_killed_demo_leaves_a_readable_recording_and_nothing_else(traces, tmp_path: Path) -> None:
    demo = subprocess.Popen([*DEMO, str(tmp_path), "20"], env=traces.environment, stderr=subprocess.PIPE, text=True)
    assert demo.stderr is not None
    for line in demo.stderr:
        if "camera timestamps" in line:
            break
    time.sleep(1.0)
    demo.kill()
    demo.wait(10)
    demo.stderr.close()
    left = traces.left(10.0)
    assert "processes" not in left and "shm" not in left
    opened = open_recording(tmp_path / "scan.mcap")
    assert len(opened.frames) >= 10
    for frame in opened.frames:
        opened.read(frame)


@pytest.mark.deep(gate="tests/system/test_interrupt.py::test_broken_off_at_any_moment")
def test_the_daemon_runs_a_head_from_its_file_until_ctrl_c(traces, tmp_path: Path) -> None:
    world = demo_world(travel_mm=330.0).scaled(416)
    save_calibration(tmp_path / "head-7.json", world.calibration())
    with start_head(world, 8.0, seed=9) as head:
        more = '[record]\nfolder = "scans"\n[publish]\naddress = "tcp://127.0.0.1:*"\n'
        (tmp_path / "head.toml").write_text(head_toml(head, world, Path("head-7.json")) + "\n" + more)
        command = [sys.executable, "-c", "from annulus_pipe.cli import main; main()", "daemon", "--config"]
        daemon = subprocess.Popen(
            [*command, str(tmp_path / "head.toml")], env=traces.environment, stderr=subprocess.PIPE, text=True
        )
        assert daemon.stderr is not None
        heard = []
        for line in daemon.stderr:
            heard.append(line)
            if line.startswith("scanning: ") and int(line.split()[1]) >= 12:
                daemon.send_signal(signal.SIGINT)
                break
        heard += daemon.stderr.readlines()
        assert daemon.wait(30) == 0, "".join(heard)
        assert head.counters()["lamps_on"] == []
    assert traces.left() == {}
    (recording,) = (tmp_path / "scans").glob("*.mcap")
    assert f"recording {recording}" in heard[-1]
    opened = open_recording(recording)
    assert not opened.torn and len(opened.frames) >= 12
