"""How deep a groove is, all round or across a part of the pipe, from the light that fell wholly on its floor.

A groove is hardly wider than two slits. A slit that lies on both a rim and the floor shows something between them, and
the near rim keeps the light away from a good part of the floor, from most of it that of the narrow rings. The floor is
what slits show whose whole width fits between the near rim's shadow and the far rim; along it, there are enough.
"""

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.points import ROW_MM, SECTORS, WallPoints

# Held together by test_grooves.py and the benchmark topics scenes (s11a-groove) and stereo (stereo-a).
ASIDE_OF_RADIUS = 0.12  # before and behind a groove: sound wall, and a shape that the groove does not drag about
SOUND_OF_DEPTH = 0.25  # of the depth: less is the wall before it
HALF = 0.5  # of the depth: half-way up is the far rim
WHOLE = 0.8  # of half a slit: so far inside its middle lies, when hardly any of it falls on a rim
WITHIN = 0.8  # of a groove's arc: nearer its ends slits are half on them
SEEN_ALONG = 0.25  # part of the sectors in which the floor must be seen
TURNS = 2  # a deeper groove has a longer shadow: once more with the depth found


def groove_floor(
    wall: Wall, points: WallPoints, z_range_mm: tuple[float, float], clock_deg: float, arc_deg: float, depth_mm: float
) -> tuple[float, float] | None:
    """Depth of a groove and its k = 2, mm; None where too little of its floor was seen.

    z_range_mm, clock_deg, arc_deg : where it is, the clock angle of its middle; all round from 360 on. depth_mm : how
    deep it seems.
    """
    aside = ASIDE_OF_RADIUS * wall.mean_radius_mm
    first, last = z_range_mm[0] - aside, z_range_mm[1] + aside
    points = points.between(first, last)
    near = np.abs((points.clock_deg - clock_deg + 180.0) % 360.0 - 180.0) <= WITHIN * arc_deg / 2
    if arc_deg >= 360.0:
        near[:] = True
    if not near.any():
        return None
    z, sector, ratio, slit, stated = (
        field[near] for field in (points.z_mm, points.sector, points.shadow_ratio, points.slit_mm, points.stated_mm)
    )
    along = (z - first) / (last - first)
    deep = -((1 - along) * points.over(wall, first)[near] + along * points.over(wall, last)[near])
    row = np.floor((z - first) / ROW_MM).astype(np.intp)
    rows = np.array([np.median(deep[row == k]) if (row == k).any() else np.nan for k in range(int(row.max()) + 1)])
    needed = SEEN_ALONG * SECTORS * min(WITHIN * arc_deg, 360.0) / 360.0
    found = None
    for _ in range(TURNS):
        rims = _rims(rows, depth_mm)
        if rims is None:
            return found
        rim, end = first + rims[0] * ROW_MM, first + rims[1] * ROW_MM
        whole = np.minimum(z - rim - depth_mm * ratio, end - z) >= WHOLE * slit
        whole &= np.isfinite(stated) & (stated > 0)
        if not whole.any() or len(np.unique(sector[whole])) < needed:
            return found
        order = np.argsort(deep[whole])
        sums = np.cumsum(1.0 / stated[whole][order])
        depth_mm = float(deep[whole][order][np.searchsorted(sums, 0.5 * sums[-1])])
        scatter = SIGMA_OF_MAD * float(np.median(np.abs(deep[whole] - depth_mm)))
        noise = float(np.median(wall.noise_mm)), float(np.median(stated[whole])), scatter
        found = depth_mm, 2.0 * float(np.linalg.norm(noise))
    return found


def _rims(rows: FloatArray, depth: float) -> tuple[float, float] | None:
    """Rows at which the wall before a groove ends, and at which its far rim stands half-way up; None where it has no
    such."""
    away = np.flatnonzero(rows > SOUND_OF_DEPTH * depth)
    if not len(away):
        return None
    bottom = int(away[0] + np.nanargmax(rows[away[0] : away[-1] + 1]))
    up = np.flatnonzero(rows[bottom:] < HALF * depth)
    if not len(up):
        return None
    k = bottom + int(up[0])
    above = rows[k - 1]
    part = (above - HALF * depth) / (above - rows[k]) if np.isfinite(above) else 0.5
    return float(away[0]), k - 0.5 + float(part)
