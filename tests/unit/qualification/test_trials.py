"""Truths and reports matched one to one: by place, all at once, and refused where they are not of one pipe or unit."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.qualification.trials import (
    GATE_MM,
    Pull,
    Reported,
    SeenWall,
    TrialState,
    TrueDefect,
    UnseenPlace,
    hidden_part,
    match,
    pairs,
)
from annulus_pipe.vocabulary import AnnulusError

RADIUS_MM = 75.0
PULL = Pull("pull 1", "spool A", 0.0, 3000.0, RADIUS_MM, depth_limit_mm=0.5)


def laid(z: float, clock: float = 90.0, depth: float = 2.0, kind: str = "loss", **more: object) -> TrueDefect:
    given = {"length_mm": 20.0, "width_mm": 20.0, "pipe": "spool A", **more}
    return TrueDefect(f"{kind} {z:.0f}", kind, z, clock, depth, **given)  # type: ignore[arg-type]


def listed(z: float, clock: float = 90.0, depth: float = 2.0, kind: str = "loss", **more: object) -> Reported:
    return Reported(kind, z, clock, depth, length_mm=20.0, arc_deg=15.0, **more)  # type: ignore[arg-type]


SPOOL = [laid(200.0 + 250 * i, (40 * i) % 360) for i in range(10)]
FOUND = [listed(one.z_mm + 3, one.clock_deg - 2, 2.1) for one in SPOOL]


def states(truths: list[TrueDefect], reported: list[Reported], pull: Pull = PULL) -> list[TrialState]:
    return [one.state for one in match(truths, reported, pull).trials]


def test_what_lies_at_a_truths_place_is_its_report() -> None:
    found = match(SPOOL, FOUND, PULL)
    assert all(one.state is TrialState.DETECTED and one.is_identified for one in found.trials)
    assert not found.false_calls and found.trials[3].reported_depth_mm == 2.1


def test_pairs_are_chosen_all_at_once() -> None:
    """The nearest report of the first truth is the only one of the second."""
    truths, reported = [laid(100.0), laid(130.0)], [listed(118.0), listed(75.0)]
    assert sorted(pairs(truths, reported, RADIUS_MM)) == [(0, 1), (1, 0)]


def test_one_report_is_one_detection() -> None:
    assert sorted(states([laid(100.0), laid(110.0)], [listed(104.0)])) == [TrialState.DETECTED, TrialState.MISSED]


@pytest.mark.parametrize(("along", "expected"), [(10 + GATE_MM - 1, 1), (10 + GATE_MM + 1, 0)])
def test_the_gate_along_the_pipe(along: float, expected: int) -> None:
    assert len(pairs([laid(500.0)], [listed(500.0 + along)], RADIUS_MM)) == expected


@pytest.mark.parametrize(("round_mm", "expected"), [(10 + GATE_MM - 1, 1), (10 + GATE_MM + 1, 0)])
def test_the_gate_round_the_pipe_across_twelve_o_clock(round_mm: float, expected: int) -> None:
    clock = (355.0 + math.degrees(round_mm / RADIUS_MM)) % 360.0
    assert len(pairs([laid(500.0, 355.0)], [listed(500.0, clock)], RADIUS_MM)) == expected


def test_of_a_groove_the_clock_says_nothing() -> None:
    groove = laid(500.0, 0.0, width_mm=2 * math.pi * RADIUS_MM)
    assert pairs([groove], [listed(505.0, 180.0)], RADIUS_MM) == [(0, 0)]


def test_another_kind_is_detected_and_not_identified() -> None:
    (one,) = match([laid(500.0)], [listed(500.0, kind="bump")], PULL).trials
    assert one.state is TrialState.DETECTED and not one.is_identified


def test_an_undecided_place_is_a_miss_that_is_counted_by_itself() -> None:
    assert states([laid(500.0)], [listed(502.0, listed=False)]) == [TrialState.UNDECIDED]
    both = match([laid(500.0)], [listed(502.0, listed=False), listed(510.0)], PULL)
    assert both.trials[0].state is TrialState.DETECTED and both.undecided_elsewhere == 1 and not both.false_calls


def test_what_lies_in_a_hole_is_left_out_though_it_was_reported() -> None:
    hidden = replace(PULL, holes=(UnseenPlace(450.0, 550.0, 90.0, 40.0),))
    assert states([laid(500.0)], [], hidden) == [TrialState.NOT_SEEN]
    found = match([laid(500.0)], [listed(500.0)], hidden)
    assert found.trials[0].state is TrialState.NOT_SEEN and not found.false_calls
    assert states([laid(500.0, 150.0)], [], hidden) == [TrialState.MISSED]
    assert hidden_part(laid(550.0), hidden) == pytest.approx(0.5, abs=0.1)


def test_what_a_defects_own_rim_hides_is_no_hole() -> None:
    cells = np.ones((1500, 360), bool)
    seen = SeenWall(cells, 0.0, 2.0)
    cells[246:258, 70:110] = False  # 492 to 514 mm: most of the pocket at 500, and the wall behind it
    assert states([laid(500.0)], [listed(500.0)], replace(PULL, seen=seen)) == [TrialState.DETECTED]
    cells[:, 70:110] = False  # a rod's strip
    assert states([laid(500.0)], [listed(500.0)], replace(PULL, seen=seen)) == [TrialState.NOT_SEEN]
    assert states([laid(500.0, 150.0)], [listed(500.0, 150.0)], replace(PULL, seen=seen)) == [TrialState.DETECTED]


def test_what_was_not_scanned_is_left_out() -> None:
    assert states([laid(500.0), laid(3100.0)], [listed(500.0)]) == [TrialState.DETECTED, TrialState.OUTSIDE]


def test_what_matches_nothing_is_a_false_call_and_ovality_is_none() -> None:
    found = match(SPOOL, [*FOUND, listed(1380.0, 200.0), listed(1500.0, kind="ovality")], PULL)
    assert [one.z_mm for _, one in found.false_calls] == [1380.0] and found.of_other_kinds == 1


def test_the_truths_zero_may_lie_anywhere_in_the_scan() -> None:
    moved = [replace(one, z_mm=one.z_mm - 150.0) for one in SPOOL]
    assert all(one.state is TrialState.DETECTED for one in match(moved, FOUND, PULL, zero_mm=150.0).trials)
    with pytest.raises(AnnulusError, match="10 would match if the truths' zero lay at 153 mm"):
        match(moved, FOUND, PULL)


def wrong(truths: list[TrueDefect], reported: list[Reported], pull: Pull = PULL) -> str:
    with pytest.raises(AnnulusError) as error:
        match(truths, reported, pull)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_truths_of_another_pipe_are_refused() -> None:
    assert "results of pipe spool B, and the truths are of spool A" in wrong(
        SPOOL, FOUND, replace(PULL, pipe="spool B")
    )
    rng = np.random.default_rng(4)
    elsewhere = [
        listed(float(z), float(c)) for z, c in zip(rng.uniform(0, 3000, 6), rng.uniform(0, 360, 6), strict=True)
    ]
    elsewhere = [one for one in elsewhere if not pairs(SPOOL, [one], RADIUS_MM)]
    assert "another pipe, another zero or another unit" in wrong(SPOOL, elsewhere)


def test_truths_of_several_pipes_need_results_that_say_which() -> None:
    both = [*SPOOL, laid(100.0, pipe="spool B")]
    assert "does not say which pipe" in wrong(both, FOUND, replace(PULL, pipe=""))
    assert len(match(both, FOUND, PULL).trials) == len(SPOOL)


def test_places_in_metres_and_depths_in_inches_are_refused() -> None:
    assert "In metres they would" in wrong(
        [replace(one, z_mm=one.z_mm / 1000) for one in SPOOL], FOUND, replace(PULL, from_mm=50.0)
    )
    inches = wrong([replace(one, depth_mm=one.depth_mm / 25.4) for one in SPOOL], FOUND)
    assert "truths' depths look like inches" in inches
    assert "times as deep" in wrong(SPOOL, [replace(one, depth_mm=one.depth_mm / 25.4) for one in FOUND])


def test_no_truths_are_refused() -> None:
    assert "no truths to match" in wrong([], FOUND)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0, 3000), st.floats(0, 360), st.floats(0, 60)), max_size=12),
    st.lists(st.tuples(st.floats(0, 3000), st.floats(0, 360), st.booleans()), max_size=12),
)
def test_nothing_is_matched_twice_or_beyond_the_gate(
    truths: list[tuple[float, float, float]], reported: list[tuple[float, float, bool]]
) -> None:
    a = [laid(z, clock, length_mm=length) for z, clock, length in truths]
    b = [listed(z, clock, listed=name) for z, clock, name in reported]
    found = pairs(a, b, RADIUS_MM)
    for side in (0, 1):
        assert len({one[side] for one in found}) == len(found)
    for i, j in found:
        assert abs(a[i].z_mm - b[j].z_mm) <= GATE_MM + max(a[i].length_mm, b[j].length_mm) / 2 + 1e-9
