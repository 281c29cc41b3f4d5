"""One pipe's results against its truth: what was found, what was made up, and every number with its k = 2."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from tools.bench.blind.cloud import cloud_coverage
from tools.bench.blind.draw import limited
from tools.bench.blind.pipe import Scene, Thing
from tools.bench.blind.places import place_of
from tools.bench.blind.results import NAMELESS, Listed, Results
from tools.bench.blind.stations import departure_mm, station_numbers, worst_ovality
from tools.bench.blind.surface import Surface, away_deg

ACCEPTS = {
    "pocket": ("loss",),
    "groove": ("loss",),
    "bump": ("bump",),
    "dent": ("bump", "ovality"),
    "joint": ("joint",),
    "gap": ("gap", "joint"),
    "reducer": ("reducer", "taper"),
    "taper": ("taper", "reducer"),
    "bend": ("bend",),
    "branch": ("branch", "tee"),
    "tee": ("tee", "branch"),
    "cable": ("object",),
    "hose": ("object", "bump", "deposit"),
    "silt": ("deposit", "water"),
    "water": ("water", "deposit"),
}
WALL_THINGS = ("pocket", "groove", "bump")  # a survey states a limit of detection for these
ALL_ROUND = ("joint", "gap", "bend", "taper", "reducer")  # no name of a thing on a part of the wall
STRETCHES = ("bend", "taper", "reducer")
BESIDE_OF_RADIUS, BESIDE_DEG = 0.06, 8.0  # what is listed so near to a thing is that thing
INSIDE = 0.6  # of a thing's length must have been scanned, or nobody could list it
# A place at which nothing is established speaks of a thing if it is no more than LOCAL times as long and as wide, or
# than what an inspector looks at in one go.
LOCAL, LOOK_OF_RADIUS, LOOK_DEG = 4.0, 0.5, 60.0
NOT_SEEN = "not seen"  # in the reason of a place that is a hole in the map
DARK = 0.9  # of a place's area: a hole in the map throughout; of that it says no more than is true, however large it is
COVERED = 0.5  # of a thing's area that such places must cover
OVAL_LEAST = 0.4  # of what is listed: a pipe that is less oval than that is none
SURE = 3.0  # times k = 2: a depth that is off by more is wrong, whatever coverage is
MEASURES = {  # of features, by kind; of all else the depth
    "joint": ("height_mm", "width_mm", "hilo_mm", "angle_deg", "step_mm", "radius_after_mm"),
    "gap": ("gap_mm", "hilo_mm", "angle_deg", "step_mm", "radius_after_mm"),
    "reducer": ("radius_before_mm", "radius_after_mm"),
    "taper": ("radius_before_mm", "radius_after_mm"),
    "bend": ("radius_mm", "angle_deg", "start_mm"),
    "branch": ("inner_d_mm",),
    "tee": ("inner_d_mm", "protrusion_mm"),
    "silt": ("level_mm", "depth_mm"),
    "water": ("level_mm", "depth_mm"),
}
CALLED = {  # by what kind of number a measure is
    "height_mm": "bead height",
    "width_mm": "width",
    "hilo_mm": "hi-lo",
    "angle_deg": "angle",
    "step_mm": "step",
    "radius_after_mm": "radius",
    "radius_before_mm": "radius",
    "gap_mm": "gap",
    "radius_mm": "bend radius",
    "start_mm": "place",
    "inner_d_mm": "opening",
    "protrusion_mm": "opening",
    "level_mm": "level",
    "depth_mm": "level",
}


@dataclass(frozen=True, slots=True)
class Number:
    """What was said of something, and what is true. k2 is NaN where none is said; at_least: a lower bound."""

    what: str
    where: str
    reported: float
    k2: float
    true: float
    at_least: bool = False

    @property
    def right(self) -> bool | None:
        """Within its k = 2; of a lower bound, not below it. None where no k = 2 is said."""
        if not math.isfinite(self.k2):
            return None
        return self.true >= self.reported - self.k2 if self.at_least else abs(self.reported - self.true) <= self.k2

    @property
    def far_off(self) -> bool:
        """By more than SURE of its k = 2."""
        off = self.reported - self.true if self.at_least else abs(self.reported - self.true)
        return math.isfinite(self.k2) and off > SURE * self.k2


@dataclass(frozen=True, slots=True)
class Outcome:
    """Of one true thing: found, misnamed, missed, not established, below the limit, or outside of what was scanned."""

    kind: str
    z_mm: float
    clock_deg: float
    depth_mm: float
    beside: str
    where: str
    state: str
    reported: tuple[str, ...] = ()


@dataclass(slots=True)
class Score:
    """Of one pipe. cloud : place -> (points, those within k = 2, those within it but for the scale)."""

    seed: int
    bore_mm: float
    material: str
    marks: tuple[str, ...]
    length_mm: float
    decision: str
    over_limit: tuple[str, ...]
    falsely_conforms: bool
    outcomes: list[Outcome] = field(default_factory=list)
    false: list[str] = field(default_factory=list)
    numbers: list[Number] = field(default_factory=list)
    cloud: dict[str, tuple[int, int, int]] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def score(scene: Scene, results: Results) -> Score:
    """Everything that can be asked of one survey of a drawn pipe."""
    surface, seen = Surface(scene.pipe), (results.from_mm, results.to_mm)
    listed = [one for one in results.listed if one.group != "undecided"]
    over = tuple(_over(scene, results, surface))
    out = Score(
        scene.seed,
        2.0 * scene.pipe.radius_mm,
        scene.pipe.material.name,
        scene.marks,
        results.to_mm - results.from_mm,
        results.decision,
        tuple(name for name, _ in over),
        results.decision.startswith("conforms") and any(not hidden for _, hidden in over),
    )
    named: dict[int, tuple[Listed, list[tuple[Thing, str]]]] = {}
    for thing in scene.pipe.things:
        state, best, others = judged(thing, scene, results, listed)
        where = place_of(scene, thing.span_mm, thing.clock_deg, thing.arc_deg, seen)
        reported = tuple(one.reported for one in ([best] if best else others))
        out.outcomes.append(
            Outcome(thing.kind, thing.z_mm, thing.clock_deg, thing.depth_mm, thing.beside, where, state, reported)
        )
        if best is not None:
            named.setdefault(id(best), (best, []))[1].append((thing, where))
    for line, things in named.values():
        out.numbers += line_numbers(line, things, surface, seen)
    for one in listed:
        if one.kind == "ovality":
            true = departure_mm(surface, one.z_mm - one.length_mm / 2, one.z_mm + one.length_mm / 2)
            where = place_of(scene, span(one), 0.0, 360.0, seen)
            out.numbers.append(Number("ovality", where, *one.numbers["depth_mm"], true))
            if true < OVAL_LEAST * one.numbers["depth_mm"][0]:
                out.false.append(one.reported)
        elif is_false(one, scene, out.outcomes):
            out.false.append(one.reported)
    out.numbers += [Number(*one) for one in station_numbers(scene, results, surface)]
    for item in results.items:
        if (item["of"], item["kind"]) == ("pipe", "ovality") and item["value"] is not None:
            k2 = math.nan if item["k2"] is None else item["k2"]
            where = place_of(scene, (item["z_mm"], item["z_mm"]), 0.0, 360.0, seen)
            out.numbers.append(Number("worst ovality", where, item["value"], k2, worst_ovality(surface, *seen)))
    out.cloud = cloud_coverage(scene, results.points_mm, results.sigma_mm, seen, results.scale_part)
    return out


def judged(
    thing: Thing, scene: Scene, results: Results, listed: Sequence[Listed]
) -> tuple[str, Listed | None, list[Listed]]:
    """State of one thing, the line that names it rightly, and what else is listed there."""
    radius = scene.pipe.radius_mm
    inside = min(thing.span_mm[1], results.to_mm) - max(thing.span_mm[0], results.from_mm)
    if inside < INSIDE * thing.length_mm:
        return "outside", None, []
    near = [one for one in listed if overlap(thing, one, radius)]
    right = [one for one in near if one.kind in ACCEPTS[thing.kind]]
    if right:
        holding = [one for one in results.listed if one.kind in ACCEPTS[thing.kind] and _holds(one, thing, radius)]
        if thing.kind in WALL_THINGS and holding and all(one.group == "undecided" for one in holding):
            return "not established", None, []  # the line of its own place says so, whatever the neighbour's
        return "found", min(right, key=lambda one: _away(thing, one, radius)), []
    if "object" in ACCEPTS[thing.kind] and results.objects:
        return "found", None, []
    names = [one for one in near if one.kind not in ALL_ROUND or thing.arc_deg >= 360.0]
    others = [one for one in names if one.kind != "ovality" and not _is_of_another(one, thing, scene)]
    if thing.kind in WALL_THINGS and is_below(thing, results, radius):
        return "below the limit", None, others
    if not others and is_not_established(thing, results, radius):
        return "not established", None, []
    return ("misnamed" if others else "missed"), None, others


def is_below(thing: Thing, results: Results, radius: float) -> bool:
    """Whether a survey's own limits say that it need not list this: what of it is deeper than the one is no larger than
    the other."""
    part = results.depth_limit_mm / thing.depth_mm
    if part >= 1.0:
        return True
    length, width = thing.length_mm, math.radians(thing.arc_deg) * radius
    if thing.kind == "bump":  # a dome
        length, width = (math.sqrt(1.0 - math.sqrt(part)) * one for one in (length, width))
    else:
        ramps = 2.0 * thing.ramp_mm * part
        length, width = length - ramps, width - (0.0 if thing.arc_deg >= 360.0 else ramps)
    return min(length, width) <= results.size_limit_mm


def is_not_established(thing: Thing, results: Results, radius: float) -> bool:
    """Whether it is listed as undecided, or places that the verdict leaves open cover it; either speaking of little
    else."""
    kinds = {
        "pocket": "loss",
        "groove": "loss",
        "dent": "bump",
        "branch": "bump",
        "cable": "bump",
        "hose": "bump",
        "silt": "deposit",
        "bend": "ovality",
        "reducer": "bore",
        "taper": "bore",
    }
    kind = kinds.get(thing.kind, thing.kind)
    longest, widest = _most(thing, radius)
    undecided = [one for one in results.listed if one.group == "undecided" and one.kind != "ovality"]
    if thing.arc_deg < 360.0:  # a place without a name speaks of what goes all round, and of nothing on a part of it
        undecided = [one for one in undecided if one.kind != NAMELESS and one.arc_deg <= widest]
    if any(one.length_mm <= longest and overlap(thing, one, radius) for one in undecided):
        return True
    z = np.linspace(*thing.span_mm, 24)[:, None]
    clock = thing.clock_deg + thing.arc_deg * np.linspace(-0.5, 0.5, 24)[None, :]
    covered = np.zeros((24, 24), bool)
    for place in results.places:
        first, last, arc = place["z_from_mm"], place["z_to_mm"], place["arc_deg"]
        is_short, is_narrow = last - first <= longest, arc <= widest
        # of what was not seen at all it says so: all round behind a bead, or along a rod's whole shadow
        is_local = is_short or is_narrow if NOT_SEEN in place.get("reason", "") else is_short and is_narrow
        if kind in place["limits"] and (is_local or is_dark(place, results)):
            around = np.abs(away_deg(clock, place["clock_deg"])) <= arc / 2 + 1.0
            covered |= (z >= first - 1.0) & (z <= last + 1.0) & around
    return bool(covered.mean() >= COVERED)


def is_dark(place: Mapping[str, Any], results: Results) -> bool:
    """Whether nothing was seen in all but a tenth of a place's cells."""
    if not results.seen.size:
        return False
    rows = (results.seen_z_mm >= place["z_from_mm"]) & (results.seen_z_mm <= place["z_to_mm"])
    columns = results.seen.shape[1]
    clock = (np.arange(columns) + 0.5) * 360.0 / columns
    around = np.abs(away_deg(clock, place["clock_deg"])) <= place["arc_deg"] / 2
    cells = results.seen[rows][:, around]
    return bool(cells.size) and float(cells.mean()) <= 1.0 - DARK


