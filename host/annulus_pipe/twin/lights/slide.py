"""Which slide the projector holds: for a world by what it says, in a frame's kernel by the type of its table."""

from typing import Any

import numba.extending

from annulus_pipe.hooks import merged
from annulus_pipe.twin.lights.slits import SlitLight
from annulus_pipe.twin.stretch import OPTIONS
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import World

# A slide has `axis`, `rims` and `brightest` (see SlideProjector), `coordinate(points)`, along which it draws, and
# `by_coordinate`, whether one camera needs that too; a method `table(pose, z_mm)` that gives its numbers for one frame
# as a `Table`, and the kernel that reads them.
Slide = Any


def slides_of(world: World) -> tuple[Slide, ...]:
    """Of a world's projector, in its order."""
    light = world.projector
    if isinstance(light, Projector):
        return (SlitLight(light, world.radius_mm, world.translucency),)
    return light.drawn()


def _kinds() -> list[Any]:
    return [SlitLight, *(light.Slide for light in merged("lights").values() if hasattr(light, "Slide"))]


def through(table: Any, part: Any, beam: Any) -> None:
    """Turn what the beam would give each pixel into what comes through the slide. For compiled code only."""
    raise NotImplementedError


@numba.extending.overload(through, jit_options=OPTIONS)
def _through(table, part, beam):  # type: ignore[no-untyped-def]
    """Called by the compiler, with types: `table.instance_class` is the NamedTuple that it will be."""
    kernel = next(slide.kernel for slide in _kinds() if slide.Table is table.instance_class)
    return lambda table, part, beam: kernel(part, beam, table)
