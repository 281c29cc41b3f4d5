"""Which ring a slit is: the right one, or none."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.rings.decode import NONE, UNKNOWN, classify, decode, readings

PATTERNS = ("RRGBGR", "RRRGRBRGGGBB", "RGBRBGRRBBGG")
FIRST_PX, SPACING_PX, PIPE_MM = 200.0, 40.0, 76.2


def deviation(pixel: float, rings: int) -> np.ndarray:
    """Relative radius of a slit at `pixel` if it were each ring: 1 mm a pixel on the first ring, 0.3 on the last."""
    k = np.arange(rings)
    return (FIRST_PX + SPACING_PX * k - pixel) * np.linspace(1.0, 0.3, rings) / PIPE_MM


@st.composite
def lines(draw):
    """Slits (pixel, inside, outside, ring or NONE) of a few lines: some missing, some false inside a stripe."""
    pattern = draw(st.sampled_from(PATTERNS))
    rings = len(pattern) - 1
    out = []
    for direction in range(draw(st.integers(1, 3))):
        slits = []
        for k in range(rings):
            if draw(st.booleans()) or draw(st.booleans()):
                dent = draw(st.floats(-1.5, 1.5))
                slits.append((FIRST_PX + SPACING_PX * k + dent, pattern[k], pattern[k + 1], k))
        for _ in range(draw(st.integers(0, 4))):
            stripe = draw(st.integers(0, rings))
            pixel = FIRST_PX + SPACING_PX * (stripe - 1 + draw(st.floats(0.25, 0.75)))
            slits.append((pixel, pattern[stripe], pattern[stripe], NONE))
        out += [(direction, *slit) for slit in sorted(slits)]
    return pattern, out


def read(pattern, slits, tolerance=0.35):
    code = {"R": 0, "G": 1, "B": 2, "?": UNKNOWN}
    return decode(
        np.array([s[0] for s in slits], np.int64),
        np.array([code[s[2]] for s in slits], np.uint8),
        np.array([code[s[3]] for s in slits], np.uint8),
        np.array([deviation(s[1], len(pattern) - 1) for s in slits]).reshape(len(slits), len(pattern) - 1),
        pattern,
        tolerance,
    )


@settings(max_examples=150, deadline=None, derandomize=True)
@given(lines())
def test_missing_and_false_slits_never_give_a_wrong_ring(case):
    pattern, slits = case
    ring = read(pattern, slits)
    for i, (direction, _, inside, outside, true) in enumerate(slits):
        if true != NONE:
            assert ring[i] in (true, NONE)
        elif ring[i] != NONE:
            # A false slit can only pass where its own stripe pair has lost its slit: left to the outlier gate.
            assert pattern[ring[i]] == inside and pattern[ring[i] + 1] == outside
            assert not any(s[0] == direction and s[4] == ring[i] for s in slits)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.sampled_from(PATTERNS), st.lists(st.floats(-3, 3), min_size=11, max_size=11), st.data())
def test_every_slit_of_an_unbroken_line_is_named(pattern, dents, data):
    rings = len(pattern) - 1
    slits = [(0, FIRST_PX + SPACING_PX * k + dents[k], pattern[k], pattern[k + 1]) for k in range(rings)]
    assert list(read(pattern, slits)) == list(range(rings))
    lost = data.draw(st.integers(0, rings - 1))
    assert list(read(pattern, slits[:lost] + slits[lost + 1 :])) == [k for k in range(rings) if k != lost]


@settings(max_examples=60, deadline=None, derandomize=True)
@given(st.sampled_from(PATTERNS), st.sets(st.integers(0, 10), max_size=3))
def test_stripes_without_a_wall_are_read_by_colours_and_order(pattern, lost):
    """What is left of a line gets its own names or none, and an unbroken line all of them."""
    code = {"R": 0, "G": 1, "B": 2}
    true = [k for k in range(len(pattern) - 1) if k not in lost]
    inside, outside = (np.array([code[pattern[k + side]] for k in true], np.uint8) for side in (0, 1))
    ring = decode(np.zeros(len(true), np.int64), inside, outside, None, pattern, 0.35)
    assert all(found in (k, NONE) for found, k in zip(ring, true, strict=True))
    if not lost & set(range(len(pattern) - 1)):
        assert list(ring) == true


def test_two_slits_that_could_both_be_a_ring_are_neither():
    slits = [(0, 199.0, "R", "R"), (0, 201.0, "R", "R"), (0, 240.0, "R", "G")]
    assert list(read("RRGBGR", slits)) == [NONE, NONE, 1]


def test_an_unknown_colour_proves_nothing_and_contradicts_nothing():
    assert list(read("RRGBGR", [(0, 280.0, "?", "B")])) == [2]
    assert list(read("RRGBGR", [(0, 280.0, "?", "?")])) == [NONE]
    assert list(read("RRGBGR", [(0, 280.0, "R", "B")])) == [NONE]


def test_readings_are_what_decode_accepts():
    inside, outside = np.array([0, UNKNOWN, 1], np.uint8), np.array([0, 1, UNKNOWN], np.uint8)
    assert readings(inside, outside, "RRGBGR").tolist() == [
        [True, False, False, False, False],
        [False, True, False, True, False],
        [False, False, True, False, True],
    ]


def test_a_yellow_wall_does_not_turn_blue_into_green():
    rng = np.random.default_rng(5)
    stripes = np.array([[1.0, 12.0, 200.0], [6.0, 160.0, 14.0], [26.0, 18.0, 2.0]])  # BGR of R, G, B stripes
    name = rng.integers(0, 3, 3000)
    light = stripes[name] * rng.uniform(0.4, 1.0, (3000, 1)) + rng.normal(0, 0.5, (3000, 3))
    found = classify(light, "RGBRGB")
    assert (found[found != UNKNOWN] == name[found != UNKNOWN]).all()
    assert (found != UNKNOWN).mean() > 0.998


def test_no_slits_is_no_error():
    assert classify(np.zeros((0, 3)), "RGB").shape == (0,)
    assert read("RRGBGR", []).shape == (0,)
