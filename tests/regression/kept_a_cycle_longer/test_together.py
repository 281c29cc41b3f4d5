"""A driver that kept one lamp cycle of frames more moved stamp, arrival and picture together, and nobody contradicted:
475 frames at the place of five frames later, up to the next preamble. The twin's queue ended at four frames."""

import random

import pytest
from bench_of_faults import Bench, Faults

from annulus_pipe.twin.soak import soak
from annulus_pipe.vocabulary import Lamp

PROFILES = ("hiccups", "hiccups-alone", "deeper-restarts", "pictures-behind", "queue-cycles", "queue-cycles-alone")
EVERY, LENGTH, AT = 200, 15, 305  # frames


def lamp(k: int) -> Lamp:
    if k % EVERY < LENGTH:
        return random.Random(k).choice([Lamp.PROJECTOR, Lamp.LED])
    return Lamp.LED if k % 5 == 4 else Lamp.PROJECTOR


def test_pictures_that_come_again_may_be_late_from_then_on() -> None:
    """Of five frames before, from one on; stamp, count and arrival are those of the present."""
    faults = Faults(lamp=lamp, preamble=lambda k: k % EVERY < LENGTH, pictured=lambda k: k - 5 * (k >= AT))
    score = Bench(faults).run(700)
    assert score.wrong == [] and score.share(500) < 0.1, "after the next preamble they are known again"


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", [22, 21, 23])
@pytest.mark.parametrize("faults", PROFILES)
def test_no_place_is_a_lamp_cycle_off(faults: str, seed: int) -> None:
    found = soak(2500, seed, faults=faults)
    assert found["wrong"] == 0
    assert found["unknown_share"] < 0.05 and found["untold"] == 0


@pytest.mark.deep(gate="tests/regression/kept_a_cycle_longer/test_together.py::test_no_place_is_a_lamp_cycle_off")
@pytest.mark.parametrize("faults", [*PROFILES, "stamps-odd", "queue-steps", "handed-over", "reckoned", "unplugged"])
def test_nor_in_fifty_thousand_frames(faults: str) -> None:
    assert soak(50_000, 5, faults=faults, jobs=None, world_frames=25_000)["wrong"] == 0


def drip(at: int, count: int, gap: int) -> list[int]:
    """Frames that are dropped one by one while a queue grows by one frame each time."""
    return [at + n * gap for n in range(count)]


@pytest.mark.deep(but=3)
@pytest.mark.parametrize(("gap", "by", "count"), [(2, 1, 5), (5, 1, 9), (16, 3, 3), (3, 1, 5), (7, 2, 9), (25, 1, 3)])
def test_nor_does_a_queue_that_grows_bit_by_bit_hide_a_cycle(gap: int, by: int, count: int) -> None:
    """Each hole is less than half a cycle, and no count spans it; stamps move with the queue. It may go on growing
    while a search is under way."""
    grown = [at + more for at in drip(AT, count, gap) for more in range(by)]
    behind = [sum(k > at for at in grown) for k in range(900)]
    faults = Faults(
        lamp=lamp,
        preamble=lambda k: k % EVERY < LENGTH,
        count=lambda k: None,
        dropped=lambda k: k in grown,
        pictured=lambda k: k - behind[min(k, 899)],
    )
    assert Bench(faults).run(900).wrong == []


@pytest.mark.parametrize("blank", [2, 5])
def test_nor_do_buffers_that_nothing_was_written_into(blank: int) -> None:
    """They are handed over first, and what comes behind them is late from then on."""
    faults = Faults(
        lamp=lamp,
        preamble=lambda k: k % EVERY < LENGTH,
        blank=lambda k: AT <= k < AT + blank,
        pictured=lambda k: k - blank * (k >= AT),
    )
    assert Bench(faults).run(700).wrong == []
