"""Whether measurements bear out what a specification claims: so many of them within a tolerance, out of so many.

A claim says that a stated part of all measurements (its certainty) lies within a tolerance of the truth: "80 % within
± 0.5 mm". Each measurement that somebody checked lies within or not, so what is known of the true part is an exact
binomial interval (Clopper and Pearson 1934), and the claim is judged by where that interval lies:

    accepted    its lower end is at or above the certainty
    rejected    its upper end is below the certainty
    open        the certainty lies inside: these measurements say neither (the "grey" outcome)

These are the three outcomes of PRCI IM-1-06 for level 2 of API 1163 (3rd edition, 2021). Level 2 itself asks one side
only, whether the tool is worse than it claims, which is the exact binomial test (`ClaimJudgement.one_sided`).

At hand were the abstracts of PRCI IM-1-06, of McNealy and others (IPC2006) and the begin of API 1163's Annex C.1, not
their tables; the intervals are held against published binomial tables instead (tests/unit/qualification).
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from annulus_pipe.numeric.late import special
from annulus_pipe.untrusted import mapping, whole, within

CERTAINTY, CONFIDENCE = 0.80, 0.95  # what specifications of in-line tools state, where nobody says otherwise
COUNT_MAX = 10_000_000  # measurements: more are no validation that anybody dug for


class Outcome(StrEnum):
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    OPEN = "open"


@dataclass(frozen=True, slots=True)
class Proportion:
    """hits of n, and between what the true part lies with that confidence. value is NaN, and the interval 0 to 1, where
    there is no trial."""

    hits: int
    n: int
    value: float
    lower: float
    upper: float
    confidence: float

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"value": None if math.isnan(self.value) else self.value}

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> "Proportion":
        """Raises ValueError, one line, for what is none."""
        n = whole(found.get("n"), "n", 0, COUNT_MAX)
        hits = whole(found.get("hits"), "hits", 0, n)
        lower, upper, confidence = (
            within(found.get(name), name, 0.0, 1.0) for name in ("lower", "upper", "confidence")
        )
        return cls(hits, n, hits / n if n else math.nan, lower, upper, confidence)


@dataclass(frozen=True, slots=True)
class ClaimJudgement:
    """What `within` of n measurements say of a claim.

    outcome : of the two-sided interval `proportion`; also the as-run performance of API 1163's level 3.
    one_sided : REJECTED where the tool is worse than claimed with the confidence (API 1163 level 2), else OPEN: that
        test cannot accept.
    level : of API 1163, by what n measurements could decide: 1 nothing (the claim is neither proven nor disputed),
        2 they could reject it, 3 they could accept it as well.
    needed : how many more measurements, all within, would accept the claim; 0 where it is.
    """

    within: int
    n: int
    certainty: float
    confidence: float
    proportion: Proportion
    outcome: Outcome
    one_sided: Outcome
    level: int
    needed: int

    def statement(self) -> str:
        claim = f"{100 * self.certainty:.0f} % within tolerance"
        if not self.n:
            return f'The claim "{claim}" was not tried: {self.needed} measurements, all within, would accept it.'
        counted = (
            f"{self.within} of {self.n} within tolerance: {100 * self.proportion.lower:.0f} % to "
            f"{100 * self.proportion.upper:.0f} % of all with {100 * self.confidence:.0f} % confidence"
        )
        match self.outcome:
            case Outcome.ACCEPTED:
                return f'{counted}. The claim "{claim}" is accepted.'
            case Outcome.REJECTED:
                return f'{counted}. The claim "{claim}" is rejected.'
        more = f"{self.needed} more, all within, would accept it"
        worse = ", though the one-sided test rejects it" if self.one_sided is Outcome.REJECTED else ""
        return f'{counted}. The claim "{claim}" is open{worse}; {more}.'

    def to_dict(self) -> dict[str, Any]:
        return asdict(self) | {"proportion": self.proportion.to_dict()}

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> "ClaimJudgement":
        """Raises ValueError, one line, for what is none. Judges nothing again: a file is quoted as it was written."""
        n = whole(found.get("n"), "n", 0, COUNT_MAX)
        return cls(
            whole(found.get("within"), "within", 0, n),
            n,
            within(found.get("certainty"), "certainty", 0.0, 1.0),
            within(found.get("confidence"), "confidence", 0.0, 1.0),
            Proportion.from_dict(mapping(found.get("proportion"), "proportion")),
            Outcome(str(found.get("outcome"))),
            Outcome(str(found.get("one_sided"))),
            whole(found.get("level"), "level", 1, 3),
            whole(found.get("needed"), "needed", 0, COUNT_MAX),
        )


def proportion(hits: int, n: int, confidence: float = CONFIDENCE, sides: int = 2) -> Proportion:
    """The exact interval of Clopper and Pearson (1934). sides : 2, or 1 for a bound on each side that has the whole
    confidence by itself. Raises ValueError for hits beyond n and a confidence that is not between 0 and 1."""
    _require(hits, n, confidence)
    if not n:
        return Proportion(0, 0, math.nan, 0.0, 1.0, confidence)
    level = confidence if sides == 2 else 2.0 * confidence - 1.0  # two one-sided bounds are one wider interval
    if level <= 0.0:
        raise ValueError(f"a one-sided bound of {confidence:g} confidence says nothing, expected more than 0.5")
    beyond = (1.0 - level) / 2.0
    lower = float(special.betaincinv(hits, n - hits + 1, beyond)) if hits else 0.0
    upper = float(special.betaincinv(hits + 1, n - hits, 1.0 - beyond)) if hits < n else 1.0
    return Proportion(hits, n, hits / n, lower, upper, confidence)


def judge_claim(
    within_tolerance: int, n: int, certainty: float = CERTAINTY, confidence: float = CONFIDENCE
) -> ClaimJudgement:
    """Judges the claim that `certainty` of all measurements lie within tolerance, of which n were checked.

    Raises ValueError for counts and parts that are none.
    """
    _require(within_tolerance, n, confidence, certainty)
    as_run = proportion(within_tolerance, n, confidence)
    worse = n > 0 and proportion(within_tolerance, n, confidence, sides=1).upper < certainty
    return ClaimJudgement(
        within_tolerance,
        n,
        certainty,
        confidence,
        as_run,
        _outcome(as_run, certainty),
        Outcome.REJECTED if worse else Outcome.OPEN,
        _level(n, certainty, confidence),
        needed(within_tolerance, n, certainty, confidence),
    )


def needed(within_tolerance: int, n: int, certainty: float = CERTAINTY, confidence: float = CONFIDENCE) -> int:
    """How many more measurements, all within, accept the claim: 17 of none for 80 %, 36 for 90 %, 95 % confidence."""
    _require(within_tolerance, n, confidence, certainty)

    def accepted(more: int) -> bool:
        return proportion(within_tolerance + more, n + more, confidence).lower >= certainty

    if accepted(0):
        return 0
    few, many = 0, 1
    while not accepted(many):
        few, many = many, 2 * many
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if accepted(middle) else (middle, many)
    return many


def _outcome(as_run: Proportion, certainty: float) -> Outcome:
    if as_run.lower >= certainty:
        return Outcome.ACCEPTED
    return Outcome.REJECTED if as_run.upper < certainty else Outcome.OPEN


def _level(n: int, certainty: float, confidence: float) -> int:
    if _outcome(proportion(n, n, confidence), certainty) is Outcome.ACCEPTED:
        return 3
    return 2 if _outcome(proportion(0, n, confidence), certainty) is Outcome.REJECTED else 1


def _require(hits: int, n: int, confidence: float, certainty: float = CERTAINTY) -> None:
    if not 0 <= hits <= n:
        raise ValueError(f"{hits} of {n} measurements, expected no more than there are")
    for name, part in (("confidence", confidence), ("certainty", certainty)):
        if not 0.0 < part < 1.0:
            raise ValueError(f"a {name} of {part:g}, expected a part between 0 and 1")
