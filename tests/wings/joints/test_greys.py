"""A joint is the same in every scale of grey: any gain, offset and sign, and whatever fills what is no picture."""

import functools

import joint_scene
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from joint_scene import Scene

from annulus_pipe.numeric.arrays import Float32Array
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure import ArrayVolume, JointImage, features, image
from annulus_pipe.wings.joints.measure.greys import densities

AIR_HU, PLASTIC_HU = -1000.0, -122.0
VOXEL = (0.5, 0.45, 0.45)
SCENE = Scene(centre=(22.4, 21.8), shape=(64, 100, 100))


@functools.cache
def density() -> Float32Array:
    """A volume with air at 0 and plastic at 1, about."""
    return (joint_scene.volume(SCENE, 11, VOXEL) - joint_scene.AIR) / (joint_scene.PLASTIC - joint_scene.AIR)


def outside_disc(part: float) -> np.ndarray:
    """(Y, X) what lies outside a disc of so large a part of the slice's half side."""
    rows, columns = density().shape[1:]
    y, x = np.mgrid[:rows, :columns]
    return np.asarray(np.hypot(y - 0.5 * (rows - 1), x - 0.5 * (columns - 1)) > 0.5 * part * min(rows, columns))


@functools.cache
def measured(a: float, b: float, constant: float | None = None, whole: bool = False) -> JointImage:
    grey = (a * density().astype(float) + b).astype(np.float32)
    if constant is not None:
        grey[:, outside_disc(0.96)] = constant
    return image(ArrayVolume(np.round(grey).astype(np.int16) if whole else grey, VOXEL))


def off(one: JointImage, other: JointImage, name: str) -> float:
    """By how much a feature differs, rms over the angles, mm or a part; both know it at the same angles."""
    a, b = (np.asarray(features(joint)[name], float) for joint in (one, other))
    assert np.array_equal(np.isfinite(a), np.isfinite(b)), name
    return float(np.sqrt(np.nanmean((a - b) ** 2)))


def same(one: JointImage, other: JointImage, within: float) -> None:
    for name in ("W", "T", "crest", "wo", "ho", "wi", "hi", "haz", "ro", "ri"):
        assert off(one, other, name) < within, name
    verdicts = (
        [(flaw.kind, round(flaw.phi_deg), round(flaw.rho, 1)) for flaw in joint.flaws] for joint in (one, other)
    )
    assert next(verdicts) == next(verdicts)


def test_a_joint_in_hounsfield_units_with_a_disc_of_noughts_is_the_same_joint() -> None:
    """0 HU outside the disc is denser than the plastic, and stored in whole numbers; W has a sigma of 0.46 mm here."""
    same(measured(1.0, 0.0, 0.0), measured(PLASTIC_HU - AIR_HU, AIR_HU, 0.0, whole=True), 0.12)


@pytest.mark.deep(
    gate="tests/wings/joints/test_greys.py::test_a_joint_in_hounsfield_units_with_a_disc_of_noughts_is_the_same_joint"
)
@pytest.mark.parametrize(
    ("a", "b", "constant"),
    [
        (3.1e4, 2.0e4, None),  # 16 bits
        (1.7e-5, -4e-3, None),  # attenuation per um, below nought
        (-300.0, 90.0, None),  # a negative
        (-878.0, -122.0, 3000.0),
        (878.0, -1000.0, -3024.0),  # what some scanners pad with
        (878.0, -1000.0, -1000.0),
    ],
)
def test_a_joint_is_the_same_in_any_grey(a: float, b: float, constant: float | None) -> None:
    same(measured(1.0, 0.0, None if constant is None else 0.0), measured(a, b, constant), 0.002)


@settings(max_examples=60, deadline=None)
@given(
    a=st.floats(1e-6, 1e6),
    negative=st.booleans(),
    b=st.floats(-1e3, 1e3),  # of the contrast: beyond that single precision has fewer steps than the noise
    constant=st.none() | st.floats(-10, 10, width=32),
    disc=st.floats(0.9, 1.0),
)
def test_any_scale_gives_the_same_density(
    a: float, negative: bool, b: float, constant: float | None, disc: float
) -> None:
    thin = density()[::5, ::2, ::2]
    scale = -a if negative else a
    grey = (scale * (thin.astype(float) + b)).astype(np.float32)
    outside = outside_disc(disc)[::2, ::2]
    if constant is not None:
        grey[:, outside] = scale * (constant + b)
    found = densities(ArrayVolume(grey, VOXEL)).slices(0, len(thin))
    plain = densities(ArrayVolume(thin, VOXEL)).slices(0, len(thin))
    if constant is not None:
        assert not found[:, outside].any()
        found, plain = found[:, ~outside], plain[:, ~outside]
    # Fewer voxels say what air and plastic are; single precision has 1e-7 of the offset.
    assert np.abs(found - plain).max() < 0.02 + 1e-6 * abs(b)


def test_noughts_within_the_plastic_are_measurements() -> None:
    grey = np.round(878 * density() - 1000).astype(np.int16)
    grey[:, outside_disc(0.96)] = 0
    inside = (density() > 0.8) & ~outside_disc(0.96)
    grey[20, inside[20]] = 0
    found = densities(ArrayVolume(grey, VOXEL)).slices(20, 21)[0]
    assert found[inside[20]].min() > 1.1 and not found[outside_disc(0.96)].any()


def test_air_cut_off_at_the_scales_end_is_air() -> None:
    grey: np.ndarray = np.clip(np.round(200 * density() + 0.0), 0, 255).astype(np.uint8)
    grey[grey < 40] = 0
    same_as = densities(ArrayVolume(grey, VOXEL))
    assert same_as.air == pytest.approx(0, abs=1) and same_as.plastic == pytest.approx(198, abs=6)


@pytest.mark.parametrize(("value", "why"), [(np.nan, "finite greys"), (7.0, "one grey")])
def test_a_volume_without_two_greys_is_one_line(value: float, why: str) -> None:
    with pytest.raises(AnnulusError, match=why):
        image(ArrayVolume(np.full((20, 40, 40), value, np.float32), VOXEL))
