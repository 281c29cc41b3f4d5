"""Butt-fusion joints on a bench: CT volumes, a near-field probe's rasters, light through dogbones, strengths."""

from collections.abc import Mapping
from typing import Any


def app() -> Mapping[str, Any]:
    from annulus_pipe.wings.joints import commands, dogbone_commands  # noqa: F401  which adds to the same noun

    return {"joint": commands.app}
