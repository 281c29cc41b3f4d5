"""Camera models: pixels to lines and back. Pixel centres are at whole numbers, as in OpenCV.

`pinhole` and `fisheye` have one centre, the origin of the camera frame: z down the pipe, x right, y down as in the
image. `mirror` (Alzuhiri 2022, §3.6, pipes of 2 to 4 inches) is a pinhole camera that looks at a convex ball. Its lines
start on the ball and have no common centre. The house's camera frame then has its origin in the ball's centre:

    pipe wall ------------------------------------------------------------
                      .  slit          , ray of a pixel
                   .                 ,
        projector < - - - - -  ( o )- - - - - - - - -[ camera      looks = "back": z down the pipe,
                                 |                                 past the camera; the camera looks along -z
                                 +--> z
                                 y
    ----------------------------------------------------------------------

The camera's own axes (X right, Y down in its image, Z out of the lens) are turned by half a turn about y: x = -X,
y = Y, z = -Z. So the image is like one that looks down the pipe, but for left and right: the middle shows the camera
itself, the farthest wall stands around it, and towards the ball's rim come the wall beside it and behind it.
With looks = "ahead" the camera stands behind the ball and looks down the pipe: x = X, y = Y, z = Z, the middle of the
image shows what lies behind, and rings appear in reversed order, the innermost cone outermost.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import cv2
import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door

Model = Literal["pinhole", "fisheye", "mirror"]

BISECTIONS, EXACT = 60, 1e-13  # of the angle at which a ball reflects, radians; test_mirror
COEFFICIENTS = 12  # of a lens in OpenCV's order, before the two angles of a tilted sensor

_LENS = "f8 nearest", "b1 fisheye", "f8[4] lens", "f8[12] k", "f8[3,3] tilt"
_projected = door("projected", "f8[n,3] points", "f8[3,3] turn", "f8[3] shift", *_LENS, "f8[n,2]! out")
_rows_projected = door(
    "rows_projected", "f8[r,a] radius", "f8[a] right", "f8[a] down", "f8[r,9] rows", *_LENS, "f8[r,a,2]! out"
)


@dataclass(frozen=True, slots=True)
class Mirror:
    """A convex ball before a pinhole camera: its centre in that camera's own axes (Z out of the lens), its radius."""

    centre_mm: tuple[float, float, float]
    radius_mm: float
    looks: Literal["back", "ahead"] = "back"  # the camera against the pipe's z

    @property
    def turn(self) -> FloatArray:
        """(3,) signs that turn the camera's own axes into those of the camera frame, and back."""
        return np.array([-1.0, 1.0, -1.0] if self.looks == "back" else [1.0, 1.0, 1.0])

    @property
    def eye_mm(self) -> FloatArray:
        """(3,) the pinhole in the camera frame."""
        return -self.turn * self.centre_mm

    def reflect(self, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 3) unit rays of the pinhole, its own axes -> where they meet the ball (mm) and how they leave it, both
        (N, 3) in the camera frame; NaN where they pass it by."""
        way, eye = rays * self.turn, self.eye_mm
        along = way @ eye
        with np.errstate(invalid="ignore"):
            s = -along - np.sqrt(along**2 - (eye @ eye - self.radius_mm**2))
        place = eye + s[:, None] * way
        normal = place / self.radius_mm
        out = way - 2.0 * np.einsum("ij,ij->i", way, normal)[:, None] * normal
        return place, out

    def meet(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm in the camera frame -> (N, 3) where on the ball the eye sees them; NaN where the ball hides them.

        Alhazen's problem. In the plane of eye, point and ball's centre, with the eye at distance D, the point at
        distance d and angle psi from it, the light is reflected at angle phi where
        D d sin(2 phi - psi) = r (D sin phi - d sin(psi - phi)). Between the horizons of both there is one such angle;
        Newton's steps find it, bisection keeps them there.
        """
        eye, r = self.eye_mm, self.radius_mm
        near = float(np.linalg.norm(eye))
        u = eye / near
        along = points @ u
        across = points - along[:, None] * u
        side = np.linalg.norm(across, axis=1)
        far = np.hypot(along, side)
        psi = np.arctan2(side, along)
        with np.errstate(invalid="ignore", divide="ignore"):
            low = np.maximum(psi - np.arccos(r / far), 0.0)
            high = np.minimum(psi, np.arccos(r / near))
            seen = low <= high
            phi = np.where(seen, (low + high) / 2, np.nan)
            for _ in range(BISECTIONS):
                rest = psi - phi
                value = near * far * np.sin(phi - rest) - r * (near * np.sin(phi) - far * np.sin(rest))
                slope = 2 * near * far * np.cos(phi - rest) - r * (near * np.cos(phi) + far * np.cos(rest))
                low, high = np.where(value < 0, phi, low), np.where(value < 0, high, phi)
                step = phi - value / slope
                before, phi = phi, np.where((step >= low) & (step <= high), step, (low + high) / 2)
                if not (np.abs(phi - before) > EXACT).any():
                    break
            side_way = np.where(side[:, None] > 1e-12, across / np.maximum(side, 1e-12)[:, None], 0.0)
        return np.asarray(r * (np.cos(phi)[:, None] * u + np.sin(phi)[:, None] * side_way))


