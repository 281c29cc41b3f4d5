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
from annulus_pipe.numeric.jit import jit
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.rings.decode import NONE, UNKNOWN, classify, decode, readings
from annulus_pipe.rings.lines import find_lines, line_bias, name_lines
from annulus_pipe.rings.objects import without_objects
from annulus_pipe.rings.order import PlacedSlits, by_order
from annulus_pipe.rings.outliers import reject_outliers
from annulus_pipe.rings.pedestal import without_pedestal
from annulus_pipe.rings.polar import polar_grid, unroll
from annulus_pipe.rings.slits import Slits, find_slits
from annulus_pipe.rings.triangulate import deviations, ring_optics, triangulate
from annulus_pipe.rings.uncertainty import BIAS_PX, calibrated, point_sigma
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.pose import Fit, fit_pose
from annulus_pipe.wall.profile import Profile

# Measured by topics colour (points read, wrong rings), few_rings and diameter; OVER_EXPOSED by uncertainty.
FIRST_TOLERANCE = 0.5  # of the radius: the head's lean and stand-off are still in the deviation
WALL_TOLERANCE = 0.35  # and now they are not
RING_POINTS = 20  # with fewer a ring does not count as seen
ROUGHLY = 400  # points that tell the pose well enough to read the rings again
OVER_EXPOSED = 235.0  # grey levels of light, a slit's own darkness taken off
STEP_PX = 1.5  # a point's neighbours lie within this many pixels' worth of radius and ..
STEP = 0.01  # .. this part of the pipe's radius

# what a frame shows: slits, or lines given like them; (N, K) which ring each could be; from (N, K) deviations of the
# wall and their tolerance the ring of each; how many were left out, by reason
_Seen = tuple[Slits, NDArray[np.bool_], Callable[[FloatArray, float], NDArray[np.int64]], dict[str, int]]


