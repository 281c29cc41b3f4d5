"""What the projector's pattern is off its cones, from frames in a clean pipe of known radius (Alzuhiri 2022, §3.5.1.1).

The source subtracts the radius of a reference frame, direction by direction: r - r_ref + R. That holds while the head
stands as it stood then. An artefact of the slide is an angle at the projector, though, and what it does to the radius
depends on where the wall is; so here the angle is kept, and a point is corrected where its ray meets the bent cone. At
the reference's own pose both are the same.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration, RingCorrection
from annulus_pipe.geometry.cone import intersect_cylinder
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.wall.profile import Profile

FORMAT = "annulus-reference/1"
# By topic artefacts (radius rms of a distorted slide, on frames kept out); ANGLE_FAR and SHIFT_FAR by test_limits.
SAMPLES = 720  # round each cone's axis
GAP = 6  # samples between measured ones that are filled in; a rod's shadow is wider, and hides the scan's points too
REACH = 2.5  # samples: points farther apart than this have a gap between them
SMOOTH = 0.3  # samples, standard deviation: takes a little noise away, artefacts may step from one sample to the next
GROSS = 0.25  # of the radius: a point so far off the wall is no artefact
ANGLE_FAR = math.radians(2.5)  # a scan's pose this far from any of the reference's ..
SHIFT_FAR = 0.05  # .. or this part of the radius is farther than the reference can vouch for


@dataclass(frozen=True, slots=True)
class Reference:
    """offset_rad[k][i]: to add to ring k's half-angle at the azimuth 2 pi i / n (see `RingCorrection`); NaN where no
    frame showed it. poses: of the frames. before_mm, after_mm: rms of the radius about the pipe's; `after` on frames
    that were kept out of the learning, NaN where there was only one frame and nothing to check with."""

    offset_rad: tuple[tuple[float, ...], ...]
    radius_mm: float
    poses: tuple[Pose, ...]
    before_mm: float
    after_mm: float

    @property
    def known(self) -> float:
        """Share of all directions of all rings that a frame showed."""
        return float(np.isfinite(np.array(self.offset_rad)).mean())

    def applied(self, calibration: Calibration) -> Calibration:
        """The calibration with every ring bent as the reference says. Raises ValueError for another number of rings."""
        if len(self.offset_rad) != len(calibration.rings):
            raise ValueError(
                f"the reference has {len(self.offset_rad)} rings, the calibration {len(calibration.rings)}"
            )
        before = calibration.corrections or tuple(RingCorrection((0.0,) * SAMPLES) for _ in calibration.rings)
        return replace(
            calibration,
            corrections=tuple(
                _added(ring, _closed(np.array(more))) for ring, more in zip(before, self.offset_rad, strict=True)
            ),
        )

    def distance(self, poses: Sequence[Pose]) -> tuple[float, float]:
        """How far the farthest of these poses is from the nearest of the reference's: radians of lean, mm of shift."""
        own = np.array([[p.rx, p.ry, p.tx, p.ty] for p in self.poses])
        angle, shift = 0.0, 0.0
        for pose in poses:
            lean = np.hypot(own[:, 0] - pose.rx, own[:, 1] - pose.ry)
            off = np.hypot(own[:, 2] - pose.tx, own[:, 3] - pose.ty)
            nearest = int(np.argmin(lean / ANGLE_FAR + off / (SHIFT_FAR * self.radius_mm)))
            angle, shift = max(angle, float(lean[nearest])), max(shift, float(off[nearest]))
        return angle, shift

    def to_dict(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "radius_mm": self.radius_mm,
            "before_mm": self.before_mm,
            "after_mm": None if math.isnan(self.after_mm) else self.after_mm,
            "poses": [[p.rx, p.ry, p.tx, p.ty] for p in self.poses],
            "rings": [
                {"offset_rad": [None if math.isnan(v) else round(v, 9) for v in ring]} for ring in self.offset_rad
            ],
        }

    @classmethod
    def from_dict(cls, data: object) -> "Reference":
        """Inverse of `to_dict`. Raises ValueError naming the key that is wrong."""
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            raise ValueError(f'"format" is not "{FORMAT}"')
        rings, poses = data.get("rings"), data.get("poses")
        if not isinstance(rings, Sequence) or not rings or not isinstance(poses, Sequence) or not poses:
            raise ValueError('"rings" and "poses" must be lists that are not empty')
        offsets = []
        for i, ring in enumerate(rings):
            values = ring.get("offset_rad") if isinstance(ring, Mapping) else None
            if not isinstance(values, Sequence) or not 36 <= len(values) <= 4096:
                raise ValueError(f'"rings[{i}].offset_rad" must be a list of 36..4096 numbers')
            offsets.append(tuple(math.nan if v is None else _number(v, f"rings[{i}]", 0.2) for v in values))
        stood = []
        for one in poses:
            if not isinstance(one, Sequence) or len(one) != 4:
                raise ValueError('"poses" must be lists of four numbers')
            stood.append(Pose(*(_number(v, "poses", 1e4) for v in one)))
        after = data.get("after_mm")
        return cls(
            tuple(offsets),
            _number(data.get("radius_mm"), "radius_mm", 5000.0),
            tuple(stood),
            _number(data.get("before_mm"), "before_mm", 1e4),
            math.nan if after is None else _number(after, "after_mm", 1e4),
        )