@dataclass(frozen=True, slots=True)
class Camera:
    """Intrinsics. `pinhole` is Brown-Conrady (k1 k2 p1 p2 [k3 ..]), `fisheye` is OpenCV's Kannala-Brandt (k1..k4),
    `mirror` a pinhole, with all its numbers, and the ball it looks at.

    `sensor_crop`: x, y, width, height of what the image shows of the whole sensor, in its pixels, where that is known:
    modes of a sensor share sizes but not fields of view.

    `colour_shift_px`: of red, green and blue (in this order) how far an edge in its image lies from where the lens
    says, along the edge's normal at angle a in the image: (c1, s1, c3, s3) for c1 cos a + s1 sin a + c3 cos 3a +
    s3 sin 3a. Demosaicing with JPEG's chroma does it, lateral colour too."""

    model: Model
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = ()
    mirror: Mirror | None = None
    sensor_crop: tuple[int, int, int, int] | None = None
    colour_shift_px: tuple[tuple[float, float, float, float], ...] = ()  # three, or none

    def __post_init__(self) -> None:
        if (self.model == "mirror") != (self.mirror is not None):
            raise ValueError(f"a {self.model} camera {'needs' if self.mirror is None else 'has no'} mirror")

    @property
    def central(self) -> bool:
        """Whether all lines meet in the origin."""
        return self.mirror is None

    @property
    def reversed(self) -> bool:
        """Whether what lies farther down the pipe is seen farther from the middle of the image."""
        return self.mirror is not None and self.mirror.looks == "ahead"

    def lines(self, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) pixels -> (N, 3) mm where their lines start, (N, 3) unit vectors along them, camera frame.

        NaN outside what the lens model can invert, and beside the mirror.
        """
        if self.mirror is not None:
            return self.mirror.reflect(self._inner.rays(pixels))
        rays = self.rays(pixels)
        return np.zeros_like(rays), rays

    @property
    def _inner(self) -> "Camera":
        """What looks at the mirror."""
        return replace(self, model="pinhole", mirror=None)

    @property
    def matrix(self) -> FloatArray:
        """K, (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def _coefficients(self) -> FloatArray:
        n = 4 if self.model == "fisheye" else max(5, len(self.distortion))
        return np.pad(np.array(self.distortion, dtype=float), (0, n - len(self.distortion)))

    def rays(self, pixels: FloatArray) -> FloatArray:
        """(N, 2) pixels -> (N, 3) unit vectors in the camera frame; NaN outside what the lens model can invert.

        Only of a camera with one centre; of any camera: `lines`.
        """
        if not self.central:
            raise ValueError("a mirror camera's lines have no common centre: use lines()")
        pixels = np.asarray(pixels, dtype=float)
        if self.model == "fisheye":
            x, y = (pixels[:, 0] - self.cx) / self.fx, (pixels[:, 1] - self.cy) / self.fy
            distorted = np.hypot(x, y)
            theta = _invert_kannala_brandt(distorted, self._coefficients())
            with np.errstate(invalid="ignore"):
                scale = np.where(distorted > 1e-12, np.sin(theta) / np.maximum(distorted, 1e-12), 1.0)
            return np.stack([x * scale, y * scale, np.cos(theta)], axis=1)
        if any(self.distortion):
            criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-12)
            flat = np.asarray(
                cv2.undistortPoints(pixels.reshape(-1, 1, 2), self.matrix, self._coefficients(), criteria=criteria)
            ).reshape(-1, 2)
        else:
            flat = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        rays = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def project(
        self,
        points: FloatArray,
        turn: FloatArray | None = None,
        shift: FloatArray | None = None,
        nearest_mm: float = -math.inf,
    ) -> FloatArray:
        """(N, 3) mm in the camera frame -> (N, 2) pixels; NaN behind a pinhole and where the mirror is in the way.

        turn (3, 3), shift (3,) : of points in another frame, which are at turn p + shift in the camera's. nearest_mm :
        what is less far ahead has no pixel.
        """
        points = np.ascontiguousarray(points, float)
        turn = np.eye(3) if turn is None else np.ascontiguousarray(turn, float)
        shift = np.zeros(3) if shift is None else np.ascontiguousarray(shift, float)
        if self.mirror is not None:
            moved = points @ turn.T + shift
            pixels = self._inner.project((self.mirror.meet(moved) - self.mirror.eye_mm) * self.mirror.turn)
            pixels[moved[:, 2] < nearest_mm] = np.nan
            return pixels
        out = np.empty((len(points), 2))
        _projected(points, turn, shift, nearest_mm, *self._lens(), out)
        return out

    def project_rows(
        self, radius_mm: FloatArray, around: FloatArray, rows: FloatArray, nearest_mm: float = -math.inf
    ) -> FloatArray:
        """The same of places round an axis, (R, A) by their radius: (R A, 2) pixels.

        around (2, A) : right and down of a radius of one; rows (R, 3, 3) : what right and down do in the camera's
        frame, and where the axis is there, as columns.
        """
        if self.mirror is not None:
            flat = np.concatenate([radius_mm * around[:, None], np.ones((1, *radius_mm.shape))])
            return self.project(np.einsum("rij,jra->rai", rows, flat).reshape(-1, 3), nearest_mm=nearest_mm)
        out = np.empty((*radius_mm.shape, 2))
        packed = np.concatenate([rows[:, :, :2].reshape(-1, 6), rows[:, :, 2]], axis=1)
        _rows_projected(np.ascontiguousarray(radius_mm, float), *around, packed, nearest_mm, *self._lens(), out)
        return out.reshape(-1, 2)

    def _lens(self) -> tuple[bool, FloatArray, FloatArray, FloatArray]:
        """As the loops have it."""
        k = np.zeros(COEFFICIENTS + 2)
        k[: len(self.distortion)] = self.distortion
        lens = np.array([self.fx, self.fy, self.cx, self.cy], float)
        return self.model == "fisheye", lens, k[:COEFFICIENTS], _tilted(*k[COEFFICIENTS:])


