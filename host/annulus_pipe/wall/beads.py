"""A bead of butt fusion: how high it stands and how wide it is, from its front and from where it lets light by again.

A slit is as wide on the wall as half a bead. On a crest only its lower part is lit, so that crests read low. Behind a
bead, slits that its shadow cuts in half seem to stand high, where nothing stands: what was seen there says only that
light did not get by. The far flank is never seen. But the ring whose middle just passes the last crest lands on
the wall behind, each ring farther off the narrower it is, and that place is well seen. A bead is two rolls alike, a
quarter of its width from flank to crest each: with the near flank and the height known, the width is what puts the
light's return where it is.

A wall that swells stands inwards all round as a bead does, but not as steeply: molten plastic rolls over, so a bead's
flank climbs within its own height. What climbs over a longer way is no bead.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.points import ROW_MM, SECTORS, WallPoints

# All held together by test_beads.py and the benchmark topic scenes (s01a-butt); POINTS not tried.
POINTS = 6  # of a sector, that give it a height
SECTORS_MIN = 9  # whose front was seen, for a height from the front alone
CREST = 97.0  # percentile of a sector's heights: noise is small against beads
FRONT_OF_RADIUS = 0.05  # from the near flank on: the first crest, and nothing of a second one
BEHIND_OF_RADIUS = 0.6  # of the radius, from the near flank on: by then light has come down again
READS_LOW = 0.4  # of how far half a slit reaches up a flank: so much lower is the middle of what of it lights a crest
LOW = 0.3  # of a bead's height: what is lower is wall
BESIDE = 0.5  # of half a slit: so far past the shadow's edge its middle is, when the wall has the brighter part of it
BESIDE_SIGMA = 0.25  # of half a slit, how well that is known
FORM_SIGMA = 0.25  # of a width: how far a bead is from two rolls alike; caps and wide ones are (blind, even seeds)
# Parts of what stands highest: a bead's flank climbs CLIMBS of it, and to SHOULDER at least, within as far along the
# pipe as it is high, and what a slit and a row smear. Beads of the blind even seeds climb 0.55 at least there, walls
# that undulate 0.4 at most. Guarded both ways by tests/regression/wall_that_undulates_called_butt_fusion.
CLIMBS, SHOULDER = 0.5, 0.6
QUARTERS = 0.006 * np.arange(1.0, 17.0, 0.1)  # of the radius: a quarter of the width of any bead, from least to most
LOOKS = 1.0  # so many more looks in the wrong place: a width as good as the best, for a look's points err together
LOOK_POINTS = 36  # a look of fewer counts for less than one


@dataclass(frozen=True, slots=True)
class WallBead:
    """mm along the pipe, and how far it stands into it; k2 of height and width, NaN where the width is no bead's.
    climbs : part of its height that its flank was seen to climb within its own height; may_climb : the same if it did
    so where nobody saw."""

    start_mm: float
    width_mm: float
    width_k2_mm: float
    height_mm: float
    height_k2_mm: float
    climbs: float
    may_climb: float

    @property
    def is_sure(self) -> bool:
        """Whether it stands out by more than its k = 2 (if anybody says so much), with a flank that was seen."""
        return self.climbs >= CLIMBS and not self.height_mm <= self.height_k2_mm

    @property
    def is_none(self) -> bool:
        """Whether what stands there surely has no bead's flank."""
        return self.may_climb < CLIMBS


