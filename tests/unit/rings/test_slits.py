"""Slits and the cones they stand for: pixels to points, against geometry worked out apart."""

import numpy as np
import pytest
from drawn import calibration

from annulus_pipe.geometry.cone import intersect_cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.polar import RAY_STEP_PX, polar_grid, ring_pixels, unroll
from annulus_pipe.rings.slits import find_slits
from annulus_pipe.rings.triangulate import GRAZING, meet_rings, ring_optics


@pytest.fixture(scope="module")
def grid():
    return polar_grid(calibration(), 72)


def seen(grid, slits, levels, blur=1.0, noise=0.0, seed=0):
    """A frame of stripes around the grid's centre: `slits` (centre, width), one level (B, G, R) more than slits."""
    length = grid.address.shape[1]
    fine = np.arange(-0.5 + 1 / 32, length - 0.5, 1 / 16)
    row = np.zeros((len(fine), 3)) + levels[0]
    for (centre, width), level in zip(slits, levels[1:], strict=True):
        row[fine > centre] = level
        row[np.abs(fine - centre) < width / 2] = 0.0
    taps = np.exp(-0.5 * (np.arange(-80, 81) / 16 / blur) ** 2)
    row = np.stack([np.convolve(c, taps / taps.sum(), "same") for c in row.T], axis=1)
    camera = calibration().camera
    y, x = np.mgrid[0 : camera.height, 0 : camera.width]
    away = np.hypot(x - grid.centre[0], y - grid.centre[1]) - grid.first
    image = np.stack([np.interp(away, fine, c, left=0.0, right=0.0) for c in row.T], axis=2)
    image += np.random.default_rng(seed).normal(0, 1, image.shape) * noise
    return unroll(np.clip(np.rint(image), 0, 255).astype(np.uint8), grid)


@pytest.mark.parametrize(
    "levels",
    [((0, 0, 200), (0, 0, 200)), ((0, 0, 220), (0, 90, 0)), ((60, 0, 0), (0, 230, 0))],
    ids=["red red", "red green", "blue green"],
)
@pytest.mark.parametrize("centre", [60.0, 60.3, 60.5, 60.8])
def test_unequal_stripes_do_not_pull_a_slit(grid, levels, centre):
    found = find_slits(seen(grid, [(centre, 7.0)], levels), grid)
    assert len(found.position) == len(grid.stop)
    assert np.abs(found.position - centre).max() < 0.06
    assert np.abs(found.width - 7.0).max() < 0.14


@pytest.mark.parametrize("seed", range(3))
def test_darkness_with_noise_has_next_to_no_slits(grid, seed):
    assert len(find_slits(seen(grid, [], [(4, 4, 4)], noise=2.0, seed=seed), grid).position) < 15  # of 72 lines


def test_scaling_the_light_changes_nothing_but_the_light(grid):
    levels = np.array([(0, 0, 200), (0, 160, 0)])
    bright, dim = (find_slits(seen(grid, [(64.2, 7.0)], levels * s), grid) for s in (1.0, 0.25))
    assert np.abs(bright.position - dim.position).max() < 0.1


def test_the_compiled_cone_is_the_geometrys_cone():
    cal = calibration()
    rng = np.random.default_rng(4)
    rays = rng.normal(size=(500, 3)) * [0.5, 0.5, 0.3] + [0, 0, 0.7]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    cones = np.array([[*c.vertex_mm, *c.axis, c.half_angle] for c in cal.rings])
    met = meet_rings(np.zeros_like(rays), rays, cones)
    for k, cone in enumerate(cal.rings):
        truth, delta = intersect_cone(rays, cone)
        away = np.linalg.norm(truth - cone.vertex_mm, axis=1)
        sine = delta / (np.sin(2 * cone.half_angle) * away)  # of the angle between ray and cone
        ok = ~(sine < 1.01 * GRAZING)  # such rays are left out on purpose
        assert np.allclose(met[ok, k], truth[ok], rtol=1e-12, atol=1e-9, equal_nan=True)


@pytest.mark.parametrize("model", ["pinhole", "barrel", "fisheye"])
def test_a_pixel_on_the_grid_is_the_cameras_own_ray(model):
    cal = calibration(model)
    grid = polar_grid(cal, 36)
    for j, i in ((0, 12), (7, 44), (20, 100), (35, 64)):
        r = grid.first + i
        pixel = [[grid.centre[0] + r * grid.cosine[j], grid.centre[1] + r * grid.sine[j]]]
        assert np.allclose(cal.camera.rays(np.array(pixel))[0], grid.rays[j, i // RAY_STEP_PX], rtol=0, atol=1e-7)


def test_unrolling_reads_the_pixel_it_names():
    cal = calibration()
    grid = polar_grid(cal, 36)
    y, x = np.mgrid[0 : cal.camera.height, 0 : cal.camera.width]
    unrolled = unroll(np.stack([x * 0, y % 251, x * 0], axis=2).astype(np.uint8), grid)
    j, i = 9, 30  # straight down, for 36 directions
    expected = round(grid.centre[1] + grid.first + i)
    assert abs(int(unrolled.top[j, i - unrolled.first]) - expected % 251) <= 1


def test_rings_of_a_clean_pipe_lie_inside_the_grid_wherever_the_head_looks():
    cal = calibration("fisheye")
    grid = polar_grid(cal, 72)
    for pose in (Pose(0.05, 0.03, 5.0, -4.0), Pose(-0.05, 0.0, -6.0, 0.0)):
        for cone in cal.rings:
            r = np.linalg.norm(ring_pixels(cal.camera, cone, pose, cal.pipe_radius_mm) - grid.centre, axis=1)
            assert np.nanmin(r) > grid.first + 5 and np.nanmax(r) < grid.first + grid.stop.max()


def test_the_bend_is_that_of_the_cone_half_way_between_two_edges():
    """Edges at theta -+ h on a clean wall: their pixel middle, mended, is the slit's own pixel."""
    cal = calibration(scale=1.0)
    grid = polar_grid(cal, 72)
    optics = ring_optics(cal, grid)
    from dataclasses import replace

    for k, cone in enumerate(cal.rings):
        h = 4.0e-3
        edges = [replace(cone, half_angle=cone.half_angle + s) for s in (-h, 0.0, h)]
        # one azimuth of the light is enough: the head stands almost on the axis
        low, mid, high = (
            np.linalg.norm(ring_pixels(cal.camera, c, Pose(), cal.pipe_radius_mm)[40] - grid.centre) for c in edges
        )
        middle, width = (low + high) / 2, high - low
        mended = middle + np.median(optics.bend[k]) * width**2 / 8
        assert abs(mended - mid) < 0.02 * abs(middle - mid) + 1e-4
