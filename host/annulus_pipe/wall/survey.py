"""What a scan says of a pipe: the whole pipeline from profiles to wall, defects, diameters and colour, in one call."""

import math
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import BoolArray, FloatArray, Image
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.apart import sound_wall_apart
from annulus_pipe.wall.axis import find_axis
from annulus_pipe.wall.before import Standing, find_objects
from annulus_pipe.wall.bends import find_bends
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.consistency import without_inconsistent
from annulus_pipe.wall.crosscheck import with_edges, with_revised_sigma
from annulus_pipe.wall.defects import Defect, Detection, Kind, find_defects
from annulus_pipe.wall.features import Feature
from annulus_pipe.wall.grid import Wall, build_wall
from annulus_pipe.wall.gyro import NO_TURNS, Turns
from annulus_pipe.wall.indications import Scale
from annulus_pipe.wall.joints import common_mm, find_joints, taken, without_hidden
from annulus_pipe.wall.levels import covered, without_levels
from annulus_pipe.wall.looks import looks_of
from annulus_pipe.wall.lost import lost_rings, objects_before_the_wall
from annulus_pipe.wall.openings import find_openings
from annulus_pipe.wall.pace import Pace
from annulus_pipe.wall.points import WallPoints
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.registration import register
from annulus_pipe.wall.rests import without_rests
from annulus_pipe.wall.scale import AbsoluteScale, find_scale, scale_findings, with_drift, with_marks, with_scale
from annulus_pipe.wall.shadow import shadowed
from annulus_pipe.wall.standing import depth_limit_mm
from annulus_pipe.wall.stations import Stations, measure_stations, not_enough_seen
from annulus_pipe.wall.surface import Mesh, triangulate
from annulus_pipe.wall.texture import LedFrame, paint
from annulus_pipe.wall.unjudged import Unjudged, find_unjudged, nameless, wider
from annulus_pipe.wall.vibration import Vibration, without_vibration


