"""A hiccup of a driver shows pictures again, blank ones, and lacks some: each was held against half a lamp cycle by
itself, and what came while edges were unheard or another doubt lasted was not held against anything. 210 frames at the
place of five frames later, up to the next preamble.
"""

import random

import pytest
from bench_of_faults import Bench, Faults, Score

from annulus_pipe.labelling.replay import PATIENCE_NS, Replay
from annulus_pipe.vocabulary import Label, Lamp

EVERY, LENGTH, AT = 500, 15, 205  # frames
COUNTS = pytest.mark.parametrize("counted", [True, False])


def lamp(k: int, ratio: int = 4) -> Lamp:
    if k % EVERY < LENGTH:
        return random.Random(k).choice([Lamp.PROJECTOR, Lamp.PROJECTOR, Lamp.LED, Lamp.DARK])
    return Lamp.LED if k % (ratio + 1) == ratio else Lamp.PROJECTOR


def hiccup(signs: str, counted: bool, at: int = AT, ratio: int = 4) -> Faults:
    """From `at` on a frame each: b blank, r shown again, s missing, t torn, u garbage, n new; behind them pictures are
    late by as many.
    """
    sign = dict(zip(range(at, at + len(signs)), signs, strict=True))
    late = [sum(sign.get(i, "n") != "n" for i in range(at, k + 1)) for k in range(900)]
    return Faults(
        lamp=lambda k: lamp(k, ratio),
        preamble=lambda k: k % EVERY < LENGTH,
        blank=lambda k: sign.get(k) == "b",
        torn=lambda k: sign.get(k) == "t",
        garbage=lambda k: sign.get(k) == "u",
        dropped=lambda k: sign.get(k) == "s",
        pictured=lambda k: k - late[min(k, 899)],
        count=(lambda k: 1000 + k) if counted else lambda k: None,
    )


def scored(faults: Faults, **options: float) -> Score:
    score = Bench(faults, **options).run(700)
    assert score.wrong == [] and score.share(560) < 0.1, "after the next preamble they are known again"
    return score


@pytest.mark.deep(but=2)
@pytest.mark.parametrize(
    ("signs", "ratio"),
    [("brrss", 4), ("brs", 2), ("bsr", 2), ("bssrr", 4), ("brsrs", 4), ("brrnss", 4), ("rrbbb", 4), ("bnnrnrnss", 4)],
)
def test_signs_of_every_sort_are_counted_together(signs: str, ratio: int) -> None:
    scored(hiccup(signs, False, ratio=ratio), ratio=ratio)


@pytest.mark.deep(but=2)
@COUNTS
@pytest.mark.parametrize("signs", ["bbbbb", "r", "rr", "b", "bb", "rrrrr"])
def test_also_in_frames_whose_edges_nobody_heard(signs: str, counted: bool) -> None:
    faults = hiccup(signs, counted)
    faults.edge_lost = lambda k: AT - 1 <= k < AT + len(signs)
    scored(faults)


@pytest.mark.deep(but=2)
@COUNTS
@pytest.mark.parametrize("shift", range(5))
@pytest.mark.parametrize("signs", ["r", "b", "rr", "bb"])
@pytest.mark.parametrize("stepped", [False, True])
def test_also_in_a_doubt_that_began_otherwise(signs: str, shift: int, counted: bool, stepped: bool) -> None:
    """A stamp that is off by itself, or from then on."""
    faults = hiccup(signs, counted, AT + shift)
    faults.stamp_ms = lambda k: 120.0 * (k >= AT + shift - 1 if stepped else k == AT + shift - 1)
    scored(faults)


@pytest.mark.deep(but=2)
@COUNTS
@pytest.mark.parametrize("signs", ["bbuuu", "rrttt", "ttttt", "uuuuu", "rruuu", "nnbuttr"])
def test_also_pictures_that_are_none(signs: str, counted: bool) -> None:
    """A buffer that was written in part, or with something else."""
    scored(hiccup(signs, counted))


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("signs", ["sbsbs", "ssbss", "sbssb"])
@pytest.mark.parametrize("handed_over", [True, False])
def test_also_where_stamps_are_true_or_the_count_is_of_what_is_handed_over(signs: str, handed_over: bool) -> None:
    faults = hiccup(signs, True)
    missing = [AT + i for i, sign in enumerate(signs) if sign == "s"]
    late = lambda k: k - faults.pictured(k)  # noqa: E731
    if handed_over:
        faults.count = lambda k: 1000 + k - sum(one <= k for one in missing)
    else:
        faults.stamp_ms = lambda k: -40.0 * late(k)
    scored(faults)


@pytest.mark.deep(but=1)
@COUNTS
@pytest.mark.parametrize("signs", ["rrrnnnnr", "bbbnnnb", "bbbnnnnbb"])
def test_also_while_a_search_is_under_way(signs: str, counted: bool) -> None:
    """What it proves holds behind the last sign, not for the frames before."""
    scored(hiccup(signs, counted))


def test_a_driver_that_gives_a_cycle_of_frames_away_is_not_one_whose_stamps_have_moved() -> None:
    """Its count goes on, its frames come as much sooner, and its stamps are right."""
    gone = range(AT - 5, AT)
    faults = Faults(
        lamp=lamp,
        preamble=lambda k: k % EVERY < LENGTH,
        kept=lambda k: 5 * (k < AT),
        dropped=lambda k: k in gone,
        count=lambda k: 1000 + k - 5 * (k >= AT),
    )
    scored(faults)


def test_a_lamp_that_fails_for_good_costs_its_own_frames_and_a_moment() -> None:
    faults = hiccup("", True)
    faults.blank = lambda k: k > AT and lamp(k - 1) is Lamp.LED
    score = Bench(faults).run(480)
    assert score.wrong == [] and score.share(AT + 60) <= 0.21


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("hole", [350, 150, 250, 440])
def test_behind_a_hole_in_the_evidence_a_deep_queue_is_not_taken_for_a_shallow_one(hole: int) -> None:
    """The head saw a preamble; who reads on behind the hole has not."""
    bench = Bench(Faults(lamp=lamp, preamble=lambda k: k % EVERY < LENGTH, kept=lambda k: 5), preambles=True)
    rows: list[dict[str, object]] = []
    bench.navigation.write_down(rows.append)
    assert bench.run(700).wrong == []
    first = next(i for i, row in enumerate(rows) if row["what"] == "edge" and row["odometer"] == hole)
    replay = Replay(PATIENCE_NS)
    said = [one for row in rows[:first] for one in replay.feed(row)] + replay.cut()
    said += [one for row in rows[first + 100 :] for one in replay.feed(row)]
    now = [again for _, again in said + replay.finish() if again is not None and again.label is not Label.UNKNOWN]
    assert [one for one in now if one.odometer != (one.sequence or 0) - 1001] == []
    assert sum((one.odometer or 0) > 520 for one in now) > 150, "the next preamble proves them"
