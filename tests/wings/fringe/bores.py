"""A pipe before a fisheye and a slide of rings, ray by ray: no code of the method used but the slide's phase and the
lens's rays. Grooves are cut straight down; their rims hide and shade what lies behind them."""

from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.wings.fringe.measure import FringeProjector

RADIUS_MM = 60.0
LENS = HeadCamera(0, Camera("fisheye", 360, 360, 150.0, 150.0, 179.5, 179.5, (0.02, -0.004, 0.0, 0.0)))
TURN = Rotation.from_rotvec([0.006, -0.004, 0.0]).as_matrix()
SLIDE = FringeProjector("rings", (0.3, -0.2, -40.0), tuple(tuple(row) for row in TURN), 7.0, 0.7, 0.0, RADIUS_MM)
FIELD_DEG = (22.0, 40.0)
EDGE_DEG = 3.0  # beside it: more than a pixel sees, and a groove's depth moves


def drawn(
    poses: FloatArray,
    *,
    slide: FringeProjector = SLIDE,
    groove: tuple[float, float, float, float] | None = None,
    texture: float = 0.2,
    noise: float = 0.7,
    blur_px: float = 0.8,
    seed: int = 1,
    over: int = 2,
) -> Float32Array:
    """(N, H, W) grey levels, linear. poses : (N, 6) lean (rad) and place (mm) of the head. groove : z0, z1, half its
    arc (deg, about phi = 0), depth. over : rays either way in a pixel."""
    camera, random = LENS.camera, np.random.default_rng(seed)
    rays = _rays(over)
    first = rays.reshape(camera.height, over, camera.width, over, 3)[:, 0, :, 0].reshape(-1, 3)
    out = []
    for pose in poses:
        turn = Rotation.from_rotvec(pose[:3]).as_matrix()
        # most pixels see no light at all: the first ray of each says so, long before the field's edge
        angle = _angle(slide, (_met(first @ turn, pose[3:], RADIUS_MM) - pose[3:]) @ turn.T)
        near = (angle > FIELD_DEG[0] - EDGE_DEG) & (angle < FIELD_DEG[1] + EDGE_DEG)
        lit = np.kron(near.reshape(camera.height, camera.width), np.ones((over, over), bool))
        way = rays[lit.ravel()] @ turn
        x, bright = _met(way, pose[3:], RADIUS_MM), np.ones(len(way))
        if groove is not None:
            inside = np.flatnonzero((x[:, 2] > groove[0]) & (x[:, 2] < groove[1]))
            inside = inside[np.abs(np.degrees(np.arctan2(x[inside, 1], x[inside, 0]))) < groove[2]]
            lamp = pose[3:] + np.array(slide.centre_mm) @ turn
            x[inside], bright[inside] = _cut(groove, way[inside], x[inside], pose[3:], lamp)
        head = (x - pose[3:]) @ turn.T
        beam, angle = (head - slide.centre_mm) @ np.array(slide.rotation).T, _angle(slide, head)
        phase, wave = slide.phase(head), 0.0
        for k, (even, odd) in enumerate(np.reshape(slide.harmonics, (-1, 2)), start=2):
            wave = wave + even * np.cos(k * phase) + odd * np.sin(k * phase)
        albedo = 1 + texture * np.sin(x[:, 2] * 0.57) * np.cos(8 * np.arctan2(x[:, 1], x[:, 0]))
        light = 90 * albedo * (1 + 0.8 * (np.cos(phase) + wave)) * (100 / np.maximum(beam[:, 2], 1.0)) * bright
        whole = np.zeros(lit.shape)
        whole[lit] = np.where((angle > FIELD_DEG[0]) & (angle < FIELD_DEG[1]), light, 0.0)
        seen = gaussian_filter(whole, blur_px * over)
        seen = seen.reshape(camera.height, over, camera.width, over).mean(axis=(1, 3))
        out.append(seen + random.normal(0, noise, seen.shape))
    return np.array(out, np.float32)


@cache
def _rays(over: int) -> FloatArray:
    """(P, 3) of all pixels, row by row of `over` rays each way."""
    camera = LENS.camera
    v, u = (np.mgrid[: camera.height * over, : camera.width * over] + 0.5) / over - 0.5
    rays = camera.rays(np.stack([u.ravel(), v.ravel()], axis=1))
    rays[~np.isfinite(rays).all(axis=1)] = [0.0, 0.0, 1.0]
    return rays


def _angle(slide: FringeProjector, head: FloatArray) -> FloatArray:
    """(P,) deg, of places in the head's frame to the projector's axis."""
    beam = (head - slide.centre_mm) @ np.array(slide.rotation).T
    return np.asarray(np.degrees(np.arctan2(np.hypot(beam[:, 0], beam[:, 1]), beam[:, 2])))


def _cut(
    groove: tuple[float, float, float, float], way: FloatArray, x: FloatArray, eye: FloatArray, lamp: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Where lines of sight that meet the wall at x, within the groove, meet it with the groove in it, and its light
    over the wall's."""
    z0, z1, _, depth = groove
    floor = _met(way, eye, RADIUS_MM + depth)
    side = floor[:, 2] > z1
    with np.errstate(divide="ignore", invalid="ignore"):
        end = eye + way * ((z1 - eye[2]) / way[:, 2])[:, None]
    out = np.where(side[:, None], end, floor)
    beam = out - lamp
    steep = beam[:, 2] / np.hypot(beam[:, 0], beam[:, 1])
    over = _met(beam, lamp, RADIUS_MM)[:, 2]
    return out, np.where(over < z0, 0.0, np.where(side, steep, 1.0))


def _met(way: FloatArray, start: FloatArray, radius: float) -> FloatArray:
    """(P, 3) where lines from `start` meet the cylinder."""
    a = way[:, 0] ** 2 + way[:, 1] ** 2
    b = way[:, 0] * start[0] + way[:, 1] * start[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        far = (-b + np.sqrt(np.maximum(b * b - a * (start[0] ** 2 + start[1] ** 2 - radius**2), 0))) / a
    return np.asarray(start + np.where(np.isfinite(far), np.minimum(far, 1e4), 1e4)[:, None] * way)
