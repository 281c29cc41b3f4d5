"""Grooves across the line of sight, as narrow as the lens's blur: their depth from what light does in one.

A head in a pipe sees the wall aslant. The near rim of a groove shades a part of its floor, more the deeper it is; its
far wall stands in full light; and the blur mixes both with the wall about them, so that a cell's own fit reads a
mixture. Here a cross-section is fitted whole, in the plane of the axis, where camera and lamp lie too:

    wall | groove from a to b, depth d, steep walls, flat floor | wall

Each line of sight ends on wall, floor or far wall, and what it meets is lit by the slide or shaded by a rim; the blur
then runs over all of it, and albedo is free along the wall. What a frame does not see of a floor says nothing, so a
floor that no frame sees leaves its depth undetermined, and the map's own reading remains as the lower limit it is.

A groove with a round floor is fitted as the steep one most like it, whose depth is 0.92 of its middle's, and a V's is
0.8: what is left of the frames hardly tells them apart, so sigma has a share of every depth. Grooves along the pipe
need none of this: there the lens sees both rims alike.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage, optimize
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import TUKEY, biweight, robust_sigma
from annulus_pipe.wings.fringe.measure.bore import FRAMES, HeadFrames
from annulus_pipe.wings.fringe.measure.placement import EyeFrames, PlacedHead

STARTS = 4.0  # sigma above which a cell is part of a loss
NARROW_BLURS = 6.0  # sigma of the blur: it widens a loss by two each way, and two must lie between to show a floor
STRAIGHT = 0.9  # cosine: a camera that looks along the pipe
ACROSS_OF_RADIUS = 0.1  # camera or lamp beside the plane of a cross-section: what a rim hides is then off by 1 %
MARGIN_BLURS = 5.0  # of wall on either side
FRAMES_LEAST = 4
UNKNOWNS = 6  # edges, depth, the wall's own height, modulation, blur
SETTLED = 1e-3  # of the misfit, where rounds end
DEEPEST = 10.0  # cells
SCALE = np.array([0.05, 0.05, 0.05, 0.01, 0.02, 0.02])  # of their differences: four in cells
BLUR_KNOWN = 40.0  # sigma: below, slopes of albedo are noise for the most part, and the blur reads small
BLUR_SIGMA = 0.03  # of the head's blur over itself, known from texture
ALBEDO = 0.15  # of itself, from one cell to the next
BESIDE = 2  # columns either way that share a depth
FITTED = 3  # of those, at least
MODEL = 0.06  # of a depth: a round floor lies 8 % deeper in its middle than the steep groove most like it, a V 20 %
LIT_BLURS = 1.2  # of floor: less cannot be told from its far wall's light
TOLD = 0.25  # sigma of a depth over itself: more is not told
ROWS_LEAST = 2  # of a loss
DEEPER = (1.0, 2.5)  # than the map reads, where fits begin
RIVAL = 9.0  # of chi^2 between two depths: less decides nothing

_light_of_cut = door(
    "fringe_light_of_cut",
    "f8[k,s] slide",
    "f8[k,3,4] projectors",
    "f8[k,2] sight",
    "f8[k,2] lamp",
    "f8[3] normal",
    "f8 radius",
    "f8 z0",
    "f8 step",
    "f8 a",
    "f8 b",
    "f8 deep",
    "f8 off",
    "f8 modulation",
    "f8[k,j] depth",
    "f8[k,j] gain",
    "f8[k,j] blur",
    "f8[k,j,j]! out",
    "f8[j,j]! room",
    "f8[j]! taps",
)
_look_at_cut = door(
    "fringe_look_at_cut",
    *FRAMES,
    "f8[n,3,4] projectors",
    "f8[n,s] slide",
    "i8[n] eye",
    "f8[e,3,t] shading",
    "f8 blur_px",
    "f8[3] normal",
    "f8 radius",
    "f8[j] z",
    "f8[n,j]! grey",
    "f8[n,j]! gain",
    "f8[n,j]! depth",
    "f8[n,j]! blur",
)


class Plane(NamedTuple):
    """The plane of a cut, and K frames' light and sight in it, as `light_of_cut` takes them."""

    slide: FloatArray  # (K, S)
    projectors: FloatArray  # (K, 3, 4)
    sight: FloatArray  # (K, 2) mm, z and distance from the axis of the camera, in this plane
    lamp: FloatArray  # (K, 2) likewise of the light
    normal: FloatArray  # (3,) its azimuth
    radius: float  # mm, of the wall
    z0: float  # mm, of the first row
    step: float  # mm, from row to row


