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
from annulus_pipe.numeric.mosaic import Mosaic, Picture
from annulus_pipe.numeric.native import Like, door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.vocabulary import AnnulusError

# What a line keeps (ACROSS, WEAK, RAISED_MOST) is measured by topics uncertainty and colour; what is left out unseen
# (PROBE, LIT) by the points that colour counts; RAY_STEP_PX by test_slits; the search by test_slits, few_rings, mirror.
ACROSS = 0.85  # standard deviation, in directions, of the average over neighbouring lines: weights 1, 2, 1
LEAST_SAMPLES = 16  # of a line that is looked at: shorter, no slit has light on both sides
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
    address: NDArray[
        np.uint32
    ]  # (J + 2, L) y * width + x of the pixel above and left of each sample; outside, height *
    # width. It begins with the last line and ends with the first, for averages
    part: NDArray[np.uint16]  # (J + 2, L) 32 fy + fx: how far below and right of it, 1/32 px
    size: tuple[int, int]  # height and width of the image
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
    at, part = np.asarray(maps[0], np.int64), np.asarray(maps[1], np.uint16)
    inside_it = ((at >= 0) & (at < np.array([camera.width - 1, camera.height - 1]))).all(axis=2)
    address = np.where(inside_it, at[..., 1] * camera.width + at[..., 0], camera.height * camera.width)
    return PolarGrid(
        (float(centre[0]), float(centre[1])),
        first,
        step,
        cosine,
        sine,
        stop,
        rays.astype(np.float32),
        None if camera.central else origins.astype(np.float32),
        address.astype(np.uint32),
        part,
        (camera.height, camera.width),
        spacing,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Unrolled:
    """One frame along the grid's lines: the strongest of its channels, for where slits are; their colours stay in the
    image and are read only where slits were found."""

    cells: NDArray[np.uint8]  # the image as it came, see `laid_out`
    phase: int
    flat: NDArray[np.uint8]  # room, in which the first J rows of `length` are `top`
    length: int  # B - A
    lines: int  # J
    first: int  # A
    bright: float  # the frame's bright level and ..
    noise: float  # .. the noise of `top`, grey levels

    @property
    def top(self) -> NDArray[np.uint8]:
        """(J, B - A) samples A .. B of every line; outside of them nothing is lit."""
        return self.flat[: self.lines * self.length].reshape(self.lines, self.length)


class Unroller:
    """Lays frames of one grid out, in memory that is used again for each: what it returns holds until the next."""

    def __init__(self, grid: PolarGrid) -> None:
        lines, length = len(grid.cosine), grid.address.shape[1]
        self.grid = grid
        self.top = np.empty(lines * length, np.uint8)
        self._black, self._gain, self._range = np.empty(3, np.int32), np.empty(3, np.int32), np.empty(2, np.int64)
        self._levels = np.empty(2)
        limits = np.array([LIT, LIT_MARGIN, WEAK, RAISED_MOST, LEAST_SAMPLES])
        seen = np.empty(3 * (lines // PROBE_LINES + 1) * (length // PROBE_PX + 2), np.uint8)
        placed = grid.address, grid.part, grid.stop, *grid.centre, grid.first, grid.step
        asked = PROBE_LINES, PROBE_PX, limits, SIGMA_OF_MAD
        observed = seen, self._black, self._gain, self._range, empty_plane(grid)
        laid = *observed, np.empty((3, length), np.uint8), self.top, self._levels
        self._lay_out = {
            channels: _lay_out.held(Like(np.empty((*grid.size, channels), np.uint8)), ..., *placed, *asked, *laid)
            for channels in (1, 3)  # a mosaic, and in colours
        }

    def __call__(self, image: Picture) -> Unrolled:
        """See `unroll`. Raises AnnulusError where the image is not of the grid's size."""
        grid = self.grid
        if image.shape != (*grid.size, 3):
            height, width = grid.size
            raise AnnulusError(
                f"image: shape {image.shape}, expected ({height}, {width}, 3), as the calibration's camera"
            )
        cells, phase = laid_out(image)
        self._lay_out[cells.shape[2]](cells, phase)
        start, stop = self._range.tolist()
        return Unrolled(cells, phase, self.top, stop - start, len(grid.cosine), start, *self._levels.tolist())


def laid_out(image: Picture) -> tuple[NDArray[np.uint8], int]:
    """(H, W, 3) BGR or (H, W, 1) cells of a mosaic, in order of memory; and of a mosaic where its red cells are. Raises
    AnnulusError for one without a cell that has neighbours all round."""
    if isinstance(image, Mosaic):
        if min(image.cells.shape) < 3:
            raise AnnulusError(f"image: a mosaic of shape {image.cells.shape}, expected at least 3 rows and columns")
        row, column = divmod(image.order.index("r"), 2)
        return np.ascontiguousarray(image.cells)[:, :, None], 2 * row + column
    return np.ascontiguousarray(image), 0


def unroll(image: Picture, grid: PolarGrid) -> Unrolled:
    """Lay a frame (H, W) out: one row a direction, one column a pixel's step along it.

    The strongest channel is taken in the image, so that one plane is interpolated and not three. That pass also fetches
    the frame in the order of memory: a fresh one is in no cache, and lines that cross its rows would wait for nearly
    every sample. A channel that the wall's paint swallows (blue, on a yellow pipe) is raised for this, black taken off,
    or its stripes would be darkness beside the others.

    Each line is averaged with its two neighbours, weights 1, 2, 1: less noise where stripes are dim, and nothing is
    lost along the line, where a slit's place is read. Wider averages would carry light into the shadows of rods.
    """
    return Unroller(grid)(image)


def empty_plane(grid: PolarGrid) -> NDArray[np.uint8]:
    """Room for one channel of an image, and behind it a dark place for samples outside."""
    height, width = grid.size
    return np.zeros(height * width + width + 2, np.uint8)


def sampled(plane: NDArray[np.uint8], grid: PolarGrid) -> NDArray[np.uint8]:
    """(J + 2, L) one channel (H, W) along the grid's lines, which begin with the last and end with the first."""
    padded = empty_plane(grid)
    padded[: plane.size] = plane.reshape(-1)
    out = np.empty(grid.address.shape, np.uint8)
    _sample(padded, grid.size[1], grid.address, grid.part, out)
    return out


_lay_out = door(
    "rings_lay_out",
    "u1[h,w,b] image",
    "i8 phase",
    "u4[i,n] address",
    "u2[i,n] part",
    "i8[j] stop",
    "f8 cx",
    "f8 cy",
    "f8 first",
    "f8 step",
    "i8 every",
    "i8 px",
    "f8[5] limits",
    "f8 sigma_of_mad",
    "u1[s]! seen",
    "i4[3]! black",
    "i4[3]! gain",
    "i8[2]! range",
    "u1[p]! plane",
    "u1[3,n]! rows",
    "u1[t]! top",
    "f8[2]! levels",
)
_sample = door("rings_sample", "u1[p] plane", "i8 w", "u4[i,n] address", "u2[i,n] part", "u1[i,n]! out")


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
