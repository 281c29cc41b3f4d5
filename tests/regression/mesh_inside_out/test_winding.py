"""The mesh's triangles faced out of the pipe: viewers that cull back faces showed nothing (407d326). Fails with any of
the four kinds of triangle wound the other way."""

from dataclasses import replace

import numpy as np
from synthetic_pipe import round_pipe, scan

from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.surface import triangulate


def test_every_triangle_faces_the_axis() -> None:
    wall = build_wall(scan(round_pipe, z_mm=[0.0, 2.4, 4.8]))
    holes = np.random.default_rng(1).random(wall.radius_mm.shape) < 0.2  # so that each corner is missing somewhere
    mesh = triangulate(replace(wall, radius_mm=np.where(holes, np.nan, wall.radius_mm)))
    a, b, c = (mesh.points_mm[mesh.triangles[:, i]] for i in range(3))
    normal, middle = np.cross(b - a, c - a), (a + b + c) / 3
    assert ((normal[:, :2] * middle[:, :2]).sum(axis=1) < 0).all()
