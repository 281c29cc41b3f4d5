"""The image seen along straight lines from the pattern's centre: where each sample lies and which ray it is."""

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.jit import jit
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.vocabulary import AnnulusError

# What a line keeps (ACROSS, WEAK, RAISED_MOST) is measured by topics uncertainty and colour; what is left out unseen
# (PROBE, LIT) by the points that colour counts; RAY_STEP_PX by test_slits; the search by test_slits, few_rings, mirror.
ACROSS = 0.85  # standard deviation, in directions, of the average over neighbouring lines: weights 1, 2, 1
PROBE_LINES = 24  # how coarse the first look at a frame is: every so many lines ..
PROBE_PX = 6  # .. and samples
LIT = 0.02  # light is more than this part of the bright level
LIT_MARGIN = 12  # samples kept around it
WEAK = 2.5  # a channel so many times weaker than the strongest is raised ..
RAISED_MOST = 4.0  # .. by so much at most: noise is raised with it
RAY_STEP_PX = 4  # rays are tabulated this often: linear interpolation between is good to 5e-6 rad
TILT = math.radians(4.0)  # how far the head may lean and ..
SHIFT = 0.1  # .. stand off the pipe's axis (of the radius) for its rings to be searched
DENT = 0.75  # of the radius: how far inside the wall may be ..
BULGE = 1.3  # .. and outside


@dataclass(frozen=True, slots=True, eq=False)
class PolarGrid:
    """Sample (j, i) lies at `centre + (first + step i) * (cosine[j], sine[j])`, whole steps of one image pixel.

    Nothing is undistorted: the lens is folded into `rays`, tabulated for every fourth sample, so that the image is
    read once, where it is sharp, and a position along a line turns into a ray by interpolation. Lines run from the
    innermost ring to the outermost: outwards, but for a mirror that turns their order about (`camera.Mirror`).
    """

    centre: tuple[float, float]
    first: float
    step: int  # 1 or -1
    cosine: NDArray[np.float64]  # (J,) direction j runs along (cosine, sine) in image x, y
    sine: NDArray[np.float64]
    stop: NDArray[np.int64]  # (J,) samples inside the image and inside what the lens model can invert
    rays: NDArray[np.float32]  # (J, L / RAY_STEP_PX + 1, 3) unit vectors, camera frame; single, to stay in the cache
    origins: NDArray[np.float32] | None  # the same shape, mm, where the rays start; None: all in the camera's centre
    map_xy: NDArray[np.int16]  # (J + 2, L, 2) cv2's fixed-point map: SIMD, half the time of a float map, 1/32 px;
    map_part: NDArray[np.uint16]  # (J + 2, L) it begins with the last line and ends with the first, for averages
    spacing_px: float  # least distance between two neighbouring rings in a clean pipe

    def pixels(self, direction: NDArray[np.int64], position: FloatArray) -> FloatArray:
        """(N,) lines, (N,) samples along them -> (N, 2) places in the image."""
        away = self.first + self.step * position
        way = np.stack([self.cosine[direction], self.sine[direction]], axis=1)
        return np.asarray(self.centre + away[:, None] * way)


