"""What the windows of a long pipe say together: one survey of the whole, its map no finer than can be held and shown.

Of each window's survey an `Abstract` is kept, whose size does not depend on how many points or rows the window had.
What two windows found at the cut between them is told once: by the one that has its middle between its cuts, or, where
it reaches farther than a window sees, as one thing from end to end.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.centreline import Centreline, Piece
from annulus_pipe.wall.defects import Defect, Detection, Kind
from annulus_pipe.wall.features import Feature, FeatureKind, FeatureMeasure
from annulus_pipe.wall.grid import Wall, WallObservations
from annulus_pipe.wall.stations import Stations
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wall.unjudged import in_one
from annulus_pipe.wall.windows import Window

TOUCH_MM = 1.0  # beside a row: findings of two neighbouring windows whose ends are closer than this are one
Found = TypeVar("Found", Defect, Feature)


@dataclass(frozen=True, slots=True)
class Sums:
    """What is counted of a survey, and cannot be told from its map any more.

    points : of the cloud. cells, seen_cells, hidden_cells : of the map. seen_by_cells : by camera id, and None of
    several. rejected : slits, by reason. lean_sigma_deg (F,) : of each frame with a pose. roll_deg : least and
    greatest.
    """

    points: int = 0
    cells: int = 0
    seen_cells: int = 0
    hidden_cells: int = 0
    seen_by_cells: Mapping[int | None, float] = field(default_factory=dict)
    rejected: Mapping[str, int] = field(default_factory=dict)
    lean_sigma_deg: FloatArray = field(default_factory=lambda: np.zeros(0))
    roll_deg: tuple[float, float] | None = None

    @classmethod
    def of(cls, survey: Survey) -> "Sums":
        cells = survey.wall.radius_mm.size
        lean = [p.lean_sigma_deg for p in survey.profiles if p.pose is not None]
        seen_by = {one: part * cells for one, part in survey.seen_by_fraction().items()}
        return cls(
            survey.points,
            cells,
            int(survey.wall.seen.sum()),
            int(survey.shadowed.sum()),
            seen_by,
            survey.rejected,
            np.array(lean, np.float64),
            survey.roll_range_deg,
        )

    def plus(self, other: "Sums") -> "Sums":
        rolls = [one for one in (self.roll_deg, other.roll_deg) if one is not None]
        return Sums(
            self.points + other.points,
            self.cells + other.cells,
            self.seen_cells + other.seen_cells,
            self.hidden_cells + other.hidden_cells,
            dict(Counter(self.seen_by_cells) + Counter(other.seen_by_cells)),
            dict(sorted((Counter(self.rejected) + Counter(other.rejected)).items())),
            np.concatenate([self.lean_sigma_deg, other.lean_sigma_deg]),
            (min(a for a, _ in rolls), max(b for _, b in rolls)) if rolls else None,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Joined(Survey):
    """A survey of many windows: its map in longer rows, no cloud; counts are over all windows."""

    sums: Sums = field(default_factory=Sums)

    @property
    def points(self) -> int:
        return self.sums.points

    @property
    def seen_fraction(self) -> float:
        return self.sums.seen_cells / max(self.sums.cells, 1)

    @property
    def shadowed_fraction(self) -> float:
        return self.sums.hidden_cells / max(self.sums.cells, 1)

    def seen_by_fraction(self) -> dict[int | None, float]:
        return {one: cells / max(self.sums.cells, 1) for one, cells in self.sums.seen_by_cells.items()}

    @property
    def rejected(self) -> Mapping[str, int]:
        return self.sums.rejected

    @property
    def lean_sigma_deg(self) -> float:
        known = self.sums.lean_sigma_deg[np.isfinite(self.sums.lean_sigma_deg)]
        return float(np.median(known)) if len(known) else math.nan

    @property
    def roll_range_deg(self) -> tuple[float, float] | None:
        return self.sums.roll_deg


@dataclass(frozen=True, slots=True, eq=False)
class Abstract:
    """What of a window's survey the whole is told from: the window, the survey with a coarser map and without its
    points, what was counted, and what the finer map could not say."""

    window: Window
    survey: Survey
    sums: Sums
    findings: tuple[Finding, ...]


def abstract(survey: Survey, window: Window, step_mm: float) -> Abstract:
    """survey : of one window, as `between` leaves it. step_mm : of a row of the whole's map."""
    wall = survey.wall
    group = np.floor(wall.z_mm / step_mm).astype(np.int64)
    many = max(1, round(step_mm / wall.z_step_mm))
    row = group - group[0]
    count = int(row[-1]) + 1
    at = np.floor(wall.z_mm / wall.z_step_mm).astype(np.int64) - group[0] * many

    def pooled(values: NDArray[Any], how: Callable[..., Any], empty: Any) -> NDArray[Any]:
        if many == 1:
            return values
        whole = np.full((count * many, *values.shape[1:]), empty, values.dtype)
        whole[at] = values
        with np.errstate(all="ignore"):
            return np.asarray(how(whole.reshape(count, many, *values.shape[1:]), axis=1), values.dtype)

    nan = np.float32(np.nan)
    texture = None if survey.texture is None else _pooled_colour(survey.texture, at, count, many)
    coarse = Wall(
        (np.arange(count) + group[0] + 0.5) * step_mm,
        wall.clock_deg,
        pooled(wall.radius_mm, _median, nan),
        pooled(wall.count, np.sum, 0),
        pooled(wall.shape_mm, np.nanmean, np.nan),
        pooled(wall.shape_covariance, np.nanmax, np.nan),
        pooled(wall.noise_mm, np.nanmean, np.nan),
        pooled(wall.cell_noise_mm, _median, nan),
        _nobody(),
        pooled(wall.sigma_mm, _median, nan),
        wall.scale_part,
        wall.oval_part,
    )
    hidden = pooled(survey.shadowed, np.any, False) & ~coarse.seen
    bare = replace(
        survey,
        profiles=(),
        wall=coarse,
        shadowed=hidden,
        detection=replace(survey.detection, label=pooled(survey.detection.label, np.max, 0)),
        texture=texture,
        no_wall=None,
    )
    return Abstract(window, bare, Sums.of(survey), survey.findings)


