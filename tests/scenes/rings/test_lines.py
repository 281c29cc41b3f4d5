"""Bright rings and planes of one colour, with truth from the twin: found, told apart, measured; and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest
from line_heads import ONE_RING, PLANE, TWO_RINGS, head, picture, with_reflection

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.cone import Cone, cone_distance, intersect_cone
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.rings.triangulate import meet_rings
from annulus_pipe.twin.worlds import World
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile

Z_MM = 40.0


def radial_error(profile: Profile, world: World) -> np.ndarray:
    """Of each point from the true axis: one ring does not show the lean, and points do not depend on it."""
    assert profile.pose is not None
    camera = profile.pose.to_camera(profile.points_mm.astype(float), Z_MM)
    flat = world.pose(Z_MM).to_pipe(camera, Z_MM)
    clock = np.degrees(np.arctan2(flat[:, 0], -flat[:, 1]))
    return np.asarray(np.hypot(flat[:, 0], flat[:, 1]) - world.radius_mm - world.deviation(clock, flat[:, 2]))


def measured(world: World, image: np.ndarray, guess: float = 1.0) -> Profile:
    known = replace(world.calibration(), pipe_radius_mm=guess * world.radius_mm)
    return Reconstructor(known).profile(image, frame=0, z_mm=Z_MM)


@pytest.mark.parametrize("cones", [ONE_RING, TWO_RINGS, PLANE], ids=["one ring", "two rings", "flat plane"])
def test_bright_lines_are_measured_though_the_radius_is_a_guess(cones: tuple[tuple[float, float], ...]) -> None:
    world = head(*cones)
    image = picture(world, Z_MM)
    for guess in (1.0, 1.03, 0.97):
        profile = measured(world, image, guess)
        error = radial_error(profile, world)
        assert len(error) > 0.9 * 720 * len(cones)
        assert np.sqrt(np.mean(error**2)) < 0.12 and np.abs(error).max() < 1.0
        for k in range(len(cones)):
            mine = error[profile.ring == k]
            assert len(mine) > 0.88 * 720 and abs(mine.mean()) < 0.05
        if guess == 1.0:
            assert 0.9 < np.mean(np.abs(error) < 2 * profile.sigma_mm) <= 1.0


def test_a_reflection_is_no_wall_and_a_gap_stays_one() -> None:
    world = head(*ONE_RING)
    image = picture(world, Z_MM)
    image[:, : image.shape[1] // 3] = 2  # a third of the picture is dark
    profile = measured(world, with_reflection(image, 0.5, 1.25))
    error = radial_error(profile, world)
    assert 0.5 * 720 < len(error) < 0.75 * 720
    # what the picture's dark edge cuts in half is off; the reflection would be by 19 mm
    assert np.percentile(np.abs(error), 98) < 0.3 and np.abs(error).max() < 3.0


def test_a_dark_frame_has_no_pipe() -> None:
    world = head(*ONE_RING)
    dark = np.random.default_rng(1).integers(0, 6, (world.camera.height, world.camera.width, 3), dtype=np.uint8)
    profile = measured(world, dark)
    assert profile.pose is None and len(profile.points_mm) == 0


def test_a_plane_is_no_grazing_cone() -> None:
    """88 degrees were measured, 89 refused: the two sheets of a flat cone were taken for a ray along it."""
    rng = np.random.default_rng(2)
    rays = np.stack([rng.uniform(-1, 1, 400), rng.uniform(-1, 1, 400), np.full(400, 0.8)], axis=1)
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    axis = (0.02, -0.01, float(np.sqrt(1 - 0.0005)))
    for degrees in (60.0, 88.0, 89.0, 89.9, 89.99999, 90.0):
        cone = Cone(float(np.radians(degrees)), axis, (1.0, 2.0, 70.0))
        points, _ = intersect_cone(rays, cone)
        seen = np.isfinite(points[:, 0])
        assert seen.mean() > 0.95
        assert np.abs(cone_distance(points[seen], cone)).max() < 1e-5
        row = np.array([[*cone.vertex_mm, *cone.axis, cone.half_angle]])
        again = meet_rings(np.zeros_like(rays), rays, row)[:, 0]
        both = seen & np.isfinite(again[:, 0])
        assert both.mean() > 0.95 and np.abs(again - points)[both].max() < 1e-5


def test_the_calibration_of_a_line_head_says_so_and_comes_back() -> None:
    known = head(*TWO_RINGS).calibration()
    data = known.to_dict()
    assert data["format"] == "annulus-calibration/2" and data["pattern"] == {"kind": "line"}
    assert Calibration.from_dict(data) == known
    plane = head(*PLANE).calibration().to_dict()
    assert plane["rings"][0]["theta_full_deg"] == 180.0 and Calibration.from_dict(plane).kind == "line"
    with pytest.raises(ValueError, match="at least one"):
        Calibration.from_dict({**data, "rings": []})
    with pytest.raises(ValueError, match='"rings" is missing'):
        Calibration.from_dict({key: value for key, value in data.items() if key != "rings"})
    with pytest.raises(AnnulusError, match="projects line, expected slits"):
        known.only()
