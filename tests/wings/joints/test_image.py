"""What a joint's volume says of it, on a joint of our own: off centre, leaning, oval, drifting, not quite aligned."""

import math

import joint_scene
import numpy as np
import pytest
from joint_scene import VOXEL, Scene

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure import ArrayVolume, JointImage, features, image, summary
from annulus_pipe.wings.joints.measure.axis import VolumeAxis
from annulus_pipe.wings.joints.measure.unwrap import planes
from annulus_pipe.wings.joints.measure.zone import Shape, _model

SCENE = Scene()


@pytest.fixture(scope="module")
def joint() -> JointImage:
    return image(ArrayVolume(joint_scene.volume(SCENE), VOXEL))


def rms(off: FloatArray) -> float:
    assert np.isfinite(off).all()
    return float(np.sqrt(np.mean(off**2)))


@pytest.mark.deep(gate="tests/wings/joints/test_image.py::test_hilo_is_known_to_a_twentieth_of_a_millimetre")
def test_the_axis_leans_as_the_pipe_does_and_runs_between_two_that_do_not_meet(joint: JointImage) -> None:
    axis = joint.found.axis
    assert axis.lean_x == pytest.approx(SCENE.lean[0], abs=1e-3)
    assert axis.lean_y == pytest.approx(SCENE.lean[1], abs=1e-3)
    assert axis.x_mm + axis.lean_x * SCENE.plane == pytest.approx(SCENE.centre[0], abs=0.03)
    assert axis.y_mm + axis.lean_y * SCENE.plane == pytest.approx(SCENE.centre[1], abs=0.03)


def test_hilo_is_known_to_a_twentieth_of_a_millimetre(joint: JointImage) -> None:
    true = SCENE.hilo * np.cos(joint.phi)
    assert rms(joint.outer_sides.hilo_mm - true) < 0.03
    assert rms(joint.inner_sides.hilo_mm - true) < 0.03
    told = summary(joint)["hilo_mm"]
    assert told["axes_aside"] == pytest.approx(SCENE.hilo, abs=0.03)
    assert math.cos(math.radians(told["towards_deg"])) > 0.99


def test_radius_wall_and_beads(joint: JointImage) -> None:
    assert rms(joint.outer_sides.at_mm.mean(axis=0) - SCENE.outer_at(joint.phi)) < 0.02
    assert rms(joint.wall_mm - SCENE.wall) < 0.02
    for bead, part in ((joint.bead_out, 1.0), (joint.bead_in, 0.8)):
        assert rms(bead.height - part * SCENE.bead[1]) < 0.08
        assert abs(np.median(bead.width - SCENE.bead[0])) < 0.15
    thick = SCENE.wall + 1.8 * (1 - SCENE.notch) * SCENE.bead[1]
    assert rms(joint.thickness_mm - thick) < 0.1


def test_the_zone_is_as_wide_and_as_light_as_it_is_though_the_air_sinks_with_the_plastic(joint: JointImage) -> None:
    off = joint.zone.width - SCENE.width_at(joint.phi)
    assert rms(off) < 0.3
    assert abs(np.median(off)) < 0.1
    assert rms(joint.zone.drop - SCENE.drop) < 0.003
    assert (np.abs(off) < 3 * joint.zone.width_sigma).mean() > 0.9


def test_plain_wall_is_one_whatever_drifts(joint: JointImage) -> None:
    plain = joint.density[joint.plain]
    assert np.nanmean(plain) == pytest.approx(1.0, abs=5e-4)
    assert np.abs(np.nanmean(plain, axis=1) - 1).max() < 3e-3
    assert np.abs(np.nanmean(plain, axis=0) - 1).max() < 3e-3


def test_flaws_are_found_where_they_are_and_none_besides(joint: JointImage) -> None:
    assert sorted(flaw.kind for flaw in joint.flaws) == ["grain", "void"]
    for flaw in joint.flaws:
        angle, rho, z = SCENE.void if flaw.kind == "void" else SCENE.grain  # type: ignore[misc]
        assert flaw.phi_deg == pytest.approx(angle, abs=2.0)
        assert flaw.rho == pytest.approx(rho, abs=0.3)
        assert flaw.z - joint.fusion_mm.mean() == pytest.approx(z, abs=0.3)


def test_features_have_a_value_for_every_angle(joint: JointImage) -> None:
    named = features(joint)
    for name in ("W", "T", "crest", "wo", "ho", "wi", "hi", "haz", "zj"):
        assert named[name].shape == named["phi_deg"].shape
    assert named["ro"].shape == (2, len(joint.phi))


@pytest.mark.deep(gate="tests/wings/joints/test_image.py::test_hilo_is_known_to_a_twentieth_of_a_millimetre")
def test_sides_that_do_not_meet_take_nothing_from_the_thickness() -> None:
    scene = Scene(bead=(8.0, 2.2), hilo=0.4, plane=18.0, centre=(22.0, 22.0), shape=(110, 150, 150))
    found = image(ArrayVolume(joint_scene.volume(scene), VOXEL))
    off = found.thickness_mm - (scene.wall + 1.8 * (1 - scene.notch) * scene.bead[1])
    assert np.sqrt(np.mean(off**2)) < 0.1  # 0.06; before the step was taken out 0.13, 0.38 where it is 0.8 mm
    assert np.mean(np.abs(off) < 2 * found.thickness_sigma_mm) > 0.85


def test_a_volume_of_noise_has_no_pipe() -> None:
    noise = np.random.default_rng(3).normal(100, 5, (40, 64, 64)).astype(np.float32)
    with pytest.raises(AnnulusError, match="no plastic"):
        image(ArrayVolume(noise, (0.3, 0.3, 0.3)))


def test_a_rod_and_a_pipe_without_a_joint_are_refused() -> None:
    y, x = np.mgrid[:80, :80] * 0.3
    rho = np.hypot(x - 12, y - 12)
    rng = np.random.default_rng(4)
    for solid, why in ((rho < 9, "no cylinder"), ((rho < 9) & (rho > 6), "no joint")):
        grey = 100 + 900 * solid + rng.normal(0, 10, (40, 80, 80))
        with pytest.raises(AnnulusError, match=why):
            image(ArrayVolume(grey, (0.3, 0.3, 0.3)))


def test_planes_are_at_right_angles_to_the_axis() -> None:
    """A field that grows along the axis only is one value all over each plane, and the same in other slabs."""
    axis = VolumeAxis(6.0, 6.0, 0.05, -0.03)
    along = axis.frame()[2]
    z, y, x = np.meshgrid(*(np.arange(40) * 0.3,) * 3, indexing="ij")
    field = (x - 6.0) * along[0] + (y - 6.0) * along[1] + z * along[2]
    where = np.arange(2.0, 9.0, 0.3)
    phi = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    seen = np.concatenate(
        [b for _, b in planes(ArrayVolume(field, (0.3,) * 3), axis, where, phi, np.linspace(0, 5, 9))]
    )
    assert np.abs(seen - where[:, None, None]).max() < 1e-4


def test_the_zones_slopes_are_those_of_its_model() -> None:
    t = np.linspace(-8, 8, 40)
    p, shape = np.array([-2.5, 2.9, -1.0, 0.016, 0.001, 0.0001]), Shape(np.array([0.9, 0.95, 1.15]), 0.2, 0.0)
    value, slopes = _model(p, t, shape)
    for k in range(6):
        q = p.copy()
        q[k] += 1e-6
        assert (_model(q, t, shape)[0] - value) / 1e-6 == pytest.approx(slopes[:, k], abs=1e-6)