def joined(parts: Sequence[Abstract], more: Sequence[Finding] = ()) -> Joined:
    """All windows of a pipe as one survey, in their order."""
    surveys = [part.survey for part in parts]
    cuts = [part.window.last_mm for part in parts[:-1]]
    step = max(one.wall.z_step_mm for one in surveys)
    defects, number = _each_once([one.defects for one in surveys], cuts, step, _one_defect)
    features, _ = _each_once([one.features for one in surveys], cuts, step, _one_feature)
    rows = _JoinedRows.of([one.wall for one in surveys], step)
    label = rows.laid([of[one.detection.label] for of, one in zip(number, surveys, strict=True)], 0)
    sums = Sums()
    for part in parts:
        sums = sums.plus(part.sums)
    detection = Detection(
        tuple(defects),
        label,
        surveys[0].detection.limits,
        tuple(place for one in surveys for place in one.detection.undecided),
    )
    timing: Counter[str] = Counter()
    for one in surveys:
        timing.update(one.timing_ms)
    first = surveys[0]
    colours = [one.texture for one in surveys if one.texture is not None]
    stations = Stations(
        **{
            one.name: np.concatenate([getattr(survey.stations, one.name) for survey in surveys])
            for one in fields(Stations)
        }
    )
    findings = [finding for part in parts for finding in part.survey.disbelieved]
    lost = _by_kind([finding for part in parts for finding in part.survey.rings_lost or ()], len(parts))
    return Joined(
        profiles=(),
        wall=_side_by_side([one.wall for one in surveys], rows),
        shadowed=rows.laid([one.shadowed for one in surveys], False),
        detection=detection,
        stations=stations,
        texture=rows.laid(colours, 0) if len(colours) == len(surveys) else None,
        vibration=None,
        features=tuple(features),
        centreline=centreline_of(parts),
        disbelieved=(*findings, *more),
        nominal_diameter_mm=first.nominal_diameter_mm,
        timing_ms=dict(timing),
        cameras=first.cameras,
        light=first.light,
        rings_lost=lost,
        sums=sums,
        unjudged=in_one([survey.unjudged for survey in surveys], TOUCH_MM + step),
        scale=first.scale,
    )


