"""`annulus reconstruct` compiled for a minute before it saw that the calibration is of another size of pictures, or
that no frame is the projector's."""

import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.cli import main
from annulus_pipe.reprocess import whole
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.twin.worlds.pipes import demo_world


@pytest.mark.parametrize("command", ["reconstruct", "reprocess"])
@pytest.mark.parametrize(
    ("light", "told"), [("projector", "but .* is 40x30"), ("led", "none of its 3 frames is labelled projector")]
)
def test_what_is_refused_is_refused_before_anything_is_measured(
    command: str, light: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    calibration = tmp_path / "calibration.json"
    save_calibration(calibration, demo_world().calibration())
    scan = tmp_path / "scan"
    scan.mkdir()
    rows = ["index,file,light,z_mm"]
    for n in range(3):
        cv2.imwrite(str(scan / f"{n}.png"), np.zeros((30, 40, 3), np.uint8))
        rows.append(f"{n},{n}.png,{light},{2 * n}")
    (scan / "frames.csv").write_text("\n".join(rows))
    monkeypatch.setattr(whole, "surveyed", lambda *_, **__: pytest.fail("measures before it has looked"))
    out = tmp_path / "results"
    monkeypatch.setattr(sys, "argv", ["annulus", command, str(scan), "-o", str(out), "--calibration", str(calibration)])
    with pytest.raises(SystemExit) as ended:
        main()
    said = capsys.readouterr()
    assert ended.value.code == 1 and not list(out.glob("scan/*"))
    lines = [line for line in said.err.splitlines() if line.startswith("annulus: ")]
    assert len(lines) == 1
    assert re.search(told, lines[0])
