"""Promises of the pipe's own shape: known where it was seen, and nothing said from it where it was not.

A dented pipe, one bright ring, an arc of 110 degrees that nobody saw: the shape once stood 40 mm beside points that lay
within 7.5 mm of a circle.
"""

import math

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, oval, round_pipe, scan, turn

from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.pose import fit_pose
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.shape import fit_shape, harmonics, spread
from annulus_pipe.wall.stations import shape_ovality, swing_sigma
from annulus_pipe.wall.survey import Survey, survey

OVAL = 0.04
NOISE_MM, BIAS_MM = 0.12, 0.05
CLOCK = np.arange(360) + 0.5


def one_ring(
    guess: float,
    *,
    gap_deg: float = 110.0,
    gap_at: float = 180.0,
    axis_deg: float = 30.0,
    third_mm: float = 0.0,
    seed: int = 0,
) -> tuple[list[Profile], int]:
    """Frames of a wandering head whose one ring lies 90 mm ahead, posed with a radius `guess` times the true one; and
    how many found no pipe. third_mm: a dent of three waves, which no oval follows."""
    rng = np.random.default_rng(seed)
    out: list[Profile] = []
    lost = 0
    for i in range(24):
        clock = np.arange(720) / 2.0
        clock = clock[(np.abs(turn(clock, gap_at)) > gap_deg / 2) & (rng.random(720) > 0.03)]
        t = np.radians(clock)
        radius = RADIUS_MM * (1 + OVAL * np.cos(2 * (t - math.radians(axis_deg)))) + third_mm * np.cos(3 * t + seed)
        radius += rng.normal(0, NOISE_MM, len(t)) + BIAS_MM * rng.normal()
        shift = np.array([4 * math.sin(i / 7), 3 * math.cos(i / 9), 0.0])
        points = np.stack([radius * np.sin(t), -radius * np.cos(t), np.full(len(t), 90.0)], axis=1) + shift
        fit = fit_pose(points, guess * RADIUS_MM, np.full(len(t), 0.1), None, one_ring=True)
        if fit is None:
            lost += 1
            continue
        blank = np.zeros((len(t), 3), np.uint8)
        sigma = np.full(len(t), math.hypot(NOISE_MM, BIAS_MM), np.float32)
        out.append(
            Profile(
                i,
                5.0 * i,
                fit.pose,
                fit.pose.to_pipe(points, 5.0 * i).astype(np.float32),
                blank,
                blank[:, 0],
                (2 * clock).astype(np.uint16),
                fit.robust_sigma_mm,
                sigma_mm=sigma,
                lean_sigma_deg=fit.lean_sigma_deg,
            )
        )
    return out, lost


@pytest.mark.deep(but=2)
@pytest.mark.parametrize(("guess", "axis_deg"), [(1.03, 30.0), (0.97, 30.0), (1.03, 90.0), (0.97, 135.0)])
def test_a_dented_pipe_of_one_ring_and_an_unseen_arc(guess: float, axis_deg: float) -> None:
    profiles, lost = one_ring(guess, axis_deg=axis_deg)
    assert lost == 0, "every frame is posed, though the radius is 3 % off"
    pipe: Survey = survey(profiles, CALIBRATION)
    (found,) = pipe.defects
    assert found.kind is Kind.OVALITY, "nothing else is invented"
    assert abs(found.depth_mm - 2 * OVAL * RADIUS_MM) < found.depth_k2_mm < 0.9
    assert abs(turn(np.array(2 * found.clock_deg), 2 * axis_deg)) < 2 * 2.0
    assert pipe.findings == ()
    off = np.hypot(pipe.wall.shape_mm[:, 3], pipe.wall.shape_mm[:, 4]) - OVAL * RADIUS_MM
    assert np.abs(off).max() < 0.06 and (swing_sigma(pipe.wall) < 0.02).all()


def test_what_an_unseen_arc_leaves_open_is_said_and_not_measured() -> None:
    profiles, lost = one_ring(1.0, third_mm=4.0, gap_deg=130.0)
    assert lost == 0
    pipe = survey(profiles, CALIBRATION)
    (finding,) = pipe.findings
    assert "° about clock 6:00 were not seen" in finding.text
    assert not [d for d in pipe.defects if d.kind is Kind.OVALITY]
    assert np.isnan(shape_ovality(pipe.wall)).all() and math.isnan(pipe.shape_ovality_max_percent)
    unsure = pipe.wall.shape_sigma_mm() > pipe.wall.shape_limit_mm
    assert not (unsure & (pipe.detection.label > 0)).any()


def test_the_shape_stays_by_the_points_it_was_fitted_to() -> None:
    """Whatever is left of a crushed pipe, and however little of it was seen."""
    rng, t = np.random.default_rng(4), np.radians(CLOCK)
    z = np.arange(0.0, 60.0, 2.0)
    for gap in (60, 110, 150, 200):
        line = RADIUS_MM + 4 * np.cos(3 * t + gap) + 2 * np.cos(5 * t) + rng.normal(0, 0.3, (len(z), len(t)))
        line[:, np.abs(turn(CLOCK, 200.0)) < gap / 2] = np.nan
        shape, covariance = fit_shape(line, z, CLOCK)
        round_clock = shape @ harmonics(CLOCK).T
        assert np.abs(round_clock - line)[np.isfinite(line)].max() < 20.0
        assert np.abs(round_clock - RADIUS_MM).max() < 15.0, "nor does it run away where nobody looked"
        sigma = spread(covariance, harmonics(CLOCK))
        unseen = ~np.isfinite(line[0])
        assert sigma[:, unseen].max() > 2 * sigma[:, ~unseen].min()


def test_a_pipe_seen_all_round_has_a_shape_that_is_known() -> None:
    wall = build_wall(scan(oval(round_pipe, 60.0, 0.02)))
    assert wall.shape_sigma_mm().max() < 0.05
    true = 0.02 * RADIUS_MM
    assert np.abs(np.hypot(wall.shape_mm[:, 3], wall.shape_mm[:, 4]) - true).max() < 0.03
    assert np.isfinite(wall.deviation_mm()[wall.seen]).all()


def test_a_shape_nobody_saw_is_not_known() -> None:
    nothing = np.full((20, 360), np.nan)
    nothing[:, :100] = RADIUS_MM
    shape, covariance = fit_shape(nothing, np.arange(20.0), CLOCK)
    assert np.isfinite(shape).all() and np.isinf(spread(covariance, harmonics(CLOCK))).all()
