"""A bead is measured by where light strikes it and where it comes down behind: true, unlike what the points show."""

from dataclasses import replace

import numpy as np
import pytest
from even_wall import RADIUS_MM, even_wall

from annulus_pipe.wall.beads import WallBead, measure_bead
from annulus_pipe.wall.points import WallPoints

AT_MM = 172.0
RATIOS = np.array([2.9, 2.6, 2.3, 2.0, 1.8])


def _stands(z: np.ndarray, height: float, width: float) -> np.ndarray:
    """Two half ellipses side by side."""
    arm = (np.abs(z - AT_MM) - width / 4) / (width / 4)
    return np.where(np.abs(z - AT_MM) < width / 2, height * np.sqrt(np.maximum(1.0 - arm * arm, 0.0)), 0.0)


def _measured(height: float, width: float, half_slit: float, rng: np.random.Generator) -> WallBead:
    return measure_bead(even_wall(), _points(height, width, half_slit, rng), _zone(width))


def _zone(width: float) -> tuple[float, float]:
    return AT_MM - width / 2 - 2, AT_MM + width / 2 + 12


def _points(height: float, width: float, half_slit: float, rng: np.random.Generator) -> WallPoints:
    """Slits of rings in frames 5 mm apart: the middle of what light falls on the wall, or on the bead, the brighter one
    of both, drawn to the nominal cone."""
    z, stands, ratio, sector, look = [], [], [], [], []
    looks = 0
    for q in RATIOS:
        for lands in np.arange(145.0, 215.0, 5.0) + rng.uniform(0, 5):
            across = np.linspace(-half_slit, half_slit, 41)
            path = np.linspace(0.0, 1.5 * height, 301)  # heights along each ray, from above
            at = lands + across[:, None] - q * path
            looks += 1
            blocked = _stands(at, height, width) > path
            top = np.where(blocked.any(axis=1), path[300 - np.argmax(blocked[:, ::-1], axis=1)], 0.0)
            for k in range(36):
                on_bead = top > 0
                mine = on_bead if 2.0 * on_bead.sum() > (~on_bead).sum() else ~on_bead
                stood = top[mine].mean() + rng.normal(0, 0.05)
                z += [lands - q * stood] * 2
                stands += [stood] * 2
                ratio += [q] * 2
                sector += [k] * 2
                look += [looks] * 2
    rows = [np.array(one, float) for one in (z, stands, ratio)]
    clock = np.array(sector) * 10.0 + 5.0
    return WallPoints(
        rows[0],
        np.array(sector),
        rows[1],
        np.full(len(clock), 0.05),
        rows[2],
        np.full(len(clock), half_slit),
        RADIUS_MM - rows[1],
        clock,
        np.array(look),
    )


@pytest.mark.deep(but=4)
@pytest.mark.parametrize(("height", "width"), [(2.5, 7.0), (3.5, 8.0), (3.5, 12.0), (4.8, 10.5)])
@pytest.mark.parametrize("half_slit", [1.0, 2.2])
def test_a_bead_is_as_high_and_as_wide_as_it_is(height: float, width: float, half_slit: float) -> None:
    bead = _measured(height, width, half_slit, np.random.default_rng(3))
    assert abs(bead.height_mm - height) < 0.5
    assert abs(bead.width_mm - width) < 2.0
    assert abs(bead.width_mm - width) < bead.width_k2_mm
    assert abs(bead.height_mm - height) < bead.height_k2_mm
    assert abs(bead.start_mm - (AT_MM - width / 2)) < 2.0


def test_a_wider_slit_knows_less() -> None:
    fine, coarse = (_measured(3.5, 8.0, half, np.random.default_rng(5)) for half in (1.0, 2.2))
    assert coarse.width_k2_mm > fine.width_k2_mm
    assert coarse.height_k2_mm > fine.height_k2_mm


def test_no_bead_is_narrower_than_it_is_high() -> None:
    ridge = _measured(5.0, 3.0, 1.0, np.random.default_rng(5))
    assert ridge.width_mm < ridge.height_mm and np.isnan(ridge.width_k2_mm)


def test_what_one_look_sees_of_a_bead_may_be_its_error() -> None:
    points = _points(3.5, 8.0, 1.0, np.random.default_rng(5))
    together, apart = (replace(points, look=look) for look in (points.look // 14, np.arange(len(points.look))))
    few, many = (measure_bead(even_wall(), one, _zone(8.0)).width_k2_mm for one in (together, apart))
    assert few > many
