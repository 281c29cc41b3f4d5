"""A folder of results as the pull that known defects and digs are held against."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from annulus_pipe.archive.wall_map import WallMap
    from annulus_pipe.qualification.trials import Pull, SeenWall
    from annulus_pipe.storage.results_folder import ListedPlace


def read_pull(folder: Path) -> "tuple[Pull, tuple[ListedPlace, ...], tuple[ListedPlace, ...], Mapping[str, Any]]":
    """What was scanned and what of it was not seen; the defects, the undecided places; the summary that says all this.

    What was not seen is the map's word where the folder has one: summary.json names small holes together, by the
    stretch in which they lie.
    Raises AnnulusError, one line, for a folder that is none of a pipe.
    """
    from annulus_pipe.archive.wall_map import read_map
    from annulus_pipe.qualification.trials import Pull, UnseenPlace
    from annulus_pipe.storage.results_folder import SUMMARY, places, read_summary, scanned, unreadable, unseen
    from annulus_pipe.untrusted import number, text

    try:
        summary = read_summary(folder)
        first, last = scanned(summary)
        job, diameter, limits = (_section(summary, name) for name in ("job", "diameter_mm", "limits"))
        depth = limits.get("depth_mm")
        wall = read_map(folder) if (folder / "wall.npz").exists() else None
        holes = () if wall else unseen(summary)
        pull = Pull(
            folder.resolve().name,
            text(job.get("pipe") or "", "job.pipe", 300),
            first,
            last,
            number(diameter.get("mean"), "diameter_mm.mean", 1e5) / 2,
            math.nan if depth is None else number(depth, "limits.depth_mm", 1e5),
            text(job.get("head") or "", "job.head", 300),
            text(_section(summary, "versions").get("annulus") or "", "versions.annulus", 300),
            text(str(summary.get("created") or ""), "created", 300)[:10],
            tuple(UnseenPlace(one.z_from_mm, one.z_to_mm, one.clock_deg, one.arc_deg) for one in holes),
            None if wall is None else _seen(wall),
        )
        return pull, places(summary, "defects"), places(summary, "undecided"), summary
    except (OSError, ValueError) as error:
        raise unreadable(folder / SUMMARY, error) from None


def _seen(wall: "WallMap") -> "SeenWall":
    import numpy as np

    from annulus_pipe.qualification.trials import SeenWall

    return SeenWall(np.isfinite(wall.deviation_mm), wall.first_mm, wall.step_mm, wall.first_deg)


def _section(summary: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    from annulus_pipe.untrusted import mapping

    return mapping(summary.get(name) or {}, name)
