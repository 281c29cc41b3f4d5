"""Heads under fringes: each camera sees its slide's phase where that falls on the wall, a file says the same head."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from annulus_pipe.geometry.cone import intersect_cylinder
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.scans.scan import open_scan
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.scan import write_scan
from annulus_pipe.twin.worlds import World
from annulus_pipe.vocabulary import Label
from annulus_pipe.wings.fringe.heads import ball_fringe_world, mirror_fringe_world, modules_world, series_world
from annulus_pipe.wings.fringe.light import Fringes
from annulus_pipe.wings.fringe.measure import FringeHead

MODELS = pytest.mark.parametrize("make", [series_world, modules_world, mirror_fringe_world])


def light_of(world: World) -> Fringes:
    assert isinstance(world.projector, Fringes)
    return world.projector


def clean(make: Callable[[], World]) -> World:
    world = replace(make(), features=(), texture=False, rods=())
    return replace(world, optics=replace(world.optics, read=0.0, shot=0.0, blur_px=0.3))


def seen_places(world: World, number: int, z_mm: float) -> FloatArray:
    """(H, W, 3) in the head's frame: the wall of a clean pipe behind every pixel of a camera."""
    seen, pose = world.cameras[number], world.pose(z_mm)
    v, u = np.mgrid[: seen.camera.height, : seen.camera.width]
    turn = np.array(seen.rotation)
    rays = seen.camera.rays(np.stack([u.ravel(), v.ravel()], axis=1).astype(float)) @ turn
    centre = -np.array(seen.translation_mm) @ turn
    start = pose.to_pipe(centre[None])
    wall = intersect_cylinder(
        rays @ pose.rotation, np.zeros(3), np.array([0.0, 0.0, 1.0]), world.radius_mm, np.tile(start, (len(rays), 1))
    )
    return np.asarray(pose.to_camera(wall)).reshape(*u.shape, 3)


def test_a_camera_sees_the_phase_of_a_slide_over_a_ball() -> None:
    """Twin and measurement solve for the ray each in its own way, and agree."""
    world, z_mm = clean(lambda: ball_fringe_world().scaled(320)), 11.0
    light = light_of(world)
    plain = replace(world, projector=replace(light, modulation=0.0))
    bright, dc = (
        Renderer(one).render(world.pose(z_mm), z_mm, 1.0)[::2, 1::2].astype(float) - 2.0 for one in (world, plain)
    )
    phase = light.slides[0].slide.phase(seen_places(world, 0, z_mm))[::2, 1::2]
    inside = (cv2.erode((dc > 40).astype(np.uint8), np.ones((9, 9))) > 0) & np.isfinite(phase)
    swing = bright / np.maximum(dc, 1.0) * (1 + light.modulation) - 1
    observed = (swing * np.exp(-1j * phase))[inside].mean()
    assert inside.mean() > 0.2 and np.ptp(phase[inside]) > 50  # rad
    assert abs(np.angle(observed)) < 0.1
    assert np.corrcoef(swing[inside], np.cos(phase[inside]))[0, 1] > 0.9


@pytest.mark.deep(gate="tests/wings/fringe/test_worlds.py::test_a_scan_of_slides_in_turn_says_the_slot")
@MODELS
def test_every_camera_sees_the_phase_of_its_slide(make: Callable[[], World]) -> None:
    world, z_mm = clean(make), 11.0
    light = light_of(world)
    plain = replace(world, projector=replace(light, modulation=0.0))
    for number in range(0, len(world.cameras), 3):
        slot = next(k for k, one in enumerate(light.slides) if not one.cameras or number in one.cameras)
        grey, dc = (
            cv2.cvtColor(
                Renderer(one, number).render(world.pose(z_mm), z_mm, 1.0, slot=slot), cv2.COLOR_BayerRGGB2GRAY
            ).astype(float)
            - 2.0
            for one in (world, plain)
        )
        phase = light.slides[slot].slide.phase(seen_places(world, number, z_mm))
        lit = cv2.erode((dc > 25).astype(np.uint8), np.ones((9, 9))) > 0
        assert lit.mean() > 0.1
        swing = (grey / np.maximum(dc, 1.0) * (1 + light.modulation) - 1) / light.modulation
        inside = lit & np.isfinite(phase)
        observed = (swing * np.exp(-1j * phase))[inside].mean() * 2
        assert abs(np.angle(observed)) < 0.02  # rad; 0.003 measured, a sensor's mosaic included
        assert 0.8 < abs(observed) < 1.02
        assert np.corrcoef(swing[inside], np.cos(phase[inside]))[0, 1] > 0.98


def test_a_slot_lights_one_slide_and_no_neighbours() -> None:
    world = clean(modules_world)
    renderer = Renderer(world, 0)
    lit = [float(renderer.render(world.pose(0.0), 0.0, 1.0, slot=slot).mean()) for slot in range(4)]
    assert lit[0] > 20
    assert max(lit[1:]) < 0.25 * lit[0]


@MODELS
def test_a_file_says_the_head_as_it_is(make: Callable[[], World]) -> None:
    world = make()
    written = json.loads(json.dumps(world.calibration().to_dict()))
    head = FringeHead.from_dict(written)
    light = light_of(world)
    eyes = head.eyes()
    pairs = [(k, n) for k, one in enumerate(light.slides) for n in one.cameras or range(len(world.cameras))]
    assert len(eyes) == len(pairs)
    for (eye, camera, slots), (k, number) in zip(eyes, pairs, strict=True):
        slide, seen = light.slides[k].slide, world.cameras[number]
        assert camera == number and slots == light.slides[k].slots
        np.testing.assert_allclose(eye.projector.centre_mm, slide.centre_mm, atol=1e-9)
        np.testing.assert_allclose(eye.projector.rotation, slide.rotation, atol=1e-9)
        np.testing.assert_allclose(eye.camera.rotation, seen.rotation, atol=1e-9)
        np.testing.assert_allclose(eye.camera.translation_mm, seen.translation_mm, atol=1e-9)
    if head.projector is not None:
        again = head.with_projector(eyes[0][0].projector).projector
        assert again is not None
        np.testing.assert_allclose(again.centre_mm, head.projector.centre_mm, atol=1e-9)
    assert World.from_dict(json.loads(json.dumps(world.to_dict()))) == world


def test_a_scan_of_slides_in_turn_says_the_slot(tmp_path: Path) -> None:
    world = modules_world()
    write_scan(world.scaled(160), tmp_path / "scan", 10)
    frames = open_scan(tmp_path / "scan").frames
    lit = [(one.index % 5, one.slot, one.camera) for one in frames if one.label is Label.PROJECTOR]
    assert len(lit) == 16
    assert all(slot == place and camera // 2 == place for place, slot, camera in lit)
    assert sum(one.label is Label.LED for one in frames) == 16
