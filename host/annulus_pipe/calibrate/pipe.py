"""`annulus calibrate pipe`: the projector's rings, from frames of a clean pipe with the head leaning about in it."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.calibrate.both import Disagreement
from annulus_pipe.calibrate.followed import decode_frames, over_exposed
from annulus_pipe.calibrate.sample import Progress, projector_frames, sample
from annulus_pipe.geometry.calibration import Calibration, camera_alone, head_from_dict
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.rings.calibration.autocalibration import calibrate, with_frame
from annulus_pipe.rings.calibration.bundle import Solution
from annulus_pipe.rings.calibration.contours import Contours, Look
from annulus_pipe.rings.calibration.corrections import fit_corrections, ring_corrections
from annulus_pipe.rings.calibration.cross_validation import Measured, hold_out
from annulus_pipe.rings.calibration.observations import Observations, observe
from annulus_pipe.rings.diagnosis import LOST_MOST, FrameLighting
from annulus_pipe.rings.polar import ring_pixels
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.storage.calibration_file import load_part, update_calibration
from annulus_pipe.vocabulary import AnnulusError

# What is refused and what is found: test_pipe and topic calibrate_scene. What is only said (GOOD_*, WAVES, OTHER_*,
# CLIPPED_*) was chosen on calibration-a, spoilt one way at a time: unguarded.
FRAMES_MOST = 40  # of a longer scan evenly taken; more only average noise that is small already
FRAMES_ASKED = 4  # fewer are used, and said to be few
LEAN_DEG, LEAN_SHIFT = 10.0, 0.1  # what is advised: to lean so far, and stand off by this part of the radius
GOOD_ANGLE_DEG, GOOD_VERTEX = 0.02, 0.001  # of the full angle; of the radius: known so well, poses were good enough
USELESS = 0.03  # of the radius: a vertex known no better than this is not known
ALIKE_DEG, ALIKE_SHIFT = 1.0, 0.02  # leans and stands (of the radius) within so much of each other are one
FOLDS = 4  # parts that are held out in turn
HELD_EVERY = 3  # observations: as many as the held-out error needs
CORRECTION_WINS = 0.97  # residual corrections are kept if they bring the held-out error down to this part at most
WAVES = 8.0  # neighbouring errors alike: noise makes 3
CLIPPED_SOME = 0.02  # of the stripes at full scale: enough to bend a ring by the tenth of a pixel that makes waves
OTHER_PIPE = 0.004  # of the radius: a frame's pipe this much off is another pipe
CLIPPED_HERE = 0.75  # of the stripes at full scale: rings then come out hundredths of a degree off
NEARLY_FLAT = math.radians(8.0)  # from a plane: a cone so flat is fitted as a plane too, ..
FLAT_FITS = 1.05  # .. and is one if the plane's misfit is at most this many times the cone's
OTHER_DISTANCE = 0.01  # of the distance camera - projector: farther from the last calibration's, it is said

LINES_REMARK = (
    "of several bright lines, half-angle and vertex may together be off by ten times their sigmas (0.45 deg and "
    "2 mm on a simulated head); what they measure of the wall is as good as the hold-out says"
)


@dataclass(frozen=True, slots=True)
class PipeCalibration:
    """What was found, how well, and what to do better."""

    calibration: Calibration
    solution: Solution
    seen: Observations
    held_out: Measured | None  # None with fewer than three frames: nothing is left to hold out
    held_out_corrected: Measured | None  # the same with each ring's residual correction
    frames: tuple[int, ...]  # scan indices of the frames used
    left_out: dict[int, str]  # scan index -> why
    found: int  # projector frames in the scan
    warnings: tuple[str, ...]
    advice: tuple[str, ...]
    timing_s: dict[str, float] = field(default_factory=dict)
    held_every: int = HELD_EVERY
    target: tuple[Disagreement, ...] = ()  # with a target before both cameras, about where they stand

    def held_mm(self, held: Measured, part: BoolArray | None = None) -> float:
        """mm rms of the radius in frames held out."""
        if not self.solution.cameras:
            return held.rms_mm() if part is None else held.rms_mm(part)
        return self._mm(held.error_px, part, self.held_every)

    @property
    def off_mm(self) -> float:
        """mm rms of the radius: in frames held out, where there are enough for that."""
        return self._mm(self.solution.error_px, None) if self.held_out is None else self.held_mm(self.held_out)

    def _mm(self, error_px: FloatArray, part: BoolArray | None, every: int = 1) -> float:
        """Errors in px as mm of radius: where a ray is tangent to its cone a pixel is any length, so over all."""
        by_mm = self.solution.radius_px[::every]
        good = np.isfinite(error_px) if part is None else np.isfinite(error_px) & part
        return _rms(error_px[good]) / max(_rms(by_mm[good]), 1e-9)

    @property
    def cameras(self) -> list[dict[str, Any]]:
        """Of each camera after the first: how far it is turned (degrees), where its centre is in the first one's frame
        (mm), and their standard deviations."""
        sigma = np.sqrt(np.diag(self.solution.camera_covariance)).reshape(-1, 6)
        out = []
        for one, placed, s in zip(self.calibration.others, self.solution.cameras, sigma, strict=True):
            turn = math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(placed.rotation)) - 1.0) / 2.0))))
            at = {"turned_deg": turn, "turned_sigma_deg": math.degrees(float(s[:3].max()))}
            out.append(
                {"camera": one.id, **at, "centre_mm": placed.centre_mm.tolist(), "centre_sigma_mm": s[3:].tolist()}
            )
        return out

    @property
    def distance_mm(self) -> float:
        """From the camera's centre to the rings' vertices, the mean: what a ruler can check."""
        return float(np.mean([math.hypot(*ring.vertex_mm) for ring in self.calibration.rings]))

    def to_dict(self) -> dict[str, Any]:
        """Plain numbers; degrees and mm."""
        solution, held = self.solution, self.held_out_corrected if self.calibration.corrections else self.held_out
        sigma = np.sqrt(np.diag(solution.covariance)).reshape(-1, 6)
        rings = []
        for k, ring in enumerate(solution.rings):
            mine = (self.seen.ring == k) & (solution.weight > 0)
            mm = solution.error_px[mine] / solution.radius_px[mine]
            part = self.seen.ring[:: self.held_every] == k
            rings.append(
                {
                    "theta_full_deg": math.degrees(2 * ring.half_angle),
                    "theta_full_sigma_deg": math.degrees(2 * sigma[k, 0]),
                    "axis": list(ring.axis),
                    "axis_sigma": sigma[k, 1:3].tolist(),
                    "vertex_mm": list(ring.vertex_mm),
                    "vertex_sigma_mm": sigma[k, 3:].tolist(),
                    "observations": int(np.count_nonzero(mine)),
                    "residual_px": _rms(solution.error_px[mine]),
                    "residual_mm": _rms(mm) if not solution.cameras else self._mm(solution.error_px, mine),
                    "held_out_mm": None if held is None else self.held_mm(held, part),
                }
            )
        return {
            "frames_found": self.found,
            "frames_used": list(self.frames),
            "frames_left_out": {str(index): why for index, why in self.left_out.items()},
            "poses": [
                {
                    "frame": index,
                    "rx_deg": math.degrees(p.rx),
                    "ry_deg": math.degrees(p.ry),
                    "tx_mm": p.tx,
                    "ty_mm": p.ty,
                }
                for index, p in zip(self.frames, solution.poses, strict=True)
            ],
            "rings": rings,
            "residual_px": _rms(solution.error_px[solution.weight > 0]),
            "held_out_mm": None if self.held_out is None else self.held_mm(self.held_out),
            "held_out_corrected_mm": None if self.held_out_corrected is None else self.held_out_corrected.rms_mm(),
            "corrected": self.calibration.corrections is not None,
            "camera_projector_mm": self.distance_mm,
            "pipe_radius_mm": self.calibration.pipe_radius_mm,
            **({"cameras": self.cameras} if self.cameras else {}),
            **({"target": [asdict(one) for one in self.target]} if self.target else {}),
            "poses_good": not self.advice,
            "advice": list(self.advice),
            "warnings": list(self.warnings),
            "timing_s": {name: round(value, 4) for name, value in self.timing_s.items()},
        }


def calibrate_pipe(
    scan: Path, camera: Path, radius_mm: float, *, lines: int = 0, progress: Progress | None = None
) -> PipeCalibration:
    """Calibrate from the projector frames of a scan in a clean round pipe of known radius.

    `camera` is a file with the sections camera and pattern; a whole calibration.json will do, its rings are compared
    with, never started from. lines : of a head of bright rings or planes how many; then the file needs no pattern.
    Raises AnnulusError, one line, where nothing can be found.
    """
    check_radius(radius_mm)
    if lines:
        known, look = load_part(camera, camera_alone, "annulus calibrate camera"), Look.of_lines(lines)
        colours, last_radius, last = "", None, None
    else:
        known, colours, last_radius, last = load_part(camera, head_from_dict, "annulus calibrate camera")
        look = Look.of_slits(colours)
    report = progress or (lambda stage, done, total: None)
    marks = {"start": time.process_time()}
    opened = open_scan(scan)
    frames = list(sample(opened, known, FRAMES_MOST, report))
    marks["read"] = time.process_time()
    contours, kept, left_out = decode_frames(frames, known, look, scan, report)
    marks["decode"] = time.process_time()
    seen = _observations(known, [contours[i] for i in kept])
    indices = tuple(frames[i].index for i in kept)
    try:
        solution = _solve(seen, radius_mm, bool(lines), lambda done, total: report("solve", done, total))
    except AnnulusError as error:
        raise AnnulusError(f"{scan}: {error}.") from None
    refuse(scan, solution, indices)
    marks["solve"] = time.process_time()
    held, held_corrected, best, corrections = None, None, solution, None
    if len(kept) > 2:
        try:
            folds, few = min(FOLDS, len(kept)), seen.take(np.arange(0, len(seen), HELD_EVERY))
            held = hold_out(few, solution, folds, progress=lambda done, total: report("hold out", done, total))
            held_corrected = hold_out(
                few, solution, folds, fit=fit_corrections, progress=lambda done, total: report("correct", done, total)
            )
            if held_corrected.rms_mm() < CORRECTION_WINS * held.rms_mm():
                best, corrections = fit_corrections(seen, solution)
        except AnnulusError:  # what a part of the frames leaves open; the advice says so
            held = held_corrected = None
    marks["hold out"] = time.process_time()
    calibration = Calibration(
        known,
        colours,
        best.rings,
        radius_mm,
        tuple(tuple(float(v) for v in row) for row in best.covariance),
        None if corrections is None else ring_corrections(corrections),
        pattern={"kind": "line"} if lines else None,
    )
    # a laser's line may be at full scale
    used = [] if lines else [frames[i].exposure for i in kept]
    full = () if lines else over_exposed(contours[i] for i in kept)
    warnings = warn(best, held, indices, radius_mm, last_radius, last, used, full)
    if lines > 1:
        warnings += (LINES_REMARK,)
    names = list(marks)
    timing = {name: marks[name] - marks[before] for before, name in pairwise(names)}
    return PipeCalibration(
        calibration,
        best,
        seen,
        held,
        held_corrected,
        indices,
        left_out,
        len(projector_frames(opened)),
        warnings,
        advise(known, best, radius_mm),
        timing,
    )


def check_radius(radius_mm: float) -> None:
    """Raises AnnulusError for what is no pipe's radius."""
    if not 1.0 <= radius_mm <= 5000.0:
        raise AnnulusError(f"the radius is {radius_mm:g} mm, expected 1..5000: half of the pipe's inner diameter")


