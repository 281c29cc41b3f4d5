"""Photographs of targets drawn by the tests themselves: ray, plane, paint, blur, noise; with the truth known."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline
from scipy.spatial.transform import Rotation

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.intrinsics import TargetObservation
from annulus_pipe.numeric.arrays import FloatArray


@dataclass(frozen=True)
class DrawnTarget:
    """Squares each way, their side, and a dictionary for markers in the light ones."""

    columns: int
    rows: int
    square_mm: float = 25.0
    markers: str = ""

    @property
    def middle_mm(self) -> FloatArray:
        return np.array([self.columns, self.rows, 0.0]) * self.square_mm / 2

    def paint(self, flat: FloatArray) -> FloatArray:
        """(N, 2) mm on the target -> 0 black .. 1 white; a white margin around, grey beyond."""
        s = self.square_mm
        u, v = flat[:, 0] / s, flat[:, 1] / s
        inside = (u >= 0) & (v >= 0) & (u < self.columns) & (v < self.rows)
        margin = (u >= -0.6) & (v >= -0.6) & (u < self.columns + 0.6) & (v < self.rows + 0.6)
        away = np.exp(-0.5 * (((flat - self.middle_mm[:2]) / (2 * s * self.columns)) ** 2).sum(axis=1))
        out = np.where(margin, 1.0, 0.35 + 0.1 * away * np.sin(flat[:, 0] / 60 + flat[:, 1] / 45))
        if self.markers:
            picture = _charuco(self.columns, self.rows, self.markers)
            x, y = (np.clip((w * 160).astype(int), 0, n - 1) for w, n in ((u, picture.shape[1]), (v, picture.shape[0])))
            return np.where(inside, picture[y, x] / 255.0, out)
        return np.where(inside, ((np.floor(u) + np.floor(v)) % 2), out)


@lru_cache(maxsize=8)
def _charuco(columns: int, rows: int, markers: str) -> NDArray[np.uint8]:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{markers}_250"))
    target = cv2.aruco.CharucoBoard((columns, rows), 1.0, 0.75, dictionary)
    return np.asarray(target.generateImage((columns * 160, rows * 160), marginSize=0), np.uint8)


@lru_cache(maxsize=4)
def _lens(camera: Camera) -> list[RectBivariateSpline]:
    x, y = (np.arange(-8.0, size + 16, 8) for size in (camera.width, camera.height))
    rays = np.nan_to_num(camera.rays(np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2)))
    return [RectBivariateSpline(y, x, part.reshape(len(y), len(x)), s=0) for part in rays.T]


@lru_cache(maxsize=20)
def _rays(camera: Camera, dx: float, dy: float) -> FloatArray:
    """(H W, 3) rays of all pixels, moved by so much; a lens is smooth and need not be worked out everywhere."""
    x, y = np.arange(camera.width) + dx, np.arange(camera.height) + dy
    return np.stack([f(y, x).ravel() for f in _lens(camera)], axis=1).astype(np.float32)


def photograph(
    camera: Camera,
    target: DrawnTarget,
    rotation: FloatArray,
    middle_mm: FloatArray,
    *,
    blur_px: float = 0.8,
    noise: float = 2.0,
    light: tuple[float, float] = (30.0, 190.0),
    seed: int = 0,
) -> NDArray[np.uint8]:
    """(H, W) image of the target, its middle at `middle_mm` in the camera frame."""
    shift = np.asarray(middle_mm) - rotation @ target.middle_mm
    normal = rotation[:, 2]
    picture = np.zeros((camera.height, camera.width))
    for i in range(9):  # nine places a pixel, no two in one row or column
        rays = _rays(camera, ((i * 3) % 9 + i // 3 + 0.5) / 9 - 0.5, (i + 0.5) / 9 - 0.5)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (normal @ shift) / (rays @ normal)
        flat = np.where((s > 0)[:, None], (s[:, None] * rays - shift) @ rotation[:, :2], 1e6)
        picture += target.paint(flat).reshape(picture.shape) / 9
    picture = light[0] + (light[1] - light[0]) * picture
    picture *= 1 - 0.25 * np.linspace(-1, 1, camera.width) ** 2  # vignetting and a lamp to one side
    picture *= np.linspace(0.85, 1.1, camera.height)[:, None]
    picture = cv2.GaussianBlur(picture, (0, 0), blur_px) if blur_px else picture
    rng = np.random.default_rng(seed)
    return np.clip(np.rint(picture + rng.normal(0, noise, picture.shape)), 0, 255).astype(np.uint8)


def poses(
    camera: Camera,
    target: DrawnTarget,
    count: int,
    *,
    fill: float = 0.55,
    off: float = 0.6,
    tilt_deg: float = 35.0,
    seed: int = 0,
) -> list[tuple[FloatArray, FloatArray]]:
    """Targets in different parts of the image, tilted. `fill`: of the image's height, `off`: how far out middles go."""
    rng = np.random.default_rng(seed)
    out = []
    centre = np.array([camera.cx, camera.cy])
    half = np.array([camera.width, camera.height]) / 2
    focal = np.array([camera.fx, camera.fy]).mean()
    for i in range(count):
        turn = 2.4 * i
        place = centre + off * np.sqrt((i + 0.5) / count) * half * [np.cos(turn), np.sin(turn)]
        ray = camera.rays(place[None])[0]
        distance = target.rows * target.square_mm * focal / (fill * camera.height) * rng.uniform(0.85, 1.2)
        ahead = np.array([0.0, 0.0, 1.0])
        facing = Rotation.align_vectors([ray], [ahead])[0]  # the target looks back along the ray ..
        lean = np.radians(rng.uniform(0.4, 1.0) * tilt_deg)
        around = rng.uniform(0, 2 * np.pi)
        tilt = Rotation.from_rotvec(lean * np.array([np.cos(around), np.sin(around), 0]))  # .. and leans
        spin = Rotation.from_rotvec([0, 0, rng.normal(0, 0.3)])
        out.append(((facing * tilt * spin).as_matrix(), distance * ray))
    return out


SMALL = DrawnTarget(8, 6)


def corners(
    camera: Camera, count: int, seed: int, off: float = 0.6, target: DrawnTarget = SMALL
) -> list[TargetObservation]:
    """Views of a target without errors."""
    flat = np.stack(np.meshgrid(np.arange(1, target.columns), np.arange(1, target.rows)), axis=2).reshape(-1, 2)
    mm = flat * target.square_mm - target.middle_mm[:2]
    return [
        TargetObservation(mm, camera.project(mm @ rotation[:, :2].T + middle))
        for rotation, middle in poses(camera, target, count, fill=0.6, off=off, seed=seed)
    ]


def read(view: TargetObservation, rng: np.random.Generator, own: float, shared: float) -> TargetObservation:
    """Every corner a little off by itself, and all of one photograph by a smooth field: blur, light, bend."""
    u, v = (view.target_mm / np.abs(view.target_mm).max(axis=0)).T
    fields = np.linalg.qr(np.stack([u**a * v**b for a in range(4) for b in range(4 - a)], axis=1))[0]
    smooth = fields @ rng.normal(0, shared * np.sqrt(len(u) / fields.shape[1]), (fields.shape[1], 2))
    return TargetObservation(view.target_mm, view.pixels + smooth + rng.normal(0, own, view.pixels.shape))
