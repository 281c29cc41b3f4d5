"""An uncertainty budget by the GUM (JCGM 100:2008): contributions of type A and B, what dominates, and what a value
keeps in 19 of 20.

A bias is stated and not taken off: users of a head see its values as they come. The expanded uncertainty therefore
covers it: U is the half-width about the value within which the true one lies with CONFIDENCE, for an error that is
distributed as the bias plus u times Student's t with the effective degrees of freedom (Welch and Satterthwaite,
JCGM 100, G.4).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from annulus_pipe.numeric.late import optimize, stats
from annulus_pipe.qualification.precision import CONFIDENCE


@dataclass(frozen=True, slots=True)
class Contribution:
    """One source of error. u : its standard uncertainty, percent of the diameter; dof : infinite where it is taken as
    known; kind : "A" by statistics of the study, "B" by other knowledge; source : where its number comes from."""

    name: str
    u: float
    dof: float
    kind: str
    source: str


@dataclass(frozen=True, slots=True)
class Budget:
    """u : combined standard uncertainty; U : expanded, with the bias in it; percent of the diameter. share : of each
    contribution in u squared, in the order of `rows`."""

    rows: tuple[Contribution, ...]
    u: float
    dof: float
    k: float
    U: float
    share: tuple[float, ...]

    @property
    def dominant(self) -> Contribution | None:
        """The contribution that says most of u; None where all are 0."""
        return max(self.rows, key=lambda row: row.u, default=None) if self.u > 0.0 else None


def budget(rows: Sequence[Contribution], bias: float) -> Budget:
    """rows and bias in percent of the diameter; contributions are independent."""
    u = math.sqrt(sum(row.u**2 for row in rows))
    fourth = sum(row.u**4 / row.dof for row in rows)  # G.2b; a contribution without spread has no degrees of freedom
    dof = u**4 / fourth if fourth > 0.0 else math.inf
    share = tuple(row.u**2 / u**2 if u > 0.0 else 0.0 for row in rows)
    expanded = _covering(abs(bias), u, dof)
    return Budget(tuple(rows), u, dof, (expanded - abs(bias)) / u if u > 0.0 else 0.0, expanded, share)


def _covering(bias: float, u: float, dof: float) -> float:
    """The half-width about 0 that holds CONFIDENCE of bias + u t(dof)."""
    if u == 0.0:
        return bias
    spread = stats.norm if math.isinf(dof) else stats.t(dof)

    def missing(half: float) -> float:
        return float(spread.cdf((half - bias) / u) - spread.cdf((-half - bias) / u)) - CONFIDENCE

    widest = bias + u * float(spread.ppf((1.0 + CONFIDENCE) / 2)) + u
    return float(optimize.brentq(missing, 0.0, widest))
