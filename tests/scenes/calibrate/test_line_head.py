"""A head of bright rings, or of a flat plane, calibrated from a clean pipe: cones found, or a plane."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from line_heads import ONE_RING, PLANE, TWO_RINGS, head, picture

from annulus_pipe.calibrate.pipe import LINES_REMARK, calibrate_pipe, save_pipe
from annulus_pipe.geometry.calibration import camera_to_dict
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.storage.calibration_file import load_calibration
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World

LEANS = ((0.0, 8.0), (0.0, -8.0), (8.0, 0.0), (-8.0, 0.0), (6.0, 6.0), (-6.0, -6.0), (-6.0, 6.0), (6.0, -6.0))


def scan_of(world: World, folder: Path) -> Path:
    (folder / "frames").mkdir(parents=True)
    rows = ["index,file,light,z_mm"]
    renderer = Renderer(world)
    for i, (x, y) in enumerate(LEANS):
        pose = Pose(np.radians(x), np.radians(y), -0.6 * y, 0.6 * x)
        image = to_bgr(renderer.render(pose, 40.0, 1.0, seed=i), "bayer_rggb8")
        cv2.imwrite(str(folder / f"frames/{i}.png"), image)
        rows.append(f"{i},frames/{i}.png,projector,{i}")
    (folder / "frames.csv").write_text("\n".join(rows) + "\n")
    camera = {"format": "annulus-calibration/1", "camera": camera_to_dict(world.camera)}
    (folder / "camera.json").write_text(json.dumps(camera))
    return folder


@pytest.mark.deep(
    gate="tests/scenes/calibrate/test_line_head.py::test_two_rings_measure_the_wall_and_say_what_their_sigmas_do_not_hold"
)
@pytest.mark.parametrize("cones", [ONE_RING, PLANE], ids=["one ring", "flat plane"])
def test_a_line_head_is_calibrated_in_a_clean_pipe(cones: tuple[tuple[float, float], ...], tmp_path: Path) -> None:
    world = head(*cones, rods=False)
    folder = scan_of(world, tmp_path / "scan")
    found = calibrate_pipe(folder, folder / "camera.json", world.radius_mm, lines=1)
    save_pipe(found, tmp_path / "head.json")
    save_pipe(found, tmp_path / "head.json")  # again into its own file
    known = load_calibration(tmp_path / "head.json")
    assert known.kind == "line" and replace(known, rings=()) == replace(found.calibration, rings=())
    for read, ring in zip(known.rings, found.calibration.rings, strict=True):  # degrees in the file, radians here
        assert (read.axis, read.vertex_mm) == (ring.axis, ring.vertex_mm)
        assert read.half_angle == pytest.approx(ring.half_angle, rel=1e-15)
    true, got = world.projector.cones[0], known.rings[0]
    sigma = np.sqrt(np.diag(np.array(known.covariance)))
    print(true, got, sigma, found.advice, found.warnings)
    assert abs(got.half_angle - true.half_angle) <= 4 * sigma[0] + 1e-12
    # where it lights the wall: along the camera's axis, which is what a vertex and an angle are for
    reach = [ring.vertex_mm[2] + world.radius_mm / np.tan(ring.half_angle) for ring in (true, got)]
    lean = np.array(true.axis[:2]) @ np.array(true.vertex_mm[:2]) if cones == PLANE else 0.0
    assert abs(reach[0] + lean - reach[1]) < 0.15
    assert np.abs(np.array(true.axis[:2]) - np.array(got.axis[:2])).max() < 0.004
    assert picture(world, 40.0).shape[:2] == (world.camera.height, world.camera.width)


def test_two_rings_measure_the_wall_and_say_what_their_sigmas_do_not_hold(tmp_path: Path) -> None:
    world = head(*TWO_RINGS, rods=False)
    folder = scan_of(world, tmp_path / "scan")
    found = calibrate_pipe(folder, folder / "camera.json", world.radius_mm, lines=2)
    assert found.held_out is not None and found.held_out.rms_mm() < 0.1  # 0.032 measured
    assert LINES_REMARK in found.warnings
    for true, got in zip(world.projector.cones, found.calibration.rings, strict=True):  # as far off as it says
        assert np.degrees(abs(2 * (got.half_angle - true.half_angle))) < 1.0  # of the full angle: 0.42 and 0.90
        assert abs(got.vertex_mm[2] - true.vertex_mm[2]) < 3.0  # mm: 1.5 and 2.1
