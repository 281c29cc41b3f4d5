"""Where pixels look: rays of any camera, as host/native/twin_rays.c meets them with the plain cylinder."""

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.geometry.cone import intersect_cylinder
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.twin.worlds.world import World


class HeadPosition(Protocol):
    """Where the head is: a Pose, or one in a pipe of several pieces."""

    @property
    def rotation(self) -> FloatArray: ...

    def to_pipe(self, points: FloatArray, z_mm: float) -> FloatArray: ...


def eye_at(seen: HeadCamera, pose: HeadPosition, z_mm: float) -> Float32Array:
    """(12,) turn from the pipe's frame into that of one of the head's cameras, and where that stands, mm. pose : the
    head's, that is its first camera's."""
    turn, centre = placed(seen)
    return np.concatenate([(turn @ pose.rotation).ravel(), pose.to_pipe(centre[None], z_mm)[0]], dtype=np.float32)


def placed(seen: HeadCamera) -> tuple[FloatArray, FloatArray]:
    """(3, 3), (3,) mm: turn from the head's frame into the camera's, and where in the head's its centre is."""
    turn = np.array(seen.rotation)
    return turn, -np.array(seen.translation_mm) @ turn


def ray_table(
    world: World, seen_by: HeadCamera, coordinate: Callable[[FloatArray], FloatArray] | None
) -> tuple[Float32Array, Float32Array | None]:
    """Where every pixel looks: the table all cameras have, and what one without a single centre has besides.

    (3, H, W): x, y of every pixel's unit ray, and how its cot(theta) on the wall changes with a pixel: a ring on the
    wall of a clean pipe, half-angle t, is blurred by sin^2 t times that (zero where the lens sees nothing).
    (4, H, W): x, y, z (mm) where the ray starts, and the sign of its z.
    coordinate : along which the slide draws, of (N, 3) points in the head's frame, to take in place of cot(theta)
    where the projector does not look along with one camera.
    """
    camera = seen_by.camera
    grid = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1).astype(float)
    shape = (camera.height, camera.width, 3)
    start, rays = (part.reshape(shape) for part in camera.lines(grid.reshape(-1, 2)))
    across = np.hypot(rays[..., 0], rays[..., 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        if camera.mirror is None:
            theta = np.arctan2(across, rays[..., 2])
            spread = _slope(theta) / np.sin(theta) ** 2
            if coordinate is not None:
                spread = _slope(coordinate(_on_wall(world, seen_by, rays.reshape(-1, 3))).reshape(theta.shape))
            seen = (rays[..., 2] > 0) & (theta > 1e-3) & (theta < np.radians(world.optics.half_field_deg))
        else:
            reach = world.radius_mm - np.hypot(start[..., 0], start[..., 1])
            spread = _slope(start[..., 2] + reach * rays[..., 2] / across) / world.radius_mm
            eye = camera.mirror.eye_mm
            to_eye = eye - start  # the housing of the camera, a disc about its pinhole
            past = np.cross(to_eye, rays)
            facing = (rays * eye).sum(axis=-1) > 0
            seen = ~(facing & (np.linalg.norm(past, axis=-1) < world.housing_mm)) & (across > 1e-3)
    seen &= np.isfinite(spread)
    table = np.where(seen, np.stack([rays[..., 0], rays[..., 1], spread]), 0.0).astype(np.float32)
    if camera.central:
        return table, None
    sign = np.where(rays[..., 2] < 0, -1.0, 1.0)[..., None]
    return table, np.nan_to_num(np.concatenate([start, sign], axis=-1)).transpose(2, 0, 1).astype(np.float32).copy()


def _on_wall(world: World, seen: HeadCamera, rays: FloatArray) -> FloatArray:
    """(N, 3) where rays of a head that does not wobble meet the wall, in its frame."""
    turn, centre = placed(seen)
    middle, along = np.array([*world.centre_mm, 0.0]), np.array([0.0, 0.0, 1.0])
    return intersect_cylinder(rays @ turn, middle, along, world.radius_mm, np.broadcast_to(centre, rays.shape))


def _slope(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(*np.gradient(values)) if min(values.shape) > 1 else np.zeros_like(values)
