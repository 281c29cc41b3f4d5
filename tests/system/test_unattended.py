"""Promises of a head that nobody watches, kept across processes: the simulated head in real time, all else real."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from annulus_pipe.capture.remote import RemoteCamera
from annulus_pipe.daemon.check import check_head
from annulus_pipe.daemon.config import RecordConfig
from annulus_pipe.daemon.health import HARMLESS, UNKNOWN_SHARE, HeadHealth
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.session import Session
from annulus_pipe.demo import demo_config
from annulus_pipe.link.client import Client
from annulus_pipe.record.recording import open_part, open_recording
from annulus_pipe.twin.head import HeadHandle, head_toml, start_head
from annulus_pipe.twin.worlds import demo_world
from annulus_pipe.vocabulary import AnnulusError

pytestmark = pytest.mark.alone

WORLD = demo_world(travel_mm=330.0).scaled(208)


class Told(Observer):
    def __init__(self) -> None:
        self.events: list[str] = []
        self.words: list[HeadHealth] = []

    def event(self, kind: str, text: str) -> None:
        self.events.append(text)

    def health(self, health: HeadHealth) -> None:
        self.words.append(health)


@pytest.fixture
def head() -> Iterator[HeadHandle]:
    with start_head(WORLD, 12.0, seed=5, speed_mm_s=25.0) as head:
        yield head


def session_of(head: HeadHandle, folder: Path, record: RecordConfig) -> tuple[Session, Told]:
    told = Told()
    config = replace(demo_config(head, WORLD, folder), calibration=None, record=record)
    return Session(config, [RemoteCamera(head.camera_address)], told, name="scan"), told


@pytest.mark.deep(gate="tests/system/test_unattended.py::test_the_check_finds_a_head_in_order_and_leaves_it_dark")
def test_a_scan_in_parts_loses_nothing_between_them_and_is_read_as_one(head: HeadHandle, tmp_path: Path) -> None:
    session, told = session_of(head, tmp_path, RecordConfig(part_minutes=1 / 60, sync_s=0.5, min_free_gb=0))
    report = session.run(lambda: session.seconds > 6.5)
    whole = open_recording(tmp_path / "scan.mcap")
    assert len(whole.parts) >= 4 and not whole.torn
    busy = report.drops.get("recorder_busy", 0)  # a machine with too much to do, and counted
    assert len(whole.frames) + busy == sum(report.frames.values()) >= 40
    assert sum(len(open_part(part.path).frames) for part in whole.parts) == len(whole.frames)
    assert report.recordings == tuple(part.path for part in whole.parts)
    assert all(len(whole.read_raw(frame)[0]) for frame in whole.frames)
    last = [*whole.notes("/health")][-1]
    assert {"health": told.words[-1].word.value, "why": told.words[-1].why} == last
    strained = set(report.drops) - HARMLESS or report.frames["unknown"] > UNKNOWN_SHARE * sum(report.frames.values())
    assert last["health"] in (("degraded",) if busy else ("ok", "degraded") if strained else ("ok",))
    assert json.loads((tmp_path / "health.json").read_text())["pid"] == os.getpid()


@pytest.mark.deep(gate="tests/system/test_unattended.py::test_the_check_finds_a_head_in_order_and_leaves_it_dark")
def test_no_scan_begins_without_room_and_lamps_stay_dark(head: HeadHandle, tmp_path: Path) -> None:
    session, _ = session_of(head, tmp_path, RecordConfig(min_free_gb=1e5))
    with pytest.raises(AnnulusError, match=r"GB free, expected at least 100000 GB \(\[record\] min_free_gb\)"):
        session.run(lambda: False)
    assert head.counters()["lamps_on"] == [] and not list(tmp_path.rglob("*.mcap"))


@pytest.mark.deep(gate="tests/system/test_unattended.py::test_the_check_finds_a_head_in_order_and_leaves_it_dark")
def test_a_scan_ends_and_its_recording_is_closed_before_the_disk_is_full(
    head: HeadHandle, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "annulus_pipe.daemon.disk.free_bytes", lambda *_: 10**9 if session.labelled < 15 else 150 * 10**6
    )
    session, _ = session_of(head, tmp_path, RecordConfig(min_free_gb=0))
    end = time.monotonic() + 60.0
    with pytest.raises(AnnulusError, match="MB free: the scan is ended while its recording can be closed"):
        session.run(lambda: time.monotonic() > end)
    recording = open_recording(tmp_path / "scan.mcap")
    assert not recording.torn and len(recording.frames) >= 15
    assert head.counters()["lamps_on"] == []


def test_the_check_finds_a_head_in_order_and_leaves_it_dark(head: HeadHandle, tmp_path: Path) -> None:
    toml = tmp_path / "head.toml"
    toml.write_text(head_toml(head, WORLD, None) + "[daemon]\nrealtime = false\n")
    found = {one.what: one for one in check_head(toml)}
    assert not [one for one in found.values() if one.ok is False]
    assert found["controller"].ok and found["camera 0"].ok and found["sensors"].ok
    assert head.counters()["lamps_on"] == []


@pytest.mark.deep(gate="tests/system/test_unattended.py::test_the_check_finds_a_head_in_order_and_leaves_it_dark")
def test_a_service_is_ready_fed_and_stopped_and_its_port_is_its_own(head: HeadHandle, tmp_path: Path) -> None:
    toml, log = tmp_path / "head.toml", tmp_path / "head.log"
    more = f'[record]\nfolder = "scans"\nmin_free_gb = 0\n[log]\nfile = "{log}"\n'
    toml.write_text(head_toml(head, WORLD, None) + more)
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "notify"))
        systemd.settimeout(60.0)
        daemon = subprocess.Popen(
            [sys.executable, "-c", "from annulus_pipe.cli import main; main()", "daemon", "--config", str(toml)],
            env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "30000000"},
            stderr=subprocess.PIPE,
            text=True,
        )
        try:
            said: list[str] = []
            while not any(line.startswith("STATUS=scanning, ") for line in said):
                said += systemd.recv(4096).decode().splitlines()
            assert "READY=1" in said and said.count("WATCHDOG=1") >= 2
            with pytest.raises(AnnulusError, match=rf"in use by another program \(process {daemon.pid}:"):
                Client(head.port_url)
            daemon.send_signal(signal.SIGTERM)
            while "STOPPING=1" not in said:
                said += systemd.recv(4096).decode().splitlines()
            assert daemon.wait(60.0) >= 0
        finally:
            daemon.kill()
            assert daemon.stderr is not None
            print(daemon.stderr.read())
    lines = log.read_text().splitlines()
    assert any(" INFO state scanning" in line for line in lines) and " INFO ended " in lines[-2] + lines[-1]
    assert json.loads((tmp_path / "scans" / "health.json").read_text())["pid"] == daemon.pid
