"""A chessboard that bows by 0.1 to 0.4 mm sent a lens' rays 0.2 to 0.7 px off, and their k = 2 said 0.04 to 0.3 px.

A bow is the same in all photographs: how the lens moves when one of them is left out does not show it.
"""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.intrinsics import Intrinsics, TargetObservation, fit_intrinsics

CAMERA = Camera("pinhole", 640, 480, 520.0, 521.0, 322.0, 236.0, (-0.2, 0.05, 1e-3, -5e-4, 0.0))
VIEWS, NOISE_PX, SQUARE_MM = 12, 0.06, 25.0
BOARD = np.stack(np.meshgrid(np.arange(9.0), np.arange(6.0)), axis=2).reshape(-1, 2) * SQUARE_MM


def fitted(bow_mm: float, seed: int) -> Intrinsics:
    rng = np.random.default_rng(seed)
    x = (BOARD[:, 0] - BOARD[:, 0].mean()) / np.ptp(BOARD[:, 0]) * 2
    board = np.column_stack([BOARD - BOARD.mean(axis=0), bow_mm * x * x])
    views = []
    while len(views) < VIEWS:
        turn = Rotation.from_euler("zxy", rng.uniform((-0.5, -0.7, -0.7), (0.5, 0.7, 0.7))).as_matrix()
        seen = CAMERA.project(board @ turn.T + rng.uniform((-90, -60, 260), (90, 60, 420)))
        if (np.abs(seen - [320, 240]) < [318, 238]).all():
            views.append(TargetObservation(BOARD, seen + rng.normal(0, NOISE_PX, seen.shape)))
    return fit_intrinsics(views, 640, 480, "pinhole")


def off_over_sigma(fit: Intrinsics) -> np.ndarray:
    """Of rays all over where a board was, without the turn that brings those of the corners together."""
    seen = np.concatenate(fit.seen)
    turn, _ = Rotation.align_vectors(fit.camera.rays(seen), CAMERA.rays(seen))
    at = np.stack(np.meshgrid(np.linspace(30, 610, 9), np.linspace(30, 450, 7)), axis=2).reshape(-1, 2)
    off = np.linalg.norm(fit.camera.project(turn.apply(CAMERA.rays(at))) - at, axis=1)
    return np.asarray((off / fit.ray_sigma_px(at))[fit.covered(at)])


@pytest.mark.parametrize("bow_mm", [0.15, pytest.param(-0.4, marks=pytest.mark.deep(but=1))])
@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.deep(but=1))])
def test_rays_are_within_what_their_sigma_says(bow_mm: float, seed: int) -> None:
    assert np.mean(off_over_sigma(fitted(bow_mm, seed)) < 2) > 0.9


def test_a_flat_board_costs_little() -> None:
    fit = fitted(0.0, 3)
    alone = (VIEWS - 1) / VIEWS * fit.moves.T @ fit.moves
    assert np.mean(off_over_sigma(fit) < 2) > 0.9
    assert (np.diag(fit.covariance) < 4 * np.diag(alone))[:4].all()
