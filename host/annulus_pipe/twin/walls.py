"""Walls as host/native/twin_walls.c meets them: the map of a wall, and tiles of it that say how a ray is met there and
bound what it may meet on its way.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import Float32Array, Image
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.twin.worlds.world import CLOCKS, STEP_Z_MM, World

_TILE_ROWS, _TILE_COLUMNS = 6, 8  # cells of the wall map to a tile: 2.4 mm by 2 degrees
_PLAIN_MM = 0.002  # a tile deviating less than this is a cylinder
_STEEP = 0.25  # slope above which a wall can hide itself from a grazing ray
_SPARE_COLUMNS = (1, 3)  # of the padded wall map: before twelve o'clock, and after
_GENTLE, _STEEP_TOO, _PAINTED = 1, 2, 4  # bits of a tile's kind, as the loops know them; a steep one has both


class WorldWall(NamedTuple):
    """A world's wall, as `render` hands it to the loops."""

    numbers: Float32Array  # (5,) radius, station of the map's first row (mm), rows a mm, tiles a row, tiles a column
    deviation: Float32Array  # the world's radius map, padded
    tile_low: Float32Array  # bounds of the deviation within a tile, mm
    tile_high: Float32Array
    near_low: Float32Array  # bounds of what a ray to the tile may meet on its way, mm
    near_high: Float32Array
    kind: Image


def padded(world: World) -> Float32Array:
    """The world's radius map with columns to spare on both sides."""
    return np.pad(world.radius_map, ((0, 0), _SPARE_COLUMNS), mode="wrap")


def wall_of(world: World) -> WorldWall:
    numbers = [world.radius_mm, world.z_range_mm[0], 1 / STEP_Z_MM, 1 / _TILE_ROWS, 1 / _TILE_COLUMNS]
    return WorldWall(np.array(numbers, np.float32), padded(world), *_tiles(world))


def _behind(tiles: NDArray[Any], reach: int, combine: Callable[..., NDArray[Any]]) -> NDArray[Any]:
    """Each tile combined with the `reach` tiles before it along the pipe."""
    out = tiles.copy()
    for k in range(1, reach + 1):
        out[k:] = combine(out[k:], tiles[:-k])
    return out


def _tiles(world: World) -> tuple[Float32Array, Float32Array, Float32Array, Float32Array, Image]:
    """Per tile of wall: bounds of the deviation in it, bounds of what a ray to it may meet on its way, how it is met.

    A ray that grazes at angle a passes height h of relief over h / tan(a) of pipe, so bounds reach that far.
    """
    deviation, paint = world.radius_map, world.albedo_map
    rows = deviation.shape[0] // _TILE_ROWS * _TILE_ROWS
    shape = (rows // _TILE_ROWS, _TILE_ROWS, CLOCKS // _TILE_COLUMNS, _TILE_COLUMNS)
    tiles = deviation[:rows].reshape(shape)
    low, high = tiles.min(axis=(1, 3)), tiles.max(axis=(1, 3))
    slope = np.maximum(
        np.abs(np.diff(deviation, axis=0, append=deviation[-1:]))[:rows] / STEP_Z_MM,
        np.abs(np.diff(deviation, axis=1, append=deviation[:, :1]))[:rows] / (world.radius_mm * 2 * np.pi / CLOCKS),
    )
    steep = slope.reshape(shape).max(axis=(1, 3)) > _STEEP
    grazing = math.tan(max(world.projector.innermost, math.radians(8.0)))
    relief = max(float(np.abs(deviation).max(initial=0.0)), 0.0)
    reach = math.ceil(relief / grazing / (STEP_Z_MM * _TILE_ROWS)) + 2
    mode = ("nearest", "wrap")
    near_low = _behind(ndimage.minimum_filter(low, size=3, mode=mode), reach, np.minimum)
    near_high = ndimage.maximum_filter(high, size=(5, 3), mode=mode)
    # what is carved out of the wall is met through its own opening; what stands out of it hides the wall behind it
    carved = ndimage.maximum_filter(high, size=3, mode=mode) > _PLAIN_MM
    steep_near = ndimage.maximum_filter(steep, size=(2 * reach + 1, 3), mode=mode) & carved
    steep_near |= ndimage.maximum_filter(steep, size=3, mode=mode)
    stands = ndimage.maximum_filter(steep & (low < -_PLAIN_MM), size=3, mode=mode)
    steep_near |= _behind(stands, reach, np.maximum)
    kind = np.where(
        steep_near, _STEEP_TOO | _GENTLE, np.where((near_high > _PLAIN_MM) | (near_low < -_PLAIN_MM), _GENTLE, 0)
    ).astype(np.uint8)
    bare = (np.array(world.albedo) * 255.0 + 0.5).astype(np.uint8)
    marked = (paint[:rows] != bare).any(axis=2).reshape(shape).any(axis=(1, 3))
    kind |= np.where(ndimage.maximum_filter(marked, size=3, mode=mode), _PAINTED, 0).astype(np.uint8)
    bounds = [np.ascontiguousarray(bound, dtype=np.float32) for bound in (low, high, near_low, near_high)]
    return bounds[0], bounds[1], bounds[2], bounds[3], kind
