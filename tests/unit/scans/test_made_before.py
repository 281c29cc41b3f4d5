"""Every file made before still says what it said: tests/data/before, with what the readers of then said of it."""

import hashlib
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.rings.calibration.reference import Reference
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_calibration, load_part
from annulus_pipe.vocabulary import Label
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wings.tai.acoustic_file import load_acoustic
from annulus_pipe.wings.tai.decode import load_template

BEFORE = Path(__file__).parents[2] / "data" / "before"
EXPECTED = json.loads((BEFORE / "expected.json").read_text())


def digest(values: Any) -> str:
    return hashlib.sha256(np.ascontiguousarray(values).tobytes()).hexdigest()[:16]


def plain(value: Any) -> Any:
    """As JSON gives it back; NaN is null."""
    return json.loads(json.dumps(value), parse_constant=lambda name: {"NaN": None}[name])


def frames_of(recording: Recording) -> list[Any]:
    seen = [(frame, *recording.read_raw(frame)) for frame in recording.frames]
    return plain(
        [[f.index, f.label, f.z_mm, f.timestamp_ns, f.roll_deg, encoding, digest(image)] for f, image, encoding in seen]
    )


def test_a_recording() -> None:
    recording, expected = open_recording(BEFORE / "recording.mcap"), EXPECTED["recording"]
    assert not recording.torn
    assert frames_of(recording) == expected["frames"]
    assert {frame.camera for frame in recording.frames} == {0} and recording.cameras == (0,)
    assert [recording.label(frame) for frame in recording.frames] == expected["labels"]
    assert recording.calibration == expected["calibration"]
    assert recording.configuration == expected["configuration"]
    assert list(recording.notes("/event")) == expected["events"]
    assert list(recording.notes("/telemetry")) == expected["telemetry"]
    profiles = [
        [
            p.frame,
            p.z_mm,
            [p.pose.rx, p.pose.ry, p.pose.tx, p.pose.ty, p.pose.roll],
            p.residual_mm,
            p.lean_sigma_deg,
            len(p.ring),
            *map(digest, (p.points_mm, p.colour, p.ring, p.direction, p.sigma_mm)),
        ]
        for p in map(Profile.from_dict, recording.notes("/profile"))
    ]
    assert plain(profiles) == expected["profiles"]
    scan = open_scan(BEFORE / "recording.mcap")
    assert scan.calibration == Calibration.from_dict(expected["calibration"])
    assert [frame.label for frame in scan.frames][-3:] == [Label.LED, Label.PROJECTOR, Label.UNKNOWN]


def test_a_torn_recording(tmp_path: Path) -> None:
    whole = open_recording(BEFORE / "recording.mcap")
    cut = whole.frames[4].offset + whole.frames[4].length // 2
    (tmp_path / "torn.mcap").write_bytes((BEFORE / "recording.mcap").read_bytes()[:cut])
    torn = open_recording(tmp_path / "torn.mcap")
    assert torn.torn and frames_of(torn) == EXPECTED["recording"]["frames"][:4]
    assert torn.calibration == whole.calibration


def test_a_scan_folder() -> None:
    scan = open_scan(BEFORE / "scan")
    seen = []
    for i, f in enumerate(scan.frames):
        image = scan.read(i)
        seen.append([f.index, f.label, f.z_mm, f.where, f.roll_deg, list(image.shape), float(image.mean())])
    png, jpeg = EXPECTED["scan"]
    assert plain(seen[0]) == png
    assert plain(seen[1][:-1]) == jpeg[:-1] and seen[1][-1] == pytest.approx(jpeg[-1], abs=0.5)  # decoders may round
    assert {frame.camera for frame in scan.frames} == {0}


@pytest.mark.parametrize("name", ["calibration-plain", "calibration-mirror", "calibration-full"])
def test_a_calibration(name: str) -> None:
    read = load_calibration(BEFORE / f"{name}.json")
    camera = asdict(read.camera)
    assert camera.pop("sensor_crop") is None  # nobody wrote it then ..
    assert camera.pop("colour_shift_px") == ()  # .. nor this
    assert (
        plain(
            {
                "camera": camera,
                "colours": read.colours,
                "rings": [asdict(ring) for ring in read.rings],
                "pipe_radius_mm": read.pipe_radius_mm,
                "covariance": read.covariance and digest(np.array(read.covariance)),
                "corrections": read.corrections and [asdict(ring) for ring in read.corrections],
            }
        )
        == EXPECTED[name]
    )
    assert read.only() is read and len(read.cameras) == 1
    again = read.to_dict()
    file = json.loads((BEFORE / f"{name}.json").read_text())
    assert again["format"] == file["format"] and again.keys() == file.keys()
    assert Calibration.from_dict(again).corrections == read.corrections


def test_what_lies_beside_a_calibration() -> None:
    assert plain(asdict(load_part(BEFORE / "colour.json", ColourProfile.from_dict, ""))) == EXPECTED["colour"]
    reference = asdict(load_part(BEFORE / "reference.json", Reference.from_dict, ""))
    reference["offset_rad"] = [digest(np.array(ring)) for ring in reference["offset_rad"]]
    assert plain(reference) == EXPECTED["reference"]


def test_a_template() -> None:
    expected = dict(EXPECTED["template"])
    template = load_template(BEFORE / "template.json")
    assert digest(template.taps) == expected.pop("taps")
    assert plain({key: getattr(template, key) for key in expected}) == expected


@pytest.mark.parametrize("name", ["acoustic.npz", "acoustic.hdf5"])
def test_raw_sound(name: str) -> None:
    expected = dict(EXPECTED[name])
    record = load_acoustic(BEFORE / name)
    assert [list(record.signals.shape), digest(record.signals)] == expected.pop("signals")
    assert (
        plain(
            {key: getattr(record, key) for key in expected if key != "angles_deg"}
            | {"angles_deg": list(record.angles_deg)}
        )
        == expected
    )
    assert not math.isnan(record.t0_s)
