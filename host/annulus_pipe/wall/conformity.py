"""What a survey says of limits that somebody named: over, under, or undecided within the uncertainty.

The words are JCGM 106:2012's. A limit is a tolerance limit T; with the expanded uncertainty U (k = 2) as guard band on
either side of it, what is measured conforms by guarded acceptance where y + U < T, does not conform by guarded
rejection where y - U >= T, and is undecided in between. A value that is a lower limit itself, or whose uncertainty
nobody knows, is never accepted. Severities are the client's: of a class is what is measured at its start or beyond.

A limit is kept where it was judged, and nowhere else: the places where it was not (`unjudged`) are named with the
verdict. Where one is such as every scan has, the pipe conforms where it was seen; any other leaves it undecided.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.untrusted import shown
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.features import NOT_TOLD, Feature, FeatureKind
from annulus_pipe.wall.stations import shape_ovality, swing_k2_mm
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wall.unjudged import Unjudged

RULE = (
    "Decision rule (JCGM 106:2012): guarded acceptance and guarded rejection, guard band w = U, the expanded "
    "uncertainty with k = 2. Conforms: the measured value lies inside the tolerance limit by more than U. Does not "
    "conform: it lies at the limit or beyond it by at least U. Between the two: undecided within the uncertainty."
)
SEVERITY_MAX = 5  # classes of severity, of whoever names limits
GRADES_MAX = 24  # entries of one kind in limits.toml; bounds what a stranger's file costs
TITLE_MAX = 200  # characters of its title, for one line of the page
Group = Literal["defect", "undecided", "feature", "pipe"]


@dataclass(frozen=True, slots=True)
class LimitedQuantity:
    """What may be limited of a kind: its unit, the words for it, and whether less of it is worse."""

    unit: str
    words: str
    lower: bool = False


QUANTITIES: Mapping[str, Mapping[str, LimitedQuantity]] = {
    "loss": {
        "depth_mm": LimitedQuantity("mm", "depth"),
        "depth_percent_diameter": LimitedQuantity("%", "depth, of the diameter"),
        "depth_percent_wall": LimitedQuantity("%", "depth, of the wall thickness"),
    },
    "bump": {
        "height_mm": LimitedQuantity("mm", "height"),
        "height_percent_diameter": LimitedQuantity("%", "height, of the diameter"),
    },
    "ovality": {"percent": LimitedQuantity("%", "of the pipe's shape")},
    "bore": {
        "smallest_mm": LimitedQuantity("mm", "smallest diameter", lower=True),
        "largest_mm": LimitedQuantity("mm", "largest diameter"),
    },
    "joint": {
        "hilo_mm": LimitedQuantity("mm", "hi-lo"),
        "angle_deg": LimitedQuantity("°", "angle"),
        "bead_height_mm": LimitedQuantity("mm", "height of the bead"),
        "bead_width_mm": LimitedQuantity("mm", "width of the bead"),
    },
    "gap": {"gap_mm": LimitedQuantity("mm", "width of the gap")},
    "water": {
        "depth_mm": LimitedQuantity("mm", "depth"),
        "height_percent": LimitedQuantity("%", "height, of the diameter"),
    },
    "deposit": {
        "depth_mm": LimitedQuantity("mm", "depth"),
        "height_percent": LimitedQuantity("%", "height, of the diameter"),
    },
    "tee": {"protrusion_mm": LimitedQuantity("mm", "stands into the pipe by")},
}
_MEASURED = {"bead_height_mm": "height_mm", "bead_width_mm": "width_mm"}  # as features name them
_LISTED: Mapping[str, Kind] = {"loss": Kind.LOSS, "bump": Kind.BUMP}


class Decision(StrEnum):
    """In the words of summary.json."""

    CONFORMS = "conforms"
    SEEN = "conforms where seen"
    UNDECIDED = "undecided"
    FAILS = "does not conform"


@dataclass(frozen=True, slots=True)
class Grade:
    """A class of severity: of it is what has so much of a quantity, or more (less, where that is worse)."""

    severity: int
    quantity: str
    start: float


@dataclass(frozen=True, slots=True)
class Criteria:
    """limits.toml as a checked value. accepted : the highest severity that conforms. wall_mm, diameter_mm : what parts
    are of; the measured mean diameter where None. seen_percent : of the wall, below which nothing is accepted."""

    title: str
    grades: Mapping[str, tuple[Grade, ...]]
    accepted: int = 0
    wall_mm: float | None = None
    diameter_mm: float | None = None
    seen_percent: float = 0.0

    @classmethod
    def from_dict(cls, data: object) -> "Criteria":
        """Of plain values, as TOML has them. Raises ValueError naming section and key."""
        top = untrusted.mapping(data, "limits.toml")
        own = ("title", "accept_severity", "wall_mm", "diameter_mm", "seen_percent")
        for name in top:
            if name not in (*own, *QUANTITIES):
                raise ValueError(f"{_name(name)} is not known, expected one of {', '.join((*own, *QUANTITIES))}")
        wall, diameter = (
            untrusted.within(top[name], name, 0.1, 1e4) if name in top else None for name in ("wall_mm", "diameter_mm")
        )
        grades = {kind: _grades(kind, top[kind]) for kind in QUANTITIES if kind in top}
        if not grades:
            raise ValueError(f"names no limit, expected at least one section of [[{']], [['.join(QUANTITIES)}]]")
        if wall is None and any(one.quantity == "depth_percent_wall" for one in grades.get("loss", ())):
            raise ValueError("[[loss]] depth_percent_wall needs wall_mm, the wall's thickness")
        return cls(
            untrusted.printable(untrusted.text(top.get("title", ""), "title", TITLE_MAX)),
            grades,
            untrusted.whole(top.get("accept_severity", 0), "accept_severity", 0, SEVERITY_MAX),
            wall,
            diameter,
            untrusted.within(top.get("seen_percent", 0.0), "seen_percent", 0.0, 100.0),
        )

    def limit(self, kind: str, quantity: str) -> float:
        """The tolerance limit: where the first class begins that does not conform; NaN without one."""
        starts = [
            one.start for one in self.grades.get(kind, ()) if one.quantity == quantity and one.severity > self.accepted
        ]
        if not starts:
            return math.nan
        return max(starts) if QUANTITIES[kind][quantity].lower else min(starts)

    def severity(self, kind: str, quantity: str, value: float) -> int:
        """The class of a value; 0 of none."""
        sign = -1.0 if QUANTITIES[kind][quantity].lower else 1.0
        of = [one.severity for one in self.grades[kind] if one.quantity == quantity and sign * (value - one.start) >= 0]
        return max(of, default=0)


@dataclass(frozen=True, slots=True)
class Judged:
    """One thing held against the limits. group, index : of the survey's defects, undecided places or features, or the
    pipe as a whole. severities : of value - k2, value, value + k2. at_least : the value is a lower limit."""

    group: Group
    index: int
    kind: str
    quantity: str
    value: float
    k2: float
    limit: float
    severities: tuple[int, int, int]
    decision: Decision
    z_mm: float = math.nan
    at_least: bool = False

    @property
    def severity(self) -> int:
        return self.severities[1]

    @property
    def of(self) -> LimitedQuantity:
        return QUANTITIES[self.kind][self.quantity]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Everything judged, the decision about the pipe as far as it was seen, what is not in it, for people, and the
    places where a limit that was named may be broken unseen, those that every scan has last."""

    criteria: Criteria
    items: tuple[Judged, ...]
    decision: Decision
    remarks: tuple[str, ...]
    not_established: tuple[Unjudged, ...] = ()

    def worst_of(self, group: Group, index: int) -> Judged | None:
        """What governs one thing: the decision against it, then its severity."""
        mine = [one for one in self.items if (one.group, one.index) == (group, index)]
        return max(mine, key=lambda one: (_ORDER.index(one.decision), one.severity), default=None)

    @property
    def foremost(self) -> tuple[int, ...]:
        """Defects that do not conform, then those that are undecided, the more severe first."""
        bad = [one for one in self.items if one.group == "defect" and one.decision is not Decision.CONFORMS]
        bad.sort(key=lambda one: (-_ORDER.index(one.decision), -one.severity))
        return tuple(dict.fromkeys(one.index for one in bad))


