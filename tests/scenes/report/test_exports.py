"""A survey's results in other programs' forms, held against the survey itself."""

from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pandas
import pytest
import trimesh
from synthetic_pipe import CALIBRATION, bump, pocket, round_pipe, scan

from annulus_pipe.export import FORMS, open_results
from annulus_pipe.export import write as export
from annulus_pipe.export.radii import ANGLES_DEG
from annulus_pipe.report import ScanAccount, results, write
from annulus_pipe.wall.survey import Survey, survey

Made = tuple[Path, Survey]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Made:
    out = tmp_path_factory.mktemp("results")
    shape = pocket(bump(round_pipe, 200, 160, 12, 3.0), 90, 12, 130, 160, 4.0)
    pipe = survey(scan(shape, z_mm=[3.0 * i for i in range(26)]), CALIBRATION)
    write(pipe, ScanAccount("a pipe", {"projector": 26}, {}, {}), out)
    export(open_results(out), list(FORMS), out / "export")
    return out, pipe


@pytest.mark.deep(gate="tests/scenes/report/test_exports.py::test_the_radii_at_a_station_are_the_walls")
def test_the_wall_map_is_the_walls_radii_to_a_micrometre(made: Made) -> None:
    out, pipe = made
    with np.load(out / "wall.npz", allow_pickle=False) as file:
        held = dict(file)
    away, seen = held["deviation_um"], pipe.wall.seen
    assert away.dtype == np.int16 and np.array_equal(away == -32768, ~seen)
    assert held["radius_mm"] == CALIBRATION.pipe_radius_mm and str(held["radius_of"]) == "nominal"
    radius = held["radius_mm"] + 1e-3 * away
    assert np.abs(radius - pipe.wall.radius_mm)[seen].max() <= 0.51e-3
    assert np.array_equal(held["z_mm"], pipe.wall.z_mm) and np.array_equal(held["shadowed"], pipe.shadowed)
    sigma = np.hypot(pipe.wall.sigma_mm, pipe.wall.cell_noise_mm)
    known = seen & np.isfinite(sigma)
    assert np.array_equal(held["sigma_um"] == 65535, ~known)
    assert (held["sigma_um"][known] >= 999 * sigma[known]).all()  # rounded up
    assert np.isnan(held["imu_roll_deg"]).all() and len(held["imu_roll_deg"]) == len(away)  # no sensor gave one


def test_a_roll_that_a_sensor_gave_is_no_longer_in_the_map(made: Made, tmp_path: Path) -> None:
    _, pipe = made
    turned = tuple(replace(one, pose=one.pose and replace(one.pose, roll=0.2)) for one in pipe.profiles)
    results._write_wall(tmp_path / "wall.npz", replace(pipe, profiles=turned))
    with np.load(tmp_path / "wall.npz") as file:
        assert set(file["imu_roll_deg"]) == {0.0}


def test_a_deviation_beyond_what_the_map_holds_does_not_come_out_small(made: Made, tmp_path: Path) -> None:
    _, pipe = made
    for nominal in (20.0, 400.0):
        results._write_wall(tmp_path / "wall.npz", replace(pipe, nominal_diameter_mm=nominal))
        with np.load(tmp_path / "wall.npz") as file:
            away = file["deviation_um"][pipe.wall.seen]
        assert set(away) == {32767 if nominal < 100 else -32767}


def test_every_form_says_what_the_survey_found(made: Made) -> None:
    out, pipe = made
    table = pandas.read_csv(out / "export/pipe-tally.csv")
    assert len(table) == len(pipe.defects) + len(pipe.features) + len(pipe.detection.undecided)
    for row, one in zip(table.to_dict("records"), pipe.defects, strict=True):
        assert row["Log distance [m]"] == pytest.approx(one.z_mm / 1000, abs=6e-4)
        depth = row["Max. depth [mm]"] if one.kind == "loss" else row["Depth / height [mm]"]
        assert depth == pytest.approx(one.depth_mm, abs=0.006)
    cloud = laspy.read(out / "export/cloud.laz")
    assert cloud.header.point_count == pipe.points
    points = np.concatenate([one.points_mm for one in sorted(pipe.profiles, key=lambda one: one.frame)])
    x, y, z = cloud.xyz.T
    assert np.abs(1000 * np.stack([x, -z, y], axis=1) - points).max() < 0.001
    (surface,) = trimesh.load_scene(out / "export/mesh.glb").geometry.values()
    mesh = pipe.mesh()
    assert np.abs(1000 * surface.vertices * (1, -1, -1) - mesh.points_mm).max() < 1e-4
    assert np.array_equal(surface.faces, mesh.triangles)


def test_the_radii_at_a_station_are_the_walls(made: Made) -> None:
    out, pipe = made
    table = pandas.read_csv(out / "export/radii.csv")
    assert np.abs(table["z_mm"] - pipe.stations.z_mm).max() < 1e-4
    radii = table.iloc[:, 1:].to_numpy()
    deep = (ANGLES_DEG > 83) & (ANGLES_DEG < 97)
    row = int(np.argmin(np.abs(pipe.stations.z_mm - 145)))
    assert np.nanmedian(radii[row, deep]) == pytest.approx(CALIBRATION.pipe_radius_mm + 4.0, abs=0.1)
    opposite = radii[:, :540] + radii[:, 540:]
    both = np.isfinite(opposite).mean(axis=1) > 0.6
    away = np.nanmean(opposite[both], axis=1) - pipe.stations.diameter_mean_mm[both]
    assert both.sum() > 5 and np.nanmedian(np.abs(away)) < 0.02
