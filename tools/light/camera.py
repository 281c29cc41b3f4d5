"""A drawn pipe in pictures, path-traced: linear light, no noise of a sensor.

Light straight from the slide is drawn in every pixel; what walls hand on to one another is smooth, and drawn smaller.
Each picture has a seed of its own, and no sample lies in two pixels: equal scenes give equal pictures.
"""

import math
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tools.bench.blind.head import reach_of
from tools.bench.blind.pipe import Scene, Stand
from tools.bench.blind.surface import Surface
from tools.light import kernel, tube
from tools.light.effects import Effects
from tools.light.lens import fisheye, through_lens
from tools.light.mitsuba3 import mi
from tools.light.shapes import pipe_shapes, rods
from tools.light.slide import OPEN, angles_of, dusty, picture, smeared, transmission

Array = NDArray[np.float64]
STRAIGHT_SAMPLES = 4  # a pixel, of light straight from the lamp
HANDED_SAMPLES, COARSER = 8, 4  # a pixel of the smaller picture, of what was on another wall before
SMOOTH_PX = 1.5  # of that picture's pixels: what walls hand on is smooth, its noise is not
LEDS, LED_ASIDE_OF_RADIUS = 3, 0.12
SEEN_DEG = 62.0  # half-angle that a fisheye's picture has; beyond is no ring's light
BRIGHT = 0.5


