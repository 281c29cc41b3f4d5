"""A drawn wall that light enters: its rings land where the model says."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.translucency import edge_shift_mm, incidence_rad, slit_shift_mm
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.record.codec import to_bgr
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World, clean_world, mirror_world, stereo_world, translucent
from annulus_pipe.twin.worlds.fittings import FITTINGS
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.heads import series_world

R = 76.2
# px, sigma: the twin's lens and pixel (0.85), what demosaicing and the smoothing of lines add
BLUR_PX = 1.7
OPAQUE = clean_world().scaled(832)
WORLD = translucent(OPAQUE)


@cache
def _image(world: World) -> FloatArray:
    return to_bgr(Renderer(world).render(world.pose(40.0), 40.0, 1.0), "bayer_rggb8")


def _radii(world: World, known: Calibration) -> FloatArray:
    """(K,) mm, the median of each ring."""
    profile = Reconstructor(known).profile(_image(world), frame=0, z_mm=40.0)
    radius = np.hypot(*profile.points_mm[:, :2].T)
    return np.array([np.median(radius[profile.ring == k]) for k in range(5)])


def test_rings_move_by_the_models_numbers() -> None:
    """A ring m farther along is read R m / d wider, of a projector d behind the camera."""
    known = WORLD.calibration()
    behind = -np.array([cone.vertex_mm[2] for cone in known.rings])
    moved = (_radii(WORLD, known) - _radii(OPAQUE, known)) * behind / R
    assert WORLD.translucency is not None
    expected = []
    for k, cone in enumerate(known.rings):
        ahead = R / np.tan(cone.half_angle) + cone.vertex_mm[2]
        blur = BLUR_PX * ahead**2 / (known.camera.fx * R)
        edge = edge_shift_mm(WORLD.translucency, incidence_rad(cone.half_angle), blur)
        expected.append(slit_shift_mm(edge, known.colours[k : k + 2])[0])
    assert moved == pytest.approx(expected, abs=0.02)


def test_a_world_says_what_its_wall_does() -> None:
    assert World.from_dict(WORLD.to_dict()) == WORLD
    assert WORLD.truth()["translucency"]["surface_share"] == 0.25 and "translucency" not in OPAQUE.truth()
    assert "wall" not in WORLD.calibration().to_dict()  # measured in an opaque one


@pytest.mark.parametrize("world", [series_world(1), FITTINGS["bend"](1)])
def test_what_is_not_drawn_is_refused(world: World) -> None:
    with pytest.raises(AnnulusError, match="a wall that light enters is drawn for slits, in a pipe of one piece"):
        translucent(world)


@pytest.mark.parametrize("world", [mirror_world(1), stereo_world(1)])
def test_other_heads_are_drawn_before_it_too(world: World) -> None:
    world = replace(world.scaled(416), texture=False)
    both = (world, translucent(world))
    before, after = (Renderer(one).render(one.pose(10.0), 10.0, 1.0).astype(float) for one in both)
    assert 0.2 < np.abs(before - after).mean() < 20 and abs(before.mean() - after.mean()) < 0.5
