"""A recording with another file's bytes behind its end was called whole, and one that is torn was exported as if it
were not."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from annulus_pipe.cli.app import app
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.reprocess.places import incomplete_findings
from annulus_pipe.scans.scan import open_scan

FRAMES, H, W = 6, 24, 32


def written(path: Path, frames: int = FRAMES) -> bytes:
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=5_000) as writer:
        for index in range(frames):
            label = {
                "index": index,
                "label": "projector",
                "reason": "",
                "slot": 0,
                "z_mm": 2.5 * index,
                "encoding": "mono8",
                "width": W,
                "height": H,
                "timestamp_ns": 10_000 * index,
            }
            writer.frame(label, np.random.default_rng(index).integers(0, 255, (H, W), np.uint8), 10_000 * index)
            writer.flush()
    return path.read_bytes()


def run(*words: str) -> tuple[int, str, str]:
    done = CliRunner().invoke(app, ["record", *words])
    return done.exit_code, done.stdout, done.stderr


@pytest.mark.parametrize("what", ["twice", "junk", "zeros", "one byte", "another"])
def test_what_lies_behind_the_end_is_damage(tmp_path: Path, what: str) -> None:
    whole = written(tmp_path / "rec.mcap")
    assert run("verify", str(tmp_path / "rec.mcap"))[0] == 0
    behind = {
        "twice": whole,
        "junk": b"junk" * 1000,
        "zeros": bytes(4096),
        "one byte": b"\n",
        "another": written(tmp_path / "other.mcap", 40),
    }[what]
    (tmp_path / "both.mcap").write_bytes(whole + behind)
    scan = str(tmp_path / "both.mcap")
    opened = open_recording(scan)
    assert len(opened.frames) == FRAMES and not opened.torn
    told = f"{len(behind)} bytes behind its end"
    assert [told in one.text for one in opened.damage] == [True] and opened.damage[0].offset == len(whole)
    (finding,) = incomplete_findings(open_scan(scan))
    assert told in finding.text
    status, out, _ = run("verify", scan)
    assert status == 1 and told in out and "6 frames, 1 places damaged" in out
    for words in (["recover", scan, "-o", str(tmp_path / "new.mcap")], ["export", scan, "-o", str(tmp_path / "new")]):
        status, _, err = run(*words)
        assert status == 1 and told in err


@pytest.mark.parametrize("to", ["folder", "new.mcap"])
def test_an_export_of_what_is_torn_or_damaged_says_so(tmp_path: Path, to: str) -> None:
    whole = written(tmp_path / "rec.mcap")
    assert run("export", str(tmp_path / "rec.mcap"), "-o", str(tmp_path / f"sound-{to}"))[0] == 0
    chunk = open_recording(tmp_path / "rec.mcap").frames[3].chunk
    assert chunk is not None
    flipped = bytearray(whole)
    flipped[chunk.offset + chunk.length // 2] ^= 1
    for name, content, frames, torn in (("cut", whole[: len(whole) // 2], 0, True), ("bad", flipped, 5, False)):
        scan = tmp_path / f"{name}.mcap"
        scan.write_bytes(content)
        status, out, err = run("export", str(scan), "-o", str(tmp_path / f"{name}-{to}"), "--json")
        told = json.loads(out)
        assert status == 1 and told["torn"] is torn and told["frames"] >= frames
        assert (tmp_path / f"{name}-{to}").exists()
        assert all(line.startswith(f"annulus: {scan}: ") for line in err.splitlines() if "━" not in line)
        assert ("was not closed" if torn else "wrong checksum") in err
