"""From the runs of a gauge study to a certificate, and from later runs to whether that certificate still holds.

certificate = certified(plan, readings, conditions, issued)   # signed by `signature.sign` of its content
check = compared(certificate, plan, later)                    # check.upheld
"""

import calendar
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date, timedelta
from itertools import zip_longest

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import stats
from annulus_pipe.qualification.budget import Contribution, budget
from annulus_pipe.qualification.certificate import (
    CLOCKS_APART,
    Accuracy,
    BudgetRow,
    Certificate,
    CertificateScope,
    CertifiedPiece,
    CertifiedRun,
    ProfilerForm,
)
from annulus_pipe.qualification.plan import MONTHS_MAX, ReferencePiece, StudyPlan, StudyRun
from annulus_pipe.qualification.precision import Components, Variance, components, precision
from annulus_pipe.vocabulary import AnnulusError

SIGNIFICANCE = 0.025  # of the F test of `compared`: so many good heads it refuses; guarded by test_certificate.py
TWICE = 2.0  # how much worse a head is that a plan is asked about: what a check must notice
POWER = 0.95  # in how many studies such a head has to be refused; below, `annulus certify plan` says what to add
FAR_PERCENT = 5.0  # of its diameter: ten times what owners ask of a profiler; no head that scans a pipe errs by it ..
APART_PERCENT = 1.0  # .. nor by so much more of one piece than of the study's others
UNITS = {25.4: "inches", 10.0: "centimetres"}  # in mm; a plan in metres or feet has no diameter that is one
SAME_PART, SAME_PERCENT = 1e-6, 1e-9  # of numbers that follow from the same readings: another machine's rounding
DAYS_A_MONTH = 30.5  # on average over some years, rounded up
ASKED_OPERATORS = 6  # laboratories that E691, section 9, asks for


@dataclass(frozen=True, slots=True)
class GaugeReading:
    """What one run read of one piece. diameter_mm : mean of its stations; error_direction : percent, the largest of any
    station's smallest and largest diameter; ovality_percent : ASTM F1216, the largest; stations : how many.
    drift_percent : standard uncertainty of all its diameters by what the optics may have drifted by, as the scan
    states it; results : digits that name them."""

    run: StudyRun
    piece: ReferencePiece
    diameter_mm: float
    error_direction: float
    ovality_percent: float
    stations: int
    drift_percent: float
    results: str

    @property
    def error(self) -> float:
        """Percent of the piece's diameter."""
        return 100.0 * (self.diameter_mm / self.piece.diameter_mm - 1.0)


@dataclass(frozen=True, slots=True)
class Conditions:
    """What all runs have in common; "" where they do not say. days : of the first and last run; None: nobody knows."""

    calibration: str = ""
    firmware: str = ""
    software: str = ""
    lens: str = ""
    points_per_picture: float = math.nan
    days: tuple[date, date] | None = None


@dataclass(frozen=True, slots=True)
class CertificateCheck:
    """Whether later runs bear a certificate out. reasons : against it, or what was compared."""

    upheld: bool
    reasons: tuple[str, ...]


