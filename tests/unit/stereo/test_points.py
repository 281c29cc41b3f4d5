"""The compiled passes say what the same sums written out in numpy say."""

import numpy as np
from drawn_head import RADIUS_MM, head

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.stereo.merge import Merged
from annulus_pipe.stereo.points import known, outwards, radius_sigma, to_pipe
from annulus_pipe.stereo.reconstructor import generators

POSE = Pose(0.02, -0.03, -6.9, -9.1)


def test_points_and_their_sigma_are_those_of_the_plain_sums() -> None:
    cones, ways = generators(head(), 90)
    vertices = cones[:, :3]
    start = to_pipe(vertices, POSE, ways, RADIUS_MM)
    on_wall = POSE.to_pipe((vertices[:, None] + start[..., None] * ways).reshape(-1, 3))
    assert np.allclose(np.hypot(on_wall[:, 0], on_wall[:, 1]), RADIUS_MM, atol=1e-9)

    seeded = np.random.default_rng(3)
    distance = np.where(seeded.random(start.shape) < 0.2, np.nan, start + seeded.normal(0.0, 0.5, start.shape))
    along = np.where(np.isnan(distance), np.nan, seeded.uniform(0.01, 0.3, start.shape))
    none = np.zeros(start.shape, np.int64)
    merged = Merged(distance, along, none, none, none, none, np.full(start.shape, np.nan))
    root = seeded.normal(0.0, 1.0, (4, 4)) * [[1e-4], [1e-4], [1e-2], [1e-2]]
    covariance = root @ root.T

    at, points = known(merged, vertices, ways)
    ring, direction = np.nonzero(np.isfinite(distance))
    assert np.array_equal(at, [ring, direction])
    assert np.allclose(points, vertices[ring] + distance[ring, direction][:, None] * ways[ring, direction], atol=1e-12)

    q, w = POSE.to_pipe(points), ways[ring, direction] @ POSE.rotation
    r = np.hypot(q[:, 0], q[:, 1])
    away = (q[:, :2] * w[:, :2]).sum(axis=1) / r
    assert np.allclose(outwards(points, at, ways, POSE), away, atol=1e-12)
    pull = np.stack([q[:, 2] * q[:, 1] / r, -q[:, 2] * q[:, 0] / r, -q[:, 0] / r, -q[:, 1] / r], axis=1)
    sigma = np.sqrt((along[ring, direction] * away) ** 2 + np.einsum("ni,ij,nj->n", pull, covariance, pull))
    assert np.allclose(radius_sigma(points, at, along[ring, direction], ways, POSE, covariance), sigma, rtol=1e-12)
