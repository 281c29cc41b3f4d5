"""From one projector frame to the wall: the method, end to end.

Assumed: one camera, one projector, both calibrated; a pipe that is round but for what is to be found; a head that leans
and stands off its axis no farther than `polar` looks (some 4 degrees, a tenth of the radius).

What carries it: three separate witnesses (a slit's colours, its order on the line, the wall it would make) must agree
on its ring, and are asked twice: with the pose unknown, then with the pose that the first answer gave. Points depend on
slits and calibration alone; the pose only turns them into the pipe's frame.

When it breaks: nothing is guessed. A frame without enough agreeing slits has no pose and no points and counts why in
`Profile.rejected`; a seed far off is tried, then forgotten.
"""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.mosaic import Picture, bgr_of, in_words, is_colour
from annulus_pipe.numeric.native import door
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.decode import Candidates, StripeColours, StripeNames, letters
from annulus_pipe.rings.lines import MOSAIC_PX, find_lines, line_bias, name_lines
from annulus_pipe.rings.objects import without_objects
from annulus_pipe.rings.order import PlacedSlits, by_order
from annulus_pipe.rings.outliers import NamedSlits, Outliers
from annulus_pipe.rings.pedestal import Pedestal, without_pedestal
from annulus_pipe.rings.polar import PolarGrid, Unroller, polar_grid, unroll
from annulus_pipe.rings.slits import FrameSlits, Slits, find_slits
from annulus_pipe.rings.triangulate import CandidatePoints, RingOptics, ring_optics
from annulus_pipe.rings.uncertainty import BIAS_PX, RING_POINTS, KeptSlits, PointErrors, calibrated
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.pose import Fit, Fitter, sound_seed, weight_of
from annulus_pipe.wall.profile import Profile

# Measured by topics colour (points read, wrong rings), few_rings and diameter; OVER_EXPOSED by uncertainty.
FIRST_TOLERANCE = 0.5  # of the radius: the head's lean and stand-off are still in the deviation
WALL_TOLERANCE = 0.35  # and now they are not
ROUGHLY = 400  # points that tell the pose well enough to read the rings again
OVER_EXPOSED = 235.0  # grey levels of light, a slit's own darkness taken off
STEP_PX = 1.5  # a point's neighbours lie within this many pixels' worth of radius and ..
STEP = 0.01  # .. this part of the pipe's radius

# from a pose and a tolerance of the wall the ring of each slit; how many slits are left out, by reason
_Observed = tuple[Callable[[Pose, float], NDArray[np.int64]], dict[str, int]]


class _Memory:
    """One frame on its way from picture to points, in memory that is used again for the next: slits (N of them), the
    candidates (C) which ring each may be, and what becomes a profile."""

    def __init__(
        self,
        calibration: Calibration,
        grid: PolarGrid,
        optics: RingOptics,
        calibrated_mm: FloatArray,
        worth: FloatArray,
        stripes: StripeColours | None,
    ) -> None:
        rings, directions = optics.bend.shape
        of_lines = calibration.kind == "line"  # of one colour
        self.pedestal = Pedestal(grid.size, grid.spacing_px)
        self.unroll, self.slits = Unroller(grid), FrameSlits(grid)
        slits = self.slits
        most = len(slits.position)
        self.colour = np.empty((2, most), np.uint8)  # of the stripes inside and outside
        pattern = np.zeros(rings + 1, np.uint8) if of_lines else letters(calibration.colours)
        self.candidates = Candidates(slits.direction, self.colour, pattern)
        self.names = StripeNames(slits.light, calibration.colours, stripes, self.colour, self.candidates)
        self.points = CandidatePoints(slits, self.candidates, grid, optics)
        self.ring, chosen, points = self.candidates.named, self.candidates.chosen, self.points.points
        pipe = calibration.pipe_radius_mm
        of = NamedSlits(self.ring, slits.direction, slits.width, slits.bright, chosen, self.candidates.deviation)
        self.outliers = Outliers(of, pipe, STEP * pipe + STEP_PX * optics.mm_per_px, directions)
        self.fitter, self.counts = Fitter(most), np.empty(2, np.int64)
        to_fit = self.fitter.points, self.fitter.weight, np.empty(rings, np.int64), self.counts
        self.for_fit = _for_fit.held(self.ring, chosen, points, worth, ..., RING_POINTS, ..., *to_fit)
        kept, seen, clipped = np.empty(most, np.int64), np.empty((3, most)), np.empty(most, np.bool_)
        self.wall, self.light = np.empty((most, 3), np.float32), np.empty((most, 3), np.uint8)
        self.of_ring, self.of_line = np.empty(most, np.uint8), np.empty(most, np.uint16)
        self.rotation, self.shift = np.empty((3, 3)), np.empty(3)
        found, placed = (self.ring, slits.direction, chosen, slits.light, points), (self.rotation, self.shift)
        made = kept, seen, self.wall, self.light, clipped, self.of_ring, self.of_line
        self.keep = _keep.held(*found, *placed, ..., OVER_EXPOSED, ..., *made)
        widths = slits.blur, slits.width, self.outliers.wider
        of_kept = KeptSlits(kept, self.ring, slits.direction, seen, *widths, clipped)
        self.errors = PointErrors(of_kept, optics, calibrated_mm, MOSAIC_PX if of_lines else BIAS_PX)


