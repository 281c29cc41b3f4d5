"""What a head detects: the value that `annulus pod fit` writes as pod.json, and that reports quote.

For every kind of defect and each of its dimensions POD and a90/95 by hits and misses (ASTM E2862), of depths also by
what was reported of them (E3023); all together, and apart beside a joint and away from one. Beside them false calls per
100 m, whether kinds are named right, how far off depths are, and what was left out.

It says nothing outside of the sizes that were laid, of another head, or of another program. Reading it back takes
neither statsmodels nor the trials.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from annulus_pipe.numeric.late import stats
from annulus_pipe.numeric.rounding import MEASURE, digits, digits_k2
from annulus_pipe.qualification.applicability import Applicability, HeadInUse, ScopeCheck
from annulus_pipe.qualification.hit_miss import (
    CONFIDENCE,
    CURVE_POINTS,
    TARGETS_ASKED,
    Curve,
    LeastPod,
    PodFit,
    SizeAxis,
    fit_hit_miss,
)
from annulus_pipe.qualification.signal_response import LEFT, MEASURED, RIGHT, ResponseLine, fit_signal_response
from annulus_pipe.qualification.sizing import SizedPair, Sizing, size_errors
from annulus_pipe.qualification.trials import JUDGED, KINDS, Pull, Trial, Trials, TrialState
from annulus_pipe.qualification.validation import Proportion, proportion
from annulus_pipe.untrusted import mapping, number, parse_json, printable, read_file, shown, whole, within
from annulus_pipe.untrusted import text as raw_text
from annulus_pipe.vocabulary import AnnulusError

FORMAT = "annulus-pod/1"
FILE_MAX = 1 << 22  # bytes; a study of two kinds has 60 kB
COUNT_MAX = 100_000_000
MM_MAX = 1e8
ROWS_MAX, NAMES_MAX, TEXT_MAX = 200, 1000, 400
DIMENSIONS = ("depth", "length", "width")
ALL, BESIDE, AWAY = "all", "beside a joint", "away from joints"
WHERE: Mapping[str, bool | None] = {ALL: None, BESIDE: True, AWAY: False}
PER_M = 100.0  # false calls are stated per so many metres
CALLED = {"loss": "wall loss", "bump": "bumps"}


@dataclass(frozen=True, slots=True)
class PodRow:
    """POD of one kind against one dimension, somewhere. response : of depths, with the line it follows from."""

    kind: str
    dimension: str
    where: str
    fit: PodFit
    response: PodFit | None = None
    line: ResponseLine | None = None

    def statement(self) -> str:
        """One line: "a90/95 2.10 mm (depth of wall loss; 64 laid, 51 detected; ASTM E2862)"."""
        fit, kind = self.fit, CALLED.get(self.kind, self.kind)
        of = f"{self.dimension} of {kind}" + ("" if self.where == ALL else f", {self.where}")
        if fit.a9095_mm is None:
            return f"a90/95 not established ({of}): {fit.why}"
        laid = f"{fit.laid} laid from {digits(fit.from_mm, MEASURE)} to {digits(fit.to_mm, MEASURE)} mm"
        if fit.laid < TARGETS_ASKED:
            laid += f" where {TARGETS_ASKED} are asked for"
        if fit.trials != fit.laid:
            laid += f", passed {fit.trials} times"
        return f"a90/95 {digits_k2(fit.a9095_mm, MEASURE)} mm ({of}; {laid}, {fit.detected} detected; {fit.method})"


@dataclass(frozen=True, slots=True)
class FalseCalls:
    """Listed where nothing lay, over what was seen of pipes whose every defect is known; per 100 m with the exact
    interval of a Poisson count (Garwood 1936). NaN where nobody said how much was inspected.

    inspected_m : of all pulls. pipe_m : of different pipes. One that is passed again has the same wall to call falsely:
    the interval is that of one pass, whose count is the mean of all.
    """

    count: int
    inspected_m: float
    per_100_m: float
    lower: float
    upper: float
    confidence: float
    pipe_m: float

    @classmethod
    def of(
        cls, count: int, inspected_m: float, confidence: float = CONFIDENCE, pipe_m: float | None = None
    ) -> "FalseCalls":
        """pipe_m : None where no pipe was passed again."""
        if not inspected_m > 0:
            return cls(count, math.nan, math.nan, math.nan, math.nan, confidence, math.nan)
        own_m = inspected_m if pipe_m is None else min(pipe_m, inspected_m)
        tail, share, once = (1.0 - confidence) / 2, PER_M / own_m, count * own_m / inspected_m
        lower = float(stats.chi2.ppf(tail, 2 * once)) / 2 if count else 0.0
        upper = float(stats.chi2.isf(tail, 2 * once + 2)) / 2
        return cls(count, inspected_m, once * share, lower * share, upper * share, confidence, own_m)

    def statement(self) -> str:
        if math.isnan(self.inspected_m):
            return "false calls: not established, the trials do not say how much was inspected"
        again = f" ({self.pipe_m:.3g} m of pipe, passed again)" if self.pipe_m < 0.99 * self.inspected_m else ""
        return (
            f"false calls: {self.count} in {self.inspected_m:.3g} m{again}, {_rate(self.per_100_m)} per 100 m"
            f" ({_rate(self.lower)} to {_rate(self.upper)}, {100 * self.confidence:.0f} % confidence)"
        )


def _rate(per_100_m: float) -> str:
    return f"{per_100_m:.0f}" if per_100_m >= 100.0 else f"{per_100_m:.2g}"


@dataclass(frozen=True, slots=True)
class LeftOut:
    """Trials that no fit has: in holes of the survey, outside of it; dug up because they were reported, which tells of
    sizes only. undecided are in the fit, as misses."""

    not_seen: int
    outside: int
    dug: int
    undecided: int


@dataclass(frozen=True, slots=True)
class Detectability:
    """heads, versions : of all pulls; "" where one does not say. bore_mm : least and greatest inner diameter, NaN where
    no pull says. identified : by kind, of the targets detected those that were named right every time."""

    rows: tuple[PodRow, ...]
    identified: tuple[tuple[str, Proportion], ...]
    sizing: tuple[tuple[str, Sizing], ...]
    false_calls: FalseCalls
    left_out: LeftOut
    pulls: tuple[str, ...]
    heads: tuple[str, ...]
    versions: tuple[str, ...]
    bore_mm: tuple[float, float]
    created: str

    @property
    def kinds(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(one.kind for one in self.rows))

    def row(self, kind: str, dimension: str = "depth", where: str = ALL) -> PodRow | None:
        for one in self.rows:
            if (one.kind, one.dimension, one.where) == (kind, dimension, where):
                return one
        return None

    def statement(self, kind: str) -> tuple[str, ...]:
        """What a report says of one kind, in plain lines; the first is that of its depth."""
        row = self.row(kind)
        if row is None:
            return (f"a90/95 not established ({CALLED.get(kind, kind)}): none was laid",)
        lines = [row.statement()]
        if row.fit.a9095_mm is None and row.fit.least and row.fit.least[-1].detected:
            least = row.fit.least[-1]
            lines.append(
                f"{least.detected} of {least.laid} between {digits(least.from_mm, MEASURE)} and"
                f" {digits(least.to_mm, MEASURE)} mm were detected: POD on average over these at least"
                f" {math.floor(100 * least.pod)} % ({100 * CONFIDENCE:.0f} % confidence)"
            )
        if row.response is not None and row.response.a9095_mm is not None:
            lines.append(
                f"by what was reported of depths a90/95 {digits_k2(row.response.a9095_mm, MEASURE)} mm"
                f" ({row.response.method})"
            )
        others = [one for one in self.rows if one.kind == kind and one is not row]
        lines += [one.statement() for one in others if one.dimension == "depth" or one.fit.a9095_mm is not None]
        for name, named in self.identified:
            if name == kind and named.n:
                lines.append(
                    f"named right: {named.hits} of {named.n} detected, {100 * named.lower:.0f} to"
                    f" {100 * named.upper:.0f} % ({100 * named.confidence:.0f} % confidence)"
                )
        for name, sized in self.sizing:
            if name == kind:
                lines += [f"depth: {one}" for one in sized.statement()]
        return tuple(lines)

    def standing(self, use: HeadInUse) -> tuple[Applicability, tuple[str, ...]]:
        """Whether it speaks for such a scan, and why not or what is not known."""
        found = ScopeCheck()
        for what, known, used in (("head", self.heads, use.head), ("software", self.versions, use.software)):
            found.same(what, "" if "" in known else ", ".join(known), used)
        reach = None if math.isnan(self.bore_mm[0]) else self.bore_mm
        found.within("diameter", "mm", reach, 0.0 if reach is None else BORE_MARGIN * reach[1], use.diameter_mm)
        return found.standing()

    def to_dict(self) -> dict[str, Any]:
        found = asdict(self)
        found["identified"] = [{"kind": kind, **one.to_dict()} for kind, one in self.identified]
        found["sizing"] = [{"kind": kind, **one.to_dict()} for kind, one in self.sizing]
        plain: dict[str, Any] = _plain({"format": FORMAT, **found})
        return plain

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> "Detectability":
        """Raises ValueError, one line, for what is none."""
        if found.get("format") != FORMAT:
            raise ValueError(f"its format is {shown(found.get('format'))}, expected {FORMAT}")
        rows = [_row(mapping(one, f"rows[{i}]"), f"rows[{i}]") for i, one in enumerate(_list(found, "rows", ROWS_MAX))]
        identified, sizing = (
            [(_kind(mapping(one, name)), one) for one in _list(found, name, len(KINDS))]
            for name in ("identified", "sizing")
        )
        calls, out = (mapping(found.get(name), name) for name in ("false_calls", "left_out"))
        pulls, heads, versions = (_names(found, name) for name in ("pulls", "heads", "versions"))
        bore = [math.nan if one is None else within(one, "bore_mm", 0.0, MM_MAX) for one in _list(found, "bore_mm", 2)]
        if len(bore) != 2:
            raise ValueError("bore_mm must be a list of 2")
        return cls(
            tuple(rows),
            tuple((kind, Proportion.from_dict(one)) for kind, one in identified),
            tuple((kind, Sizing.from_dict(one)) for kind, one in sizing),
            FalseCalls(
                whole(calls.get("count"), "false_calls.count", 0, COUNT_MAX),
                *(_maybe_nan(calls, name, "false_calls") for name in _FALSE_CALLS),
            ),
            LeftOut(*(whole(out.get(name), f"left_out.{name}", 0, COUNT_MAX) for name in _LEFT_OUT)),
            pulls,
            heads,
            versions,
            (bore[0], bore[1]),
            _time(_text(found.get("created"), "created")),
        )


BORE_MARGIN = 0.05  # of the pipes pulled through, beyond them: a head's rings fall much the same there
_FALSE_CALLS = ("inspected_m", "per_100_m", "lower", "upper", "confidence", "pipe_m")
_LEFT_OUT = ("not_seen", "outside", "dug", "undecided")


def detectability(
    trials: Trials, axis: SizeAxis | None = None, claim: tuple[float, float] | None = None
) -> Detectability:
    """Everything that a set of trials says. axis : of POD, where it was fixed beforehand. claim : a tolerance of
    depths, mm, and the certainty with which it is claimed. Raises AnnulusError, one line, where none of them was
    judged, and without statsmodels."""
    judged = [one for one in trials.trials if one.state in JUDGED and one.truth.laid]
    dug = [one for one in trials.trials if not one.truth.laid]
    if not judged and dug:
        raise AnnulusError(
            f"all {len(dug)} truths were dug up because they were reported, which says nothing of what was not:"
            " expected defects that were laid, for POD; `annulus unity` takes digs"
        )
    if not judged:
        raise AnnulusError(f"none of {len(trials.trials)} trials was judged: all lie outside of the scans, or unseen")
    rows, identified, sizing = [], [], []
    for kind in KINDS:
        its = [one for one in judged if one.truth.kind == kind]
        if not its:
            continue
        rows += list(_rows(kind, its, axis))
        identified.append((kind, _identified(its)))
        sizing.append((kind, _sizing([one for one in trials.trials if one.truth.kind == kind], claim)))
    states = [one.state for one in trials.trials if one.truth.laid]
    dug_in = {one.pull for one in dug}  # nobody dug where nothing was reported: what else is there nobody knows
    known = [one for one in trials.pulls if one.name not in dug_in]
    inspected_m, pipe_m = (length / 1000 for length in (sum(one.seen_mm for one in known), _pipe_mm(known, trials)))
    bores = [2 * one.bore_radius_mm for one in trials.pulls]
    return Detectability(
        tuple(rows),
        tuple(identified),
        tuple(sizing),
        FalseCalls.of(sum(pull not in dug_in for pull, _ in trials.false_calls), inspected_m, pipe_m=pipe_m),
        LeftOut(
            states.count(TrialState.NOT_SEEN),
            states.count(TrialState.OUTSIDE),
            len(dug),
            states.count(TrialState.UNDECIDED),
        ),
        tuple(dict.fromkeys(one.pull for one in trials.trials)),
        tuple(dict.fromkeys(one.head for one in trials.pulls)),
        tuple(dict.fromkeys(one.version for one in trials.pulls)),
        (min(bores), max(bores)) if bores else (math.nan, math.nan),
        datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _pipe_mm(pulls: Sequence[Pull], trials: Trials) -> float:
    """Length of different pipes: pulls that share a target, or name one pipe, are of one; of it the longest counts."""
    marks: dict[str, set[tuple[str, ...]]] = {one.name: {("pipe", one.pipe)} if one.pipe else set() for one in pulls}
    for trial in trials.trials:
        if trial.pull in marks:
            marks[trial.pull].add(_target(trial))
    pipes: list[tuple[set[tuple[str, ...]], float]] = []
    for one in pulls:
        own, length = marks[one.name], one.seen_mm
        for same in [pipe for pipe in pipes if pipe[0] & own]:
            pipes.remove(same)
            own, length = own | same[0], max(length, same[1])
        pipes.append((own, length))
    return sum(length for _, length in pipes)


def read_pod(path: Path) -> Detectability:
    """pod.json. AnnulusError, one line, for what is none."""
    try:
        return Detectability.from_dict(mapping(parse_json(read_file(path, FILE_MAX), FILE_MAX), "pod"))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror or error}). Expected a pod.json.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}. Expected a pod.json of `annulus pod fit`.") from None


def pod_json(found: Detectability) -> str:
    return json.dumps(found.to_dict(), indent=1, allow_nan=False) + "\n"


def _rows(kind: str, judged: Sequence[Trial], axis: SizeAxis | None) -> Iterator[PodRow]:
    for dimension in DIMENSIONS:
        for where, beside in WHERE.items():
            its = [one for one in judged if beside is None or one.truth.beside_joint is beside]
            its = [one for one in its if math.isfinite(_size(one, dimension))]
            if not its or (where != ALL and len(its) == len(judged)):
                continue
            fit = fit_hit_miss(
                [_size(one, dimension) for one in its],
                [one.state is TrialState.DETECTED for one in its],
                axis,
                target=_targets(its),
                curve=where == ALL,
            )
            if dimension == "depth" and where == ALL:
                yield PodRow(kind, dimension, where, fit, *_response(its))
            else:
                yield PodRow(kind, dimension, where, fit)


def _response(its: Sequence[Trial]) -> tuple[PodFit | None, ResponseLine | None]:
    """Of depths; None where a decision limit is not stated, or what was reported is not."""
    side = [LEFT if one.state is not TrialState.DETECTED else RIGHT if one.at_least else MEASURED for one in its]
    reported = [one.reported_depth_mm for one in its]
    limits = [one.depth_limit_mm for one in its]
    known = all(at == LEFT or value > 0 for at, value in zip(side, reported, strict=True))
    if not known or not all(one > 0 for one in limits):
        return None, None
    return fit_signal_response([one.truth.depth_mm for one in its], reported, side, limits, target=_targets(its))


def _targets(its: Sequence[Trial]) -> list[int]:
    """Which trials are of one target: a number for each."""
    numbers: dict[tuple[str, str, str], int] = {}
    return [numbers.setdefault(_target(one), len(numbers)) for one in its]


def _target(one: Trial) -> tuple[str, str, str]:
    """A truth without a place is of its own file only."""
    return one.truth.pipe, one.truth.name, "" if math.isfinite(one.truth.z_mm) else one.pull


def _size(one: Trial, dimension: str) -> float:
    sizes = {"depth": one.truth.depth_mm, "length": one.truth.length_mm, "width": one.truth.width_mm}
    return sizes[dimension]


def _identified(its: Sequence[Trial]) -> Proportion:
    """By target. Trials that do not say as what something was reported are left out."""
    right: dict[tuple[str, str, str], bool] = {}
    for one in its:
        if one.state is TrialState.DETECTED and one.reported:
            right[_target(one)] = right.get(_target(one), True) and one.is_identified
    return proportion(sum(right.values()), len(right), CONFIDENCE)


def _sizing(its: Sequence[Trial], claim: tuple[float, float] | None) -> Sizing:
    """Of every target the trial that is farthest off: several of one target are no several errors."""
    worst: dict[tuple[str, str, str], SizedPair] = {}
    for one in its:
        if one.state is not TrialState.DETECTED or math.isnan(one.reported_depth_mm):
            continue
        sure = None if math.isnan(one.truth.depth_u_mm) else one.truth.depth_u_mm
        pair = SizedPair(one.reported_depth_mm, one.truth.depth_mm, sure, one.at_least)
        before = worst.get(_target(one))
        if before is None or _off(pair) > _off(before):
            worst[_target(one)] = pair
    return size_errors(worst.values(), claim=claim)


def _off(pair: SizedPair) -> float:
    return -1.0 if pair.at_least else abs(pair.reported_mm - pair.true_mm)


def _row(found: Mapping[str, Any], what: str) -> PodRow:
    dimension, where = (_text(found.get(name), f"{what}.{name}") for name in ("dimension", "where"))
    if dimension not in DIMENSIONS or where not in WHERE:
        raise ValueError(
            f"{what} is of {shown(dimension)}, {shown(where)}; expected a dimension and a place that are known"
        )
    response, line = found.get("response"), found.get("line")
    return PodRow(
        _kind(found),
        dimension,
        where,
        _fit(mapping(found.get("fit"), f"{what}.fit"), f"{what}.fit"),
        None if response is None else _fit(mapping(response, f"{what}.response"), f"{what}.response"),
        None if line is None else _line(mapping(line, f"{what}.line"), f"{what}.line"),
    )


def _fit(found: Mapping[str, Any], what: str) -> PodFit:
    method, axis, why = (_text(found.get(name), f"{what}.{name}") for name in ("method", "axis", "why"))
    laid, trials, detected = (
        whole(found.get(name), f"{what}.{name}", 0, COUNT_MAX) for name in ("laid", "trials", "detected")
    )
    first, last = (_maybe_nan(found, name, what) for name in ("from_mm", "to_mm"))
    a50, a90, a9095 = (_maybe(found, name, what) for name in ("a50_mm", "a90_mm", "a9095_mm"))
    least = tuple(_least(mapping(one, f"{what}.least")) for one in _list(found, "least", 10))
    curve = found.get("curve")
    drawn = None if curve is None else _curve(mapping(curve, f"{what}.curve"), f"{what}.curve")
    return PodFit(method, laid, trials, detected, first, last, axis, a50, a90, a9095, why, least, drawn)


def _least(found: Mapping[str, Any]) -> LeastPod:
    first, last = (within(found.get(name), f"least.{name}", 0.0, MM_MAX) for name in ("from_mm", "to_mm"))
    laid = whole(found.get("laid"), "least.laid", 0, COUNT_MAX)
    detected = whole(found.get("detected"), "least.detected", 0, laid)
    return LeastPod(first, last, laid, detected, within(found.get("pod"), "least.pod", 0.0, 1.0))


def _curve(found: Mapping[str, Any], what: str) -> Curve:
    size, pod, lower = (
        tuple(
            math.nan if one is None else number(one, f"{what}.{name}", MM_MAX)
            for one in _list(found, name, CURVE_POINTS)
        )
        for name in ("size_mm", "pod", "lower")
    )
    if not len(size) == len(pod) == len(lower):
        raise ValueError(
            f"{what} has {len(size)} sizes, {len(pod)} POD and {len(lower)} bounds, expected as many of each"
        )
    return Curve(size, pod, lower)


def _line(found: Mapping[str, Any], what: str) -> ResponseLine:
    names = ("intercept", "slope", "sigma", "decision_mm")
    axes = [_text(found.get(name), f"{what}.{name}") for name in ("true_axis", "reported_axis")]
    if not set(axes) <= {str(one) for one in SizeAxis}:
        raise ValueError(f"{what} has axes {shown(axes)}, expected {' or '.join(SizeAxis)}")
    intercept, slope, sigma, decision = (number(found.get(name), f"{what}.{name}", MM_MAX) for name in names)
    return ResponseLine(intercept, slope, sigma, decision, axes[0], axes[1])


def _kind(found: Mapping[str, Any]) -> str:
    kind = _text(found.get("kind"), "kind")
    if kind not in KINDS:
        raise ValueError(f"kind is {shown(kind)}, expected {' or '.join(KINDS)}")
    return kind


def _names(found: Mapping[str, Any], name: str) -> tuple[str, ...]:
    return tuple(_text(one, name) for one in _list(found, name, NAMES_MAX))


def _text(value: object, what: str) -> str:
    return printable(raw_text(value, what, TEXT_MAX))


def _time(iso: str) -> str:
    datetime.fromisoformat(iso)  # ValueError
    return iso


def _list(found: Mapping[str, Any], name: str, most: int) -> list[Any]:
    value = found.get(name)
    if not isinstance(value, list) or len(value) > most:
        raise ValueError(f"{name} must be a list of at most {most}")
    return value


def _maybe(found: Mapping[str, Any], name: str, what: str) -> float | None:
    return None if found.get(name) is None else within(found[name], f"{what}.{name}", 0.0, MM_MAX)


def _maybe_nan(found: Mapping[str, Any], name: str, what: str) -> float:
    value = _maybe(found, name, what)
    return math.nan if value is None else value


def _plain(value: Any) -> Any:
    """With None for what JSON has no number for, and lists for tuples."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {name: _plain(one) for name, one in value.items()}
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value
