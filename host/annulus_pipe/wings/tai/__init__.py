"""A thermoacoustic measurement from file to file: simulate or acquire a sweep, decode it, make its image.

Ties `measure` (the physics) to the controller, the digitizer and the files. What a person sees of it is `annulus tai`
and `annulus burst`.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from annulus_pipe.hooks import Noun


def app() -> "Mapping[str, Noun]":
    from annulus_pipe.hooks import Noun

    burst = "On/off patterns of the microwave source, and the filters that decode them."
    tai = "Thermoacoustic imaging: simulate or acquire a sweep, decode it, make its image."
    return {
        "burst": Noun(f"{__name__}.burst_commands", burst),
        "tai": Noun(f"{__name__}.commands", tai),
        "twin": Noun(f"{__name__}.rig_commands"),
    }
