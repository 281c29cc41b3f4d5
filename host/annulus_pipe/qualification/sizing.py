"""How far off reported sizes are: mean, spread, and a tolerance that a stated part of all errors keeps.

A tolerance T at 80 % certainty and 95 % confidence: with 95 % confidence at least 80 % of all errors lie within ± T
(the terms of API 1163). Where there are enough errors it is distribution-free: the r-th smallest |error|, r the least
with P(binomial(n, certainty) < r) >= confidence (Wilks 1941), which needs 14 errors for 80 % and 29 for 90 %. From five
on it is |mean| + k s with the exact two-sided factor of normal errors (Odeh 1978; ISO 16269-6, Annex F), and says that
it takes them for normal. Below that it cannot be told.

The truths' own uncertainty is inside every number here: an error is what was reported less what the other measurement
found. It makes a tolerance larger, never smaller, so it is left in; `sd_own_mm` has it taken off.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import cache
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import optimize, stats
from annulus_pipe.numeric.rounding import MEASURE, digits_k2, quoted
from annulus_pipe.qualification.validation import CONFIDENCE, COUNT_MAX, ClaimJudgement, judge_claim
from annulus_pipe.untrusted import mapping, number, shown, whole, within

CERTAINTIES = (0.80, 0.90)
MM_MAX = 1e6  # of a size or its error: a kilometre
# Errors that a normal tolerance is made of: of fewer the factor is above 4 (80 %, 95 % confidence), and nothing could
# show that they are not normal. tests/unit/qualification/test_sizing.py holds the bounds to their confidence.
NORMAL_LEAST = 5
ABSCISSAE = 48  # of the mean's distribution: the factor's fourth decimal does not change with more


class Basis(StrEnum):
    """What a tolerance rests on."""

    DISTRIBUTION_FREE = "distribution-free"
    NORMAL = "normal errors"
    NONE = "too few"


@dataclass(frozen=True, slots=True)
class SizedPair:
    """One size as reported and as another measurement found it, mm. true_u_mm: that one's expanded uncertainty (k = 2),
    None where nobody stated it. at_least: what is reported is a lower limit, so how far it is off is not known."""

    reported_mm: float
    true_mm: float
    true_u_mm: float | None = None
    at_least: bool = False


@dataclass(frozen=True, slots=True)
class SizingClaim:
    """A tolerance that somebody claims, and what the errors say of it (API 1163, levels 1 to 3). An error is within
    when it is no larger than claim and true size's own uncertainty together, the root of the sum of squares."""

    tolerance_mm: float
    judgement: ClaimJudgement

    @classmethod
    def of(cls, pairs: Iterable[SizedPair], tolerance_mm: float, certainty: float, confidence: float) -> "SizingClaim":
        """Lower limits say nothing of it. Raises ValueError for a tolerance or a certainty that is none."""
        if not 0.0 < tolerance_mm <= MM_MAX:
            raise ValueError(f"a tolerance of {tolerance_mm:g} mm, expected more than 0")
        known = [one for one in pairs if not one.at_least]
        inside = [abs(one.reported_mm - one.true_mm) <= math.hypot(tolerance_mm, one.true_u_mm or 0.0) for one in known]
        return cls(tolerance_mm, judge_claim(sum(inside), len(known), certainty, confidence))

    def statement(self) -> str:
        return f"claim of ± {quoted(self.tolerance_mm, MEASURE)}: {self.judgement.statement()}"


@dataclass(frozen=True, slots=True)
class SizingTolerance:
    """`certainty` of all errors lie within ± tolerance_mm, with `confidence`. needed: errors that it takes at least,
    where tolerance_mm is NaN."""

    certainty: float
    confidence: float
    tolerance_mm: float
    basis: Basis
    needed: int

    def statement(self, n: int) -> str:
        what = f"tolerance at {100 * self.certainty:.0f} % certainty, {100 * self.confidence:.0f} % confidence"
        if self.basis is Basis.NONE:
            return f"{what}: cannot be told, {n} of {self.needed} errors needed"
        return f"{what}: ± {digits_k2(self.tolerance_mm, MEASURE)} mm ({self.basis})"


