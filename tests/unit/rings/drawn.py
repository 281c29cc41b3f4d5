"""Frames drawn by the tests themselves, a pixel at a time from first principles: ray, wall, light. Nothing of the
reconstruction is used but the calibration's own types; nothing of the twin."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RectBivariateSpline

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from tests import kept

PIPE_MM = 76.2
Radius = Callable[[FloatArray, FloatArray], FloatArray]  # (clock-free angle atan2(y, x), z mm) -> wall radius mm


def calibration(
    model: str = "pinhole",
    scale: float = 0.5,
    colours: str = "RRGBGR",
    theta_deg: tuple[float, ...] = (37.9, 42.4, 47.5, 52.8, 57.7),
) -> Calibration:
    """The head of the source's figures, with `scale` of its pixels. Angles are full angles."""
    width, height = round(1664 * scale), round(1232 * scale)
    centre = ((width - 1) / 2 + 3.0, (height - 1) / 2 - 2.0)
    if model == "fisheye":
        camera = Camera("fisheye", width, height, 520 * scale, 518 * scale, *centre, (0.03, -0.012, 0.002, 0.0))
    elif model == "barrel":
        camera = Camera("pinhole", width, height, 520 * scale, 520 * scale, *centre, (-0.12, 0.01, 0.001, -0.0005, 0.0))
    else:
        camera = Camera("pinhole", width, height, 470 * scale, 470 * scale, *centre)
    axis = np.array([-0.016, 0.015, 1.0])
    axis /= np.linalg.norm(axis)
    cones = tuple(
        Cone(np.radians(t / 2), (float(axis[0]), float(axis[1]), float(axis[2])), (1.1, -1.0, -56.0 - 0.3 * i))
        for i, t in enumerate(theta_deg)
    )
    return Calibration(camera, colours, cones, PIPE_MM)


@dataclass(frozen=True)
class Paint:
    """How the light and the camera turn stripes into numbers."""

    light: tuple[tuple[float, float, float], ...] = ((215, 8, 4), (10, 190, 22), (4, 20, 170))  # RGB of R, G, B stripes
    blur_px: float = 0.8
    noise: float = 0.0  # grey levels
    bayer: bool = False
    black: float = 3.0
    supersample: int = 3
    artefact: Callable[[int, FloatArray], FloatArray] | None = None  # (slit, azimuth) -> rad off its cone


def draw(
    cal: Calibration,
    pose: Pose,
    radius: Radius | None = None,
    paint: Paint | None = None,
    slit_px: float = 8.0,
    seed: int = 0,
    lit: Callable[[FloatArray], NDArray[np.bool_]] | None = None,
) -> NDArray[np.uint8]:
    """One projector frame (H, W, 3) BGR. `radius`: the wall (star-shaped, no shadows); `lit`: (N, 3) pipe points."""
    parts = (cal, pose, radius, paint or Paint(), slit_px, seed, lit)
    return kept.picture(lambda: _drawn(*parts), *parts)


