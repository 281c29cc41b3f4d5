"""`annulus calibrate fringe`: a slide of stripes, and its waveform, from frames of a plain plate at known heights.

A reference scan is a scan folder whose frames.csv has `height_mm`: how far the plate stood towards the head from where
it stands at `distance_mm`. The camera's curve is taken from the file's "transfer"; where it says none, grey levels are
taken as linear, and a gamma that the waveform shows is taken out and written.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.geometry.calibration import camera_to_dict
from annulus_pipe.scans.scan import Scan, open_scan
from annulus_pipe.storage.calibration_file import load_part, update_calibration
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wings.fringe.measure import (
    FringeHead,
    PlateCalibration,
    ReferencePlate,
    Transfer,
    calibrate_plate,
    lens_names,
    light_of,
    plate_names,
    projector_to_dict,
)

Progress = Callable[[str, int, int], None]

FRAMES_MAX = 32  # spread over the scan; each says all it knows with 150 tiles
GAMMA_SIGMAS, GAMMA_OFF = 4.0, 0.02  # beyond which a gamma is taken out
SAME_RAD = 0.05  # by which cameras may differ on one plate
BARREL_KNOWN = 0.005  # sigma of the distortion at the edge of the light: a barrel of 3 % would stand out six times
SATURATED_MAX = 0.05  # share of the tiles' light


@dataclass(frozen=True, slots=True)
class FringeCalibration:
    """What was found, how well, and what to look at. curve : of the camera, as used; curve_stated : whether the
    file has it."""

    head: FringeHead
    found: PlateCalibration
    curve: Transfer
    curve_stated: bool
    frames: int
    heights_mm: tuple[float, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; mm, degrees and rad."""
        found = self.found
        names = (*plate_names, *lens_names)[: len(found.sigma)]
        sigma = dict(zip(names, (float(one) for one in found.sigma), strict=True))
        lens = {name: sigma[name] for name in lens_names if name in sigma}
        return {
            "projector": projector_to_dict(found.projector),
            "k_rad": float(found.values[4]),
            "sigma": {
                "across_mm": sigma["across_mm"],
                "depth_mm": sigma["depth_mm"],
                "tilt_deg": [math.degrees(sigma["tilt_x"]), math.degrees(sigma["tilt_y"])],
                "period": sigma["rate"] / float(found.values[4]) * found.projector.period,
                "k_rad": sigma["rate"],
                "turn_deg": math.degrees(sigma["turn"]),
                "phase0": sigma["phase0"],
                "harmonics": list(found.harmonics_sigma),
                **lens,
            },
            "barrel": found.barrel,
            "barrel_sigma": found.barrel_sigma,
            "edge": found.edge,
            "modulation": found.modulation,
            "gamma": found.gamma,
            "gamma_sigma": found.gamma_sigma,
            "transfer": self.curve.to_dict(),
            "rms_rad": found.rms_rad,
            "cameras_apart_rad": found.camera_rad,
            "frames": self.frames,
            "tiles": found.tiles,
            "heights_mm": list(self.heights_mm),
            "warnings": list(self.warnings),
        }


def calibrate_fringe(
    scan: Path, camera: Path, *, distance_mm: float | None = None, progress: Progress | None = None
) -> FringeCalibration:
    """The slide of the head whose cameras are in `camera`, from reference frames of a plate.

    distance_mm : of the plate at height 0; the file's where None. Raises AnnulusError, one line, where nothing can be
    calibrated.
    """
    head = load_part(camera, FringeHead.from_dict, "annulus calibrate camera")
    distance = head.distance_mm if distance_mm is None else distance_mm
    if distance is None:
        raise AnnulusError(
            f'{camera}: no "distance_mm", expected there or told: mm from the first camera to the plate at height 0'
        )
    opened = open_scan(scan)
    which = _reference(opened)
    named = head.curve(scan.resolve().name)
    curve = named or Transfer()
    report = progress or (lambda stage, done, total: None)
    found = _calibrated(opened, which, head, distance, curve, lambda done, total: report("plate", done, total))
    if named is None and abs(found.gamma - 1) > max(GAMMA_SIGMAS * found.gamma_sigma, GAMMA_OFF):
        curve = replace(curve, gamma=1 / found.gamma)
        found = _calibrated(
            opened, which, head, distance, curve, lambda done, total: report("plate, gamma out", done, total)
        )
    heights = tuple(sorted({h for i in which if (h := opened.frames[i].height_mm) is not None}))
    curves = dict(head.transfer) if named is not None else {"": curve}
    known = FringeHead(head.cameras, found.projector, head.motion, distance, curves)
    return FringeCalibration(
        known, found, curve, named is not None, len(which), heights, tuple(_warnings(found, distance))
    )