def _tilted(about_x: float, about_y: float) -> FloatArray:
    """(3, 3) what a sensor that is tilted so does to an image, OpenCV's tauX and tauY."""
    if not (about_x or about_y):
        return np.eye(3)
    (cx, cy), (sx, sy) = np.cos([about_x, about_y]), np.sin([about_x, about_y])
    turn = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    flat = np.array([[turn[2, 2], 0, -turn[0, 2]], [0, turn[2, 2], -turn[1, 2]], [0, 0, 1]])
    return np.asarray(flat @ turn)


def _invert_kannala_brandt(distorted: FloatArray, k: FloatArray) -> FloatArray:
    """theta with theta (1 + k1 theta^2 + ..) = distorted, by Newton; NaN where it does not converge below pi."""
    theta = np.minimum(distorted, 1.5)
    for _ in range(20):
        t2 = theta * theta
        value = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) - distorted
        slope = 1 + t2 * (3 * k[0] + t2 * (5 * k[1] + t2 * (7 * k[2] + t2 * 9 * k[3])))
        theta = np.clip(theta - value / np.where(np.abs(slope) > 1e-6, slope, 1e-6), 0.0, np.pi)
    t2 = theta * theta
    residual = theta * (1 + t2 * (k[0] + t2 * (k[1] + t2 * (k[2] + t2 * k[3])))) - distorted
    return np.where(np.abs(residual) < 1e-9, theta, np.nan)
