"""One number reads the same wherever it is read."""

import math
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.numeric.rounding import (
    ANGLE,
    ARC,
    AREA,
    DISTANCE,
    EXTENT,
    MEASURE,
    NOT_MEASURED,
    PERCENT,
    SHARE,
    Quantity,
    clock_face,
    digits,
    digits_k2,
    off,
    quoted,
    span,
    stored,
    stored_k2,
    two_digits_up,
)

QUANTITIES = st.sampled_from([DISTANCE, MEASURE, EXTENT, AREA, ANGLE, ARC, PERCENT, SHARE])
VALUES = st.floats(-1e7, 1e7)
UNCERTAINTIES = st.floats(0.0, 1e5)


def step(quantity: Quantity) -> Decimal:
    """Of the last decimal, in the unit that is kept."""
    return Decimal(1).scaleb(-quantity.places + (3 if quantity.thousands else 0))


def read(text: str, quantity: Quantity) -> Decimal:
    return Decimal(text).scaleb(3 if quantity.thousands else 0)


@given(VALUES, QUANTITIES)
def test_a_number_and_what_was_kept_of_it_read_the_same(value: float, quantity: Quantity) -> None:
    assert digits(value, quantity) == digits(stored(value), quantity)
    assert stored(stored(value)) == stored(value)


@given(UNCERTAINTIES, QUANTITIES)
def test_an_uncertainty_and_what_was_kept_of_it_read_the_same(k2: float, quantity: Quantity) -> None:
    assert digits_k2(k2, quantity) == digits_k2(stored_k2(k2), quantity)
    assert stored_k2(stored_k2(k2)) == stored_k2(k2)


@given(VALUES, QUANTITIES)
def test_what_is_read_is_the_nearest_and_its_mirror_reads_mirrored(value: float, quantity: Quantity) -> None:
    far = abs(read(digits(value, quantity), quantity) - Decimal(str(value)))
    assert far <= step(quantity) / 2 + Decimal("0.0005")
    assert digits(-value, quantity).lstrip("-") == digits(value, quantity).lstrip("-")


@given(st.integers(-(10**9), 10**9))
def test_a_half_goes_away_from_zero_on_the_decimal_and_not_on_the_binary_fraction(thousandths: int) -> None:
    whole, rest = divmod(abs(thousandths), 10)
    expected = Decimal(whole + (rest >= 5)) / 100
    assert abs(Decimal(digits(thousandths / 1000, MEASURE))) == expected


@given(UNCERTAINTIES, QUANTITIES)
def test_an_uncertainty_is_never_understated_never_nothing_and_by_less_than_a_step_too_large(
    k2: float, quantity: Quantity
) -> None:
    told = read(digits_k2(k2, quantity), quantity)
    assert told > 0 and Decimal(str(k2)) - Decimal("1e-8") <= told <= Decimal(str(k2)) + step(quantity)


@given(st.floats(1e-6, 1e6))
def test_two_digits_are_two_and_never_understate(value: float) -> None:
    text = two_digits_up(value)
    assert value * (1 - 1e-8) <= float(text) <= value * 1.1
    assert len(text.replace(".", "").strip("0")) <= 2 and two_digits_up(float(text)) == text


@given(st.floats(-1e4, 1e4, width=32), QUANTITIES)
def test_a_short_float_reads_as_its_own_decimals(value: float, quantity: Quantity) -> None:
    short = np.float32(value)
    assert digits(short, quantity) == digits(float(str(short)), quantity)  # type: ignore[arg-type]


@given(VALUES, VALUES, QUANTITIES)
def test_a_larger_number_never_reads_smaller(one: float, other: float, quantity: Quantity) -> None:
    low, high = sorted((one, other))
    assert Decimal(digits(low, quantity)) <= Decimal(digits(high, quantity))


@given(st.floats(-1e4, 1e4))
def test_the_dial_repeats_and_is_off_by_half_a_tick_at_most(angle: float) -> None:
    hour, minute = map(int, clock_face(angle).split(":"))
    assert 1 <= hour <= 12 and minute % 5 == 0
    assert clock_face(angle) == clock_face(stored(angle % 360.0))
    off_deg = (hour % 12 * 30 + minute / 2 - angle + 180) % 360 - 180
    assert abs(off_deg) <= 1.2511


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (quoted(2.2849, MEASURE, 0.0312), "2.29 ± 0.04 mm"),  # 2.285 is kept
        (quoted(2.2844, MEASURE, 0.04), "2.28 ± 0.04 mm"),
        (quoted(213.5, DISTANCE), "0.214 m"),
        (quoted(30213.4, DISTANCE, 0.2), "30.213 ± 0.001 m"),
        (quoted(0.55, MEASURE, math.nan, at_least=True), "≥ 0.55 mm"),
        (quoted(0.55, MEASURE, 0.14, at_least=True), "≥ 0.55 ± 0.14 mm"),
        (quoted(1.0, MEASURE, 0.0), "1.00 ± 0.01 mm"),
        (quoted(0.3, MEASURE, 0.1 + 0.2), "0.30 ± 0.30 mm"),  # 0.30000000000000004 is no 0.31
        (quoted(None, PERCENT), NOT_MEASURED),
        (quoted(math.inf, EXTENT), NOT_MEASURED),
        (quoted(22.5, EXTENT), "23 mm"),
        (quoted(22.5, ARC), "23°"),
        (quoted(-0.001, MEASURE), "0.00 mm"),
        (quoted(2.0, PERCENT, 0.111), "2.00 ± 0.12 %"),
        (quoted(89.95, ANGLE, 0.21), "90.0 ± 0.3°"),
        (off(0.034, MEASURE), "0.04 mm"),
        (off(None, MEASURE), NOT_MEASURED),
        (span(123.0, 213.5, DISTANCE), "0.123 to 0.214 m"),
        (span(123.0, 213.5, DISTANCE, unit=False), "0.123 to 0.214"),
        (clock_face(359.0), "12:00"),
        (clock_face(1.25), "12:05"),
        (clock_face(90.0), "3:00"),
    ],
)
def test_how_a_thing_is_said(text: str, expected: str) -> None:
    assert text == expected
