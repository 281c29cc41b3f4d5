"""What lies in the shadow of steps of the wall, and what only seems to be seen there.

The projector's light comes along the pipe at each ring's own angle, so behind a step of height W (the near rim of a
loss, the back of a bump) a length W cot(theta / 2) of wall gets no light (Alzuhiri 2022, Eq. 3.24), least of the widest
ring's. No place there can have been measured. A slit that lies half on the rim and half on the floor looks like one,
though, halfway down.
"""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray

# STEP_MM, LEVEL_OF_STEP, RIM_OF_RADIUS and RIM_PART are guarded by test_shadow.py one way each. FLOOR_OF_RADIUS,
# SIDEWAYS_DEG, SLIT_OF_RADIUS and FLOOR_PART: unguarded; the benchmark topic artefacts counts the false floors left.
STEP_MM = 0.3  # a rise less than this is noise or the pipe's course
LEVEL_OF_STEP = 0.2  # of the step: this near to the rim's or the floor's level is that
RIM_OF_RADIUS = 0.08  # of the radius: wall before a step, that gives its rim's level
FLOOR_OF_RADIUS = 0.12  # .. and behind it, that gives its floor's
SIDEWAYS_DEG = 12.0  # how far round a step is followed from where it is plain
SLIT_OF_RADIUS = 0.05  # of the radius: a slit's width on the wall
RIM_PART = 0.3  # quantile of what is seen there that is the rim's level ..
FLOOR_PART = 0.8  # .. and the floor's: false floors lie between


def between_levels(radius_mm: FloatArray, z_step_mm: float, rise: float) -> BoolArray:
    """(Z, A) bool: cells on neither level of a step so steep that one of its two sides would hide them.

    radius_mm (Z, A), NaN where not seen. rise: tangent of the widest ring's half-angle, the steepest wall that light
    coming along the pipe still reaches.
    """
    rows, columns = radius_mm.shape
    index = np.arange(rows)[:, None]
    seen = np.isfinite(radius_mm)
    before = np.full((rows, columns), -1)
    before[1:] = np.maximum.accumulate(np.where(seen, index, -1), axis=0)[:-1]
    across = radius_mm - np.take_along_axis(radius_mm, before.clip(0), axis=0)
    with np.errstate(invalid="ignore"):
        steep = seen & (before >= 0) & (across > (index - before) * z_step_mm * rise + STEP_MM)
    if not steep.any():
        return np.asarray(steep)
    low, high = np.full(radius_mm.shape, np.nan), np.full(radius_mm.shape, np.nan)  # of the step a cell lies behind
    size = float(np.nanmedian(radius_mm)) / z_step_mm if seen.any() else 0.0
    ahead, behind = max(2, round(RIM_OF_RADIUS * size)), max(3, round(FLOOR_OF_RADIUS * size))
    for i, column in zip(*np.nonzero(steep), strict=True):
        line, last = radius_mm[:, column], before[i, column]
        rim, floor = line[max(last - ahead, 0) : last + 1], line[i : i + behind]
        below, above = np.nanquantile(rim, RIM_PART), np.nanquantile(floor, FLOOR_PART)
        if above - below > STEP_MM:
            reach = int(np.ceil((above - below) / rise / z_step_mm))
            part = slice(max(last - reach, 0), i + reach + 1)
            low[part, column], high[part, column] = below, above
    # Beside such places the same step goes on, though it may be seen in too few cells to look steep.
    near = np.flatnonzero(np.isfinite(low).any(axis=1))
    rows_of, low, high = radius_mm[near], low[near], high[near]
    for _ in range(round(SIDEWAYS_DEG * columns / 360.0)):
        for way in (-1, 1):
            free = np.isnan(low)
            beside = np.roll(low, way, axis=1), np.roll(high, way, axis=1)
            more = free & _between(rows_of, *beside)
            low[more], high[more] = beside[0][more], beside[1][more]
    out = np.zeros(radius_mm.shape, bool)
    out[near] = seen[near] & _between(rows_of, low, high)
    return out


def _between(radius_mm: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    margin = LEVEL_OF_STEP * (high - low)
    with np.errstate(invalid="ignore"):
        return np.asarray((radius_mm > low + margin) & (radius_mm < high - margin))


def shadowed(radius_mm: FloatArray, z_step_mm: float, rise: float) -> BoolArray:
    """(Z, A) bool: cells nobody saw because a step before them keeps the light of every ring, or of most, away.

    rise: tangent of the narrowest ring's half-angle; what it cannot reach others may, but hardly ever do everywhere.
    """
    rows, _ = radius_mm.shape
    index = np.arange(rows)[:, None]
    seen = np.isfinite(radius_mm)
    before = np.maximum.accumulate(np.where(seen, index, -1), axis=0)
    after = np.minimum.accumulate(np.where(seen, index, rows)[::-1], axis=0)[::-1]
    inside = ~seen & (before >= 0) & (after < rows)
    # a slit has a width: the rim's own last part is not seen either
    slack = max(2 * z_step_mm, SLIT_OF_RADIUS * float(np.nanmedian(radius_mm))) if seen.any() else 0.0
    step = np.take_along_axis(radius_mm, after.clip(0, rows - 1), axis=0) - np.take_along_axis(
        radius_mm, before.clip(0), axis=0
    )
    with np.errstate(invalid="ignore"):
        dark = inside & (step > STEP_MM) & ((after - before - 2) * z_step_mm <= step / rise + slack)
    return np.asarray(dark)
