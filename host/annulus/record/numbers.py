"""Numbers in the fields of a table that somebody wrote by hand or program."""

import math


def whole(text: str, column: str) -> int:
    """Raises ValueError naming the column."""
    if not (text.isascii() and text.isdigit()) or len(text) > 18:
        raise ValueError(f'{column} is "{text[:40]}", expected a whole number')
    return int(text)


def number(text: str) -> float:
    """NaN where it is none; "1_000" and digits of other scripts are none, though Python reads them."""
    try:
        return float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        return math.nan
