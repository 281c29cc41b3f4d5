"""The page of a flat wall."""

import json
from pathlib import Path

import numpy as np

from annulus_pipe.report import ScanAccount
from annulus_pipe.wings.fringe.measure.plate import Plate
from annulus_pipe.wings.fringe.plate_page import write_plate


def test_a_plate_of_which_no_height_is_told_says_so(tmp_path: Path) -> None:
    x, y, places = np.arange(30.0), np.arange(20.0), np.arange(4.0)
    nothing = np.full((20, 30), np.nan)
    plate = Plate(
        x,
        y,
        nothing,
        nothing.copy(),
        np.full_like(nothing, 3.0),
        np.zeros_like(nothing),
        np.ones(nothing.shape, bool),
        300.0,
        {"too little light": 600},
        (0, 1, 2, 3),
        places,
        0.01 + 0 * places,
        places,
        (),
        {},
    )
    summary = write_plate(plate, ScanAccount("a dark plate", {"projector": 4}, {}, {}), tmp_path)
    assert summary["height_mm"] == {"min": None, "median": None, "max": None} and summary["points"] == 0
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "of no place could a height be told" in page
    assert json.loads((tmp_path / "summary.json").read_text())["sigma_mm"]["p50"] is None