def centreline_of(parts: Sequence[Abstract]) -> Centreline:
    """The pieces of all windows, each cut off at its window's ends; one that crosses a cut becomes one piece again."""
    pieces: list[Piece] = []
    for part in parts:
        first, last = part.window.first_mm, part.window.last_mm
        own = part.survey.centreline.pieces
        at = int(part.survey.centreline.piece_of(np.array([first]))[0]) if math.isfinite(first) else 0
        for i, piece in enumerate(own[at:]):
            if i and not first < piece.start_mm < last:
                continue
            if i == 0 and pieces:
                before = pieces[-1]
                if piece.curvature == before.curvature == (0.0, 0.0) and piece.taper == before.taper == 0.0:
                    continue  # straight on
                radius = piece.radius_mm + piece.taper * (first - piece.start_mm)
                piece = Piece(first, radius, curvature=piece.curvature, taper=piece.taper)
            pieces.append(piece)
    return Centreline(pieces)


def _each_once(
    found: Sequence[Sequence[Found]], cuts: Sequence[float], step_mm: float, one: Callable[[Found, Found], Found]
) -> tuple[list[Found], list[NDArray[np.int32]]]:
    """All findings in the order of the pipe, one that two windows share merged into one; and for each window an array
    that maps the number of its finding, from 1, to its number in that list. 0 maps to 0, as does a finding that is
    left out."""
    merged: list[Found] = []
    became = [np.zeros(len(own) + 1, np.int64) for own in found]
    open_ones: dict[int, int] = {}  # the window before's that reach its last cut, by number: index in `merged`
    for k, own in enumerate(found):
        first, last = ([-math.inf, *cuts][k], [*cuts, math.inf][k])
        taken: set[int] = set()
        now_open: dict[int, int] = {}
        for i, finding in enumerate(own):
            begin, end = finding.z_range_mm
            here = None
            if begin < first:
                here = next(
                    (j for j in open_ones.values() if j not in taken and _same(merged[j], finding, step_mm)), None
                )
                if here is None and finding.z_mm < first:
                    continue  # the window before, whose it is, did not see it so
            if here is not None:
                taken.add(here)
                merged[here] = one(merged[here], finding)
            else:
                here = len(merged)
                merged.append(finding)
            became[k][i + 1] = here + 1
            if end >= last:
                now_open[i] = here
        open_ones = now_open
    order = sorted(range(len(merged)), key=lambda j: (merged[j].z_mm, merged[j].clock_deg))
    rank = np.zeros(len(merged) + 1, np.int32)
    rank[[j + 1 for j in order]] = np.arange(1, len(merged) + 1)
    return [merged[j] for j in order], [rank[numbers].astype(np.int32) for numbers in became]


def _same(one: Defect | Feature, other: Defect | Feature, step_mm: float) -> bool:
    """Whether what two windows found is one thing: of one kind, side by side round the pipe, touching along it."""
    gap = max(one.z_range_mm[0], other.z_range_mm[0]) - min(one.z_range_mm[1], other.z_range_mm[1])
    away = abs((one.clock_deg - other.clock_deg + 180.0) % 360.0 - 180.0)
    near = away <= (one.arc_deg + other.arc_deg) / 2 or one.kind in (Kind.OVALITY, FeatureKind.BEND, FeatureKind.TAPER)
    return one.kind == other.kind and near and gap <= step_mm + TOUCH_MM


def _one_defect(one: Defect, other: Defect) -> Defect:
    """Of two windows' word for one defect: the fuller, from end to end of both."""
    deepest = max(one, other, key=lambda d: (d.floor_seen, d.depth_mm))
    begin, end = _ends(one, other)
    return replace(
        deepest,
        z_mm=(begin + end) / 2,
        length_mm=end - begin,
        arc_deg=max(one.arc_deg, other.arc_deg),
        area_mm2=max(one.area_mm2, other.area_mm2, deepest.area_mm2 * (end - begin) / max(deepest.length_mm, 1e-9)),
    )


def _one_feature(one: Feature, other: Feature) -> Feature:
    begin, end = _ends(one, other)
    longest = max(one, other, key=lambda f: f.length_mm)
    measures = longest.measures
    if one.kind is FeatureKind.BEND:
        radius = longest.measured("radius_mm")
        values = {"start_mm": begin, "angle_deg": math.degrees((end - begin) / radius)}
        measures = tuple(FeatureMeasure(m.name, values.get(m.name, m.value), m.k2) for m in longest.measures)
    return replace(longest, z_mm=(begin + end) / 2, length_mm=end - begin, measures=measures)