def is_false(line: Listed, scene: Scene, outcomes: Sequence[Outcome]) -> bool:
    """Whether there is nothing where something is listed. A stretch that bends or tapers, and is called so, is nothing:
    what else is listed there must be there."""
    for thing, outcome in zip(scene.pipe.things, outcomes, strict=True):
        if overlap(thing, line, scene.pipe.radius_mm):
            if line.kind in ALL_ROUND and thing.arc_deg < 360.0:
                continue
            is_stretch = thing.kind in STRETCHES and outcome.state != "misnamed"
            if not is_stretch or line.kind in ACCEPTS[thing.kind]:
                return False
    return True


def overlap(thing: Thing, one: Listed, radius: float) -> bool:
    first, last = span(one)
    margin = BESIDE_OF_RADIUS * radius
    if thing.span_mm[0] - margin > last or first > thing.span_mm[1] + margin:
        return False
    if thing.kind == "cable" or one.kind == "ovality":  # from wall to wall; all round
        return True
    off = abs(float(away_deg(np.array(thing.clock_deg), one.clock_deg)))
    return off <= (thing.arc_deg + one.arc_deg) / 2 + BESIDE_DEG


def _most(thing: Thing, radius: float) -> tuple[float, float]:
    """mm and degrees that a line or a place may be long and wide to speak of a thing: it speaks of little else."""
    return max(LOCAL * thing.length_mm, LOOK_OF_RADIUS * radius), max(LOCAL * thing.arc_deg, LOOK_DEG)


