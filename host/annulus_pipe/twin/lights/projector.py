"""Light from one point through a slide: how much of it reaches a wall that faces it, and what rods keep back."""

import math

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.twin.rays import HeadPosition
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import STEP_Z_MM, World

EVERYWHERE = (0.0, 0.0, 0.0, 1e6)  # no pixel is known to be dark beforehand


class SlideProjector:
    """All but the slide, which says where its light is."""

    def __init__(
        self, world: World, seen: HeadCamera, axis: FloatArray, rims: tuple[float, float], brightest: float
    ) -> None:
        """seen : the camera it is drawn for. axis : (6,) point and unit vector in the head's frame. rims : the angles
        to it between which light comes. brightest : cosine over the squared distance of a wall that gets the peak.
        """
        self._world, self._seen, self._axis, self._rims = world, seen, axis, rims
        self._extremes = np.stack([world.radius_map.min(axis=1), world.radius_map.max(axis=1)], axis=1)
        self._power = world.projector.peak / max(world.albedo) / brightest
        vertex = axis[:3]
        # (rods, 5) x, y, radius, back, front as seen from the point, head's frame
        self.rods = np.array(
            [
                [r.x_mm - vertex[0], r.y_mm - vertex[1], r.radius_mm, r.z0_mm - vertex[2], r.z1_mm - vertex[2]]
                for r in world.rods
            ],
            np.float32,
        ).reshape(-1, 5)
        self._blur = math.sqrt(world.optics.blur_px**2 + 1.0 / 12.0)  # the pixel itself is a box
        self._focal = seen.camera.fx
        if (mirror := seen.camera.mirror) is not None:
            self._focal *= mirror.radius_mm / (2 * float(np.linalg.norm(mirror.centre_mm)))

    def beam(self, pose: HeadPosition, z_mm: float) -> Float32Array:
        """(22,) the light in one frame.

        Ring of the picture that it may be in (u, v, inner, outer, px); the point it comes from and its axis (pipe);
        its power; the turn from the pipe to the head; blur (px, sigma); px a radian.
        """
        lit = self._lit_circle(pose, z_mm) if isinstance(pose, Pose) else EVERYWHERE
        centre = in_pipe(self._axis[None], pose, z_mm)[0]
        numbers = [*lit, *centre, self._power, *pose.rotation.ravel(), self._blur, self._focal]
        return np.array(numbers, np.float32)

    def _lit_circle(self, pose: Pose, z_mm: float) -> tuple[float, ...]:
        """(u, v, inner, outer): pixels outside the ring inner..outer get no projector light."""
        world, camera = self._world, self._seen.camera
        turn, moved = np.array(self._seen.rotation), np.array(self._seen.translation_mm)
        # not worth a search: only the demo's frames must be quick
        if not camera.central or not isinstance(world.projector, Projector):
            return EVERYWHERE
        around = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        vertex, axis = self._axis[:3], self._axis[3:]
        side = np.cross(axis, [0.0, 1.0, 0.0])
        side /= np.linalg.norm(side)
        up = np.cross(axis, side)
        ring = np.cos(around)[:, None] * side + np.sin(around)[:, None] * up
        v = pose.to_pipe(vertex[None])[0]
        bounds = []
        for angle, extreme in ((self._rims[0] - 0.01, np.max), (self._rims[1] + 0.01, np.min)):
            rays = (math.cos(angle) * axis + math.sin(angle) * ring) @ pose.rotation
            # how deep or shallow the wall gets about where this rim meets it
            rim_mm = z_mm + v[2] + world.radius_mm / math.tan(angle)
            first, last = (round((rim_mm + d - world.z_range_mm[0]) / STEP_Z_MM) for d in (-30.0, 30.0))
            near = self._extremes[max(first, 0) : max(last, 0)]
            radius = world.radius_mm + float(extreme(near)) if near.size else world.radius_mm
            a = rays[:, 0] ** 2 + rays[:, 1] ** 2
            b = v[0] * rays[:, 0] + v[1] * rays[:, 1]
            s = (np.sqrt(b * b - a * (v[0] ** 2 + v[1] ** 2 - radius**2)) - b) / a
            bounds.append(camera.project(pose.to_camera(v + s[:, None] * rays) @ turn.T + moved))
        centre = bounds[1].mean(axis=0)
        inner = np.linalg.norm(bounds[0] - centre, axis=1).min() - 6.0
        outer = np.linalg.norm(bounds[1] - centre, axis=1).max() + 6.0
        return *centre, max(inner, 0.0), outer


def in_pipe(table: NDArray[np.float64], pose: HeadPosition, z_mm: float) -> Float32Array:
    """Rows of vertex, axis and more, from the camera frame to the pipe's."""
    place, way = pose.to_pipe(table[:, :3], z_mm), table[:, 3:6] @ pose.rotation
    return np.hstack([place, way, table[:, 6:]]).astype(np.float32)