def _ends(one: Defect | Feature, other: Defect | Feature) -> tuple[float, float]:
    return min(one.z_range_mm[0], other.z_range_mm[0]), max(one.z_range_mm[1], other.z_range_mm[1])


def _by_kind(findings: Sequence[Finding], windows: int) -> tuple[Finding, ...]:
    """One of each kind, which says in how many windows it was told."""
    first: dict[str, Finding] = {}
    times: Counter[str] = Counter(str(one.kind) for one in findings)
    for one in findings:
        first.setdefault(str(one.kind), one)
    return tuple(
        replace(
            one, text=f"{one.text} (told {times[kind]} times in {windows} windows)" if times[kind] > 1 else one.text
        )
        for kind, one in first.items()
    )


@dataclass(frozen=True, slots=True, eq=False)
class _JoinedRows:
    """Where the rows of windows stand on one grid; rows that no window has are of nobody."""

    own: NDArray[np.int64]  # (R,) of each window's rows, one after the other: which of the grid's they are
    z_mm: FloatArray  # (Z,) of the grid

    @classmethod
    def of(cls, walls: Sequence[Wall], step_mm: float) -> "_JoinedRows":
        z = np.concatenate([wall.z_mm for wall in walls])
        own = np.rint((z - z[0]) / step_mm).astype(np.int64)
        return cls(own, z[0] + np.arange(int(own[-1]) + 1) * step_mm)

    def laid(self, values: Sequence[NDArray[Any]], empty: Any) -> NDArray[Any]:
        """(Z, ..) those rows; `empty` where nobody has one."""
        stacked = np.concatenate(values)
        out = np.full((len(self.z_mm), *stacked.shape[1:]), empty, stacked.dtype)
        out[self.own] = stacked
        return out

    def carried(self, values: Sequence[NDArray[Any]]) -> NDArray[Any]:
        """(Z, ..) those rows; of the nearest before where nobody has one."""
        before = np.searchsorted(self.own, np.arange(len(self.z_mm)), side="right") - 1
        return np.asarray(np.concatenate(values)[before])


def _side_by_side(walls: Sequence[Wall], rows: _JoinedRows) -> Wall:
    unknown = np.float32(np.nan)
    return Wall(
        rows.z_mm,
        walls[0].clock_deg,
        rows.laid([one.radius_mm for one in walls], unknown),
        rows.laid([one.count for one in walls], 0),
        rows.carried([one.shape_mm for one in walls]),
        rows.laid([one.shape_covariance for one in walls], np.inf),
        rows.carried([one.noise_mm for one in walls]),
        rows.carried([one.cell_noise_mm for one in walls]),
        _nobody(),
        rows.laid([one.sigma_mm for one in walls], unknown),
        walls[0].scale_part,
        walls[0].oval_part,
    )


def _nobody() -> WallObservations:
    return WallObservations(
        np.zeros(0, np.int64),
        np.zeros(0, np.int32),
        np.zeros(0, np.float32),
        np.zeros(0, np.float32),
        np.zeros(0, np.uint8),
    )


def _median(values: NDArray[Any], axis: int) -> NDArray[Any]:
    """NaN passed over."""
    ordered = np.sort(values, axis=axis)  # NaN last
    known = np.isfinite(values).sum(axis=axis, keepdims=True)
    low = np.take_along_axis(ordered, np.maximum(known - 1, 0) // 2, axis=axis)
    high = np.take_along_axis(ordered, np.minimum(known // 2, values.shape[axis] - 1), axis=axis)
    return np.asarray(np.where(known > 0, 0.5 * (low + high), np.nan).squeeze(axis))


def _pooled_colour(texture: NDArray[np.uint8], at: NDArray[np.int64], count: int, many: int) -> NDArray[np.uint8]:
    """(G, A, 4): of each group of rows the mean of the cells that are known."""
    if many == 1:
        return texture
    whole = np.zeros((count * many, *texture.shape[1:]), np.uint8)
    whole[at] = texture
    grouped = whole.reshape(count, many, *texture.shape[1:])
    known = grouped[..., 3:] > 0
    mean = (grouped * known).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.asarray(np.rint(mean), np.uint8)
