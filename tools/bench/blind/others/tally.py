"""What came of one drawn case, and many of them summed up in markdown."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from tools.bench.blind.score import Number
from tools.bench.blind.table import ASKED, cell, coverage, coverage_rows, part, without_k2

STATES = ("found", "misnamed", "missed", "not established", "below the limit")
SAID_MOST = 4  # lines of a case's worst numbers


@dataclass(slots=True)
class Case:
    """marks : what makes it hard. things : (kind, state, what was said). false : of what is not there, a line each.

    odds : (what it was called, how probable that was said to be, whether it was so).
    unsaid : numbers that were not established, by kind. refused : the one line with which all of it was refused.
    """

    seed: int
    marks: str
    things: list[tuple[str, str, str]] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    numbers: list[Number] = field(default_factory=list)
    odds: list[tuple[str, float, bool]] = field(default_factory=list)
    unsaid: Counter[str] = field(default_factory=Counter)
    refused: str = ""

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    def __str__(self) -> str:
        if self.refused:
            return f"{self.marks}: refused: {self.refused}"
        states = Counter(state for _, state, _ in self.things)
        counts = [f"{count} {state}" for state, count in states.items()]
        return f"{self.marks}: {', '.join([*counts, f'{len(self.false)} false'])}; k = 2 holds {held(self)}"


def held(case: Case) -> str:
    known = [one.right for one in case.numbers if one.right is not None]
    return f"{sum(known)} of {len(known)}"


def markdown(cases: Sequence[Case], failed: Mapping[int, str], head: str) -> str:
    done = [case for case in cases if not case.refused]
    states = Counter(state for case in cases for _, state, _ in case.things)
    asked = sum(states[name] for name in STATES[:4])
    lines = [
        head,
        "",
        f"{len(cases)} drawn, {len(failed)} broke, {len(cases) - len(done)} refused in one line. Of {asked} things "
        f"over the limit of detection: found {part(states['found'], asked)}, misnamed "
        f"{part(states['misnamed'], asked)}, missed {part(states['missed'], asked)}, said not established "
        f"{part(states['not established'], asked)}. False: {sum(len(case.false) for case in cases)}.",
        "",
        *_coverage(done),
        *without_k2(done),
        *_odds(done),
        *_things(cases),
        *_rows(cases, failed),
        *_details(done),
    ]
    return "\n".join(lines) + "\n"


def _coverage(cases: Sequence[Case]) -> list[str]:
    counts = coverage(one for case in cases for one in case.numbers)
    unsaid = Counter[str]()
    for case in cases:
        unsaid += case.unsaid
    lines = [
        f"Coverage of k = 2; {100 * ASKED[0]:.0f} to {100 * ASKED[1]:.0f} % are asked, what is surely outside is bold. "
        "Numbers of one case err together: intervals are too narrow by that.",
        "",
        "| number | where | k = 2 holds, % | not established |",
        "|---|---|---|---|",
    ]
    lines += [f"| {what} | {where} | {cell(*of)} | |" for (what, where), of in sorted(counts.items())]
    lines += [f"| {what} | | | {count} |" for what, count in sorted(unsaid.items())]
    return [*lines, ""]


def _odds(cases: Sequence[Case]) -> list[str]:
    odds = [one for case in cases for one in case.odds]
    if not odds:
        return []
    lines = ["| called | times | said to be right | right |", "|---|---|---|---|"]
    for kind in sorted({kind for kind, _, _ in odds}):
        reported = [(value, right) for one, value, right in odds if one == kind]
        mean = sum(value for value, _ in reported) / len(reported)
        rightly = sum(right for _, right in reported)
        lines.append(f"| {kind} | {len(reported)} | {100 * mean:.1f} % | {part(rightly, len(reported))} |")
    return [*lines, ""]


def _things(cases: Sequence[Case]) -> list[str]:
    things = [one for case in cases for one in case.things]
    if not things:
        return []
    lines = ["| thing | " + " | ".join(STATES) + " |", "|---" * (len(STATES) + 1) + "|"]
    for kind in sorted({kind for kind, _, _ in things}):
        states = Counter(state for one, state, _ in things if one == kind)
        lines.append(f"| {kind} | " + " | ".join(str(states[name] or "") for name in STATES) + " |")
    return [*lines, ""]


def _rows(cases: Sequence[Case], failed: Mapping[int, str]) -> list[str]:
    lines = ["| seed | drawn | found/misnamed/missed/not est. | false | k = 2 holds |", "|---" * 5 + "|"]
    for case in cases:
        states = Counter(state for _, state, _ in case.things)
        counts = "/".join(str(states[name]) for name in STATES[:4])
        lines.append(f"| {case.seed} | {case.marks} | {case.refused or counts} | {len(case.false)} | {held(case)} |")
    lines += [f"| {seed} | broke: {why} | | | |" for seed, why in failed.items()]
    return [*lines, ""]


def _details(cases: Sequence[Case]) -> list[str]:
    lines = []
    for case in cases:
        lines += [
            f"- {case.seed}: {kind}: {state}: {reported}"
            for kind, state, reported in case.things
            if state in ("misnamed", "missed")
        ]
        lines += [f"- {case.seed}: false: {one}" for one in case.false]
        far = [one for one in case.numbers if one.far_off]
        lines += [
            f"- {case.seed}: {one.what} {one.reported:.3f} +- {one.k2:.3f}, is {one.true:.3f}: over 3 k2"
            for one in far[:SAID_MOST]
        ]
        if len(far) > SAID_MOST:
            lines.append(f"- {case.seed}: {len(far) - SAID_MOST} more numbers over 3 k2")
    return lines


def totals(cases: Sequence[Case], failed: Mapping[int, str]) -> dict[str, Any]:
    """The same for programs."""
    return {
        "cases": [case.to_dict() for case in cases],
        "broke": {str(seed): why for seed, why in failed.items()},
        "coverage": coverage_rows(one for case in cases for one in case.numbers),
    }
