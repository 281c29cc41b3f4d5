"""What frames say of their errors is put right by how they disagree: sigmas too large, too small, of biased rings."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import NOISE_MM, RADIUS_MM, RadiusMap, bump, pocket, round_pipe, scan

from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.crosscheck import with_edges, with_revised_sigma
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.profile import Profile

STATIONS = [4.0 * i for i in range(20)]
STRAIGHT = Centreline([Piece(0.0, RADIUS_MM)])
PIECES = Centreline([Piece(0.0, RADIUS_MM), Piece(120.0, RADIUS_MM, turn=(1e-6, 0.0))])  # poses are its adjustment's
NOISE = np.array(NOISE_MM)


def said(
    profiles: Sequence[Profile],
    *,
    times: float = 1.0,
    drawn: Sequence[float] = (0, 0, 0, 0, 0),
    calibrated: float = 0.0,
    bias: Sequence[float] = (0, 0, 0, 0, 0),
) -> list[Profile]:
    """Each ring off by a bias; points say `times` their noise, how far it seems drawn, what the calibration leaves."""
    parts = np.stack([np.array(drawn, float), np.full(5, calibrated)], axis=1)
    sigma = np.sqrt((times * NOISE) ** 2 + (parts**2).sum(axis=1))
    out = []
    for one in profiles:
        points = one.points_mm.copy()
        radius = np.hypot(points[:, 0], points[:, 1])
        points[:, :2] *= (1 + np.array(bias, float)[one.ring] / radius)[:, None]
        out.append(
            replace(
                one,
                points_mm=points.astype(np.float32),
                sigma_mm=sigma[one.ring].astype(np.float32),
                ring_sigma_mm=parts.astype(np.float32),
            )
        )
    return out


def covered(profiles: Sequence[Profile], wall: RadiusMap = round_pipe) -> dict[int, float]:
    """Part of each ring's points within twice their sigma of the true wall, away from what steps."""
    x, y, z = np.concatenate([p.points_mm for p in profiles]).astype(float).T
    ring, sigma = (np.concatenate([getattr(p, name) for p in profiles]) for name in ("ring", "sigma_mm"))
    clock = np.degrees(np.arctan2(x, -y)) % 360
    inside = np.abs(np.hypot(x, y) - wall(clock, z)) <= 2 * sigma
    sound = np.abs(wall(clock, z) - RADIUS_MM) < 1e-9
    return {k: float(inside[sound & (ring == k)].mean()) for k in range(5)}


@pytest.mark.parametrize(("times", "line"), [(0.5, STRAIGHT), (3.0, PIECES)], ids=["too sure", "too unsure"])
def test_noise_is_what_frames_differ_by(times: float, line: Centreline) -> None:
    before = said(scan(round_pipe, z_mm=STATIONS), times=times)
    assert not all(0.93 < part < 0.97 for part in covered(before).values())
    assert all(0.93 < part < 0.97 for part in covered(with_revised_sigma(before, line)).values())


def test_a_straight_scan_is_no_surer_than_its_frames_were() -> None:
    before = said(scan(round_pipe, z_mm=STATIONS), times=3.0)
    after = with_revised_sigma(before, STRAIGHT)
    assert all((b.sigma_mm >= 0.999 * a.sigma_mm).all() for a, b in zip(before, after, strict=True))


def test_steps_of_the_wall_are_no_noise() -> None:
    wall = bump(pocket(round_pipe, 90, 25, 130, 165, 5.0), 270, 150, 15.0, 4.0)
    after = with_revised_sigma(said(scan(wall, z_mm=STATIONS)), STRAIGHT)
    assert all(0.92 < part < 0.98 for part in covered(after, wall).values())


