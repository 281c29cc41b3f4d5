"""Two cameras of one head see the same light on the same wall, each from where it is; a scan of theirs pairs it."""

import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.scan import world_named, write_scan
from annulus_pipe.twin.worlds import World, stereo_world
from annulus_pipe.vocabulary import AnnulusError, Label


def places(world: World, ring: int, around: float, off: np.ndarray) -> np.ndarray:
    """(N, 3) in the first camera's frame: where the wall of a clean pipe is met `off` (rad) beside the ring's cone."""
    cone, pose = world.projector.cones[ring], world.pose(0.0)
    axis = np.array(cone.axis)
    side = np.cross(axis, [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    across = math.cos(around) * side + math.sin(around) * np.cross(axis, side)
    angle = (cone.half_angle + off)[:, None]
    ways = (np.cos(angle) * axis + np.sin(angle) * across) @ pose.rotation
    vertex = pose.to_pipe(np.array([cone.vertex_mm]))[0]
    a, b = (ways[:, :2] ** 2).sum(axis=1), ways[:, :2] @ vertex[:2]
    s = (np.sqrt(b * b - a * (vertex[:2] @ vertex[:2] - world.radius_mm**2)) - b) / a
    return pose.to_camera(vertex + s[:, None] * ways)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("radius_mm", [76.2, 38.1])
@pytest.mark.parametrize("camera", [0, 1])
def test_every_slit_is_seen_by_both_cameras_where_its_cone_meets_the_wall(camera: int, radius_mm: float) -> None:
    world = replace(stereo_world(radius_mm=radius_mm), features=(), texture=False)
    world = replace(world, optics=replace(world.optics, read=0.0, shot=0.0))
    frame = Renderer(world, camera).render(world.pose(0.0), 0.0, 1.0)
    light = cv2.cvtColor(frame, cv2.COLOR_BayerRGGB2BGR).max(axis=2).astype(np.float32)
    seen = world.cameras[camera]
    off = np.radians(np.linspace(-1.3, 1.3, 261))
    worst = 0.0
    for ring in range(7):
        for around in np.linspace(0.1, 2 * np.pi + 0.1, 8, endpoint=False):
            at = places(world, ring, around, off) @ np.array(seen.rotation).T + seen.translation_mm
            line = seen.camera.project(at).astype(np.float32)
            level = cv2.remap(light, line[:, :1], line[:, 1:], cv2.INTER_LINEAR).ravel() - 2.0
            inside, outside = np.median(level[:20]), np.median(level[-20:])
            assert min(inside, outside) > 8.0, (ring, around)
            dark = level < 0.5 * np.where(off < 0, inside, outside)
            wide_px = float(np.linalg.norm(line[-1] - line[0])) / len(off)
            worst = max(worst, abs((off[dark] / (off[1] - off[0])).mean()) * wide_px)
            assert dark.sum() * wide_px == pytest.approx(12.0, abs=6.0)
    assert worst < 0.35  # px, half a pixel of mosaic either way; 0.2 measured


@pytest.mark.deep(
    gate="tests/unit/twin/test_stereo_world.py::test_every_slit_is_seen_by_both_cameras_where_its_cone_meets_the_wall"
)
def test_the_wall_is_lit_alike_for_both_cameras() -> None:
    """One LED for both: a place on the wall is as bright in either picture."""
    world = replace(stereo_world(), features=(), texture=False)
    world = replace(world, optics=replace(world.optics, read=0.0, shot=0.0))
    wall = places(world, 4, 0.7, np.zeros(1)), places(world, 2, 3.7, np.zeros(1))
    frames = [Renderer(world, camera).render(world.pose(0.0), 0.0, 0.0, 1.0) for camera in (0, 1)]
    for point in wall:
        levels = []
        for seen, frame in zip(world.cameras, frames, strict=True):
            u, v = seen.camera.project(point @ np.array(seen.rotation).T + seen.translation_mm)[0].round().astype(int)
            levels.append(frame[v - 2 : v + 2, u - 2 : u + 2].mean() - 2.0)
        assert levels[0] > 5.0 and levels[1] == pytest.approx(levels[0], abs=1.5)


def test_two_cameras_noise_is_not_the_same() -> None:
    world = stereo_world().scaled(208)
    dark = [Renderer(world, camera).render(world.pose(0.0), 0.0, seed=3).astype(float) for camera in (0, 1)]
    rows = min(len(one) for one in dark)
    assert abs(np.corrcoef(dark[0][:rows].ravel(), dark[1][:rows].ravel())[0, 1]) < 0.05


def test_a_world_of_two_cameras_survives_its_own_data_and_says_its_calibration() -> None:
    world = stereo_world().scaled(832)
    assert World.from_dict(json.loads(json.dumps(world.to_dict()))) == world
    known = Calibration.from_dict(json.loads(json.dumps(world.calibration().to_dict())))
    assert [one.camera.width for one in known.cameras] == [832, 832] and len(known.rings) == 7
    np.testing.assert_allclose(known.others[0].translation_mm, world.others[0].translation_mm)
    # Table 5.4: the second camera stands there, a quarter turn round, and the projector at right angles between them
    turn, moved = np.array(world.others[0].rotation), np.array(world.others[0].translation_mm)
    centre = -turn.T @ moved
    np.testing.assert_allclose(centre, [-16.2253, -15.2014, 1.4238], atol=1e-9)
    first, second = -np.array(known.rings[3].vertex_mm)[:2], (centre - known.rings[3].vertex_mm)[:2]
    between = math.degrees(math.acos(first @ second / np.linalg.norm(first) / np.linalg.norm(second)))
    assert between == pytest.approx(90.0, abs=4.0)


def test_cameras_of_one_sync_line_have_equally_many_rows() -> None:
    world = stereo_world()
    other = replace(world.others[0], camera=replace(world.others[0].camera, height=616))
    with pytest.raises(AnnulusError, match="equally many rows"):
        replace(world, others=(other,))


def test_a_written_scan_has_a_row_for_each_camera_of_each_flash(tmp_path: Path) -> None:
    small = world_named("stereo-3inch", 2).scaled(208)
    write_scan(small, tmp_path / "scan", 6)
    scan = open_scan(tmp_path / "scan")
    assert scan.cameras == (0, 1) and len(scan.frames) == 12
    for index in range(6):
        first, second = (frame for frame in scan.frames if frame.index == index)
        assert (first.camera, second.camera) == (0, 1)
        assert first.label is second.label is (Label.LED if index == 4 else Label.PROJECTOR)
        assert first.z_mm == second.z_mm
    assert (scan.read(0) != scan.read(1)).any()
    assert Calibration.from_dict(json.loads((tmp_path / "scan" / "calibration.json").read_text())).others
