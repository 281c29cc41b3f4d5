"""Which LED frame shows a defect best, and where in it.

The best is the one that looks at it least obliquely: ahead of a camera on the pipe's axis that is the nearest one from
which all of the outline is still in the picture. Only that frame has to be read.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import Float32Array, FloatArray, Image
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wall.texture import HeadPath, pixels_of

NEAREST_OF_RADIUS = 0.3  # of the radius: how far ahead of the head a place is looked for, at least
FARTHEST_OF_RADIUS = 4.0  # .. and at most
INSIDE = 0.98  # part of the outline in the picture, or the most there is where no frame has so much ..
INSIDE_LEAST = 0.5  # .. but not less
SIDE_MAX_PX = 560  # of a crop: what is larger is made smaller
SIDE_MIN_PX = 160  # .. and what is smaller shows more around
MARGIN = 0.35  # of the outline's larger side, left free about it
CLOSED_MM = 6.0  # half of a gap in the outline that is a shadow's and not the defect's
TICK_DEG = 15.0  # between clock ticks, half an hour
POINTS_MAX = 400  # of an outline
EVEN_PERCENT = (1.0, 99.5)  # of the crop's grey levels: what becomes black and white


@dataclass(frozen=True, slots=True)
class Shot:
    """An LED frame that could be read: its number for whoever reads it, index, station and camera."""

    number: int
    index: int
    z_mm: float
    camera: int


@dataclass(frozen=True, slots=True, eq=False)
class DefectView:
    """A defect as one shot sees it. outline : closed lines in pixels of the frame, each (N, 2). ticks : clock angle, in
    degrees, and two pixels, its begin and its end. ahead_mm : how far before the camera; oblique_deg : between the
    wall's normal and the look at it, at the middle. inside : part of the outline in the picture."""

    index: int
    shot: Shot
    outline: tuple[FloatArray, ...]
    ticks: tuple[tuple[float, FloatArray], ...]
    ahead_mm: float
    oblique_deg: float
    inside: float


@dataclass(frozen=True, slots=True, eq=False)
class Photograph:
    """A part of one LED frame, (H, W, 3) uint8 BGR, brightness stretched; `view` in pixels of this part."""

    view: DefectView
    image_bgr: Image


def best_views(
    survey: Survey, calibration: Calibration, shots: Sequence[Shot], indices: Sequence[int]
) -> dict[int, DefectView]:
    """The best view of each of some defects, by its index; none of an out-of-round stretch, which is no place, and of
    what no shot shows half of."""
    pose = cache(HeadPath(survey.profiles).at)
    shape = survey.wall.shape_radius_mm()  # where the pipe's wall would be: a rim lies on it
    sizes = {one.id: (one.camera.width, one.camera.height) for one in calibration.cameras}
    radius = survey.wall.mean_radius_mm

    def seen(shot: Shot, line: FloatArray) -> FloatArray | None:
        stood = pose(shot.z_mm)
        if stood is None or shot.camera not in sizes:
            return None
        return pixels_of(line, survey.centreline, calibration, stood, shot.z_mm, shot.camera)

    out: dict[int, DefectView] = {}
    for index in indices:
        defect = survey.defects[index]
        lines = _outline(survey, index, shape)
        if defect.kind is Kind.OVALITY or not lines:
            continue
        first, last = defect.z_range_mm
        found: list[tuple[bool, float, int, float]] = []  # the least is the best
        for k, shot in enumerate(shots):
            ahead = defect.z_mm - shot.z_mm
            near = NEAREST_OF_RADIUS * radius <= last - shot.z_mm and ahead <= FARTHEST_OF_RADIUS * radius
            pixels = seen(shot, np.concatenate(lines)) if near and first >= shot.z_mm else None
            if pixels is not None:
                inside = _inside(pixels, sizes[shot.camera])
                found.append((inside < INSIDE, ahead if inside >= INSIDE else -inside, k, inside))
        *_, k, inside = min(found, default=(0, 0, 0, 0.0))
        if inside >= INSIDE_LEAST:
            ahead = defect.z_mm - shots[k].z_mm
            outline = [line for one in lines if (line := seen(shots[k], one)) is not None]
            ticks = [(clock, seen(shots[k], line)) for clock, line in _ticks(survey, defect, shape)]
            marks = [(clock, at) for clock, at in ticks if at is not None and np.isfinite(at).all()]
            oblique = math.degrees(math.atan2(ahead, radius))
            out[index] = DefectView(index, shots[k], tuple(outline), tuple(marks), ahead, oblique, inside)
    return out