def save_pipe(result: PipeCalibration, out: Path) -> None:
    """Write rings, pattern, camera and pipe into `out`; other sections in it stay."""
    data, figures = result.calibration.to_dict(), result.to_dict()
    made = {
        key: figures[key] for key in ("frames_used", "residual_px", "held_out_mm", "held_out_corrected_mm", "corrected")
    }
    kept = "camera" if "camera" in data else "cameras"
    sections = {key: data[key] for key in (kept, "pattern", "rings", "pipe", "covariance")}
    update_calibration(out, sections, {"rings": {"by": "annulus calibrate pipe", **made}})


def _solve(seen: Observations, radius_mm: float, lines: bool, progress: Callable[[int, int], None]) -> Solution:
    """Cones; of bright lines planes, where cones are as good as flat or leave their vertices open, and planes do."""
    try:
        solution = calibrate(seen, radius_mm, progress=progress)
    except AnnulusError:
        if not lines:
            raise
        solution = None
    if not lines:
        assert solution is not None
        return solution
    rings = int(seen.ring.max()) + 1
    near = [True] * rings
    if solution is not None:
        near = [abs(math.pi / 2 - ring.half_angle) < NEARLY_FLAT for ring in solution.rings]
    if not any(near):
        assert solution is not None
        return solution
    flat = calibrate(seen, radius_mm, flat=tuple(near), progress=progress)
    if solution is None or _rms(flat.error_px[flat.weight > 0]) < FLAT_FITS * _rms(
        solution.error_px[solution.weight > 0]
    ):
        return flat
    return solution


