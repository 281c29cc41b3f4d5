"""Profiles survive the wire, and nothing else does."""

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.profile import Profile


def profile(n=5, pose=Pose(0.1, 0.2, 3.0, 4.0)):  # noqa: B008 (frozen)
    rng = np.random.default_rng(n)
    return Profile(
        7,
        12.5,
        pose,
        rng.normal(size=(n, 3)).astype(np.float32),
        rng.integers(0, 255, (n, 3)).astype(np.uint8),
        rng.integers(0, 5, n).astype(np.uint8),
        rng.integers(0, 720, n).astype(np.uint16),
        0.04,
        {"width": 3},
        {"slits": 2.5},
        rng.uniform(0.01, 1, n).astype(np.float32),
        ring_sigma_mm=rng.uniform(0.01, 1, (5, 2)).astype(np.float32),
        slit_rad=rng.uniform(0, 0.01, 5).astype(np.float32),
    )


@pytest.mark.parametrize("original", [profile(), profile(0), profile(0, None)], ids=["points", "none", "no pose"])
def test_a_profile_comes_back_as_it_was(original):
    back = Profile.from_dict(msgpack.unpackb(msgpack.packb(original.to_dict())))
    assert (back.frame, back.z_mm, back.pose) == (original.frame, original.z_mm, original.pose)
    assert back.rejected == original.rejected and back.timing_ms == original.timing_ms
    for name in ("points_mm", "colour", "ring", "direction", "sigma_mm", "ring_sigma_mm", "slit_rad"):
        a, b = getattr(original, name), getattr(back, name)
        assert a.dtype == b.dtype and a.shape == b.shape and (a == b).all()


def test_a_profile_of_old_has_sigmas_nobody_knows():
    data = profile().to_dict()
    del data["sigma"]
    assert np.isnan(Profile.from_dict(data).sigma_mm).all() and len(Profile.from_dict(data).sigma_mm) == 5
    with pytest.raises(ValueError, match="sigma"):
        Profile.from_dict(profile().to_dict() | {"sigma": np.full(5, -1, "<f4").tobytes()})
    del data["ring_sigma"]
    assert Profile.from_dict(data).ring_sigma_mm.shape == (0, 2)
    with pytest.raises(ValueError, match="ring_sigma"):
        Profile.from_dict(profile().to_dict() | {"ring_sigma": np.full(4, np.nan, "<f4").tobytes()})
    del data["slit"]
    assert Profile.from_dict(data).slit_rad.shape == (0,)
    with pytest.raises(ValueError, match="slit"):
        Profile.from_dict(profile().to_dict() | {"slit": np.full(5, -1, "<f4").tobytes()})


ANYTHING = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.binary(max_size=40),
    st.text(max_size=8),
    st.lists(st.floats(), max_size=5),
    st.dictionaries(st.text(max_size=4), st.floats(), max_size=3),
)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.sampled_from(sorted(profile().to_dict())), ANYTHING)
def test_a_strangers_bytes_give_a_profile_or_a_value_error(key, value):
    data = profile().to_dict() | {key: value}
    try:
        back = Profile.from_dict(data)
    except ValueError:
        return
    assert len(back.points_mm) == len(back.ring) == len(back.direction) == len(back.colour) == len(back.sigma_mm)
    assert np.isfinite(back.points_mm).all() and (back.pose is not None or not len(back.ring))
