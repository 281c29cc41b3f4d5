"""Promises of the wall that viewers see grow: a bad ring does not spoil it, its memory is bounded, who comes late or
misses words has all of it soon, and where nobody looked it says so.
"""

import gc
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.daemon.live_wall import COLUMNS, RECENT_ROWS, UNSEEN, WHOLE_ROWS, LiveGrid, LiveWall, medians
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.twin.worlds import clean_world
from annulus_pipe.wall.profile import Profile

RADIUS_MM, RINGS = 76.2, 5
AHEAD_MM = (420.0, 260.0, 190.0, 150.0, 120.0)  # of the rings, from the head
CALIBRATION = replace(clean_world().calibration(), pipe_radius_mm=RADIUS_MM)


def profile(z_mm: float, wrong_mm: dict[int, float] | None = None, seen_deg: float = 360.0, bump=None) -> Profile:
    """A frame's points, two a degree and ring, noise .02 mm; `wrong_mm` of a ring's radius, `bump(clock, z)` of all."""
    clock = np.tile(np.arange(0.25, seen_deg, 0.5), RINGS)
    ring = np.repeat(np.arange(RINGS), len(clock) // RINGS)
    z = z_mm + np.array(AHEAD_MM)[ring]
    radius = RADIUS_MM + np.random.default_rng(int(abs(z_mm) * 10)).normal(0, 0.02, len(clock))
    for one, wrong in (wrong_mm or {}).items():
        radius[ring == one] += wrong
    if bump is not None:
        radius += bump(clock, z)
    angle = np.radians(clock)
    points = np.stack([radius * np.sin(angle), -radius * np.cos(angle), z], axis=1).astype(np.float32)
    n = len(clock)
    colour, direction = np.zeros((n, 3), np.uint8), np.zeros(n, np.uint16)
    return Profile(int(z_mm), z_mm, Pose(0.0, 0.0, 0.0, 0.0), points, colour, ring.astype(np.uint8), direction, 0.02)


def told(wall: LiveWall, seconds: float, missed: float = 0.0, begin_s: float = 0.0) -> dict[str, dict[int, np.ndarray]]:
    """What a viewer has after so long who misses that part of all words: rows by grid, mm, NaN not seen."""
    rows: dict[str, dict[int, np.ndarray]] = {"recent": {}, "whole": {}}
    chance = np.random.default_rng(1)
    for now in np.arange(begin_s, begin_s + seconds, 0.02):
        for body, part in wall.say(float(now)):
            cells = np.frombuffer(part, "<i2").reshape(body["rows"], body["columns"]) / 100.0
            if chance.random() >= missed:
                rows[body["of"]] |= dict(enumerate(np.where(cells == UNSEEN / 100.0, np.nan, cells), body["first"]))
    return rows


def scanned(length_mm: float, step_mm: float = 2.0, **more) -> LiveWall:
    wall = LiveWall(CALIBRATION, 7)
    for z in np.arange(0.0, length_mm, step_mm):
        wall.add(profile(z, **more))
    return wall


def test_one_bad_ring_does_not_spoil_a_cell_however_long_it_looks() -> None:
    wall = scanned(900.0, wrong_mm={0: 9.0})
    for _ in range(100):  # the head stands, and looks at the same places
        wall.add(profile(900.0, wrong_mm={1: -9.0, 0: 9.0}))
    step, rows, deviation = wall.deviation_mm("recent")
    by_four = (rows + 0.5) * step < 890.0 + AHEAD_MM[-1]
    by_four &= (rows + 0.5) * step > AHEAD_MM[0] + 10.0
    assert np.count_nonzero(by_four) > 80
    assert np.nanmax(np.abs(deviation[by_four])) < 0.1


def test_where_nobody_looked_is_not_seen() -> None:
    step, rows, deviation = scanned(300.0, seen_deg=180.0).deviation_mm("whole")
    inside = ((rows + 0.5) * step > 430.0) & ((rows + 0.5) * step < 500.0)
    assert np.isfinite(deviation[inside, :180]).all()
    assert np.isnan(deviation[:, 180:]).all()
    assert rows[0] * step > AHEAD_MM[-1] - step


@pytest.mark.deep(
    gate="tests/unit/daemon/test_live_wall.py::test_who_misses_a_third_of_the_words_has_all_of_ten_metres_in_four_minutes"
)
def test_the_whole_has_a_scan_of_any_length_in_rows_that_grow() -> None:
    def bump(clock, z):
        return np.where((np.abs(clock - 90.0) < 20.0) & (z > 20_000.0) & (z < 21_000.0), -4.0, 0.0)

    wall = scanned(60_000.0, 40.0, bump=bump)
    step, rows, deviation = wall.deviation_mm("whole")
    assert step == 40.0 and len(rows) <= WHOLE_ROWS
    assert rows[0] * step <= AHEAD_MM[-1] and (rows[-1] + 1) * step >= 59_960.0 + AHEAD_MM[0]
    z = (rows + 0.5) * step
    assert np.allclose(deviation[(z > 20_100) & (z < 20_900), 80:100], -4.0, atol=0.1)
    assert np.nanmax(np.abs(deviation[(z < 19_900) | (z > 21_100)])) < 0.1
    step, rows, _ = wall.deviation_mm("recent")
    assert step == 5.0 and len(rows) <= RECENT_ROWS and (rows[-1] + 1) * step >= 59_960.0 + AHEAD_MM[0]


@pytest.mark.deep(gate="tests/unit/daemon/test_live_wall.py::test_what_changed_is_told_within_a_second_and_little_else")
def test_a_head_that_goes_back_below_zero_and_forth_again_is_told_where_it_is() -> None:
    wall = LiveWall(CALIBRATION, 7)
    for z in [*np.arange(0.0, -3000.0, -5.0), *np.arange(-3000.0, 500.0, 5.0)]:
        wall.add(profile(z))
    for of in ("recent", "whole"):
        step, rows, deviation = wall.deviation_mm(of)
        assert rows[0] * step < -2850.0 and (rows[-1] + 1) * step > 900.0
        assert np.nanmax(np.abs(deviation)) < 0.1


def test_a_point_far_away_or_deep_stretches_nothing() -> None:
    wall = LiveWall(CALIBRATION, 7)
    one = profile(0.0)
    one.points_mm[0, 2], one.points_mm[1, :2] = 1e9, 1e6
    wall.add(one)
    assert wall.deviation_mm("whole")[0] == 5.0


def test_who_comes_late_has_a_demo_scan_within_three_seconds() -> None:
    wall = scanned(1300.0)
    told(wall, 60.0)
    wall.say_again()
    rows = told(wall, 3.0, begin_s=60.0)
    for of in ("recent", "whole"):
        _, there, deviation = wall.deviation_mm(of)
        assert sorted(rows[of]) == list(there)
        assert np.allclose(np.stack([rows[of][row] for row in there]), deviation, equal_nan=True)


def test_who_misses_a_third_of_the_words_has_all_of_ten_metres_in_four_minutes() -> None:
    wall = scanned(9_000.0, 20.0)
    rows = told(wall, 240.0, missed=1 / 3)
    assert all(set(wall.deviation_mm(of)[1]) <= set(rows[of]) for of in rows)


def test_what_changed_is_told_within_a_second_and_little_else() -> None:
    wall = scanned(1300.0)
    told(wall, 60.0)
    wall.add(profile(1500.0))
    said = [body for now in np.arange(60.0, 61.0, 0.02) for body, _ in wall.say(float(now), in_turn=False)]
    there = {row for body in said for row in range(body["first"], body["first"] + body["rows"])}
    assert {int((1500.0 + ahead) // 5.0) for ahead in AHEAD_MM} <= there
    assert len(said) <= 12 and all(body["scan"] == 7 for body in said)


def test_another_scan_begins_with_nothing_seen() -> None:
    wall = scanned(300.0)
    wall.begin(8)
    assert not len(wall.deviation_mm("whole")[1]) and not any(told(wall, 2.0).values())


@pytest.mark.deep(gate="tests/unit/daemon/test_live_wall.py::test_what_changed_is_told_within_a_second_and_little_else")
def test_memory_is_flat_from_the_first_scan_on_whatever_the_length() -> None:
    """Ten hours at 100 mm/s are 3.6 km; as few frames of them as need every row."""

    def go(wall: LiveWall, places: Iterator[float]) -> int:
        for k, z in enumerate(places):
            wall.add(profile(float(z)))
            list(wall.say(k * 0.04))
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    wall = LiveWall(CALIBRATION, 7)
    tracemalloc.start()
    try:
        before = go(wall, iter(np.arange(0.0, 60_000.0, 200.0)))
        after = go(wall, iter(np.arange(60_000.0, 3_600_000.0, 5_000.0)))
    finally:
        tracemalloc.stop()
    assert after - before < 100_000  # bytes; one frame's points have 50 000
    assert wall.deviation_mm("whole")[0] == 2560.0


def test_the_median_of_what_was_seen() -> None:
    votes = np.array([[1, 2, 900], [UNSEEN, 2, 5], [UNSEEN, UNSEEN, 7], [UNSEEN] * 3], np.int16)
    assert list(medians(votes)) == [2, 3, 7, UNSEEN]


def test_a_grid_holds_what_it_is_made_for() -> None:
    grid = LiveGrid("recent", 5.0, 10, 5)
    one = np.array([0]), np.array([0])
    for row in range(30):
        grid.add(np.array([5.0 * row + 1.0]), *one, np.array([float(row)]))
    assert list(grid.known()) == list(range(20, 30))
    assert list(grid.cells(np.arange(18, 22))[:, 0]) == [UNSEEN, UNSEEN, 20, 21]
    assert grid.cells(np.arange(20, 30)).shape == (10, COLUMNS)