@dataclass(frozen=True, slots=True)
class _Cut:
    """A cross-section in K frames. z (J,) of its rows on the wall, mm; grey, weight (its noise, to -1), gain, depth,
    blur (K, J)."""

    plane: Plane
    z: FloatArray
    grey: FloatArray
    weight: FloatArray
    gain: FloatArray
    depth: FloatArray
    blur: FloatArray

    @staticmethod
    def of(
        head: PlacedHead,
        sight: EyeFrames,
        images: Float32Array,
        noise: tuple[float, float, float],
        phi: float,
        radius: float,
        z: FloatArray,
    ) -> "_Cut | None":
        """None where fewer than FRAMES_LEAST frames see it whole, from its own plane."""
        normal = np.array([math.cos(phi), math.sin(phi), 0.0])
        lamps = sight.lamps(radius * normal + [0.0, 0.0, float(np.mean(z))])
        beside = np.array([-normal[1], normal[0], 0.0])
        blur_px = math.sqrt(head.blur_squared)
        grey, gain, depth, blur = look_at_cut(sight.frames(images), head.shading, blur_px, normal, radius, z)
        flat = np.maximum(np.abs(sight.eyes @ beside), np.abs(lamps @ beside)) < ACROSS_OF_RADIUS * radius
        k = np.flatnonzero(np.isfinite(grey).all(axis=1) & flat)
        if len(k) < FRAMES_LEAST:
            return None
        grey = grey[k]
        level = np.maximum(grey, 0.0)
        plane = Plane(
            slide=sight.slide[k],
            projectors=sight.projectors[k],
            sight=np.stack([sight.eyes[k, 2], sight.eyes[k] @ normal], axis=1),
            lamp=np.stack([lamps[k, 2], lamps[k] @ normal], axis=1),
            normal=normal,
            radius=radius,
            z0=float(z[0]),
            step=float(z[1] - z[0]),
        )
        weight = 1.0 / np.sqrt(noise[0] + level * (noise[1] + level * noise[2]))
        return _Cut(plane, z, grey, weight, gain[k], depth[k], blur[k])

    def light(self, p: FloatArray) -> FloatArray:
        """(K J, J): see `light_of_cut`, weighted."""
        out = light_of_cut(self.plane, p[:5], self.depth, self.gain, p[5] * self.blur)
        return np.asarray((out * self.weight[..., None]).reshape(-1, len(self.z)))

    def lit(self, a: float, b: float, deep: float) -> BoolArray:
        """(J,) rows whose floor frames enough see in the light, in a stretch wider than the blur."""
        low, high = np.full(len(self.grey), a), np.full(len(self.grey), b)
        for one in (self.plane.sight, self.plane.lamp):  # a rim hides what lies behind it
            for rim in (a, b):
                shadow = rim + deep * (rim - one[:, 0]) / (self.plane.radius - one[:, 1])
                low, high = (np.maximum(low, shadow), high) if rim == a else (low, np.minimum(high, shadow))
        wide = high - low > LIT_BLURS * self.blur.mean(axis=1)
        free = (self.z > low[:, None]) & (self.z < high[:, None]) & wide[:, None]
        return np.asarray(free.sum(axis=0) >= FRAMES_LEAST)


