"""Promises about the head's roll, in virtual time against truth."""

import math
import random

import pytest

from annulus_pipe.sensors.roll import NEAR_NS, Roll

MS = 1_000_000


def apart(a: float, b: float) -> float:
    """Between two angles, degrees."""
    return abs((a - b + 180.0) % 360.0 - 180.0)


def truth(at_ns: int) -> float:
    """A head that turns over and over: 40 degrees a second, and sways."""
    t = at_ns / 1e9
    return 40.0 * t + 3.0 * math.sin(2 * math.pi * t)


def test_between_samples_it_is_what_it_is_turn_after_turn() -> None:
    roll, rng = Roll(), random.Random(1)
    now = 0
    for _ in range(3000):  # 30 s at about 100 Hz: more than three turns, and more than is kept
        now += rng.randrange(5 * MS, 15 * MS)
        roll.add(now, truth(now) % 360.0)
        said = roll.at(now - rng.randrange(20 * MS)) if now > 40 * MS else None
        assert said is None or -180.0 <= said < 180.0
    moments = [now - rng.randrange(5_000 * MS) for _ in range(500)]
    said = [roll.at(moment) for moment in moments]
    assert max(apart(s, truth(m)) for s, m in zip(said, moments, strict=True) if s is not None) < 0.01
    assert None not in said


@pytest.mark.parametrize("first, second", [(359.0, 1.0), (1.0, 359.0), (-179.0, 179.0), (719.0, 1.0)])
def test_the_step_from_359_to_1_is_two_degrees(first: float, second: float) -> None:
    roll = Roll()
    roll.add(0, first)
    roll.add(10 * MS, second)
    middle = roll.at(5 * MS)
    assert middle is not None and apart(middle, (first + 1.0 if apart(first + 2, second) < 1 else first - 1.0)) < 1e-9


def test_a_sensor_that_falls_silent_is_believed_for_a_tenth_of_a_second_and_again_when_it_is_back() -> None:
    roll = Roll()
    assert roll.at(0) is None
    for k in range(100):
        roll.add(k * 10 * MS, truth(k * 10 * MS))
    last = 990 * MS
    assert roll.at(last + NEAR_NS) == pytest.approx((truth(last) + 180) % 360 - 180)
    assert roll.at(last + NEAR_NS + 1) is None
    back = last + 2_000 * MS
    roll.add(back, truth(back))
    assert roll.at(last + 1_000 * MS) is None, "nothing is made up for the silence"
    assert roll.at(last + NEAR_NS) is not None and roll.at(back - NEAR_NS - 1) is None
    roll.add(back + 10 * MS, truth(back + 10 * MS))
    said = roll.at(back + 4 * MS)
    assert said is not None and apart(said, truth(back + 4 * MS)) < 0.01


def test_samples_of_the_past_change_nothing() -> None:
    roll = Roll()
    roll.add(10 * MS, 5.0)
    roll.add(10 * MS, 50.0)
    roll.add(3 * MS, 50.0)
    assert roll.at(10 * MS) == 5.0
