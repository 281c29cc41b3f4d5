"""POD against size from hits and misses: ASTM E2862, MIL-HDBK-1823A appendix G.4.

Assumed: each trial is independent, POD rises with size from 0 to 1, logit POD = b0 + b1 x with x the size or its
logarithm. Of the two the likelier makes the curve; while the other is nearly as likely, the larger a90/95 of both is
stated, for a choice made by the data is not free.

a90/95 is the size at which a lower 95 % confidence bound on POD reaches 90 %: in 95 of 100 such studies it is above
the true a90 (1823A, 3.2 "confidence"). The standards take it from the likelihood ratio: twice the loglikelihood lost by
holding a90 at a value is chi-squared, of one degree of freedom. With 60 to 120 targets that covers 91 to 94 %
(`python -m tools.bench pod`), so its signed root r is corrected to r* = r + log(q / r) / r (Barndorff-Nielsen 1986,
Biometrika 73, 307; Brazzale, Davison & Reid 2007, Applied Asymptotics, section 2.4), which covers what it says.

1823A prints bounds for hits and misses at chi-squared's 95 %, which is one-sided 97.5 %: `bound` with z = 1.96 and
corrected=False gives its numbers, digit by digit; what is stated here is the one-sided 95 % that it defines.

A target that was passed several times is one target: the loglikelihood of its trials is divided by their number, as
1823A's own program does, for they say more of that target and little more of its size.

What the data cannot say is not said: no misses, no hits, hits and misses that do not overlap, no rise with size, a
value outside of the sizes that were laid, or misses of large ones that no size explains. `why` says which, and
`least_pod` what can be said instead.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from annulus_pipe.extras import need
from annulus_pipe.numeric.arrays import FloatArray, IntArray
from annulus_pipe.numeric.late import optimize, special, stats
from annulus_pipe.qualification.validation import proportion
from annulus_pipe.vocabulary import AnnulusError

HIT_MISS = "ASTM E2862"
TARGETS_ASKED = 60  # MIL-HDBK-1823A, 4.5.2.2 b: "at least 60 targeted sites" for hits and misses
TARGETS_LEAST = 20  # below, no curve is fitted; of 20 and 30 what is stated was right in 96 to 99 % of 600 studies
POD, CONFIDENCE = 0.9, 0.95
# In loglikelihood: axes that differ by less are both considered. With it a90/95 covers 94 to 97 % whichever of them is
# true (tools/bench, table pod); without it 92 % of curves in the logarithm.
NEARLY_AS_LIKELY = 0.3
# In loglikelihood: by more, and hits and misses follow a POD that ends below 1 rather than one that does not. Twice it
# is the 95 % point of a likelihood ratio whose parameter lies at its bound (Self & Liang 1987): 1 of 20 good studies is
# refused. Without it, POD that ends at 88 % had an a90/95 in 54 of 100 studies of 120 (tests/unit/qualification).
ENDS_BELOW = 1.353
STEPS_MAX = 100  # of a Newton iteration, which ends after 5 to 10
TINY = 1e-12  # of a probability whose logarithm is asked for
CURVE_POINTS, CURVE_LEVELS = 60, 25  # of a curve for a picture: sizes, and POD whose bound is found


class SizeAxis(StrEnum):
    """What POD's logit is linear in."""

    LINEAR = "size"
    LOG = "log size"

    def of(self, size: FloatArray) -> FloatArray:
        return np.log(size) if self is SizeAxis.LOG else np.asarray(size, float)

    def back(self, x: float) -> float:
        return math.exp(min(x, 700.0)) if self is SizeAxis.LOG else x


@dataclass(frozen=True, slots=True)
class LeastPod:
    """Of the `laid` defects between two sizes, `detected` were: on average over these POD is at least `pod`, at 95 %
    confidence (Clopper & Pearson 1934, one-sided)."""

    from_mm: float
    to_mm: float
    laid: int
    detected: int
    pod: float


