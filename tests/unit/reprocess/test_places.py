"""Promises about places that nobody counted: they are said, never merged in silence."""

from annulus_pipe.reprocess.places import place_findings
from annulus_pipe.scans.scan import ScanFrame
from annulus_pipe.vocabulary import Label


def frame(index: int, z_mm: float, bound_mm: float = 0.0, segment: int = 0, label: Label = Label.LED) -> ScanFrame:
    return ScanFrame(index, label, z_mm, "", None, 0, bound_mm, segment)


def test_a_scan_that_was_counted_throughout_has_no_finding() -> None:
    frames = [frame(0, 0.0), frame(1, float("nan"), label=Label.UNKNOWN), frame(2, 2.0)]
    assert place_findings(frames) == []


def test_assumed_places_and_what_does_not_hang_together_are_named() -> None:
    frames = [frame(0, 0.0), frame(1, 5.0, 80.0, 1), frame(2, 6.0, 80.5, 1), frame(3, 0.0, 0.0, 2)]
    assumed, segments = place_findings(frames)
    assert (assumed.kind, assumed.frames) == ("place_assumed", (1, 2))
    assert assumed.text.startswith("place assumed from 0.005 to 0.006 m, ± 0.081 m")
    assert (segments.kind, segments.frames) == ("place_segments", (1, 3))
    assert "3 segments, begun anew at frame 1 at 0.005 m, frame 3 at 0.000 m" in segments.text
