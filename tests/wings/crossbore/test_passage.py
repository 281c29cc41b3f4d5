"""Sensors that speak each at their own time make the log that one of them would have written."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.wings.crossbore.ground import Bore, Drawn, Ground, log
from annulus_pipe.wings.crossbore.measure import BoreIndication, BoreKind, Passage, detect, likely, on_grid
from annulus_pipe.wings.crossbore.measure.grid import Log
from annulus_pipe.wings.crossbore.measure.odds import COUNTED, odds

GROUND = Ground(6000.0, bores=(Bore(3000.0, 101.0, 101.0, 20.0),))


def told(passage: Passage, drawn: Drawn, from_mm: float = -math.inf, to_mm: float = math.inf) -> None:
    """Sectors each 25 ms, the odometer each fifth of a second, the roll each 100 ms."""
    rows = drawn.rows()
    for i, t in enumerate(rows.t_s):
        if not from_mm <= rows.odometer_mm[i] <= to_mm:
            continue
        if i % 8 == 0:
            passage.place(t, rows.odometer_mm[i])
        if i % 4 == 0:
            passage.roll(t, rows.roll_deg[i] % 360)
        passage.read(t, (*rows.c_pf[i], rows.reference_pf[i]))


def test_what_three_sensors_say_finds_the_bore_where_the_log_does() -> None:
    drawn = log(GROUND, 4)
    passage = Passage(ahead_mm=40.0)
    told(passage, drawn)
    (run,) = passage.runs()
    (one,), (same,) = detect(on_grid(run.log)).bores, detect(on_grid(drawn.rows())).bores
    assert run.rolled[10:-10].all() and one.kind is same.kind is BoreKind.AIR
    assert one.odometer_mm - 40.0 == pytest.approx(same.odometer_mm, abs=8.0)
    assert one.phi_deg == pytest.approx(same.phi_deg, abs=8.0) and one.arc_deg < 360.0


def test_an_odometer_that_is_zeroed_begins_another_run() -> None:
    drawn = log(GROUND, 4)
    passage = Passage()
    told(passage, drawn)
    rows = drawn.rows()
    t0 = float(rows.t_s[-1]) + 1.0
    for i, t in enumerate(rows.t_s):
        passage.place(t0 + t, rows.odometer_mm[i])
        passage.read(t0 + t, (*rows.c_pf[i], rows.reference_pf[i]))
    first, second = passage.runs()
    assert first.rolled_at(3000.0) and not second.rolled_at(3000.0)  # nobody said how the head was turned
    for run in (first, second):
        assert [round(one.odometer_mm, -2) for one in detect(on_grid(run.log)).bores] == [3000]


def test_a_passage_that_keeps_some_metres_forgets_the_rest() -> None:
    drawn = log(Ground(20_000.0), 1)
    passage = Passage(keep_mm=4000.0)
    told(passage, drawn)
    (run,) = passage.runs()
    assert np.ptp(run.log.odometer_mm) <= 4000.0 and len(passage) < 0.3 * len(drawn.rows().t_s)


def test_a_head_whose_odometer_says_nothing_has_no_run() -> None:
    passage = Passage()
    for k in range(1000):
        passage.read(0.025 * k, (4.8, 4.8, 4.8, 4.7))
    assert passage.runs() == []
    passage.place(0.0, 0.0)
    passage.place(20.0, 2000.0)  # nothing is assumed of what lies between
    assert passage.runs() == []


def test_a_tank_that_stands_still_and_numbers_that_are_none_are_no_readings() -> None:
    drawn = log(GROUND, 4)
    passage, rows = Passage(), drawn.rows()
    for i, t in enumerate(rows.t_s):
        c = list(rows.c_pf[i])
        if i % 3 == 0:
            c[i % 2] = (math.nan, math.inf, -1.0, 1e300)[i % 4]
        passage.place(t, rows.odometer_mm[i])
        passage.place(t, math.inf)
        passage.roll(t, rows.roll_deg[i] if i < 2000 else math.nan)
        passage.read(t, (*c, rows.reference_pf[i]))
    (run,) = passage.runs()
    assert [round(one.odometer_mm, -2) for one in detect(on_grid(run.log)).bores] == [3000]
    assert run.rolled_at(100.0)
    dead = Passage()
    for i, t in enumerate(rows.t_s):
        dead.place(t, rows.odometer_mm[i])
        dead.read(t, (4.8, math.nan, 4.8, 4.7))
    assert dead.runs() == []


def test_where_the_roll_was_not_known_nothing_is_said_of_a_direction() -> None:
    drawn = log(GROUND, 4)
    passage, rows = Passage(), drawn.rows()
    for i, t in enumerate(rows.t_s):
        passage.place(t, rows.odometer_mm[i])
        if not 2000 < rows.odometer_mm[i] < 4000:
            passage.roll(t, rows.roll_deg[i])
        passage.read(t, (*rows.c_pf[i], rows.reference_pf[i]))
    (run,) = passage.runs()
    assert [run.rolled_at(z) for z in (1000.0, 3000.0, 5000.0)] == [True, False, True]


def test_a_joint_that_the_rings_saw_explains_what_is_alike_all_round() -> None:
    """In soil so dry that a coupling takes off as much as air would, by a head that was told of another pipe's."""
    ground = Ground(6000.0, soils=(4.0,), couplings_mm=(3000.0,))
    grid = on_grid(log(ground, 3).rows())
    from annulus_pipe.wings.crossbore.measure import CapacitiveHead

    strange = CapacitiveHead(coupling_ff=250.0)  # of another pipe
    assert [one.kind for one in detect(grid, strange).indications] != [BoreKind.COUPLING]
    assert [one.kind for one in detect(grid, strange, joints_mm=[3010.0]).indications] == [BoreKind.COUPLING]
    assert not detect(grid, strange, joints_mm=[3010.0]).bores
    sewer = on_grid(log(GROUND, 4).rows())
    assert detect(sewer, joints_mm=[3000.0]).bores  # a sewer on one side is no joint


