"""A loss whose floor was not seen is a lower limit wherever its depth is printed."""

import pytest

from annulus_pipe.cli.summary import print_summary
from annulus_pipe.report.page import _depth
from annulus_pipe.wall.defects import Defect, Kind


def test_a_lower_limit_says_so(capsys: pytest.CaptureFixture[str], tmp_path) -> None:
    loss = {
        "kind": "loss",
        "depth_mm": 0.55,
        "depth_k2_mm": 0.14,
        "z_mm": 140.0,
        "clock": "12:30",
        "length_mm": 4.0,
        "arc_deg": 13.0,
        "hidden_mm": 0.0,
    }
    summary = {
        "frames": {"projector": 24},
        "diameter_mm": {"mean": None},
        "points": 9,
        "features": [],
        "undecided": [],
        "warnings": [],
        "not_seen": [],
        "defects": [{**loss, "floor_seen": False}, {**loss, "floor_seen": True}],
    }
    print_summary(summary, tmp_path)
    said = capsys.readouterr().out
    assert "loss       ≥ 0.55 ± 0.14 mm at 0.140 m, clock 12:30" in said
    assert said.count("≥") == 1
    told = Defect(Kind.LOSS, 140.0, 15.0, 4.0, 13.0, 0.55, 20.0, False, 0.14)
    assert _depth(told) == "≥ 0.55 ± 0.14 mm"
