"""A scan under fringes in a pipe (§6.8.2, Models A, B and C) to the same survey that every method makes.

The wall's map follows from many frames together, so there is no profile a frame: each row of the map is handed on as
one. A scan is worked through in windows of consecutive frames, half of each shared with the next, so that memory does
not grow with its length; a row is told by the window whose middle is nearest.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, Image
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.reprocess.executors import Executor, in_process
from annulus_pipe.reprocess.job import roll_filled
from annulus_pipe.reprocess.places import require_near
from annulus_pipe.scans.scan import Scan, open_scan
from annulus_pipe.storage.calibration_file import load_part
from annulus_pipe.storage.place import StoragePath, Where
from annulus_pipe.vocabulary import AnnulusError, Finding, Label, first_few
from annulus_pipe.wall.apart import sound_wall_apart
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.defects import Defect, Detection
from annulus_pipe.wall.grid import Wall, build_wall
from annulus_pipe.wall.indications import Limits
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.stations import measure_stations
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wall.unjudged import find_unjudged
from annulus_pipe.wings.fringe.job import name_of, refused
from annulus_pipe.wings.fringe.measure import (
    Eye,
    FringeHead,
    PipeMap,
    Shots,
    Transfer,
    find_scratches,
    light_of,
    measure_pipe,
)
from annulus_pipe.wings.fringe.measure.placement import PlacedHead
from annulus_pipe.wings.fringe.measure.scratches import CELL, CELLS_MIN, LEAST_OF_RADIUS
from annulus_pipe.wings.fringe.measure.track import AMBIGUOUS
from annulus_pipe.wings.fringe.windows import Arrays, FringeWindow, FringeWindowWork, window_of, without_frames

Progress = Callable[[str, int, int], None]

WINDOW = 24  # flashes of a slide: three fringes of 8 mm at 1 mm a frame, and 120 MB of a camera of a Mpixel
LIGHT = "the fringes' mean light"
EVEN_CELLS = 20.0  # of the report's grid: brightness is evened out over that
BRIGHT = 230  # of 255: what the brightest hundredth of the wall is drawn as
MADE_BY = "annulus calibrate fringe"
STEP_OF_RADIUS = 1 / 400  # half a cell of the map: flashes nearer than that are one
UNTOLD_MAX = 0.02  # share of the map's cells from which it is said that their order of fringe is open


@dataclass(frozen=True, slots=True)
class FringePipeJob:
    """A scan with what its frames need."""

    scan: Scan
    eyes: tuple[Eye, ...]
    ids: tuple[int, ...]  # of the eyes' cameras
    radius_mm: float
    curve: Transfer
    flashes: tuple[tuple[tuple[int, int], ...], ...]  # of each: eye, and number of its frame in the scan
    z_mm: tuple[float, ...]
    roll_rad: tuple[float, ...] | None  # None where nobody said
    window: int  # flashes
    findings: tuple[Finding, ...]
    refuses: Mapping[str, str] = field(default_factory=dict)  # see hooks.WingJob


@dataclass(frozen=True, slots=True)
class MeasuredPipe:
    """map : the fine one. survey : the same wall as reports and files take it. findings : what a reader must know.
    windows, made : of how many, and how many of those were measured now."""

    map: PipeMap
    survey: Survey
    findings: tuple[Finding, ...]
    timing_ms: dict[str, float]
    windows: int = 1
    made: int = 1


def open_fringe_pipe(scan: Where, calibration: Where | None) -> FringePipeJob:
    """calibration : None: the recording's own. AnnulusError, one line, for what is missing, damaged or does not belong
    together."""
    opened = roll_filled(open_scan(scan))
    source = calibration or scan
    head = _head_of(opened, scan) if calibration is None else load_part(calibration, FringeHead.from_dict, MADE_BY)
    if head.radius_mm is None or not (head.lamps or head.projector is not None):
        raise AnnulusError(f"{source}: has no slide of fringes and pipe. Make it with `{MADE_BY}`.")
    eyes = head.eyes()
    flashes, findings = _flashes(opened, scan, head)
    flashes = _moved(opened, scan, flashes, STEP_OF_RADIUS * head.radius_mm)
    for number, (_, camera, _) in enumerate(eyes):
        mine = sum(eye == number for flash in flashes for eye, _ in flash)
        if mine < 3:
            whose = "with the projector" if len(eyes) == 1 else f"of camera {camera} under its slide"
            raise AnnulusError(f"{scan}: {mine} frames {whose}, expected at least 3: phase, DC and AC of a point")
    z = tuple(opened.frames[flash[0][1]].z_mm for flash in flashes)
    rolls = [opened.frames[flash[0][1]].roll_deg for flash in flashes]
    rolled = tuple(math.radians(one) for one in rolls if one is not None)
    curve = head.curve(name_of(scan))
    text = "the calibration names no transfer curve for this scan: grey levels are taken as linear in light"
    if curve is None:
        findings.append(Finding("transfer", text))
    turns = max(1, round(len(flashes) * len(eyes) / max(sum(len(flash) for flash in flashes), 1)))
    return FringePipeJob(
        opened,
        tuple(eye for eye, _, _ in eyes),
        tuple(camera for _, camera, _ in eyes),
        head.radius_mm,
        curve or Transfer(),
        tuple(flashes),
        z,
        rolled if len(rolled) == len(z) else None,
        WINDOW * turns,
        tuple(findings),
        refuses=refused(source),
    )


def _head_of(opened: Scan, scan: Where) -> FringeHead:
    if opened.recording is None or opened.recording.calibration is None:
        raise AnnulusError(f"{scan}: carries no calibration of a head that projects fringes. Name one.")
    try:
        return FringeHead.from_dict(opened.recording.calibration)
    except ValueError as error:
        raise AnnulusError(f"{scan}: the calibration in the recording is damaged: {error}.") from None


def _flashes(opened: Scan, scan: Where, head: FringeHead) -> tuple[list[tuple[tuple[int, int], ...]], list[Finding]]:
    """Of each flash of a slide: eye, and number of its frame in the scan; in order of the flashes."""
    eyes = head.eyes()
    found: dict[int, list[tuple[int, int]]] = {}
    unplaced = []
    for i, frame in enumerate(opened.frames):
        if frame.label is not Label.PROJECTOR:
            continue
        head.camera(frame.camera)
        if not math.isfinite(frame.z_mm):
            raise AnnulusError(f"{scan}: frame {frame.index} has no z_mm, expected where the head was")
        mine = [(number, slots) for number, (_, camera, slots) in enumerate(eyes) if camera == frame.camera]
        if any(slots for _, slots in mine) and frame.slot is None:
            unplaced.append(frame.index)
        found.setdefault(frame.index, []).extend(
            (number, i) for number, slots in mine if not slots or frame.slot in slots
        )
    findings = []
    if unplaced and not any(found.values()):
        raise AnnulusError(
            f"{scan}: no frame says its slot in the lamp cycle, expected it: the head's slides are lit in turn"
        )
    if unplaced:
        text = (
            f"{len(unplaced)} frames have no slot ({first_few(unplaced)}): which of the slides was lit is not known, "
            "they are left out"
        )
        findings.append(Finding("slot", text, tuple(unplaced)))
    return [tuple(found[index]) for index in sorted(found) if found[index]], findings


def _moved(
    opened: Scan, scan: Where, flashes: list[tuple[tuple[int, int], ...]], step_mm: float
) -> list[tuple[tuple[int, int], ...]]:
    """Without flashes of a head that stood still: they say again what the one before said. AnnulusError where it did
    throughout."""
    out: list[tuple[tuple[int, int], ...]] = []
    last = dict[int, float]()  # by eye
    for flash in flashes:
        z, eyes = opened.frames[flash[0][1]].z_mm, [eye for eye, _ in flash]
        if any(abs(z - last.get(eye, math.inf)) >= step_mm for eye in eyes):
            out.append(flash)
            last.update(dict.fromkeys(eyes, z))
    places = [opened.frames[flash[0][1]].z_mm for flash in out]
    require_near(scan, places)
    if len(flashes) > 2 and np.ptp(places) < step_mm:
        raise AnnulusError(
            f"{scan}: z_mm is {places[0]:g} throughout: the head did not move, nothing shifted the phase"
        )
    return out


@dataclass(frozen=True, slots=True)
class _PipePart:
    """What one window says of the wall."""

    map: PipeMap

    def arrays(self) -> Arrays:
        head = {f"head.{name}": getattr(self.map.head, name) for name in _HEAD}
        return {name: getattr(self.map, name) for name in _MAP} | head | {"noise": np.array(self.map.noise)}

    @staticmethod
    def of(job: FringePipeJob, arrays: Arrays) -> "_PipePart":
        head: dict[str, Any] = {name: arrays[f"head.{name}"] for name in _HEAD}
        head |= {name: float(one) for name, one in head.items() if not one.ndim}
        first, second, third = (float(one) for one in arrays["noise"])
        own = {name: arrays[name] for name in _MAP}
        shape = own["z_mm"].shape + own["phi_deg"].shape
        if any(own[name].shape != shape for name in _MAP if name not in ("z_mm", "phi_deg", "slipped")):
            raise ValueError(f"maps of other shapes than {shape}")
        return _PipePart(PipeMap(**own, head=PlacedHead(job.eyes, **head), noise=(first, second, third)))


_MAP = tuple(one.name for one in fields(PipeMap) if one.name not in ("head", "noise"))
_HEAD = tuple(one.name for one in fields(PlacedHead) if one.name != "eyes")


def measured_window(job: FringePipeJob, window: FringeWindow, beside: dict[str, Any]) -> _PipePart:
    each = [(k, eye, i) for k, flash in enumerate(window.flashes) for eye, i in flash]
    images = np.array([_light(job, window.part, eye, i) for _, eye, i in each])
    shots = Shots(images, np.array([eye for _, eye, _ in each]), np.array([k for k, _, _ in each]))
    known = window.known
    try:
        return _PipePart(measure_pipe(job.eyes, shots, known["z_mm"], job.radius_mm, roll_rad=known.get("roll_rad")))
    except AnnulusError as error:
        raise AnnulusError(f"{job.scan.path}: {error}") from None


def reconstruct_fringe_pipe(
    job: FringePipeJob,
    progress: Progress | None = None,
    executor: Executor = in_process,
    place: StoragePath | None = None,
) -> MeasuredPipe:
    """The wall. place : where windows are kept, and found again. AnnulusError where nothing can be measured."""
    started = time.perf_counter()
    report = progress or (lambda stage, done, total: None)
    count, size = len(job.flashes), job.window
    last = count - size
    if last <= size // 4:  # a few more at once are cheaper than a window for them
        size, last = max(count, size), 0
    starts = [*range(0, last, size // 2), last]
    report("fringes", 0, count)
    work = FringeWindowWork(without_frames(job), measured_window, _PipePart.of, place)
    parts, z, slipped, made = [], np.array(job.z_mm), np.zeros(count, bool), 0
    for number, start in enumerate(starts):
        window = slice(start, start + size)
        known = {"z_mm": z[window]} | ({} if job.roll_rad is None else {"roll_rad": np.array(job.roll_rad[window])})
        one = window_of(job.scan, number, job.flashes[window], lambda flash: [i for _, i in flash], known)
        kept, new = work.of(executor, one)
        part = kept.map
        made += new
        parts.append(part)
        off = part.head.poses[:, 5] - z[window]
        slipped[window] |= part.slipped
        z[start:] += np.concatenate([off, np.full(len(z) - start - len(off), off[-1])])  # what slipped stays so
        report("fringes", min(start + size, count), count)
    seen = _joined(parts, starts)
    timing = {"scan_to_map": 1e3 * (time.perf_counter() - started)}
    findings = list(job.findings)
    if slipped.any():
        indices = tuple(job.scan.frames[job.flashes[k][0][1]].index for k in np.flatnonzero(slipped))
        text = (
            f"z_mm disagrees with the frames by up to {np.abs(z - job.z_mm).max():.2f} mm, at {len(indices)} flashes "
            f"({first_few(indices)}): the frames' places are used"
        )
        findings.append(Finding("slip", text, indices))
    if (unsure := float((seen.flag == AMBIGUOUS).mean())) > UNTOLD_MAX:
        text = f"{100 * unsure:.1f} % of the map has no radius: the order of the fringe is open there"
        findings.append(Finding("untold", text))
    return MeasuredPipe(seen, _survey(job, seen), tuple(findings), timing, len(starts), made)


def _light(job: FringePipeJob, part: Scan, eye: int, i: int) -> Float32Array:
    return light_of(part.read(i), job.eyes[eye].camera, job.curve, part.frames[i].where)


def _joined(parts: Sequence[PipeMap], starts: Sequence[int]) -> PipeMap:
    """One map of all windows, which begin at these flashes; their rows are whole steps from z = 0."""
    if len(parts) == 1:
        return parts[0]
    step = parts[0].cell_mm[0]
    rows = [np.rint(part.z_mm / step).astype(int) for part in parts]
    every = np.arange(min(one[0] for one in rows), max(one[-1] for one in rows) + 1)
    middles = np.array([part.z_mm.mean() for part in parts])
    distance = np.abs(every[None, :] * step - middles[:, None])
    for k, one in enumerate(rows):
        distance[k, (every < one[0]) | (every > one[-1])] = np.inf
    owner = np.argmin(distance, axis=0)
    first = parts[0]

    def grid(name: str) -> Any:
        return np.array([getattr(parts[k], name)[row - rows[k][0]] for row, k in zip(every, owner, strict=True)])

    poses = first.head.poses
    for part, start in zip(parts[1:], starts[1:], strict=True):
        poses = np.concatenate([poses, part.head.poses[len(poses) - start :]])
    radius = float(np.mean([part.head.radius_mm for part in parts]))
    return PipeMap(
        every * step,
        first.phi_deg,
        grid("radius_mm"),
        grid("sigma_mm"),
        grid("flag"),
        grid("at_least"),
        grid("dc"),
        grid("modulation"),
        grid("frames"),
        grid("seen_by"),
        replace(first.head, poses=poses, radius_mm=radius),
        first.noise,
        np.concatenate([part.slipped for part in parts]),
    )


def _survey(job: FringePipeJob, seen: PipeMap) -> Survey:
    began = time.perf_counter()
    line = Centreline([Piece(0.0, seen.head.radius_mm)])
    profiles = _rows(job, seen)
    wall = build_wall(profiles, centreline=line)
    built = time.perf_counter()
    defects = find_scratches(seen)
    size = math.sqrt(CELLS_MIN) * seen.cell_mm[0] / seen.head.radius_mm
    limits = replace(Limits(), seed_noise=CELL, seed_of_radius=LEAST_OF_RADIUS, size_of_radius=size)
    label = np.zeros(wall.radius_mm.shape, np.int32)
    for n, one in enumerate(defects, start=1):
        label[_cells(wall, one)] = n
    timing = {"wall": 1e3 * (built - began), "defects": 1e3 * (time.perf_counter() - built)}
    none, detection = np.zeros(wall.radius_mm.shape, bool), Detection(tuple(defects), label, limits)
    unjudged = find_unjudged(
        wall,
        detection,
        explained=none,
        joints=none[:, 0],
        shadowed=none,
        no_wall=None,
        looks=None,
        rings=1,
        apart=sound_wall_apart(wall, None),
    )
    return Survey(
        tuple(profiles),
        wall,
        none,
        detection,
        measure_stations(wall),
        _light_map(wall, seen),
        None,
        (),
        line,
        (),
        2 * job.radius_mm,
        timing,
        tuple(sorted(set(job.ids))),
        LIGHT,
        unjudged=unjudged,
    )


def _rows(job: FringePipeJob, seen: PipeMap) -> list[Profile]:
    """Each row of the map as a profile of one frame: of all, the one whose lit wall had its middle nearest the row."""
    middle = float(np.median(seen.z_mm)) - float(np.median(job.z_mm))
    z = np.array(job.z_mm)
    turn, out = np.radians(seen.phi_deg), []
    cameras = sorted(set(job.ids))
    whose = np.array([*(cameras.index(one) for one in job.ids), len(cameras)], np.uint8)  # by eye, and of several
    bright = float(np.nanpercentile(seen.dc, 99)) if np.isfinite(seen.dc).any() else 1.0
    for j, at in enumerate(seen.z_mm):
        known = np.flatnonzero(np.isfinite(seen.radius_mm[j]) & np.isfinite(seen.sigma_mm[j]))
        radius = seen.radius_mm[j, known]
        points = np.stack([radius * np.cos(turn[known]), radius * np.sin(turn[known]), np.full(len(known), at)], axis=1)
        grey = np.clip(255 * np.nan_to_num(seen.dc[j, known]) / bright, 0, 255).astype(np.uint8)
        frame = job.scan.frames[job.flashes[int(np.argmin(np.abs(z + middle - at)))][0][1]].index
        out.append(
            Profile(
                frame,
                float(at),
                Pose(),
                points.astype(np.float32),
                np.repeat(grey[:, None], 3, axis=1),
                np.zeros(len(known), np.uint8),
                known.astype(np.uint16),
                float(np.median(seen.sigma_mm[j, known])) if len(known) else math.nan,
                sigma_mm=seen.sigma_mm[j, known].astype(np.float32),
                camera=job.ids[0],
                seen_by=whose[seen.seen_by[j, known]],
            )
        )
    return out


def _cells(wall: Wall, one: Defect) -> BoolArray:
    """(Z, A) bool, of the report's coarser grid: those that a defect's extent covers, at least one."""
    low, high = one.z_range_mm
    rows = np.abs(wall.z_mm - one.z_mm) <= max((high - low) / 2, wall.z_step_mm / 2)
    away = np.abs((wall.clock_deg - one.clock_deg + 180.0) % 360.0 - 180.0)
    return np.asarray(rows[:, None] & (away <= max(one.arc_deg / 2, wall.clock_step_deg / 2)))


def _light_map(wall: Wall, seen: PipeMap) -> Image | None:
    """(Z, A, 4) uint8 RGBA of the report's grid: the mean of the map's DC in each cell over that about it, alpha 0
    where nothing is known. How bright one stretch of wall is beside another far from it, no eye knows."""
    row = np.rint((seen.z_mm - wall.z_mm[0]) / wall.z_step_mm).astype(int)
    column = np.rint((seen.phi_deg + 90.0) / wall.clock_step_deg).astype(int) % len(wall.clock_deg)
    seen_here = np.isfinite(seen.radius_mm) & ((row >= 0) & (row < len(wall.z_mm)))[:, None]
    if not seen_here.any():
        return None
    j, i = np.nonzero(seen_here)
    cell = row[j] * len(wall.clock_deg) + column[i]
    count = np.bincount(cell, minlength=wall.radius_mm.size)
    total = np.bincount(cell, weights=seen.dc[seen_here], minlength=wall.radius_mm.size)
    about = [
        ndimage.gaussian_filter(
            one.reshape(wall.radius_mm.shape).astype(float), EVEN_CELLS, mode=("nearest", "wrap")
        ).ravel()
        for one in (total, count)
    ]
    known = count > 0
    even = np.where(known, total / np.maximum(count, 1) / np.maximum(about[0] / np.maximum(about[1], 1e-9), 1e-9), 0.0)
    grey = np.clip(BRIGHT * even / np.percentile(even[known], 99), 0, 255)
    picture = np.stack([grey, grey, grey, np.where(known, 255, 0)], axis=1)
    return picture.astype(np.uint8).reshape(*wall.radius_mm.shape, 4)
