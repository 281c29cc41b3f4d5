"""Nested values and numbers of thousands of digits in files were a RecursionError, an OverflowError, a TypeError, and
14 s for 40 kB of dots. Fails where the readers call json.loads, tomllib.loads and msgpack.unpackb themselves."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from annulus_pipe.daemon.config import load_config
from annulus_pipe.record.recording import open_recording
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.decode import load_template

JSON = (
    b"[" * 100_000,
    b'{"a":' * 5000,
    b"9" * 5000,
    b'{"format": ["x"]}',
    b'{"format": ' + b"9" * 400 + b"}",
    b"[NaN]",
)
TOML = (
    b"camera = " + b"[" * 60_000,
    b"[camera]\nwidth = 0x" + b"f" * 6000,
    b"[camera]\nwidth = " + b"9" * 5000,
    b"[camera]\ngain = 1e999",
    b"a." * 20_000 + b"a = 1",
    b"[controller]\nport = {a = [1]}",
)


@pytest.mark.parametrize(
    "load, data",
    [*((load_calibration, d) for d in JSON), *((load_template, d) for d in JSON), *((load_config, d) for d in TOML)],
)
def test_a_file_is_refused_in_one_line(load: Callable[[Path], Any], data: bytes, tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(data)
    with pytest.raises(AnnulusError) as caught:
        load(tmp_path / "file")
    assert len(str(caught.value)) <= 500 and "\n" not in str(caught.value)


@pytest.mark.parametrize("z", ["9" * 400, "[" * 5000, '{"base64": 5}', '"x"', "1e999", "1e300"])
@pytest.mark.parametrize("light", ['"led"', "[]", "{}"])
def test_a_label_that_says_anything_is_no_label(z: str, light: str, tmp_path: Path) -> None:
    data = f'{{"index":0,"label":{light},"z_mm":{z}}}'.encode()
    path = tmp_path / "scan.mcap"
    with RecordingWriter(path, calibration=None, configuration={}, now_ns=0) as writer:
        writer.note("/label", {"index": 0}, 0)
        writer._add("/label", data, 0, 0)
        writer._add("/frame/0", bytes(3), 0, 0, "/frame")
    (frame,) = open_recording(path).frames
    assert frame.label == "unknown" and json.dumps(frame.z_mm) == "NaN"