def _holds(one: Listed, thing: Thing, radius: float) -> bool:
    """Whether the middle of a thing lies in what is listed, and that speaks of little else."""
    longest, widest = _most(thing, radius)
    off = abs(float(away_deg(np.array(thing.clock_deg), one.clock_deg)))
    inside = abs(thing.z_mm - one.z_mm) <= one.length_mm / 2 and off <= one.arc_deg / 2
    return inside and one.length_mm <= longest and one.arc_deg <= widest


def span(one: Listed) -> tuple[float, float]:
    return one.z_mm - one.length_mm / 2, one.z_mm + one.length_mm / 2


def line_numbers(
    line: Listed, things: Sequence[tuple[Thing, str]], surface: Surface, seen: tuple[float, float]
) -> list[Number]:
    """What a line measured. One that is of several things has the depth of the deepest, and no more is asked."""
    thing, where = max(things, key=lambda one: one[0].depth_mm)
    depth = max(true_depth_mm(one, surface) for one, _ in things) if thing.kind in WALL_THINGS else thing.depth_mm
    numbers = list(thing_numbers(replace(thing, depth_mm=depth), line, where, surface, seen))
    return numbers if len(things) == 1 else [one for one in numbers if one.what == "depth"]


def true_depth_mm(thing: Thing, surface: Surface) -> float:
    """How far the wall departs where the thing lies: one that another crosses is as deep there as both together, and
    that is what a survey sees."""
    z, clock = np.linspace(*thing.span_mm, 81)[:, None], thing.clock_deg + thing.arc_deg * np.linspace(-0.5, 0.5, 81)
    departure = surface.radius(clock, z, bottoms=False) - surface.shape(clock, z)
    return float((-departure if thing.kind == "bump" else departure).max())