@given(st.sampled_from(list(BoreKind)), st.floats(0.0, 1.2), st.booleans(), st.sampled_from([math.nan, -30.0]))
def test_odds_are_of_everything_and_never_certain(kind: BoreKind, part: float, side: bool, loss: float) -> None:
    found = odds(str(kind), part, side, loss)
    if kind in (BoreKind.UNKNOWN, BoreKind.VOID, BoreKind.BEAD):
        assert found == {}
        return
    assert sum(found.values()) == pytest.approx(1.0) and min(found.values()) > 0 and max(found.values()) < 1
    one = BoreIndication(0.0, kind, 100.0, math.nan, math.nan, np.zeros(3), odds=found)
    assert 0.0 < likely(one) < 1.0


def test_what_nobody_counted_has_no_probability() -> None:
    assert math.isnan(likely(BoreIndication(0.0, BoreKind.UNKNOWN, 100.0, math.nan, math.nan, np.zeros(3))))
    assert all(sum(twin) > 10 and sum(other) > 0 for twin, other in COUNTED.values())


def test_a_head_that_swings_between_the_walls_has_no_loose_wire_and_does_not_jump() -> None:
    """Its median differs from a reading at the ends of each swing only; and it swings from the moment it moves."""
    drawn = log(Ground(3000.0), 1)
    rows = np.arange(600)
    z = np.maximum(0.0, 3.0 * (rows - 100))
    phase = 2 * np.pi * np.maximum(rows - 100, 0)[:, None] / np.array([11.0, 13.0, 9.0])
    noise = np.random.default_rng(5).normal(0.0, 0.4, (600, 3))
    c_pf = drawn.rows().c_pf[:1] + (15.0 * np.sin(phase) + noise) / 1000
    for far in (290, 400, 600):
        part = Log(0.025 * rows[:far], z[:far], c_pf[:far], np.full(far, 4.7) + noise[:far, 0] / 1000, np.zeros(far))
        assert on_grid(part).gaps == ()