class Reconstructor:
    """Holds what one calibration fixes (grid, rays, optics), so that frames cost only their own pixels.

    >>> reconstructor = Reconstructor(calibration)
    >>> profile = reconstructor.profile(image, frame=17, z_mm=40.8, seed=last.pose)
    """

    def __init__(self, calibration: Calibration, directions: int = 720, *, colour: ColourProfile | None = None) -> None:
        if not 36 <= directions <= 4096:
            raise AnnulusError(f"{directions} polar directions, expected 36..4096")
        self.calibration = calibration = calibration.only("slits", "line").in_wall()
        self.directions = directions
        self._grid = polar_grid(calibration, directions)
        self._optics = ring_optics(calibration, self._grid)
        self._calibrated = calibrated(calibration, self._grid, self._optics)
        # (K,) mm: what a tenth of a pixel and the calibrated radius itself leave open
        self._expected = np.hypot(0.1 * self._optics.mm_per_px, 0.0005 * calibration.pipe_radius_mm)
        self.colour = colour
        self._seen = colour.seen() if colour is not None else None
        self._worth = weight_of(self._expected)  # of a point to its ring's pose
        self._spare: list[_Memory] = []  # of frames that are done; threads take one each

    def profile(
        self,
        image: Picture,
        *,
        frame: int,
        z_mm: float,
        seed: Pose | None = None,
        roll_deg: float | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> Profile:
        """The wall's points in one projector frame.

        Parameters
        ----------
        image : (H, W, 3) uint8 BGR, or the mosaic that it is made of; of the calibration's size.
        z_mm : the frame's station, added to the points' z.
        seed : pose of a frame nearby, saves iterations; a wrong one, or one that is not finite, does no harm.
        roll_deg : how far the head was turned clockwise, looking forward; None where no sensor said so, and then clock
            positions are the head's own.

        Raises
        ------
        AnnulusError where the image is not of the calibration's size, or its station is not finite. A frame without a
        pipe in it is no error: its profile has no pose and no points, and `rejected` says why.
        """
        camera = self.calibration.camera
        if not is_colour(image, camera.width, camera.height):
            raise AnnulusError(
                f"frame {frame}: image is {in_words(image)}, but the calibration's camera is "
                f"{camera.width}x{camera.height}, 3 of uint8. Calibrate with the camera that took this scan."
            )
        seed = sound_seed(frame, z_mm, seed)
        memory = self._spare.pop() if self._spare else self._memory()
        try:
            return self._profile(memory, image, frame, z_mm, seed, roll_deg, clock)
        finally:
            self._spare.append(memory)

    def _memory(self) -> _Memory:
        return _Memory(self.calibration, self._grid, self._optics, self._calibrated, self._worth, self._seen)

    def _profile(
        self,
        memory: _Memory,
        image: Picture,
        frame: int,
        z_mm: float,
        seed: Pose | None,
        roll_deg: float | None,
        clock: Callable[[], float],
    ) -> Profile:
        slits, candidates = memory.slits, memory.candidates
        marks = [("", clock())]

        def mark(stage: str) -> None:
            marks.append((stage, clock()))

        observe = self._observe_lines if self.calibration.kind == "line" else self._observe_slits
        named, rejected = observe(memory, image, mark)
        memory.points.place()
        mark("triangulate")
        # A seed far off would make every reading implausible: then once more without.
        for first in (seed, None) if seed is not None else (None,):
            named(first or Pose(), FIRST_TOLERANCE)
            mark("decode")
            fitted = self._fit(memory, first, ROUGHLY)
            mark("pose")
            if fitted is not None:
                break
        if fitted is None:
            rejected["no pipe"] = slits.size
            return _without_pipe(frame, z_mm, rejected, spans(marks))
        # Read again where the wall now is, and fit what that leaves.
        ring = named(fitted.pose, WALL_TOLERANCE)
        mark("decode")
        rejected["no ring"] = candidates.left_out
        memory.outliers.reject(slits.size)
        rejected |= memory.outliers.counts()
        if self.calibration.kind == "line":
            rejected["object"] = without_objects(
                ring,
                slits.direction[: slits.size],
                self._of_every_ring(memory),
                self._optics.mm_per_px,
                self.directions,
            )
        mark("outliers")
        fitted = self._fit(memory, fitted.pose) or fitted
        pose = fitted.pose if roll_deg is None else replace(fitted.pose, roll=math.radians(roll_deg))
        mark("pose")
        memory.rotation[:], memory.shift[:] = pose.rotation, pose.translation
        kept = memory.keep(z_mm, slits.size)
        mark("points")
        sigma = memory.errors.sigma(fitted, kept)
        slit_rad = self._slit_rad(memory)
        mark("sigma")
        return Profile(
            frame,
            z_mm,
            pose,
            memory.wall[:kept].copy(),
            memory.light[:kept].copy(),
            memory.of_ring[:kept].copy(),
            memory.of_line[:kept].copy(),
            fitted.robust_sigma_mm,
            rejected,
            spans(marks),
            sigma,
            fitted.lean_sigma_deg,
            ring_sigma_mm=memory.errors.of_rings(),
            slit_rad=slit_rad,
        )

    def _observe_slits(self, memory: _Memory, image: Picture, mark: Callable[[str], None]) -> _Observed:
        """What the frame shows."""
        slits, candidates = memory.slits, memory.candidates
        unrolled = memory.unroll(memory.pedestal.taken_off(image))
        mark("polar")
        slits.find(unrolled)
        mark("slits")
        memory.names.name(slits.size)
        mark("colours")
        pipe, read = self.calibration.pipe_radius_mm, memory.points.read
        rejected = {"crowded": slits.crowded, "shallow": slits.shallow, "colour": candidates.unclear}
        return lambda pose, tolerance: read(pose, pipe, tolerance), rejected

    def _observe_lines(self, memory: _Memory, image: Picture, mark: Callable[[str], None]) -> _Observed:
        slits, candidates = memory.slits, memory.candidates
        lines, strength = find_lines(bgr_of(image), self._grid)
        slits.take(lines)
        candidates.list_all(slits.size)
        memory.errors.bias_px = line_bias(lines)
        mark("lines")

        def named(pose: Pose, tolerance: float) -> NDArray[np.int64]:
            memory.points.deviate(pose, self.calibration.pipe_radius_mm)
            deviation = candidates.deviation[: candidates.size].reshape(slits.size, len(self._expected))
            return candidates.take(name_lines(lines.direction, strength, deviation, tolerance))

        return named, {"crowded": lines.crowded, "faint": lines.shallow}

    def _of_every_ring(self, memory: _Memory) -> FloatArray:
        """(N, K) mm: the wall's radius if line n were ring k, where every one is a candidate."""
        deviation = memory.candidates.deviation[: memory.candidates.size]
        return self.calibration.pipe_radius_mm * (1.0 + deviation.reshape(memory.slits.size, len(self._expected)))

    def _slit_rad(self, memory: _Memory) -> NDArray[np.float32]:
        """(K,) half of the angle of light between the edges of each ring's slit, 0 where too few were seen. None of a
        bright line, which has no edges, and behind a mirror, where rays start apart."""
        if self.calibration.kind == "line" or not self.calibration.camera.central:
            return np.zeros(0, np.float32)
        return np.asarray(0.5 * self._optics.rad_per_px * memory.errors.usual_width, np.float32)

    def slits_by_order(self, image: Picture) -> tuple[Slits, PlacedSlits | None]:
        """A frame's slits, and which ring each is by its order alone; colours can be learnt from that."""
        slits = find_slits(unroll(without_pedestal(image, self._grid.spacing_px), self._grid), self._grid)
        return slits, by_order(slits, self._grid, self._optics, self._expected, self.calibration.pipe_radius_mm)

    def _fit(self, memory: _Memory, seed: Pose | None, most: int = 0) -> Fit | None:
        """Of the slits that are a ring, or about `most` of them."""
        memory.for_fit(most, memory.slits.size)
        size, rings = memory.counts.tolist()
        return memory.fitter.fit(size, self.calibration.pipe_radius_mm, seed, one_ring=rings < 2)


def _without_pipe(frame: int, z_mm: float, rejected: dict[str, int], timing_ms: dict[str, float]) -> Profile:
    empty = np.zeros(0, np.uint8)
    points, colour = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8)
    direction = np.zeros(0, np.uint16)
    return Profile(frame, z_mm, None, points, colour, empty, direction, math.nan, rejected, timing_ms)