def certified(plan: StudyPlan, readings: Sequence[GaugeReading], conditions: Conditions, issued: date) -> Certificate:
    """The certificate of a whole study, not yet signed. readings : of every run and piece of the plan, once."""
    errors, kelvin = _cube(plan, readings)
    parts = components(errors, kelvin, shared=plan.one_pull)
    slope = parts.per_kelvin
    rows = _contributions(plan, parts, kelvin)
    drift = max((one.drift_percent for one in readings), default=0.0)
    own = budget(rows, parts.mean)
    drifting = Contribution(
        "drift of the optics until the next use", drift, math.inf, "B", "as the scans state it without a reference"
    )
    accuracy = Accuracy(
        bias=parts.bias(_reference_u(plan)),
        s_r=parts.repeatability(),
        s_R=parts.reproducibility(),
        u=own.u,
        dof=None if math.isinf(own.dof) else float(own.dof),
        k=own.k,
        U=own.U,
        U_drift=budget((*rows, drifting), parts.mean).U,
        worst=float(np.abs(errors).max()),
        worst_direction=max(one.error_direction for one in readings),
        per_kelvin=slope,
        repeat_dof=float(parts.repeats.dof),
    )
    return Certificate(
        plan.title,
        plan.laboratory,
        _scope(plan, readings, conditions, issued),
        plan.operators,
        plan.repeats,
        accuracy,
        tuple(
            BudgetRow(row.name, row.u, share, None if math.isinf(row.dof) else float(row.dof), row.kind, row.source)
            for row, share in zip(own.rows, own.share, strict=True)
        ),
        tuple(_pieces(plan, errors)),
        ProfilerForm(
            0.0 if math.isnan(conditions.points_per_picture) else conditions.points_per_picture,
            max(one.ovality_percent for one in readings),
            conditions.lens,
        ),
        tuple(_runs(readings)),
        tuple(_left_open(plan, kelvin, slope is not None, conditions.days is not None)),
    )


def require_own_pieces(plan: StudyPlan, readings: Sequence[GaugeReading], where: str) -> None:
    """AnnulusError for a reading that is not of the piece it stands for, by its size, and for the same results twice: a
    study of mixed units, or of pieces that were mistaken, would certify a head of some percent."""
    middle = float(np.median([one.error for one in readings]))
    first: dict[str, int] = {}
    for one in readings:
        run, stated = one.run.number, f"piece {one.piece.name}, {one.piece.diameter_mm:g} mm"
        if first.setdefault(one.results, run) != run:
            raise AnnulusError(f"{where}: run {run} has the results of run {first[one.results]}, expected its own")
        away = abs(one.error - middle)
        for other in plan.pieces:
            there = abs(100.0 * (one.diameter_mm / other.diameter_mm - 1.0) - middle)
            if away > APART_PERCENT and there < away / 4:
                raise AnnulusError(
                    f"{where}: run {run} reads {one.diameter_mm:.2f} mm of {stated}. That is the size of {other.name}"
                )
        if not abs(one.error) <= FAR_PERCENT:
            parts = (one.diameter_mm / one.piece.diameter_mm / mm for mm in UNITS)
            unit = [name for name, part in zip(UNITS.values(), parts, strict=True) if abs(part - 1) < FAR_PERCENT / 100]
            hint = f"The plan's diameters look like {unit[0]}" if unit else "Is it of another piece?"
            raise AnnulusError(f"{where}: run {run} reads {one.diameter_mm:.2f} mm of {stated}. {hint}")


def _cube(plan: StudyPlan, readings: Sequence[GaugeReading]) -> tuple[FloatArray, FloatArray]:
    """Errors (q, p, n) in percent, and temperatures in degrees Celsius."""
    shape = (len(plan.pieces), len(plan.operators), plan.repeats)
    errors, celsius = np.full(shape, np.nan), np.full(shape, np.nan)
    pieces = {piece.name: i for i, piece in enumerate(plan.pieces)}
    operators = {name: i for i, name in enumerate(plan.operators)}
    for one in readings:
        at = pieces[one.piece.name], operators[one.run.operator], one.run.repeat - 1
        errors[at], celsius[at] = one.error, one.run.temperature_c
    if np.isnan(errors).any():
        raise ValueError(f"{int(np.isfinite(errors).sum())} readings, expected {errors.size}")
    return errors, celsius


def _reference_u(plan: StudyPlan) -> float:
    """Standard uncertainty that the pieces' diameters have in common, percent: one gauge measured them all."""
    return max(50.0 * piece.k2_mm / piece.diameter_mm for piece in plan.pieces)