@dataclass(frozen=True, slots=True)
class Sizing:
    """Errors of n sizes, reported less true, mm; NaN where n does not say.

    mean_k_mm : half of the mean's interval (Student's t, with `confidence`). sd_own_mm : sd_mm with what the truths may
    be off taken off; 0 where that explains all of it, NaN where the truths state nothing. left_out : lower limits, of
    which no error is known. without_u : truths that state no uncertainty. claim : what somebody claims of them.
    """

    n: int
    left_out: int
    without_u: int
    confidence: float
    mean_mm: float
    mean_k_mm: float
    sd_mm: float
    sd_own_mm: float
    tolerances: tuple[SizingTolerance, ...]
    claim: SizingClaim | None = None

    def statement(self) -> list[str]:
        lines = []
        if self.n:
            mean = f"mean error {quoted(self.mean_mm, MEASURE, self.mean_k_mm)}"
            if math.isfinite(self.sd_mm):
                mean += f" ({100 * self.confidence:.0f} % confidence), "
                mean += f"standard deviation {digits_k2(self.sd_mm, MEASURE)} mm"
            lines.append(f"{mean}, of {self.n} sizes")
        if self.n and self.sd_own_mm == 0.0:
            lines.append("the errors are no larger than what the true sizes may be off themselves")
        elif math.isfinite(self.sd_own_mm):
            own = digits_k2(self.sd_own_mm, MEASURE)
            lines.append(f"standard deviation without what the true sizes may be off: {own} mm")
        lines += [one.statement(self.n) for one in self.tolerances]
        if self.claim is not None:
            lines.append(self.claim.statement())
        if self.left_out:
            lines.append(f"left out, reported as lower limits: {self.left_out}")
        if self.without_u:
            lines.append(f"true sizes without an uncertainty, which counts as the tool's: {self.without_u}")
        return lines

    def to_dict(self) -> dict[str, Any]:
        found = asdict(self)
        found["tolerances"] = [_without_nan(asdict(one)) for one in self.tolerances]
        if self.claim is not None:
            found["claim"] = self.claim.judgement.to_dict() | {"tolerance_mm": self.claim.tolerance_mm}
        return _without_nan(found)

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> "Sizing":
        """Raises ValueError, one line, for what is none."""
        listed = found.get("tolerances")
        if not isinstance(listed, Sequence) or isinstance(listed, str) or len(listed) > 10:
            raise ValueError("tolerances must be a list of at most 10")
        tolerances = tuple(_tolerance(mapping(one, f"tolerances, entry {i},")) for i, one in enumerate(listed, 1))
        return cls(
            whole(found.get("n"), "n", 0, COUNT_MAX),
            whole(found.get("left_out"), "left_out", 0, COUNT_MAX),
            whole(found.get("without_u"), "without_u", 0, COUNT_MAX),
            within(found.get("confidence"), "confidence", 0.0, 1.0),
            _maybe(found, "mean_mm"),
            _maybe(found, "mean_k_mm"),
            _maybe(found, "sd_mm"),
            _maybe(found, "sd_own_mm"),
            tolerances,
            None if found.get("claim") is None else _claim(mapping(found["claim"], "claim")),
        )


def size_errors(
    pairs: Iterable[SizedPair],
    certainties: Sequence[float] = CERTAINTIES,
    confidence: float = CONFIDENCE,
    claim: tuple[float, float] | None = None,
) -> Sizing:
    """Mean, spread and tolerances of reported less true. claim : a tolerance, mm, and the certainty with which it is
    claimed. Raises ValueError for a size that is no number, and for a certainty or confidence that is not between 0
    and 1."""
    pairs, known, left_out = list(pairs), [], 0
    for pair in pairs:
        if not (abs(pair.reported_mm) <= MM_MAX and abs(pair.true_mm) <= MM_MAX):
            raise ValueError(f"a size of {pair.reported_mm:g} against {pair.true_mm:g} mm, expected numbers")
        if pair.at_least:
            left_out += 1
        else:
            known.append(pair)
    for name, part in (("confidence", confidence), *(("certainty", one) for one in certainties)):
        if not 0.0 < part < 1.0:
            raise ValueError(f"a {name} of {part:g}, expected a part between 0 and 1")
    error = np.array([one.reported_mm - one.true_mm for one in known])
    stated = [one.true_u_mm / 2.0 for one in known if one.true_u_mm is not None]
    n, mean, spread, half, own = len(error), math.nan, math.nan, math.nan, math.nan
    if n:
        mean = float(error.mean())
    if n > 1:
        spread = float(error.std(ddof=1))
        half = float(stats.t.ppf((1.0 + confidence) / 2.0, n - 1)) * spread / math.sqrt(n)
        if stated:
            own = math.sqrt(max(spread**2 - sum(u * u for u in stated) / n, 0.0))
    tolerances = tuple(_sizing_tolerance(error, mean, spread, part, confidence) for part in certainties)
    claimed = None if claim is None else SizingClaim.of(pairs, *claim, confidence)
    return Sizing(n, left_out, n - len(stated), confidence, mean, half, spread, own, tolerances, claimed)


