"""A head that looks the other way through the pipe of another: behind it on one carrier, or pulled in from the far end.

Half a turn round the vertical changes no length, and the pipe is again one that is looked along: what lay at z, clock c
lies at length - z, -c. So the backward head is a world of its own, with its own calibration and its
own wobble; its paint is drawn anew.
"""

import math
from collections.abc import Callable
from dataclasses import replace

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.twin.worlds.sensor_head import Projector
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.vocabulary import AnnulusError

OTHER_LENS = 1.012  # focal length of the backward head over the forward one's: its calibration is its own
OTHER_MIDDLE_PX = 3.0  # .. and how far aside its lens's axis meets the sensor
OTHER_SEED = 1000  # .. of its wobble


def looking_back(world: World, apart_mm: float | None = None) -> tuple[World, Callable[[float], float]]:
    """The pipe as the backward head has it, over the same stretch of wall, and what is counted with that head at each
    of its stations: the place of the forward head, `apart_mm` before it on its carrier; without that its own.

    Raises AnnulusError for a head that projects no rings, or a pipe of several pieces.
    """
    light = world.projector
    if not isinstance(light, Projector) or world.course is not None or world.ground is not None or world.others:
        raise AnnulusError(
            "world: a backward head is drawn for one camera that projects rings, in a straight pipe of one piece"
        )
    ahead = [_ahead_mm(cone, world.radius_mm) for cone in light.cones]
    length = world.travel_mm + min(ahead) + max(ahead)
    camera = world.camera
    camera = replace(camera, fx=OTHER_LENS * camera.fx, fy=OTHER_LENS * camera.fy, cx=camera.cx + OTHER_MIDDLE_PX)
    features = tuple(replace(one, z_mm=length - one.z_mm, clock_deg=-one.clock_deg % 360.0) for one in world.features)
    turned = replace(world, camera=camera, features=features, seed=world.seed + OTHER_SEED)
    if apart_mm is None:
        return turned, lambda z_mm: z_mm
    return turned, lambda z_mm: length + apart_mm - z_mm


def _ahead_mm(cone: Cone, radius_mm: float) -> float:
    """Where a ring meets the wall before a head on the axis."""
    return cone.vertex_mm[2] + radius_mm / math.tan(cone.half_angle)
