"""What of a window's survey is the window's own: what lies between its cuts."""

from dataclasses import fields, replace

import numpy as np

from annulus_pipe.wall.grid import Wall, WallObservations
from annulus_pipe.wall.lost import lost_rings
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, stations_of
from annulus_pipe.wall.windows import Window


def between(survey: Survey, window: Window) -> Survey:
    """What of a window's survey lies between its cuts. What reaches over a cut is kept whole; a frame's account (what
    was rejected, where the camera was) is of the window that the head was in."""
    first, last = window.first_mm, window.last_mm
    wall, (a, b) = survey.wall, _rows(survey.wall, first, last)
    part = _part(wall, a, b)
    kept = [i for i, one in enumerate(survey.defects) if _touches(one.z_range_mm, first, last)]
    number = np.zeros(len(survey.defects) + 1, np.int32)
    number[[i + 1 for i in kept]] = np.arange(1, len(kept) + 1)
    found = survey.detection
    detection = replace(
        found,
        defects=tuple(survey.defects[i] for i in kept),
        label=number[found.label[a:b]],
        undecided=tuple(one for one in found.undecided if first <= one.z_mm < last),
    )
    no_wall = None if survey.no_wall is None else survey.no_wall[a:b]
    return replace(
        survey,
        profiles=tuple(one for one in (_of(profile, first, last) for profile in survey.profiles) if one is not None),
        wall=part,
        shadowed=survey.shadowed[a:b],
        detection=detection,
        stations=stations_of(part, no_wall),
        texture=None if survey.texture is None else survey.texture[a:b],
        no_wall=no_wall,
        features=tuple(one for one in survey.features if _touches(one.z_range_mm, first, last)),
        unjudged=tuple(
            replace(one, z_from_mm=max(one.z_from_mm, first), z_to_mm=min(one.z_to_mm, last))
            for one in survey.unjudged
            if one.z_to_mm > first and one.z_from_mm < last
        ),
        # reported once, by the window that it begins in
        disbelieved=(*survey.disbelieved, *(one.finding for one in survey.standing if first <= one.z_from_mm < last)),
        standing=(),
        rings_lost=lost_rings(survey.profiles),  # of whole frames: at a cut only some of their rings are kept
    )


def _rows(wall: Wall, first_mm: float, last_mm: float) -> tuple[int, int]:
    a, b = np.searchsorted(wall.z_mm, [first_mm, last_mm])
    return int(a), int(b)


def _part(wall: Wall, a: int, b: int) -> Wall:
    seen, columns = wall.observations, len(wall.clock_deg)
    inside = (seen.cell >= a * columns) & (seen.cell < b * columns)
    observations = WallObservations(**{one.name: getattr(seen, one.name)[inside] for one in fields(seen)})
    whole = ("clock_deg", "observations", "scale_part", "oval_part")
    along = {one.name: getattr(wall, one.name)[a:b] for one in fields(wall) if one.name not in whole}
    return replace(wall, **along, observations=replace(observations, cell=observations.cell - a * columns))


def _touches(z_range_mm: tuple[float, float], first_mm: float, last_mm: float) -> bool:
    return z_range_mm[1] >= first_mm and z_range_mm[0] < last_mm


def _of(profile: Profile, first_mm: float, last_mm: float) -> Profile | None:
    """What of a frame is a window's; None where nothing is."""
    inside = (profile.points_mm[:, 2] >= first_mm) & (profile.points_mm[:, 2] < last_mm)
    own = first_mm <= profile.z_mm < last_mm
    if not own and not inside.any():
        return None
    return replace(
        profile,
        points_mm=profile.points_mm[inside],
        colour=profile.colour[inside],
        ring=profile.ring[inside],
        direction=profile.direction[inside],
        sigma_mm=profile.sigma_mm[inside],
        seen_by=profile.seen_by[inside],
        rejected=profile.rejected if own else {},
    )