class Camera:
    """Pictures of one scene under some effects."""

    def __init__(self, scene: Scene, effects: Effects) -> None:
        self.scene, self.effects, self.surface = scene, effects, Surface(scene.pipe)
        last = max(one.z_mm for one in scene.stands) + reach_of(scene.head, scene.pipe.radius_mm).far
        self.shapes = {name: _built(shape) for name, shape in pipe_shapes(scene, effects, last).items()}
        head, radius = scene.head, scene.pipe.radius_mm
        self.angles = angles_of(head)
        self.light = transmission(head, self.angles)
        if effects.scatter_mm:
            albedo = np.array(scene.pipe.material.albedo)
            self.light = smeared(self.angles, self.light, radius, lambda t: kernel.parts(t, albedo, effects.scatter_mm))
        self.half_angle = OPEN * (head.slits[-1][1] + head.margin_rad)
        self._slides: dict[float, list[tuple[float, Any]]] = {}

    def photograph(self, stand: Stand) -> Array:
        """(H, W, 3) float64, blue first, linear light of one frame."""
        scene, head, radius = self.scene, self.scene.head, self.scene.pipe.radius_mm
        at, axes = self.stands(stand)
        part = stand.drift if scene.change.grows else 1.0
        held = rods(head.rods, at, axes, -head.vertex_mm[2] - 0.02 * radius)
        focal = head.focal_px * (1.0 + part * scene.change.focal)
        sensor = self._sensor(at, axes, focal)
        seed = scene.seed * 4096 + stand.index
        lamps = self._leds(at, axes) if stand.lamp == "led" else self._projectors(at, axes, part)
        straight = self._render(lamps, held, sensor(1), 2, STRAIGHT_SAMPLES, seed)
        if self.effects.bounces > 1 and stand.lamp != "led":
            all_of_it = self._render(lamps, held, sensor(COARSER), 1 + self.effects.bounces, HANDED_SAMPLES, seed + 1)
            size = all_of_it.shape[1::-1]
            handed = all_of_it - cv2.resize(straight, size, interpolation=cv2.INTER_AREA)
            handed = np.maximum(cv2.GaussianBlur(handed, (0, 0), SMOOTH_PX), 0.0)  # noise of a slit's edge, too
            straight += cv2.resize(handed, straight.shape[1::-1], interpolation=cv2.INTER_LINEAR)
        centre = head.centre_px
        if head.model == "fisheye":
            straight = fisheye(straight, head.focal_px, focal, (head.width, head.height), centre)
        return np.asarray(through_lens(straight, self.effects, centre)[..., ::-1])

    def stands(self, stand: Stand) -> tuple[Array, Array]:
        """Where the camera is in space, and its axes (columns x, y, ahead)."""
        origin, frame = self.surface.frame_at(stand.z_mm)
        turned = Rotation.from_euler("xy", [stand.rx, stand.ry]).as_matrix().T
        return origin - frame @ turned @ np.array([stand.tx_mm, stand.ty_mm, 0.0]), frame @ turned

    def back_mm(self) -> list[float]:
        """How far behind the projector each slit's light seems to come from."""
        glass, slits = self.effects.tube, self.scene.head.slits
        return [0.0 if glass is None else tube.behind_mm(glass, sum(one) / 2) for one in slits]

    # ---- lamps -----------------------------------------------------------------------------------------------------
    def _projectors(self, at: Array, axes: Array, part: float) -> list[dict[str, Any]]:
        """One; behind a tube one for every ring, each as far back as the tube puts it."""
        head, change, radius = self.scene.head, self.scene.change, self.scene.pipe.radius_mm
        vertex = at + axes @ (np.array(head.vertex_mm) + part * np.array(change.shift_mm))
        x, y = part * np.array(change.turn_rad)
        axis = np.array(head.axis) + np.array([x, y, 0.0])
        ahead = axes @ (axis / np.linalg.norm(axis))
        up = np.cross(ahead, axes[:, 0])
        up /= np.linalg.norm(up)
        power = BRIGHT / max(self.scene.pipe.material.albedo) * (radius / math.sin(self.half_angle)) ** 2
        return [
            {
                "type": "projector",
                "irradiance": bitmap,
                "fov": 2.0 * math.degrees(self.half_angle),
                "scale": power,
                "to_world": _placed(vertex - back * ahead, np.stack([np.cross(up, ahead), up, ahead], 1)),
            }
            for back, bitmap in self._slide(1.0 + part * change.angles)
        ]

    def _slide(self, scale: float) -> list[tuple[float, Any]]:
        """(how far back, its picture) of every projector; `scale` : of the slide's angles since the calibration."""
        if scale not in self._slides:
            head, effects, radius = self.scene.head, self.effects, self.scene.pipe.radius_mm
            tables: list[tuple[float, Array, Any]] = [(0.0, self.light, None)]
            if effects.tube is not None:
                tables = []
                for near, back in zip(_rings(self.angles, head.slits), self.back_mm(), strict=True):
                    came = tube.came(effects.tube, back, self.angles, radius)
                    tables.append((back, self.light * near[:, None], came))
            slides = []
            for back, light, came in tables:
                image = picture(self.angles * scale, light, self.half_angle, came)
                if effects.dust:
                    dusty(image, head, self.half_angle, effects.dust, np.random.default_rng([self.scene.seed, 0xD057]))
                slides.append((back, _bitmap(image)))
            self._slides = {scale: slides}
        return self._slides[scale]

    def _leds(self, at: Array, axes: Array) -> list[dict[str, Any]]:
        radius = self.scene.pipe.radius_mm
        power = BRIGHT / max(self.scene.pipe.material.albedo) / LEDS * radius**2
        turns = 2.0 * math.pi * np.arange(LEDS) / LEDS
        return [
            {
                "type": "point",
                "intensity": {"type": "rgb", "value": power},
                "position": list(at + axes @ (LED_ASIDE_OF_RADIUS * radius * np.array([math.cos(t), math.sin(t), 0]))),
            }
            for t in turns
        ]

    # ---- pictures --------------------------------------------------------------------------------------------------
    def _sensor(self, at: Array, axes: Array, focal: float) -> Any:
        """A function of how much coarser: a pinhole camera, its rays through pixels as the head's lens has them;
        for a fisheye a plane picture as fine in its middle, with the axis there."""
        head = self.scene.head
        wide, high, (x, y) = float(head.width), float(head.height), head.centre_px
        if head.model == "fisheye":
            focal = head.focal_px
            wide = high = 2.0 * math.ceil(focal * math.tan(math.radians(SEEN_DEG)))
            x = y = (wide - 1.0) / 2.0
        offset = ((wide - 1.0) / 2.0 - x) / wide, ((high - 1.0) / 2.0 - y) / high  # Mitsuba's go the other way

        def sensor(coarser: int) -> Any:
            film = {
                "type": "hdrfilm",
                "width": round(wide / coarser),
                "height": round(high / coarser),
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            }
            return {
                "type": "perspective",
                "fov": 2.0 * math.degrees(math.atan(wide / 2.0 / focal)),
                "fov_axis": "x",
                "principal_point_offset_x": offset[0],
                "principal_point_offset_y": offset[1],
                "near_clip": 0.1,
                "far_clip": 1e5,
                "to_world": _placed(at, axes),
                "film": film,
            }

        return sensor

    def _render(
        self,
        lamps: list[dict[str, Any]],
        held: dict[str, Any],
        sensor: dict[str, Any],
        depth: int,
        samples: int,
        seed: int,
    ) -> Array:
        """Sum over the lamps, each drawn alone: one that is picked by lot makes noise."""
        total: Array | None = None
        each = max(2, samples // len(lamps)) if len(lamps) > 1 else samples
        for k, lamp in enumerate(lamps):
            scene = mi.load_dict(
                {
                    "type": "scene",
                    "integrator": {"type": "path", "max_depth": depth, "rr_depth": 64},
                    "sensor": {**sensor, "sampler": {"type": "multijitter", "sample_count": each}},
                    "lamp": lamp,
                    **held,
                    **self.shapes,
                }
            )
            image = np.array(mi.render(scene, seed=seed * 16 + k), dtype=np.float64)
            total = image if total is None else total + image
        assert total is not None
        return total


def _rings(angles: Array, slits: tuple[tuple[float, float], ...]) -> list[Array]:
    """For every slit the half-angles nearer to it than to others, parts that sum to 1 and meet within stripes."""
    over = [np.ones_like(angles)]
    for (_, inner), (outer, _) in pairwise(slits):
        middle, width = (inner + outer) / 2, (outer - inner) / 3
        over.append(np.clip((angles - middle) / width + 0.5, 0.0, 1.0))
    return [one - other for one, other in pairwise([*over, np.zeros_like(angles)])]


def _placed(at: Array, axes: Array) -> Any:
    """Mitsuba's cameras and projectors have x to the left and y up."""
    matrix = np.eye(4)
    matrix[:3, :3] = axes * np.array([-1.0, -1.0, 1.0])
    matrix[:3, 3] = at
    return mi.ScalarTransform4f(matrix)


def _bitmap(image: NDArray[np.float32]) -> Any:
    return mi.load_dict(
        {"type": "bitmap", "bitmap": mi.Bitmap(image), "raw": True, "filter_type": "bilinear", "wrap_mode": "clamp"}
    )


def _built(shape: Any) -> Any:
    return mi.load_dict(shape) if isinstance(shape, dict) else shape