class Reconstructor:
    """Holds what one calibration fixes (grid, rays, optics), so that frames cost only their own pixels.

    >>> reconstructor = Reconstructor(calibration)
    >>> profile = reconstructor.profile(image_bgr, frame=17, z_mm=40.8, seed=last.pose)
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

    def profile(
        self,
        image_bgr: NDArray[np.uint8],
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
        image_bgr : (H, W, 3) uint8, of the calibration's size. z_mm : the frame's station, added to the points' z.
        seed : pose of a frame nearby, saves iterations; a wrong one does no harm.
        roll_deg : how far the head was turned clockwise, looking forward; None where no sensor said so, and then clock
            positions are the head's own.

        Raises
        ------
        AnnulusError where the image is not of the calibration's size. A frame without a pipe in it is no error: its
        profile has no pose and no points, and `rejected` says why.
        """
        camera = self.calibration.camera
        if image_bgr.shape != (camera.height, camera.width, 3) or image_bgr.dtype != np.uint8:
            raise AnnulusError(
                f"frame {frame}: image is {_size(image_bgr)} but the calibration's camera is "
                f"{camera.width}x{camera.height}, 8 bit colour. Calibrate with the camera that took this scan."
            )
        pipe = self.calibration.pipe_radius_mm
        marks = [("", clock())]

        def mark(stage: str) -> None:
            marks.append((stage, clock()))

        slits, could_be, named, rejected = (self._lines if self.calibration.kind == "line" else self._slits)(
            image_bgr, mark
        )
        points = triangulate(slits, self._grid, self._optics, could_be)
        mark("triangulate")
        # A seed far off would make every reading implausible: then once more without.
        for first in (seed, None) if seed is not None else (None,):
            deviation = deviations(points, first or Pose(), pipe)
            ring = named(deviation, FIRST_TOLERANCE)
            marks.append(("decode", clock()))
            fitted = self._fit(points, ring, first, ROUGHLY)
            marks.append(("pose", clock()))
            if fitted is not None:
                break
        if fitted is None:
            rejected["no pipe"] = len(ring)
            empty = np.zeros(0, np.uint8)
            return Profile(
                frame,
                z_mm,
                None,
                np.zeros((0, 3), np.float32),
                np.zeros((0, 3), np.uint8),
                empty,
                empty.astype(np.uint16),
                math.nan,
                rejected,
                spans(marks),
            )
        # Read again where the wall now is, and fit what that leaves.
        deviation = deviations(points, fitted.pose, pipe)
        ring = named(deviation, WALL_TOLERANCE)
        marks.append(("decode", clock()))
        rejected["no ring"] = int(np.count_nonzero(ring == NONE))
        step = STEP * pipe + STEP_PX * self._optics.mm_per_px
        outliers, wider = reject_outliers(ring, slits, pipe * (1.0 + deviation), step, self.directions)
        rejected |= outliers
        if self.calibration.kind == "line":
            rejected["object"] = without_objects(
                ring, slits.direction, pipe * (1.0 + deviation), self._optics.mm_per_px, self.directions
            )
        marks.append(("outliers", clock()))
        fitted = self._fit(points, ring, fitted.pose) or fitted
        pose = replace(fitted.pose, roll=None if roll_deg is None else math.radians(roll_deg))
        marks.append(("pose", clock()))
        kept = np.flatnonzero(ring != NONE)
        seen = points[kept, ring[kept]]
        wall = pose.to_pipe(seen, z_mm)
        light = np.empty((len(kept), 3), np.uint8)
        clipped = np.empty(len(kept), np.bool_)
        _beside(kept, slits.inside, slits.outside, light, clipped)
        marks.append(("points", clock()))
        sigma, of_rings = point_sigma(
            ring[kept],
            slits.direction[kept],
            seen,
            slits.edge_blur[kept],
            wider[kept],
            clipped,
            self._optics,
            self._calibrated,
            fitted,
            line_bias(slits) if self.calibration.kind == "line" else BIAS_PX,
        )
        marks.append(("sigma", clock()))
        return Profile(
            frame,
            z_mm,
            pose,
            wall.astype(np.float32),
            light,
            ring[kept].astype(np.uint8),
            slits.direction[kept].astype(np.uint16),
            fitted.robust_sigma_mm,
            rejected,
            spans(marks),
            sigma,
            fitted.lean_sigma_deg,
            ring_sigma_mm=of_rings,
            slit_rad=self._slit_rad(slits.width[kept], ring[kept]),
        )

    def _slits(self, image_bgr: NDArray[np.uint8], mark: Callable[[str], None]) -> _Seen:
        polar = unroll(without_pedestal(image_bgr, self._grid.spacing_px), self._grid)
        mark("polar")
        slits = find_slits(polar, self._grid)
        mark("slits")
        colours = self.calibration.colours
        both = classify(np.vstack([slits.inside, slits.outside]), colours, self._seen)
        inside, outside = both[: len(slits.position)], both[len(slits.position) :]
        mark("colours")

        def named(deviation: FloatArray, tolerance: float) -> NDArray[np.int64]:
            return decode(slits.direction, inside, outside, deviation, colours, tolerance)

        unknown = int(np.count_nonzero((inside == UNKNOWN) | (outside == UNKNOWN)))
        rejected = {"crowded": slits.crowded, "shallow": slits.shallow, "colour": unknown}
        return slits, readings(inside, outside, colours), named, rejected

    def _slit_rad(self, width: FloatArray, ring: NDArray[np.int64]) -> NDArray[np.float32]:
        """(K,) half of the angle of light between the edges of each ring's slit, 0 where too few were seen. None of a
        bright line, which has no edges, and behind a mirror, where rays start apart."""
        if self.calibration.kind == "line" or not self.calibration.camera.central:
            return np.zeros(0, np.float32)
        usual = [np.median(w) if len(w := width[ring == k]) >= RING_POINTS else 0.0 for k in range(len(self._expected))]
        return np.asarray(0.5 * self._optics.rad_per_px * usual, np.float32)

    def _lines(self, image_bgr: NDArray[np.uint8], mark: Callable[[str], None]) -> _Seen:
        lines, strength = find_lines(image_bgr, self._grid)
        mark("lines")

        def named(deviation: FloatArray, tolerance: float) -> NDArray[np.int64]:
            return name_lines(lines.direction, strength, deviation, tolerance)

        could_be = np.ones((len(lines.position), len(self.calibration.rings)), np.bool_)
        return lines, could_be, named, {"crowded": lines.crowded, "faint": lines.shallow}

    def slits_by_order(self, image_bgr: NDArray[np.uint8]) -> tuple[Slits, PlacedSlits | None]:
        """A frame's slits, and which ring each is by its order alone; colours can be learnt from that."""
        slits = find_slits(unroll(without_pedestal(image_bgr, self._grid.spacing_px), self._grid), self._grid)
        return slits, by_order(slits, self._grid, self._optics, self._expected, self.calibration.pipe_radius_mm)

    def _fit(
        self, points: FloatArray, ring: NDArray[np.int64], seed: Pose | None, most: int | None = None
    ) -> Fit | None:
        kept = np.flatnonzero(ring != NONE)
        if most is not None:
            kept = kept[:: max(1, len(kept) // most)]
        mine = ring[kept]
        one_ring = bool(np.count_nonzero(np.bincount(mine) > RING_POINTS) < 2)
        return fit_pose(points[kept, mine], self.calibration.pipe_radius_mm, self._expected[mine], seed, one_ring)


def spans(marks: list[tuple[str, float]]) -> dict[str, float]:
    """ms of each stage, from (what ended, when in s); of stages of one name the sum, and `total`."""
    out: dict[str, float] = {}
    for (_, before), (name, after) in pairwise(marks):
        out[name] = out.get(name, 0.0) + 1e3 * (after - before)
    out["total"] = 1e3 * (marks[-1][1] - marks[0][1])
    return out


def _size(image: NDArray[np.uint8]) -> str:
    return f"{image.shape[1]}x{image.shape[0]}" if image.ndim >= 2 else f"an array of shape {image.shape}"


@jit
def _beside(kept, inside, outside, out, clipped):  # type: ignore[no-untyped-def]
    """The wall's colour, RGB, as the mean of what the two stripes (BGR) show of it; whether one is over-exposed."""
    for n in range(len(kept)):
        clipped[n] = False
        for c in range(3):
            a, b = inside[kept[n], 2 - c], outside[kept[n], 2 - c]
            out[n, c] = min(0.5 * (a + b), 255.0)
            clipped[n] = clipped[n] or max(a, b) > OVER_EXPOSED