UNSEEN_AGAIN = 1.0  # of what a bump or loss was seen to depart by: as much may be hidden; test_bore.py
_ORDER = (Decision.CONFORMS, Decision.SEEN, Decision.UNDECIDED, Decision.FAILS)


def decide(value: float, k2: float, limit: float, *, lower: bool = False, at_least: bool = False) -> Decision:
    """A measured value against a tolerance limit, see above. limit NaN: none is named, and everything conforms.

    lower : what lies below the limit does not conform. at_least : the true value may lie any way beyond the measured.
    """
    if math.isnan(limit):
        return Decision.CONFORMS
    if not (math.isfinite(value) and math.isfinite(k2) and k2 >= 0):
        return Decision.UNDECIDED
    if value + k2 <= limit if lower else value - k2 >= limit:
        return Decision.FAILS
    sure = value - k2 > limit if lower else value + k2 < limit
    return Decision.CONFORMS if sure and not at_least else Decision.UNDECIDED


def judge(survey: Survey, criteria: Criteria) -> Verdict:
    """Every defect, undecided place and feature of a kind that has a limit, and the pipe's own shape, against it."""
    items = list(_judged(survey, criteria))
    remarks = list(_open(survey, criteria))
    decision = max((one.decision for one in items), key=_ORDER.index, default=Decision.CONFORMS)
    places = [one for one in survey.unjudged if _is_open(one, survey, criteria)]
    if decision is Decision.CONFORMS:
        unusual = any(not one.usual for one in places)
        decision = Decision.UNDECIDED if remarks or unusual else Decision.SEEN if places else decision
    remarks += _unseen(survey, criteria)
    return Verdict(criteria, tuple(items), decision, tuple(remarks), tuple(sorted(places, key=lambda one: one.usual)))