def test_a_taper_that_frames_took_for_drawn_edges_is_taken_out_again() -> None:
    slope = 0.02

    def taper(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        return round_pipe(clock, z) - slope * z

    line = Centreline([Piece(0.0, RADIUS_MM, taper=-slope), Piece(120.0, RADIUS_MM - 120 * slope, taper=-slope)])
    before = said(scan(taper, z_mm=STATIONS), drawn=(1.0, 0.7, 0.5, 0.4, 0.3))
    after = with_revised_sigma(before, line)
    sigma = np.array([np.median(np.concatenate([p.sigma_mm[p.ring == k] for p in after])) for k in range(5)])
    assert np.all(np.abs(sigma / NOISE - 1) < 0.25), sigma


def test_a_ring_that_is_off_says_so_and_the_others_do_not() -> None:
    bias = (0.3, 0.0, -0.15, 0.0, 0.0)
    profiles = said(scan(round_pipe, z_mm=STATIONS), bias=bias)
    assert covered(profiles)[2] < 0.3
    part = covered(with_revised_sigma(profiles, STRAIGHT))
    assert all(0.93 < part[k] < 0.98 for k in (0, 2)), part
    # which rings are right nobody can know: the others are less sure than they need be
    assert all(part[k] > 0.93 for k in (1, 3, 4)), part


def test_what_the_calibration_leaves_stays_however_well_frames_agree() -> None:
    after = with_revised_sigma(said(scan(round_pipe, z_mm=STATIONS), calibrated=0.2), STRAIGHT)
    assert min(float(p.sigma_mm.min()) for p in after) >= 0.2


def test_where_no_other_frame_looks_or_nobody_said_anything_sigma_stays() -> None:
    profiles = scan(round_pipe, z_mm=STATIONS)
    alone = said(profiles[:1], times=3.0)
    assert np.array_equal(with_revised_sigma(alone, STRAIGHT)[0].sigma_mm, alone[0].sigma_mm)
    assert with_revised_sigma(profiles, STRAIGHT)[3] is profiles[3]
    assert with_revised_sigma([], STRAIGHT) == ()


def test_points_that_knew_how_bad_they_are_do_not_make_the_others_unsure() -> None:
    """A quarter of the way round is five times as noisy, and says so: in a flank, a dark patch, a bend."""
    noisy = said(scan(round_pipe, z_mm=STATIONS))
    rng = np.random.default_rng(5)
    before = []
    for one in noisy:
        bad = (one.points_mm[:, 0] > 0) & (one.points_mm[:, 1] > 0)
        points, sigma = one.points_mm.copy(), np.where(bad, 5 * one.sigma_mm, one.sigma_mm)
        radius = np.hypot(points[:, 0], points[:, 1])
        off = np.where(bad, np.sqrt(24) * one.sigma_mm * rng.normal(size=len(radius)), 0.0)
        points[:, :2] *= (1 + off / radius)[:, None]
        before.append(replace(one, points_mm=points.astype(np.float32), sigma_mm=sigma.astype(np.float32)))
    after = with_revised_sigma(before, STRAIGHT)
    said_now, said_then = (np.concatenate([p.sigma_mm for p in scan_]) for scan_ in (after, before))
    assert np.all(np.abs(said_now / said_then - 1) < 0.15), np.percentile(said_now / said_then, [0, 50, 100])


def test_points_beside_an_edge_are_no_surer_than_on_which_side_of_it_they_are() -> None:
    def smeared(profiles: Sequence[Profile]) -> list[Profile]:
        """What a picture makes of an edge: of the points within 2 mm of it, some stand on the other side."""
        out = []
        for one in profiles:
            points = one.points_mm.astype(float)
            points[:, 2] += np.random.default_rng(one.frame).uniform(-2.0, 2.0, len(points))
            out.append(replace(one, points_mm=points.astype(np.float32)))
        return out

    wall = pocket(round_pipe, 90, 30, 120, 190, 4.0)
    before = smeared(said(scan(wall, z_mm=STATIONS)))
    pipe = build_wall(before)
    after = with_edges(before, pipe)
    x, y, z = np.concatenate([p.points_mm for p in after]).astype(float).T
    clock = np.degrees(np.arctan2(x, -y)) % 360
    beside = (np.abs(np.abs(z - 155.0) - 35.0) < 2.0) & (np.abs(clock - 90.0) < 25.0)
    far = np.abs(z - 155.0) > 45.0
    off = np.abs(np.hypot(x, y) - wall(clock, z))
    sigmas = [np.concatenate([p.sigma_mm for p in profiles]).astype(float) for profiles in (before, after)]
    assert (off <= 2 * sigmas[0])[beside].mean() < 0.8  # half of them are on the other side
    assert (off <= 2 * sigmas[1])[beside].mean() > 0.93
    assert np.median(sigmas[1][far] / sigmas[0][far]) < 1.05
