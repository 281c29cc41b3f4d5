"""Numbers for people: one way to round, and one unit and step for every kind of quantity.

A number is kept with three decimals of its own unit (`stored`: what summary.json says), and whatever a person reads, on
a page, in a picture or at a terminal, is rounded from the kept one: half away from zero, as decimals, not as binary
fractions. Rounding the number itself and rounding what was kept of it therefore read the same, wherever it is done. An
uncertainty is rounded up; rounding up one that already was changes nothing, and one above 0 never shows as 0.

Where a thing lies along the pipe is said in metres, to the millimetre. How large it is, depths and diameters are said
in millimetres: extents whole, since an edge is not known better, what is measured to 0.01 mm.
"""

import math
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_HALF_UP, Decimal
from typing import Final

STORED: Final = 3  # decimals that are kept
_NOISE: Final = 9  # decimals: beyond them lies what binary fractions leave, which is not to be rounded up
NOT_MEASURED: Final = "not measured"
DIAL_STEP_DEG: Final = 2.5  # 5 minutes of the dial


@dataclass(frozen=True, slots=True)
class Quantity:
    """How a kind of quantity is read: its unit and decimals. `thousands`: it is kept in the thousandth of that unit."""

    unit: str
    places: int
    thousands: bool = False

    @property
    def suffix(self) -> str:
        return self.unit if self.unit in ("", "°") else f" {self.unit}"


DISTANCE: Final = Quantity("m", 3, thousands=True)  # along the pipe, from the odometer's zero; kept in mm
MEASURE: Final = Quantity("mm", 2)  # depths, diameters, heights, gaps, and what they may be off
EXTENT: Final = Quantity("mm", 0)  # lengths and widths of what lies on the wall
AREA: Final = Quantity("mm²", 0)
ANGLE: Final = Quantity("°", 1)  # measured: of a bend, of a joint, a roll
ARC: Final = Quantity("°", 0)  # an extent round the pipe
PERCENT: Final = Quantity("%", 2)  # ovality, and what is held against a limit
SHARE: Final = Quantity("%", 1)  # of a whole: of the wall seen, of the diameter


def stored(value: float) -> float:
    """The number as it is kept: three decimals, half away from zero. NaN and infinities stay."""
    return value if not math.isfinite(value) else float(_kept(value))


def stored_k2(value: float) -> float:
    """An uncertainty as it is kept: three decimals, up."""
    return value if not math.isfinite(value) else float(_kept_up(value))


def digits(value: float, quantity: Quantity) -> str:
    """The number without its unit: 213.5 mm along the pipe -> "0.214"."""
    return _text(_scaled(_kept(value), quantity), quantity.places, ROUND_HALF_UP)


def digits_k2(value: float, quantity: Quantity) -> str:
    """An uncertainty without its unit: up, and never 0."""
    return _text(max(_scaled(_kept_up(value), quantity), Decimal(1).scaleb(-quantity.places)), quantity.places)


def two_digits_up(value: float) -> str:
    """An uncertainty of any size without its unit: two significant digits, up. Not negative.

    >>> two_digits_up(0.1041), two_digits_up(0.21), two_digits_up(0.0996), two_digits_up(118.2)
    ('0.11', '0.21', '0.10', '120')
    """
    if not math.isfinite(value) or value <= 0.0:
        return f"{value:g}"
    exact = Decimal(f"{value:.{_NOISE}g}")
    up = exact.quantize(Decimal(1).scaleb(exact.adjusted() - 1), ROUND_CEILING)
    return f"{up.quantize(Decimal(1).scaleb(up.adjusted() - 1)):f}"


def quoted(value: float | None, quantity: Quantity, k2: float | None = None, *, at_least: bool = False) -> str:
    """A value for people: "2.28 ± 0.04 mm".

    k2 : its expanded uncertainty; the value stands alone where nobody knows it (None, NaN). at_least : the value is a
    lower limit.

    >>> quoted(2.2849, MEASURE, 0.0312), quoted(0.55, MEASURE, at_least=True), quoted(213.5, DISTANCE)
    ('2.29 ± 0.04 mm', '≥ 0.55 mm', '0.214 m')
    """
    if value is None or not math.isfinite(value):
        return NOT_MEASURED
    within = "" if k2 is None or not math.isfinite(k2) else f" ± {digits_k2(k2, quantity)}"
    return f"{'≥ ' if at_least else ''}{digits(value, quantity)}{within}{quantity.suffix}"


def off(k2: float | None, quantity: Quantity) -> str:
    """An uncertainty alone: "0.04 mm"."""
    return NOT_MEASURED if k2 is None or not math.isfinite(k2) else digits_k2(k2, quantity) + quantity.suffix


def span(first: float, last: float, quantity: Quantity, *, unit: bool = True) -> str:
    """From one to another: "0.123 to 0.214 m"."""
    return f"{digits(first, quantity)} to {digits(last, quantity)}{quantity.suffix if unit else ''}"


def clock_face(angle_deg: float) -> str:
    """Clock position of an angle, clockwise from 12, to 5 minutes of the dial: 90 -> "3:00", 0 -> "12:00"."""
    ticks = int(_quantized(_kept(angle_deg % 360.0) / Decimal(str(DIAL_STEP_DEG)), 0, ROUND_HALF_UP)) % 144
    return f"{ticks // 12 or 12}:{ticks % 12 * 5:02d}"


def _kept(value: float) -> Decimal:
    return _quantized(Decimal(str(value)), STORED, ROUND_HALF_UP)


def _kept_up(value: float) -> Decimal:
    return _quantized(_quantized(Decimal(str(value)), _NOISE, ROUND_HALF_UP), STORED, ROUND_CEILING)


def _scaled(kept: Decimal, quantity: Quantity) -> Decimal:
    return kept.scaleb(-3) if quantity.thousands else kept


def _text(value: Decimal, places: int, rounding: str = ROUND_CEILING) -> str:
    return f"{_quantized(value, places, rounding):f}"


def _quantized(value: Decimal, places: int, rounding: str) -> Decimal:
    return value.quantize(Decimal(1).scaleb(-places), rounding=rounding) + 0  # no "-0.00"
