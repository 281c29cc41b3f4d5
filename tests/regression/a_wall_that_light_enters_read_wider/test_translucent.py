"""A calibration could not say that light goes on in a wall before it leaves: such pipes read 0.2 to 0.3 mm too wide in
radius, whatever was known of them."""

from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.record.codec import to_bgr
from annulus_pipe.rings.reconstructor import Reconstructor
from annulus_pipe.stereo.reconstructor import StereoReconstructor
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import clean_world, stereo_world, translucent
from annulus_pipe.wall.profile import Profile

R = 76.2
# mm: what edges of red, green, blue move by in the drawn wall, lens and smoothing in it (test_translucent_wall)
MOVED = (0.237, 0.194, 0.142)


def _off(profile: Profile, radius: float) -> float:
    return float(np.median(np.hypot(*profile.points_mm[:, :2].T))) - radius


@pytest.mark.parametrize(
    "red_mm", [0.56, pytest.param(0.3, marks=pytest.mark.deep), pytest.param(0.9, marks=pytest.mark.deep)]
)
def test_a_known_wall_is_read_as_wide_as_it_is(red_mm: float) -> None:
    world = translucent(clean_world(seed=3).scaled(832), red_mm)
    image = to_bgr(Renderer(world).render(world.pose(20.0), 20.0, 1.0), "bayer_rggb8")
    opaque = world.calibration()
    known = replace(opaque, translucency_mm=tuple(red_mm / 0.56 * moved for moved in MOVED))
    wider, right = (_off(Reconstructor(one).profile(image, frame=0, z_mm=20.0), R) for one in (opaque, known))
    assert 0.35 < wider / red_mm < 0.55
    assert abs(right) < 0.03


def test_two_cameras_and_the_rings_of_a_known_wall_agree() -> None:
    """Both cameras see where light leaves. Rings of an opaque wall stand against that: no point was kept."""
    world = translucent(replace(stereo_world(seed=3), texture=False).scaled(832))
    pose = world.pose(20.0)
    images = {n: to_bgr(Renderer(world, n).render(pose, 20.0, 1.0), "bayer_rggb8") for n in range(2)}
    known = replace(world.calibration(), translucency_mm=MOVED)
    profile = StereoReconstructor(known).profile(images, frame=0, z_mm=20.0)
    assert len(profile.points_mm) > 4500 and abs(_off(profile, world.radius_mm)) < 0.08
