"""Pipes and the sensor heads inside them, as plain data and a seed: what the twin draws and what a score calls true.

A new kind of fault in a wall goes into `features`, a new head or pipe is a function that returns a `World`, in a file
of its own, with a line in WORLDS if it shall have a name on the command line. A wing brings its
own (`worlds` of hooks.py).
"""

from collections.abc import Callable, Mapping

from annulus_pipe.hooks import merged
from annulus_pipe.twin.worlds.features import WorldFeature, clock_text
from annulus_pipe.twin.worlds.fittings import FITTINGS
from annulus_pipe.twin.worlds.mirror import mirror_world
from annulus_pipe.twin.worlds.paint import ORANGE, WHITE, YELLOW
from annulus_pipe.twin.worlds.pipes import CONTAMINATED, clean_world, demo_world, fisheye_camera, painted, translucent
from annulus_pipe.twin.worlds.sensor_head import CameraOptics
from annulus_pipe.twin.worlds.stereo import stereo_world
from annulus_pipe.twin.worlds.world import World

__all__ = [
    "CONTAMINATED",
    "ORANGE",
    "WHITE",
    "WORLDS",
    "YELLOW",
    "CameraOptics",
    "World",
    "WorldFeature",
    "clean_world",
    "clock_text",
    "demo_world",
    "every_world",
    "fisheye_camera",
    "mirror_world",
    "painted",
    "stereo_world",
    "translucent",
]

WORLDS: Mapping[str, Callable[[int], World]] = {
    "demo": demo_world,
    "clean": clean_world,
    "mirror-2inch": lambda seed: mirror_world(seed, 25.4),
    "mirror-3inch": mirror_world,
    "mirror-4inch": lambda seed: mirror_world(seed, 50.8),
    "stereo": stereo_world,
    **FITTINGS,
    "stereo-3inch": lambda seed: stereo_world(seed, 38.1),
}


def every_world() -> Mapping[str, Callable[[int], World]]:
    """By the names of the command line, the wings' too."""
    return {**WORLDS, **merged("worlds")}