def crop(view: DefectView, image: Image) -> Photograph:
    """The part of the frame about a defect, no larger than SIDE_MAX_PX a side."""
    height, width = image.shape[:2]
    points = np.concatenate(view.outline)
    points = points[np.isfinite(points).all(axis=1)]
    low = np.clip(points.min(axis=0), 0, (width - 1, height - 1))
    high = np.clip(points.max(axis=0), 0, (width - 1, height - 1))
    side = max(float((high - low).max()) * (1 + 2 * MARGIN), SIDE_MIN_PX)
    middle = (low + high) / 2
    span = np.minimum(np.maximum((high - low) + 2 * MARGIN * float((high - low).max()), 0.75 * side), (width, height))
    start = np.clip(np.rint(middle - span / 2), 0, np.array((width, height)) - span).astype(int)
    stop = np.minimum(start + np.maximum(np.rint(span), 8).astype(int), (width, height))
    part = image[start[1] : stop[1], start[0] : stop[0]]
    scale = min(SIDE_MAX_PX / max(part.shape[:2]), 3.0)
    size = (max(1, round(part.shape[1] * scale)), max(1, round(part.shape[0] * scale)))
    part = cv2.resize(part, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    black, white = np.percentile(part.max(axis=2), EVEN_PERCENT)
    even = (part.astype(np.float32) - black) * (255.0 / max(float(white - black), 1.0))
    moved = [(line - start) * scale for line in view.outline]
    ticks = tuple((clock, (line - start) * scale) for clock, line in view.ticks)
    own = DefectView(view.index, view.shot, tuple(moved), ticks, view.ahead_mm, view.oblique_deg, view.inside)
    return Photograph(own, np.clip(even, 0, 255).astype(np.uint8))


def _inside(pixels: FloatArray, size: tuple[int, int]) -> float:
    """Part of the pixels that lie in a picture."""
    ok = (pixels >= 1).all(axis=1) & (pixels <= np.array(size) - 2).all(axis=1)  # NaN is not
    return float(np.mean(ok))


def _outline(survey: Survey, index: int, shape: Float32Array) -> list[FloatArray]:
    """Closed lines round a defect's cells on the wall, (N, 3) mm each, pipe frame."""
    wall = survey.wall
    mask = (survey.detection.label == index + 1).astype(np.uint8)
    rows = np.flatnonzero(mask.any(axis=1))
    if not len(rows):
        return []
    first = max(int(rows[0]) - 1, 0)
    part = mask[first : rows[-1] + 2]
    free = np.flatnonzero(~part.any(axis=0))
    turn = int(free[0]) if len(free) else 0  # cut open where nothing of it lies
    cell = np.array([wall.z_step_mm, math.radians(wall.clock_step_deg) * wall.mean_radius_mm])
    reach = np.maximum(np.round(CLOSED_MM / cell), 1).astype(int)
    pad = 3 * int(reach.max())
    part = np.pad(np.roll(part, -turn, axis=1), ((pad, pad), (pad, pad)))
    y, x = np.ogrid[-reach[0] : reach[0] + 1, -reach[1] : reach[1] + 1]
    disc = (y / (reach[0] + 0.5)) ** 2 + (x / (reach[1] + 0.5)) ** 2 <= 1
    solid = ndimage.binary_fill_holes(ndimage.binary_closing(part, disc))  # for the eye
    part = (ndimage.gaussian_filter(solid.astype(np.float32), reach / 3) > 0.5).astype(np.uint8)
    contours, _ = cv2.findContours(part, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    out = []
    for contour in contours:
        column, row = (contour[:, 0, k].astype(int) for k in (0, 1))
        keep = slice(None, None, max(1, len(row) // POINTS_MAX))
        row, column = row[keep] + first - pad, (column[keep] - pad + turn) % mask.shape[1]
        row = np.clip(row, 0, len(wall.z_mm) - 1)
        out.append(_points(wall.clock_deg[column], wall.z_mm[row], shape[row, column]))
    return out


def _ticks(survey: Survey, defect: Defect, shape: Float32Array) -> list[tuple[float, FloatArray]]:
    """Short lines along the pipe just behind a defect, one every half hour of the dial about it."""
    reach = min(defect.arc_deg / 2 + TICK_DEG, 180.0)
    begin = math.ceil((defect.clock_deg - reach) / TICK_DEG)
    clocks = [TICK_DEG * k for k in range(begin, math.floor((defect.clock_deg + reach) / TICK_DEG) + 1)]
    wall = survey.wall
    start = defect.z_range_mm[1] + 0.02 * wall.mean_radius_mm
    z = np.array([start, start + 0.06 * wall.mean_radius_mm])
    row = np.clip(np.searchsorted(wall.z_mm, z), 0, len(wall.z_mm) - 1)
    out = []
    for clock in clocks[: round(360 / TICK_DEG)]:
        column = int(clock % 360.0 / wall.clock_step_deg) % len(wall.clock_deg)
        out.append((clock % 360.0, _points(np.full(2, clock), z, shape[row, column])))
    return out


def _points(clock_deg: FloatArray, z_mm: FloatArray, radius_mm: FloatArray) -> FloatArray:
    t, r = np.radians(clock_deg), np.asarray(radius_mm, dtype=np.float64)
    return np.stack([r * np.sin(t), -r * np.cos(t), z_mm], axis=-1)
