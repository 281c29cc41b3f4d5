"""Scans under a slide of fringes: the heights of a plate, the wall of a pipe, by motion phase shifting."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.hooks import Noun, WingResults
    from annulus_pipe.storage.place import Where
    from annulus_pipe.twin.worlds import World
    from annulus_pipe.wings.fringe.job import FringeJob
    from annulus_pipe.wings.fringe.pipe import FringePipeJob


def opens(scan: "Where", calibration: "Where | None", by: str) -> "FringeJob | FringePipeJob | None":
    """by : "cameras" for a plate whose heights two cameras say without the slide's own calibration."""
    from annulus_pipe.wings.fringe.recognise import fringes_on

    wall = fringes_on(scan, calibration)
    if wall is None:
        return None
    if wall == "pipe" and by == "cameras":
        raise AnnulusError(
            f"by cameras does not go with {calibration or scan}: its head lights a pipe, expected a head that projects "
            "fringes on a plate"
        )
    if wall == "pipe" or calibration is None:
        from annulus_pipe.wings.fringe.pipe import open_fringe_pipe

        return open_fringe_pipe(scan, calibration)
    from annulus_pipe.wings.fringe.job import open_fringe

    return open_fringe(scan, calibration, "cameras" if by == "cameras" else "slide")


def measured(job: "FringeJob | FringePipeJob", *place: Any, **how: Any) -> "WingResults":
    from annulus_pipe.wings.fringe.results import measured as of

    return of(job, *place, **how)


def worlds() -> "Mapping[str, Callable[[int], World]]":
    from annulus_pipe.wings.fringe.heads import ball_fringe_world, mirror_fringe_world, modules_world, series_world

    return {
        "fringe": series_world,
        "fringe-modules": modules_world,
        "fringe-mirror": mirror_fringe_world,
        "fringe-ball": ball_fringe_world,
    }


def lights() -> Mapping[str, type]:
    from annulus_pipe.wings.fringe.light import Fringes

    return {"slides": Fringes}


def app() -> "Mapping[str, Noun]":
    from annulus_pipe.hooks import Noun

    return {"calibrate": Noun(f"{__name__}.commands")}