@dataclass(frozen=True, slots=True)
class Curve:
    """POD at sizes, and the lower bound of it at 95 % confidence; NaN where it is not known."""

    size_mm: tuple[float, ...]
    pod: tuple[float, ...]
    lower: tuple[float, ...]

    @classmethod
    def through(
        cls, size: FloatArray, pod: FloatArray, levels: Sequence[float], bounds: Sequence[float | None]
    ) -> "Curve":
        """bounds : the size at which POD is surely each of the levels, which rise: the lower bound there."""
        at = [(mm, one) for mm, one in zip(bounds, levels, strict=True) if mm is not None]
        lower = np.full(len(size), np.nan)
        if len(at) > 1:
            mm, level = (np.array(one) for one in zip(*at, strict=True))
            lower = np.interp(size, np.maximum.accumulate(mm), level, left=np.nan, right=np.nan)
        return cls(*(tuple(float(v) for v in one) for one in (size, pod, lower)))


@dataclass(frozen=True, slots=True)
class PodFit:
    """What a set of trials says. Sizes are None where nothing can be told, and `why` says for what reason.

    laid : targets, each of which may have had several of the `trials`, `detected` of them. axis : what it was fitted
    in. least : of all sizes laid, and of the larger half of them; detected there is what was in every trial.
    """

    method: str
    laid: int
    trials: int
    detected: int
    from_mm: float
    to_mm: float
    axis: str = ""
    a50_mm: float | None = None
    a90_mm: float | None = None
    a9095_mm: float | None = None
    why: str = ""
    least: tuple[LeastPod, ...] = ()
    curve: Curve | None = None


class Logistic:
    """logit POD = b0 + b1 x, by maximum likelihood, and the confidence bound of a size x at which POD is p."""

    def __init__(self, x: FloatArray, hit: FloatArray, weight: FloatArray | None = None) -> None:
        """x (N,), hit (N,) 0 or 1, which overlap; weight (N,) of each, 1. Raises AnnulusError without statsmodels."""
        sm = need("statsmodels.api")
        self.x, self.hit, self.weight = x, hit, np.ones(len(x)) if weight is None else weight
        model = sm.GLM(hit, sm.add_constant(x), family=sm.families.Binomial(), freq_weights=self.weight)
        fitted = model.fit(tol=1e-12, maxiter=STEPS_MAX)
        self.b0, self.b1 = (float(one) for one in fitted.params)
        self.loglikelihood = float(fitted.llf)
        known = self.weight * special.expit(self.b0 + self.b1 * x) * special.expit(-self.b0 - self.b1 * x)
        self._information = float(
            known.sum() * (known @ (x - x.mean()) ** 2) - (known @ (x - x.mean())) ** 2
        )  # its determinant

    def at(self, pod: float) -> float:
        """x at which POD is this."""
        return (float(special.logit(pod)) - self.b0) / self.b1

    def held(self, pod: float, x: float) -> tuple[float, float, float]:
        """With POD held at a value at x: slope, loglikelihood, and the slope's information there."""
        u, logit, slope = self.x - x, float(special.logit(pod)), self.b1
        if (self.weight * u) @ (self.hit - pod) <= 0:  # it falls from slope 0 on: POD is the same at every size
            return 0.0, self._of(np.full(len(u), logit)), float((self.weight * pod * (1 - pod)) @ u**2)
        best = self._of(logit + slope * u)
        for _ in range(STEPS_MAX):  # concave in the slope
            p = special.expit(logit + slope * u)
            step = float((self.weight * u) @ (self.hit - p)) / max(float((self.weight * p * (1 - p)) @ u**2), 1e-300)
            while True:
                value = self._of(logit + (slope + step) * u)
                if (slope + step > 0 and value >= best - 1e-13 * abs(best)) or abs(step) < 1e-12 * slope:
                    break
                step /= 2
            slope, best = slope + step, value
            if abs(step) < 1e-10 * slope:
                break
        p = special.expit(logit + slope * u)
        return slope, best, float((self.weight * p * (1 - p)) @ u**2)

    def root(self, pod: float, x: float, *, corrected: bool = True) -> float:
        """Signed root of the likelihood ratio of "POD is this at x", standard normal; positive above the estimate."""
        _, value, information = self.held(pod, x)
        r = math.copysign(math.sqrt(max(2 * (self.loglikelihood - value), 0.0)), x - self.at(pod))
        if not corrected:
            return r
        # both parameters are canonical: q is the logit's own departure, standardized by the information that is left
        q = (self.b0 + self.b1 * x - float(special.logit(pod))) * math.sqrt(self._information / information)
        return r + math.log(q / r) / r if r * q > 0 else math.nan

    def bound(self, pod: float, z: float, farthest: float, *, corrected: bool = True) -> float | None:
        """The largest x at which POD may be as low as this: root = z. None where it lies beyond `farthest`."""
        estimate = self.at(pod)
        near = estimate + 0.05 * z / self.b1 / math.sqrt(
            self.weight.sum()
        )  # the correction is 0/0 at the estimate itself
        if not near < farthest or not self.root(pod, farthest, corrected=corrected) >= z:
            return None
        if not self.root(pod, near, corrected=corrected) < z:
            return near

        def off(x: float) -> float:
            return self.root(pod, x, corrected=corrected) - z

        try:
            return float(optimize.brentq(off, near, farthest, xtol=1e-9 * abs(farthest - near)))
        except ValueError:  # the correction has no value somewhere between
            return None

    def gain_of_an_end(self) -> tuple[float, float]:
        """What the loglikelihood gains by a POD that ends below 1, and where it then ends."""
        z = (self.x - self.x.mean()) / self.x.std()
        start = self.b0 + self.b1 * self.x.mean(), self.b1 * self.x.std()

        def lost(at: FloatArray) -> float:
            pod = np.clip(special.expit(at[2]) * special.expit(at[0] + at[1] * z), TINY, 1 - TINY)
            return -float(self.weight @ np.where(self.hit > 0, np.log(pod), np.log1p(-pod)))

        found = [
            optimize.minimize(
                lost, [k * start[0], k * start[1], 2.0], method="L-BFGS-B", bounds=[(-200, 200), (0, 200), (-2, 12)]
            )
            for k in (1.0, 3.0)  # the curve may be much steeper where it need not reach 1
        ]
        best = min(found, key=lambda one: float(one.fun))
        return -float(best.fun) - self.loglikelihood, float(special.expit(best.x[2]))

    def _of(self, logit: FloatArray) -> float:
        return -float(self.weight @ np.logaddexp(0.0, np.where(self.hit > 0, -logit, logit)))


