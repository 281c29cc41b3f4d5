"""Promises of the job sheet: kept word for word, never guessed, wrong in one line."""

import datetime
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from annulus_pipe.job import WORDS, JobSheet, Origin, job_of, provenance, read_job, recorded_provenance
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.scans.origin import origin_of
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.untrusted import printable
from annulus_pipe.vocabulary import AnnulusError


def test_names_of_before_are_read() -> None:
    old = {"who": "J. Doe", "where": "Elm Street", "what": "DN 150"}
    sheet = JobSheet.from_dict(old)
    assert (sheet.operator, sheet.site, sheet.pipe) == ("J. Doe", "Elm Street", "DN 150")
    assert JobSheet.recorded(old) == sheet


def test_a_command_line_says_names_and_files_and_the_later_one_wins(tmp_path: Path) -> None:
    file = tmp_path / "job.toml"
    file.write_text('client = "A"\nsdr = 17.6\ndate = 2026-11-25\npipe = 7\n')
    sheet = job_of([str(file), "client=B", "where=Elm Street = 4"])
    assert sheet.to_dict() == {"client": "B", "site": "Elm Street = 4", "pipe": "7", "sdr": 17.6, "date": "2026-11-25"}
    file.write_text('[job]\nclient = "A"\n')
    assert read_job(file) == JobSheet(client="A")


@pytest.mark.parametrize(
    ("wrong", "match"),
    [
        ("where", "expected NAME=TEXT or a file .toml"),
        ("where=", "expected NAME"),
        ("when=now", "a name one of"),
        ("\x1b[2J=x", "expected NAME=TEXT"),
        ("sdr=thick", "job sdr is 'thick', expected a number in 3..100"),
        ("date=today", "job date is 'today', expected a day, YYYY-MM-DD"),
        ("no-such.toml", "cannot be read"),
        ("site=" + 301 * "x", "job site must be a text of at most 300"),
    ],
)
def test_what_is_wrong_on_the_command_line_is_one_line(wrong: str, match: str) -> None:
    with pytest.raises(AnnulusError, match=match) as told:
        job_of([wrong])
    assert str(told.value).isprintable()


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ('client = ["A"]', r"j.toml: \[job\] client must be a text"),
        ("client = ", "not TOML"),
        ('"\x7f" = 1', "not TOML"),
        ('colour = "red"', "colour is not known, expected one of client, site"),
        ("[job]\nsdr = true\n", "sdr is True, expected a number"),
        ("[job]\n[limits]\n", "job is not known"),
    ],
)
def test_a_wrong_file_is_one_line(text: str, match: str, tmp_path: Path) -> None:
    (tmp_path / "j.toml").write_text(text)
    with pytest.raises(AnnulusError, match=match) as told:
        read_job(tmp_path / "j.toml")
    assert str(told.value).isprintable()


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(
    st.dictionaries(
        st.sampled_from([*WORDS, "who", "x"]), st.none() | st.text(max_size=400) | st.floats() | st.booleans()
    )
)
def test_whatever_a_recording_says_is_a_sheet_that_reads_back(data: dict[str, object]) -> None:
    sheet = JobSheet.recorded(data)
    assert JobSheet.from_dict(sheet.to_dict()) == sheet
    assert all(printable(str(value)) == str(value) for value in sheet.to_dict().values())
    json.dumps(sheet.to_dict(), allow_nan=False)


