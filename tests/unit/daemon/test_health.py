"""Promises of the one word: it is said within a second, says why, and comes back by itself."""

import json
import os
from pathlib import Path
from typing import Any

import pytest

from annulus_pipe.daemon.health import HeadHealth, HealthFile, HealthWatch, Word, health_path


class Head:
    """A head's counters, moved on by the second."""

    def __init__(self, records: bool = True) -> None:
        self.watch, self.now_s = HealthWatch(records), 100.0
        self.telemetry: dict[str, Any] = {
            "state": "scanning",
            "frames": {"projector": 0, "led": 0, "unknown": 0},
            "recorded": 0,
            "drops": {},
            "disk": {},
        }

    def second(
        self, known: int = 25, unknown: int = 0, recorded: int | None = None, why: str = "", **lost: int
    ) -> HeadHealth:
        """One more, with so many frames, and so many lost by kind."""
        now = self.telemetry
        frames, drops = now["frames"], now["drops"]
        self.telemetry = {
            **now,
            "frames": {**frames, "projector": frames["projector"] + known, "unknown": frames["unknown"] + unknown},
            "recorded": now["recorded"] + (known + unknown if recorded is None else recorded),
            "drops": {**drops, **{kind: drops.get(kind, 0) + count for kind, count in lost.items()}},
        }
        self.now_s += 1.0
        return self.watch.judge(self.telemetry, why, self.now_s)


def test_a_head_that_does_its_work_is_ok() -> None:
    head = Head()
    assert {str(head.second()) for _ in range(60)} == {"ok"}


def test_a_loss_is_said_at_once_and_forgotten_after_ten_seconds() -> None:
    head = Head()
    for _ in range(20):
        head.second()
    assert str(head.second(disk=3)) == "degraded: 3 disk"
    assert str(head.second(camera=1)) == "degraded: 3 disk; 1 camera"
    words = [head.second().word for _ in range(12)]
    assert words == [Word.DEGRADED] * 9 + [Word.OK] * 3


def test_what_is_recorded_but_not_seen_live_is_no_matter_of_health() -> None:
    head = Head()
    assert {str(head.second(worker_busy=20, worker_late=1, control_malformed=5)) for _ in range(30)} == {"ok"}


def test_a_share_of_unknown_frames_degrades_and_single_ones_do_not() -> None:
    head = Head()
    assert {str(head.second(24, 1)) for _ in range(30)} == {"ok"}
    said = [str(head.second(20, 5)) for _ in range(12)]
    assert said[-1] == "degraded: 50 of 250 frames unknown"


def test_a_fault_is_failed_and_says_which() -> None:
    head = Head()
    head.second()
    head.telemetry["state"] = "fault"
    said = head.second(0, why="/dev/ttyACM0: the line is broken")
    assert str(said) == "failed: /dev/ttyACM0: the line is broken" and not said.restart_helps
    head.telemetry["state"] = "scanning"
    assert head.second().word is Word.OK


def test_a_recording_that_does_not_grow_is_failed_and_a_restart_may_help() -> None:
    head = Head()
    for _ in range(5):
        head.second()
    said = [head.second(recorded=0) for _ in range(12)]
    assert said[4].word is Word.OK
    assert str(said[-1]) == "failed: 250 frames in 10 s and none recorded" and said[-1].restart_helps
    assert head.second().word is Word.OK


def test_a_head_that_does_not_record_does_not_fail_at_it() -> None:
    head = Head(records=False)
    assert {head.second(recorded=0).word for _ in range(30)} == {Word.OK}


def test_a_disk_with_minutes_left_degrades() -> None:
    head = Head()
    head.telemetry["disk"] = {"minutes_left": 8.7}
    assert str(head.second()) == "degraded: disk: 9 min left"
    head.telemetry["disk"] = {"minutes_left": None, "hangs": True}
    assert str(head.second()) == "degraded: disk: does not say what is free"


def test_a_new_scan_is_not_judged_by_the_last_ones_counters() -> None:
    head = Head()
    for _ in range(5):
        head.second(disk=1)
    head.telemetry |= {"frames": {"projector": 0, "led": 0, "unknown": 0}, "recorded": 0, "drops": {}}
    assert head.second(0).word is Word.OK


def test_many_reasons_are_one_line() -> None:
    head = Head()
    head.second()
    assert str(head.second(disk=5, camera=4, no_slot=3, edge_events=2, sensor_silent=1)) == (
        "degraded: 5 disk; 4 camera; 3 no_slot; 2 more"
    )


def test_the_file_is_always_whole_and_the_last_word(tmp_path: Path) -> None:
    path = tmp_path / "scans" / "health.json"
    file = HealthFile(path)
    for number in range(50):
        file.write(HeadHealth(Word.DEGRADED, f"{number} disk"), "scanning", {"minutes_left": 3.0})
        if path.exists():
            json.loads(path.read_text())
    file.close()
    body = json.loads(path.read_text())
    assert (body["health"], body["why"], body["state"], body["pid"]) == ("degraded", "49 disk", "scanning", os.getpid())
    assert body["utc"].endswith("+00:00") and list(path.parent.iterdir()) == [path]


def test_a_file_that_cannot_be_written_is_said_and_nothing_worse(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    file = HealthFile(tmp_path / "file" / "health.json")
    file.write(HeadHealth(Word.OK), "idle", {})
    file.close()
    assert "cannot be written" in file.problem


def test_it_is_beside_the_recordings_or_in_the_runtime_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/run/user/7")
    assert health_path(Path("/data/scans")) == Path("/data/scans/health.json")
    assert health_path(None) == Path("/run/user/7/annulus-health.json")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert health_path(None) is None
