"""Whether a scan is one under fringes: asked of every scan, so no physics is imported for it."""

from typing import Literal

from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_sections
from annulus_pipe.storage.place import Where
from annulus_pipe.vocabulary import AnnulusError


def fringes_on(scan: Where, calibration: Where | None) -> Literal["plate", "pipe"] | None:
    """Which wall a scan shows under fringes, by its calibration or the one a recording carries; None under other light.
    Such a scan goes to `plate` or `pipe`, for a height follows from many frames together.

    Raises AnnulusError where a file cannot be read."""
    if calibration is None:
        try:
            known = open_scan(scan).calibration
        except AnnulusError:  # it may be another wing's; if it is nobody's, rings say what is wrong with it
            return None
        return "pipe" if known is not None and known.kind == "fringe" else None
    sections = load_sections(calibration)
    pattern = sections.get("pattern")
    if not isinstance(pattern, dict) or pattern.get("kind", "slits") != "fringe":
        return None
    slide = pattern.get("projector")
    rings = isinstance(slide, dict) and slide.get("kind") == "rings"
    in_pipe = rings or "projectors" in pattern or ("pipe" in sections and "distance_mm" not in sections)
    return "pipe" if in_pipe else "plate"
