"""Pairs of frames of a target drawn by the tests themselves: in white light, and with the projector's rings on it."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.numeric.arrays import FloatArray
from tests.scenes.calibrate.photographs import DrawnTarget, _rays, poses

COLOURS = "RRGBGR"
LIGHT = {"R": (4.0, 8.0, 215.0), "G": (22.0, 190.0, 10.0), "B": (170.0, 20.0, 4.0)}  # BGR of each stripe
BLACK = 0.1  # what black print lets back
HALF_SLIT = 0.009  # rad: 8 px of a head with f = 470 px


def cones(theta_deg: tuple[float, ...] = (37.9, 42.4, 47.5, 52.8, 57.7)) -> tuple[Cone, ...]:
    axis = np.array([-0.016, 0.015, 1.0])
    axis /= np.linalg.norm(axis)
    return tuple(
        Cone(np.radians(t / 2), (float(axis[0]), float(axis[1]), float(axis[2])), (1.1, -1.0, -56.5 + 0.4 * i))
        for i, t in enumerate(theta_deg)
    )


def pair(
    camera: Camera,
    target: DrawnTarget,
    rings: tuple[Cone, ...],
    rotation: FloatArray,
    middle_mm: FloatArray,
    colours: str = COLOURS,
    seed: int = 0,
    blur_px: float = 0.7,
    noise: float = 1.5,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """(H, W, 3) BGR: white light, rings."""
    shift = np.asarray(middle_mm) - rotation @ target.middle_mm
    stripes = np.array([LIGHT[c] for c in colours])
    white, ringed = np.zeros((2, camera.height * camera.width, 3))
    for dx, dy in ((-0.375, -0.125), (-0.125, 0.375), (0.125, -0.375), (0.375, 0.125)):
        rays = _rays(camera, dx, dy).astype(float)
        with np.errstate(divide="ignore", invalid="ignore"):
            s = (rotation[:, 2] @ shift) / (rays @ rotation[:, 2])
        hit = np.flatnonzero((s > 0) & (s < 2000))
        points = s[hit, None] * rays[hit]
        flat = (points - shift) @ rotation[:, :2]
        paper = BLACK + (1 - BLACK) * target.paint(flat)
        paper *= np.all((flat > -1.0 * target.square_mm) & (flat < target.middle_mm[:2] * 2 + target.square_mm), axis=1)
        stripe = np.zeros(len(hit), int)
        dark = np.zeros(len(hit), bool)
        for k, cone in enumerate(rings):
            v = points - np.asarray(cone.vertex_mm)
            theta = np.arccos(v @ np.asarray(cone.axis) / np.linalg.norm(v, axis=1))
            stripe += theta > cone.half_angle
            dark |= np.abs(theta - cone.half_angle) < HALF_SLIT
            dark |= (theta < cone.half_angle - 0.04) if k == 0 else False
            dark |= (theta > cone.half_angle + 0.04) if k == len(rings) - 1 else False
        fall = np.clip(120.0**2 / np.einsum("ij,ij->i", points, points), 0.1, 1.1)
        ringed[hit] += stripes[stripe] * (np.where(dark, 0.0, paper * fall) / 4)[:, None]
        white[hit] += (200.0 * paper * fall / 4)[:, None]
    rng = np.random.default_rng(seed)
    out = []
    for image in (white, ringed):
        soft = cv2.GaussianBlur(image.reshape(camera.height, camera.width, 3), (0, 0), blur_px)
        out.append(np.clip(np.rint(soft + 3 + rng.normal(0, noise, soft.shape)), 0, 255).astype(np.uint8))
    return out[0], out[1]


def write_scan(
    folder: Path, camera: Camera, target: DrawnTarget, rings: tuple[Cone, ...], count: int, colours: str = COLOURS
) -> None:
    """A scan folder of `count` pairs, near and far, tilted."""
    lines = ["index,file,light,z_mm"]
    for i, (rotation, middle) in enumerate(poses(camera, target, count, off=0.12, tilt_deg=40.0, seed=4)):
        away = (110.0, 150.0, 200.0)[i % 3] * middle / np.linalg.norm(middle)
        for light, image in zip(
            ("led", "projector"), pair(camera, target, rings, rotation, away, colours, seed=i), strict=True
        ):
            cv2.imwrite(str(folder / f"{i:02d}-{light}.png"), image)
            lines.append(f"{len(lines) - 1},{i:02d}-{light}.png,{light},{i}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n")