def polar_grid(calibration: Calibration, directions: int, usual: Pose = Pose()) -> PolarGrid:  # noqa: B008
    """Lay the grid where this calibration's rings can appear, for `directions` lines around the pattern's centre.

    usual : the pipe as the camera sees it when the head stands as it should."""
    camera, radius = calibration.camera, calibration.pipe_radius_mm
    nominal = [ring_pixels(camera, cone, usual, radius) for cone in calibration.rings]
    if not all(np.isfinite(curve).any() for curve in nominal):
        raise AnnulusError("calibration: a ring of the pattern is nowhere in the image; check pipe.radius_mm and rings")
    middle = np.array([(np.nanmin(curve, axis=0) + np.nanmax(curve, axis=0)) / 2 for curve in nominal])
    centre = middle.mean(axis=0)
    leaning = [
        Pose(usual.rx + a, usual.ry + b, usual.tx + c, usual.ty + d)
        for a, b, c, d in np.vstack([np.eye(4), -np.eye(4)]) * [TILT, TILT, *[SHIFT * radius] * 2]
    ]
    inner = [ring_pixels(camera, calibration.rings[0], pose, radius) for pose in leaning]
    inner.append(ring_pixels(camera, calibration.rings[0], usual, BULGE * radius))
    outer = [ring_pixels(camera, calibration.rings[-1], pose, radius) for pose in leaning]
    outer.append(ring_pixels(camera, calibration.rings[-1], usual, DENT * radius))
    reach = [np.linalg.norm(np.vstack(curves) - centre, axis=1) for curves in (inner, outer)]
    mean_radii = [float(np.nanmedian(np.linalg.norm(curve - centre, axis=1))) for curve in nominal]
    spacing = float(np.min(np.abs(np.diff(mean_radii)))) if len(mean_radii) > 1 else mean_radii[0] / 4
    if spacing < 3.0:
        raise AnnulusError(f"calibration: rings lie {spacing:.1f} px apart in the image, expected at least 3")
    if camera.reversed:
        reach.reverse()
    first = max(2.0, math.floor(np.nanmin(reach[0]) - spacing))
    last = math.ceil(np.nanmax(reach[1]) + spacing)
    return lay_grid(camera, centre, first, last, spacing, directions)


