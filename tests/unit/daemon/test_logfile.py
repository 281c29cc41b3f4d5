"""Promises of the log: every line has its time, level and kind, the files have a bound, a slow disk holds up nobody."""

import re
import threading
from pathlib import Path

import pytest

from annulus_pipe.daemon import logfile
from annulus_pipe.daemon.config import LogConfig
from annulus_pipe.daemon.health import HeadHealth, Word
from annulus_pipe.daemon.logfile import LogFile
from annulus_pipe.daemon.state import State
from annulus_pipe.vocabulary import AnnulusError

LINE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z (INFO|WARNING|ERROR) \S+ .+")


def test_what_happens_is_a_line_with_time_level_and_kind(tmp_path: Path) -> None:
    log = LogFile(LogConfig(tmp_path / "logs" / "head.log"))
    log.state(State.FAULT, "the line is broken")
    log.event("link", "the line\nwent away")
    log.event("odometer", "zeroed")
    log.health(HeadHealth(Word.DEGRADED, "3 disk"))
    log.health(HeadHealth(Word.DEGRADED, "4 disk"))
    log.health(HeadHealth(Word.OK))
    log.telemetry({"state": "scanning", "frames": {"led": 3}, "drops": {}})
    log.close()
    lines = (tmp_path / "logs" / "head.log").read_text().splitlines()
    assert all(LINE.fullmatch(line) for line in lines)
    assert [line.split("Z ", 1)[1] for line in lines] == [
        "WARNING state fault: the line is broken",
        "WARNING link the line went away",
        "INFO odometer zeroed",
        "WARNING health degraded: 3 disk",
        "INFO health ok",
        "INFO telemetry scanning: 3 led; lost: nothing",
    ]


def test_the_files_have_a_bound_and_the_last_lines_are_kept(tmp_path: Path) -> None:
    log = LogFile(LogConfig(tmp_path / "head.log", max_mb=0.01, keep=2))
    for number in range(900):
        log.event("link", f"{number:0100d}")
    log.close()
    files = sorted(tmp_path.iterdir())
    assert [file.name for file in files] == ["head.log", "head.log.1", "head.log.2"]
    assert all(file.stat().st_size <= 10_000 for file in files)
    assert files[0].read_text().splitlines()[-1].endswith("0899")


def test_a_disk_that_stands_still_costs_lines_that_are_counted(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(logfile, "WAITING_MAX", 10)
    log = LogFile(LogConfig(tmp_path / "head.log"))
    stands, let_go = threading.Event(), threading.Event()
    write = log._file.handle

    def slow(record: object) -> bool:
        stands.set()
        let_go.wait(10.0)
        return write(record)  # type: ignore[arg-type]

    monkeypatch.setattr(log._file, "handle", slow)
    log.event("link", "first")
    assert stands.wait(10.0)
    for _ in range(15):
        log.event("link", "more")
    assert log.dropped == 5
    let_go.set()
    while log._waiting.qsize():
        stands.wait(0.01)
    log.event("link", "last")
    log.close()
    text = (tmp_path / "head.log").read_text()
    assert "WARNING log 5 lines before this one found no room" in text and text.endswith("link last\n")


def test_a_log_that_cannot_be_opened_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(AnnulusError, match="the log cannot be written"):
        LogFile(LogConfig(tmp_path / "file" / "head.log"))
