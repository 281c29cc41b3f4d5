"""What the camera sees of a world: one Bayer frame, lit row by row by as much of each lamp as the gates gave it.

`rays` says where pixels look, `walls` and `course` what they meet, `lights` what arrives there; here paint and sensor
are added. All that is tables of numbers; the loops over pixels that read them are host/native/twin_*.c.
Light comes from two points (projector, LED), so shadows of rods and of the wall itself are rays too.
"""

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import Float32Array, Image
from annulus_pipe.numeric.native import door
from annulus_pipe.twin.course import TUBE, InSpace, tube_of
from annulus_pipe.twin.lights.led import LedRing
from annulus_pipe.twin.lights.projector import SlideProjector
from annulus_pipe.twin.lights.slide import slides_of
from annulus_pipe.twin.rays import eye_at, ray_table
from annulus_pipe.twin.walls import wall_of
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import World

_NOISE = 1 << 20
_APART = 0x2545F491  # seeds of two cameras' noise in one frame

# Of a frame: where it goes, seed of its noise; of the camera: see `rays`.
_FRAME = ("u1[h,w]! out", "i8 seed", "f4[3,h,w] rays", "f4[12] eye")
_WALL = (
    "f4[5] wall",
    "f4[r,p] deviation",
    "f4[t,c] tile_low",
    "f4[t,c] tile_high",
    "f4[t,c] near_low",
    "f4[t,c] near_high",
    "u1[t,c] kind",
)
# What the wall reflects, 255 = all, and a bare one, 1 = all; what each row collected of either lamp's light, and the
# lamps; black level, read noise, variance per level and the balance of red, green and blue; standard normal numbers.
_LIGHT = (
    "u1[3,r,a] albedo",
    "f4[3] base",
    "f4[h] beam_gain",
    "f4[22] beam",
    "f4[n,5] rods",
    "i8 slide",
    "f4[s] slide_numbers",
    "f4[h] led_gain",
    "f4[6] led",
    "f4[6] pixel",
    "f4[z] noise",
)
_draw = door("twin_draw", *_FRAME, "f4[4,h,w]? starts", *_WALL, *_LIGHT)
_draw_course = door("twin_draw_course", *_FRAME, "f4[h,w] pixel_rad", "f8[2] rims", "i8 hint", *TUBE, *_LIGHT)


class Renderer:
    """Draws what one camera of a world sees. Holds tables, no state between frames; safe to call from several
    threads.
    """

    def __init__(self, world: World, camera: int = 0) -> None:
        """camera : which of the world's, from 0."""
        self.world, self._number = world, camera
        self._first, self._seen = world.cameras[0], world.cameras[camera]
        self.height, self.width = self._seen.camera.height, self._seen.camera.width
        self._met = wall_of(world) if world.course is None else tube_of(world)
        albedo = np.pad(world.albedo_map.transpose(2, 0, 1), ((0, 0), (0, 0), (0, 1)), mode="wrap")
        self._paint = (albedo, np.array(world.albedo, np.float32))
        self._slides = slides_of(world)
        tables = [
            ray_table(world, self._seen, slide.coordinate if world.others or slide.by_coordinate else None)
            for slide in self._slides
        ]
        self._rays, self._starts = [rays for rays, _ in tables], tables[0][1]
        self._projectors = [
            SlideProjector(world, self._seen, slide.axis, slide.rims, slide.brightest) for slide in self._slides
        ]
        self._led = LedRing(world)
        self._pixel_rad = None if world.course is None else _pixel_rad(self._rays[0])
        optics = world.optics
        noise = np.random.default_rng([world.seed, 0x4015E]).standard_normal(_NOISE)
        pixel = np.array([optics.black, optics.read, optics.shot, *optics.balance], np.float32)
        self._pixel = (pixel, noise.astype(np.float32))

    def render(
        self,
        pose: Pose,
        z_mm: float,
        projector: Float32Array | float = 0.0,
        led: Float32Array | float = 0.0,
        *,
        slot: int | None = None,
        seed: int = 0,
        out: Image | None = None,
    ) -> Image:
        """One raw frame, (H, W) uint8, RGGB mosaic.

        pose, z_mm : where the head, its first camera, was when the light flashed. projector, led : light each row
        collected, in units of the lamp's nominal on-time, (H,) or one number. slot : of the lamp cycle, which tells
        several slides apart. seed : of this frame's noise. out : where to draw it.
        """
        frame = np.empty((self.height, self.width), np.uint8) if out is None else out
        gains = [np.array(np.broadcast_to(g, (self.height,)), np.float32) for g in (projector, led)]
        noise = (seed + self._number * _APART) & 0x7FFFFFFF
        light, course = self.world.projector, self.world.course
        lit = 0 if isinstance(light, Projector) else light.lit(slot)
        head = pose if course is None else InSpace(pose, course).at(z_mm)
        eye, first = (eye_at(one, head, z_mm) for one in (self._seen, self._first))
        slide, beam = self._slides[lit], self._projectors[lit]
        place = (frame, noise, self._rays[lit], eye)
        light_falls = (gains[0], beam.beam(head, z_mm), beam.rods, slide.kind, slide.table(head, z_mm))
        lamps = (*light_falls, gains[1], self._led.table(first))
        if course is None:
            _draw(*place, self._starts, *self._met, *self._paint, *lamps, *self._pixel)
        else:
            # of a frame of the LED alone no light of the projector is asked for
            rims = np.cos(slide.rims) if gains[0].any() else np.array([-1.0, 1.0])
            piece = course.frame(z_mm)[2]
            _draw_course(*place, self._pixel_rad, rims, piece, *self._met, *self._paint, *lamps, *self._pixel)
        return frame


def _pixel_rad(rays: Float32Array) -> Float32Array:
    """(H, W) angle between the rays of neighbouring pixels; the mean of both ways, as a blur sees it."""
    way = rays.astype(np.float64)
    way[2] = np.sqrt(np.maximum(1.0 - way[0] ** 2 - way[1] ** 2, 0.0))
    down, right = (np.linalg.norm(np.gradient(way, axis=axis), axis=0) for axis in (1, 2))
    return np.ascontiguousarray(np.sqrt(down * right), dtype=np.float32)