def learn(profiles: Sequence[Profile], calibration: Calibration) -> Reference:
    """What remains of the pattern's artefacts in profiles of a clean, round pipe of the calibration's radius.

    With several frames each is also corrected by what only the others say, so that `after_mm` is an honest figure; a
    defect of the wall then goes out of the median, too, if the head moved on. From one frame nothing can be checked.

    Raises ValueError where no profile has a pose.
    """
    used = [profile for profile in profiles if profile.pose is not None and len(profile.ring)]
    if not used:
        raise ValueError("not one frame shows the pipe")
    seen = np.stack([_observed(profile, calibration) for profile in used])  # (F, K, n)
    before = _rms(np.concatenate([_radius_error(p, calibration, None) for p in used]))
    after = math.nan
    if len(used) > 1:
        folds = np.arange(len(used)) % min(len(used), 4)
        errors = [_radius_error(used[f], calibration, _merged(seen[folds != folds[f]])) for f in range(len(used))]
        after = _rms(np.concatenate(errors))
    merged = _merged(seen)
    poses = tuple(profile.pose for profile in used if profile.pose is not None)
    return Reference(
        tuple(tuple(float(v) for v in ring) for ring in merged), calibration.pipe_radius_mm, poses, before, after
    )


def _observed(profile: Profile, calibration: Calibration) -> FloatArray:
    """(K, n) what one profile says of every ring's half-angle, NaN where it says nothing."""
    azimuth, off, _ = _angles(profile, calibration)
    nodes = np.arange(SAMPLES) * (2 * math.pi / SAMPLES)
    out = np.full((len(calibration.rings), SAMPLES), np.nan)
    for k in range(len(out)):
        mine = np.flatnonzero((profile.ring == k) & np.isfinite(off))
        if not len(mine):
            continue
        mine = mine[np.argsort(azimuth[mine])]
        at = azimuth[mine]
        between = np.interp(nodes, at, off[mine], period=2 * math.pi)
        after = np.searchsorted(at, nodes) % len(at)
        gap = (at[after] - at[after - 1]) % (2 * math.pi)
        out[k] = np.where(gap < REACH * 2 * math.pi / SAMPLES, between, np.nan)
    return out


