"""Relabelling went on counting over a hole in the evidence in which z had been zeroed: 143 frames stood 25 mm off, 15
of them as counted, and neither the exit status nor the new recording said so.
"""

import json
import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from faulty_head import Head

from annulus_pipe.cli import main
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.evidence import Evidence
from annulus_pipe.job import JobSheet
from annulus_pipe.labelling.evidence import Row
from annulus_pipe.record.frames import place_of
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.reprocess.places import incomplete_findings
from annulus_pipe.reprocess.relabel import relabel
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.sensors.odometer import ANYWHERE_MM
from annulus_pipe.vocabulary import Label

BATCH = 100  # rows of one record
SAME_MM = 1e-6
Rows = list[tuple[int, list[Any]]]  # number of the first, rows
Damage = Callable[[Rows], Rows]


def scanned(seed: int, frames: int = 150, remember: int = 0) -> Head:
    """`remember`: after so many frames the odometer's state is written down, over and over."""
    head = Head(seed)
    head.begin()
    step = remember or frames
    for first in range(0, frames, step):
        head.run(first, first + step)
        if remember:
            head.navigation.remember()
    return head


def batches(head: Head) -> Rows:
    return [(first, head.rows[first : first + BATCH]) for first in range(0, len(head.rows), BATCH)]


def record(path: Path, head: Head, rows: Rows) -> Path:
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        for header in head.headers:
            label = {**header.to_dict(), "width": 4, "height": 4}
            writer.frame(label, np.full((4, 4), header.index % 251, np.uint8), header.timestamp_ns)
        for first, some in rows:
            writer.note("/evidence", {"first": first, "rows": some}, first)
        writer.note("/identity", {"why": "end", "evidence_rows": len(head.rows)}, len(head.rows))
    return path


def wrong(new: Recording, honest: Recording) -> list[str]:
    """Frames of which both say what lit them and where, and the new one another lamp, or a place beyond its own bound.
    The truth of the lamp is the head's cycle.
    """
    truth = {(frame.index, frame.camera): frame for frame in honest.frames}
    out = []
    for frame in new.frames:
        label, then = new.label(frame), truth[frame.index, frame.camera]
        if frame.label is Label.UNKNOWN:
            continue
        if frame.label is not (Label.LED if label["sequence"] % 5 == 0 else Label.PROJECTOR):
            out.append(f"{frame.index}: {frame.label}")
        off_mm = abs(frame.z_mm - then.z_mm) if then.label is not Label.UNKNOWN else 0.0
        if off_mm > label["z_bound_mm"] + SAME_MM or (label["z_bound_mm"] > 0.0) != label["z_assumed"]:
            out.append(f"{frame.index}: {off_mm} mm off, bound {label['z_bound_mm']}")
        if off_mm > SAME_MM and frame.segment == then.segment:
            out.append(f"{frame.index}: {off_mm} mm off in one segment")
    return out


def known(recording: Recording) -> int:
    return sum(frame.label is not Label.UNKNOWN for frame in recording.frames)


def at(head: Head, what: str, nth: int = 0) -> int:
    """Number of the batch in which something was."""
    return [number for number, row in enumerate(head.rows) if row["what"] == what][nth] // BATCH


def lose(*which: int) -> Damage:
    return lambda rows: [one for n, one in enumerate(rows) if n not in which and n - len(rows) not in which]


def garble(which: int, made: Callable[[Row], Any]) -> Damage:
    def damage(rows: Rows) -> Rows:
        first, some = rows[which]
        return [*rows[:which], (first, [made(row) for row in some]), *rows[which + 1 :]]

    return damage


def swapped(which: int) -> Damage:
    return lambda rows: [*rows[:which], rows[which + 1], rows[which], *rows[which + 2 :]]


def renumbered(which: int, first: int) -> Damage:
    return lambda rows: [*rows[:which], (first, rows[which][1]), *rows[which + 1 :]]


def restarted(seed: int, moved_ns: int) -> Head:
    head = Head(seed)
    head.begin()
    head.run(0, 150)
    head.restart(moved_ns)
    head.run(150, 300)
    return head


