"""Promises about openings: branches and tees are found, named and measured; nothing that only looks dark is one."""

from dataclasses import replace

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, RadiusMap, bump, opening, oval, pocket, round_pipe, scan, turn

from annulus_pipe.wall.features import Feature, FeatureKind
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.survey import Survey, survey

STATIONS = tuple(3.0 * i for i in range(32) if i % 5 != 4)
Z_MM = 155.0


def surveyed(radius: RadiusMap, *, directions: int = 720, noise: float = 1.0) -> Survey:
    return survey(scan(radius, z_mm=STATIONS, directions=directions, noise=noise, steep=True), CALIBRATION)


def only(pipe: Survey, kind: FeatureKind) -> Feature:
    """The one feature of a pipe that has nothing else."""
    assert [feature.kind for feature in pipe.features] == [kind]
    assert pipe.defects == ()
    return pipe.features[0]


def k2(feature: Feature, name: str) -> float:
    return next(one.k2 for one in feature.measures if one.name == name)


# Clock angles: in sound wall, at the seam of the grid, beside a rod's shadow (107 degrees).
@pytest.mark.deep(but=1)
@pytest.mark.parametrize(("clock_deg", "diameter_mm"), [(30.0, 25.0), (0.0, 40.0), (116.0, 25.0), (200.0, 18.0)])
def test_a_branch_is_found_where_it_is(clock_deg: float, diameter_mm: float) -> None:
    pipe = surveyed(opening(round_pipe, clock_deg, Z_MM, diameter_mm))
    branch = only(pipe, FeatureKind.BRANCH)
    assert branch.z_mm == pytest.approx(Z_MM, abs=0.2)
    assert abs(turn(np.array(branch.clock_deg), clock_deg)) < 0.1
    measured, allowed = branch.measured("inner_d_mm"), k2(branch, "inner_d_mm")
    assert measured == pytest.approx(diameter_mm, abs=0.3)
    assert abs(measured - diameter_mm) < allowed < 1.5
    assert branch.length_mm == measured
    assert np.isnan(branch.measured("protrusion_mm"))


def test_what_a_bore_shows_inside_is_no_diameter_of_the_pipe() -> None:
    pipe = surveyed(opening(round_pipe, 30.0, Z_MM, 25.0))
    assert np.nanmax(pipe.wall.radius_mm) > RADIUS_MM + 1.0, "its face has been seen"
    assert pipe.diameter_max_mm < 2 * RADIUS_MM + 0.3


@pytest.mark.deep(gate="tests/unit/wall/test_openings.py::test_what_a_bore_shows_inside_is_no_diameter_of_the_pipe")
@pytest.mark.parametrize(
    ("inner_mm", "outer_mm", "stands_mm", "clock_deg"), [(22.0, 34.0, 6.0, 30.0), (30.0, 42.0, 8.0, 227.0)]
)
def test_a_tee_is_told_by_its_rim(inner_mm: float, outer_mm: float, stands_mm: float, clock_deg: float) -> None:
    tee = only(surveyed(opening(round_pipe, clock_deg, Z_MM, inner_mm, outer_mm, stands_mm)), FeatureKind.TEE)
    assert tee.z_mm == pytest.approx(Z_MM, abs=0.2)
    assert tee.clock_deg == pytest.approx(clock_deg, abs=0.1)
    assert tee.measured("inner_d_mm") == pytest.approx(inner_mm, abs=0.3)
    assert tee.measured("protrusion_mm") == pytest.approx(stands_mm, abs=0.03)
    assert tee.length_mm == pytest.approx(outer_mm, abs=0.2)


def test_a_coarse_and_noisy_scan_shows_a_branch_too() -> None:
    branch = only(surveyed(opening(round_pipe, 30.0, Z_MM, 25.0), directions=360, noise=2.0), FeatureKind.BRANCH)
    assert branch.measured("inner_d_mm") == pytest.approx(25.0, abs=0.2)


@pytest.mark.deep(gate="tests/unit/wall/test_openings.py::test_what_a_bore_shows_inside_is_no_diameter_of_the_pipe")
def test_an_oval_pipe_with_a_pocket_beside_it_keeps_both() -> None:
    pipe = surveyed(pocket(opening(oval(round_pipe, 30, 0.01), 30, Z_MM, 25.0), 130, 10, 140, 165, 3.0))
    assert [feature.kind for feature in pipe.features] == [FeatureKind.BRANCH]
    assert pipe.features[0].z_mm == pytest.approx(Z_MM, abs=0.2)
    losses = [defect for defect in pipe.defects if defect.kind == "loss"]
    assert [round(defect.clock_deg / 10) for defect in losses] == [13]


def pit(clock_deg: float, diameter_mm: float, depth_mm: float) -> RadiusMap:
    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        away = np.hypot(np.radians(turn(clock, clock_deg)) * RADIUS_MM, z - Z_MM)
        return round_pipe(clock, z) + depth_mm * (away < diameter_mm / 2)

    return radius


@pytest.mark.deep(but=1)
@pytest.mark.parametrize(
    "radius",
    [
        round_pipe,
        pocket(round_pipe, 30, 10, 145, 167, 3.0),
        pocket(round_pipe, 100, 12, 140, 170, 5.0),  # its edge in a rod's shadow
        pit(30, 25.0, 5.0),
        pit(200, 18.0, 3.0),
        bump(round_pipe, 200, Z_MM, 12, 7.0),
        pocket(round_pipe, 0, 180, 150, 158, 2.0),
    ],
    ids=["nothing", "pocket", "pocket by a rod", "pit", "small pit", "bump", "groove"],
)
def test_shadows_and_floors_are_no_openings(radius: RadiusMap) -> None:
    assert surveyed(radius).features == ()


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("shape", ["disc", "square", "band", "streak"])
def test_wall_that_swallows_all_light_is_not_called_open(shape: str) -> None:
    """Black dirt, a dead patch of the picture, a gap all round: nothing is seen there, and nothing is claimed."""

    def hidden(profile: Profile) -> Profile:
        x, y, z = profile.points_mm.astype(np.float64).T
        across = np.radians(turn(np.degrees(np.arctan2(x, -y)), 30.0)) * RADIUS_MM
        along = z - Z_MM
        gone = {
            "disc": np.hypot(across, along) < 12.5,
            "square": np.maximum(np.abs(across), np.abs(along)) < 11.0,
            "band": np.abs(along) < 4.0,
            "streak": np.abs(across) < 12.0,
        }[shape]
        return replace(
            profile,
            points_mm=profile.points_mm[~gone],
            colour=profile.colour[~gone],
            ring=profile.ring[~gone],
            direction=profile.direction[~gone],
            sigma_mm=profile.sigma_mm[~gone],
        )

    assert survey([hidden(p) for p in scan(round_pipe, z_mm=STATIONS)], CALIBRATION).features == ()