def measure_bead(wall: Wall, points: WallPoints, zone: tuple[float, float]) -> WallBead:
    """The bead that stands between two stations; the wall before and behind them is sound.

    Notes
    -----
    Height: the median over 36 sectors of each one's 97th percentile over the front, and what a crest
    reads low. Width: with a the quarter of it, s the near flank at half height, h the height and q a
    ring's shadow ratio, light comes down again at s + 3a + sqrt((h q)^2 + a^2), the tangent to a second roll that is
    half an ellipse; a is that for which the fewest points are low before, or stand high after, where the light that
    made them would have come down. Frames and rings are few about a bead, and the points of a ring in one frame err
    together: any width is as good for which no more than a whole look more is wrong.
    """
    radius = wall.mean_radius_mm
    inside = (points.z_mm >= zone[0]) & (points.z_mm <= zone[1])
    rough, _ = _crest(points.height_mm[inside], points.sector[inside])
    start = _near_flank(points.z_mm[inside], points.height_mm[inside], rough)
    front = inside & (points.z_mm >= start - ROW_MM / 2) & (points.z_mm <= start + FRONT_OF_RADIUS * radius)
    crest, sectors = _crest(points.height_mm[front], points.sector[front])
    if len(sectors) < SECTORS_MIN:
        crest, sectors = _crest(points.height_mm[inside], points.sector[inside])
    rise = float(np.median(points.slit_mm[inside] / points.shadow_ratio[inside]))
    height = crest + READS_LOW * rise
    start = _near_flank(points.z_mm[inside], points.height_mm[inside], height)

    behind = (points.z_mm > start + ROW_MM / 2) & (points.z_mm < start + BEHIND_OF_RADIUS * radius)
    stands, ratio, slit = points.height_mm[behind], points.shadow_ratio[behind], points.slit_mm[behind]
    lands, low = points.z_mm[behind] + stands * ratio, stands < LOW * height
    quarters = QUARTERS * radius
    lit = start + BESIDE * slit - lands
    _, look, count = np.unique(points.look[behind], return_inverse=True, return_counts=True)
    part = (1.0 / np.maximum(count, LOOK_POINTS))[look]
    misplaced = (low == (lit + 3 * a + np.sqrt((height * ratio) ** 2 + a * a) > 0) for a in quarters)
    wrong, looks = np.array([(np.count_nonzero(one), part[one].sum()) for one in misplaced]).T
    width = 4.0 * float(quarters[wrong == wrong.min()].mean())
    alike = float(np.abs(4.0 * quarters[looks <= looks.min() + LOOKS] - width).max())
    slit_sigma = BESIDE_SIGMA * float(np.median(slit)) * 4.0 / 3.0
    width_k2 = float(np.linalg.norm([alike, 2.0 * slit_sigma, 2.0 * FORM_SIGMA * width]))
    if width < height:  # no bead is narrower than it is high: light came back sooner than rolls let it
        width_k2 = math.nan
    # a bead uneven all round is seen as unevenly
    spread = np.hypot(float(np.std(sectors)) / 2 if len(sectors) else np.nan, READS_LOW / 2 * rise)
    stated = points.stated_mm[inside]
    sigma = float(np.median(stated[np.isfinite(stated)])) if np.isfinite(stated).any() else np.nan
    noise = np.hypot(float(np.median(wall.noise_mm)), sigma)
    before = (points.z_mm > start - BEHIND_OF_RADIUS * radius) & (points.z_mm <= start + FRONT_OF_RADIUS * radius)
    smeared = float(np.median(points.slit_mm[inside])) + ROW_MM
    climbs = _climbs(points.z_mm[before], points.height_mm[before], smeared)
    return WallBead(start, width, width_k2, height, 2.0 * float(np.hypot(noise, spread)), *climbs)


def _crest(height: FloatArray, sector: NDArray[np.intp]) -> tuple[float, FloatArray]:
    """mm: the crest, and each sector's of those with points enough."""
    each = [np.percentile(height[sector == k], CREST) for k in range(SECTORS) if (sector == k).sum() >= POINTS]
    return (float(np.median(each)) if each else float(np.percentile(height, CREST))), np.array(each)


def _climbs(z: FloatArray, height: FloatArray, smeared_mm: float) -> tuple[float, float]:
    """Part of what stands highest that rows climb at most within as far as it is high and `smeared_mm`; and the same if
    the longest stretch between two of them that nobody saw counts for nothing."""
    rows, middle = _row_middles(z, height)
    top = float(middle.max(initial=0.0))
    if top <= 0.0:
        return 0.0, 0.0
    seen = may = 0.0
    for shoulder in np.flatnonzero(middle >= SHOULDER * top):
        before = slice(0, int(shoulder) + 1)
        climbed = (middle[shoulder] - middle[before]) / top
        away = (rows[shoulder] - rows[before]) * ROW_MM
        unseen = np.maximum.accumulate(np.diff(rows[before], append=rows[shoulder])[::-1])[::-1] - 1
        seen = max(seen, float(climbed[away <= top + smeared_mm].max()))
        may = max(may, float(climbed[away - unseen.clip(0) * ROW_MM <= top + smeared_mm].max()))
    return seen, may


def _row_middles(z: FloatArray, height: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
    """(R,) rows that have points enough, counted from the first point, and the middle height of each."""
    if not len(z):
        return np.zeros(0, np.intp), np.zeros(0)
    row = np.floor((z - z.min()) / ROW_MM).astype(np.intp)
    rows = np.flatnonzero(np.bincount(row) >= POINTS)
    return rows, np.array([np.median(height[row == k]) for k in rows])


def _near_flank(z: FloatArray, height: FloatArray, crest: float) -> float:
    """Chainage at which rows come to half a crest's height."""
    rows, middle = _row_middles(z, height)
    if not len(rows):
        return float(z.min())
    at = z.min() + (rows + 0.5) * ROW_MM
    half = int(np.argmax(middle >= 0.5 * crest))
    start = float(at[half])
    if half > 0 and middle[half] > middle[half - 1]:
        start -= float((at[half] - at[half - 1]) * (middle[half] - 0.5 * crest) / (middle[half] - middle[half - 1]))
    return start
