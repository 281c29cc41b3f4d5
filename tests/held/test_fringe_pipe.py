"""The ray-traced pipe before a fisheye and a slide of rings in series, against its truth (SCENES/fringe-pipe-a)."""

import pytest

from tools.bench.metrology.fringe_pipe import PIPE, judged

pytestmark = [pytest.mark.skipif(not PIPE.is_dir(), reason="needs ../shared/scenes")]


def test_the_pipe() -> None:
    """From a design that is millimetres off, calibrated by the clean pipe; the exact projector is not used."""
    one = judged()
    assert one.centre_mm < 3 * one.calibrated.sigma[:3].max() < 0.3
    assert one.calibrated.reversed  # the scene tells where the pipe was, not the head
    score = one.score
    assert score["rms_mm"] <= 0.035
    assert score["rms_before_alignment_mm"] <= 0.040
    assert score["completeness"] >= 0.97
    assert score["defects_found"].startswith("13 of 13")
    # 11 asked; a groove 2 mm wide and 1 deep has its floor in the dark, and is told as a lower limit
    assert sum(bool(d.get("measured")) for d in score["defects"]) >= 12
    assert 0.93 <= one.covered <= 0.98
    assert len(one.defects) == 13
    assert sum(not d.floor_seen for d in one.defects) == 1
    narrow = {round(d["width_mm"], 1): d for d in score["defects"] if d["kind"] == "pocket" and d["true_mm"] < 0.4}
    assert abs(narrow[1.5]["measured_mm"] - 0.3) < 0.04  # its cells alone read 0.19
