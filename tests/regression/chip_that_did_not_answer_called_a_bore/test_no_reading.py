"""A capacitive chip that did not answer, or a loose wire, was called a sewer at 91 %; one that froze hid a true one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.ground import Bore, Ground, log, some_ground
from annulus_pipe.wings.crossbore.measure import BoreDetections, Log, NoReadingReason, Passage, detect, on_grid

SEWER = Bore(2000.0, 101.0)
GROUND = Ground(6000.0, soils=(6.0,), bores=(SEWER,))
Fault = Callable[[FloatArray, np.random.Generator], FloatArray]  # of readings in pF, one after the other

FAULTS: dict[str, tuple[Fault, NoReadingReason]] = {
    "loose by 0.05 pF": (lambda c, rng: c + rng.normal(0, 0.05, len(c)), NoReadingReason.LOOSE),
    "nothing": (lambda c, rng: 0 * c, NoReadingReason.RANGE),
    "full scale": (lambda c, rng: 0 * c + 999.9, NoReadingReason.RANGE),
    "frozen": (lambda c, rng: 0 * c + c[0], NoReadingReason.STUCK),
    "frozen low": (lambda c, rng: 0 * c + 4.62, NoReadingReason.STUCK),
    "a line drawn over a hole": (lambda c, rng: np.linspace(c[0], c[-1], len(c)), NoReadingReason.STUCK),
    "loose by 1 pF": (lambda c, rng: c + rng.normal(0, 1.0, len(c)), NoReadingReason.RANGE),
    "loose by 0.01 pF": (lambda c, rng: c + rng.normal(0, 0.01, len(c)), NoReadingReason.LOOSE),
    "every other one": (lambda c, rng: np.where(np.arange(len(c)) % 2, c, c - 0.2), NoReadingReason.LOOSE),
    "a contact of 0.05 pF": (lambda c, rng: c - 0.05, NoReadingReason.JUMP),
    "a contact of 1 pF": (lambda c, rng: c + 1.0, NoReadingReason.JUMP),
    "no number": (lambda c, rng: c * np.nan, NoReadingReason.NONE),
}


def spoiled(rows: Log, fault: Fault, from_mm: float, to_mm: float, sectors: tuple[int, ...] = (0, 1, 2)) -> Log:
    c, here = rows.c_pf.copy(), (rows.odometer_mm > from_mm) & (rows.odometer_mm < to_mm)
    for k in sectors:
        c[here, k] = fault(c[here, k], np.random.default_rng(k))
    return replace(rows, c_pf=c)


def judged(rows: Log) -> BoreDetections:
    return detect(on_grid(rows))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", [3, 4, 5])
@pytest.mark.parametrize("name", FAULTS)
def test_where_a_chip_failed_nothing_was_seen_and_which_sector_and_why_is_said(name: str, seed: int) -> None:
    fault, why = FAULTS[name]
    rows = log(GROUND, seed).rows()
    for sectors in ((0, 1, 2), (1,)):
        account = judged(spoiled(rows, fault, 4000.0, 4200.0, sectors))
        assert [round(one.odometer_mm, -2) for one in account.bores] == [2000]
        assert {k - 1 for gap in account.gaps for k in gap.sectors} == set(sectors)
        assert why in {gap.why for gap in account.gaps} or name == "loose by 1 pF"  # as many are within the range
        first, last = min(gap.from_mm for gap in account.gaps), max(gap.to_mm for gap in account.gaps)
        assert 3850 < first < 4020 and 4180 < last < 4350 and 100 < account.unseen_mm < 400
        assert not judged(spoiled(rows, fault, 1850.0, 2150.0, sectors)).bores, "a sewer that was not seen"


def test_four_faults_one_after_the_other_are_four_stretches_and_no_bore() -> None:
    rows = log(replace(GROUND, length_mm=9000.0, bores=()), 4).rows()
    for k, name in enumerate(("loose by 0.05 pF", "nothing", "frozen low", "a contact of 0.05 pF")):
        rows = spoiled(rows, FAULTS[name][0], 1500.0 + 1800 * k, 1700.0 + 1800 * k, (k % 3,))
    account = judged(rows)
    assert not account.bores and {gap.why for gap in account.gaps} == {
        NoReadingReason.LOOSE,
        NoReadingReason.RANGE,
        NoReadingReason.STUCK,
        NoReadingReason.JUMP,
    }
    assert "sector 2 from 3.2" in str(next(gap for gap in account.gaps if gap.why is NoReadingReason.RANGE))


def test_a_reference_that_fails_is_said_and_hides_nothing() -> None:
    rows = log(GROUND, 4).rows()
    reference = np.where(np.abs(rows.odometer_mm - 4000) < 150, 999.9, rows.reference_pf)
    account = judged(replace(rows, reference_pf=reference))
    assert [round(one.odometer_mm, -2) for one in account.bores] == [2000] and account.unseen_mm == 0
    assert [gap.sectors for gap in account.gaps] == [(0,)] and "reference" in str(account.gaps[0])


def test_a_log_in_coarse_steps_is_no_frozen_one() -> None:
    rows = log(GROUND, 4).rows()
    for digits in (3, 2):
        account = judged(replace(rows, c_pf=rows.c_pf.round(digits)))
        assert account.unseen_mm == 0 and [round(one.odometer_mm, -2) for one in account.bores] == [2000]


def test_a_sector_that_never_answers_is_one_clear_line_and_so_is_another_head() -> None:
    rows = log(GROUND, 4).rows()
    with pytest.raises(AnnulusError, match=r"sector 2 gives no readings .*: 0 pF in the middle, expected"):
        on_grid(spoiled(rows, FAULTS["nothing"][0], -1.0, 1e9, (1,)))
    with pytest.raises(AnnulusError, match=r"expected 3\.98 to 6\.08 pF of a head that reads 4\.575 pF in air"):
        on_grid(replace(rows, c_pf=rows.c_pf + 7.0))


def test_a_fault_on_the_way_from_sensors_is_said_as_one_in_a_log_is() -> None:
    """Live rows in which a chip failed were dropped without a word."""
    rows = spoiled(log(GROUND, 4).rows(), FAULTS["nothing"][0], 4000.0, 4200.0, (2,))
    passage = Passage()
    for t, z, c, reference in zip(rows.t_s, rows.odometer_mm, rows.c_pf, rows.reference_pf, strict=True):
        passage.place(t, z)
        passage.read(t, (*c, reference))
    (run,) = passage.runs()
    (gap,) = judged(run.log).gaps
    assert gap.sectors == (3,) and gap.why is NoReadingReason.RANGE


def failed(rows: Log) -> BoolArray:
    grid = on_grid(rows)
    return np.array([gap.why is not NoReadingReason.NONE for gap in grid.gaps], bool)


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seeds", [range(7000, 7003), range(7003, 7200)], ids=["three", "two hundred"])
def test_in_a_sound_log_every_reading_is_one(seeds: range) -> None:
    """Soils, sewers, couplings, beads, hollows, slips and lost rows are no faults: 1 in 200 logs at most says one."""
    soils = ((15.0, 4.0, 22.0), (20.0,), (4.0,), (9.0, 25.0), (25.0, 6.0, 12.0))
    said = sum(
        failed(log(some_ground(10_000.0, seed, soils[seed % 5], 2, 1, seed % 2 == 0, seed % 2 == 0), seed).rows()).any()
        for seed in seeds
    )
    assert said <= len(seeds) / 200
