"""Frames that no pipe shows, and tables that hold anything: an answer or none, never memory that is not the loops' own.

tests/unit/numeric/test_sanitized.py runs this file with loops that stop at the first load or store outside of a table.
"""

import functools

import numpy as np
from hostile_frames import DIRECTIONS, KINDS, frame, heads, mosaic_of, spoilt
from hypothesis import given, settings
from hypothesis import strategies as st
from repeated import few
from small_work import hostile_calls

from annulus_pipe.numeric.mosaic import ORDERS
from annulus_pipe.rings.reconstructor import Reconstructor

seeds = st.integers(0, 2**32 - 1)


@functools.cache
def reconstructor(head: str) -> Reconstructor:
    return Reconstructor(heads()[head], DIRECTIONS)


@few
@given(st.sampled_from(list(heads())), st.sampled_from([*KINDS, "spoilt"]), seeds, st.sampled_from([None, *ORDERS]))
def test_a_hostile_frame_has_a_profile_or_none(head: str, kind: str, seed: int, order: str | None) -> None:
    camera, rings = heads()[head].camera, len(heads()[head].rings)
    image = spoilt(head, seed) if kind == "spoilt" else frame(kind, seed, camera.height, camera.width)
    profile = reconstructor(head).profile(image if order is None else mosaic_of(image, order), frame=0, z_mm=5.0)
    assert (profile.pose is None) == (len(profile.ring) == 0)
    assert np.isfinite(profile.points_mm).all()
    if profile.pose is not None:
        assert profile.ring.max() < rings and profile.direction.max() < DIRECTIONS
        assert (profile.sigma_mm > 0.0).all() and np.isfinite(profile.sigma_mm).all()
        assert np.isfinite(profile.pose.translation).all()


@settings(parent=few, max_examples=few.max_examples // 5)
@given(seeds, st.sampled_from([0.02, 0.5, 1.0]))
def test_whatever_tables_hold_no_other_memory_is_touched(seed: int, part: float) -> None:
    assert len({call.name for call in hostile_calls(seed, part)}) > 40  # doors


def test_every_sample_of_every_grid_lies_in_the_plane_that_it_is_read_from() -> None:
    for head in heads():
        grid = reconstructor(head)._grid
        height, width = grid.size
        assert grid.address.max() <= height * width  # where darkness begins, a row and two pixels of it
        assert (grid.part < 1024).all() and grid.rays.shape[1] >= 2
