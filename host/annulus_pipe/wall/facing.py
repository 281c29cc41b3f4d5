"""One wall from two views of it, a forward and a backward one, each of which sees what steps hide from the other.

A step throws a shadow along the light (Alzuhiri 2022, Eq. 3.24), so a head that looks the other way sees what lies in
it (§3.5.1.2). Both were surveyed by themselves, each with its own calibration and its own direction of light. Here the
backward wall is turned about, put where it was matched, and both become one grid: where both saw, each cell by their
sigmas; where one did, as it was; where none did, not seen.

What is common to both is not counted twice. The size of the pipe comes from the surer view alone, for both may go back
to one reference; of one calibration the share of every sigma that it causes does not shrink. The odometer moves both
along together, and is in no radius.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.rounding import MEASURE, PERCENT, off, quoted
from annulus_pipe.vocabulary import AnnulusError, Finding
from annulus_pipe.wall.apart import sound_wall_apart
from annulus_pipe.wall.before import Standing
from annulus_pipe.wall.defects import find_defects
from annulus_pipe.wall.extent import as_large
from annulus_pipe.wall.features import Feature, FeatureKind
from annulus_pipe.wall.grid import Wall, row_noise
from annulus_pipe.wall.indications import Limits, Scale
from annulus_pipe.wall.lost import lost_rings
from annulus_pipe.wall.opposite import (
    GridView,
    Placed,
    Taken,
    combined,
    common_rows,
    common_shape,
    middle,
    observations_of,
    view_of_aft,
    view_of_fore,
)
from annulus_pipe.wall.points import WallPoints
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.scale import AbsoluteScale
from annulus_pipe.wall.shape import fit_shape
from annulus_pipe.wall.survey import Survey, Views, stations_of
from annulus_pipe.wall.unjudged import find_unjudged, nameless, wider

DISAGREE = "views-disagree"  # kind of a finding
SIZES_APART = 1.5  # times k = 2 of both scales by which two diameters may differ; both ways by test_there_and_back.py
SAME_FEATURE_OF_RADIUS = 0.15  # of the radius: so near along the pipe two features of a kind are one; unguarded
BACKWARD = "backward view: "


def facing(
    fore: Survey, aft: Survey, placed: Placed, calibrations: tuple[Calibration, Calibration], *, one_head: bool = False
) -> Survey:
    """One survey of what both saw, on the forward one's z and clock.

    Parameters
    ----------
    fore, aft : of a pipe without bends, each as its head saw it. placed : the backward one's rows on the forward one's
    wall. calibrations : of both. one_head : both were measured with one calibration, whose share of the errors is the
    same.

    Raises
    ------
    AnnulusError where one has a bend.
    """
    for one in (fore, aft):
        if any(feature.kind is FeatureKind.BEND for feature in one.features):
            raise AnnulusError("two views are joined in a pipe without bends, and this one has one")
    z_mm, rows = common_rows(fore.wall, placed)
    clock = fore.wall.clock_deg
    taken = Taken(aft.wall, placed, z_mm, clock)
    mine, theirs = view_of_fore(fore.wall, len(z_mm), rows), view_of_aft(aft.wall, taken, fore.wall)
    size, sure, aft_leads = _sizes(fore, aft, mine, theirs)
    if aft_leads:
        mine = replace(mine, shape=mine.shape + size)
    else:
        theirs = replace(theirs, shape=theirs.shape - size)
    shape = common_shape(mine, theirs, clock)
    radius, point, noise, apart = combined(mine, theirs, shape, one_head)
    seen = np.isfinite(radius)
    observations = observations_of(
        fore.wall, aft.wall, taken, placed, rows, (shape - mine.shape, shape - theirs.shape), z_mm, seen
    )
    count = np.zeros(radius.shape, np.int32)
    count[rows] = fore.wall.count
    count += np.asarray(taken.nearest(aft.wall.count), np.int32)
    count[~seen] = 0
    coefficients, covariance = fit_shape(radius, z_mm, clock)
    leader = aft if aft_leads else fore
    bare = Wall(
        z_mm,
        clock,
        radius.astype(np.float32),
        count,
        coefficients,
        covariance,
        np.zeros(len(z_mm)),
        noise.astype(np.float32),
        observations,
        np.where(seen, point, np.nan).astype(np.float32),
        leader.wall.scale_part,
        leader.wall.oval_part,
    )
    of_rows = row_noise(bare)
    wall = replace(bare, noise_mm=of_rows, cell_noise_mm=np.maximum(noise, of_rows[:, None]).astype(np.float32))
    scale = leader.scale
    both = mine.seen & theirs.seen
    disagree = _disagreement(wall, apart, both)
    differs = abs(size) > SIZES_APART * 2.0 * sure
    findings: list[Finding] = []
    if differs and scale is not None:
        scale = replace(scale, astray=math.hypot(scale.astray, size / wall.mean_radius_mm))
        wall = replace(wall, scale_part=math.hypot(wall.scale_part, size / wall.mean_radius_mm))
    if differs:
        findings.append(_sizes_differ(fore, size, sure))
    if disagree > 0:
        text = (
            f"the two views disagree over {quoted(100 * disagree, PERCENT)} of the wall that both saw, by more than "
            "they may be off: one head's calibration is wrong, or they were laid together wrongly. The sigmas there "
            "hold both"
        )
        findings.append(Finding(DISAGREE, text))
    total = np.sqrt(mine.variance + theirs.variance)
    alone = np.zeros(seen.shape, bool)
    alone[rows] = fore.wall.seen
    at = slice(rows.start, rows.stop)
    views = Views(
        middle(placed.z_mm + aft.wall.z_mm),
        middle(placed.sigma_z_mm),
        float(np.median(taken.roll_deg[taken.seen])) % 360.0 if taken.seen.any() else math.nan,
        middle(placed.sigma_roll_deg),
        placed.matched,
        float(1.0 - alone[at].mean()),
        float(1.0 - seen[at].mean()),
        middle(np.abs(mine.residual - theirs.residual)[both] / total[both]),
        disagree,
        2.0 * size,
        4.0 * sure,
    )
    return _surveyed(fore, aft, wall, taken, placed, rows, calibrations, scale, tuple(findings), views)


def _sizes(fore: Survey, aft: Survey, mine: GridView, theirs: GridView) -> tuple[float, float, bool]:
    """Backward less forward mean radius, mm; what it may be by both scales, k = 1; whether the backward one is surer.
    Nothing where no row was seen by both."""
    away = (theirs.shape - mine.shape).mean(axis=1)
    size = middle(away[(mine.seen & theirs.seen).any(axis=1)])
    radius = fore.wall.mean_radius_mm
    by_scales = math.hypot(fore.wall.scale_part, aft.wall.scale_part) * radius
    known = [math.sqrt(max(float(np.median(one.wall.shape_covariance[:, 0, 0])), 0.0)) for one in (fore, aft)]
    leads = fore.scale is not None and aft.scale is not None and aft.wall.scale_part < 0.5 * fore.wall.scale_part
    return (0.0 if math.isnan(size) else size), math.hypot(by_scales, *known), leads


def _disagreement(wall: Wall, apart: BoolArray, both: BoolArray) -> float:
    """Part of what both saw where they differ over patches as large as a defect: beside edges every view errs."""
    large = as_large(apart, Scale.of(wall, Limits()))
    return float(int(np.count_nonzero(large)) / max(int(np.count_nonzero(both)), 1))


def _sizes_differ(fore: Survey, size: float, sure: float) -> Finding:
    text = (
        f"the backward view has the pipe {off(2.0 * abs(size), MEASURE)} "
        f"{'wider' if size > 0 else 'narrower'} than the forward one, and both scales together explain "
        f"{off(4.0 * sure, MEASURE)} (k = 2): one head is calibrated wrongly. Diameters are those of the surer view, "
        "and may be off by the difference"
    )
    return Finding(DISAGREE, text)


def _surveyed(
    fore: Survey,
    aft: Survey,
    wall: Wall,
    taken: Taken,
    placed: Placed,
    rows: slice,
    calibrations: tuple[Calibration, Calibration],
    scale: AbsoluteScale | None,
    findings: tuple[Finding, ...],
    views: Views,
) -> Survey:
    """All that follows from the common wall."""

    def mask(one: BoolArray | None, other: BoolArray | None) -> BoolArray:
        out = np.zeros(wall.radius_mm.shape, bool)
        if one is not None:
            out[rows] = one
        if other is not None:
            out |= np.asarray(taken.nearest(other), bool)
        return out

    turn = _Turn(aft.wall, placed)
    features = _features(fore, aft, turn, SAME_FEATURE_OF_RADIUS * wall.mean_radius_mm)
    kinds = (FeatureKind.JOINT, FeatureKind.GAP, FeatureKind.NAMELESS)
    joints = np.zeros(len(wall.z_mm), bool)
    for one in features:
        if one.kind in kinds:
            joints |= (wall.z_mm >= one.z_range_mm[0]) & (wall.z_mm <= one.z_range_mm[1])
    explained, dark = mask(fore.explained, aft.explained), mask(fore.shadowed, aft.shadowed) & ~wall.seen
    no_wall = None
    if fore.no_wall is not None or aft.no_wall is not None:
        no_wall = mask(fore.no_wall, aft.no_wall)
    rises: list[FloatArray] = [np.array([math.tan(ring.half_angle) for ring in one.rings]) for one in calibrations]
    ratios = 1.0 / (rises[0] if len(rises[0]) >= len(rises[1]) else rises[1])
    profiles = (*(_by(one, 0) for one in fore.profiles), *(turn.profile(one) for one in aft.profiles))
    detection = find_defects(
        wall,
        shadow_ratio=1.0 / min(float(one[0]) for one in rises),
        least_shadow_ratio=1.0 / max(float(one[-1]) for one in rises),
        features=explained,
        joints=joints,
        points=cache(lambda: WallPoints.of(wall, profiles, ratios)),
    )
    unjudged = find_unjudged(
        wall,
        detection,
        explained=explained,
        joints=joints,
        shadowed=dark,
        no_wall=no_wall,
        looks=None,
        rings=min(len(one) for one in rises),
        profiles=profiles,
        apart=sound_wall_apart(wall, None),
    )
    standing = (*fore.standing, *(turn.standing(one) for one in aft.standing))
    unjudged = (*unjudged, *nameless(features), *wider(features, *wall.extent[:2]), *(one.place for one in standing))
    texture = None
    if fore.texture is not None:
        texture = np.zeros((*wall.radius_mm.shape, 4), np.uint8)
        texture[rows] = fore.texture
    return replace(
        fore,
        profiles=profiles,
        wall=wall,
        shadowed=dark,
        detection=detection,
        stations=stations_of(wall, no_wall),
        texture=texture,
        features=features,
        disbelieved=(
            *fore.disbelieved,
            *(replace(one, text=BACKWARD + one.text) for one in aft.disbelieved),
            *findings,
        ),
        cameras=(0, 1),
        rings_lost=(*_lost(fore), *(replace(one, text=BACKWARD + one.text) for one in _lost(aft))),
        no_wall=no_wall,
        explained=explained,
        unjudged=unjudged,
        standing=standing,
        scale=scale,
        views=views,
    )


class _Turn:
    """The backward survey's places as the forward one has them."""

    def __init__(self, wall: Wall, placed: Placed) -> None:
        known = np.isfinite(placed.z_mm)
        self._own = wall.z_mm[known]
        self._away = (placed.z_mm + wall.z_mm)[known]
        self._roll = np.unwrap(placed.roll_deg[known], period=360.0)

    def z(self, z_mm: FloatArray) -> FloatArray:
        return np.asarray(np.interp(z_mm, self._own, self._away) - z_mm)

    def roll(self, z_mm: FloatArray) -> FloatArray:
        return np.asarray(np.interp(z_mm, self._own, self._roll))

    def place(self, z_mm: float, clock_deg: float) -> tuple[float, float]:
        at = np.array([z_mm])
        return float(self.z(at)[0]), float(self.roll(at)[0] - clock_deg) % 360.0

    def feature(self, one: Feature) -> Feature:
        z, clock = self.place(one.z_mm, one.clock_deg)
        return replace(one, z_mm=z, clock_deg=0.0 if one.arc_deg >= 360.0 else clock)

    def standing(self, one: Standing) -> Standing:
        last, clock = self.place(one.z_from_mm, one.clock_deg)
        first, _ = self.place(one.z_to_mm, one.clock_deg)
        return replace(one, z_from_mm=first, z_to_mm=last, clock_deg=clock)

    def profile(self, one: Profile) -> Profile:
        """Its points; of its pose the place of the camera is kept, for a `Pose` cannot look back and be rolled."""
        points = one.points_mm.astype(np.float64)
        x, y, z = points.T
        radius, clock = np.hypot(x, y), np.radians(self.roll(z)) - np.arctan2(x, -y)
        points = np.stack([radius * np.sin(clock), -radius * np.cos(clock), self.z(z)], axis=1)
        pose, (at, _) = one.pose, self.place(one.z_mm, 0.0)
        if pose is not None:
            eye = pose.to_pipe(np.zeros((1, 3)))[0]
            turn = math.radians(float(self.roll(np.array([one.z_mm]))[0])) - math.atan2(eye[0], -eye[1])
            aside = math.hypot(eye[0], eye[1]) * np.array([math.sin(turn), -math.cos(turn), 0.0])
            pose = Pose(pose.rx, pose.ry + math.pi, roll=pose.roll)
            moved = -pose.rotation @ aside
            pose = replace(pose, tx=float(moved[0]), ty=float(moved[1]))
        return replace(_by(one, 1), points_mm=points.astype(np.float32), pose=pose, z_mm=at)


def _by(one: Profile, view: int) -> Profile:
    return replace(one, camera=view, seen_by=np.full(len(one.ring), view, np.uint8))


def _features(fore: Survey, aft: Survey, turn: _Turn, near_mm: float) -> tuple[Feature, ...]:
    """The forward view's, and those that only the backward one shows."""
    out = list(fore.features)
    for one in map(turn.feature, aft.features):
        if not any(one.kind is two.kind and abs(one.z_mm - two.z_mm) < near_mm for two in out):
            out.append(one)
    return tuple(sorted(out, key=lambda one: (one.z_mm, one.clock_deg)))


def _lost(survey: Survey) -> tuple[Finding, ...]:
    return lost_rings(survey.profiles) if survey.rings_lost is None else survey.rings_lost
