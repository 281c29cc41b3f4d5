"""Photographs of chessboards through lenses of other families, and what `annulus calibrate camera` says of the lens.

A lens is a curve from the angle off its axis to the distance from its middle: rectilinear, stereographic, equidistant
or equisolid, bent by a polynomial, decentred and sheared a little: none is OpenCV's formula. Boards bow, light falls
off, photographs are blurred, noisy and packed. A ray is right when the fitted lens sends it where the true one does,
but for a turn of the whole camera that no calibration can tell.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from annulus_pipe.calibrate.camera import CameraCalibration, calibrate_camera
from annulus_pipe.vocabulary import AnnulusError
from tools.bench.blind.others.tally import Case
from tools.bench.blind.score import Number

SIZES = ((640, 480), (800, 600), (832, 616), (1024, 768))
FAMILIES = {
    "rectilinear": np.tan,
    "stereographic": lambda t: 2 * np.tan(t / 2),
    "equidistant": lambda t: t,
    "equisolid": lambda t: 2 * np.sin(t / 2),
}
HALF_DEG = {"rectilinear": (18, 42), "stereographic": (40, 75), "equidistant": (40, 85), "equisolid": (40, 80)}
GRID = 7  # rays across the picture that are held against the truth
EDGE_DEG = 20.0  # of the widest: rays so near to it count as at the edge


@dataclass(slots=True)
class Lens:
    """focal in pixels; bends are parts of the angle's third and fifth power, centre in pixels, shear of y."""

    family: str
    width: int
    height: int
    focal: float
    centre: tuple[float, float]
    bends: tuple[float, float]
    shear: float
    half: float  # rad, to the corner of the picture

    def distance(self, angle: np.ndarray) -> np.ndarray:
        part = angle / self.half
        bent = angle * (1 + self.bends[0] * part**2 + self.bends[1] * part**4)
        return self.focal * FAMILIES[self.family](np.minimum(bent, 1.5))

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 3) unit vectors of (N, 2) pixels."""
        x, y = pixels[:, 0] - self.centre[0], pixels[:, 1] - self.centre[1]
        y = y * (1 + self.shear)
        angles = np.linspace(0, 1.25 * self.half, 4000)
        angle = np.interp(np.hypot(x, y), self.distance(angles), angles)
        turn = np.arctan2(y, x)
        return np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], axis=1)


def draw(rng: np.random.Generator) -> Lens:
    family = str(rng.choice(list(FAMILIES)))
    width, height = SIZES[int(rng.integers(len(SIZES)))]
    half = math.radians(rng.uniform(*HALF_DEG[family]))
    bends = (rng.uniform(-0.12, 0.04), rng.uniform(-0.02, 0.02))
    lens = Lens(family, width, height, 1.0, (0.0, 0.0), bends, rng.normal(0, 5e-4), half)
    corner = 0.5 * math.hypot(width, height)
    lens.focal = corner / float(lens.distance(np.array(half)))
    lens.centre = (width - 1) / 2 + rng.normal(0, 0.012 * width), (height - 1) / 2 + rng.normal(0, 0.012 * width)
    return lens


def photograph(
    lens: Lens, rng: np.random.Generator, board: tuple[int, int], bow: float, rays: np.ndarray
) -> np.ndarray:
    """One picture; the board is `board` squares of 25 mm, somewhere before the lens. rays : twice as fine as pixels."""
    columns, rows = board
    size = 25.0 * columns
    at = lens.rays(np.array([[rng.uniform(0.22, 0.78) * lens.width, rng.uniform(0.22, 0.78) * lens.height]]))[0]
    away = size / (2 * math.tan(rng.uniform(0.35, 0.75) * min(lens.half, 0.9)))
    tilt = rng.uniform(0.1, 0.65)
    turn, way = rng.uniform(-0.5, 0.5), rng.uniform(0, 2 * math.pi)
    ahead = at + tilt * np.cross(at, [math.cos(way), math.sin(way), 0.0])
    ahead /= np.linalg.norm(ahead)
    right = np.cross([-math.sin(turn), math.cos(turn), 0.0], ahead)
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    middle = away * at
    along = rays @ ahead
    reach = (middle @ ahead) / np.where(along > 0.05, along, np.nan)
    for _ in range(2):  # a board that bows along its long side
        across = (rays * reach[..., None] - middle) @ right
        reach = (middle @ ahead + bow * (1 - (2 * across / size) ** 2)) / np.where(along > 0.05, along, np.nan)
    point = rays * reach[..., None] - middle
    x, y = (point @ right) / 25.0 + columns / 2, (point @ down) / 25.0 + rows / 2
    inside = (x > 0) & (x < columns) & (y > 0) & (y < rows)
    paper = (x > -0.8) & (x < columns + 0.8) & (y > -0.8) & (y < rows + 0.8)
    dark = inside & ((np.floor(np.nan_to_num(x)) + np.floor(np.nan_to_num(y))) % 2 == 0)
    light = np.where(dark, 0.08, np.where(paper, 0.85, rng.uniform(0.2, 0.5)))
    light = light.reshape(lens.height, 2, lens.width, 2).mean(axis=(1, 3))
    light *= (
        1
        - rng.uniform(0, 0.4)
        * np.hypot(*np.meshgrid(np.linspace(-1, 1, lens.width), np.linspace(-1, 1, lens.height))) ** 2
        / 2
    )
    light = gaussian_filter(light, rng.uniform(0.5, 1.1))
    grey = 235 * rng.uniform(0.6, 1.0) * light + rng.normal(0, rng.uniform(0.5, 4.0), light.shape)
    return np.clip(np.round(grey), 0, 255).astype(np.uint8)


def measured(seed: int, folder: Path) -> Case:
    rng = np.random.default_rng([seed, 93])
    lens = draw(rng)
    board, count = ((10, 7), (9, 6), (12, 9))[int(rng.integers(3))], int(rng.integers(9, 17))
    bow, quality = rng.normal(0, 0.15), int(rng.choice([75, 85, 92, 98]))
    y, x = np.mgrid[: 2 * lens.height, : 2 * lens.width]
    fine = np.stack([(x.ravel() + 0.5) / 2 - 0.5, (y.ravel() + 0.5) / 2 - 0.5], axis=1)
    rays = lens.rays(fine).reshape(2 * lens.height, 2 * lens.width, 3)
    files = []
    for k in range(count):
        files.append(folder / f"{k:02d}.jpg")
        picture = photograph(lens, rng, board, bow, rays)
        cv2.imwrite(str(files[-1]), picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    case = Case(
        seed,
        f"{lens.family}, {2 * math.degrees(lens.half):.0f} deg, {lens.width} x {lens.height}, {count} "
        f"photographs of {board[0]} x {board[1]}, bow {bow:+.2f} mm, JPEG {quality}",
    )
    try:
        found = calibrate_camera(files)
    except AnnulusError as error:
        case.refused = str(error).replace(str(folder), "")
        return case
    score(case, lens, found)
    return case


def score(case: Case, lens: Lens, found: CameraCalibration) -> None:
    camera, fit = found.camera, found.intrinsics
    case.marks += f"; {camera.model}, {fit.rms_px:.2f} px, {len(fit.views)} kept"
    model = f"fitted by {camera.model}"
    # The fitted camera's own turn: the one that brings the rays of all corners seen together.
    seen = np.concatenate(fit.seen)
    own, true = camera.rays(seen), lens.rays(seen)
    good = np.isfinite(own).all(axis=1)
    u, _, v = np.linalg.svd(own[good].T @ true[good])
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    x, y = np.meshgrid(np.linspace(0, lens.width - 1, GRID), np.linspace(0, lens.height - 1, GRID))
    at = np.stack([x.ravel(), y.ravel()], axis=1)
    sigma, back = fit.ray_sigma_px(at), camera.project(lens.rays(at) @ turn.T)
    off = np.linalg.norm(back - at, axis=1)
    wide = np.degrees(np.arccos(np.clip(lens.rays(at)[:, 2], -1, 1)))
    for k in range(len(at)):
        if not math.isfinite(sigma[k]):
            case.unsaid["ray, px"] += 1
        elif math.isfinite(off[k]):
            where = "at the edge" if wide[k] > math.degrees(lens.half) - EDGE_DEG else "in the middle"
            case.numbers.append(Number(f"ray, px, {where}", model, float(off[k]), 2 * float(sigma[k]), 0.0))
    sigmas = np.sqrt(np.diag(fit.covariance))
    for k, (name, value, true_value) in enumerate(
        (
            ("focal length, px", camera.fx, paraxial(lens)),
            ("focal length, px", camera.fy, paraxial(lens) / (1 + lens.shear)),
            ("centre, px", camera.cx, lens.centre[0]),
            ("centre, px", camera.cy, lens.centre[1]),
        )
    ):
        case.numbers.append(Number(name, model, value, 2 * float(sigmas[k]), true_value))


def paraxial(lens: Lens) -> float:
    """Pixels a radian on the axis."""
    return float(lens.distance(np.array(1e-4))) / 1e-4
