"""Butt-fusion joints on a bench: CT volumes, a near-field probe's rasters, light through dogbones, strengths."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from annulus_pipe.hooks import Noun


def app() -> "Mapping[str, Noun]":
    from annulus_pipe.hooks import Noun

    about = "Butt-fusion joints: beads, heat-affected zone and flaws from a CT volume, and what strengths go with."
    return {"joint": Noun(f"{__name__}.dogbone_commands", about)}  # which adds to what `commands` has
