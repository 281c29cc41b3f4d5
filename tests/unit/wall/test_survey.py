"""Promises of the one call: the whole pipeline, nothing read or written, everything a reader may want an attribute."""

import math
from pathlib import Path

import numpy as np
import pytest
from synthetic_pipe import CALIBRATION, RADIUS_MM, bump, oval, pocket, round_pipe, scan

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.defects import Kind
from annulus_pipe.wall.grid import build_wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.surface import triangulate
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.texture import LedFrame

STATIONS = [3.0 * i for i in range(26)]


@pytest.fixture(scope="module")
def profiles() -> list[Profile]:
    return scan(pocket(bump(round_pipe, 200, 160, 12, 3.0), 90, 12, 130, 160, 4.0), z_mm=STATIONS)


@pytest.fixture(scope="module")
def pipe(profiles: list[Profile]) -> Survey:
    grey = np.full((CALIBRATION.camera.height, CALIBRATION.camera.width, 3), 120, np.uint8)
    return survey(profiles, CALIBRATION, [LedFrame(4, 20.0, grey)])


def test_the_worst_defect_is_the_deepest_and_says_how_well_it_is_known(pipe: Survey) -> None:
    worst = pipe.worst
    assert worst is not None and worst.kind is Kind.LOSS and worst.clock == "3:00"
    assert worst.depth_mm == pytest.approx(4.0, abs=0.1)
    assert math.isnan(worst.depth_k2_mm), "drawn points state no sigma, so nothing is claimed"


@pytest.mark.deep(
    gate="tests/unit/wall/test_survey.py::test_the_worst_defect_is_the_deepest_and_says_how_well_it_is_known"
)
def test_an_oval_stretch_is_worst_only_where_there_is_nothing_else() -> None:
    out_of_round = survey(scan(oval(round_pipe, 30, 0.03), z_mm=STATIONS), CALIBRATION)
    assert out_of_round.worst is not None and out_of_round.worst.kind is Kind.OVALITY
    dented = survey(scan(oval(bump(round_pipe, 200, 160, 12, 2.0), 30, 0.03), z_mm=STATIONS), CALIBRATION)
    assert {d.kind for d in dented.defects} == {Kind.OVALITY, Kind.BUMP}
    assert dented.worst is not None and dented.worst.kind is Kind.BUMP
    assert survey(scan(round_pipe, z_mm=STATIONS), CALIBRATION).worst is None


def test_every_figure_is_an_attribute(pipe: Survey) -> None:
    assert pipe.diameter_mean_mm == pytest.approx(2 * RADIUS_MM, abs=0.15)
    assert pipe.diameter_min_mm < pipe.diameter_mean_mm < pipe.diameter_max_mm
    assert pipe.diameter_max_mm == pytest.approx(2 * RADIUS_MM + 4.0, abs=0.15)
    assert pipe.nominal_diameter_mm == 2 * RADIUS_MM
    first, last = pipe.scanned_mm
    assert last - first == pytest.approx(len(pipe.wall.z_mm) * pipe.wall.z_step_mm)
    assert pipe.shadowed_fraction > 0 and pipe.seen_fraction + pipe.shadowed_fraction < 1
    assert not (pipe.shadowed & pipe.wall.seen).any()
    assert 0.02 <= pipe.noise_mm < 0.06
    assert pipe.depth_limit_mm == pytest.approx(max(6 * pipe.noise_mm, 0.005 * pipe.wall.mean_radius_mm))
    assert pipe.points == sum(len(p.points_mm) for p in pipe.profiles)
    assert pipe.roll_range_deg is None and math.isnan(pipe.lean_sigma_deg)
    assert pipe.texture is not None and not pipe.texture[pipe.shadowed].any()
    assert sum(pipe.rejected.values()) == sum(sum(p.rejected.values()) for p in pipe.profiles)


def test_the_maps_edges_are_the_grids(pipe: Survey) -> None:
    left, right, bottom, top = pipe.wall.extent
    assert (left, right, bottom, top) == (*pipe.scanned_mm, 360.0, 0.0)
    assert pipe.wall.deviation_mm().shape == (len(pipe.wall.z_mm), len(pipe.wall.clock_deg))


def test_a_survey_changes_nothing_and_writes_nothing(
    pipe: Survey, profiles: list[Profile], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    before = [p.points_mm.copy() for p in profiles]
    again = survey(profiles, CALIBRATION)
    assert all(np.array_equal(p.points_mm, old) for p, old in zip(profiles, before, strict=True))
    assert list(tmp_path.iterdir()) == []
    assert str(again.defects) == str(pipe.defects)  # NaN is not equal to itself
    assert np.array_equal(again.wall.radius_mm, pipe.wall.radius_mm, equal_nan=True)


def test_no_frame_is_one_clear_line() -> None:
    with pytest.raises(AnnulusError, match="no wall"):
        survey([], CALIBRATION)


def test_the_mesh_closes_around_the_seam() -> None:
    wall = build_wall(scan(round_pipe, z_mm=[3.0 * i for i in range(20)], rods_deg=(90.0,)))
    mesh = triangulate(wall, Centreline([Piece(0.0, 76.2)]))
    columns = mesh.cell[mesh.triangles] % len(wall.clock_deg)
    assert ((columns == 0).any(axis=1) & (columns == len(wall.clock_deg) - 1).any(axis=1)).any()