@dataclass(frozen=True, slots=True)
class Views:
    """What two views of one wall, a forward and a backward one, are to each other. mm, degrees; sigmas are k = 1.

    moved_mm, turned_deg : what lies at z and clock of the backward view lies at moved_mm - z, turned_deg - clock of the
    forward one; the middle row's. matched : whether the wall itself said both; else the mounting did. not_seen_alone,
    not_seen : of the wall's area, 0..1, by the forward view alone and by neither. differ_sigma : by how many of their
    sigmas they differ where both saw, in the median; 0.67 where the sigmas are right. disagree_fraction : of what both
    saw, by more than is explained. size_mm, size_k2_mm : backward less forward diameter, and what it may be by their
    scales.
    """

    moved_mm: float
    moved_sigma_mm: float
    turned_deg: float
    turned_sigma_deg: float
    matched: bool
    not_seen_alone: float
    not_seen: float
    differ_sigma: float
    disagree_fraction: float
    size_mm: float
    size_k2_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """The pipe as one scan shows it. Lengths in mm, pipe frame; NaN where nothing could be measured.

    Attributes
    ----------
    profiles : aligned with each other, without what other frames contradict; every point of the cloud.
    wall : the grid (Z, A) of radii, and the pipe's shape under its defects.
    shadowed : (Z, A) bool, cells that a step keeps the rings' light from; a part of what was not seen.
    detection : the defects, which cells each has, the limits of listing, how many places are not surely known.
    stations : diameters and ovality along the pipe.
    texture : (Z, A, 4) uint8 RGBA in its `light`, alpha 0 where not known; None without a usable frame of it.
    vibration : what shook periodically and was taken out; None where nobody asked.
    features : joints, openings, levels and the like, in order of distance; none of them is a defect.
    centreline : pipe coordinates, in which all of this is, and the way to space.
    disbelieved : what of the sensors the rings contradict, and of the labels the pictures.
    nominal_diameter_mm : of the calibration. cameras : of the head, their ids.
    timing_ms : of every step.
    """

    profiles: tuple[Profile, ...]
    wall: Wall
    shadowed: BoolArray
    detection: Detection
    stations: Stations
    texture: Image | None
    vibration: Vibration | None
    features: tuple[Feature, ...]
    centreline: Centreline
    disbelieved: tuple[Finding, ...]
    nominal_diameter_mm: float
    timing_ms: Mapping[str, float]
    cameras: tuple[int, ...]
    light: str = "LED light"  # that `texture` shows the wall in
    beside: Mapping[str, object] = field(default_factory=dict)  # what wings have to say of the pipe, by their names
    rings_lost: tuple[Finding, ...] | None = None  # of the pattern; None: as `profiles` show
    no_wall: BoolArray | None = None  # (Z, A) cells of openings, which no diameter has its ends in; None: none
    explained: BoolArray | None = None  # (Z, A) cells of joints, openings and levels, where no defect is looked for
    unjudged: tuple[Unjudged, ...] = ()  # where a limit may be broken although nothing listed breaks it
    standing: tuple[Standing, ...] = ()  # in the bore, before the wall
    scale: AbsoluteScale | None = None  # what anchors lengths across the pipe; None where nothing is known of that
    views: Views | None = None  # of a wall that two heads saw from both ends; None: one did

    @property
    def defects(self) -> tuple[Defect, ...]:
        """In order of distance."""
        return self.detection.defects

    @property
    def worst(self) -> Defect | None:
        """The deepest loss or bump, an out-of-round stretch only where there is neither; None for a sound wall."""
        return max(self.defects, key=lambda d: (d.kind is not Kind.OVALITY, d.depth_mm), default=None)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Where too little was seen to say what shape the pipe has; which rings of the pattern were lost; what stands
        before the wall; what of the sensors was not believed."""
        lost = lost_rings(self.profiles) if self.rings_lost is None else self.rings_lost
        return (
            *not_enough_seen(self.wall, self.features),
            *lost,
            *objects_before_the_wall(self.profiles),
            *(one.finding for one in self.standing),
            *scale_findings(self.scale),
            *self.disbelieved,
        )

    @property
    def points(self) -> int:
        return sum(len(profile.points_mm) for profile in self.profiles)

    @property
    def scanned_mm(self) -> tuple[float, float]:
        """First and last end of the wall, along the pipe."""
        return self.wall.extent[:2]

    @property
    def seen_fraction(self) -> float:
        """Of the wall's area, 0..1."""
        return float(self.wall.seen.mean())

    @property
    def shadowed_fraction(self) -> float:
        """Of the wall's area, 0..1."""
        return float(self.shadowed.mean())

    def seen_by_fraction(self) -> dict[int | None, float]:
        """Of the wall's area, 0..1: what each camera alone saw, by its id, and more than one of them, by None."""
        who = self.wall.seen_by(len(self.cameras))
        return {one: float(np.mean(who == n)) for n, one in enumerate((*self.cameras, None), start=1)}

    @property
    def noise_mm(self) -> float:
        """Standard deviation of one cell of the grid about the pipe's shape, the median over the stations."""
        return float(np.median(self.wall.noise_mm))

    @property
    def diameter_mean_mm(self) -> float:
        return _over(np.mean, self.stations.diameter_mean_mm)

    @property
    def diameter_min_mm(self) -> float:
        return _over(np.min, self.stations.diameter_min_mm)

    @property
    def diameter_max_mm(self) -> float:
        return _over(np.max, self.stations.diameter_max_mm)

    @property
    def diameter_k2_mm(self) -> float:
        """Expanded uncertainty (k = 2) of a station's mean diameter, the median over the stations."""
        return _over(np.median, self.stations.diameter_k2_mm)

    @property
    def ovality_max_percent(self) -> float:
        """ASTM F1216, as measured, local defects included; the worst station's."""
        return _over(np.max, self.stations.ovality_percent)

    @property
    def shape_ovality_max_percent(self) -> float:
        """ASTM F1216 of the pipe's fitted shape, local defects left out; the worst station's."""
        return _over(np.max, self.stations.shape_ovality_percent)

    @property
    def shape_ovality_median_percent(self) -> float:
        return _over(np.median, self.stations.shape_ovality_percent)

    @property
    def depth_limit_mm(self) -> float:
        """Smallest depth listed."""
        return depth_limit_mm(self.wall, Scale.of(self.wall, self.detection.limits))

    @property
    def size_limit_mm(self) -> float:
        """Smallest size listed, both ways."""
        return self.detection.limits.size_of_radius * self.wall.mean_radius_mm

    @property
    def rejected(self) -> Mapping[str, int]:
        """Slits that were seen and not used, by reason, over all frames."""
        total: Counter[str] = Counter()
        for profile in self.profiles:
            total.update(profile.rejected)
        return dict(sorted(total.items()))

    @property
    def lean_sigma_deg(self) -> float:
        """How well the head's lean was known: standard deviation, the median over the frames."""
        return _over(np.median, np.array([profile.lean_sigma_deg for profile in self.profiles], dtype=np.float64))

    @property
    def roll_range_deg(self) -> tuple[float, float] | None:
        """Least and greatest roll of the head, clockwise looking forward; None where no sensor gave it."""
        rolls = [p.pose.roll for p in self.profiles if p.pose is not None and p.pose.roll is not None]
        return (math.degrees(min(rolls)), math.degrees(max(rolls))) if rolls else None

    def mesh(self) -> Mesh:
        """The seen wall as triangles, in space."""
        return triangulate(self.wall, self.centreline)


