"""Rings followed round an image whose geometry is not known yet: by order and colour, then by their own course."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.rings.decode import NONE, classify, decode, readings
from annulus_pipe.rings.lines import find_lines, name_lines
from annulus_pipe.rings.pedestal import without_pedestal
from annulus_pipe.rings.polar import PolarGrid, lay_grid, unroll
from annulus_pipe.rings.slits import Slits, find_slits

# By topic calibrate_scene (errors of angle and vertex against what is stated) and test_pipe; WANDER and STRAY by
# the targets of topic intrinsics, too, where print has false slits.
DIRECTIONS = 720
GUESS_PX = 24.0  # ring spacing taken for granted in the first look; only the smoothing depends on it
INNERMOST_PX = 8.0  # from the centre, where lines begin
AROUND = 8  # directions on each side that a ring's course is the median of ..
COURSE_LEAST = 3  # .. where so many of them show it
WANDER = 0.5  # of the way to the next ring: a slit farther from its ring's course is another's
STRAY = 5.0  # sigma off the course: farther is no slit of the ring ..
STRAY_PX = 2.0  # .. but px at least
NARROW = 0.75  # of the ring's usual width around there: a narrower slit is half covered ..
WIDE = 1.3  # .. and a wider one part of a shadow
STRONG = 0.5  # of the usual line: what is counted in the first look at bright lines
LEAST = 0.15  # of the directions must show a ring for its course to be drawn
FULL = 250  # grey level that is full scale, give or take JPEG
BESIDE_PX = 3.0  # beyond a slit's edges, where it is looked for
WHOLE = 0.3  # of a ring's slits in a frame: with so many between stripes that are not over-exposed, the others go

_course_medians = door("course_medians", "f8[k,j] curve", "i8 around_each", "i8 least_there", "f8[k,j]! out")


@dataclass(frozen=True, slots=True, eq=False)
class Contours:
    """The slits of one frame that are known rings. Positions are the slits' middles, as everywhere."""

    ring: NDArray[np.int64]  # (N,)
    pixels: FloatArray  # (N, 2)
    width: FloatArray  # (N,) px
    clipped: NDArray[np.bool_]  # (N,) a stripe beside it is over-exposed
    reach: FloatArray  # (K, 3) px from the centre: least, median and most of each ring; NaN where it is not seen
    middle: FloatArray  # (2,) px, of the rings
    slits: int  # seen, ring or not
    centre: tuple[float, float]  # of the lines they were found on

    def whole(self) -> "Contours":
        """Without slits beside over-exposed stripes, ring by ring, where enough of the ring is left: full scale cuts
        off half an edge, and moves a slit by up to a quarter of a pixel, on the pipe's nearer side only."""
        kept = ~self.clipped
        for k in range(len(self.reach)):
            mine = self.ring == k
            if np.count_nonzero(mine & kept) < WHOLE * np.count_nonzero(mine):
                kept |= mine
        return replace(
            self, ring=self.ring[kept], pixels=self.pixels[kept], width=self.width[kept], clipped=self.clipped[kept]
        )


def wide_grid(camera: Camera, centre: FloatArray) -> PolarGrid:
    """Lines from `centre` (2,) px to the corners of the image, for a first look."""
    size = np.array([camera.width, camera.height])
    last = float(np.linalg.norm(np.maximum(np.abs(centre), np.abs(size - centre))))
    return lay_grid(camera, centre, INNERMOST_PX, last, GUESS_PX, DIRECTIONS)


def close_grid(camera: Camera, contours: list[Contours]) -> PolarGrid:
    """Lines around the rings that a first look found, as `polar_grid` lays them: the detector then sees what it will
    see when it measures."""
    centre = np.median([contour.middle for contour in contours], axis=0)
    reach = np.array([contour.reach for contour in contours])
    reach = reach[:, np.isfinite(reach[:, :, 1]).any(axis=0)]  # rings seen at all
    usual = np.nanmedian(reach[:, :, 1], axis=0)
    gaps = np.abs(np.diff(usual))
    spacing = max(3.0, float(gaps.min())) if len(gaps) else float(np.nanmedian(usual)) / 4
    off = float(max(np.linalg.norm(contour.middle - centre) for contour in contours))
    first = max(2.0, math.floor(float(np.nanmin(reach)) - spacing - off))
    last = math.ceil(float(np.nanmax(reach)) + spacing + off)
    return lay_grid(camera, centre, first, last, spacing, DIRECTIONS)


