"""The ray-traced pipe before a fisheye and a slide of rings in series, against its truth (SCENES/fringe-pipe-a)."""

import pytest

from tools.bench.metrology.fringe_pipe import PIPE, judged

pytestmark = pytest.mark.skipif(not PIPE.is_dir(), reason="needs ../shared/scenes")


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
    # 11 asked: three narrow grooves across the line of sight read short, and are told as lower limits
    assert sum(bool(d.get("measured")) for d in score["defects"]) >= 10
    assert 0.93 <= one.covered <= 0.98
    assert len(one.defects) == 13
    shallow = min(one.defects, key=lambda d: d.depth_mm)  # 1.5 mm wide and 0.3 deep
    assert not shallow.floor_seen
