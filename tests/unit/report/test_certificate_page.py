"""A certificate as people read it: its page."""

from datetime import date

import numpy as np

from annulus_pipe.qualification.plan import ReferencePiece, StudyPlan, planned
from annulus_pipe.qualification.study import Conditions, GaugeReading, certified
from annulus_pipe.report.certificate_page import certificate_page


def test_what_is_small_is_no_zero() -> None:
    """A simulated head repeats to 0.0005 %: a page that says 0.000 % says that it has no error."""
    pieces = (ReferencePiece("A", 148.0, 0.03), ReferencePiece("B", 152.4, 0.03))
    plan = StudyPlan("small", "7", "", ("Ames", "Bose"), 2, pieces)
    rng = np.random.default_rng(1)
    readings = []
    for run in planned(plan):
        piece = pieces["AB".index(run.piece)]
        read = piece.diameter_mm * (1 + rng.normal(-0.18, 0.0005) / 100)
        readings.append(GaugeReading(run, piece, read, 0.4, 0.2, 40, 0.36, "0" * 12))
    page = certificate_page(certified(plan, readings, Conditions(), date(2026, 11, 29)))
    assert "0.000 %" not in page and "0.000 to" not in page and "-0.18" in page
