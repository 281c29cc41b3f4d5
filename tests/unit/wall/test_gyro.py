"""A gyroscope with a bias in a bent pipe: weighed against the rings by what it scatters; not believed when it lies."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from chained_pipe import gyroscope, ridden
from synthetic_pipe import CALIBRATION

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall import adjustment
from annulus_pipe.wall.adjustment import (
    CURVATURE,
    PIECE,
    START,
    Adjusted,
    AdjustmentState,
    Sightings,
    adjust,
    sightings,
    unmodelled,
)
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.gyro import GYRO, Turns, weigh
from annulus_pipe.wall.profile import Profile

R, RADIUS, ANGLE = 76.2, 457.2, 45.0
STATIONS = list(np.arange(-70.0, 690.0, 20.0))
BIAS = (0.05, -0.06, 0.03)  # degrees a frame
TURN = np.array([np.cos(0.5), np.sin(0.5)]) / RADIUS
LINE = Centreline(
    [Piece(0.0, R), Piece(150.0, R, curvature=(TURN[0], TURN[1])), Piece(150.0 + RADIUS * np.radians(ANGLE), R)]
)


@dataclass(frozen=True)
class Ride:
    profiles: list[Profile]
    heads: list[Pose]
    seen: Sightings
    found: Adjusted

    def weighed(self, found: Adjusted, turns: Turns) -> tuple[Adjusted, tuple[str, ...]]:
        frames = np.array([self.profiles[i].frame for i in self.seen.which])
        adjusted, findings = weigh(self.seen, found, frames, turns)
        return adjusted, tuple(finding.kind for finding in findings)

    def said(self, noise_deg: float) -> Turns:
        return gyroscope(LINE, STATIONS, self.heads, BIAS, noise_deg)


def angle_of(adjusted: Adjusted) -> float:
    pieces = adjusted.state.pieces
    return float(np.degrees(np.hypot(*pieces[1, CURVATURE]) * (pieces[2, START] - pieces[1, START])))


@pytest.fixture(scope="module")
def ride() -> Ride:
    profiles, heads = ridden(LINE, STATIONS, roll=True)
    seen = sightings(profiles, CALIBRATION.rings, 24)
    assert seen is not None
    pieces, free = np.zeros((3, PIECE)), np.zeros((3, PIECE), np.bool_)
    pieces[:, START] = [piece.start_mm for piece in LINE.pieces]
    pieces[0, adjustment.RADIUS], pieces[1, CURVATURE] = R, TURN
    free[0, adjustment.RADIUS] = free[1:, START] = free[1, CURVATURE] = True
    found = adjust(
        seen,
        AdjustmentState(pieces, np.zeros((seen.rings, adjustment.BIAS)), seen.heads),
        free,
        scales_mm=(5.0, 1.0, 0.5),
    )
    return Ride(profiles, heads, seen, replace(found, covariance=found.covariance + unmodelled(seen, found)))


@pytest.fixture(scope="module")
def unsure(ride: Ride) -> Adjusted:
    """The same of rings that know the bend's radius to 2 % only, and are 1.5 % off."""
    pieces = ride.found.state.pieces.copy()
    pieces[1, CURVATURE] *= 1.015
    moved = adjust(ride.seen, replace(ride.found.state, pieces=pieces), np.zeros(pieces.shape, np.bool_))
    covariance = ride.found.covariance.copy()
    for number in (PIECE + CURVATURE.start, PIECE + CURVATURE.start + 1):
        at = int(np.flatnonzero(ride.found.free == number)[0])
        covariance[at, at] += (0.02 / RADIUS) ** 2
    return replace(moved, free=ride.found.free, covariance=covariance, follow=ride.found.follow)


def test_rings_that_know_well_stay_where_they_are(ride: Ride) -> None:
    adjusted, findings = ride.weighed(ride.found, ride.said(0.05))
    assert not findings
    assert angle_of(adjusted) == pytest.approx(ANGLE, abs=0.1)


def test_rings_that_know_little_are_put_right(ride: Ride, unsure: Adjusted) -> None:
    assert angle_of(unsure) == pytest.approx(ANGLE + 0.68, abs=0.1)
    adjusted, findings = ride.weighed(unsure, ride.said(0.02))
    print(angle_of(adjusted), findings)
    assert not findings
    assert angle_of(adjusted) == pytest.approx(ANGLE, abs=0.3)
    at = int(np.flatnonzero(adjusted.free == PIECE + CURVATURE.start)[0])
    assert adjusted.covariance[at, at] < 0.25 * unsure.covariance[at, at]


LIES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "signs": lambda t: -t,
    "axes": lambda t: t[[1, 0, 2]],
    "still": lambda t: 0.0 * t,
    "radians": np.radians,
    "scale": lambda t: 0.8 * t,
    "noise": lambda t: np.random.default_rng(int(abs(t[0]) * 1e6)).normal(0.0, 3.0, 3),
}


@pytest.mark.parametrize("lie", LIES)
def test_a_gyroscope_that_lies_is_left_out_and_that_is_said(ride: Ride, lie: str) -> None:
    turns = {frame: tuple(LIES[lie](np.array(said)).tolist()) for frame, said in ride.said(0.02).items()}
    adjusted, findings = ride.weighed(ride.found, turns)
    assert adjusted is ride.found
    assert findings == (GYRO,)


def test_one_that_drifts_a_little_moves_nothing_much(ride: Ride) -> None:
    turns = {frame: (x, y + 0.004 * frame, z) for frame, (x, y, z) in ride.said(0.02).items()}
    adjusted, _ = ride.weighed(ride.found, turns)
    assert angle_of(adjusted) == pytest.approx(ANGLE, abs=0.1)


def test_frames_of_which_nothing_is_known_cost_only_their_part(ride: Ride, unsure: Adjusted) -> None:
    unknown = (np.nan, np.nan, np.nan)
    turns = {frame: unknown if frame % 9 == 4 else said for frame, said in ride.said(0.02).items()}
    adjusted, findings = ride.weighed(unsure, turns)
    assert not findings
    assert angle_of(adjusted) == pytest.approx(ANGLE, abs=0.4)
    assert ride.weighed(ride.found, dict.fromkeys(turns, unknown)) == (ride.found, ())