def order_needed(certainty: float, confidence: float = CONFIDENCE) -> int:
    """Fewest errors of which the largest is a distribution-free tolerance: 14 for 80 %, 29 for 90 % (95 %)."""
    return math.ceil(math.log(1.0 - confidence) / math.log(certainty))


def order_statistic(n: int, certainty: float, confidence: float = CONFIDENCE) -> int | None:
    """Which of n |errors| in order (1 the smallest) is a distribution-free tolerance; None where n is too few."""
    rank = int(stats.binom.ppf(confidence, n, certainty)) + 1  # the least r with P(X <= r - 1) >= confidence
    return rank if n >= order_needed(certainty, confidence) and rank <= n else None


@cache
def normal_factor(n: int, certainty: float, confidence: float = CONFIDENCE) -> float:
    """k of mean ± k s, which holds `certainty` of a normal population with `confidence`; exact, of n >= 2.

    Given the mean's own departure z, the half-width that holds the part is the root of a non-central chi-square's
    quantile, and s is large enough with the chi-square's probability; averaged over z, it is solved for k (Odeh 1978).
    """
    node, weight = np.polynomial.legendre.leggauss(ABSCISSAE)
    reach = 8.0 / math.sqrt(n)  # 8 standard deviations of the mean
    z = reach * node
    weight = weight * reach * stats.norm.pdf(z, scale=1.0 / math.sqrt(n))
    half_squared = stats.ncx2.ppf(certainty, 1, z * z)

    def short(k: float) -> float:
        return float(weight @ stats.chi2.sf((n - 1) * half_squared / k**2, n - 1)) - confidence

    return float(optimize.brentq(short, 1e-3, 1e6, xtol=1e-10))


def _sizing_tolerance(
    error: FloatArray, mean: float, spread: float, certainty: float, confidence: float
) -> SizingTolerance:
    rank = order_statistic(len(error), certainty, confidence)
    if rank is not None:
        size = float(np.sort(np.abs(error))[rank - 1])
        return SizingTolerance(certainty, confidence, size, Basis.DISTRIBUTION_FREE, 0)
    if len(error) < NORMAL_LEAST:
        return SizingTolerance(certainty, confidence, math.nan, Basis.NONE, NORMAL_LEAST)
    size = abs(mean) + normal_factor(len(error), certainty, confidence) * spread
    return SizingTolerance(certainty, confidence, size, Basis.NORMAL, 0)


def _tolerance(found: Mapping[str, Any]) -> SizingTolerance:
    certainty, confidence = (within(found.get(name), name, 0.0, 1.0) for name in ("certainty", "confidence"))
    size, basis = _maybe(found, "tolerance_mm"), Basis(str(found.get("basis")))
    if (basis is Basis.NONE) != math.isnan(size):
        raise ValueError(f"tolerance_mm is {shown(found.get('tolerance_mm'))} of {basis}")
    return SizingTolerance(certainty, confidence, size, basis, whole(found.get("needed"), "needed", 0, COUNT_MAX))


def _maybe(found: Mapping[str, Any], name: str) -> float:
    value = found.get(name)
    return math.nan if value is None else number(value, name, MM_MAX)


def _claim(found: Mapping[str, Any]) -> SizingClaim:
    return SizingClaim(within(found.get("tolerance_mm"), "tolerance_mm", 0.0, MM_MAX), ClaimJudgement.from_dict(found))


def _without_nan(found: dict[str, Any]) -> dict[str, Any]:
    return {name: None if isinstance(one, float) and math.isnan(one) else one for name, one in found.items()}