def _contributions(plan: StudyPlan, parts: Components, celsius: FloatArray) -> tuple[Contribution, ...]:
    """What the error of one diameter, read by any operator, is made of."""
    q, p, n = parts.shape
    rows = [
        _type_a("repeats", parts.repeats, f"E691: s_r of {q * p} cells of {n}"),
        _type_a(
            "operators",
            parts.of_operators.times(1.0 + 1.0 / p),
            f"analysis of variance, {p} operators; another one against their mean",
        ),
    ]
    if q > 1:
        rows += [
            _type_a("operator with piece", parts.of_both, "analysis of variance"),
            _type_a("pieces differ", parts.of_pieces.times(1.0 + 1.0 / q), f"analysis of variance, {q} pieces"),
        ]
    rows += [
        _type_a("how well the bias is known", parts.of_mean, "standard deviation of the mean"),
        Contribution("reference pieces", _reference_u(plan), math.inf, "B", _measured(plan)),
    ]
    if parts.per_kelvin is not None:
        half = float(celsius.max() - celsius.min()) / 2
        rows.append(
            Contribution(
                "temperature within the range",
                math.hypot(*parts.per_kelvin) * half / math.sqrt(3.0),
                parts.of_mean.dof,
                "A",
                f"slope of the study over {2 * half:.3g} K, rectangular",
            )
        )
    return tuple(rows)


def _type_a(name: str, variance: Variance, source: str) -> Contribution:
    """Of a difference of mean squares that happens to be below 0 there is nothing."""
    if variance.value <= 0.0:
        return Contribution(name, 0.0, math.inf, "A", source)
    return Contribution(name, math.sqrt(variance.value), variance.dof, "A", source)


def _measured(plan: StudyPlan) -> str:
    return "; ".join(sorted({piece.measured_by for piece in plan.pieces if piece.measured_by})) or "as the plan states"


def _scope(plan: StudyPlan, readings: Sequence[GaugeReading], conditions: Conditions, issued: date) -> CertificateScope:
    diameters = [piece.diameter_mm for piece in plan.pieces]
    celsius = [one.run.temperature_c for one in readings]
    first, last = conditions.days or (issued, issued)
    if issued < last - CLOCKS_APART:
        raise AnnulusError(f"the last run is of {last}, after the day of issue, {issued}")
    month = first.month - 1 + plan.months  # from the first run on: an old study that is issued again is no newer for it
    year, month = first.year + month // 12, month % 12 + 1
    until = date(year, month, min(first.day, calendar.monthrange(year, month)[1]))
    if until < issued:
        raise AnnulusError(f"the first run is of {first}, and a certificate of it holds until {until}, before {issued}")
    return CertificateScope(
        plan.head,
        conditions.calibration,
        conditions.firmware,
        conditions.software,
        (min(diameters), max(diameters)),
        None if any(math.isnan(one) for one in celsius) else (min(celsius), max(celsius)),
        issued,
        until,
    )


def _pieces(plan: StudyPlan, errors: FloatArray) -> list[CertifiedPiece]:
    """E691 of each piece, of its readings as they came."""
    out = []
    for piece, own in zip(plan.pieces, errors, strict=True):
        stated = precision(piece.diameter_mm * (1.0 + own / 100.0))
        out.append(
            CertifiedPiece(
                piece.name,
                piece.diameter_mm,
                piece.k2_mm,
                piece.measured_by,
                stated.mean,
                stated.s_r,
                stated.s_R,
                tuple(float(h) for h in stated.h),
                tuple(float(k) for k in stated.k),
            )
        )
    return out


def _runs(readings: Sequence[GaugeReading]) -> list[CertifiedRun]:
    return [
        CertifiedRun(
            one.run.number,
            one.run.operator,
            one.piece.name,
            one.run.repeat,
            None if math.isnan(one.run.temperature_c) else one.run.temperature_c,
            one.diameter_mm,
            one.error,
            one.results,
        )
        for one in sorted(readings, key=lambda one: (one.run.number, one.piece.name))
    ]


