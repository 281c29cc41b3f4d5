"""From the frames of one flash to the wall: the method, end to end.

Assumed: one projector, several cameras beside it, all calibrated together; a round pipe but for what is to be found; a
head whose middle leans and stands off the pipe's axis no farther than `rings.polar` looks.

What carries it: each camera's slits are found and named alone, so that a camera that fails costs only its own; the wall
is then what all that was seen says of it (`merge`), with what is left between the cameras as the measure of how well.

When it breaks: where no camera sees a ring, or only one whose ray is tangent to the cone, there is no point; where two
contradict each other there is none either, and `Profile.rejected` counts it.
"""

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.cone import intersect_cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.mosaic import Picture, in_words, is_colour
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD, nan_median
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.decode import NONE
from annulus_pipe.rings.reconstructor import FIRST_TOLERANCE, WALL_TOLERANCE, spans
from annulus_pipe.rings.uncertainty import RING_POINTS
from annulus_pipe.stereo.merge import BLUNT, CONTRADICTED, EDGE, KNOWN, Merged, Sight, merge
from annulus_pipe.stereo.points import beside, known, outwards, radius_sigma, to_pipe
from annulus_pipe.stereo.view import Expected, ObservedSlits, View, view_of
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.pose import Fit, fit_pose, sound_seed
from annulus_pipe.wall.profile import Profile

# By topic stereo of the metrology table.
DIRECTIONS = 720  # generators of each cone
SIGMA_MOST = 0.01  # of the radius: a point known no better is not known (profilers: 0.5 % of 2 r)
MANY = 2000  # points: from more than these the pose takes ..
EVERY = 2  # .. every other one, for neighbours share their pixels
ROUGHLY = 6  # of so many generators one, for the pose that rings are named with
BIAS_PX = 0.0115  # what neighbouring places may be off alike, at least; as `rings.uncertainty`
UNTOLD_PX = 0.02  # .. and where no second camera tells it by lying apart, nor ..
RINGS_LEAST = 3  # .. so many rings
USUAL_PX = 0.03  # what a place is off until its frame says
CAMERAS_LEAST = 2
# Frames are not of one flash where more than SPREAD of what both cameras see is contradicted, in QUARTERS of the round
# or more. A quarter of stereo-a has 0.002 at most; with its frames paired with their neighbours', 0.4 and more where
# the head has moved.
SPREAD = 0.02
QUARTERS = 3
_spread = door(
    "stereo_spread",
    "i8[k,j] which",
    "f8[k,j] stray",
    "f8[n] edge_blur",
    "f8[n,3] inside",
    "f8[n,3] outside",
    "f8[n] wider",
    "f8 least_px",
    "f8 sigma_of_mad",
    "f8[w]! work",
    "f8[k,j]! sigma",
    "f8[k,j]! edge",
)
TWO_WALLS, CAMERA_MISSING = "cameras contradict", "camera missing"  # keys of `rejected`


@dataclass(frozen=True, slots=True, eq=False)
class _Look:
    """What one camera's frame said."""

    seen: ObservedSlits
    which: NDArray[np.int64]  # (K, J) slit, -1 for none
    sight: Sight


