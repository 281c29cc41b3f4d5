"""The image seen along straight lines from the pattern's centre: where each sample lies and which ray it is."""

import math
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus.geometry.calibration import Calibration
from annulus.geometry.camera import Camera
from annulus.geometry.cone import Cone
from annulus.geometry.pose import FloatArray, Pose
from annulus.rings.compiled import compiled
from annulus.vocabulary import AnnulusError

ACROSS = 0.85  # standard deviation, in directions, of the average over neighbouring lines: weights 1, 2, 1
SECTORS = 8  # the image's part under one of them fits a core's second cache
CACHE_LINE = 64  # bytes
RAY_STEP_PX = 2  # rays are tabulated this often: linear interpolation between is good to 1e-6 rad
TILT = math.radians(4.0)  # how far the head may lean and ..
SHIFT = 0.1  # .. stand off the pipe's axis (of the radius) for its rings to be searched
DENT, BULGE = 0.75, 1.3  # and how far the wall may be from its radius


@dataclass(frozen=True, slots=True, eq=False)
class Sector:
    """Neighbouring lines, and which bytes of the image they read: one run in each image row they cross."""

    lines: slice  # of the grid's map
    starts: NDArray[np.int64]
    stops: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PolarGrid:
    """Sample (j, i) lies at `centre + (first + step i) * (cosine[j], sine[j])`, whole steps of one image pixel.

    Nothing is undistorted: the lens is folded into `rays`, tabulated for every second sample, so that the image is
    read once, where it is sharp, and a position along a line turns into a ray by interpolation. Lines run from the
    innermost ring to the outermost: outwards, but for a mirror that turns their order about (`camera.Mirror`).
    """

    centre: tuple[float, float]
    first: float
    step: int  # 1 or -1
    cosine: NDArray[np.float64]  # (J,) direction j runs along (cosine, sine) in image x, y
    sine: NDArray[np.float64]
    stop: NDArray[np.int64]  # (J,) samples inside the image and inside what the lens model can invert
    rays: NDArray[np.float64]  # (J, L / RAY_STEP_PX + 1, 3) unit vectors, camera frame
    origins: NDArray[np.float64] | None  # the same shape, mm, where the rays start; None: all in the camera's centre
    map_xy: NDArray[np.int16]  # (J + 2, L, 2) cv2's fixed-point map: SIMD, half the time of a float map, 1/32 px;
    map_part: NDArray[np.uint16]  # (J + 2, L) it begins with the last line and ends with the first, for averages
    sectors: list[Sector]
    spacing_px: float  # least distance between two neighbouring rings in a clean pipe

    def pixels(self, direction: NDArray[np.int64], position: FloatArray) -> FloatArray:
        """(N,) lines, (N,) samples along them -> (N, 2) places in the image."""
        away = self.first + self.step * position
        way = np.stack([self.cosine[direction], self.sine[direction]], axis=1)
        return np.asarray(self.centre + away[:, None] * way)


