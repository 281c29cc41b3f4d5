"""Where the odometer slips in a pipe, by the wall's texture: in mm, and not said of a right one."""

from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World
from annulus_pipe.wings.fringe.heads import series_world
from annulus_pipe.wings.fringe.light import Fringes
from annulus_pipe.wings.fringe.measure import Eye, Shots, measure_pipe

pytestmark = pytest.mark.deep(gate="tests/wings/fringe/test_steps.py::test_a_slip_is_said_where_it_was")

Z = np.arange(20) * 1.9


def seen(world: World) -> tuple[list[Eye], Shots]:
    light = world.projector
    assert isinstance(light, Fringes)
    renderer = Renderer(world)
    images = [renderer.render(world.pose(z), z, 1.0, seed=k).astype(np.float32) - 2.0 for k, z in enumerate(Z)]
    grey: list[Float32Array] = [
        (one[0::2, 0::2] / 0.95 + one[0::2, 1::2] + one[1::2, 0::2] + one[1::2, 1::2] / 0.9) / 4 for one in images
    ]
    whole = world.camera
    camera = replace(
        whole,
        width=whole.width // 2,
        height=whole.height // 2,
        fx=whole.fx / 2,
        fy=whole.fy / 2,
        cx=(whole.cx + 0.5) / 2 - 0.5,
        cy=(whole.cy + 0.5) / 2 - 0.5,
    )
    return [Eye(HeadCamera(0, camera), light.slides[0].slide)], Shots.single(np.array(grey))


@pytest.mark.parametrize(
    ("slip", "first"), [(0.0, 20), (0.6, 12), (-0.5, 15)], ids=["right", "0.6 mm on", "0.5 mm back"]
)
def test_a_slip_is_found_and_said(slip: float, first: int) -> None:
    eyes, shots = seen(series_world(travel_mm=40.0))
    off: FloatArray = np.where(np.arange(20) >= first, slip, 0.0)
    found = measure_pipe(eyes, shots, Z - off, 101.6, cell_mm=1.0)
    assert list(np.flatnonzero(found.slipped)) == list(range(first, 20))
    np.testing.assert_allclose(found.head.poses[:, 5], Z, atol=0.2)  # 0.1 measured
