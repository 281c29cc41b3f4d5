"""A designed slide of fringes as files: what to expose on film, to scale, and the calibration to begin with."""

import json
from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import RingSlide

INCH_MM = 25.4
DPI = (2540, 5080, 10160)  # of film recorders; the first that gives the finest period so many pixels
PIXELS_A_PERIOD = 16
BORDER = 1.1  # of the pattern's radius: black around it, or light passes beside it
SIDE_MAX = 8000  # pixels


def write_ring_slide(slide: RingSlide, folder: Path) -> list[Path]:
    """slide.png: grey wedge, linear in transmission, to scale by its dpi in slide.json; bars.png: the same as bars;
    calibration.json: the pattern's section. Returns what was written."""
    side_mm = 2 * BORDER * slide.outer_mm
    wanted = [dpi for dpi in DPI if slide.finest_mm * dpi / INCH_MM >= PIXELS_A_PERIOD]
    dpi = min(float(wanted[0] if wanted else DPI[-1]), SIDE_MAX / side_mm * INCH_MM)
    side = round(side_mm * dpi / INCH_MM)
    place = (np.arange(side) - (side - 1) / 2) * INCH_MM / dpi
    radius = np.hypot(place[:, None], place[None, :])
    projector = slide.projector
    section = {
        "kind": "rings",
        "centre_mm": list(projector.centre_mm),
        "rotation": [list(row) for row in projector.rotation],
        "period_mm": projector.period,
        "nominal_radius_mm": projector.nominal_radius_mm,
        "phase0": projector.phase0,
    }
    design = {
        "dpi": dpi,
        "inner_mm": slide.inner_mm,
        "outer_mm": slide.outer_mm,
        "focal_mm": slide.focal_mm,
        "defocus_mm": slide.defocus_mm,
        "transmission": "linear: grey 255 is clear, 0 is black",
    }
    pattern = {"pattern": {"kind": "fringe", "projector": section, "design": design}}
    out = [folder / name for name in ("slide.png", "bars.png", "slide.json", "calibration.json")]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        grey = np.round(255 * slide.transmission(radius)).astype(np.uint8)
        bars = np.where(slide.is_dark(radius), 0, 255).astype(np.uint8)
        for path, image in zip(out, (grey, bars), strict=False):
            path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
        out[2].write_text(json.dumps(design, indent=1) + "\n")
        out[3].write_text(json.dumps(pattern, indent=1) + "\n")
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be written ({error.strerror}).") from None
    return out
