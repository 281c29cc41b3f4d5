"""Heights of a water's surface, in C against tests/reference/wall_refraction.py."""

import math

import numpy as np
import wall_refraction
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.wall.refraction import WATER, surface_heights

few = settings(max_examples=60, deadline=None, derandomize=True)
R = 76.2


@few
@given(
    depth=st.floats(0.5, 40.0),
    across=st.floats(-20.0, 20.0),
    ahead=st.floats(40.0, 200.0),
    eye=st.tuples(*[st.floats(-10.0, 10.0)] * 2),
    lamp=st.tuples(*[st.floats(-10.0, 10.0)] * 2),
)
def test_at_the_height_found_light_gets_there_as_its_ring_leaves_the_lamp(
    depth: float, across: float, ahead: float, eye: tuple[float, float], lamp: tuple[float, float]
) -> None:
    bottom = math.sqrt(R * R - across * across)
    point = np.array([across, bottom - 0.2 * depth, ahead])
    eyes, lamps = np.array([*eye, 0.0]), np.array([*lamp, -40.0])
    axis = np.array([0.02, -0.01, 1.0]) / np.linalg.norm([0.02, -0.01, 1.0])
    (height,) = surface_heights(point[None], eyes[None], lamps[None], axis[None], np.array([R]))
    way = (point - eyes) / np.linalg.norm(point - eyes)
    ring = float((point - lamps) @ axis / np.linalg.norm(point - lamps))

    def off(y: float) -> float:
        return wall_refraction.cosine(y, eyes, way, lamps, axis, R, WATER) - ring

    low, high = max(point[1] - 3.0 * (bottom - point[1]), max(eyes[1], lamps[1]) + 1e-3 * R), float(point[1])
    if not low < high or not off(low) * off(high) < 0.0:
        assert math.isnan(height)
        return
    assert low <= height <= high
    # a micrometre to either side light comes at too small and at too large an angle
    assert off(max(height - 1e-3, low)) * off(min(height + 1e-3, high)) <= 0.0


@few
@given(st.lists(st.tuples(*[st.floats()] * 4), max_size=19))
def test_rubbish_has_a_height_or_none(rows: list[tuple[float, ...]]) -> None:
    table = np.array(rows, float).reshape(-1, 4)
    turned = np.ascontiguousarray(table[:, [1, 2, 0]])
    out = surface_heights(table[:, :3], turned, turned[::-1], table[::-1, :3], table[:, 3])
    assert out.shape == (len(rows),)


def test_a_point_is_the_same_beside_any_others() -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-20, 20, 21), rng.uniform(60, 75, 21), rng.uniform(60, 180, 21)])
    eyes, lamps = np.zeros((21, 3)), np.tile([0.0, 0.0, -40.0], (21, 1))
    axes, radius = np.tile([0.0, 0.0, 1.0], (21, 1)), np.full(21, R)
    whole = surface_heights(points, eyes, lamps, axes, radius)
    assert np.isfinite(whole).sum() > 5
    each = [surface_heights(points[i : i + 1], eyes[:1], lamps[:1], axes[:1], radius[:1])[0] for i in range(21)]
    np.testing.assert_array_equal(whole, each)
