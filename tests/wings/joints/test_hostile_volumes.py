"""Whatever a volume's voxels, rays and surfaces hold, its loops stay within it and say NaN where there is nothing."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as drawn

from annulus_pipe.wings.joints.measure.density import wall_samples
from annulus_pipe.wings.joints.measure.surface import edges
from annulus_pipe.wings.joints.measure.unwrap import sampled

SIZES = st.integers(0, 4)
EDGE_MM = st.sampled_from([0.0, -1e-7, 1e-7, 1.0, 3.0, 1e300, -np.inf, np.nan])  # of a volume of 4 voxels at most


@given(st.data(), st.tuples(SIZES, SIZES, SIZES), st.booleans())
def test_no_ray_reads_beside_its_slab(data: st.DataObject, shape: tuple[int, int, int], to_edge: bool) -> None:
    slab = data.draw(drawn.arrays(np.float32, shape, elements=st.floats(0, 1, width=32)))
    z, rho = data.draw(drawn.arrays(float, 3, elements=EDGE_MM)), data.draw(drawn.arrays(float, 4, elements=EDGE_MM))
    way = data.draw(drawn.arrays(float, (2, 3)))
    first = data.draw(st.sampled_from([0, 2, -(2**63), 2**63 - 1]))
    origin, along = data.draw(drawn.arrays(float, 3, elements=EDGE_MM)), np.array([0.0, 0.0, 1.0])
    grey = sampled(slab, first, (1.0, 0.5, 0.0), origin, along, z, (way[::-1].copy(), way), rho, to_edge)
    seen = grey[np.isfinite(grey)]
    assert ((seen >= 0) & (seen <= 1)).all()
    assert min(shape) > 1 or not len(seen)


@given(st.data(), SIZES, SIZES, SIZES)
def test_no_surface_or_wall_is_sought_beside_its_ray(
    data: st.DataObject, planes: int, angles: int, places: int
) -> None:
    block = data.draw(drawn.arrays(np.float32, (planes, angles, places)))
    rho = data.draw(drawn.arrays(float, places))
    outer, inner = edges(block, rho, data.draw(st.floats()))
    assert outer.shape == inner.shape == (planes, angles)
    wild = data.draw(drawn.arrays(float, (2, planes, angles)))
    for low, high in ((inner, outer), wild):
        wall = wall_samples(block, rho, low, high, 3)
        assert places > 1 or np.isnan(wall).all()
