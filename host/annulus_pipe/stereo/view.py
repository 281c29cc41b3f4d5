"""One camera of a head with several: its slits, named, and where it would see a point of the wall.

All that `rings` knows of finding slits holds for a camera beside the projector, too, but for one thing: where a ray is
tangent to its cone, the slit's place says nothing of the wall, and the wall nothing of the slit. So a slit is named by
how far it lies from where its ring should be in the image, against how far a wall could move it there.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration, HeadCamera
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose, pose_of
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.mosaic import Picture
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import nan_median
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.decode import UNKNOWN, classify, decode, readings
from annulus_pipe.rings.outliers import reject_outliers
from annulus_pipe.rings.pedestal import without_pedestal
from annulus_pipe.rings.polar import PolarGrid, polar_grid, unroll
from annulus_pipe.rings.slits import Slits, find_slits
from annulus_pipe.rings.triangulate import RingOptics, ring_optics
from annulus_pipe.stereo.lens import lens_numbers

STEP_PX = 1.5  # along a line, between a point and its neighbours on one wall, as in `rings` ..
STEP = 0.01  # .. plus what this part of the radius moves it by
WIDE = 1.3  # of the usual width: a slit in a shadow's edge must not shift itself
SOME = 8  # lines, of which one says how far a ring's image moves

_expect = door(
    "stereo_expect",
    "f8[34] lens",
    "f8[k,7] cones",
    "f8[k,p,3] ways",
    "f8[k,p] start",
    "f8[3,3] rotation",
    "f8[3] shift",
    "f8[4,k,p]! by_generator",
    "f8[3,k,j]! by_line",
    "f8[w]! work",
)
_off = door(
    "stereo_off",
    "i8[n] direction",
    "f8[n] position",
    "b1[n,k] could_be",
    "f8[k,j] course",
    "f8[k,j] by_radius",
    "f8 spacing",
    "f8[n,k]! off",
    "f8[n,k]! deviation",
)
_as_usual = door("stereo_as_usual", "i8[n] ring", "i8[n] direction", "f8[k,j] by_angle", "f8[k]! mean", "f8[n]! width")
_table = door(
    "stereo_table",
    "i8[n] ring",
    "i8[n] direction",
    "f8[n] position",
    "f8[n] width",
    "f8 widest",
    "f8[k,j] bend",
    "f8[k,j] offset",
    "f8[k,j]! place",
    "i8[k,j]! which",
)


@dataclass(frozen=True, slots=True, eq=False)
class ObservedSlits:
    """The slits (N,) of one frame, the colours beside them, and (N, K) which rings they could be by those."""

    slits: Slits
    inside: NDArray[np.uint8]
    outside: NDArray[np.uint8]
    could_be: NDArray[np.bool_]
    widest: float  # px: what is wider is no wider than this


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Where a camera would see each ring on a clean pipe. By generator (K, P): line, sample along it, and how both move
    with a mm along the generator; by line (K, J): sample, and how it moves with the pipe's radius (px a radius) and the
    half-angle of the cone (px a radian)."""

    by_generator: FloatArray  # (4, K, P)
    course: FloatArray
    by_radius: FloatArray
    by_angle: FloatArray

    @property
    def line(self) -> FloatArray:
        return np.asarray(self.by_generator[0])

    @property
    def place(self) -> FloatArray:
        return np.asarray(self.by_generator[1])

    @property
    def line_by_mm(self) -> FloatArray:
        return np.asarray(self.by_generator[2])

    @property
    def place_by_mm(self) -> FloatArray:
        return np.asarray(self.by_generator[3])


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera where it stands: X_own = rotation X_head + translation_mm."""

    camera: Camera
    rotation: FloatArray  # (3, 3)
    translation_mm: FloatArray  # (3,)
    grid: PolarGrid
    optics: RingOptics
    colours: str
    lens: FloatArray  # all of the above for loops in C, see `lens`

    def expect(self, cones: FloatArray, ways: FloatArray, start_mm: FloatArray, pose: Pose) -> Expected:
        """What a clean pipe would show. cones (K, 7), see `RingOptics`, ways (K, P, 3), start_mm (K, P): generators to
        where they meet it."""
        rings, lines = len(cones), len(self.grid.cosine)
        by_generator, by_line = np.empty((4, *start_mm.shape)), np.full((3, rings, lines), np.nan)
        given = (cones, ways, start_mm, pose.rotation, pose.translation)
        work = np.empty(9 * start_mm.shape[1] + 18)  # 6 numbers of every node and three more, 3 of every step
        _expect(self.lens, *(np.ascontiguousarray(one, np.float64) for one in given), by_generator, by_line, work)
        return Expected(by_generator, *by_line)

    def see(self, image: Picture, colour: ColourProfile | None) -> tuple[ObservedSlits, dict[str, int]]:
        """The slits of one frame, and how many were left out, by reason."""
        slits = find_slits(unroll(without_pedestal(image, self.grid.spacing_px), self.grid), self.grid)
        both = classify(
            np.vstack([slits.inside, slits.outside]), self.colours, None if colour is None else colour.seen()
        )
        inside, outside = both[: len(slits.position)], both[len(slits.position) :]
        unknown = int(np.count_nonzero((inside == UNKNOWN) | (outside == UNKNOWN)))
        rejected = {"crowded": slits.crowded, "shallow": slits.shallow, "colour": unknown}
        half = len(slits.width) // 2
        widest = WIDE * float(np.partition(slits.width, half)[half]) if len(slits.width) else 0.0
        return ObservedSlits(slits, inside, outside, readings(inside, outside, self.colours), widest), rejected

    def name(self, seen: ObservedSlits, expected: Expected, tolerance: float) -> tuple[NDArray[np.int64], FloatArray]:
        """Ring of each slit, or NONE; and (N, K) px from where each ring should be. tolerance : of the wall, of the
        radius."""
        slits = seen.slits
        off, deviation = np.empty(seen.could_be.shape), np.empty(seen.could_be.shape)
        _off(
            slits.direction,
            slits.position,
            seen.could_be,
            expected.course,
            expected.by_radius,
            self.grid.spacing_px,
            off,
            deviation,
        )
        ring = decode(slits.direction, seen.inside, seen.outside, deviation, self.colours, tolerance)
        return ring, off

    def without_outliers(
        self, ring: NDArray[np.int64], seen: ObservedSlits, off: FloatArray, expected: Expected
    ) -> tuple[dict[str, int], FloatArray]:
        """Sets `ring` to NONE where a slit is not to be believed; see `rings.outliers`."""
        step = STEP_PX + STEP * nan_median(np.abs(expected.by_radius[:, ::SOME]).T)
        width = np.array(seen.slits.width)
        _as_usual(ring, seen.slits.direction, expected.by_angle, np.empty(len(expected.by_angle)), width)
        return reject_outliers(ring, replace(seen.slits, width=width), off, step, len(self.grid.cosine))

    def table(self, ring: NDArray[np.int64], seen: ObservedSlits) -> tuple[FloatArray, NDArray[np.int64]]:
        """(K, J) the samples at which each ring was seen, NaN for none; and which slit that is, -1 for none."""
        shape = self.optics.bend.shape
        place, which = np.full(shape, np.nan), np.full(shape, -1)
        slits = seen.slits
        _table(
            ring,
            slits.direction,
            slits.position,
            slits.width,
            seen.widest,
            self.optics.bend,
            self.optics.offset_px,
            place,
            which,
        )
        return place, which


def view_of(calibration: Calibration, of: HeadCamera, nominal: Pose, directions: int) -> View:
    """A view of one of the head's cameras; `nominal` : the pipe in the head's frame."""
    rotation, translation = np.array(of.rotation), np.array(of.translation_mm)
    rings = tuple(
        Cone(c.half_angle, _three(rotation @ c.axis), _three(rotation @ np.array(c.vertex_mm) + translation))
        for c in calibration.rings
    )
    own = replace(calibration, camera=of.camera, rings=rings, others=(), covariance=None)
    pose = pose_of(rotation @ nominal.rotation[:, 2], rotation @ nominal.translation + translation)
    grid = polar_grid(own, directions, pose)
    lens = lens_numbers(of.camera, rotation, translation, grid)
    return View(of.camera, rotation, translation, grid, ring_optics(own, grid, pose), calibration.colours, lens)


def _three(v: FloatArray) -> tuple[float, float, float]:
    return float(v[0]), float(v[1]), float(v[2])