def fit_hit_miss(
    size_mm: Sequence[float],
    detected: Sequence[bool],
    axis: SizeAxis | None = None,
    *,
    target: Sequence[int] | None = None,
    curve: bool = True,
) -> PodFit:
    """POD against a size, and its a90/95.

    size_mm (N,) positive, detected (N,). axis : None takes the likelier. target : of which target each trial is; None,
    each of its own. curve : for a picture, which takes longer. Raises AnnulusError for sizes that are none, and without
    statsmodels.
    """
    size, hit = np.asarray(size_mm, float), np.asarray(detected, float)
    if size.shape != hit.shape or not np.all(np.isfinite(size) & (size > 0)):
        raise AnnulusError("a size of a defect is not a positive number of mm. Expected one for every trial.")
    if not len(size):
        return PodFit(HIT_MISS, 0, 0, 0, math.nan, math.nan, why="no defect of this kind was laid and judged")
    which, weight = shared(target, len(size))
    none = PodFit(HIT_MISS, len(np.unique(which)), len(size), int(hit.sum()), float(size.min()), float(size.max()))
    none = replace(none, least=least_pods(size, hit, which))
    why = _unfit(size, hit, none.laid)
    if why:
        return replace(none, why=why)
    fits = [(one, Logistic(one.of(size), hit, weight)) for one in ((axis,) if axis else SizeAxis)]
    fits = [(one, fit) for one, fit in fits if fit.b1 > 0]
    if not fits:
        return replace(none, why="POD does not rise with size in these trials")
    fits.sort(key=lambda one: -one[1].loglikelihood)
    used, best = fits[0]
    z = float(stats.norm.ppf(CONFIDENCE))
    likely = [one for one in fits if best.loglikelihood - one[1].loglikelihood < NEARLY_AS_LIKELY]
    found = stated(
        replace(none, axis=str(used), curve=_curve(used, best, none, z) if curve else None),
        (used.back(best.at(0.5)), used.back(best.at(POD))),
        [_bound_mm(one, fit, none.to_mm, z) for one, fit in likely],
    )
    return found if found.a9095_mm is None else _unless_it_ends(found, [fit for _, fit in likely])


