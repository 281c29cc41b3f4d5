"""Which slides a world's projector holds."""

from typing import Any

from annulus_pipe.twin.lights.slits import SlitLight
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import World

# A slide has `axis`, `rims` and `brightest` (see SlideProjector), `coordinate(points)`, along which it draws, and
# `by_coordinate`, whether one camera needs that too; `kind`, its place among SLIDES of host/native/twin_lights.c; and a
# method `table(pose, z_mm)` that gives the numbers which the loop there reads, for one frame.
Slide = Any


def slides_of(world: World) -> tuple[Slide, ...]:
    """Of a world's projector, in its order."""
    light = world.projector
    if isinstance(light, Projector):
        return (SlitLight(light, world.radius_mm, world.translucency),)
    return light.drawn()
