"""`annulus calibrate fringe` of a slide of rings: the projector from frames of a clean pipe, the head shifted sideways.

A reference scan is a scan folder whose frames.csv has `tx_mm` and `ty_mm`: how far the head stood right and down of
where it began. The slide's design is where the search begins: `pattern.projector` of a calibration.json, as
`annulus pattern design --fringe` writes it.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.geometry.calibration import STILL, camera_to_dict
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_part, load_sections, update_calibration
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wings.fringe.measure import (
    CleanPipeFit,
    FringeHead,
    Shots,
    Transfer,
    calibrate_pipe,
    light_of,
    projector_to_dict,
)
from annulus_pipe.wings.fringe.measure.projector import AXIAL, BENDS, LAW, FringeProjector

Progress = Callable[[str, int, int], None]

FRAMES_MAX = 32  # held at once, 5 MB a frame of a Mpixel
BARREL_KNOWN = 0.005  # as on a plate
MISFIT_MAX = 0.25  # of half the brightest light, the fringes' swing; test_fringe_pipe
BRIGHTEST = 97.0  # percentile


@dataclass(frozen=True, slots=True)
class FringePipeCalibration:
    """The head with its projector, how well that is known, and the camera's curve as it was used."""

    head: FringeHead
    found: CleanPipeFit
    curve: Transfer
    curve_stated: bool

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; mm, degrees and rad."""
        slide, sigma = self.head.projector or self.found.projector, self.found.sigma
        return {
            "projector": projector_to_dict(slide),
            "sigma": {
                "centre_mm": [float(one) for one in sigma[:3]],
                "tilt_deg": [math.degrees(one) for one in sigma[3:5]],
                "phase0": float(sigma[5]),
                "period_mm": float(sigma[6]) * slide.period,
                "harmonics": [float(one) for one in sigma[LAW:]],
                **({"distortion": [float(one) for one in sigma[AXIAL : AXIAL + BENDS]]} if slide.distortion else {}),
                **({"mirror_mm": [float(one) for one in sigma[AXIAL + BENDS : LAW]]} if slide.mirror_mm else {}),
            },
            "barrel": self.found.barrel,
            "barrel_sigma": self.found.barrel_sigma,
            "edge": self.found.edge,
            "covariance": self.found.covariance.tolist(),
            "transfer": self.curve.to_dict(),
            "radius_mm": self.head.radius_mm,
            "misfit_levels": self.found.misfit,
            "frames": self.found.frames,
            "warnings": self.warnings,
        }

    @property
    def warnings(self) -> list[str]:
        """What to look at, a sentence each."""
        text = "tx_mm, ty_mm are where the pipe was before the head, the other way round: taken so"
        found = self.found
        out = [text] if found.reversed else []
        if found.barrel_sigma > BARREL_KNOWN and not found.projector.mirror_mm:
            out.append(
                f"the slide's lens cannot be determined: where the light ends it may distort by "
                f"{200 * found.barrel_sigma:.1f} % (k = 2). Places farther aside tell, or more light in view"
            )
        return out


def calibrate_fringe_pipe(
    scan: Path,
    camera: Path,
    slide: Path | None = None,
    *,
    radius_mm: float | None = None,
    progress: Progress | None = None,
) -> FringePipeCalibration:
    """The projector of the head whose camera is in `camera`, from frames of a clean pipe.

    slide : the file with the design, that of the camera where None. radius_mm : of the pipe; the file's where None.
    Raises AnnulusError, one line, where nothing can be calibrated.
    """
    head = load_part(camera, FringeHead.from_dict, "annulus calibrate camera")
    design = head.projector if slide is None else _design(slide)
    if design is None or design.kind != "rings":
        raise AnnulusError(
            f'{slide or camera}: "pattern.projector" is no slide of rings, expected the calibration.json of '
            "`annulus pattern design` for fringes"
        )
    radius = head.radius_mm if radius_mm is None else radius_mm
    if radius is None:
        raise AnnulusError(f'{camera}: no "pipe.radius_mm", expected there or told: the inner radius of the clean pipe')
    opened = open_scan(scan)
    which = [i for i, frame in enumerate(opened.frames) if frame.label is Label.PROJECTOR]
    if not which:
        raise AnnulusError(f"{scan}: none of its {len(opened.frames)} frames is labelled projector")
    every = sorted({opened.frames[i].index for i in which})
    most = max(FRAMES_MAX // len(head.cameras), 3)
    some = {every[k] for k in np.unique(np.linspace(0, len(every) - 1, min(len(every), most)).astype(int))}
    which = [i for i in which if opened.frames[i].index in some]
    named = head.curve(scan.resolve().name)
    curve = named or Transfer()
    report = progress or (lambda stage, done, total: None)
    known_as = {one.id: number for number, one in enumerate(head.cameras)}
    flash_of = {index: k for k, index in enumerate(sorted({opened.frames[i].index for i in which}))}
    aside, images, eye, flash = np.zeros((len(flash_of), 3)), [], [], []
    for done, i in enumerate(which):
        report("projector", done, len(which) + 1)
        frame = opened.frames[i]
        if frame.aside_mm is None:
            raise AnnulusError(
                f"{scan}: frame {frame.index} has no tx_mm, ty_mm, expected how far right and down the head stood, in "
                "columns of frames.csv"
            )
        images.append(light_of(opened.read(i), head.camera(frame.camera), curve, frame.where))
        eye.append(known_as[frame.camera])
        flash.append(flash_of[frame.index])
        aside[flash[-1], :2] = frame.aside_mm
    report("projector", len(which), len(which) + 1)
    try:
        shots = Shots(np.array(images), np.array(eye), np.array(flash))
        placed = replace(head, projector=design, lamps=()).eyes()
        found = calibrate_pipe([one.camera for one, _, _ in placed], placed[0][0].projector, shots, aside, radius)
    except AnnulusError as error:
        raise AnnulusError(f"{scan}: {error}") from None
    report("projector", len(which) + 1, len(which) + 1)
    off = found.misfit / (float(np.nanpercentile(images, BRIGHTEST)) / 2)
    if off > MISFIT_MAX:
        raise AnnulusError(
            f"{scan}: its frames do not show this slide in a pipe of {radius:g} mm radius: what is left of the fit is "
            f"{off:.2f} of the fringes' swing, expected below {MISFIT_MAX:g}. Another radius or slide, or tx_mm, ty_mm "
            "that are wrong?"
        )
    known = replace(
        head.with_projector(found.projector), radius_mm=radius, transfer=dict(head.transfer) if named else {"": curve}
    )
    return FringePipeCalibration(known, found, curve, named is not None)


def _design(file: Path) -> FringeProjector | None:
    pattern = load_sections(file).get("pattern")
    section = pattern.get("projector") if isinstance(pattern, dict) else None
    if section is None:
        return None
    try:
        return FringeProjector.from_dict(section)
    except ValueError as error:
        raise AnnulusError(f"{file}: {error}") from None


def save_fringe_pipe(result: FringePipeCalibration, path: Path) -> None:
    """Write or replace the head's sections of a calibration.json. Raises AnnulusError when it cannot be written."""
    figures = result.to_dict()
    curves = {name: curve.to_dict() for name, curve in result.head.transfer.items()}
    sections = {
        "cameras": [
            {
                "id": one.id,
                **camera_to_dict(one.camera),
                "rotation": [list(row) for row in one.rotation],
                "translation_mm": list(one.translation_mm),
            }
            for one in result.head.cameras
        ],
        "camera": None,
        "pattern": {
            "kind": "fringe",
            "projector": figures["projector"],
            "sigma": figures["sigma"],
            "covariance": figures["covariance"],
        },
        "transfer": curves.get("", curves),
        "pipe": {
            "radius_mm": result.head.radius_mm,
            "rotation": [list(row) for row in result.head.mount[0]],
            "translation_mm": list(result.head.mount[1]),
        }
        if result.head.mount[0] != STILL
        else {"radius_mm": result.head.radius_mm},
    }
    measured = {key: figures[key] for key in ("misfit_levels", "frames")}
    update_calibration(path, sections, {"pattern": {"by": "annulus calibrate fringe", **measured}})
