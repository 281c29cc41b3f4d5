"""Promises of the disk's forecast: minutes that come true, told once each; no scan without room."""

import threading
from dataclasses import dataclass
from pathlib import Path

import pytest

from annulus_pipe.daemon.config import RecordConfig
from annulus_pipe.daemon.disk import GB, MB, MINUTES, Asker, Forecast, require_room, require_space, short_of
from annulus_pipe.vocabulary import AnnulusError

RATE = 50 * MB


@dataclass
class FakeDisk:
    """Answers as statvfs does, of whatever is asked for."""

    free: float
    f_frsize: int = 4096

    @property
    def f_bavail(self) -> int:
        return int(self.free / self.f_frsize)

    def statvfs(self, path: str) -> "FakeDisk":
        return self


def test_the_forecast_is_how_long_it_really_lasts() -> None:
    reserve = 200 * MB
    free, forecast = 90 * 60 * RATE + reserve, Forecast(reserve)
    at_s, told, off = 0.0, [], []
    while not forecast.is_full(state := forecast.look(int(free), at_s, expected_rate=1.2 * RATE)):
        if news := forecast.news(state):
            told.append(news)
        assert state.minutes_left is not None
        if at_s >= 10.0:
            off.append(abs(state.minutes_left - (90 * 60 - at_s) / 60))
        free, at_s = free - RATE, at_s + 1.0
    assert at_s == pytest.approx(90 * 60, abs=2.0)
    assert max(off) < 0.1
    assert [line.split(", ")[1] for line in told] == [f"{minutes} min left at 50 MB/s" for minutes in MINUTES]


def test_before_a_rate_is_measured_the_cameras_rate_counts_and_at_rest_nothing_is_foretold() -> None:
    forecast = Forecast()
    assert forecast.look(int(60 * RATE), 0.0, RATE).minutes_left == pytest.approx(1.0, rel=0.01)
    forecast = Forecast()
    for second in range(40):
        state = forecast.look(int(60 * RATE), float(second))
    assert state.minutes_left is None and forecast.news(state) == ""
    assert str(state) == "3.0 GB free"


def test_room_that_somebody_made_is_told_of_again_when_it_goes() -> None:
    forecast = Forecast()
    assert "4 min left" in forecast.news(forecast.look(int(4 * 60 * RATE), 0.0, RATE))
    assert forecast.news(forecast.look(int(3.9 * 60 * RATE), 1.0, RATE)) == ""
    assert forecast.news(forecast.look(int(50 * 60 * RATE), 2.0, RATE)) == ""
    assert "9 min left" in forecast.news(forecast.look(int(9 * 60 * RATE), 3.0, RATE))


def test_no_scan_begins_without_room(tmp_path: Path) -> None:
    folder, limits = tmp_path / "to be made" / "scans", RecordConfig(min_free_gb=2, min_free_minutes=10)
    require_space(folder, limits, RATE, FakeDisk(11 * 60 * RATE).statvfs)
    with pytest.raises(AnnulusError, match=r"scans: 1\.9 GB free, expected at least 2 GB \(\[record\] min_free_gb\)"):
        require_space(folder, limits, RATE, FakeDisk(1.9 * GB).statvfs)
    with pytest.raises(AnnulusError, match=r"room for 9 min at 50 MB/s, expected at least 10 min"):
        require_space(folder, limits, RATE, FakeDisk(9 * 60 * RATE + 200 * MB).statvfs)

    def gone(path: str) -> FakeDisk:
        raise OSError(5, "Input/output error")

    with pytest.raises(AnnulusError, match="Input/output error"):
        require_space(folder, limits, RATE, gone)


def test_a_disk_that_hangs_hangs_nobody_else(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    let_go = threading.Event()

    def hanging(path: str) -> FakeDisk:
        let_go.wait(20.0)
        return FakeDisk(1.0 * GB)

    asker = Asker(tmp_path, hanging)
    assert asker.latest() is None and not asker.hangs
    with pytest.raises(AnnulusError, match="does not say what is free"):
        asker.free(0.0)
    monkeypatch.setattr("annulus_pipe.daemon.disk.HANGS_S", -1.0)
    assert asker.latest() is None and asker.hangs
    asker.close()
    let_go.set()


def test_room_that_was_made_a_moment_ago_counts(tmp_path: Path) -> None:
    free = [0.01 * GB]
    asker = Asker(tmp_path, lambda path: FakeDisk(free[0]))
    for room in (3.0, 0.01, 5.0):
        free[0] = room * GB
        assert asker.free(20.0) == asker.latest() == pytest.approx(room * GB, abs=4096)
    asker.close()


def test_who_asks_before_a_scan_has_the_last_answer_at_once_or_the_disks_own_words(tmp_path: Path) -> None:
    asker = Asker(tmp_path, FakeDisk(3.0 * GB).statvfs)
    assert asker.free(20.0) == pytest.approx(3.0 * GB, abs=4096)
    asker.close()

    def gone(path: str) -> FakeDisk:
        raise OSError(5, "Input/output error")

    asker = Asker(tmp_path, gone)
    with pytest.raises(AnnulusError, match="Input/output error"):
        asker.free(20.0)
    asker.close()


def test_a_scan_that_the_disk_would_end_is_warned_of_and_begun(tmp_path: Path) -> None:
    limits = RecordConfig(min_free_gb=1, reserve_mb=0, expect_minutes=40)
    require_room(tmp_path, limits, RATE, int(90 * GB))
    assert short_of(tmp_path, limits, RATE, int(40 * 60 * RATE)) == short_of(tmp_path, limits, 0.0, 0) == ""
    said = short_of(tmp_path, limits, RATE, int(30 * 60 * RATE))
    assert "room for 30 min at 50 MB/s, the scan is to take 40 min" in said and "\n" not in said
    assert short_of(tmp_path, RecordConfig(), RATE, 1) == ""
