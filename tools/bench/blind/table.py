"""Scores of many pipes summed up: markdown with binomial intervals, and the same for programs."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import beta

from tools.bench.blind.places import PLACES
from tools.bench.blind.score import Number, Outcome, Score

STATES = ("found", "misnamed", "missed", "not established", "below the limit", "outside")
ASKED = 0.93, 0.97  # of coverage
LEVEL = 0.95  # of the intervals
SAID_MOST = 3  # lines of a pipe's false ones in its row


def interval(hits: int, of: int) -> tuple[float, float]:
    """Clopper and Pearson's, at 95 %: exact, and never narrower than it says."""
    tail = (1.0 - LEVEL) / 2.0
    low = 0.0 if hits == 0 else float(beta.ppf(tail, hits, of - hits + 1))
    high = 1.0 if hits == of else float(beta.ppf(1.0 - tail, hits + 1, of - hits))
    return low, high


def part(hits: int, of: int) -> str:
    """As 94.1 % (91.0 to 96.3), or "-" of nothing."""
    if not of:
        return "-"
    low, high = interval(hits, of)
    return f"{100.0 * hits / of:.1f} % ({100.0 * low:.1f} to {100.0 * high:.1f})"


def coverage(numbers: Iterable[Number]) -> dict[tuple[str, str], tuple[int, int]]:
    """(kind of number, place) -> (right ones, those with a k = 2)."""
    counts: dict[tuple[str, str], list[int]] = defaultdict(lambda: [0, 0])
    for one in numbers:
        if one.right is not None:
            counts[one.what, one.where][0] += one.right
            counts[one.what, one.where][1] += 1
    return {key: (right, of) for key, (right, of) in counts.items()}


def markdown(scores: Sequence[Score], failed: Mapping[int, str], head: str) -> str:
    lines = [head, ""]
    lines += _sums(scores, failed)
    lines += _coverage_table(scores)
    lines += without_k2(scores)
    lines += _by_kind([one for score in scores for one in score.outcomes])
    lines += _rows(scores, failed)
    lines += _details(scores)
    return "\n".join(lines) + "\n"


def _sums(scores: Sequence[Score], failed: Mapping[int, str]) -> list[str]:
    states = Counter(one.state for score in scores for one in score.outcomes)
    asked = sum(states[name] for name in ("found", "misnamed", "missed", "not established"))
    false, metres = sum(len(score.false) for score in scores), sum(score.length_mm for score in scores) / 1000.0
    depths = [one for score in scores for one in score.numbers if one.what == "depth"]
    far = sum(one.far_off for one in depths)
    over = [score for score in scores if score.over_limit]
    wrong = sum(score.falsely_conforms for score in scores)
    return [
        f"{len(scores)} pipes, {len(failed)} broke, {metres:.2f} m, {sum(states.values())} things drawn; "
        f"{asked} over what the survey says it can list",
        "",
        "| | measured | asked |",
        "|---|---|---|",
        f"| found | {part(states['found'], asked)} | |",
        f"| misnamed | {part(states['misnamed'], asked)} | <= 3 % |",
        f"| missed, nothing said | {part(states['missed'], asked)} | <= 3 % |",
        f"| said not established | {part(states['not established'], asked)} | |",
        f"| false per 10 m | {10.0 * false / max(metres, 1e-9):.1f} ({false}) | <= 1 |",
        f"| depths off by more than 3 k2 | {far} of {len(depths)} | 0 |",
        f"| conforms with something over a limit | {wrong} of {len(over)} | 0 |",
        "",
    ]


def _coverage_table(scores: Sequence[Score]) -> list[str]:
    counts = coverage(one for score in scores for one in score.numbers)
    for score in scores:
        for place, (of, *each) in score.cloud.items():
            for what, right in zip(("cloud points", "cloud points, but for the scale"), each, strict=True):
                before = counts.get((what, place), (0, 0))
                counts[what, place] = before[0] + right, before[1] + of
    kinds = sorted({kind for kind, _ in counts})
    lines = [
        f"Coverage of k = 2 by kind of number and by place; {100 * ASKED[0]:.0f} to {100 * ASKED[1]:.0f} % are asked, "
        "and what is surely outside is bold. Numbers of one pipe err together: intervals are too narrow by that.",
        "",
        "| | all | " + " | ".join(PLACES) + " |",
        "|---" * (len(PLACES) + 2) + "|",
    ]
    for kind in kinds:
        whole = [sum(counts.get((kind, place), (0, 0))[k] for place in PLACES) for k in (0, 1)]
        cells = [cell(*whole), *(cell(*counts.get((kind, place), (0, 0))) for place in PLACES)]
        lines.append(f"| {kind} | {' | '.join(cells)} |")
    return [*lines, ""]


