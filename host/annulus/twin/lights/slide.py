"""Which slide the projector holds: for a world by what it says, in a frame's kernel by the type of its table."""

from collections.abc import Mapping
from typing import Any

import numba.extending

from annulus.twin.lights.slits import Slits
from annulus.twin.stretch import OPTIONS
from annulus.twin.worlds.sensor_head import Projector

# What a world's projector is -> the light it makes. A slide has `axis` and `rims` (see SlideProjector), a method
# `table(pose, z_mm)` that gives its numbers for one frame as a `Table`, and the kernel that reads them.
SLIDES: Mapping[type, type[Slits]] = {Projector: Slits}


def through(table: Any, part: Any, beam: Any) -> None:
    """Turn what the beam would give each pixel into what comes through the slide. For compiled code only."""
    raise NotImplementedError


@numba.extending.overload(through, jit_options=OPTIONS)
def _through(table, part, beam):  # type: ignore[no-untyped-def]
    """Called by the compiler, with types: `table.instance_class` is the NamedTuple that it will be."""
    kernel = next(slide.kernel for slide in SLIDES.values() if slide.Table is table.instance_class)
    return lambda table, part, beam: kernel(part, beam, table)