class StereoReconstructor:
    """Holds what one calibration fixes, so that frames cost only their own pixels.

    >>> head = StereoReconstructor(calibration)
    >>> profile = head.profile({0: left_bgr, 1: right_bgr}, frame=17, z_mm=40.8, seed=last.pose)
    """

    def __init__(
        self,
        calibration: Calibration,
        directions: int = DIRECTIONS,
        *,
        colour: ColourProfile | None = None,
        delta_gate: float | None = None,
    ) -> None:
        """delta_gate : for comparison only, the source's Delta (§5.2): a camera is asked only where delta is above this
        part of its greatest, and those that are count alike."""
        if len(calibration.cameras) < CAMERAS_LEAST:
            raise AnnulusError("calibration: the head has one camera, expected two or more for this method")
        if calibration.kind != "slits":
            raise AnnulusError(f"calibration: the head projects {calibration.kind}, expected slits for several cameras")
        calibration = calibration.in_wall()
        self.calibration, self.directions, self.colour, self.delta_gate = calibration, directions, colour, delta_gate
        self.usual = usual_pose(calibration)
        self.views = {one.id: view_of(calibration, one, self.usual, directions) for one in calibration.cameras}
        self._cones, self._ways = generators(calibration, directions)
        self._vertex = np.ascontiguousarray(self._cones[:, :3])
        self._outwards = np.sin([cone.half_angle for cone in calibration.rings])  # of a step along a generator
        self._most = SIGMA_MOST * calibration.pipe_radius_mm / self._outwards
        self._mm_per_px = np.mean([view.optics.mm_per_px for view in self.views.values()], axis=0)
        self._some = np.ascontiguousarray(self._ways[:, ::ROUGHLY])

    def profile(
        self,
        images: Mapping[int, Picture],
        *,
        frame: int,
        z_mm: float,
        seed: Pose | None = None,
        roll_deg: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> Profile:
        """The wall's points from the frames of one flash.

        Parameters
        ----------
        images : by camera id, (H, W, 3) uint8 BGR or mosaics; a camera whose frame was lost is left out, one is
            there.
        z_mm : the station of the first camera. seed, roll_deg : see `rings.Reconstructor.profile`; the head's.

        Raises
        ------
        AnnulusError for an image of another size than its camera's, or of a camera that the head does not have, and
        for a station that is not finite.
        """
        seed = sound_seed(frame, z_mm, seed)
        pipe = self.calibration.pipe_radius_mm
        marks = [("", clock())]
        seen: dict[int, ObservedSlits] = {}
        rejected: dict[str, int] = {}
        for number, image in images.items():
            if number not in self.views:
                own = ", ".join(map(str, self.views))
                raise AnnulusError(f"frame {frame}: is of camera {number}, but the calibration has cameras {own}.")
            camera = self.views[number].camera
            if not is_colour(image, camera.width, camera.height):
                raise AnnulusError(
                    f"frame {frame}: camera {number}'s image is {in_words(image)}, but the calibration's is "
                    f"{camera.width}x{camera.height}, 3 of uint8. Calibrate with these cameras."
                )
            seen[number], left_out = self.views[number].see(image, self.colour)
            for reason, count in left_out.items():
                rejected[reason] = rejected.get(reason, 0) + count
            marks.append(("slits", clock()))
        lost = len(self.views) - len(images)
        if lost:
            rejected[CAMERA_MISSING] = lost
        fitted = None
        for first in (seed, self.usual) if seed is not None else (self.usual,):
            some = self._some
            start = to_pipe(self._vertex, first, some, pipe)
            few = self._expect(first, some, start, seen)
            looks = {n: self._read(self.views[n], one, few[n], FIRST_TOLERANCE, 0.0, None) for n, one in seen.items()}
            merged = self._merge(looks, few, some, start)
            marks.append(("merge", clock()))
            fitted = self._fit(merged, first, some)
            marks.append(("pose", clock()))
            if fitted is not None:
                break
        if fitted is None:
            rejected["no pipe"] = sum(len(one.slits.position) for one in seen.values())
            return _empty(frame, z_mm, rejected, marks)
        bias = max(self._drawn(merged, fitted.pose), BIAS_PX if len(images) > 1 else UNTOLD_PX)
        start = to_pipe(self._vertex, fitted.pose, self._ways, pipe)
        expected = self._expect(fitted.pose, self._ways, start, seen)
        looks = {
            n: self._read(self.views[n], one, expected[n], WALL_TOLERANCE, bias, rejected) for n, one in seen.items()
        }
        marks.append(("decode", clock()))
        merged = self._merge(looks, expected, self._ways, start)
        marks.append(("merge", clock()))
        fitted = self._fit(merged, fitted.pose, self._ways) or fitted
        marks.append(("pose", clock()))
        for reason, state in (("contradicted", CONTRADICTED), ("tangent", BLUNT), ("across an edge", EDGE)):
            rejected[reason] = int(np.count_nonzero(merged.state == state))
        if _two_walls(merged):
            rejected[TWO_WALLS] = int(np.count_nonzero(merged.state == KNOWN))
            return _empty(frame, z_mm, rejected, marks)
        pose = replace(fitted.pose, roll=None if roll_deg is None else math.radians(roll_deg))
        at, points = known(merged, self._vertex, self._ways)
        ring, direction = at
        wall = pose.to_pipe(points, z_mm)
        along = merged.unit * merged.sigma_mm[ring, direction]
        sigma = radius_sigma(points, at, along, self._ways, fitted.pose, fitted.covariance)
        light = np.zeros((len(points), 3), np.uint8)
        for number, look in enumerate(looks.values()):  # as the camera shows it that knows the point best
            beside(at, merged, number, look.which, look.seen.slits, light)
        marks.append(("points", clock()))
        camera_of = np.array([*looks, *([len(self.views)] if len(looks) else [])])
        return Profile(
            frame,
            z_mm,
            pose,
            wall.astype(np.float32),
            light,
            ring.astype(np.uint8),
            direction.astype(np.uint16),
            fitted.robust_sigma_mm,
            rejected,
            spans(marks),
            sigma.astype(np.float32),
            fitted.lean_sigma_deg,
            seen_by=camera_of[merged.camera[ring, direction]].astype(np.uint8),
        )

    def _expect(
        self, pose: Pose, ways: FloatArray, start: FloatArray, numbers: Mapping[int, object]
    ) -> dict[int, Expected]:
        return {n: self.views[n].expect(self._cones, ways, start, pose) for n in numbers}

    def _read(
        self,
        view: View,
        seen: ObservedSlits,
        expected: Expected,
        tolerance: float,
        bias_px: float,
        rejected: dict[str, int] | None,
    ) -> _Look:
        ring, off = view.name(seen, expected, tolerance)
        wider = np.zeros(len(ring))
        if rejected is not None:
            rejected["no ring"] = rejected.get("no ring", 0) + int(np.count_nonzero(ring == NONE))
            lost, wider = view.without_outliers(ring, seen, off, expected)
            for reason, count in lost.items():
                rejected[reason] = rejected.get(reason, 0) + count
        place, which = view.table(ring, seen)
        return _Look(seen, which, _sight(seen, which, place, expected.course, wider, bias_px, rejected is not None))

    def _drawn(self, merged: Merged, pose: Pose) -> float:
        """px, how far a place in this frame is off as all of its ring are: rings see one wall, and how far they lie
        apart all the same is how far edges are drawn."""
        start = to_pipe(self._vertex, pose, self._some, self.calibration.pipe_radius_mm)
        off = nan_median((merged.distance_mm - start).T) * self._outwards
        if np.count_nonzero(np.isfinite(off)) < RINGS_LEAST:
            return UNTOLD_PX
        off -= np.nanmedian(off)
        return float(np.sqrt(np.nanmean((off / self._mm_per_px) ** 2)))

    def _merge(
        self, looks: Mapping[int, _Look], expected: Mapping[int, Expected], ways: FloatArray, start: FloatArray
    ) -> Merged:
        views = [self.views[n] for n in looks]
        usable = None
        if self.delta_gate is not None:
            points = self._vertex[:, None] + start[..., None] * ways
            usable = np.stack([self._gate(view, points) for view in views])
        return merge(
            views,
            [expected[n] for n in looks],
            [look.sight for look in looks.values()],
            self._vertex,
            ways,
            start,
            self._most,
            usable,
        )

    def _gate(self, view: View, points: FloatArray) -> BoolArray:
        """(K, P) where delta (Eq. 5.7) is above `delta_gate` of its greatest."""
        centre = -view.rotation.T @ view.translation_mm
        out = np.zeros(points.shape[:2], np.bool_)
        for k, cone in enumerate(self.calibration.rings):
            _, delta = intersect_cone(_unit(points[k] - centre), cone, centre)
            out[k] = delta > (self.delta_gate or 0.0) * np.nanmax(delta)
        return out

    def _fit(self, merged: Merged, first: Pose, ways: FloatArray) -> Fit | None:
        at, points = known(merged, self._vertex, ways)
        ring, direction = at
        if not len(ring):
            return None
        enough = RING_POINTS * ways.shape[1] / self.directions
        one_ring = bool(np.count_nonzero(np.bincount(ring) > enough) < 2)
        across = outwards(points, at, ways, first)
        sigma = np.hypot(merged.sigma_mm[ring, direction] * across, 0.0005 * self.calibration.pipe_radius_mm)
        every = EVERY if len(points) > MANY else 1
        return fit_pose(points[::every], self.calibration.pipe_radius_mm, sigma[::every], first, one_ring)


def usual_pose(calibration: Calibration) -> Pose:
    """The pipe as the first camera sees it when the middle of the cameras is on its axis and the head does not lean."""
    centres = np.array([-np.array(c.rotation).T @ np.array(c.translation_mm) for c in calibration.cameras])
    x, y, _ = centres.mean(axis=0)
    return Pose(0.0, 0.0, float(x), float(y))


def generators(calibration: Calibration, directions: int) -> tuple[FloatArray, FloatArray]:
    """Cones (K, 7), see `RingOptics`, and (K, P, 3) unit vectors along each one's light, P directions round its axis,
    from the camera's x towards its y: Alzuhiri 2022, Eq. 5.2."""
    turn = np.arange(directions) * (2 * math.pi / directions)
    cones, ways = [], []
    for cone in calibration.rings:
        axis = np.asarray(cone.axis)
        first = np.array([1.0, 0.0, 0.0]) - axis[0] * axis
        first /= np.linalg.norm(first)
        across = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * np.cross(axis, first)
        ways.append(math.cos(cone.half_angle) * axis + math.sin(cone.half_angle) * across)
        cones.append([*cone.vertex_mm, *cone.axis, cone.half_angle])
    return np.array(cones), np.array(ways)


def _sight(
    seen: ObservedSlits,
    which: NDArray[np.int64],
    place: FloatArray,
    course: FloatArray,
    wider: FloatArray,
    bias_px: float,
    surely: bool,
) -> Sight:
    """How far each slit's place may be off, px: see `rings.uncertainty.point_sigma`, whose terms these are."""
    slits = seen.slits
    sigma, edge = np.full(which.shape, np.nan), np.zeros(which.shape)
    if not surely:  # for a first pose, which only names
        sigma[:] = USUAL_PX
    else:
        by_slit = (slits.edge_blur, slits.inside, slits.outside, wider)
        work = np.empty(3 * which.shape[1])
        _spread(which, place - course, *by_slit, bias_px, SIGMA_OF_MAD, work, sigma, edge)
    return Sight(place, sigma, edge, bias_px)


def _two_walls(merged: Merged) -> bool:
    """Whether the cameras contradict each other nearly all round: then they did not see one flash, or do not stand as
    they were calibrated. What water mirrors, or dirt on one lens, is on one side."""
    wrong = merged.state == CONTRADICTED
    if not wrong.any():
        return False
    both = wrong | np.isfinite(merged.apart)
    parts = zip(np.array_split(wrong, 4, axis=1), np.array_split(both, 4, axis=1), strict=True)
    return sum(bool(bad.sum() > SPREAD * of.sum()) for bad, of in parts) >= QUARTERS


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def _empty(frame: int, z_mm: float, rejected: dict[str, int], marks: list[tuple[str, float]]) -> Profile:
    none = np.zeros(0, np.uint8)
    return Profile(
        frame,
        z_mm,
        None,
        np.zeros((0, 3), np.float32),
        np.zeros((0, 3), np.uint8),
        none,
        none.astype(np.uint16),
        math.nan,
        rejected,
        spans(marks),
    )
