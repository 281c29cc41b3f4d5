"""A head that stood still, or came back, saw each spot twice through one ring: the two agreed to a fiftieth of what
they were off, and the ring was said to be that sure. k = 2 held for 48 % of such a scan's points."""

from dataclasses import replace

import numpy as np
from synthetic_pipe import NOISE_MM, RADIUS_MM, round_pipe, scan

from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.crosscheck import with_revised_sigma

PIECES = Centreline([Piece(0.0, RADIUS_MM), Piece(120.0, RADIUS_MM, turn=(1e-6, 0.0))])  # poses are its adjustment's


def test_a_second_look_from_the_same_place_makes_no_point_surer() -> None:
    noise = np.array(NOISE_MM)
    once = [
        replace(one, sigma_mm=noise[one.ring].astype(np.float32), ring_sigma_mm=np.zeros((5, 2), np.float32))
        for one in scan(round_pipe, z_mm=[8.0 * i for i in range(20)])
    ]
    twice = [replace(one, frame=2 * one.frame + again) for one in once for again in (0, 1)]
    after = with_revised_sigma(twice, PIECES)
    x, y, _ = np.concatenate([p.points_mm for p in after]).astype(float).T
    ring, sigma = (np.concatenate([getattr(p, name) for p in after]) for name in ("ring", "sigma_mm"))
    inside = np.abs(np.hypot(x, y) - RADIUS_MM) <= 2 * sigma
    assert all(0.9 < inside[ring == k].mean() < 0.99 for k in range(5))
