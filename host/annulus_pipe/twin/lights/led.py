"""White LEDs round the lens, as one point behind it that shines all round."""

import math

import numpy as np

from annulus_pipe.numeric.arrays import Float32Array
from annulus_pipe.twin.worlds.world import World


class LedRing:
    def __init__(self, world: World) -> None:
        near = math.atan2(world.radius_mm, 45.0 + world.led.behind_mm)
        power = world.led.peak / max(world.albedo) / (math.sin(near) ** 3 / world.radius_mm**2)
        self._power = power * np.array(world.led.colour)
        self._behind_mm, self._aside_mm = world.led.behind_mm, world.led.aside_mm

    def table(self, first: Float32Array) -> Float32Array:
        """(6,) where they shine from, mm in the pipe's frame, and their power as red, green and blue pixels see it.

        first : the head's first camera, behind which they are, see `rays.eye_at`.
        """
        aside, down = self._aside_mm
        x, y, z, station = first.reshape(4, 3).astype(np.float64)
        return np.concatenate([station - self._behind_mm * z + aside * x + down * y, self._power], dtype=np.float32)
