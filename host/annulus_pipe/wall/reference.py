"""Stretches of a pipe whose inner diameter is known: a launch tube, a sleeve that was measured."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from annulus_pipe import untrusted

SECTIONS_MAX = 8
SPAN = re.compile(r"(-?[0-9]{1,7}(?:\.[0-9]{1,6})?):(-?[0-9]{1,7}(?:\.[0-9]{1,6})?)")  # mm, of the command line
LEAST_MM = 5.0  # of a section's length: shorter, no station lies in it
FARTHEST_MM = 1e7  # where it may lie: 10 km
DIAMETER_MM = (5.0, 10_000.0)
K2_PART = 0.05  # of the diameter: what is known no better is no reference


@dataclass(frozen=True, slots=True)
class ReferenceSection:
    """mm along the pipe, by the odometer, and across it; diameter_k2_mm : expanded uncertainty (k = 2)."""

    from_mm: float
    to_mm: float
    diameter_mm: float
    diameter_k2_mm: float


def sections_from(data: object, what: str = "[reference]") -> tuple[ReferenceSection, ...]:
    """Of plain values, as head.toml has them: sections_mm, diameter_mm, u_mm (k = 2). Raises ValueError naming the
    key that is wrong."""
    section = untrusted.mapping(data, what)
    known = ("sections_mm", "diameter_mm", "u_mm")
    for name in section:
        if name not in known:
            raise ValueError(f"{what} {untrusted.shown(name)} is not known, expected one of {', '.join(known)}")
    missing = [name for name in known if name not in section]
    if missing:
        raise ValueError(f"{what} {missing[0]} is missing, expected {', '.join(known)}")
    spans: Any = section["sections_mm"]
    if not isinstance(spans, list) or not 1 <= len(spans) <= SECTIONS_MAX:
        raise ValueError(f"{what} sections_mm: expected 1 to {SECTIONS_MAX} pairs, as [[0, 120]]")
    pairs = [untrusted.numbers(one, f"{what} sections_mm[{i}]", (2,), FARTHEST_MM) for i, one in enumerate(spans)]
    diameter = untrusted.within(section["diameter_mm"], f"{what} diameter_mm", *DIAMETER_MM)
    k2 = untrusted.within(section["u_mm"], f"{what} u_mm (k = 2)", 1e-4, K2_PART * diameter)
    return _checked([ReferenceSection(first, last, diameter, k2) for first, last in pairs], what)


def sections_to_dict(sections: Sequence[ReferenceSection]) -> dict[str, Any]:
    """What `sections_from` reads; all are of one diameter."""
    if not sections:
        return {}
    spans = [[one.from_mm, one.to_mm] for one in sections]
    return {"sections_mm": spans, "diameter_mm": sections[0].diameter_mm, "u_mm": sections[0].diameter_k2_mm}


def sections_recorded(data: object) -> tuple[ReferenceSection, ...]:
    """As `HeadConfig` writes them into a recording, whoever wrote it: none of what is malformed."""
    try:
        return sections_from(data) if data else ()
    except ValueError:
        return ()


def sections_of(words: Sequence[str], diameter_mm: float, k2_mm: float, what: str) -> tuple[ReferenceSection, ...]:
    """Of words as "0:120". Raises ValueError."""
    spans = []
    for word in words:
        match = SPAN.fullmatch(word)
        if match is None:
            raise ValueError(f"{what} {untrusted.shown(word)}: expected FROM:TO in mm, as 0:120")
        spans.append([float(match[1]), float(match[2])])
    return sections_from({"sections_mm": spans, "diameter_mm": diameter_mm, "u_mm": k2_mm}, what)


def _checked(sections: Sequence[ReferenceSection], what: str) -> tuple[ReferenceSection, ...]:
    """In order of distance. Raises ValueError where one is too short, or two overlap."""
    out = tuple(sorted(sections, key=lambda one: one.from_mm))
    before = -math.inf
    for one in out:
        shown = f"{what} {one.from_mm:g}:{one.to_mm:g}"
        if one.to_mm - one.from_mm < LEAST_MM:
            raise ValueError(f"{shown}: expected FROM before TO by {LEAST_MM:g} mm or more")
        if one.from_mm < before:
            raise ValueError(f"{shown}: overlaps the section before it")
        before = one.to_mm
    return out
