"""Promises of how a long pipe is cut: nothing is left out, nothing is too much to hold, and nobody's count decides."""

import math
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.wall.windows import CUT_MM, HALO_OF_RADIUS, WHOLE_ROWS_MAX, Reach, plan

RADIUS_MM = 76.2
FRAME = 3400


def reaches(steps: list[float], points: int = FRAME) -> list[Reach | None]:
    z, out = 0.0, []
    for step in steps:
        z += step
        out.append(Reach(points, z + 30.0, z + 190.0) if step >= 0 else None)
    return out


def test_a_scan_that_can_be_held_is_one_window_of_all_its_frames() -> None:
    cut = plan(reaches([2.5] * 200), RADIUS_MM)
    (window,) = cut.windows
    assert window.frames == tuple(range(200)) and math.isinf(window.first_mm) and math.isinf(window.last_mm)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.sampled_from([0.0, 0.5, 2.5, 2.5, 2.5, 10.0, 900.0, -1.0]), min_size=60, max_size=400),
    st.integers(100_000, 400_000),
)
def test_every_frame_is_in_the_windows_that_its_points_and_their_halo_lie_in(steps: list[float], most: int) -> None:
    seen = reaches(steps)
    cut = plan(seen, RADIUS_MM, most)
    assert cut.windows[0].first_mm == -math.inf and cut.windows[-1].last_mm == math.inf
    if len(cut.windows) == 1 and not cut.windows[0].thinned:
        return
    halo = HALO_OF_RADIUS * RADIUS_MM
    for before, after in pairwise(cut.windows):
        assert before.last_mm == after.first_mm and before.last_mm % CUT_MM == 0.0
        assert before.last_mm - before.first_mm >= halo
    for window in cut.windows:
        inside = [
            i
            for i, one in enumerate(seen)
            if one is not None and one.high_mm >= window.first_mm - halo and one.low_mm <= window.last_mm + halo
        ]
        assert len(window.frames) + window.thinned == len(inside) and set(window.frames) <= set(inside)
        assert len(window.frames) * FRAME <= 2 * most + FRAME
        if not window.thinned:
            assert list(window.frames) == inside


def test_a_pipe_of_any_length_has_rows_enough_and_a_map_that_can_be_held() -> None:
    """Two hundred metres: 270 million points, rows of half a millimetre to the end."""
    cut = plan(reaches([2.5] * 80_000), RADIUS_MM)
    assert cut.z_step_mm == 0.5 and len(cut.windows) > 100
    assert 200_000 / cut.whole_step_mm <= WHOLE_ROWS_MAX and cut.whole_step_mm % cut.z_step_mm == 0.0
    assert max(len(window.frames) for window in cut.windows) * FRAME <= 2_000_000
