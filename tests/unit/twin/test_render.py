"""The picture against the geometry it was drawn from, and against closed forms of optics and light."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from annulus_pipe.geometry.cone import intersect_cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric import native
from annulus_pipe.shipped import LOOPS, shipped
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import (
    World,
    WorldFeature,
    clean_world,
    demo_world,
    every_world,
    fisheye_camera,
    translucent,
)

CLEAN = replace(clean_world(), rods=()).scaled(832)


@pytest.fixture(scope="module")
def clean() -> Renderer:
    return Renderer(CLEAN)


def noiseless(world: World) -> World:
    return replace(world, optics=replace(world.optics, read=0.0, shot=0.0))


def test_a_dark_frame_is_black_level_and_read_noise(clean: Renderer) -> None:
    frame = clean.render(Pose(), 0.0)
    assert frame.shape == (CLEAN.camera.height, CLEAN.camera.width)
    assert 1.9 < frame.mean() < 2.2 and frame.max() < 12


def test_the_same_seed_gives_the_same_frame_and_rows_can_be_drawn_apart(clean: Renderer) -> None:
    pose = CLEAN.pose(30.0)
    whole = clean.render(pose, 30.0, 1.0, 0.3, seed=5)
    assert (whole == clean.render(pose, 30.0, 1.0, 0.3, seed=5)).all()
    assert (whole != clean.render(pose, 30.0, 1.0, 0.3, seed=6)).any()


def test_light_is_in_proportion_to_each_rows_gain() -> None:
    renderer = Renderer(noiseless(CLEAN))
    full = renderer.render(Pose(), 0.0, 0.0, 1.0).astype(float) - 2.0
    gain = np.linspace(0.0, 1.0, renderer.height).astype(np.float32)
    banded = renderer.render(Pose(), 0.0, 0.0, gain).astype(float) - 2.0
    np.testing.assert_allclose(banded, full * gain[:, None], atol=1.01)
    assert full[gain < 0.5].mean() > 45 and banded[0].max() == 0


def test_red_is_at_the_first_pixel_of_the_mosaic(clean: Renderer) -> None:
    frame = clean.render(Pose(), 0.0, 1.0)
    colour = cv2.cvtColor(frame, cv2.COLOR_BayerRGGB2BGR).reshape(-1, 3)
    v, u = np.mgrid[: clean.height, : clean.width]
    rays = CLEAN.camera.rays(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    # halfway between the outermost slit and the rim the stripe is red, between the third and fourth it is green
    tan_outer, tan_green = (
        76.2 / (76.2 / math.tan(math.radians(30.0)) - 54.0),
        76.2 / (76.2 / math.tan(math.radians(27.6)) - 54.5),
    )
    off = np.hypot(rays[:, 0], rays[:, 1]) / rays[:, 2]
    red, green = colour[np.abs(off - tan_outer) < 0.01], colour[np.abs(off - tan_green) < 0.005]
    assert np.median(red[:, 2]) > 100 > 30 > np.median(red[:, :2])
    assert np.median(green[:, 1]) > 80 > 28 > np.median(green[:, ::2])


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("camera", ["pinhole", "fisheye"])
def test_every_slits_dark_line_lies_on_its_cone_and_the_wall(camera: str) -> None:
    world = clean_world(camera=fisheye_camera()) if camera == "fisheye" else clean_world()
    world = noiseless(replace(world, rods=()))
    renderer, pose = Renderer(world), Pose(0.02, -0.015, 1.5, -1.0)
    frame = renderer.render(pose, 0.0, 1.0)
    light = cv2.cvtColor(frame, cv2.COLOR_BayerRGGB2BGR).max(axis=2).astype(np.float32)
    for cone in world.projector.cones:
        # along eight directions: from the true place of the slit, its two half-levels are equally far off
        for around in np.linspace(0.1, 2 * np.pi + 0.1, 8, endpoint=False):
            off = np.linspace(0.25, 0.85, 4000)
            rays = np.stack([np.sin(off) * math.cos(around), np.sin(off) * math.sin(around), np.cos(off)], axis=1)
            points, _ = intersect_cone(rays, cone)
            radius = np.hypot(*(pose.to_pipe(points)[:, :2].T))
            at = int(np.nanargmin(np.abs(radius - world.radius_mm)))
            place = world.camera.project(points[at : at + 1])[0]
            outwards = world.camera.project(rays[at : at + 2] * 100.0)
            step = outwards[1] - outwards[0]
            step /= np.linalg.norm(step)
            along = np.linspace(-9, 9, 181)
            line = (place + along[:, None] * step).astype(np.float32)
            seen = cv2.remap(light, line[:, :1], line[:, 1:], cv2.INTER_LINEAR).ravel()
            dark = (seen - 2.0) < 0.5 * np.where(along < 0, np.median(seen[:20]), np.median(seen[-20:]))
            centre = along[dark & (np.abs(along) < 7)].mean()
            assert abs(centre) < 0.35, f"{centre:.2f} px off"  # half a pixel of mosaic either way


def test_projector_light_falls_with_the_cube_of_distance_on_a_grazed_wall() -> None:
    led = Renderer(noiseless(replace(CLEAN, led=replace(CLEAN.led, behind_mm=0.0))))
    frame = led.render(Pose(), 0.0, 0.0, 1.0).astype(float) - 2.0
    v = round(CLEAN.camera.cy) & ~1
    tangent = (np.arange(led.width) - CLEAN.camera.cx) / CLEAN.camera.fx
    near, far = int(np.argmin(np.abs(tangent - 1.4))) | 1, int(np.argmin(np.abs(tangent - 0.7))) | 1
    ratio = (math.sin(math.atan(tangent[near])) / math.sin(math.atan(tangent[far]))) ** 3
    assert frame[v, near] / frame[v, far] == pytest.approx(ratio, rel=0.012)


def radius_seen(world: World, direction: float) -> float:
    """Tangent of the camera angle at which the fourth slit appears in one direction, from the picture."""
    renderer = Renderer(noiseless(world))
    light = cv2.cvtColor(renderer.render(Pose(), 0.0, 1.0), cv2.COLOR_BayerRGGB2BGR).max(axis=2).astype(np.float32)
    cone = world.projector.cones[3]
    off = np.linspace(0.45, 0.75, 1200)
    rays = np.stack([np.sin(off) * math.cos(direction), np.sin(off) * math.sin(direction), np.cos(off)], axis=1)
    pixels = world.camera.project(rays).astype(np.float32)
    seen = cv2.GaussianBlur(cv2.remap(light, pixels[:, :1], pixels[:, 1:], cv2.INTER_LINEAR), (1, 9), 0).ravel()
    points, _ = intersect_cone(rays, cone)
    radius = np.hypot(points[:, 0], points[:, 1])
    near = np.abs(radius - 76.2) < 5.0
    return float(radius[near][np.argmin(seen[near])])


@pytest.mark.deep(
    gate="tests/unit/twin/test_render.py::test_a_bump_throws_its_shadow_down_the_pipe_and_a_lamp_at_the_lens_none"
)
def test_a_pocket_and_an_oval_move_the_rings_by_their_depth() -> None:
    base = replace(clean_world(), rods=(), radius_mm=76.2)
    pocket = WorldFeature("pocket", z_mm=100.0, length_mm=70.0, depth_mm=3.0, clock_deg=90.0, arc_deg=40.0)
    assert radius_seen(replace(base, features=(pocket,)), 0.0) == pytest.approx(79.2, abs=0.2)
    oval = WorldFeature("oval", z_mm=100.0, length_mm=120.0, depth_mm=2.0, clock_deg=0.0)
    assert radius_seen(replace(base, features=(oval,)), math.pi / 2) == pytest.approx(78.0, abs=0.35)
    assert radius_seen(replace(base, features=(oval,)), 0.0) == pytest.approx(74.4, abs=0.5)
    assert radius_seen(base, 0.0) == pytest.approx(76.2, abs=0.05)


def test_a_bump_throws_its_shadow_down_the_pipe_and_a_lamp_at_the_lens_none() -> None:
    bump = WorldFeature("bump", z_mm=92.0, length_mm=26.0, depth_mm=8.0, clock_deg=90.0)
    world = noiseless(replace(clean_world(), rods=(), features=(bump,)))
    renderer = Renderer(world)
    behind = world.camera.project(np.array([[76.2, 0.0, 110.4]]))[0]
    u, v = int(behind[0]), int(behind[1])
    lit = Renderer(replace(world, features=())).render(Pose(), 0.0, 1.0)[v - 3 : v + 3, u - 2 : u + 2]
    assert lit.max() > 40
    assert renderer.render(Pose(), 0.0, 1.0)[v - 3 : v + 3, u - 2 : u + 2].max() <= 3
    assert renderer.render(Pose(), 0.0, 0.0, 1.0)[v - 3 : v + 3, u - 2 : u + 2].min() > 8


def test_rods_shade_the_pattern_but_not_the_led() -> None:
    with_rods = noiseless(clean_world().scaled(416))
    without = replace(with_rods, rods=())
    lost = Renderer(without).render(Pose(), 0.0, 1.0).astype(int) - Renderer(with_rods).render(Pose(), 0.0, 1.0)
    v, u = np.nonzero(lost > 40)
    direction = np.degrees(np.arctan2(v - with_rods.camera.cy, u - with_rods.camera.cx)) % 120.0
    assert len(v) > 200 and np.abs(direction - 17.0).max() < 9.0
    led = [Renderer(w).render(Pose(), 0.0, 0.0, 1.0) for w in (with_rods, without)]
    assert (led[0] == led[1]).all()


def test_a_world_survives_its_own_data_and_seeds_make_worlds() -> None:
    world = demo_world(seed=5)
    again = World.from_dict(world.to_dict())
    assert again == world
    assert (again.albedo_map == world.albedo_map).all() and again.pose(12.3) == world.pose(12.3)
    assert demo_world(seed=6).pose(12.3) != world.pose(12.3)


def test_the_demo_head_wobbles_as_much_as_a_real_one() -> None:
    poses = [demo_world().pose(z) for z in np.linspace(0, 330, 400)]
    tilt = [math.degrees(max(abs(p.rx), abs(p.ry))) for p in poses]
    shift = [max(abs(p.tx), abs(p.ty)) for p in poses]
    assert 1.0 < max(tilt) < 2.0 and 1.4 < max(shift) < 3.0


def test_the_wall_map_is_the_wall() -> None:
    world = demo_world()
    rng = np.random.default_rng(0)
    row, column = rng.integers(world.radius_map.shape[0], size=500), rng.integers(1440, size=500)
    truth = world.deviation(column * 0.25, row * 0.4)
    np.testing.assert_allclose(world.radius_map[row, column], truth, atol=2e-7)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("name", ["demo", "mirror-3inch", "water", "fringe"])
def test_a_frame_has_the_same_bits_from_every_library(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    world = every_world()[name](7).scaled(320)
    if name == "demo":
        world = translucent(world)
    renderer, z_mm = Renderer(world), 0.4 * world.travel_mm
    best = native.library().processor_level()
    drawn = []
    for level, name_of_it in native.LEVELS.items():
        if level > best or (level == 0) != (best == 0):
            continue
        loaded = native._load(shipped(f"{LOOPS}{name_of_it}.so"))
        monkeypatch.setattr(native, "library", lambda loaded=loaded: loaded)
        for door in native.DOORS:
            monkeypatch.setattr(door, "_function", None)
        drawn.append([renderer.render(world.pose(z_mm), z_mm, *lamps) for lamps in ((1.0, 0.0), (0.3, 0.7))])
    assert len(drawn) == max(best - 1, 1) and all(np.array_equal(one, drawn[0]) for one in drawn)
