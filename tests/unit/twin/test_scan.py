"""A simulated scan written as a scan folder reads like any other; through a lens and through the mirror."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.scan import world_named, write_scan
from annulus_pipe.twin.score import score_cloud
from annulus_pipe.twin.worlds import World, mirror_world
from annulus_pipe.vocabulary import AnnulusError, Label


@pytest.fixture(scope="module")
def small() -> World:
    return replace(mirror_world(), travel_mm=90.0)


@pytest.fixture(scope="module")
def folder(small: World, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("scan") / "mirror"
    write_scan(small, out, 5)
    return out


@pytest.mark.deep(gate="tests/unit/twin/test_scan.py::test_a_scan_is_not_written_over_another")
def test_a_written_scan_opens_like_one_of_a_camera(small: World, folder: Path) -> None:
    scan = open_scan(folder)
    assert [f.label for f in scan.frames] == [Label.PROJECTOR] * 4 + [Label.LED]
    assert [f.z_mm for f in scan.frames] == [0.0, 22.5, 45.0, 67.5, 90.0]
    assert scan.read(0).shape == (1232, 1664, 3)
    read = Calibration.from_dict(json.loads((folder / "calibration.json").read_text()))
    assert read.camera == small.camera and read.colours == small.projector.colours
    assert json.loads((folder / "truth.json").read_text())["radius_mm"] == 38.1


@pytest.mark.deep(gate="tests/unit/twin/test_scan.py::test_rings_in_reversed_order_are_told_apart")
def test_the_wall_of_a_3_inch_pipe_is_measured_in_the_mirror(small: World, folder: Path) -> None:
    scan = open_scan(folder)
    reconstructor = Reconstructor(Calibration.from_dict(json.loads((folder / "calibration.json").read_text())))
    for i in (0, 3):  # clean wall; pocket and bump
        profile = reconstructor.profile(scan.read(i), frame=i, z_mm=scan.frames[i].z_mm)
        score = score_cloud(small, profile.points_mm, profile.ring)
        assert score.points > 4500 and set(profile.ring) == set(range(7))
        assert score.rms_mm < 0.03 and score.gross_percent == 0
        assert profile.pose is not None and abs(profile.pose.tx - small.pose(profile.z_mm).tx) < 0.005


def test_rings_in_reversed_order_are_told_apart() -> None:
    """The camera behind the ball: the innermost cone is the outermost ring of the image."""
    narrow = mirror_world(radius_mm=25.4, travel_mm=20.0)
    assert narrow.camera.mirror is not None
    slide = narrow.projector  # two rings less: so near the ball's rim they would run into one another
    outer = replace(slide, cones=slide.cones[2:], slit_half_deg=slide.slit_half_deg[2:], colours=slide.colours[2:])
    ahead = replace(narrow.camera, mirror=replace(narrow.camera.mirror, looks="ahead"))
    world = replace(narrow, camera=ahead, projector=outer)
    image = to_bgr(Renderer(world).render(world.pose(0.0), 0.0, 1.0), "bayer_rggb8")
    profile = Reconstructor(world.calibration()).profile(image, frame=0, z_mm=0.0)
    score = score_cloud(world, profile.points_mm, profile.ring)
    assert score.points > 3400 and score.rms_mm < 0.05 and score.gross_percent == 0


def test_a_camera_sees_its_own_housing_in_the_mirror_and_nothing_beside_it(small: World) -> None:
    world = replace(small, optics=replace(small.optics, read=0.0, shot=0.0)).scaled(416)
    lit = Renderer(world).render(world.pose(5), 5.0, 0.0, 1.0)
    v, u = np.mgrid[0 : world.camera.height, 0 : world.camera.width]
    middle = world.camera.project(np.array([[0.0, 0.0, 30.0]]))[0]
    away = np.hypot(u - middle[0], v - middle[1])
    assert lit[away < 6].max() <= 2 and lit[away > 150].max() <= 2 and lit[(away > 75) & (away < 100)].min() > 10


def test_a_world_with_a_mirror_survives_its_own_dictionary(small: World) -> None:
    assert World.from_dict(json.loads(json.dumps(small.to_dict()))) == small


def test_a_scan_is_not_written_over_another(folder: Path, small: World) -> None:
    with pytest.raises(AnnulusError, match="not empty"):
        write_scan(small, folder, 5)
    with pytest.raises(AnnulusError, match="mirror-3inch"):
        world_named("moon", 1)