def light_of_cut(
    plane: Plane, numbers: FloatArray, depth: FloatArray, gain: FloatArray, blur: FloatArray
) -> FloatArray:
    """What K frames show of J rows of a cut, by the rows' albedo: (K, J, J), grey = it @ albedo.

    numbers : edges of the groove, its depth, what the wall lies off the radius, all mm, and the modulation. depth,
    gain, blur : (K, J) of the modulation, of the light, and sigma of the blur on the wall, mm. Albedo is linear between
    rows.
    """
    rows = depth.shape[1]
    out = np.zeros((*depth.shape, rows))
    _light_of_cut(*plane, *numbers, depth, gain, blur, out, np.empty((rows, rows)), np.empty(rows))
    return out


def look_at_cut(
    frames: HeadFrames, shading: FloatArray, blur_px: float, normal: FloatArray, radius: float, z: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(J,) rows of a wall in every frame: grey level, gain and depth of the head's light, sigma of the blur on the
    wall, mm, each (N, J); the grey level is NaN where not seen. The head's depth is that of the blurred light; this one
    is of the light before the lens blurs it."""
    shape = (len(frames.cameras), len(z))
    out = (np.empty(shape), np.empty(shape), np.empty(shape), np.empty(shape))
    seen = (*frames[:4], frames.projectors, frames.slide, frames.eye, shading)
    _look_at_cut(*map(np.ascontiguousarray, seen), blur_px, normal, radius, np.ascontiguousarray(z), *out)
    return out


@dataclass(frozen=True, slots=True)
class _GrooveFit:
    """numbers : as `_Cut.light` takes them; left (K, J): of each look, over its noise; misfit: chi^2."""

    numbers: FloatArray
    covariance: FloatArray
    left: FloatArray
    misfit: float


@dataclass(frozen=True, slots=True)
class _Groove:
    """One column's. rows : of its loss in the map, first and beyond the last; beside : of the wall there, mm outwards
    of the map's radius; numbers : as `_Cut.light` takes them; sigma of the depth, mm."""

    cut: _Cut
    rows: tuple[int, int]
    beside: float
    numbers: FloatArray
    sigma: float

    @property
    def edges(self) -> FloatArray:
        """(2,) mm along."""
        return self.numbers[:2]

    @property
    def depth(self) -> float:
        return float(self.numbers[2])

    @property
    def wall(self) -> float:
        """Mm outwards of the map's radius."""
        return self.beside + float(self.numbers[3])


def measured(
    head: PlacedHead,
    images: Float32Array,
    noise: tuple[float, float, float],
    phi_rad: FloatArray,
    z_mm: FloatArray,
    radius_mm: float,
    height_mm: FloatArray,
    sigma_mm: FloatArray,
    modulation: FloatArray,
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """The (Z, A) heights of a map, mm outwards of radius_mm, and their sigma, with the grooves that could be told in
    them, NaN where no light was seen on a floor; and (Z, A) bool, losses that are lower limits still: narrower along
    the pipe than what their rim hides and the blur fills.

    images : splines as `spline` makes them; modulation : (Z, A) as in `PipeMap`."""
    limits, runs = _narrow_losses(head, z_mm, height_mm, sigma_mm)
    height, sigma = height_mm.copy(), sigma_mm.copy()
    if not head.blur_squared > BLUR_KNOWN * head.blur_sigma or not runs:
        return height, sigma, limits
    sight, share = head.view, float(np.nanmedian(modulation))
    margin = int(
        np.ceil(MARGIN_BLURS * max(_aslant(head, number)[1] for number in range(len(head.eyes))) / (z_mm[1] - z_mm[0]))
    )
    found: dict[int, list[_Groove]] = {}
    for column, top, end in _beside_others(runs, len(phi_rad)):
        rows = slice(max(top - margin, 0), end + margin)
        around = np.concatenate([height_mm[rows.start : top, column], height_mm[end : rows.stop, column]])
        if np.isfinite(around).sum() < margin:
            continue
        wall = float(np.nanmedian(around))
        cut = _Cut.of(head, sight, images, noise, float(phi_rad[column]), radius_mm + wall, z_mm[rows])
        if cut is None:
            continue
        before = [one for one in found.get(column - 1, []) if one.rows[0] < end and top < one.rows[1]]
        deep = float(np.nanmax(height_mm[top:end, column])) - wall
        starts = [np.array([z_mm[top], z_mm[end - 1], more * deep, 0.0, share, 1.0]) for more in DEEPER]
        if before:
            starts[0] = before[0].numbers
        found.setdefault(column, []).append(_groove(cut, (top, end), wall, starts))
    for column, grooves in found.items():
        for one in grooves:
            near = [
                other
                for away in range(-BESIDE, BESIDE + 1)
                for other in found.get((column + away) % len(phi_rad), [])
                if min(other.edges[1], one.edges[1]) > max(other.edges[0], one.edges[0])
            ]
            if len(near) >= FITTED:
                _write(one, near, z_mm, (height[:, column], sigma[:, column], limits[:, column]))
    return height, sigma, limits


def _write(
    one: _Groove, near: list[_Groove], z_mm: FloatArray, column: tuple[FloatArray, FloatArray, BoolArray]
) -> None:
    """A groove, by itself and those in the columns beside it, into its column's height, sigma and limits."""
    height, sigma, limits = column
    depths = np.array([each.depth for each in near])
    depth, (a, b) = float(np.median(depths)), np.median([each.edges for each in near], axis=0)
    own = math.hypot(np.median([each.sigma for each in near]), robust_sigma(depths - depth), MODEL * depth)
    if own > TOLD * depth:
        return
    half = (z_mm[1] - z_mm[0]) / 2
    inside = (z_mm > a) & (z_mm < b)
    lit = np.zeros(len(z_mm), bool)
    lit[np.searchsorted(z_mm, one.cut.z[0] - half) :][: len(one.cut.z)] = one.cut.lit(a, b, depth)
    if not lit.any():
        return
    run = np.zeros(len(z_mm), bool)
    run[slice(*one.rows)] = True
    wall = run & ((z_mm < a - half) | (z_mm > b + half))
    height[wall] = one.wall
    height[inside] = np.where(lit[inside], one.wall + depth, np.nan)
    sigma[inside] = np.where(lit[inside], own, np.nan)
    limits[run] = False
    limits[inside] = ~lit[inside]


def _groove(cut: _Cut, rows: tuple[int, int], wall: float, starts: list[FloatArray]) -> _Groove:
    """The best fit from the starts, then fitted once more with outliers weighted down and the noise scaled to the
    residuals. Where another depth fits as well, sigma is at least the difference between the two."""
    best, *others = sorted((_fitted(cut, start) for start in starts), key=lambda one: one.misfit)
    spread = max(robust_sigma(best.left), 1.0)
    calm = replace(cut, weight=cut.weight / spread * np.sqrt(biweight(best.left / (TUKEY * spread))))
    final = _fitted(calm, best.numbers)
    sigma = math.sqrt(max(final.covariance[2, 2], 0.0))
    for other in others:
        if other.misfit - best.misfit < RIVAL * spread**2:
            sigma = max(sigma, abs(float(other.numbers[2] - best.numbers[2])))
    return _Groove(cut, rows, wall, final.numbers, sigma)


def _fitted(cut: _Cut, start: FloatArray) -> _GrooveFit:
    """The fit that is reached from a start, by least squares; albedo is projected out at every step."""
    low, high, step, rows = float(cut.z[0]), float(cut.z[-1]), cut.plane.step, len(cut.z)
    smooth = np.diff(np.eye(rows), axis=0) / (ALBEDO * float(np.median(cut.grey / cut.gain)))
    grey = np.concatenate([(cut.grey * cut.weight).ravel(), np.zeros(rows - 1)])

    def left(p: FloatArray) -> FloatArray:
        design = np.concatenate([cut.light(p), smooth])
        albedo = np.linalg.solve(design.T @ design, design.T @ grey)
        return np.append(grey - design @ albedo, (p[-1] - 1.0) / BLUR_SIGMA)

    bounds = ([low, low, 0.02 * step, -step, 0.05, 0.5], [high, high, DEEPEST * step, step, 2.0, 2.0])
    scale = SCALE * [step, step, step, step, 1.0, 1.0]

    def slopes(p: FloatArray) -> FloatArray:
        here, ways = left(p), np.diag(np.where(p + scale < bounds[1], scale, -scale))
        return np.stack([(left(p + way) - here) / way.sum() for way in ways], axis=1)

    start = np.clip(start, np.add(bounds[0], scale / 2), np.subtract(bounds[1], scale / 2))
    found = optimize.least_squares(left, start, slopes, bounds, x_scale=scale, ftol=SETTLED, xtol=SETTLED / 100)
    scatter = max(2.0 * float(found.cost) / (cut.grey.size - rows - UNKNOWNS), 1.0)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * scatter
    return _GrooveFit(found.x, covariance, found.fun[: cut.grey.size].reshape(cut.grey.shape), 2.0 * float(found.cost))


def _narrow_losses(
    head: PlacedHead, z_mm: FloatArray, height: FloatArray, sigma: FloatArray
) -> tuple[BoolArray, list[tuple[int, int, int]]]:
    """(Z, A) cells of losses that are narrower along the pipe than what their rim hides and the blur fills; and these,
    column by column: column, first row, row beyond the last."""
    outer = height - np.nanmedian(height)
    with np.errstate(invalid="ignore"):
        deep = (outer > STARTS * sigma) & (outer > STARTS * robust_sigma(outer[np.isfinite(outer)]))
    runs, count = ndimage.label(deep, structure=[[0, 1, 0], [0, 1, 0], [0, 1, 0]])
    if not count:
        return np.zeros(height.shape, bool), []
    size = np.bincount(runs.ravel(), minlength=count + 1) * (z_mm[1] - z_mm[0])
    depth = np.zeros(count + 1)
    np.maximum.at(depth, runs.ravel(), np.where(deep, outer, 0.0).ravel())
    hidden, blur = (
        max(each) for each in zip(*(_aslant(head, number) for number in range(len(head.eyes))), strict=True)
    )
    narrow = size < depth * hidden + NARROW_BLURS * blur
    narrow[0] = False
    places = [one for one, is_narrow in zip(ndimage.find_objects(runs), narrow[1:], strict=True) if is_narrow]
    return np.asarray(narrow[runs]), [(one[1].start, one[0].start, one[0].stop) for one in places]


def _beside_others(runs: list[tuple[int, int, int]], columns: int) -> list[tuple[int, int, int]]:
    """Runs of at least ROWS_LEAST rows that overlap, in the columns beside them, with FITTED runs or more, themselves
    included."""
    by: dict[int, list[tuple[int, int, int]]] = {}
    for run in runs:
        if run[2] - run[1] >= ROWS_LEAST:
            by.setdefault(run[0], []).append(run)
    out = []
    for column, top, end in (run for each in by.values() for run in each):
        near = [other for away in range(-BESIDE, BESIDE + 1) for other in by.get((column + away) % columns, [])]
        if sum(min(other[2], end) > max(other[1], top) for other in near) >= FITTED:
            out.append((column, top, end))
    return sorted(out)


def _aslant(head: PlacedHead, number: int) -> tuple[float, float]:
    """How far along the pipe a rim hides the wall behind it from an eye's lamp, per mm of depth, and what the lens's
    blur spans there, mm: both in the middle of the wall it sees."""
    eye, middle = head.eyes[number], head.radius_mm
    turn = np.array(eye.camera.rotation)
    centre = -np.array(eye.camera.translation_mm) @ turn
    out = turn[2, :2] if np.hypot(*turn[2, :2]) > 1 - STRAIGHT else np.array([1.0, 0.0])
    normal = np.array([*out / np.hypot(*out), 0.0])
    spot = middle * normal + [0.0, 0.0, head.shading[number, 0, 0]]
    to_lamp, to_eye = spot - eye.projector.lamp(spot), spot - centre
    hidden = abs(to_lamp[2]) / float(to_lamp @ normal)
    blur = np.sqrt(head.blur_squared) * float(to_eye @ to_eye) / (float(to_eye @ normal) * eye.camera.camera.fx)
    return hidden, blur