def _observations(camera: Camera, contours: Sequence[Contours]) -> Observations:
    frame = np.concatenate([np.full(len(contour.ring), j) for j, contour in enumerate(contours)])
    ring = np.concatenate([contour.ring for contour in contours])
    pixels = np.concatenate([contour.pixels for contour in contours])
    width = np.concatenate([contour.width for contour in contours])
    width = np.minimum(width, 1.3 * np.median(width))  # as triangulate does
    centre = np.asarray(contours[0].centre)
    return observe(camera, frame, ring, pixels, centre, width)


def refuse(scan: Path, solution: Solution, frames: Sequence[int]) -> None:
    """Raises where the answer is none."""
    vertex = np.sqrt(np.diag(solution.covariance)).reshape(-1, 6)[:, 3:].max()
    lean = leans(solution.poses)
    stands = np.array([[p.tx, p.ty] for p in solution.poses])
    turn, shift = np.ptp(lean, axis=0).max(), np.ptp(stands, axis=0).max()
    alike = turn < ALIKE_DEG and shift < ALIKE_SHIFT * solution.radius_mm
    if alike or vertex > USELESS * solution.radius_mm:
        what = (
            f"all {len(frames)} poses are alike (leans within {turn:.1f} deg, places within {shift:.1f} mm)"
            if alike
            else f"the {len(frames)} poses tell the projector's place only to {vertex:.1f} mm"
        )
        raise AnnulusError(
            f"{scan}: {what}. Take at least {FRAMES_ASKED} frames, the head leaning about {LEAN_DEG:.0f} deg to the "
            "left, to the right, up and down."
        )
    error = _rms(solution.error_px[solution.weight > 0])
    lost = float(np.mean(solution.weight == 0))
    if error > 8.0 or lost > 0.4:
        raise AnnulusError(
            f"{scan}: the frames do not show one round pipe: rings lie {error:.1f} px beside where they should, "
            f"{100 * lost:.0f} % of the slits fit nowhere. Check the camera's file; the pipe must be clean and round."
        )


