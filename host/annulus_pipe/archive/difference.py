"""The second map laid on the first's grid, and what differs, with the sigma of every cell.

Rows are taken between two of the second's that no slip parts, so that nothing is made up where the cable ran ahead.
Taken out of every row is what is the head's or the whole pipe's: orders 0 to 2. A cell's sigma holds both scans' noise,
what place and roll may be off where the wall is steep, and what lies between rows where it is bent: beads and edges.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annulus_pipe.archive.alignment import BARE, Alignment
from annulus_pipe.archive.detail import WAVES_MM, calmed, drawn, on_columns, smoothed, waves_of
from annulus_pipe.archive.floors import Floor
from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.numeric.arrays import BoolArray, ComplexArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import SIGMA_OF_MAD

BLOCK_MM = 160.0  # over which noise is one, along and round
BEND = 0.2  # of the second difference along: what a straight line between rows misses at most is an eighth, or a bead's
SIGMA_LEAST_MM = 1e-3
LOST_MM = 12.0  # sigma of a row's place, from which on it is not compared
OF_FLOOR = 0.02  # of its depth: where less is left a floor does not reach


@dataclass(frozen=True, slots=True)
class Difference:
    """On the first's grid, column 0 at clock 0: all (Z, A) mm, NaN where one of the two did not see.

    grown: second less first, outwards positive, less orders 0 to 2 of each row. sigma: its, k = 1. first, second: the
    two walls, each less its own orders 0 to 2. oval (2, Z): the ovality of both, c of Re(c exp(2i clock)), mm.
    """

    grown: Float32Array
    sigma: Float32Array
    first: Float32Array
    second: Float32Array
    oval: ComplexArray
    z_mm: FloatArray
    step_mm: float
    radius_mm: float

    @property
    def column_deg(self) -> float:
        return 360.0 / int(self.grown.shape[1])

    @property
    def column_mm(self) -> float:
        return float(np.radians(self.column_deg)) * self.radius_mm

    def sigma_of(self, year: int) -> Float32Array:
        """Of the cells of the second (0) or the first (1), where it saw: what both differ by, halved."""
        field = self.second if year == 0 else self.first
        known = self.sigma[np.isfinite(self.sigma)]
        usual = float(np.median(known)) if known.size else 1.0
        return np.where(np.isfinite(field), np.float32(usual / np.sqrt(2)), np.float32(np.nan))


@dataclass(frozen=True, slots=True)
class Laid:
    """Both walls on the first's grid, (Z, A) mm as their heads saw them; share of a cell's variance that interpolation
    keeps in the second; (Z,) sigma of place, mm, and roll, degrees. torn_mm: places of slips on a bare wall, which may
    as well lie a little before or after."""

    first: Float32Array
    second: Float32Array
    share: Float32Array
    sigma_z: FloatArray
    sigma_roll: FloatArray
    z_mm: FloatArray
    step_mm: float
    radius_mm: float
    torn_mm: tuple[float, ...] = ()

    @property
    def lost(self) -> BoolArray:
        """(Z,) rows where the two scans could not be laid together."""
        return np.asarray(self.sigma_z > LOST_MM)

    def difference(self, floors: Sequence[Floor] = ()) -> Difference:
        """What differs. floors: places known to stand out, which have no say in what is the whole row's."""
        columns = self.first.shape[1]
        away = self.second - self.first
        away[self.lost] = np.nan
        free = np.ones(self.first.shape, np.float32)
        clock = 360.0 / columns * np.arange(columns)
        for one in floors:
            rows = np.flatnonzero(np.abs(self.z_mm - one.z_mm) < one.length_mm)
            free[rows] *= one.shape(self.z_mm[rows], clock) < OF_FLOOR
        weight = free / (1.0 + self.share)
        waves = self._waves(away, weight)
        grown = away - drawn(waves, columns)
        noise = self._noise(grown / np.sqrt(1.0 + self.share))
        steep, aside, bent = (
            np.fmax(one, two) for one, two in zip(self._slopes(self.first), self._slopes(self.second), strict=True)
        )
        sigma = np.sqrt(
            2.0 * noise**2  # neighbours that were taken from the same two rows are alike: their mean is no surer
            + (steep * self.sigma_z[:, None].astype(np.float32)) ** 2
            + (aside * self.sigma_roll[:, None].astype(np.float32) * np.float32(columns / 360.0)) ** 2
            + (BEND * bent) ** 2
        )
        own = [self._waves(wall, free) for wall in (self.first, self.second)]
        walls = [wall - drawn(one, columns) for wall, one in zip((self.first, self.second), own, strict=True)]
        return Difference(
            grown,
            np.where(np.isfinite(grown), np.maximum(sigma, SIGMA_LEAST_MM), np.nan).astype(np.float32),
            walls[0],
            walls[1],
            np.stack([one[:, 2] for one in own]),
            self.z_mm,
            self.step_mm,
            self.radius_mm,
        )

    def _waves(self, field: Float32Array, weight: Float32Array) -> ComplexArray:
        """Of each row, begun from what the rows around say."""
        waves = waves_of(field, weight)
        return waves_of(field, weight, np.stack([calmed(waves[:, k], WAVES_MM, self.step_mm) for k in (1, 2)], axis=1))

    def _noise(self, scaled: Float32Array) -> Float32Array:
        """(Z, A) mm sigma of one scan's cell, by blocks; never less than half the whole map's."""
        size = np.abs(scaled)
        seen = np.isfinite(size)
        if not seen.any():
            return np.ones_like(scaled)
        whole = SIGMA_OF_MAD * float(np.median(size[seen]))
        rows = max(round(BLOCK_MM / self.step_mm), 4)
        cells = max(round(BLOCK_MM / (np.radians(360.0 / scaled.shape[1]) * self.radius_mm)), 4)
        blocks = np.full([-(-n // k) for n, k in zip(scaled.shape, (rows, cells), strict=True)], whole)
        for i, j in np.ndindex(*blocks.shape):
            part = size[i * rows : (i + 1) * rows, j * cells : (j + 1) * cells]
            part = part[np.isfinite(part)]
            if part.size > rows * cells / 4:
                blocks[i, j] = SIGMA_OF_MAD * float(np.median(part))
        blocks = ndimage.median_filter(np.pad(blocks, ((1, 1), (0, 0)), "edge"), (3, 3), mode="wrap")[1:-1]
        blocks = np.maximum(blocks, whole / 2)
        spread = np.repeat(np.repeat(blocks, rows, axis=0), cells, axis=1)[: scaled.shape[0], : scaled.shape[1]]
        return np.asarray(
            ndimage.gaussian_filter(spread, (rows / 4, cells / 4), mode=("nearest", "wrap")).astype(np.float32)
        )

    def _slopes(self, field: Float32Array) -> tuple[Float32Array, Float32Array, Float32Array]:
        """(Z, A) how steep along, mm a mm; round, mm a column; and the second difference along, mm. 0 unseen."""
        calm = smoothed(field, (1.0, 2.0))
        steep = np.abs(np.gradient(calm, axis=0)) / np.float32(self.step_mm)
        aside = np.abs(np.roll(calm, -1, axis=1) - np.roll(calm, 1, axis=1)) / 2
        fine = smoothed(field, (0.0, 3.0))
        bent = np.zeros_like(fine)
        bent[1:-1] = np.abs(fine[2:] - 2 * fine[1:-1] + fine[:-2])
        known = bent[np.isfinite(bent)]
        bent = np.maximum(bent - (3 * np.median(known) if known.size else 0), 0)
        return np.nan_to_num(steep), np.nan_to_num(aside), np.nan_to_num(bent)


def lay(first: WallMap, second: WallMap, alignment: Alignment) -> Laid:
    columns = first.deviation_mm.shape[1]
    mine = on_columns(first.deviation_mm, first.first_deg, columns)
    theirs, share, sigma_z, sigma_roll = _taken(first, second, alignment, columns)
    share = np.maximum(share, np.float32(0.25))
    torn = alignment.slips if alignment.found < BARE else ()
    return Laid(
        mine,
        theirs,
        share,
        sigma_z,
        sigma_roll,
        first.z_mm,
        first.step_mm,
        first.radius_mm,
        tuple(float(alignment.z_mm[row]) for row in torn),
    )


def _taken(
    first: WallMap, second: WallMap, alignment: Alignment, columns: int
) -> tuple[Float32Array, Float32Array, FloatArray, FloatArray]:
    """The second (Z, columns) mm on the first's rows and clock; the share of a cell's variance that it keeps; and (Z,)
    sigma of place and roll."""
    wall = second.turned_about() if alignment.reversed else second
    order = slice(None, None, -1) if alignment.reversed else slice(None)
    place, roll = alignment.z_mm[order], alignment.roll_deg[order]
    sigmas = alignment.sigma_z_mm[order], alignment.sigma_roll_deg[order]
    rows = len(place)
    slips = [rows - row for row in reversed(alignment.slips)] if alignment.reversed else list(alignment.slips)
    z = first.z_mm
    at, unsure = np.full(len(z), np.nan), np.full(len(z), np.inf)
    for begin, end in zip([0, *slips], [*slips, rows], strict=True):
        known = begin + np.flatnonzero(np.isfinite(place[begin:end]))
        if len(known) < 2:
            continue
        rising = np.maximum.accumulate(place[known])
        sigma = np.interp(z, rising, sigmas[0][known])
        surer = (z >= rising[0]) & (z <= rising[-1]) & (sigma < unsure)  # where a cable slipped back rows lie twice
        at[surer], unsure[surer] = np.interp(z[surer], rising, known), sigma[surer]
    seen = np.isfinite(at)
    low = np.minimum(np.where(seen, at, 0).astype(np.int64), rows - 2)
    part = np.clip(np.where(seen, at - low, 0.0), 0.0, 1.0)
    spread = np.arange(rows)
    unwrapped = np.interp(at[seen], spread[np.isfinite(roll)], np.unwrap(roll[np.isfinite(roll)], period=360.0))
    turned = np.zeros(len(z))
    turned[seen] = unwrapped
    count = wall.deviation_mm.shape[1]
    column = (np.arange(columns)[None] * 360.0 / columns - turned[:, None] - wall.first_deg) * count / 360.0
    left = np.floor(column)
    aside = (column - left).astype(np.float32)
    left = left.astype(np.int64) % count
    right = (left + 1) % count
    along = part[:, None].astype(np.float32)
    out = np.zeros((len(z), columns), np.float32)
    share = np.zeros_like(out)
    for row, w_row in ((low, 1 - along), (low + 1, along)):
        for at_column, w_column in ((left, 1 - aside), (right, aside)):
            weight = w_row * w_column
            value = wall.deviation_mm[row[:, None], at_column]
            out += np.where(weight > 0.01, weight * value, np.float32(0))
            share += weight * weight
    out += np.float32(wall.radius_mm - first.radius_mm)
    out[~seen] = np.nan
    known = np.isfinite(sigmas[0])
    sigma_z, sigma_roll = (np.interp(np.where(seen, at, 0.0), spread[known], one[known]) for one in sigmas)
    return out, share, sigma_z, sigma_roll
