"""White LEDs round the lens, as one point behind it that shines all round."""

import math
from typing import NamedTuple

import numpy as np

from annulus_pipe.twin.rays import PipeCamera
from annulus_pipe.twin.stretch import F32, LEVEL, NX, NY, NZ, PixelRun, X, Y, Z, jit
from annulus_pipe.twin.worlds.world import World


class LedTable(NamedTuple):
    """The LEDs in one frame."""

    gain: F32  # (H,) on-time each row saw, over the nominal
    place: F32  # (3,) pipe frame, mm
    power: F32  # (3,) as red, green, blue pixels see it


@jit
def shine(part: PixelRun, led: LedTable) -> None:
    scratch, v, odd, led_power, lamp = part.scratch, part.v, part.odd, led.power, led.place
    gain = led.gain[v]
    zero = np.float32(0.0)
    for u in range(part.n):
        lx, ly, lz = scratch[X + u] - lamp[0], scratch[Y + u] - lamp[1], scratch[Z + u] - lamp[2]
        d2 = lx * lx + ly * ly + lz * lz
        facing = lx * scratch[NX + u] + ly * scratch[NY + u] + lz * scratch[NZ + u]
        power = led_power[(v & 1) + 1] if (u & 1) != odd else led_power[v & 1]
        scratch[LEVEL + u] += gain * power * max(facing, zero) / (d2 * np.sqrt(d2))


class LedRing:
    def __init__(self, world: World) -> None:
        near = math.atan2(world.radius_mm, 45.0 + world.led.behind_mm)
        power = world.led.peak / max(world.albedo) / (math.sin(near) ** 3 / world.radius_mm**2)
        self._power = (power * np.array(world.led.colour)).astype(np.float32)
        self._behind_mm, self._aside_mm = world.led.behind_mm, world.led.aside_mm

    def table(self, first: PipeCamera, gain: F32) -> LedTable:
        """first : the head's first camera, behind which they shine."""
        aside, down = self._aside_mm
        place = first.station - np.float64(self._behind_mm) * first.rotation[2]  # rounded once
        place = place + np.float64(aside) * first.rotation[0] + np.float64(down) * first.rotation[1]
        return LedTable(gain, place.astype(np.float32), self._power)