def _unless_it_ends(found: PodFit, likely: Sequence[Logistic]) -> PodFit:
    """Without a90 and a90/95 where large ones are missed as well, whatever their size."""
    gained, end = min(fit.gain_of_an_end() for fit in likely)
    if gained <= ENDS_BELOW:
        return found
    why = f"misses do not follow from size: POD seems to end at {100 * end:.0f} %, however large"
    return replace(found, a50_mm=None, a90_mm=None, a9095_mm=None, curve=None, why=why)


def shared(target: Sequence[int] | None, trials: int) -> tuple[IntArray, FloatArray]:
    """Of which target each trial is, and the part of one that it counts for."""
    which = np.arange(trials) if target is None else np.asarray(target, np.int64)
    _, at, count = np.unique(which, return_inverse=True, return_counts=True)
    return which, 1.0 / count[at]


def stated(fit: PodFit, estimates: tuple[float, float], bounds: Sequence[float | None]) -> PodFit:
    """With a50, a90 and the largest of the bounds, as far as they lie within the sizes laid; None: it lies beyond."""
    a50, a90 = (one if fit.from_mm <= one <= fit.to_mm else None for one in estimates)
    known = [one for one in bounds if one is not None]
    if len(known) < len(bounds):
        what = "a90" if estimates[1] > fit.to_mm else "a90/95"
        return replace(fit, a50_mm=a50, a90_mm=a90, why=f"{what} lies beyond the largest laid, {fit.to_mm:.2f} mm")
    # a bound below the smallest laid: POD is larger still there, and nothing smaller was laid
    return replace(fit, a50_mm=a50, a90_mm=a90, a9095_mm=max(*known, fit.from_mm))


def least_pods(size: FloatArray, hit: FloatArray, target: IntArray) -> tuple[LeastPod, ...]:
    """Of all sizes, and of the larger half: a part that was named before anybody knew what was detected."""
    at = [np.flatnonzero(target == one) for one in np.unique(target)]
    size, hit = np.array([size[one].mean() for one in at]), np.array([hit[one].min() for one in at])
    out = [_least(size, hit)]
    larger = size >= np.median(size)
    if 0 < larger.sum() < len(size):
        out.append(_least(size[larger], hit[larger]))
    return tuple(out)


def _least(size: FloatArray, hit: FloatArray) -> LeastPod:
    laid, detected = len(size), int(hit.sum())
    pod = proportion(detected, laid, CONFIDENCE, sides=1).lower
    return LeastPod(float(size.min()), float(size.max()), laid, detected, pod)


def _unfit(size: FloatArray, hit: FloatArray, laid: int) -> str:
    """Why no curve can be fitted; "" where one can."""
    if laid < TARGETS_LEAST:
        return f"{laid} laid, at least {TARGETS_ASKED} are asked for (MIL-HDBK-1823A, 4.5.2.2)"
    if hit.all():
        return "all were detected: no curve can be fitted, smaller ones would have to be laid"
    if not hit.any():
        return "none was detected: no curve can be fitted, larger ones would have to be laid"
    if size.min() == size.max():
        return "all laid were of one size: it says nothing of others"
    if size[hit == 0].max() <= size[hit == 1].min():
        return "hits and misses do not overlap: a curve of any steepness fits, more would have to be laid between"
    return ""


def _bound_mm(axis: SizeAxis, fit: Logistic, largest_mm: float, z: float, pod: float = POD) -> float | None:
    found = fit.bound(pod, z, float(axis.of(np.array(largest_mm))))
    return None if found is None else axis.back(found)


def _curve(axis: SizeAxis, fit: Logistic, none: PodFit, z: float) -> Curve:
    size = np.linspace(none.from_mm, none.to_mm, CURVE_POINTS)
    pod = special.expit(fit.b0 + fit.b1 * axis.of(size))
    levels = [float(one) for one in special.expit(np.linspace(-4.0, 5.0, CURVE_LEVELS))]
    return Curve.through(size, pod, levels, [_bound_mm(axis, fit, none.to_mm, z, one) for one in levels])
