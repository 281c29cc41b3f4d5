"""Bytes and values from outside (wire, files, sockets), bounded and checked before anybody believes them.

Every check raises ValueError with one line that names the field, what it is and what was expected.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import msgpack


def unpack(packed: bytes, limit: int) -> Any:
    """One msgpack value of at most `limit` bytes; ValueError on anything else, whatever msgpack calls it."""
    if len(packed) > limit:
        raise ValueError(f"message of {len(packed)} bytes, at most {limit} expected")
    try:
        return msgpack.unpackb(packed)  # lengths inside are bounded by len(packed)
    except (ValueError, TypeError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise ValueError(f"not one msgpack value: {error}") from None


def mapping(value: object, what: str) -> Mapping[str, Any]:
    """A mapping with text for keys."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{what} must be a mapping of names")
    return value


def whole(value: object, what: str, low: int, high: int) -> int:
    """A whole number in low..high; True and 1.0 are none."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{what} is {value!r}, expected a whole number in {low}..{high}")
    return value


def number(value: object, what: str, most: float = math.inf) -> float:
    """A finite number, not larger than `most` either way."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value) or abs(value) > most:
        raise ValueError(f"{what} is {value!r}, expected a number")
    return float(value)


def within(value: object, what: str, low: float, high: float) -> float:
    """A number in low..high."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{what} is {value!r}, expected a number in {low:g}..{high:g}")
    return float(value)


def numbers(value: object, what: str, counts: Collection[int], most: float) -> tuple[float, ...]:
    """A list of finite numbers, not larger than `most` either way; `counts`: how many there may be."""
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) not in counts:
        raise ValueError(f"{what} must be a list of {_told(counts)} numbers")
    return tuple(within(item, f"{what}, number {i + 1},", -most, most) for i, item in enumerate(value))


def text(value: object, what: str, longest: int) -> str:
    """A text of at most `longest` characters."""
    if not isinstance(value, str) or len(value) > longest:
        raise ValueError(f"{what} must be a text of at most {longest} characters")
    return value


def _told(counts: Collection[int]) -> str:
    return f"{counts[0]}..{counts[-1]}" if isinstance(counts, range) else " or ".join(map(str, counts))