def _is_open(place: Unjudged, survey: Survey, criteria: Criteria) -> bool:
    """Whether a limit that does not conform may be broken at a place where it was not judged."""
    for kind in place.kinds:
        for quantity in _limited(criteria, kind):
            limit = criteria.limit(kind, quantity)
            if kind in _LISTED:
                limit = _in_mm(limit, quantity, survey, criteria)
            if place.may_reach(kind, limit):
                return True
    return False


def _judged(survey: Survey, criteria: Criteria) -> Iterator[Judged]:
    listed: tuple[tuple[Group, Sequence[Defect]], ...]
    listed = ("defect", survey.defects), ("undecided", survey.detection.undecided)
    for group, places in listed:
        for index, place in enumerate(places):
            yield from _of_place(group, index, place, survey, criteria)
    for index, feature in enumerate(survey.features):
        yield from _of_feature(index, feature, criteria)
    yield from _of_pipe(survey, criteria)


def _of_place(group: Group, index: int, place: Defect, survey: Survey, criteria: Criteria) -> Iterator[Judged]:
    for quantity in _limited(criteria, place.kind):
        per = 1.0
        if quantity.endswith("_percent_wall"):
            per = 100.0 / (criteria.wall_mm or math.nan)
        elif quantity.endswith("_percent_diameter"):
            per = 100.0 / _diameter_mm(survey, criteria)
        elif place.kind is Kind.OVALITY:
            nearest = int(np.argmin(np.abs(survey.wall.z_mm - place.z_mm)))
            per = 50.0 / float(survey.wall.shape_mm[nearest, 0])
        value, k2 = per * place.depth_mm, per * place.depth_k2_mm
        one = _item(criteria, group, index, place.kind, quantity, value, k2, place.z_mm, not place.floor_seen)
        if group == "undecided" and one.decision is Decision.FAILS:  # there may be nothing at all
            one = replace(one, decision=Decision.UNDECIDED)
        yield one


def _of_feature(index: int, feature: Feature, criteria: Criteria) -> Iterator[Judged]:
    identified = not feature.remark.startswith(NOT_TOLD)
    for kind in _kinds(feature):
        for quantity in _limited(criteria, kind):
            name = _MEASURED.get(quantity, quantity)
            found = next((one for one in feature.measures if one.name == name), None)
            if found is None and kind is FeatureKind.JOINT and quantity in _MEASURED and identified:
                continue  # a coupling has no bead
            value, k2 = (math.nan, math.nan) if found is None else (abs(found.value), found.k2)
            yield _item(criteria, "feature", index, kind, quantity, value, k2, feature.z_mm)


def _kinds(feature: Feature) -> tuple[FeatureKind, ...]:
    """Whose limits it has. Two pipes whose ends stand apart are a joint as well: they may lie aside of one another. A
    branch some of whose rim stands in may be a tee."""
    if feature.kind is FeatureKind.GAP:
        return feature.kind, FeatureKind.JOINT
    if feature.kind is FeatureKind.BRANCH and any(one.name == "protrusion_mm" for one in feature.measures):
        return feature.kind, FeatureKind.TEE
    return (feature.kind,)


