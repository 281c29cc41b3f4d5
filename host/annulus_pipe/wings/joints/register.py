"""A near-field probe's raster laid on what `annulus joint image` left of a joint, and written beside it."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.raster import Raster, Surface, at_joint, place
from annulus_pipe.wings.joints.pictures import write_scan
from annulus_pipe.wings.joints.raster_file import read_joint, read_raster
from annulus_pipe.wings.joints.strength_file import read_features


class Registered(NamedTuple):
    """angles, places, channels : of the raster. figures : of `microwave` in features.json, the curves left out."""

    angles: int
    places: int
    channels: list[str]
    figures: dict[str, Any]
    files: list[Path]


def register(folder: Path, raster: Path) -> Registered:
    """`microwave` in features.json, scan.npz and scan.png. AnnulusError naming the file that does not fit."""
    joint, maps = read_joint(folder)
    phi, curves = read_features(folder / "features.json", ["zj", "W"])
    if len(phi) != len(maps["phi_deg"]) or not np.isfinite(curves["zj"]).all():
        raise AnnulusError(f"{folder / 'features.json'}: phi_deg or zj, expected as in maps.npz")
    angle, z, channels = read_raster(raster)
    surface = Surface(
        maps["z_mm"],
        maps["bead_out_mm"],
        maps["density"],
        float(np.mean(maps["outer_mm"] - maps["bead_out_mm"])),
        float(np.mean(curves["zj"])),
    )
    try:
        placed = place(Raster(np.radians(angle), z, np.stack(list(channels.values()))), surface)
    except AnnulusError as error:
        raise AnnulusError(f"{raster}: {error}") from None
    figures = {"raster": str(raster), **placed.figures(list(channels))}
    laid = placed.maps(list(channels))
    microwave = figures
    if placed.accepted and placed.sense:
        at = {name: at_joint(one, maps["z_mm"], curves["zj"]) for name, one in laid.items()}
        microwave = {**figures, "phi_deg": phi, **at}
    drawn = {"phi_deg": phi, "zj": curves["zj"], "W": curves["W"]}
    files = write_scan(folder, joint, microwave, drawn, maps, laid)
    return Registered(len(angle), len(z), list(channels), figures, files)
