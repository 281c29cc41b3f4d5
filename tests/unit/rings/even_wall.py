"""A round, even wall on a grid, as build_wall would make one, without a point of its own."""

import numpy as np

from annulus_pipe.wall.grid import Wall, WallObservations

RADIUS_MM = 76.2


def even_wall() -> Wall:
    z, clock = np.arange(141.0, 210.0, 2.0), np.arange(0.5, 360.0)
    shape = np.tile([RADIUS_MM, 0.0, 0.0, 0.0, 0.0], (len(z), 1))
    cells, none = np.full((len(z), len(clock)), RADIUS_MM, np.float32), np.zeros(0, np.float32)
    nobody = WallObservations(none.astype(int), none.astype(np.int32), none, none, none.astype(np.uint8))
    noise = np.full(len(z), 0.02)
    return Wall(
        z,
        clock,
        cells,
        np.ones(cells.shape, np.int32),
        shape,
        np.zeros((len(z), 5, 5)),
        noise,
        np.full_like(cells, 0.05),
        nobody,
        np.full_like(cells, 0.05),
    )
