"""What a report states of a head is its certificate's own words, or that nothing is established."""

import json
from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest

from annulus_pipe.numeric.rounding import two_digits_up
from annulus_pipe.qualification.applicability import Applicability, HeadInUse
from annulus_pipe.qualification.pod import pod_json
from annulus_pipe.qualification.quoting import Qualification
from annulus_pipe.vocabulary import AnnulusError
from tests.unit.qualification.known_heads import CONDITIONS, made, signed_file
from tests.unit.qualification.test_pod import study

USE = HeadInUse("7", CONDITIONS.calibration, CONDITIONS.firmware, CONDITIONS.software, 152.5, 15.0, date(2027, 3, 1))


def test_without_a_file_nothing_is_established() -> None:
    stated = Qualification().quoted(USE, anchored=False)
    assert stated.accuracy.line == "not established" and stated.percent is None
    assert [one.text for _, one in stated.rows] == ["not established"] * 2


def test_a_certificate_is_quoted_where_it_applies(tmp_path: Path) -> None:
    files, accuracy = Qualification.read(signed_file(tmp_path)), made().accuracy
    drifting, anchored = (files.quoted(USE, anchored=one) for one in (False, True))
    assert drifting.accuracy.standing is Applicability.APPLIES
    assert (drifting.percent, anchored.percent) == (accuracy.U_drift, accuracy.U)
    assert f"± {two_digits_up(accuracy.U)} % in 19 of 20" in anchored.accuracy.text
    assert anchored.accuracy.source == f"certificate {made().number} of laboratory, 2026-11-29 to 2027-11-29"


def test_where_it_does_not_apply_its_numbers_are_not_there(tmp_path: Path) -> None:
    files = Qualification.read(signed_file(tmp_path))
    stated = files.quoted(replace(USE, head="8"), anchored=True)
    assert stated.accuracy.text == "not established: it is of head 7, and this is 8" and stated.percent is None
    unknown = files.quoted(replace(USE, temperature_c=None), anchored=True)
    assert (
        unknown.accuracy.standing is Applicability.OPEN
        and "(if it is so: the scan has no temp" in unknown.accuracy.line
    )


def test_a_recording_carries_it_and_a_changed_one_vouches_for_nothing(tmp_path: Path) -> None:
    files = Qualification.read(signed_file(tmp_path))
    carried = json.loads(json.dumps(files.to_dict()))
    assert Qualification.recorded(carried) == files
    carried["certificate"]["content"]["accuracy"]["U"] /= 10
    assert Qualification.recorded(carried) == Qualification()
    for junk in (None, 7, {"certificate": 7}, {"certificate": {"content": {}}}, {"certificate": {"format": b"x"}}):
        assert Qualification.recorded(junk) == Qualification()


def test_a_study_of_detection_is_quoted_kind_by_kind(tmp_path: Path) -> None:
    file = tmp_path / "pod.json"
    file.write_text(pod_json(study()))
    files = Qualification.read(pod=file)
    use = HeadInUse("7", software="0.9", diameter_mm=150.0)
    stated = dict(files.quoted(use, anchored=False).detection)
    assert list(stated) == ["detection of loss", "detection of bump", "false calls"]
    assert stated["detection of bump"].text == "a90/95 not established (bumps): none was laid"
    assert stated["detection of loss"].text.startswith("a90/95 0.") and "ASTM E2862" in stated["detection of loss"].text
    other = dict(files.quoted(replace(use, head="8"), anchored=False).detection)
    assert {one.text for one in other.values()} == {"not established: it is of head 7, and this is 8"}
    assert Qualification.recorded(json.loads(json.dumps(files.to_dict()))).quoted(
        use, anchored=False
    ).detection == tuple(stated.items())
    both = Qualification.read(signed_file(tmp_path)).over(files)
    assert both.pod is files.pod and both.certificate is not None
    assert Qualification.recorded({"pod": {"format": 7}}) == Qualification()


def test_what_stands_before_a_scan(tmp_path: Path) -> None:
    files = Qualification.read(signed_file(tmp_path))
    assert files.state(USE) == (Applicability.APPLIES, f"{made().number}, until 2027-11-29")
    assert "it lapsed on 2027-11-29" in files.state(replace(USE, day=date(2028, 1, 1)))[1]
    assert Qualification().state(USE)[0] is None


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (None, "cannot be read"),
        (b"", "not JSON"),
        (b"\x00\xff" * 100, "not a text file"),
        (b"{}", "its format is"),
        (b"[" * 100_000, "nested deeper"),
    ],
)
def test_what_is_no_certificate_is_refused_in_one_line(tmp_path: Path, content: bytes | None, line: str) -> None:
    file = tmp_path / "certificate.json"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(AnnulusError, match=line) as refused:
        Qualification.read(file)
    assert str(refused.value).startswith(str(file)) and "\n" not in str(refused.value)