def test_nothing_is_said_of_an_old_recording(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    write(path, {"port": None}, [])
    origin = origin_of(open_scan(path))
    assert origin.job == JobSheet() and origin.utc == ("", "") and not origin.calibration


def test_a_recording_gives_back_job_times_and_provenance(tmp_path: Path) -> None:
    path = tmp_path / "scan.mcap"
    made = {
        "rings": {"by": "annulus calibrate pipe", "held_out_mm": 0.1, "utc": "2026-11-01T00:00:00+00:00", "all": [1]}
    }
    notes = [
        {"utc": "2026-11-25T06:00:00.000+00:00", "job": {"where": "Elm Street"}, "controller": None},
        {
            "utc": "2026-11-25T06:10:00.000+00:00",
            "job": {"where": "Elm Street", "client": "A"},
            "controller": {"serial": "E66", "version": "1.2.3"},
        },
    ]
    write(path, {"job": {"who": "J. Doe"}, "calibration_provenance": made}, notes)
    origin = origin_of(open_scan(path), job=JobSheet(client="B"))
    assert origin.job == JobSheet(client="B", site="Elm Street", operator="J. Doe")
    assert [one[:16] for one in origin.utc] == ["2026-11-25T06:00", "2026-11-25T06:10"]
    assert origin.controller["serial"] == "E66"
    assert origin.calibration == {"rings": {k: v for k, v in made["rings"].items() if k != "all"}}


def test_what_was_told_during_the_scan_goes_over_what_was_configured(tmp_path: Path) -> None:
    """Field by field, the last word counting; what is malformed is passed over."""
    path = tmp_path / "told.mcap"
    told = [{"client": "B", "operator": "R. Roe"}, {"client": "C", "sdr": "wide", "host_ns": 3}, "none", {"pipe": 7}]
    write(path, {"job": {"operator": "J. Doe", "site": "Elm Street"}}, [{"job": {"client": "A"}}], told)
    assert origin_of(open_scan(path)).job == JobSheet(client="C", operator="R. Roe", site="Elm Street", pipe="7")


def test_provenance_of_a_stranger_is_bounded() -> None:
    huge = {"provenance": {str(i): {str(j): "x" * 1000 for j in range(100)} for i in range(1000)}}
    assert sum(len(one) for one in provenance(huge).values()) == 0 and len(provenance(huge)) <= 32
    for strange in (None, [], {"calibration_provenance": 3}, {"calibration_provenance": {"rings": "mine"}}):
        assert recorded_provenance(strange) == {}


def test_a_scan_folder_may_have_its_job_beside(tmp_path: Path) -> None:
    (tmp_path / "0.jpg").write_bytes(b"")
    (tmp_path / "frames.csv").write_text("index,file,light,z_mm\n0,0.jpg,projector,0\n")
    (tmp_path / "job.toml").write_text('site = "Elm Street"\noperator = "J. Doe"\n')
    origin = origin_of(open_scan(tmp_path), job=JobSheet(operator="R. Roe"))
    assert origin.job == JobSheet(site="Elm Street", operator="R. Roe")


def test_a_day_may_be_toml_s_own() -> None:
    assert JobSheet.from_dict({"date": datetime.date(2026, 11, 25)}).date == "2026-11-25"


def write(
    path: Path, configuration: dict[str, object], notes: list[dict[str, object]], told: Sequence[Any] = ()
) -> None:
    import numpy as np

    with RecordingWriter(path, calibration=None, configuration=configuration, now_ns=1) as writer:
        for at, note in enumerate(notes):
            writer.note("/identity", note, 2 + at)
        for note in told:
            writer.note("/job", note if isinstance(note, dict) else {"job": note}, 3)
        header = {
            "index": 0,
            "camera": 0,
            "label": "projector",
            "z_mm": 0.0,
            "encoding": "mono8",
            "width": 4,
            "height": 4,
        }
        assert writer.frame(header, np.zeros((4, 4), np.uint8), 1)


def test_what_is_told_to_be_empty_is_and_what_is_not_told_stays() -> None:
    sheet = JobSheet(client="A", site="Elm Street", sdr=11.0)
    assert sheet.over_told({"client": "", "sdr": None}) == JobSheet(site="Elm Street")
    assert sheet.over_told({"site": "Oak Street"}) == JobSheet(client="A", site="Oak Street", sdr=11.0)
    assert sheet.over_told(JobSheet(pipe="P-1").to_whole()) == JobSheet(pipe="P-1")
    assert sheet.over_told(None) == sheet


@pytest.mark.parametrize(
    ("typed", "clock", "day"),
    [
        ("2027-03-01", "2028-06-01T09:00:00+00:00", "2028-06-01"),  # a certificate that has lapsed by then has lapsed
        ("2027-03-01", "2020-01-01T00:00:05+00:00", "2027-03-01"),
        ("2027-03-01", "", "2027-03-01"),
        ("", "1970-01-01T00:03:00+00:00", None),
        ("", "", None),
    ],
)
def test_the_day_of_a_scan_is_the_later_of_what_was_typed_and_the_clock(
    typed: str, clock: str, day: str | None
) -> None:
    found = Origin(JobSheet(date=typed), utc=(clock, "")).day
    assert (None if found is None else found.isoformat()) == day
