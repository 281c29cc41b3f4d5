"""`annulus calibrate pipe` for a head with several cameras: its rings, and where they stand, from one scan of a tube.

Alzuhiri 2022 (§5.3) calibrates the projector with each camera and the cameras with a board. Here one adjustment has all
of it: both cameras see the same rings on the same wall, so the wall is the board.
"""

import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from annulus_pipe.calibrate.both import AGREES, disagreement, placement_from_dict
from annulus_pipe.calibrate.followed import decode_frames, over_exposed
from annulus_pipe.calibrate.pipe import (
    FOLDS,
    FRAMES_MOST,
    HELD_EVERY,
    PipeCalibration,
    advise,
    check_radius,
    refuse,
    warn,
)
from annulus_pipe.calibrate.sample import Progress, projector_frames, sample
from annulus_pipe.geometry.calibration import Calibration, HeadCamera, Vector, head_cameras_from_dict
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.bundle import Solution
from annulus_pipe.rings.calibration.contours import Contours, Look
from annulus_pipe.rings.calibration.cross_validation import hold_out
from annulus_pipe.rings.calibration.observations import Observations, joined, observe
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_part
from annulus_pipe.vocabulary import AnnulusError, first_few

# Of the radius, rms: more is no head. 0.0009 of stereo-calib-a, 0.0011 of a pipe with pockets; 0.014 and 0.017 with
# frames paired with their neighbours', and with the cameras exchanged.
TOGETHER = 0.005


def calibrate_head(scan: Path, camera: Path, radius_mm: float, *, progress: Progress | None = None) -> PipeCalibration:
    """Calibrate from the projector frames of a two-camera scan in a clean round pipe of known radius.

    `camera` has the section cameras, whose placements, if there are any, are not read, and pattern.colours. Where a
    target, seen by both, has said where they stand, the answer is compared with it.
    Raises AnnulusError, one line, where nothing can be found.
    """
    check_radius(radius_mm)
    cameras, colours = load_part(camera, head_cameras_from_dict, "annulus calibrate camera")
    target = load_part(camera, placement_from_dict, "annulus calibrate camera")
    report = progress or (lambda stage, done, total: None)
    marks = {"start": time.process_time()}
    opened = open_scan(scan)
    known = [one.id for one in cameras]
    if sorted(opened.cameras) != sorted(known):
        raise AnnulusError(
            f"{scan}: has frames of cameras {', '.join(map(str, opened.cameras))}, but {camera} is of cameras "
            f"{', '.join(map(str, known))}."
        )
    look = Look.of_slits(colours)
    contours: list[dict[int, Contours]] = []  # of each camera, by the flash's index
    left_out: dict[int, str] = {}
    exposures = []
    for one in cameras:
        frames = list(sample(opened, one.camera, FRAMES_MOST, report, one.id))
        found, kept, lost = decode_frames(frames, one.camera, look, scan, report)
        contours.append({frames[i].index: found[i] for i in kept})
        left_out |= {index: f"camera {one.id}: {why}" for index, why in lost.items()}
        exposures += [frames[i].exposure for i in kept]
    marks["decode"] = time.process_time()
    indices = tuple(sorted(set(contours[0]).union(*contours[1:])))
    parts = [_observed(one, found, indices, colours) for one, found in zip(cameras, contours, strict=True)]
    seen = joined(parts)
    try:
        solution = calibrate(seen, radius_mm, progress=lambda done, total: report("solve", done, total))
    except AnnulusError as error:
        raise AnnulusError(f"{scan}: {error}.") from None
    refuse(scan, solution, indices)
    marks["solve"] = time.process_time()
    shift = solution.colour_shift_px
    # from here on every ray is one of the head's, wherever its camera stands
    parts = [_observed(one, found, indices, colours, shift) for one, found in zip(cameras, contours, strict=True)]
    seen = joined(parts).in_head(solution.cameras)
    seen = replace(seen, camera=np.zeros(len(seen), np.int64))
    alone = replace(solution, cameras=(), colour_shift_px=np.zeros((0, 4)))
    held = None
    if len(indices) > 2:
        try:
            few = seen.take(np.arange(0, len(seen), HELD_EVERY))
            held = hold_out(
                few, alone, min(FOLDS, len(indices)), progress=lambda done, total: report("hold out", done, total)
            )
        except AnnulusError:  # what a part of the frames leaves open; the advice says so
            held = None
    marks["hold out"] = time.process_time()
    calibration = _calibration(cameras, colours, solution, radius_mm)
    disagreements = [
        disagreement(target, one.id, n, solution) for n, one in enumerate(cameras[1:]) if target is not None
    ]
    compared = tuple(one for one in disagreements if one is not None)
    full = over_exposed(contour for found in contours for contour in found.values())
    warnings = warn(solution, held, indices, radius_mm, None, None, exposures, full)
    for one, found in zip(cameras, contours, strict=True):
        without = sorted(set(indices) - found.keys())
        if without:
            named = first_few(without)
            warnings += (f"camera {one.id} shows no rings in {len(without)} of {len(indices)} flashes ({named})",)
    warnings += tuple(
        f"the target has camera {one.camera} {one.moved_mm:.3f} mm elsewhere, turned by {one.turned_deg:.3f} deg, "
        f"{one.sigmas:.1f} sigma, not {AGREES:g} at most: check the squares' side, the pipe's radius, the lenses"
        for one in compared
        if not one.agrees
    )
    names = list(marks)
    result = PipeCalibration(
        calibration,
        solution,
        seen,
        held,
        None,
        indices,
        left_out,
        len({opened.frames[i].index for i in projector_frames(opened, None)}),
        warnings,
        advise(cameras[0].camera, alone, radius_mm),
        {name: marks[name] - marks[before] for before, name in pairwise(names)},
        target=compared,
    )
    if not result.off_mm < TOGETHER * radius_mm:
        raise AnnulusError(
            f"{scan}: no head with these cameras sees this: {result.off_mm:.2f} mm rms of the radius, expected less "
            f"than {TOGETHER * radius_mm:.2f}. Are frames of one index of one flash, and of the camera they say?"
        )
    return result