def follow(image_bgr: NDArray[np.uint8], grid: PolarGrid, colours: str) -> Contours:
    """The rings of one frame, poses and cones unknown.

    A line is read by the order of its colours alone (`decode` with a wall that deviates nowhere). What that leaves
    unread or reads wrong, a ring's own course round the image mends: the running median of its slits.
    """
    slits = find_slits(unroll(without_pedestal(image_bgr, grid.spacing_px), grid), grid)
    both = classify(np.vstack([slits.inside, slits.outside]), colours)
    inside, outside = both[: len(slits.position)], both[len(slits.position) :]
    allowed = readings(inside, outside, colours)
    shape = len(colours) - 1, len(grid.cosine)
    ring = decode(slits.direction, inside, outside, np.where(allowed, 0.0, np.nan), colours, 1.0)
    for _ in range(2):
        course = _course(ring, slits.direction, slits.position, shape)
        stray = (slits.position - course[:, slits.direction]).T
        gap = _gap(course, grid.spacing_px)[:, slits.direction].T
        ring = decode(slits.direction, inside, outside, np.where(allowed, stray / gap, np.nan), colours, WANDER / 0.65)
    return _kept(image_bgr, grid, slits, ring, stray)


def follow_lines(image_bgr: NDArray[np.uint8], grid: PolarGrid, rings: int) -> Contours:
    """The same of a frame of so many bright lines, one colour: first where a polar line shows just so many strong ones,
    then by each ring's own course."""
    lines, strength = find_lines(image_bgr, grid)
    shape = rings, len(grid.cosine)
    strong = np.flatnonzero(strength > STRONG)
    _, first, count = np.unique(lines.direction[strong], return_index=True, return_counts=True)
    ring = np.full(len(lines.position), NONE, np.int64)
    for k in range(rings):
        ring[strong[first[count == rings] + k]] = k
    stray = np.full((len(ring), rings), np.nan)
    for _ in range(2):
        course = _course(ring, lines.direction, lines.position, shape)
        stray = (lines.position - course[:, lines.direction]).T
        ring = name_lines(
            lines.direction, strength, stray / _gap(course, grid.spacing_px)[:, lines.direction].T, WANDER
        )
    return _kept(image_bgr, grid, lines, ring, stray)


def _kept(
    image_bgr: NDArray[np.uint8], grid: PolarGrid, slits: Slits, ring: NDArray[np.int64], stray: FloatArray
) -> Contours:
    """Of named slits those that follow their ring's course, (N, K) px off it, and are about as wide."""
    shape = stray.shape[1], len(grid.cosine)
    named = np.flatnonzero(ring != NONE)
    off = np.abs(stray[named, ring[named]])
    spread = np.array([np.median(off[ring[named] == k]) if (ring[named] == k).any() else 0.0 for k in range(shape[0])])
    usual = _course(ring, slits.direction, slits.width, shape)[ring[named], slits.direction[named]]
    with np.errstate(invalid="ignore"):
        ratio = slits.width[named] / np.maximum(usual, 0.5)
        most = np.maximum(STRAY * SIGMA_OF_MAD * spread[ring[named]], STRAY_PX)
        good = (off <= most) & (ratio > NARROW) & (ratio < WIDE)
    kept = named[good]
    return _contours(image_bgr, grid, slits, ring[kept], kept, shape[0])


@dataclass(frozen=True, slots=True)
class Look:
    """What the frames of a head show, in words too, and how its rings are followed round one."""

    rings: int
    what: str
    marks: str
    colours: str  # empty for bright lines
    follow: Callable[[NDArray[np.uint8], PolarGrid], Contours]

    @classmethod
    def of_slits(cls, colours: str) -> "Look":
        return cls(
            len(colours) - 1, f"rings of {colours}", "slits", colours, lambda image, grid: follow(image, grid, colours)
        )

    @classmethod
    def of_lines(cls, rings: int) -> "Look":
        what = f"{rings} bright line{'s' if rings > 1 else ''}"
        return cls(rings, what, "lines", "", lambda image, grid: follow_lines(image, grid, rings))


