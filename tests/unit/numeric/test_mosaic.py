"""A mosaic's colours, made late or of some cells only, are those that making them all at once would give."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.numeric.mosaic import ORDERS, Mosaic, bgr_of, thinned

WORTH = {"r": 200, "g": 120, "b": 40}


@pytest.mark.parametrize("order", ORDERS)
def test_an_order_names_the_colours_of_the_first_two_rows(order: str) -> None:
    cells = np.tile(np.array([WORTH[one] for one in order], np.uint8).reshape(2, 2), (8, 8))
    assert (Mosaic(cells, order).bgr()[2:-2, 2:-2] == (WORTH["b"], WORTH["g"], WORTH["r"])).all()


@given(
    order=st.sampled_from(ORDERS),
    size=st.tuples(st.integers(3, 40), st.integers(3, 40)),
    every=st.sampled_from([4, 8]),
    seed=st.integers(0, 99),
)
def test_colours_of_some_cells_are_those_of_all(order: str, size: tuple[int, int], every: int, seed: int) -> None:
    mosaic = Mosaic(np.random.default_rng(seed).integers(0, 256, size, dtype=np.uint8), order)
    some, whole = thinned(mosaic, every), thinned(mosaic.bgr(), every)
    assert some.dtype == np.uint8 and some.flags.c_contiguous and np.array_equal(some, whole)


def test_what_has_colours_is_passed_on_as_it_is() -> None:
    image = np.zeros((4, 6, 3), np.uint8)
    assert bgr_of(image) is image and Mosaic(image[..., 0], "rggb").shape == image.shape