def spans(marks: list[tuple[str, float]]) -> dict[str, float]:
    """ms of each stage, from (what ended, when in s); of stages of one name the sum, and `total`."""
    out: dict[str, float] = {}
    for (_, before), (name, after) in pairwise(marks):
        out[name] = out.get(name, 0.0) + 1e3 * (after - before)
    out["total"] = 1e3 * (marks[-1][1] - marks[0][1])
    return out


_keep = door(
    "rings_keep",
    "i8[n] ring",
    "i8[n] direction",
    "i4[n] chosen",
    "f8[6,n] light",
    "f8[3,c] points",
    "f8[3,3] rotation",
    "f8[3] shift",
    "f8 z",
    "f8 full",
    "i8 size",
    "i8[n]! kept",
    "f8[3,n]! seen",
    "f4[n,3]! wall",
    "u1[n,3]! colour",
    "b1[n]! clipped",
    "u1[n]! of_ring",
    "u2[n]! of_line",
    returns="i8",
)
_for_fit = door(
    "rings_for_fit",
    "i8[n] ring",
    "i4[n] chosen",
    "f8[3,c] points",
    "f8[k] worth",
    "i8 most_points",
    "i8 ring_points",
    "i8 size",
    "f8[3,p]! out",
    "f8[p]! weight",
    "i8[k]! in_ring",
    "i8[2]! counts",
)