def _drawn(
    cal: Calibration,
    pose: Pose,
    radius: Radius | None,
    paint: Paint,
    slit_px: float,
    seed: int,
    lit: Callable[[FloatArray], NDArray[np.bool_]] | None,
) -> NDArray[np.uint8]:
    camera, n = cal.camera, paint.supersample
    half = _half_angles(cal, slit_px)
    # A lens is smooth: its rays are worked out every sixth pixel and splined, or drawing would be all undistortion.
    knots_x, knots_y = np.arange(-6.0, camera.width + 12, 6), np.arange(-6.0, camera.height + 12, 6)
    at = np.stack(np.meshgrid(knots_x, knots_y), axis=2).reshape(-1, 2)
    knots = np.nan_to_num(camera.rays(at)).reshape(len(knots_y), len(knots_x), 3)
    lens = [RectBivariateSpline(knots_y, knots_x, knots[..., c], s=0) for c in range(3)]
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    shown = np.hypot(x - camera.cx, y - camera.cy).ravel()
    shown = (shown > 0.11 * camera.height) & (shown < 0.5 * camera.width)
    total = np.zeros((camera.height * camera.width, 3))
    for i in range(n * n):  # n * n samples a pixel, no two in one row or column
        dy, dx = ((i + 0.5) / n**2 - 0.5), (((i * n) % (n * n) + i // n + 0.5) / n**2 - 0.5)
        rays = np.stack([f(y[:, 0] + dy, x[0] + dx) for f in lens], axis=2).reshape(-1, 3)[shown]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        total[shown] += _shade(cal, pose, radius, paint, half, rays, lit)
    image = cv2.GaussianBlur((total / n**2).reshape(camera.height, camera.width, 3), (0, 0), paint.blur_px)
    rng = np.random.default_rng(seed)
    if paint.bayer:
        raw = np.empty(image.shape[:2])
        raw[0::2, 0::2], raw[1::2, 1::2] = image[0::2, 0::2, 0], image[1::2, 1::2, 2]
        raw[0::2, 1::2], raw[1::2, 0::2] = image[0::2, 1::2, 1], image[1::2, 0::2, 1]
        raw = raw + paint.black + rng.normal(0, 1, raw.shape) * paint.noise
        return np.asarray(cv2.cvtColor(np.clip(np.rint(raw), 0, 255).astype(np.uint8), cv2.COLOR_BayerRGGB2BGR))
    image = image + paint.black + rng.normal(0, 1, image.shape) * paint.noise
    return np.ascontiguousarray(np.clip(np.rint(image[..., ::-1]), 0, 255).astype(np.uint8))


def _half_angles(cal: Calibration, slit_px: float) -> FloatArray:
    """Each slit's half width in projector angle, so that it is about `slit_px` wide in the image of a clean pipe."""
    out = []
    for cone in cal.rings:
        t = np.array([cone.half_angle - 1e-4, cone.half_angle + 1e-4])
        wall = np.stack([0 * t, 0 * t + PIPE_MM, cone.vertex_mm[2] + PIPE_MM / np.tan(t)], axis=1)
        px = np.linalg.norm(np.diff(cal.camera.project(wall), axis=0))
        out.append(slit_px / 2 / px * 2e-4)
    return np.array(out)


def _shade(
    cal: Calibration,
    pose: Pose,
    radius: Radius | None,
    paint: Paint,
    half: FloatArray,
    rays: FloatArray,
    lit: Callable[[FloatArray], NDArray[np.bool_]] | None,
) -> FloatArray:
    out = np.zeros((len(rays), 3))
    ok = np.flatnonzero(np.isfinite(rays).all(axis=1))
    way, start = rays[ok] @ pose.rotation, -pose.translation @ pose.rotation
    a, b = (way[:, :2] ** 2).sum(axis=1), way[:, :2] @ start[:2]
    wall_mm = np.full(len(ok), cal.pipe_radius_mm)
    for _ in range(5 if radius else 1):  # fixed point on the wall's radius; the walls drawn here are gentle
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (-b + np.sqrt(np.maximum(b * b - a * (start[:2] @ start[:2] - wall_mm**2), 0))) / a
        wall = start + s[:, None] * way
        if radius:
            wall_mm = radius(np.arctan2(wall[:, 1], wall[:, 0]), wall[:, 2])
    stripe = np.zeros(len(ok), int)
    dark = ~np.isfinite(wall[:, 2]) | (wall[:, 2] < 5)
    camera_frame = pose.to_camera(wall)
    fringe = np.radians(2.2)
    for k, cone in enumerate(cal.rings):
        v = camera_frame - np.asarray(cone.vertex_mm)
        cosine = v @ np.asarray(cone.axis) / np.sqrt(np.einsum("ij,ij->i", v, v))
        t: FloatArray | float = cone.half_angle
        if paint.artefact is not None:
            axis = np.asarray(cone.axis)
            x = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
            x /= np.linalg.norm(x)
            t = t + paint.artefact(k, np.arctan2(v @ np.cross(axis, x), v @ x))
        stripe += cosine < np.cos(t)
        dark |= (cosine < np.cos(t - half[k])) & (cosine > np.cos(t + half[k]))
        if k == 0:
            dark |= cosine > np.cos(t - fringe)
        if k == len(cal.rings) - 1:
            dark |= cosine < np.cos(t + fringe)
    if lit is not None:
        dark |= ~lit(wall)
    fade = np.clip(110.0**2 / np.einsum("ij,ij->i", camera_frame, camera_frame), 0.15, 1.0)
    colour = np.asarray(paint.light)[["RGB".index(c) for c in cal.colours]][stripe] * fade[:, None]
    out[ok] = np.where(dark[:, None], 0.0, colour)
    return out