def leans(poses: Sequence[Pose]) -> FloatArray:
    """(F, 2) degrees the head leans to the right and down: against the pipe, whose axis it then sees left and up."""
    axes = np.array([pose.rotation[:, 2] for pose in poses])
    return np.asarray(-np.degrees(np.arctan2(axes[:, :2], axes[:, 2:])))


def advise(camera: Camera, solution: Solution, radius: float) -> tuple[str, ...]:
    """What poses to add, if these were not good enough."""
    sigma = np.sqrt(np.diag(solution.covariance)).reshape(-1, 6)
    out: list[str] = []
    vertex, angle = float(sigma[:, 3:].max()), math.degrees(2 * float(sigma[:, 0].max()))
    weak = vertex > GOOD_VERTEX * radius or angle > GOOD_ANGLE_DEG
    lean = leans(solution.poses)
    spread = np.stack([lean.max(axis=0), -lean.min(axis=0)], axis=1)
    names = (("right", "left"), ("down", "up"))
    few = len(solution.poses) < FRAMES_ASKED
    missing = [names[a][b] for a in range(2) for b in range(2) if spread[a, b] < 0.3 * LEAN_DEG]
    if weak:
        out.append(f"the projector's place is known to {vertex:.2f} mm and {angle:.3f} deg only")
    if few:
        out.append(f"{len(solution.poses)} frames are few, take at least {FRAMES_ASKED}")
    if weak or few or missing:
        way, then = _best_lean(camera, solution, radius)
        out.append(
            (f"no frame leans {' or '.join(missing)}: " if missing else "")
            + f"lean the head {LEAN_DEG:.0f} deg {way}; one frame more brings the place to {then:.2f} mm"
        )
    return tuple(out)


def _best_lean(camera: Camera, solution: Solution, radius: float) -> tuple[str, float]:
    """The lean, of eight, that would tell most about the vertices, and how well they would then be known, mm."""
    steps = 90
    best = ("", math.inf)
    ways = {
        "to the right": (1, 0),
        "to the left": (-1, 0),
        "down": (0, 1),
        "up": (0, -1),
        "down to the right": (0.7, 0.7),
        "up to the left": (-0.7, -0.7),
        "up to the right": (0.7, -0.7),
        "down to the left": (-0.7, 0.7),
    }
    lean, stand = math.radians(LEAN_DEG), LEAN_SHIFT * radius
    for name, (right, down) in ways.items():
        pose = Pose(down * lean, -right * lean, -right * stand, -down * stand)
        rings, places = [], []
        for k, cone in enumerate(solution.rings):
            pixels = ring_pixels(camera, cone, pose, radius, steps)
            pixels = pixels[np.isfinite(pixels).all(axis=1)]
            rings.append(np.full(len(pixels), k))
            places.append(pixels)
        pixels, ring = np.vstack(places), np.concatenate(rings)
        if len(pixels) < 20:
            continue
        one = observe(camera, np.zeros(len(ring), np.int64), ring, pixels, np.array([camera.cx, camera.cy]))
        # as many observations as a frame has, not so many as were drawn here
        part = steps * len(solution.rings) * len(solution.poses) / max(len(solution.error_px), 1)
        cover = with_frame(replace(solution, correlation_length=solution.correlation_length * part), one, pose)
        vertex = float(np.sqrt(np.diag(cover)).reshape(-1, 6)[:, 3:].max())
        if vertex < best[1]:
            best = name, vertex
    return best


