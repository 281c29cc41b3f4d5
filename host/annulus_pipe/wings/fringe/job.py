"""A scan under a slide of fringes before a plate, opened: what belongs together, and whether it can be measured.

What frames must show of the slide is not looked at here; `check_order` is for the first frames once they are read.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.scans.scan import Scan, open_scan
from annulus_pipe.storage.calibration_file import load_part
from annulus_pipe.storage.place import Where
from annulus_pipe.vocabulary import AnnulusError, Finding, Label
from annulus_pipe.wings.fringe.measure import FringeHead, FringeProjector, FringeView, Points, Transfer, told_elsewhere

By = Literal["slide", "cameras"]  # what says how high a point is: its phase, or where two cameras' phases agree
Box = tuple[tuple[float, float], tuple[float, float]]  # least and most x, y, mm

CELL_PX = 1.5  # of the wall's grid: what the lens's blur leaves to be told apart
COARSE = 4  # cells
DRIFT = 0.1  # share by which a point's light may change along half a track: the lens's shading
FLASH_MM = 0.05  # cameras of one flash stand no farther apart
SHIFT_MIN = 0.1  # least singular value of DC and wave over the frames, of 1: less and they cannot be told apart
SHIFT_LEAST_RAD = 0.5  # over the scan: three frames less apart than that are one


@dataclass(frozen=True, slots=True)
class FringeJob:
    """A scan with what its frames need. curve : how its grey levels came from light;
    None where the calibration does not say."""

    scan: Scan
    head: FringeHead
    projector: FringeProjector
    distance_mm: float
    curve: Transfer | None
    flashes: tuple[tuple[float, dict[int, int]], ...]  # x_mm, and the scan's frame number by camera
    findings: tuple[Finding, ...]
    by: By = "slide"
    refuses: Mapping[str, str] = field(default_factory=dict)  # see hooks.WingJob


def open_fringe(scan: Where, calibration: Where, by: By = "slide") -> FringeJob:
    """by : "cameras" takes the slide for no more than a mark on the wall: its period, axis and place as it was designed
    will do, its phase is not used. AnnulusError, one line, for what is missing, damaged or does not belong together."""
    head = load_part(calibration, FringeHead.from_dict, "annulus calibrate fringe")
    if by == "cameras":
        _check_pair(head, calibration)
    if head.projector is None:
        raise AnnulusError(f'{calibration}: has no "pattern.projector". Make it with `annulus calibrate fringe`.')
    if head.distance_mm is None:
        raise AnnulusError(f'{calibration}: has no "distance_mm" of a plate. Make it with `annulus calibrate fringe`.')
    opened = open_scan(scan)
    strange = [number for number in opened.cameras if number not in {one.id for one in head.cameras}]
    if strange:
        head.camera(strange[0])
    flashes = _flashes(opened)
    _check_motion(opened, head, head.projector, head.distance_mm, flashes)
    findings = []
    if by == "cameras" and sum(len(frames) == len(head.cameras) for _, frames in flashes) < 3:
        raise AnnulusError(f"{scan}: fewer than 3 flashes have a frame of both cameras, which are to find the heights")
    for one in head.cameras:
        lost = [k for k, (_, frames) in enumerate(flashes) if one.id not in frames]
        if lost:
            text = f"camera {one.id} has no frame of {len(lost)} of {len(flashes)} flashes: measured without it there"
            findings.append(Finding("camera-missing", text))
    curve = head.curve(name_of(scan))
    refuses = refused(calibration) | dict.fromkeys(("job", "limits"), f"{scan}: a plate has no report of a pipe")
    return FringeJob(opened, head, head.projector, head.distance_mm, curve, flashes, tuple(findings), by, refuses)


def refused(named: Where) -> dict[str, str]:
    """Options that go with no scan under fringes. named : what says that it is one."""
    return dict.fromkeys(("colour", "reference", "vibration_filter"), f"{named}: its head projects fringes")


def name_of(scan: Where) -> str:
    """By which a calibration knows a scan's transfer curve."""
    return scan.resolve().name if isinstance(scan, Path) else str(scan).rstrip("/").rpartition("/")[2]


def _check_pair(head: FringeHead, calibration: Where) -> None:
    """AnnulusError where heights cannot be found by two cameras."""
    if len(head.cameras) != 2:
        count = f"{len(head.cameras)} camera{'s' if len(head.cameras) > 1 else ''}"
        raise AnnulusError(f"{calibration}: has {count}, expected two for heights by cameras")
    if head.projector is None:
        raise AnnulusError(
            f'{calibration}: has no "pattern.projector", expected the slide as it was designed: kind, centre_mm, '
            "rotation, period. Heights by cameras need no more of it."
        )
    if head.projector.kind != "stripes":
        raise AnnulusError(f"{calibration}: has a slide of {head.projector.kind}, in a pipe, expected stripes, a plate")


def _flashes(scan: Scan) -> tuple[tuple[float, dict[int, int]], ...]:
    by_index: dict[int, dict[int, int]] = {}
    for i, frame in enumerate(scan.frames):
        if frame.label is not Label.PROJECTOR:
            continue
        if frame.x_mm is None:
            raise AnnulusError(
                f"{scan.path}: frame {frame.index} has no x_mm, expected where the stage stood, in a column x_mm of "
                "frames.csv"
            )
        by_index.setdefault(frame.index, {})[frame.camera] = i
    out = []
    for index, frames in by_index.items():
        places = [x for i in frames.values() if (x := scan.frames[i].x_mm) is not None]
        if max(places) - min(places) > FLASH_MM:
            raise AnnulusError(
                f"{scan.path}: index {index}: x_mm is {min(places):g} and {max(places):g}, expected one flash"
            )
        out.append((places[0], frames))
    return tuple(out)


def _check_motion(
    scan: Scan, head: FringeHead, slide: FringeProjector, distance_mm: float, flashes: Sequence[tuple[float, object]]
) -> None:
    """AnnulusError where the frames are too few, or no phase moved between them."""
    if len(flashes) < 3:
        raise AnnulusError(
            f"{scan.path}: {len(flashes)} flashes with the projector, expected at least 3: phase, DC and AC of a point"
        )
    x = np.array([place for place, _ in flashes])
    if not np.ptp(x) > 0:
        raise AnnulusError(
            f"{scan.path}: x_mm is {x[0]:g} throughout: the head did not move, nothing shifted the phase"
        )
    ahead = np.array(slide.centre_mm) * [1, 1, 0] + [0, 0, distance_mm]
    if slide.kind == "stripes" and not (np.array(slide.rotation)[2] @ (ahead - np.array(slide.centre_mm))) > 0:
        raise AnnulusError(
            f'calibration: the slide at {slide.centre_mm[2]:g} mm ("pattern.projector") does not shine on the plate at '
            f"{distance_mm:g} mm: expected the plate before it"
        )
    phase = slide.phase(ahead - (x - x[0])[:, None] * np.array(head.motion))
    if np.ptp(phase) < SHIFT_LEAST_RAD:
        raise AnnulusError(
            f'{scan.path}: {np.ptp(x):g} mm along "motion" of the calibration shift the fringes by {np.ptp(phase):.2g} '
            "rad: expected a motion across the stripes, of a period or so"
        )
    matrix = np.stack([np.ones(len(x)), np.cos(phase), np.sin(phase)], axis=1) / math.sqrt(len(x))
    if np.linalg.svd(matrix, compute_uv=False)[-1] < SHIFT_MIN:
        period = 2 * np.pi / abs(float(np.polyfit(x, phase, 1)[0]))
        raise AnnulusError(
            f"{scan.path}: its {len(x)} flashes shift the fringes by whole periods ({period:.2f} mm "
            "a period on the plate): expected steps of a third to a quarter period, or uneven ones"
        )


def check_order(
    job: FringeJob, taken: Sequence[tuple[HeadCamera, Float32Array, FloatArray]], boxes: Sequence[Box]
) -> None:
    """AnnulusError where two cameras see one texture only if the plate stands whole fringes from where it was told."""
    if len(taken) < 2:
        return
    step = COARSE * cell_mm(job)
    both = [(max(a[k][0] for a in boxes[:2]), min(a[k][1] for a in boxes[:2])) for k in (0, 1)]
    points = Points.plate(np.arange(*both[0], step), np.arange(*both[1], step), job.distance_mm)
    if not len(points.base):
        return
    views = [
        (FringeView.of(one, job.projector, x[:, None] * np.array(job.head.motion)), images)
        for one, images, x in taken[:2]
    ]
    if (elsewhere := told_elsewhere(views, points, drift_sigma=DRIFT)) is not None:
        height, there, here = elsewhere
        raise AnnulusError(
            f"{job.scan.path}: the plate stands about {job.distance_mm - height:.4g} mm away, the calibration's "
            f'"distance_mm" is {job.distance_mm:g}, whole fringes off: there its cameras see one texture (correlation '
            f"{there:.2f}), as told they do not ({here:.2f})"
        )


def cell_mm(job: FringeJob) -> float:
    """Of the grid: what CELL_PX pixels of the first camera see of the plate, to two digits."""
    camera = job.head.cameras[0].camera
    return float(f"{CELL_PX * job.distance_mm / max(camera.fx, camera.fy):.2g}")
