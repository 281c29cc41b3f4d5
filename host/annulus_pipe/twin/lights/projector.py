"""Light from one point through a slide: how much of it reaches a wall that faces it, and what rods keep back."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.twin.rays import HeadPosition
from annulus_pipe.twin.stretch import AT, F32, LIT, NX, NY, NZ, OPEN, PixelRun, S, X, Y, Z, jit, step_up
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import STEP_Z_MM, World

EVERYWHERE = (0.0, 0.0, 0.0, 1e6)  # no pixel is known to be dark beforehand


class Beam(NamedTuple):
    """The projector's light in one frame."""

    gain: F32  # (H,) on-time each row saw, over the nominal
    lit: F32  # u, v, inner, outer (px): pixels outside the ring get none of it
    centre: F32  # (6,) the point it comes from and its axis, pipe frame
    power: np.float32
    rods: F32  # (rods, 5) x, y, radius, back, front as seen from the point, head's frame
    rotation: F32  # (3, 3), pipe to head
    blur: np.float32  # px, sigma
    focal: np.float32  # px a radian


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
        self._power = np.float32(world.projector.peak / max(world.albedo) / brightest)
        vertex = axis[:3]
        self._rods = np.array(
            [
                [r.x_mm - vertex[0], r.y_mm - vertex[1], r.radius_mm, r.z0_mm - vertex[2], r.z1_mm - vertex[2]]
                for r in world.rods
            ],
            np.float32,
        ).reshape(-1, 5)
        self._blur = np.float32(math.sqrt(world.optics.blur_px**2 + 1.0 / 12.0))  # the pixel itself is a box
        self._focal = np.float32(seen.camera.fx)
        if (mirror := seen.camera.mirror) is not None:
            self._focal *= np.float32(mirror.radius_mm / (2 * np.linalg.norm(mirror.centre_mm)))

    def beam(self, pose: HeadPosition, z_mm: float, gain: F32) -> Beam:
        centre = in_pipe(self._axis[None], pose, z_mm)[0]
        lit = self._lit_circle(pose, z_mm) if isinstance(pose, Pose) else np.array(EVERYWHERE, np.float32)
        rotation = pose.rotation.astype(np.float32)
        return Beam(gain, lit, centre, self._power, self._rods, rotation, self._blur, self._focal)

    def _lit_circle(self, pose: Pose, z_mm: float) -> F32:
        """(u, v, inner, outer): pixels outside the ring inner..outer get no projector light."""
        world, camera = self._world, self._seen.camera
        turn, moved = np.array(self._seen.rotation), np.array(self._seen.translation_mm)
        # not worth a search: only the demo's frames must be quick
        if not camera.central or not isinstance(world.projector, Projector):
            return np.array(EVERYWHERE, np.float32)
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
        return np.array([*centre, max(inner, 0.0), outer], np.float32)


def in_pipe(table: NDArray[np.float64], pose: HeadPosition, z_mm: float) -> F32:
    """Rows of vertex, axis and more, from the camera frame to the pipe's."""
    place, way = pose.to_pipe(table[:, :3], z_mm), table[:, 3:6] @ pose.rotation
    return np.hstack([place, way, table[:, 6:]]).astype(np.float32)


@jit
def fall(part: PixelRun, beam: Beam) -> None:
    """What the beam would give each pixel's place without a slide, and at which angle to its axis that place lies."""
    scratch, centre, gain, power = part.scratch, beam.centre, beam.gain[part.v], beam.power
    vx, vy, vz, ax, ay, az = centre[0], centre[1], centre[2], centre[3], centre[4], centre[5]
    one, zero = np.float32(1.0), np.float32(0.0)
    for u in range(part.n):
        px, py, pz = scratch[X + u] - vx, scratch[Y + u] - vy, scratch[Z + u] - vz
        d2 = px * px + py * py + pz * pz
        inverse = one / np.sqrt(d2)
        facing = px * scratch[NX + u] + py * scratch[NY + u] + pz * scratch[NZ + u]
        scratch[LIT + u] = gain * power * max(facing, zero) * inverse * inverse * inverse * scratch[OPEN + u]
        scratch[AT + u] = (px * ax + py * ay + pz * az) * inverse


@jit
def shade(part: PixelRun, beam: Beam) -> None:
    """Rods on the way of the light."""
    scratch, n, rods, centre, rotation = part.scratch, part.n, beam.rods, beam.centre, beam.rotation
    blur, focal = beam.blur, beam.focal
    r00, r01, r02 = rotation[0, 0], rotation[0, 1], rotation[0, 2]
    r10, r11, r12 = rotation[1, 0], rotation[1, 1], rotation[1, 2]
    r20, r21, r22 = rotation[2, 0], rotation[2, 1], rotation[2, 2]
    vx, vy, vz = centre[0], centre[1], centre[2]
    one, zero = np.float32(1.0), np.float32(0.0)
    for i in range(rods.shape[0]):
        rx, ry, thick, back, front = rods[i, 0], rods[i, 1], rods[i, 2], rods[i, 3], rods[i, 4]
        shaded = 0
        for u in range(n):
            x, y, z = scratch[X + u] - vx, scratch[Y + u] - vy, scratch[Z + u] - vz
            px, py = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z
            across = rx * py - ry * px
            near = across * across < np.float32(4.0) * thick * thick * (px * px + py * py)
            shaded += 1 if near and rx * px + ry * py > zero else 0
        if shaded == 0:
            continue
        for u in range(n):
            x, y, z = scratch[X + u] - vx, scratch[Y + u] - vy, scratch[Z + u] - vz
            px, py = r00 * x + r01 * y + r02 * z, r10 * x + r11 * y + r12 * z
            pz = r20 * x + r21 * y + r22 * z
            flat2 = px * px + py * py
            t = (rx * px + ry * py) / flat2  # where on its way the light passes nearest to the rod
            wide2 = rx * rx + ry * ry - t * t * flat2
            z = t * pz
            past = max(max(z - front, back - z), zero)
            past2 = past * past * flat2 / (flat2 + pz * pz)
            distance = np.sqrt(max(wide2 + past2, zero))
            far = scratch[S + u] * max(t, np.float32(0.05))
            through = step_up((distance - thick) * focal / (blur * far))
            scratch[LIT + u] *= through if t > 0 else one