def polar_grid(calibration: Calibration, directions: int) -> PolarGrid:
    """Lay the grid where this calibration's rings can appear, for `directions` lines around the pattern's centre."""
    camera, radius = calibration.camera, calibration.pipe_radius_mm
    nominal = [ring_pixels(camera, cone, Pose(), radius) for cone in calibration.rings]
    if not all(np.isfinite(curve).any() for curve in nominal):
        raise AnnulusError("calibration: a ring of the pattern is nowhere in the image; check pipe.radius_mm and rings")
    middle = np.array([(np.nanmin(curve, axis=0) + np.nanmax(curve, axis=0)) / 2 for curve in nominal])
    centre = middle.mean(axis=0)
    leaning = [
        Pose(a, b, c, d) for a, b, c, d in np.vstack([np.eye(4), -np.eye(4)]) * [TILT, TILT, *[SHIFT * radius] * 2]
    ]
    inner = [ring_pixels(camera, calibration.rings[0], pose, radius) for pose in leaning]
    inner.append(ring_pixels(camera, calibration.rings[0], Pose(), BULGE * radius))
    outer = [ring_pixels(camera, calibration.rings[-1], pose, radius) for pose in leaning]
    outer.append(ring_pixels(camera, calibration.rings[-1], Pose(), DENT * radius))
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
    # a line that runs inwards must start inside
    length = int(np.min(inside) if camera.reversed else np.max(inside))
    if length < 16:
        raise AnnulusError("calibration: the pattern's centre lies outside the image; check camera.cx, camera.cy")
    stop = np.minimum(inside, length)
    first = first if step > 0 else first + length
    nodes = first + step * np.arange(0, length + 2 * RAY_STEP_PX, RAY_STEP_PX)
    pixels = centre + nodes[None, :, None] * np.stack([cosine, sine], axis=1)[:, None, :]
    origins, rays = (part.reshape(directions, len(nodes), 3) for part in camera.lines(pixels.reshape(-1, 2)))
    good = np.cumprod(np.isfinite(rays.sum(axis=2)), axis=1).sum(axis=1)  # nodes before the first bad one
    stop = np.clip(np.minimum(stop, (good - 1) * RAY_STEP_PX), 0, None)
    away = first + step * np.arange(length)
    x, y = (centre[axis] + away * way[:, None] for axis, way in enumerate((cosine, sine)))
    closed = np.arange(-1, directions + 1) % directions
    maps = cv2.convertMaps(x[closed].astype(np.float32), y[closed].astype(np.float32), cv2.CV_16SC2)
    map_xy, map_part = np.asarray(maps[0], np.int16), np.asarray(maps[1], np.uint16)
    edges = np.linspace(0, directions + 2, SECTORS + 1).astype(int)
    sectors = [_sector(camera, map_xy, slice(a, b)) for a, b in pairwise(edges)]
    return PolarGrid(
        (float(centre[0]), float(centre[1])), first, step, cosine, sine, stop, np.nan_to_num(rays),
        None if camera.central else np.nan_to_num(origins), map_xy, map_part, sectors, spacing,
    )  # fmt: skip


def unroll(image: NDArray[np.uint8], grid: PolarGrid) -> NDArray[np.uint8]:
    """(H, W, 3) frame -> (J, L, 3): one row a direction, one column a pixel's step along it; black outside.

    Each line is averaged with its two neighbours: less noise where stripes are dim, and nothing is lost along the line,
    where a slit's place is read. Wider averages would carry light into the shadows of rods.

    A fresh frame lies in main memory, and lines that cross its rows would wait for nearly every sample. So each sector
    first fetches its part of the image in the order of memory, which the processor sees coming.
    """
    image = np.ascontiguousarray(image)
    lines = np.empty((*grid.map_part.shape, 3), np.uint8)
    for sector in grid.sectors:
        part = sector.lines
        _fetch(image.reshape(-1), sector.starts, sector.stops)
        cv2.remap(image, grid.map_xy[part], grid.map_part[part], cv2.INTER_LINEAR, dst=lines[part])
    averaged = cv2.GaussianBlur(lines.reshape(len(lines), -1), (1, 3), sigmaX=1.0, sigmaY=ACROSS)[1:-1]
    return np.asarray(averaged, np.uint8).reshape(-1, *lines.shape[1:])


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


def _sector(camera: Camera, map_xy: NDArray[np.int16], lines: slice) -> Sector:
    x, y = (map_xy[lines, :, axis].ravel().astype(np.int64) for axis in (0, 1))
    inside = (x >= 0) & (x < camera.width - 1) & (y >= 0) & (y < camera.height - 1)
    least, most = np.full(camera.height, camera.width), np.zeros(camera.height, np.int64)
    for row in (y[inside], y[inside] + 1):  # a sample is interpolated between four pixels
        np.minimum.at(least, row, x[inside])
        np.maximum.at(most, row, x[inside] + 2)
    rows = np.flatnonzero(least < most)
    return Sector(lines, 3 * (rows * camera.width + least[rows]), 3 * (rows * camera.width + most[rows]))


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


@compiled
def _fetch(memory, starts, stops):  # type: ignore[no-untyped-def]
    """Reads a byte of every cache line; the sum is returned only lest the compiler see that nobody needs it."""
    total = 0
    for n in range(len(starts)):
        for at in range(starts[n], stops[n], CACHE_LINE):
            total += memory[at]
    return total