def _left_open(plan: StudyPlan, celsius: FloatArray, sloped: bool, dated: bool) -> list[str]:
    out = []
    if not dated:
        out.append("the days of the runs: no scan states its own, and the validity counts from the day of issue")
    if len(plan.operators) < ASKED_OPERATORS:
        out.append(
            f"ASTM E691 asks for {ASKED_OPERATORS} laboratories; {len(plan.operators)} operators took part, and the "
            "interval of the reproducibility is as wide as that makes it"
        )
    if np.isnan(celsius).any():
        out.append("temperature: not every run has one, and none is certified")
    elif not sloped:
        out.append(
            "temperature: it did not differ within operator and piece, so that what it does is in none of the numbers"
        )
    if len(plan.pieces) < 2:
        out.append("other diameters: one piece was measured")
    out.append("defects, joints, levels and distances: their sizes and how surely they are detected (a POD says)")
    out.append("a wall that light enters farther than the pieces', a dirty lens, a pipe under water")
    return out


def disagreements(certificate: Certificate) -> list[str]:
    """What of a certificate does not follow from the readings that it lists, one reason each: a signature vouches for
    nobody's arithmetic. The drift of U_drift is in no reading; it can only add."""
    pieces = {one.name: ReferencePiece(one.name, one.diameter_mm, one.k2_mm) for one in certificate.pieces}
    one_pull = len({run.number for run in certificate.runs}) < len(certificate.runs)
    scope, stated = certificate.scope, certificate.accuracy
    plan = StudyPlan(
        certificate.title,
        scope.head,
        certificate.laboratory,
        certificate.operators,
        certificate.repeats,
        tuple(pieces.values()),
        one_pull=one_pull,
    )
    try:
        readings = [_read_again(one, pieces, stated) for one in certificate.runs]
        require_own_pieces(plan, readings, "its runs")
        again = certified(plan, readings, Conditions(days=(scope.issued, scope.issued)), scope.issued)
    except AnnulusError as error:
        return [str(error)]
    except (ValueError, LookupError):
        return ["its readings are not those of its pieces, operators and repeats, each once"]
    out = [
        f"its {name} is {found:.4g}, and its readings make it {made:.4g}"
        for name, found, made in _both(certificate, again)
        if not math.isclose(found, made, rel_tol=SAME_PART, abs_tol=SAME_PERCENT)
    ]
    if stated.U_drift < stated.U:
        out.append(f"its U with drift is {stated.U_drift:.4g}, less than without")
    if (scope.diameter_mm, scope.temperature_c) != (again.scope.diameter_mm, again.scope.temperature_c):
        out.append("its range of diameters or temperatures is not that of its readings")
    if [(one.name, one.kind) for one in certificate.budget] != [(one.name, one.kind) for one in again.budget]:
        out.append("its budget has other rows than its readings make")
    if len(certificate.left_open) < len(again.left_open):
        out.append(f"it leaves {len(certificate.left_open)} points open, and its readings {len(again.left_open)}")
    longest = scope.issued + timedelta(days=DAYS_A_MONTH * MONTHS_MAX) + CLOCKS_APART
    if not scope.issued <= scope.until <= longest:
        out.append(f"it holds from {scope.issued} until {scope.until}, and a plan allows {MONTHS_MAX} months")
    return out


def _read_again(run: CertifiedRun, pieces: Mapping[str, ReferencePiece], stated: Accuracy) -> GaugeReading:
    warm = math.nan if run.temperature_c is None else run.temperature_c
    made = StudyRun(run.number, run.operator, run.piece, run.repeat, warm)
    return GaugeReading(made, pieces[run.piece], run.diameter_mm, stated.worst_direction, 0.0, 0, 0.0, run.results)