def _of_pipe(survey: Survey, criteria: Criteria) -> Iterator[Judged]:
    stations, wall = survey.stations, survey.wall
    along = {
        ("ovality", "percent"): (shape_ovality(wall), 50.0 * swing_k2_mm(wall) / wall.shape_mm[:, 0], wall.z_mm),
        ("bore", "smallest_mm"): (stations.diameter_min_mm, stations.diameter_min_k2_mm, stations.z_mm),
        ("bore", "largest_mm"): (stations.diameter_max_mm, stations.diameter_max_k2_mm, stations.z_mm),
    }
    for (kind, quantity), (values, k2s, z) in along.items():
        if quantity not in _limited(criteria, kind):
            continue
        known = np.flatnonzero(np.isfinite(values))
        if not len(known):
            yield _item(criteria, "pipe", 0, kind, quantity, math.nan, math.nan, math.nan)
            continue
        each = [_item(criteria, "pipe", 0, kind, quantity, float(values[i]), float(k2s[i]), float(z[i])) for i in known]
        sign = -1.0 if QUANTITIES[kind][quantity].lower else 1.0
        if kind == "bore":
            each += _through(survey, criteria, quantity)
        yield max(each, key=lambda one: (_ORDER.index(one.decision), sign * one.value))


def _through(survey: Survey, criteria: Criteria, quantity: str) -> Iterator[Judged]:
    """The diameter through every bump or loss, and what lies opposite, against a limit of the bore. A station's own
    least and greatest are medians over its rows, and know nothing of a crest that is shorter."""
    wall, lower = survey.wall, QUANTITIES["bore"][quantity].lower
    kind, sign = (Kind.BUMP, -1.0) if lower else (Kind.LOSS, 1.0)
    listed = [one for one in survey.defects if one.kind is kind]
    shape_sigma_mm = wall.shape_sigma_mm().mean(axis=1)
    for one in (*listed, *(place for place in survey.detection.undecided if place.kind is kind)):
        row = int(np.argmin(np.abs(wall.z_mm - one.z_mm)))
        t = math.radians(one.clock_deg)
        _, _, _, even, odd = wall.shape_mm[row]
        across = 2.0 * float(wall.shape_mm[row, 0] + even * math.cos(2 * t) + odd * math.sin(2 * t))
        both = [one, *(other for other in listed if _is_opposite(one, other))]
        k2 = math.hypot(2.0 * float(shape_sigma_mm[row]), *(each.depth_k2_mm for each in both))
        departs = sign * sum(each.depth_mm for each in both)
        judged = _item(criteria, "pipe", 0, "bore", quantity, across + departs, k2, one.z_mm)
        if judged.decision is Decision.CONFORMS and not all(each.floor_seen for each in both):
            unseen = across + (1.0 + UNSEEN_AGAIN) * departs
            if _item(criteria, "pipe", 0, "bore", quantity, unseen, k2, one.z_mm).decision is not Decision.CONFORMS:
                judged = replace(judged, decision=Decision.UNDECIDED)
        if judged.decision is Decision.FAILS and one not in listed:  # there may be nothing at all
            judged = replace(judged, decision=Decision.UNDECIDED)
        yield judged


def _is_opposite(one: Defect, other: Defect) -> bool:
    """Whether a diameter has its ends on both."""
    off = abs((one.clock_deg + 180.0 - other.clock_deg + 180.0) % 360.0 - 180.0)
    return (
        off <= (one.arc_deg + other.arc_deg) / 2 and abs(one.z_mm - other.z_mm) <= (one.length_mm + other.length_mm) / 2
    )


def _item(
    criteria: Criteria,
    group: Group,
    index: int,
    kind: str,
    quantity: str,
    value: float,
    k2: float,
    z_mm: float,
    at_least: bool = False,
) -> Judged:
    limit, lower = criteria.limit(kind, quantity), QUANTITIES[kind][quantity].lower
    off = (k2 if math.isfinite(k2) else 0.0) * (-1.0 if lower else 1.0)
    least, measured, most = (criteria.severity(kind, quantity, value + side * off) for side in (-1.0, 0.0, 1.0))
    decision = decide(value, k2, limit, lower=lower, at_least=at_least)
    return Judged(
        group, index, str(kind), quantity, value, k2, limit, (least, measured, most), decision, z_mm, at_least
    )