def cell(right: int, of: int) -> str:
    if not of:
        return ""
    low, high = interval(right, of)
    text = f"{100.0 * right / of:.0f} ({100.0 * low:.0f}..{100.0 * high:.0f}) of {of}"
    return f"**{text}**" if high < ASKED[0] or low > ASKED[1] else text


def without_k2(scores: Sequence[Score]) -> list[str]:
    """Numbers for which a survey says no uncertainty: how far off they are."""
    off: dict[str, list[float]] = defaultdict(list)
    for score in scores:
        for one in score.numbers:
            if math.isnan(one.k2):
                off[one.what].append(one.reported - one.true)
    lines = [
        "No k = 2 is said of these:",
        "",
        "| | n | median | half are within | 95 % are within |",
        "|---|---|---|---|---|",
    ]
    for what in sorted(off):
        errors = np.array(off[what])
        half, most = np.percentile(np.abs(errors), [50, 95])
        lines.append(f"| {what} | {len(errors)} | {np.median(errors):+.2f} | {half:.2f} | {most:.2f} |")
    return [*lines, ""] if off else []


def _by_kind(outcomes: Sequence[Outcome]) -> list[str]:
    lines = ["| thing | " + " | ".join(STATES) + " |", "|---" * (len(STATES) + 1) + "|"]
    for kind in sorted({one.kind for one in outcomes}):
        states = Counter(one.state for one in outcomes if one.kind == kind)
        lines.append(f"| {kind} | " + " | ".join(str(states[name] or "") for name in STATES) + " |")
    places = Counter((one.where, one.state) for one in outcomes)
    lines += [
        f"| *{where}* | " + " | ".join(str(places[where, name] or "") for name in STATES) + " |" for where in PLACES
    ]
    return [*lines, ""]


def _rows(scores: Sequence[Score], failed: Mapping[int, str]) -> list[str]:
    lines = [
        "| pipe | bore mm | wall | marks | found/misnamed/missed/not est. | below, outside | false | k = 2 holds "
        "| verdict |",
        "|---" * 9 + "|",
    ]
    for score in scores:
        states = Counter(one.state for one in score.outcomes)
        counts = "/".join(str(states[name]) for name in STATES[:4])
        known = [one.right for one in score.numbers if one.right is not None]
        points = sum(of for of, _, _ in score.cloud.values())
        inside = sum(right for _, right, _ in score.cloud.values())
        held = f"{sum(known)} of {len(known)}, points {100 * inside / max(points, 1):.0f} %"
        over = " (over)" if score.over_limit else ""
        verdict = f"{score.decision}{over}{' **wrong**' if score.falsely_conforms else ''}"
        lines.append(
            f"| {score.seed} | {score.bore_mm:.0f} | {score.material} | {', '.join(score.marks)} | {counts} | "
            f"{states['below the limit']}, {states['outside']} | {len(score.false)} | {held} | {verdict} |"
        )
    lines += [f"| {seed} | | | | broke: {why} | | | | |" for seed, why in failed.items()]
    return [*lines, ""]


def _details(scores: Sequence[Score]) -> list[str]:
    """What is wrong in each pipe, a line each."""
    lines = []
    for score in scores:
        for one in score.outcomes:
            if one.state in ("misnamed", "missed"):
                reported = f": {'; '.join(one.reported[:SAID_MOST])}" if one.reported else ""
                beside = f" beside {one.beside}" if one.beside else ""
                lines.append(
                    f"- {score.seed}: {one.kind} {one.depth_mm:.2f} mm at {one.z_mm:.0f} mm, clock {one.clock_deg:.0f}"
                    f"{beside}, {one.where}: {one.state}{reported}"
                )
        lines += [f"- {score.seed}: false: {one}" for one in score.false]
        for number in score.numbers:
            if number.what == "depth" and number.right is False:
                least = ">= " if number.at_least else ""
                lines.append(
                    f"- {score.seed}: depth {least}{number.reported:.2f}+-{number.k2:.2f}, is {number.true:.2f}, "
                    f"{number.where}{' **over 3 k2**' if number.far_off else ''}"
                )
        lines += [
            f"- {score.seed}: **{score.decision}** with {one}" for one in score.over_limit if score.falsely_conforms
        ]
    return lines


def coverage_rows(numbers: Iterable[Number]) -> list[dict[str, Any]]:
    """Coverage by what and where, for programs."""
    return [
        {"what": what, "where": where, "right": right, "of": of, "interval": interval(right, of)}
        for (what, where), (right, of) in sorted(coverage(numbers).items())
    ]


def totals(scores: Sequence[Score], failed: Mapping[int, str]) -> dict[str, Any]:
    """The same for programs."""
    return {
        "pipes": [score.to_dict() for score in scores],
        "broke": {str(seed): why for seed, why in failed.items()},
        "coverage": coverage_rows(one for score in scores for one in score.numbers),
    }
