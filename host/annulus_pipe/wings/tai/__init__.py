"""A thermoacoustic measurement from file to file: simulate or acquire a sweep, decode it, make its image.

Ties `measure` (the physics) to the controller, the digitizer and the files. What a person sees of it is `annulus tai`
and `annulus burst`.
"""

from collections.abc import Mapping
from typing import Any


def app() -> Mapping[str, Any]:
    from annulus_pipe.wings.tai import burst_commands, commands, rig_commands

    return {"burst": burst_commands.app, "tai": commands.app, "twin": rig_commands.app}