def _limited(criteria: Criteria, kind: str) -> tuple[str, ...]:
    """The quantities of a kind that some class speaks of."""
    return tuple(dict.fromkeys(one.quantity for one in criteria.grades.get(kind, ())))


def _diameter_mm(survey: Survey, criteria: Criteria) -> float:
    return criteria.diameter_mm or (
        survey.nominal_diameter_mm if math.isnan(survey.diameter_mean_mm) else survey.diameter_mean_mm
    )


def _in_mm(limit: float, quantity: str, survey: Survey, criteria: Criteria) -> float:
    """A limit of depth or height, whatever it is a part of."""
    if quantity.endswith("_percent_wall"):
        return limit * (criteria.wall_mm or math.nan) / 100.0
    return limit * _diameter_mm(survey, criteria) / 100.0 if quantity.endswith("_percent_diameter") else limit


def _open(survey: Survey, criteria: Criteria) -> Iterator[str]:
    """Why nobody can say that all conforms, even where all that was listed does."""
    for kind in _LISTED:
        for quantity in _limited(criteria, kind):
            limit = _in_mm(criteria.limit(kind, quantity), quantity, survey, criteria)
            if limit <= survey.depth_limit_mm:
                yield (
                    f"the limit of {kind}, {limit:.2f} mm, lies below the least depth that is listed, "
                    f"{survey.depth_limit_mm:.2f} mm: whether there are others over it is not decided"
                )
    if 100.0 * survey.seen_fraction < criteria.seen_percent:
        yield (f"{100.0 * survey.seen_fraction:.1f} % of the wall was seen, {criteria.seen_percent:g} % were asked for")


def _unseen(survey: Survey, criteria: Criteria) -> Iterator[str]:
    """What the decision does not speak of."""
    missed = 100.0 * (1.0 - survey.seen_fraction)
    if missed > 0.0:
        yield f"{max(missed, 0.1):.1f} % of the wall was not seen: nothing is claimed there"
    if any(kind in criteria.grades for kind in _LISTED):
        yield f"a place smaller than {survey.size_limit_mm:.1f} mm along or across the pipe is not judged"
    for kind, values in (("ovality", shape_ovality(survey.wall)), ("bore", survey.stations.diameter_mean_mm)):
        unknown = float(np.mean(~np.isfinite(values)))
        if kind in criteria.grades and unknown > 0:
            yield f"{kind} is not known on {max(100.0 * unknown, 0.1):.1f} % of the length"
    named = [feature for feature in survey.features if feature.kind is not FeatureKind.NAMELESS]
    found = {*(str(feature.kind) for feature in named), *(str(place.kind) for place in survey.defects)}
    if unlimited := sorted(found - criteria.grades.keys()):
        yield f"no limit was named for: {', '.join(unlimited)}"


def _grades(kind: str, section: object) -> tuple[Grade, ...]:
    rows = section if isinstance(section, list) else [section]
    if not rows or len(rows) > GRADES_MAX:
        raise ValueError(f"[[{kind}]] must be there 1 to {GRADES_MAX} times")
    out = []
    for row in rows:
        if not isinstance(row, Mapping):
            raise ValueError(f'"{kind}" must be a section, written [[{kind}]]')
        names = [name for name in row if name != "severity"]
        for name in names:
            if name not in QUANTITIES[kind]:
                raise ValueError(
                    f"[[{kind}]] {_name(name)} is not known, expected severity and one of {', '.join(QUANTITIES[kind])}"
                )
        if "severity" not in row or not names:
            raise ValueError(f"[[{kind}]] expected severity and one of {', '.join(QUANTITIES[kind])}, where it begins")
        severity = untrusted.whole(row["severity"], f"[[{kind}]] severity", 1, SEVERITY_MAX)
        out += [Grade(severity, name, untrusted.within(row[name], f"[[{kind}]] {name}", 0.0, 1e5)) for name in names]
    for name in QUANTITIES[kind]:
        mine = sorted((one for one in out if one.quantity == name), key=lambda one: one.severity)
        starts = [one.start for one in mine]
        worse = starts[::-1] if QUANTITIES[kind][name].lower else starts
        if worse != sorted(worse) or len({one.severity for one in mine}) < len(mine):
            raise ValueError(f"[[{kind}]] {name}: a higher severity must begin at a worse value, each severity once")
    return tuple(out)


def _name(value: Any) -> str:
    return value if isinstance(value, str) and value.isidentifier() and len(value) <= 40 else shown(value)