CASES: dict[str, tuple[Callable[[], Head], Callable[[Head], Damage]]] = {
    "a zero": (lambda: scanned(9), lambda head: lose(at(head, "zero"))),
    "two": (lambda: scanned(6, 300), lambda head: lose(3, 9)),
    "two side by side": (lambda: scanned(6, 300), lambda head: lose(5, 6)),
    "a restart of the controller": (lambda: scanned(7, 300), lambda head: lose(at(head, "rebooted"))),
    "two restarts and what is between": (
        lambda: scanned(7, 300),
        lambda head: lose(*range(at(head, "rebooted"), at(head, "rebooted", 1) + 1)),
    ),
    "a restart of the camera": (lambda: restarted(8, 7_000_000), lambda head: lose(at(head, "restarted"))),
    "a restart of the camera, a frame off": (
        lambda: restarted(8, 40_000_000),
        lambda head: lose(at(head, "restarted")),
    ),
    "the start": (lambda: scanned(9), lambda head: lose(0)),
    "the start, and the odometer comes later": (lambda: scanned(9, 300, remember=100), lambda head: lose(0, 1)),
    "the end": (lambda: scanned(9), lambda head: lose(-1)),
    "all but the end": (lambda: scanned(9, 300, remember=75), lambda head: lose(*range(10))),
    "rows that are none": (lambda: scanned(9), lambda head: garble(at(head, "zero"), lambda row: {})),
    "rows that are no rows": (lambda: scanned(9), lambda head: garble(at(head, "zero"), lambda row: None)),
    "rows of unknown kinds": (
        lambda: scanned(9),
        lambda head: garble(at(head, "zero"), lambda row: {**row, "what": row["what"] + "s"}),
    ),
    "rows of texts": (
        lambda: scanned(9),
        lambda head: garble(at(head, "zero"), lambda row: {key: str(value) for key, value in row.items()}),
    ),
    "rows without their numbers": (
        lambda: scanned(9),
        lambda head: garble(at(head, "zero"), lambda row: {"what": row["what"] if row["what"] != "zero" else "Zero"}),
    ),
    "records in another order": (lambda: scanned(9), lambda head: swapped(at(head, "zero"))),
    "a record that counts from elsewhere": (lambda: scanned(9), lambda head: renumbered(at(head, "zero"), 1 << 40)),
    "a record that counts from the start": (lambda: scanned(9), lambda head: renumbered(at(head, "zero"), 0)),
}


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("case", list(CASES))
def test_nothing_that_follows_a_hole_is_wrong_and_the_hole_is_said(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    head = CASES[case][0]()
    honest = open_recording(record(tmp_path / "honest.mcap", head, batches(head)))
    path = record(tmp_path / "a.mcap", head, CASES[case][1](head)(batches(head)))
    assert run(monkeypatch, "relabel", path, "--audit") == 1
    assert f"annulus: {path}: row" in capsys.readouterr().err
    assert run(monkeypatch, "relabel", path, "-o", tmp_path / "b.mcap") == 1
    assert f"annulus: {path}: row" in capsys.readouterr().err
    new = open_recording(tmp_path / "b.mcap")
    assert wrong(new, honest) == []
    some = {"the start": 0.0, "all but the end": 0.05}.get(case, 0.6)
    assert known(new) >= some * known(honest)
    (note,) = new.notes("/relabelled")
    assert note["missing_places"] and "of the evidence" in note["missing"][0]
    assert run(monkeypatch, "verify", tmp_path / "b.mcap") == 0
    assert "missing  row" in capsys.readouterr().out
    assert run(monkeypatch, "info", tmp_path / "b.mcap", "--json") == 0
    assert json.loads(capsys.readouterr().out)["missing"] == note["missing"]
    assert open_scan(tmp_path / "b.mcap").lost()["recording_incomplete"] == note["missing_places"]
    assert "rows" in incomplete_findings(open_scan(tmp_path / "b.mcap"))[0].text
    assert run(monkeypatch, "relabel", tmp_path / "b.mcap", "--audit") == 1


def run(monkeypatch: pytest.MonkeyPatch, *arguments: object) -> int:
    monkeypatch.setattr("sys.argv", ["annulus", "record", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.mark.deep(
    gate="tests/regression/hole_in_the_evidence/test_hole.py::test_nothing_that_follows_a_hole_is_wrong_and_the_hole_is_said"
)
@pytest.mark.parametrize("seed", [9, 18])
def test_z_is_anywhere_behind_a_zero_that_is_lost_until_the_odometer_is_read(seed: int, tmp_path: Path) -> None:
    """The head had no label to help: it labelled nothing behind the hole."""
    head = scanned(seed, 320, remember=160)
    honest = open_recording(record(tmp_path / "honest.mcap", head, batches(head)))
    gone = at(head, "zero")
    for number in range(gone * BATCH, len(head.rows)):
        if head.rows[number]["what"] == "label":
            head.rows[number] = {**head.rows[number], "label": "unknown"}
    relabel(record(tmp_path / "a.mcap", head, lose(gone)(batches(head))), tmp_path / "b.mcap")
    new = open_recording(tmp_path / "b.mcap")
    assert wrong(new, honest) == []
    bounds = [frame.z_bound_mm for frame in new.frames if frame.label is not Label.UNKNOWN]
    assert ANYWHERE_MM in bounds and bounds[-1] < ANYWHERE_MM


def test_a_recording_that_lacks_nothing_is_relabelled_as_ever(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Odometer rows that are there for others change nothing."""
    for remember in (0, 20):
        head = scanned(9, 60, remember)
        path = record(tmp_path / f"{remember}.mcap", head, batches(head))
        assert run(monkeypatch, "relabel", path, "--audit") == 0
        assert run(monkeypatch, "relabel", path, "-o", tmp_path / f"{remember}-new.mcap") == 0
    plain, remembered = (open_recording(tmp_path / f"{remember}-new.mcap") for remember in (0, 20))
    assert [plain.label(frame) for frame in plain.frames] == [remembered.label(frame) for frame in remembered.frames]
    assert not open_scan(tmp_path / "20-new.mcap").lost() and not incomplete_findings(
        open_scan(tmp_path / "0-new.mcap")
    )


def test_a_damaged_chunk_ends_recovering_and_relabelling_with_status_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    head = scanned(9, 60)
    path = record(tmp_path / "a.mcap", head, batches(head))
    chunk = open_recording(path).frames[40].chunk
    assert chunk is not None
    data = bytearray(path.read_bytes())
    data[chunk.offset + chunk.length // 2] ^= 1
    path.write_bytes(data)
    for verb in ("recover", "relabel"):
        assert run(monkeypatch, verb, path, "-o", tmp_path / f"{verb}.mcap") == 1
        lines = capsys.readouterr().err.splitlines()
        assert len([line for line in lines if line.startswith(f"annulus: {path}: ")]) >= 2  # the chunk, and its frame
        assert "frame" in lines[-1] and f"at byte {chunk.offset}" in lines[-1]
        assert run(monkeypatch, "verify", tmp_path / f"{verb}.mcap") == 0
        assert f"at byte {chunk.offset}" in capsys.readouterr().out


def test_the_odometer_is_written_down_every_minute_and_how_many_rows_there_are() -> None:
    head, notes = scanned(9, 10), list[tuple[str, Mapping[str, Any]]]()
    config = cast(HeadConfig, SimpleNamespace(cameras=(), job=JobSheet()))
    evidence = Evidence(lambda topic, body: notes.append((topic, body)), head.navigation, Account(), config, (), None)
    for minute in (0.0, 3.0, 6.0, 9.0):  # of a monotonic clock that is none of this test's
        evidence.turn(time.monotonic() + minute * 60.0)
    evidence.close()
    rows = [row for topic, body in notes if topic == "/evidence" for row in body["rows"]]
    states = [row for row in rows if row["what"] == "odometer"]
    assert [bool(row.get("again")) for row in states] == [False, True, True, True] and all(
        row["known"] for row in states
    )
    assert [body["evidence_rows"] for topic, body in notes if topic == "/identity"][-1] == len(rows)


def test_a_bound_that_is_no_number_is_not_read_as_counted() -> None:
    for bound in (None, math.nan, -1.0, "5", 1e300):
        assert place_of({"label": "led", "z_mm": 5.0, "z_assumed": True, "z_bound_mm": bound})[3] == ANYWHERE_MM
    assert place_of({"label": "led", "z_mm": 5.0})[3] == 0.0