def lay_grid(
    camera: Camera, centre: FloatArray, first: float, last: float, spacing: float, directions: int
) -> PolarGrid:
    """Lines around `centre` (2,) between `first` and `last` px of it, for rings at least `spacing` px apart."""
    phi = np.arange(directions) * (2 * math.pi / directions)
    cosine, sine = np.cos(phi), np.sin(phi)
    inside = _length_inside(camera, centre, cosine, sine, first, last)
    step = -1 if camera.reversed else 1
    # a line that runs inwards must start inside the image; beside the mirror its rays stay NaN, and make no points
    length = int(np.min(inside) if camera.reversed else np.max(inside))
    if length < 16:
        raise AnnulusError("calibration: the pattern's centre lies outside the image; check camera.cx, camera.cy")
    stop = np.minimum(inside, length)
    first = first if step > 0 else first + length
    nodes = first + step * np.arange(0, length + 2 * RAY_STEP_PX, RAY_STEP_PX)
    pixels = centre + nodes[None, :, None] * np.stack([cosine, sine], axis=1)[:, None, :]
    origins, rays = (part.reshape(directions, len(nodes), 3) for part in camera.lines(pixels.reshape(-1, 2)))
    if step > 0:
        good = np.cumprod(np.isfinite(rays.sum(axis=2)), axis=1).sum(axis=1)  # nodes before the first bad one
        stop = np.clip(np.minimum(stop, (good - 1) * RAY_STEP_PX), 0, None)
        origins, rays = np.nan_to_num(origins), np.nan_to_num(rays)
    away = first + step * np.arange(length)
    x, y = (centre[axis] + away * way[:, None] for axis, way in enumerate((cosine, sine)))
    closed = np.arange(-1, directions + 1) % directions
    maps = cv2.convertMaps(x[closed].astype(np.float32), y[closed].astype(np.float32), cv2.CV_16SC2)
    map_xy, map_part = np.asarray(maps[0], np.int16), np.asarray(maps[1], np.uint16)
    return PolarGrid(
        (float(centre[0]), float(centre[1])),
        first,
        step,
        cosine,
        sine,
        stop,
        rays.astype(np.float32),
        None if camera.central else origins.astype(np.float32),
        map_xy,
        map_part,
        spacing,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Unrolled:
    """One frame along the grid's lines: the strongest of its channels, for where slits are; their colours stay in the
    image and are read only where slits were found."""

    image: NDArray[np.uint8]  # (H, W, 3) BGR, as it came
    top: NDArray[np.uint8]  # (J, B - A) samples A .. B of every line; outside of them nothing is lit
    first: int  # A
    bright: float  # the frame's bright level and ..
    noise: float  # .. the noise of `top`, grey levels


def unroll(image: NDArray[np.uint8], grid: PolarGrid) -> Unrolled:
    """Lay a frame (H, W, 3) out: one row a direction, one column a pixel's step along it.

    The strongest channel is taken in the image, so that one plane is interpolated and not three. That pass also fetches
    the frame in the order of memory: a fresh one is in no cache, and lines that cross its rows would wait for nearly
    every sample. A channel that the wall's paint swallows (blue, on a yellow pipe) is raised for this, black taken off,
    or its stripes would be darkness beside the others.

    Each line is averaged with its two neighbours: less noise where stripes are dim, and nothing is lost along the line,
    where a slit's place is read. Wider averages would carry light into the shadows of rods.
    """
    image = np.ascontiguousarray(image)
    height, width = image.shape[:2]
    black, gain, start, stop = _lit(image, grid.map_xy, grid.stop)
    plane = np.empty((height, width), np.uint8)
    ends = grid.first + grid.step * start, grid.first + grid.step * stop
    _strongest(image.reshape(-1), width, *grid.centre, min(ends) - 3.0, max(ends) + 3.0, black, gain, plane.reshape(-1))
    part = (slice(None), slice(start, stop))
    lines = cv2.remap(plane, grid.map_xy[part], grid.map_part[part], cv2.INTER_LINEAR)
    top = np.asarray(cv2.GaussianBlur(lines, (1, 3), sigmaX=1.0, sigmaY=ACROSS)[1:-1], np.uint8)
    return Unrolled(image, top, start, *_level(top, grid.stop - start))


@jit
def _lit(image, map_xy, stop):  # type: ignore[no-untyped-def]
    """What a coarse look at the frame says: (3,) black levels, (3,) gains in 1/64, and the samples from where to where
    there is light. A slit has light on both sides, so there is none outside."""
    lines, length = (len(stop) + PROBE_LINES - 1) // PROBE_LINES, map_xy.shape[1]
    seen = np.zeros((lines, length // PROBE_PX + 1, 3), np.uint8)
    counted = np.zeros((3, 256), np.int64)
    for line in range(lines):
        for n in range((stop[line * PROBE_LINES] + PROBE_PX - 1) // PROBE_PX):
            x, y = map_xy[line * PROBE_LINES + 1, n * PROBE_PX]
            for c in range(3):
                seen[line, n, c] = image[y, x, c]
                counted[c, image[y, x, c]] += 1
    black, gain, light = np.zeros(3, np.int32), np.full(3, 64, np.int32), np.empty(3)
    for c in range(3):
        black[c] = _rank(counted[c], 0.02)
        light[c] = max(_rank(counted[c], 0.97) - black[c], 1)
    most = light.max()
    for c in range(3):
        if most / light[c] > WEAK:
            gain[c] = np.int32(np.rint(64 * min(most / light[c], RAISED_MOST)))
        else:
            black[c] = 0
    # one sample brighter than the limit is noise, one together with the next is light
    limit, first, last = int(64 * max(LIT * most, 2.0)), length, 0
    for line in range(lines):
        before = False
        for n in range((stop[line * PROBE_LINES] + PROBE_PX - 1) // PROBE_PX):
            lit = False
            for c in range(3):
                lit |= (np.int32(seen[line, n, c]) - black[c]) * gain[c] > limit
            if lit and before:
                first, last = min(first, (n - 1) * PROBE_PX), max(last, n * PROBE_PX)
            before = lit
    first = max(min(first - LIT_MARGIN, length - 16), 0)
    return black, gain, first, max(min(last + LIT_MARGIN, length), first + 16)


@jit
def _level(top, stop):  # type: ignore[no-untyped-def]
    """The frame's bright level and noise in grey levels, from every 24th line and every third sample along it."""
    levels, steps = np.zeros(256, np.int64), np.zeros((256, 256), np.int32)  # the step from the sample before, by level
    size = 0
    for j in range(0, len(stop), 24):
        for i in range(1, min(stop[j], top.shape[1]), 3):
            value = np.int64(top[j, i])
            levels[value] += 1
            steps[value, abs(value - np.int64(top[j, i - 1]))] += 1
            size += 1
    if not size:
        return 0.0, 0.0
    # the darker half of the samples holds few edges; a step of n is anything up to n
    half, step = _rank(levels, 0.5) + 1, np.zeros(256, np.int64)
    for level in range(half):
        for n in range(256):
            step[n] += steps[level, n]
    at = _rank(step, 0.5)
    middle = at - 0.5 + (0.5 * step.sum() - step[:at].sum()) / step[at]
    return float(_rank(levels, 0.95)), SIGMA_OF_MAD / math.sqrt(2) * max(middle, 0.0)


@jit
def _rank(counted, part):  # type: ignore[no-untyped-def]
    """The level below or at which that part of what was counted lies."""
    total, level, wanted = counted[0], 0, part * counted.sum()
    while total < wanted:
        level += 1
        total += counted[level]
    return level


def ring_pixels(camera: Camera, cone: Cone, pose: Pose, radius_mm: float, steps: int = 180) -> FloatArray:
    """(steps, 2) image positions of one ring on a clean pipe; NaN where the light misses the wall or the camera."""
    axis = np.asarray(cone.axis)
    across = np.cross(axis, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    up = np.cross(axis, across)
    a = np.arange(steps)[:, None] * (2 * math.pi / steps)
    light = math.cos(cone.half_angle) * axis + math.sin(cone.half_angle) * (np.cos(a) * across + np.sin(a) * up)
    start, way = pose.to_pipe(np.array([cone.vertex_mm]))[0], light @ pose.rotation
    qa, qb, qc = (way[:, :2] ** 2).sum(axis=1), way[:, :2] @ start[:2], start[:2] @ start[:2] - radius_mm**2
    with np.errstate(divide="ignore", invalid="ignore"):
        s = (-qb + np.sqrt(qb * qb - qa * qc)) / qa
    pixels = camera.project(pose.to_camera(start + np.where(s > 0, s, np.nan)[:, None] * way))
    size = np.array([camera.width - 1.0, camera.height - 1.0])
    inside = np.all((pixels >= 0) & (pixels <= size), axis=1)
    return np.where(inside[:, None], pixels, np.nan)


def _length_inside(
    camera: Camera, centre: FloatArray, cosine: FloatArray, sine: FloatArray, first: float, last: float
) -> NDArray[np.int64]:
    """(J,) how many whole steps from `first` stay a pixel inside the image, at most to `last`."""
    reach = np.full(len(cosine), last)
    for way, at, size in ((cosine, centre[0], camera.width), (sine, centre[1], camera.height)):
        with np.errstate(divide="ignore"):
            edge = np.where(way > 0, size - 2.0 - at, 1.0 - at) / np.where(np.abs(way) > 1e-12, way, np.nan)
        reach = np.fmin(reach, edge)
    return np.maximum(np.floor(reach - first), 0).astype(np.int64)


@jit
def _strongest(image, width, cx, cy, inner, outer, black, gain, out):  # type: ignore[no-untyped-def]
    """max(B, G, R) of the pixels between two circles, image and plane as runs of bytes."""
    height = len(out) // width
    raised = gain[0] != 64 or gain[1] != 64 or gain[2] != 64
    for y in range(height):
        far = outer * outer - (y - cy) * (y - cy)
        if far <= 0:
            continue
        half = math.sqrt(far)
        hole = math.sqrt(max(inner * inner - (y - cy) * (y - cy), 0.0)) if inner > 0 else 0.0
        for side in range(2):
            a = max(int(cx - half), 0) if side == 0 else max(int(cx + hole), 0)
            b = min(int(cx - hole) + 2, width) if side == 0 else min(int(cx + half) + 2, width)
            if b <= a:
                continue
            source = image[3 * (y * width + a) : 3 * (y * width + b)]
            row = out[y * width + a : y * width + b]
            if raised:
                for x in range(b - a):
                    top = 0
                    for c in range(3):
                        top = max(top, (np.int32(source[3 * x + c]) - black[c]) * gain[c])
                    row[x] = min(top >> 6, 255)
            else:
                for x in range(b - a):
                    row[x] = max(max(source[3 * x], source[3 * x + 1]), source[3 * x + 2])