def warn(
    solution: Solution,
    held: Measured | None,
    frames: Sequence[int],
    radius: float,
    last_radius: float | None,
    last: Calibration | None,
    exposures: Sequence[FrameLighting],
    full: Sequence[int],
) -> tuple[str, ...]:
    """What may be wrong, a line each. full : rings, from 1, that lie between over-exposed stripes all round."""
    out = []
    distance = float(np.mean([math.hypot(*ring.vertex_mm) for ring in solution.rings]))
    off, sigma = solution.off_radius_mm
    if sigma < 0.01 * radius and abs(off) > max(5 * sigma, 0.003 * radius):
        out.append(
            f"the frames look like a pipe of radius {radius + off:.2f} mm, not {radius:g}: the mirror's size tells"
        )
    if last is not None:
        before = float(np.mean([math.hypot(*ring.vertex_mm) for ring in last.rings]))
        if abs(distance / before - 1) > OTHER_DISTANCE:
            out.append(
                f"camera and projector come out {distance:.2f} mm apart, {before:.2f} before: the head was changed, or "
                f"the pipe's radius is {radius * before / distance:.2f} mm and not {radius:g}"
            )
        out += _flipped(solution, last)
    elif last_radius is not None and abs(last_radius / radius - 1) > 0.002:
        out.append(
            f"the radius is {radius:g} mm but pipe.radius_mm in the camera's file is {last_radius:g}: lengths grow "
            f"with it, camera and projector come out {distance:.2f} mm apart, or {distance * last_radius / radius:.2f}"
        )
    if held is not None:
        other = [
            (index, delta)
            for index, delta, s in zip(frames, held.off_radius_mm, held.sigma_mm, strict=True)
            if abs(delta) > max(6 * s, OTHER_PIPE * radius)
        ]
        if other:
            out.append(
                "not all frames are of one pipe: "
                + ", ".join(f"frame {index} looks like radius {radius + delta:.2f} mm" for index, delta in other[:4])
            )
    if solution.runner_up < 1.3:
        out.append("another place of the projector fits nearly as well: take frames that lean more")
    waves = float(solution.correlation_length.max())
    if waves > WAVES:
        clipped = max((e.clipped for e in exposures), default=0.0)
        moved = f", or slits moved in the {100 * clipped:.0f} % of the stripes that are over-exposed"
        out.append(
            f"the errors run in long waves along the rings (up to {waves:.0f} neighbours alike): the camera's file is "
            f"not of this camera and lens, or the pipe is not round{moved if clipped > CLIPPED_SOME else ''}"
        )
    over = [e for e in exposures if e.lost > LOST_MOST or e.clipped > CLIPPED_HERE]
    if over:
        out.append(
            f"{len(over)} frames over-exposed, up to {100 * max(e.clipped for e in over):.0f} % of the stripes at full "
            "scale: slits move there; shorten the projector's flash"
        )
    elif full:
        out.append(
            f"ring{'s' if len(full) > 1 else ''} {', '.join(map(str, full))} beside over-exposed stripes nearly all "
            "round: slits move there, angles by tenths of a degree; shorten the projector's flash"
        )
    return tuple(out)


def _flipped(solution: Solution, last: Calibration) -> list[str]:
    """Whether the rings' axes and vertices look like the last calibration's in a mirror, or upside down."""
    now = np.array([[*ring.axis[:2], *np.array(ring.vertex_mm[:2]) / 50.0] for ring in solution.rings])
    before = np.array([[*ring.axis[:2], *np.array(ring.vertex_mm[:2]) / 50.0] for ring in last.rings])
    if now.shape != before.shape:
        return []
    ways = {"": (1, 1), "mirrored left to right": (-1, 1), "mirrored top to bottom": (1, -1), "upside down": (-1, -1)}
    off = {name: float(np.abs(now * np.tile(way, 2) - before).mean()) for name, way in ways.items()}
    nearest = min(off, key=lambda name: off[name])
    if nearest and off[""] > 0.003 and off[nearest] < 0.4 * off[""]:
        return [f"the images look {nearest} against the calibration in the camera's file: check the camera's flips"]
    return []


def _rms(values: FloatArray) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan
