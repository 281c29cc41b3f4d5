"""Where a wet or dirty wall lost light all about, all holes that touched were one place, "not seen, from 80 to 320 mm,
from 5:00 to 10:00", a third of which was dark. Fails where `_compact` gives back what it is given."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from annulus_pipe.wall.indications import Limits, Scale
from annulus_pipe.wall.unjudged import OF_HOLES, Unjudged, in_one
from annulus_pipe.wall.unseen import FILLED, ONE_LOOK_OF_RADIUS, STEP, _compact, find_holes

CELL_MM, RADIUS_MM = (2.0, 1.33), 76.2
SHAPE = 150, 360  # 300 mm of a 6-inch pipe


def scale() -> Scale:
    return Scale(CELL_MM, RADIUS_MM, Limits())


def whole_parts(hole: np.ndarray) -> list[np.ndarray]:
    parts = []
    for rows, cells in _compact(hole, scale()):
        parts.append(np.zeros_like(hole))
        parts[-1][rows] = cells
    return parts


def extent(part: np.ndarray) -> tuple[int, int]:
    """Rows and columns of the box about it, however it lies about the seam."""
    columns = np.flatnonzero(part.any(axis=0))
    gaps = np.diff(np.append(columns, columns[0] + part.shape[1]))
    rows = np.flatnonzero(part.any(axis=1))
    return int(rows[-1] - rows[0] + 1), int(part.shape[1] - gaps.max() + 1)


def web(seed: int) -> np.ndarray:
    """Stripes both ways, a third of the wall, over the seam."""
    rng = np.random.default_rng(seed)
    out = np.zeros(SHAPE, bool)
    out[np.sort(rng.choice(SHAPE[0], 25, replace=False)), 60:340] = True
    out[:, np.sort(rng.choice(280, 50, replace=False)) + 60] = True
    return np.roll(out, 200, axis=1)


@pytest.mark.parametrize("seed", range(5))
def test_each_place_is_mostly_dark_or_small(seed: int) -> None:
    hole = web(seed)
    parts = whole_parts(hole)
    assert (np.sum(parts, axis=0) == hole).all(), "all of it, and nothing twice"
    look = [most * RADIUS_MM / size for most, size in zip(ONE_LOOK_OF_RADIUS, CELL_MM, strict=True)]
    for part in parts:
        rows, columns = extent(part)
        assert part.sum() >= FILLED * rows * columns or (rows <= look[0] and columns <= look[1])
    # each at least half as long both ways as one look, but for what is left over at the sides
    assert len(parts) <= 4 * np.ceil(SHAPE[0] / look[0]) * np.ceil(SHAPE[1] / look[1])


def test_a_hole_that_fills_its_box_is_one_place() -> None:
    hole = np.zeros(SHAPE, bool)
    hole[10:140, 340:] = hole[10:140, :60] = True
    hole[30:60, 20:40] = False
    (part,) = whole_parts(hole)
    assert (part == hole).all()


def test_windows_join_what_goes_on_over_a_cut_and_nothing_else() -> None:
    def place(first: float, last: float, clock: float, arc: float) -> Unjudged:
        return Unjudged(OF_HOLES, "not seen", first, last, clock, arc)

    before = [place(0.0, 40.0, 90.0, 40.0), place(41.0, 80.0, 90.0, 40.0), place(60.0, 100.0, 200.0, 40.0)]
    after = [place(100.5, 130.0, 215.0, 60.0), place(100.5, 130.0, 350.0, 40.0), place(131.0, 150.0, 215.0, 60.0)]
    joined = in_one([before, after], 2.0)
    assert [(one.z_from_mm, one.z_to_mm) for one in joined] == [(0, 40), (41, 80), (60, 130), (100.5, 130), (131, 150)]
    over = joined[2]
    assert (over.clock_deg - over.arc_deg / 2, over.clock_deg + over.arc_deg / 2) == (180.0, 245.0), "both of them"


def test_the_shadow_of_a_listed_bump_is_usual_in_all_its_pieces() -> None:
    unseen, known = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    for row in range(40, 100):  # pointed, as that of a dome is
        unseen[row, 100 : 160 - (row - 40) * 5 // 8] = True
    known[30:40, 100:160] = True
    z_mm = (np.arange(SHAPE[0]) + 0.5) * CELL_MM[0]
    wall = SimpleNamespace(
        z_mm=z_mm, z_step_mm=CELL_MM[0], clock_step_deg=1.0, extent=(0.0, 300.0, 0.0, 360.0), mean_radius_mm=RADIUS_MM
    )
    joints = np.zeros(SHAPE[0], bool)
    for beside in (known, np.zeros_like(known)):
        places = list(find_holes(cast(Any, wall), unseen, unseen, None, beside, joints, scale()))
        assert len(places) > 1 and {reason for _, _, reason, _ in places} == {STEP}
        assert {usual for *_, usual in places} == {bool(beside.any())}