def _angles(profile: Profile, calibration: Calibration) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Of every point: its azimuth about its cone's axis; the angle at the vertex between it and where its ray meets the
    clean wall (NaN for a point far off); and how many mm of radius a radian of that angle is."""
    assert profile.pose is not None
    pose, pipe = profile.pose, calibration.pipe_radius_mm
    points = pose.to_camera(profile.points_mm.astype(np.float64), profile.z_mm)
    origins, ways = calibration.camera.lines(calibration.camera.project(points))
    axis = pose.rotation[:, 2]
    wall = intersect_cylinder(ways, pose.translation, axis, pipe, origins)
    azimuth, inner, outer = (np.empty(len(points)) for _ in range(3))
    for k, cone in enumerate(calibration.rings):
        mine = profile.ring == k
        a, v = np.asarray(cone.axis), np.asarray(cone.vertex_mm)
        x = np.array([1.0, 0.0, 0.0]) - a[0] * a
        x /= np.linalg.norm(x)
        y = np.cross(a, x)
        for place, angle in ((points[mine] - v, inner), (wall[mine] - v, outer)):
            angle[mine] = np.arctan2(np.linalg.norm(np.cross(place, a), axis=1), place @ a)
        place = wall[mine] - v
        azimuth[mine] = np.arctan2(place @ y, place @ x) % (2 * math.pi)
    error = np.hypot(profile.points_mm[:, 0], profile.points_mm[:, 1]).astype(np.float64) - pipe
    off = np.where(np.abs(error) < GROSS * pipe, outer - inner, np.nan)
    # With the wall a little farther out both change: the ratio is what one does to the other.
    farther = intersect_cylinder(ways, pose.translation, axis, 1.001 * pipe, origins)
    turn = np.empty(len(points))
    for k, cone in enumerate(calibration.rings):
        mine = profile.ring == k
        a, place = np.asarray(cone.axis), farther[mine] - np.asarray(cone.vertex_mm)
        turn[mine] = np.arctan2(np.linalg.norm(np.cross(place, a), axis=1), place @ a)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = 0.001 * pipe / (turn - outer)
    return azimuth, off, slope


def _radius_error(profile: Profile, calibration: Calibration, correction: FloatArray | None) -> FloatArray:
    """(N,) mm of every point's radius about the pipe's, after a (K, n) correction; points it does not know left out."""
    azimuth, off, slope = _angles(profile, calibration)
    error = np.hypot(*profile.points_mm[:, :2].T.astype(np.float64)) - calibration.pipe_radius_mm
    if correction is not None:
        nodes = np.arange(SAMPLES) * (2 * math.pi / SAMPLES)
        for k, ring in enumerate(correction):
            mine = profile.ring == k
            error[mine] += slope[mine] * np.interp(azimuth[mine], nodes, ring, period=2 * math.pi)
    return np.asarray(error[np.isfinite(error) & np.isfinite(off)], np.float64)


def _merged(frames: FloatArray) -> FloatArray:
    """(F, K, n) -> (K, n): the median of the frames, smoothed a little, NaN where none of them saw it."""
    ordered = np.sort(frames, axis=0)
    n = np.isfinite(ordered).sum(axis=0)
    low = np.take_along_axis(ordered, (np.maximum(n - 1, 0) // 2)[None], axis=0)[0]
    high = np.take_along_axis(ordered, np.minimum(n // 2, len(ordered) - 1)[None], axis=0)[0]
    middle = 0.5 * (low + high)
    seen = np.isfinite(middle)
    weight = ndimage.gaussian_filter1d(seen.astype(float), SMOOTH, axis=1, mode="wrap")
    value = ndimage.gaussian_filter1d(np.where(seen, middle, 0.0), SMOOTH, axis=1, mode="wrap")
    known = ndimage.binary_closing(np.tile(seen, (1, 3)), np.ones((1, GAP)))[:, SAMPLES : 2 * SAMPLES] | seen
    filled = np.where(weight > 0.05, value / np.maximum(weight, 1e-9), np.nan)
    return np.where(known, np.stack([_closed(ring) for ring in filled]), np.nan)


def _closed(ring: FloatArray) -> FloatArray:
    """The gaps of one ring bridged by straight lines round the axis; nothing known: no correction."""
    seen = np.flatnonzero(np.isfinite(ring))
    if not len(seen):
        return np.zeros(len(ring))
    return np.interp(np.arange(len(ring)), seen, ring[seen], period=len(ring))


def _added(ring: RingCorrection, more: FloatArray) -> RingCorrection:
    n = max(len(ring.offset_rad), len(more))

    def at(values: Sequence[float] | NDArray[np.float64]) -> FloatArray:
        return np.interp(np.arange(n) / n, np.arange(len(values)) / len(values), values, period=1.0)

    shift = None if ring.shift_mm is None else tuple(float(v) for v in at(ring.shift_mm))
    return RingCorrection(tuple(float(v) for v in at(ring.offset_rad) + at(more)), shift)


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _number(value: object, name: str, most: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= most:
        raise ValueError(f'"{name}" is {value!r}, expected a number')
    return float(value)
