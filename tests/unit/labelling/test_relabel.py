"""Promises of `annulus record relabel`: an honest recording audits clean, another does not, and the original stays."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from faulty_head import Head

from annulus_pipe.cli import main
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.reprocess.relabel import audit, relabel
from annulus_pipe.scans.identity import identity
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import AnnulusError, Label

Changed = dict[int, dict[str, Any]]  # by number of the frame


def record(
    path: Path, head: Head, holes: tuple[int, ...] = (), changed: dict[int, dict[str, Any]] | None = None
) -> Path:
    """As the daemon does; `holes`: batches of evidence that are lost."""
    with RecordingWriter(path, calibration={"format": "x"}, configuration={"fps": 25}, now_ns=0) as writer:
        writer.note("/identity", {"utc": "2026-11-22T06:00:00+00:00", "job": {"where": "Elm Street"}}, 1)
        for number, header in enumerate(head.headers):
            label = {**header.to_dict(), **(changed or {}).get(number, {})}
            image = np.full((header.height, header.width), number % 251, np.uint8)
            if number % 11:  # the others the recorder had no room for
                writer.frame(label, image, header.timestamp_ns)
        for first in range(0, len(head.rows), 100):
            if first // 100 not in holes:
                writer.note("/evidence", {"first": first, "rows": head.rows[first : first + 100]}, first)
    return path


@pytest.fixture
def head() -> Head:
    head = Head(5)
    head.begin()
    head.run(0, 400)
    return head


def labels(recording: Recording) -> list[tuple[int, int, Label, float]]:
    return [(frame.index, frame.camera, frame.label, frame.z_mm) for frame in recording.frames]


def test_a_recording_of_which_nothing_is_wrong_audits_clean(head: Head, tmp_path: Path) -> None:
    found = audit(record(tmp_path / "a.mcap", head))
    assert (found.frames, found.changed, found.without_evidence, found.missing) == (len(head.headers), 0, 0, 0)


def known(headers: list[FrameHeader]) -> list[int]:
    return [n for n, header in enumerate(headers) if header.label is not Label.UNKNOWN and n % 11]


@pytest.mark.deep(gate="tests/unit/labelling/test_relabel.py::test_a_recording_of_which_nothing_is_wrong_audits_clean")
def test_a_label_or_a_place_that_does_not_follow_is_found_and_mended(head: Head, tmp_path: Path) -> None:
    lamp, place, hidden = known(head.headers)[100:103]
    other = {"label": "led" if head.headers[lamp].label is Label.PROJECTOR else "projector"}
    z_mm = head.headers[place].z_mm
    assert z_mm is not None
    wrong = {lamp: other, place: {"z_mm": z_mm + 7.0}, hidden: {"z_assumed": not head.headers[hidden].z_assumed}}
    path = record(tmp_path / "a.mcap", head, changed=wrong)
    before = path.read_bytes()
    found = audit(path)
    assert found.changed == 3
    assert {(row["what"], row["frames"]) for row in found.to_dict()["changes"]} <= {("label", 1), ("place", 1)}
    relabel(path, tmp_path / "b.mcap")
    assert path.read_bytes() == before
    mended, honest = open_recording(tmp_path / "b.mcap"), open_recording(record(tmp_path / "c.mcap", head))
    assert sum(a != b for a, b in zip(labels(mended), labels(honest), strict=True)) <= 8  # those that now had time
    for frame, same in zip(mended.frames, honest.frames, strict=True):
        assert np.array_equal(mended.read_raw(frame)[0], honest.read_raw(same)[0])
        assert frame.label in (same.label, frame.label if same.label is Label.UNKNOWN else None)
    assert mended.calibration == {"format": "x"} and audit(tmp_path / "b.mcap").changed == 0
    assert [note["job"] for note in mended.notes("/identity")] == [{"where": "Elm Street"}]


def test_frames_whose_evidence_is_lost_become_unknown(head: Head, tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", head, holes=(7,))
    found = relabel(path, tmp_path / "b.mcap")
    assert found.missing == 100 and 5 < found.without_evidence < 60
    mended = open_recording(tmp_path / "b.mcap")
    reasons = [mended.label(frame)["reason"] for frame in open_recording(path).frames]
    assert 0 < reasons.count("no evidence") <= found.without_evidence


def test_without_evidence_there_is_one_clear_line(tmp_path: Path) -> None:
    path = tmp_path / "old.mcap"
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        label = {"index": 0, "label": "led", "z_mm": 1.0, "encoding": "mono8", "width": 4, "height": 4}
        writer.frame(label, np.zeros((4, 4), np.uint8), 5)
    with pytest.raises(AnnulusError, match="no evidence"):
        audit(path)
    with pytest.raises(AnnulusError, match="no evidence"):
        relabel(path, tmp_path / "new.mcap")
    assert sorted(tmp_path.iterdir()) == [path]
    assert identity(path)["evidence"] is False


def test_what_is_there_is_not_overwritten(head: Head, tmp_path: Path) -> None:
    path = record(tmp_path / "a.mcap", head)
    with pytest.raises(AnnulusError, match="there already"):
        relabel(path, path)


def test_an_audit_tells_programs_and_people(
    head: Head, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    number = known(head.headers)[50]
    path = record(tmp_path / "a.mcap", head, changed={number: {"label": "unknown", "reason": "driver count disagrees"}})
    monkeypatch.setattr("sys.argv", ["annulus", "record", "relabel", str(path), "--audit"])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 1 and "driver count disagrees -> agreed" in capsys.readouterr().out
    monkeypatch.setattr("sys.argv", ["annulus", "record", "info", str(path), "--json"])
    with pytest.raises(SystemExit):
        main()
    assert json.loads(capsys.readouterr().out)["job"] == {"site": "Elm Street"}