def _observed(
    of: HeadCamera,
    contours: dict[int, Contours],
    indices: tuple[int, ...],
    colours: str,
    shift_px: FloatArray | None = None,
) -> Observations:
    """What one camera saw; with the colours' shifts taken out where they are given, to be found where not."""
    number = {index: j for j, index in enumerate(indices)}
    frame = np.concatenate([np.full(len(one.ring), number[index]) for index, one in contours.items()])
    ring = np.concatenate([one.ring for one in contours.values()])
    pixels = np.concatenate([one.pixels for one in contours.values()])
    width = np.concatenate([one.width for one in contours.values()])
    width = np.minimum(width, 1.3 * np.median(width))  # as triangulate does
    centre = np.asarray(next(iter(contours.values())).centre)
    if shift_px is None:
        return observe(of.camera, frame, ring, pixels, centre, width, colours)
    way = pixels - centre
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    tint = observe(of.camera, frame, ring, pixels, centre, width, colours).tint
    if len(tint) == len(pixels):  # the lens inverts all of them
        pixels = pixels - (tint @ shift_px.ravel())[:, None] * way
    return observe(of.camera, frame, ring, pixels, centre, width)


def _calibration(cameras: tuple[HeadCamera, ...], colours: str, solution: Solution, radius_mm: float) -> Calibration:
    shifts = tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in solution.colour_shift_px)
    lenses = [replace(one.camera, colour_shift_px=shifts) for one in cameras]
    others = []
    for one, lens, placed in zip(cameras[1:], lenses[1:], solution.cameras, strict=True):
        turn = placed.rotation.T
        x, y, z = (_three(row) for row in turn)
        others.append(HeadCamera(one.id, lens, (x, y, z), _three(-turn @ placed.centre_mm)))
    covariance = tuple(tuple(float(v) for v in row) for row in solution.covariance)
    return Calibration(
        lenses[0], colours, solution.rings, radius_mm, covariance, others=tuple(others), camera_id=cameras[0].id
    )


def _three(v: FloatArray) -> Vector:
    return float(v[0]), float(v[1]), float(v[2])