def thing_numbers(
    thing: Thing, best: Listed, where: str, surface: Surface, seen: tuple[float, float]
) -> Iterator[Number]:
    """What was measured of a thing that was found."""
    turn = float(away_deg(np.array(best.clock_deg), thing.clock_deg))
    if thing.kind in ("pocket", "groove", "bump"):
        yield Number("depth", where, *best.numbers["depth_mm"], thing.depth_mm, best.at_least)
        yield Number("place", where, best.z_mm, math.nan, thing.z_mm)
        if thing.kind != "bump":  # where a bump begins is nobody's to say
            yield Number("length", where, best.length_mm, math.nan, thing.length_mm)
        if thing.kind != "groove":
            yield Number("clock", where, turn, math.nan, 0.0)
        if thing.kind == "pocket":
            yield Number("arc", where, best.arc_deg, math.nan, thing.arc_deg)
        return
    if best.kind not in (thing.kind, *ACCEPTS[thing.kind]):
        return
    ends = thing.kind == "bend" and (thing.span_mm[0] < seen[0] or thing.span_mm[1] > seen[1])
    for name in MEASURES.get(thing.kind, ()):
        if name not in best.numbers or (ends and name != "radius_mm"):
            continue
        true = thing.numbers.get(name, thing.depth_mm)
        if thing.kind in ("silt", "water") and name == "depth_mm":
            wall = float(surface.shape(np.array(thing.clock_deg), np.array(thing.z_mm)))
            true = wall - thing.numbers["level_mm"]
        yield Number(CALLED[name], where, *best.numbers[name], true)
    if thing.kind in ("branch", "tee"):
        yield Number("place", where, best.z_mm, math.nan, thing.z_mm)
        yield Number("clock", where, turn, math.nan, 0.0)


def _away(thing: Thing, one: Listed, radius: float) -> float:
    turn = math.radians(float(away_deg(np.array(one.clock_deg), thing.clock_deg)))
    return math.hypot(one.z_mm - thing.z_mm, turn * radius if thing.arc_deg < 360.0 else 0.0)


def _is_of_another(one: Listed, thing: Thing, scene: Scene) -> bool:
    """Whether a line is the right name of some other thing there."""
    radius = scene.pipe.radius_mm
    return any(
        other is not thing and one.kind in ACCEPTS[other.kind] and overlap(other, one, radius)
        for other in scene.pipe.things
    )


def _over(scene: Scene, results: Results, surface: Surface) -> Iterator[tuple[str, bool]]:
    """Everything over its limit, and whether the verdict names its place as one where nothing is established."""
    seen = results.from_mm, results.to_mm
    for thing in scene.pipe.things:
        inside = min(thing.span_mm[1], seen[1]) - max(thing.span_mm[0], seen[0])
        for (section, quantity), value in limited(thing).items():
            limit = scene.limits.get(section, {}).get(quantity, math.inf)
            if value > limit and inside > INSIDE * thing.length_mm:
                hidden = is_not_established(thing, results, scene.pipe.radius_mm)
                yield f"{thing.kind} at {thing.z_mm:.0f} mm: {quantity} {value:.2f} over {limit:.2f}", hidden
    oval, limit = worst_ovality(surface, *seen), scene.limits["ovality"]["percent"]
    if oval > limit:
        yield f"ovality {oval:.2f} % over {limit:.2f}", False