def read_colours(image_bgr: NDArray[np.uint8], grid: PolarGrid) -> str:
    """The stripes of a frame from the innermost outwards as they look, whatever the pattern should be; "?" unclear."""
    slits = find_slits(unroll(without_pedestal(image_bgr, grid.spacing_px), grid), grid)
    both = classify(np.vstack([slits.inside, slits.outside]), "RGB")
    inside, outside = both[: len(slits.position)], both[len(slits.position) :]
    count = np.bincount(slits.direction, minlength=len(grid.cosine))
    usual = int(np.bincount(count[count > 0]).argmax()) if (count > 0).any() else 0
    if not usual:
        return "nothing"
    lines = np.flatnonzero(count == usual)
    first = np.searchsorted(slits.direction, lines)

    def most(values: NDArray[np.uint8]) -> str:
        counted = np.bincount(values[values < 3], minlength=3)
        return "RGB"[int(counted.argmax())] if counted.max() > 0.6 * len(values) else "?"

    return most(inside[first]) + "".join(most(outside[first + n]) for n in range(usual))


def _course(
    ring: NDArray[np.int64], direction: NDArray[np.int64], values: FloatArray, shape: tuple[int, int]
) -> FloatArray:
    """(K, J) running median of each ring's values round the image, gaps bridged; NaN for a ring hardly seen."""
    curve = np.full(shape, np.nan)
    named = np.flatnonzero(ring != NONE)
    curve[ring[named], direction[named]] = values[named]
    out = np.full(shape, np.nan)
    _course_medians(curve, AROUND, COURSE_LEAST, out)
    lines = np.arange(shape[1])
    for k in range(shape[0]):
        seen = np.flatnonzero(np.isfinite(out[k]))
        if np.isfinite(curve[k]).sum() < LEAST * shape[1]:
            out[k] = np.nan
        elif len(seen) < shape[1]:
            out[k] = np.interp(lines, seen, out[k, seen], period=shape[1])
    return out


def _gap(course: FloatArray, spacing: float) -> FloatArray:
    """(K, J) distance from each ring's course to the nearer neighbour's along the same line."""
    steps = np.abs(np.diff(course, axis=0))
    padded = np.pad(steps, ((1, 1), (0, 0)), constant_values=np.nan)
    gap = np.fmin(padded[:-1], padded[1:])
    return np.where(np.isfinite(gap), np.maximum(gap, 3.0), spacing)


def _contours(
    image_bgr: NDArray[np.uint8],
    grid: PolarGrid,
    slits: Slits,
    ring: NDArray[np.int64],
    kept: NDArray[np.int64],
    rings: int,
) -> Contours:
    pixels = grid.pixels(slits.direction[kept], slits.position[kept])
    away = np.linalg.norm(pixels - np.asarray(grid.centre), axis=1)
    reach, middles = np.full((rings, 3), np.nan), []
    for k in range(rings):
        mine = np.flatnonzero(ring == k)
        if len(mine) >= LEAST * len(grid.cosine):
            reach[k] = np.percentile(away[mine], [0.5, 50, 99.5])
            # of opposite slits, so that a gap on one side does not pull it
            turn = np.zeros(len(grid.cosine), bool)
            turn[slits.direction[kept[mine]]] = True
            both = mine[np.roll(turn, len(turn) // 2)[slits.direction[kept[mine]]]]
            if len(both):
                middles.append(pixels[both].mean(axis=0))
    middle = np.mean(middles, axis=0) if middles else np.asarray(grid.centre)
    clipped = np.zeros(len(kept), bool)
    for way in (-1.0, 1.0):
        beside = grid.pixels(slits.direction[kept], slits.position[kept] + way * (slits.width[kept] / 2 + BESIDE_PX))
        x, y = np.clip(np.rint(beside).astype(int), 0, np.array(image_bgr.shape[1::-1]) - 1).T
        clipped |= image_bgr[y, x].max(axis=1) >= FULL
    return Contours(ring, pixels, slits.width[kept], clipped, reach, middle, len(slits.position), grid.centre)