def save_fringe(result: FringeCalibration, path: Path) -> None:
    """Write or replace the head's sections of a calibration.json. Raises AnnulusError when it cannot be written."""
    head, figures = result.head, result.to_dict()
    curves = {name: one.to_dict() for name, one in head.transfer.items()}
    sections = {
        "cameras": [
            {
                "id": one.id,
                **camera_to_dict(one.camera),
                "rotation": [list(row) for row in one.rotation],
                "translation_mm": list(one.translation_mm),
            }
            for one in head.cameras
        ],
        "camera": None,
        "pattern": {
            "kind": "fringe",
            "projector": figures["projector"],
            "k_rad": figures["k_rad"],
            "sigma": figures["sigma"],
            "rms_rad": figures["rms_rad"],
        },
        "transfer": curves.get("", curves),
        "motion": list(head.motion),
        "distance_mm": head.distance_mm,
    }
    measured = {key: figures[key] for key in ("rms_rad", "cameras_apart_rad", "frames", "tiles", "heights_mm", "gamma")}
    update_calibration(path, sections, {"pattern": {"by": "annulus calibrate fringe", **measured}})


def _reference(scan: Scan) -> list[int]:
    which = [i for i, frame in enumerate(scan.frames) if frame.label is Label.PROJECTOR]
    if not which:
        raise AnnulusError(f"{scan.path}: none of its {len(scan.frames)} frames is labelled projector")
    for i in which:
        if scan.frames[i].height_mm is None:
            raise AnnulusError(
                f"{scan.path}: frame {scan.frames[i].index} has no height_mm, expected how far the plate stood towards "
                "the head, in a column height_mm of frames.csv"
            )
    spread = np.unique(np.linspace(0, len(which) - 1, min(len(which), FRAMES_MAX)).astype(int))
    return [which[k] for k in spread]


def _calibrated(
    scan: Scan,
    which: list[int],
    head: FringeHead,
    distance_mm: float,
    curve: Transfer,
    report: Callable[[int, int], None],
) -> PlateCalibration:
    plates = []
    for i in which:
        frame, picture = scan.frames[i], scan.read(i)
        one = head.camera(frame.camera)
        light = light_of(picture, one, curve, frame.where)
        lost = float(np.isnan(light).mean())
        if lost > SATURATED_MAX:
            raise AnnulusError(f"{scan.path}: {100 * lost:.0f} % of {frame.where} is saturated: expose less")
        plates.append(ReferencePlate(light, one, distance_mm - (frame.height_mm or 0.0), frame.where))
    try:
        return calibrate_plate(plates, report)
    except AnnulusError as error:
        raise AnnulusError(f"{scan.path}: {error}") from None


def _warnings(found: PlateCalibration, distance_mm: float) -> list[str]:
    out = []
    if found.camera_rad > SAME_RAD:
        out.append(
            f"the cameras see phases {found.camera_rad:.3f} rad apart on one plate: it does not stand at "
            f"{distance_mm:g} mm, or the cameras do not stand as told"
        )
    if found.barrel_sigma > BARREL_KNOWN:
        out.append(
            f"the slide's lens cannot be determined: where the light ends it may distort by "
            f"{200 * found.barrel_sigma:.1f} % (k = 2). Cameras that see more of the light, or more heights, tell"
        )
    return out