def survey(
    profiles: Sequence[Profile],
    calibration: Calibration,
    led_frames: Iterable[LedFrame] = (),
    *,
    turns: Turns = NO_TURNS,
    vibration: bool = False,
    fps: float | None = None,
    z_step_mm: float | None = None,
    scale: AbsoluteScale | None = None,
) -> Survey:
    """Everything a scan's profiles say of the pipe. Opens no file and changes none of its arguments.

    Parameters
    ----------
    profiles : of the projector frames, any order. led_frames : for the colour; read once, one at a time.
    turns : how far the head turned since the frame before, as a gyroscope said; of every frame of the scan.
    vibration : take out what shakes periodically along the pipe; fps : frames a second, only to name it in hertz.
    z_step_mm : length of the wall's rows; by the density of the points if not given.
    scale : of the scan that these profiles are a part of, where it is known; else as they show themselves.

    Raises
    ------
    AnnulusError, one line, where the profiles have too few points to make one station of the pipe.

    >>> pipe = survey(profiles, calibration)
    >>> pipe.worst.depth_mm, pipe.worst.depth_k2_mm, pipe.worst.clock
    """
    marks = [("", time.perf_counter())]

    def done(step: str) -> None:
        marks.append((step, time.perf_counter()))

    rises = np.array([math.tan(ring.half_angle) for ring in calibration.rings])
    narrowest, widest = float(rises[0]), float(rises[-1])
    profiles = without_rests(profiles)
    scale = scale or find_scale(profiles, calibration)
    profiles = with_drift(profiles, calibration, scale)
    done("scale")
    above, levels = without_levels(profiles, calibration)
    done("levels")
    axis = find_axis(above, calibration.rings, turns)
    done("axis")
    # a chain's heads have been adjusted with it; on a straight pipe they follow its shape, too
    aligned = register(above, z_step_mm=z_step_mm) if axis.adjusted is None else axis.profiles
    measured = without_inconsistent(aligned)
    done("alignment")
    shaken = None
    if vibration:
        measured, shaken = without_vibration(measured, fps)
        done("vibration")
    measured = with_revised_sigma(measured, axis.centreline)
    done("sigma")

    def scaled(wall: Wall) -> Wall:
        return wall if scale is None else replace(wall, scale_part=scale.part, oval_part=scale.oval_part)

    wall = scaled(build_wall(measured, z_step_mm=z_step_mm, rise=widest, centreline=axis.centreline))
    done("wall")
    joints = find_joints(wall, measured, axis, 1.0 / rises)
    seen = without_hidden(measured, joints, 1.0 / widest)
    if any(a is not b for a, b in zip(seen, measured, strict=True)):
        measured = seen
        wall = scaled(build_wall(measured, z_step_mm=z_step_mm, rise=widest, centreline=axis.centreline))
    below = covered(levels, wall.clock_deg, wall.z_mm[:, None])
    lit = looks_of(aligned, wall, calibration)
    openings, no_wall = find_openings(wall, aligned, calibration, lit)
    of_joints = taken(wall, joints, 1.0 / narrowest)
    explained = of_joints | below | no_wall
    done("features")
    detection = find_defects(
        wall,
        shadow_ratio=1.0 / narrowest,
        least_shadow_ratio=1.0 / widest,
        features=explained,
        joints=np.asarray(of_joints.any(axis=1)),
        points=cache(lambda: WallPoints.of(wall, measured, 1.0 / rises)),
    )
    done("defects")
    dark = shadowed(wall.radius_mm.astype(np.float64), wall.z_step_mm, narrowest)
    unjudged = find_unjudged(
        wall,
        detection,
        explained=explained,
        joints=np.asarray(of_joints.any(axis=1)),
        shadowed=dark,
        no_wall=no_wall,
        looks=lit[1],
        rings=len(rises),
        profiles=aligned,
        apart=sound_wall_apart(wall, lit[0], joints, 1.0 / narrowest),
    )
    done("not judged")
    standing = find_objects(wall, aligned, calibration, lit[1], explained)
    edged = with_edges(measured, wall)
    done("objects and edges")
    pace = Pace(wall, axis.centreline, calibration, measured)
    texture = paint(wall, axis.centreline, calibration, measured, pace.watched(led_frames))
    if texture is not None:
        texture[dark | below] = 0  # the radius there is not known, so neither is what was seen of it
    done("texture")
    scale = with_marks(scale, pace.error())
    wall = scaled(wall)
    cloud, stations = with_scale(edged, scale), stations_of(wall, no_wall)
    done("stations")
    timing = {name: 1e3 * (after - before) for (_, before), (name, after) in pairwise(marks)}
    features = [level.feature for level in levels]
    features += [*(joint.feature for joint in joints), *find_bends(axis, wall.extent[:2], common_mm(wall)), *openings]
    unjudged = (*unjudged, *nameless(features), *wider(features, *wall.extent[:2]), *(one.place for one in standing))
    features.sort(key=lambda one: (one.z_mm, one.clock_deg))
    nominal = 2 * calibration.pipe_radius_mm
    return Survey(
        cloud,
        wall,
        dark,
        detection,
        stations,
        texture,
        shaken,
        tuple(features),
        axis.centreline,
        (*axis.findings, *pace.findings()),
        nominal,
        timing,
        tuple(one.id for one in calibration.cameras),
        no_wall=no_wall,
        explained=explained,
        unjudged=unjudged,
        standing=standing,
        scale=scale,
    )


def stations_of(wall: Wall, no_wall: BoolArray | None) -> Stations:
    """The wall's, no diameter ending in an opening."""
    if no_wall is None:
        return measure_stations(wall)
    return measure_stations(replace(wall, radius_mm=np.where(no_wall, np.float32(np.nan), wall.radius_mm)))


def _over(of: Any, values: FloatArray) -> float:
    """mean, min .. of the known values; NaN where none is."""
    known = values[np.isfinite(values)]
    return float(of(known)) if len(known) else math.nan