def _both(certificate: Certificate, again: Certificate) -> Iterator[tuple[str, float, float]]:
    """Each number that follows from readings: as stated, and as they make it."""
    for name in ("bias", "s_r", "s_R"):
        for end in ("value", "low", "high"):
            found, made = (getattr(getattr(one.accuracy, name), end) for one in (certificate, again))
            yield f"{name}{'' if end == 'value' else f', {end}'}", found, made
    for name in ("u", "U", "k", "worst", "repeat_dof"):
        yield name, getattr(certificate.accuracy, name), getattr(again.accuracy, name)
    yield "number of degrees of freedom", _or_infinite(certificate.accuracy.dof), _or_infinite(again.accuracy.dof)
    yield from _each("slope with temperature", certificate.accuracy.per_kelvin, again.accuracy.per_kelvin)
    for row, made_row in zip(certificate.budget, again.budget, strict=False):  # that they are the same, others say
        yield f"u of {row.name}", row.u, made_row.u
        yield f"share of {row.name}", row.share, made_row.share
        yield f"degrees of freedom of {row.name}", _or_infinite(row.dof), _or_infinite(made_row.dof)
    for ours, theirs in zip(certificate.pieces, again.pieces, strict=True):
        yield f"mean of {ours.name}", ours.mean_mm, theirs.mean_mm
        yield f"s_r of {ours.name}", ours.s_r_mm, theirs.s_r_mm
        yield f"s_R of {ours.name}", ours.s_R_mm, theirs.s_R_mm
        yield from _each(f"h of {ours.name}", ours.h, theirs.h)
        yield from _each(f"k of {ours.name}", ours.k, theirs.k)
    listed = {(one.number, one.piece): one.error for one in certificate.runs}
    for one in again.runs:
        yield f"error of {one.piece} in run {one.number}", listed[one.number, one.piece], one.error


def _each(
    name: str, stated: Sequence[float] | None, made: Sequence[float] | None
) -> Iterator[tuple[str, float, float]]:
    """What one of them lacks is NaN, which is like nothing."""
    for found, other in zip_longest(stated or (), made or (), fillvalue=math.nan):
        yield name, found, other


def _or_infinite(dof: float | None) -> float:
    return math.inf if dof is None else dof


def compared(
    certificate: Certificate, plan: StudyPlan, readings: Sequence[GaugeReading], *, drifting: bool = True
) -> CertificateCheck:
    """Whether later runs of the same head bear its certificate out.

    Two tests: the repeatability of the runs against the certified one (F, at SIGNIFICANCE), and their mean error
    against the certified U, which a head as certified leaves more seldom than single errors do (1 of 20). Single errors
    are not counted: those of one operator go together, and 9 of 100 good heads were refused by their count.
    drifting : the scans have no reference section, so that U is the one with drift.
    """
    errors, celsius = _cube(plan, readings)
    parts, accuracy = components(errors, celsius, shared=plan.one_pull), certificate.accuracy
    reasons, upheld = list[str](), True
    s = math.sqrt(parts.repeats.value)
    ratio = parts.repeats.value / accuracy.s_r.value**2 if accuracy.s_r.value > 0.0 else math.inf
    most = float(stats.f.ppf(1.0 - SIGNIFICANCE, parts.repeats.dof, accuracy.repeat_dof))
    if ratio > most:
        upheld = False
    reasons.append(
        f"repeatability: s_r {s:.3g} % for {accuracy.s_r.value:.3g} %, a ratio of squares of {ratio:.3g}, "
        f"{'over' if ratio > most else 'within'} {most:.3g}"
    )
    allowed = accuracy.U_drift if drifting else accuracy.U
    if abs(parts.mean) > allowed:
        upheld = False
    reasons.append(
        f"mean error: {parts.mean:+.3g} %, {'outside of' if abs(parts.mean) > allowed else 'within'} ± {allowed:.3g} %"
    )
    return CertificateCheck(upheld, tuple(reasons))


def power(plan: StudyPlan) -> tuple[float, float]:
    """In how many of such studies a head that repeats TWICE as badly is refused by the first test of `compared`: where
    pieces of one run err alike, and where each errs by itself. Of runs that show one piece the two are one."""
    runs = len(plan.operators) * (plan.repeats - 1)
    apart = runs * len(plan.pieces)
    alike, each = (_power(dof) for dof in (runs if plan.one_pull else apart, apart))
    return alike, each


def _power(dof: int) -> float:
    most = float(stats.f.ppf(1.0 - SIGNIFICANCE, dof, dof))
    return float(stats.f.sf(most / TWICE**2, dof, dof))
