"""From one projector frame to the wall: the method, end to end."""

import math
import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from annulus.geometry.calibration import Calibration
from annulus.geometry.pose import FloatArray, Pose
from annulus.rings.colour import ColourProfile
from annulus.rings.compiled import compiled
from annulus.rings.decode import NONE, UNKNOWN, classify, decode, readings
from annulus.rings.order import Placed, by_order
from annulus.rings.polar import polar_grid, unroll
from annulus.rings.pose import Fit, fit_pose
from annulus.rings.profile import Profile
from annulus.rings.slits import Slits, find_slits
from annulus.rings.triangulate import deviations, ring_optics, triangulate
from annulus.vocabulary import AnnulusError

FIRST_TOLERANCE = 0.5  # of the radius: the head's lean and stand-off are still in the deviation
WALL_TOLERANCE = 0.35  # and now they are not
NARROW, WIDE = 0.7, 1.35  # of the ring's width around there: beyond, a slit is half covered or part of a shadow ..
WIDTH_NOISE = 4.0  # .. unless widths scatter so much that this many sigma reach farther
WIDTH_EVERY = 4  # points: what the ring's width is learnt from
SHADE, SHADE_REACH = 0.5, 2  # a slit has at least this part of its ring's light so many directions to the side
UNLIKE = 2.0  # a ring's usual width is within this factor of the frame's
NEIGHBOURS = 4  # a point needs company among so many directions on each side ..
COMPANY = 3  # .. of so many points of its ring ..
STEP_PX = 1.5  # .. within this many pixels' worth of radius and ..
STEP = 0.01  # .. this part of the pipe's radius


class Reconstructor:
    """Holds what one calibration fixes (grid, rays, optics), so that frames cost only their own pixels.

    >>> reconstructor = Reconstructor(calibration)
    >>> profile = reconstructor.profile(image_bgr, frame=17, z_mm=40.8, seed=last.pose)
    """

    def __init__(self, calibration: Calibration, directions: int = 720, *, colour: ColourProfile | None = None) -> None:
        if not 36 <= directions <= 4096:
            raise AnnulusError(f"{directions} polar directions, expected 36..4096")
        self.calibration = calibration
        self.directions = directions
        self._grid = polar_grid(calibration, directions)
        self._optics = ring_optics(calibration, self._grid)
        # (K,) mm: what a tenth of a pixel and the calibrated radius itself leave open
        self._expected = np.hypot(0.1 * self._optics.mm_per_px, 0.0005 * calibration.pipe_radius_mm)
        self._colour = colour.seen() if colour is not None else None

    def profile(
        self,
        image_bgr: NDArray[np.uint8],
        *,
        frame: int,
        z_mm: float,
        seed: Pose | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> Profile:
        """The wall's points in one projector frame.

        Parameters
        ----------
        image_bgr : (H, W, 3) uint8, of the calibration's size. z_mm : the frame's station, added to the points' z.
        seed : pose of a frame nearby, saves iterations; a wrong one does no harm.

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
        pipe, colours = self.calibration.pipe_radius_mm, self.calibration.colours
        marks = [("", clock())]
        polar = unroll(image_bgr, self._grid)
        marks.append(("polar", clock()))
        slits = find_slits(polar, self._grid)
        marks.append(("slits", clock()))
        both = classify(np.vstack([slits.inside, slits.outside]), colours, self._colour)
        inside, outside = both[: len(slits.position)], both[len(slits.position) :]
        marks.append(("colours", clock()))
        points = triangulate(slits, self._grid, self._optics, readings(inside, outside, colours))
        marks.append(("triangulate", clock()))

        rejected = {"crowded": slits.crowded, "shallow": slits.shallow}
        # A seed far off would make every reading implausible: then once more without.
        for first in (seed, None) if seed is not None else (None,):
            deviation = deviations(points, first or Pose(), pipe)
            ring = decode(slits.direction, inside, outside, deviation, colours, FIRST_TOLERANCE)
            marks.append(("decode", clock()))
            fitted = self._fit(points, ring, first, every=3)
            marks.append(("pose", clock()))
            if fitted is not None:
                break
        if fitted is None:
            rejected["no pipe"] = len(ring)
            empty = np.zeros(0, np.uint8)
            return Profile(
                frame, z_mm, None, np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), empty,
                empty.astype(np.uint16), math.nan, rejected, _spans(marks),
            )  # fmt: skip
        # Read again where the wall now is, and fit what that leaves.
        deviation = deviations(points, fitted.pose, pipe)
        ring = decode(slits.direction, inside, outside, deviation, colours, WALL_TOLERANCE)
        marks.append(("decode", clock()))
        rejected["colour"] = int(np.count_nonzero((inside == UNKNOWN) | (outside == UNKNOWN)))
        rejected["no ring"] = int(np.count_nonzero(ring == NONE))
        ring, rejected["width"] = _width_gate(
            ring, slits.direction, slits.width, len(self._optics.cones), self.directions
        )
        ring, rejected["shaded"] = _shade_gate(ring, slits, len(self._optics.cones), self.directions)
        ring, rejected["alone"] = self._company_gate(slits.direction, pipe * (1.0 + deviation), ring)
        marks.append(("gates", clock()))
        fitted = self._fit(points, ring, fitted.pose) or fitted
        pose = fitted.pose
        marks.append(("pose", clock()))
        kept = np.flatnonzero(ring != NONE)
        wall = pose.to_pipe(points[kept, ring[kept]], z_mm)
        light = np.clip((slits.inside[kept] + slits.outside[kept])[:, ::-1] / 2, 0, 255)
        marks.append(("points", clock()))
        return Profile(
            frame, z_mm, pose, wall.astype(np.float32), light.astype(np.uint8), ring[kept].astype(np.uint8),
            slits.direction[kept].astype(np.uint16), fitted.spread_mm, rejected, _spans(marks),
            self._expected[ring[kept]].astype(np.float32),
        )  # fmt: skip

    def sightings(self, image_bgr: NDArray[np.uint8]) -> tuple[Slits, Placed | None]:
        """A frame's slits, and which ring each is by its order alone; colours can be learnt from that."""
        slits = find_slits(unroll(image_bgr, self._grid), self._grid)
        return slits, by_order(slits, self._grid, self._optics, self._expected, self.calibration.pipe_radius_mm)

    def _fit(self, points: FloatArray, ring: NDArray[np.int64], seed: Pose | None, every: int = 1) -> Fit | None:
        kept = np.flatnonzero(ring != NONE)[::every]
        return fit_pose(points[kept, ring[kept]], self.calibration.pipe_radius_mm, self._expected[ring[kept]], seed)

    def _company_gate(
        self, direction: NDArray[np.int64], radius: FloatArray, ring: NDArray[np.int64]
    ) -> tuple[NDArray[np.int64], int]:
        kept = np.flatnonzero(ring != NONE)
        curve = np.full((len(self._optics.cones), self.directions), np.nan)
        curve[ring[kept], direction[kept]] = radius[kept, ring[kept]]
        step = STEP * self.calibration.pipe_radius_mm + STEP_PX * self._optics.mm_per_px
        good = _company(curve, step, NEIGHBOURS, COMPANY)[ring[kept], direction[kept]]
        out = np.full_like(ring, NONE)
        out[kept[good]] = ring[kept[good]]
        return out, int(np.count_nonzero(~good))


def _width_gate(
    ring: NDArray[np.int64], direction: NDArray[np.int64], width: FloatArray, rings: int, directions: int
) -> tuple[NDArray[np.int64], int]:
    """Drops slits much narrower or wider than their ring is around there: half covered, or run into a shadow.

    A leaning head sees a ring wider on one side; a mean and a first harmonic over the direction follow that.
    """
    out = ring.copy()
    frame = float(np.median(width[ring != NONE])) if (ring != NONE).any() else 0.0
    turn = direction * (2 * math.pi / directions)
    for k in range(rings):
        mine = np.flatnonzero(ring == k)
        if not len(mine):
            continue
        # Two slits with a dark stripe between them look like one wide one, all the way round.
        usual = float(np.clip(np.median(width[mine]), frame / UNLIKE, frame * UNLIKE))
        basis = np.stack([np.ones(len(mine)), np.cos(turn[mine]), np.sin(turn[mine])], axis=1)
        ratio = width[mine] / usual
        some, values = basis[::WIDTH_EVERY], ratio[::WIDTH_EVERY]  # three numbers do not need every direction
        fit, spread = np.array([1.0, 0.0, 0.0]), 0.2
        for _ in range(3):
            off = np.abs(values - some @ fit)
            good = off < max(2.5 * spread, 0.05)
            if np.count_nonzero(good) < 0.5 * len(good):
                break
            weighted = some[good]
            fit = np.linalg.solve(weighted.T @ weighted + 1e-6 * np.eye(3), weighted.T @ values[good])
            spread = 1.4826 * float(np.median(np.abs(values - some @ fit)))
        expected = basis @ fit
        ratio = ratio / np.clip(expected, NARROW, WIDE)
        slack = min(max(1.0, WIDTH_NOISE * spread / (WIDE - 1.0)), 2.0)
        out[mine[(ratio < 1.0 - (1.0 - NARROW) * slack) | (ratio > 1.0 + (WIDE - 1.0) * slack)]] = NONE
    return out, int(np.count_nonzero(out != ring))


def _shade_gate(ring: NDArray[np.int64], slits: Slits, rings: int, directions: int) -> tuple[NDArray[np.int64], int]:
    """Drops slits in a shadow's edge: much dimmer than their own ring a step to the side."""
    kept = np.flatnonzero(ring != NONE)
    light = np.zeros((rings, directions))
    light[ring[kept], slits.direction[kept]] = slits.inside[kept].max(axis=1) + slits.outside[kept].max(axis=1)
    brightest = np.max([np.roll(light, step, axis=1) for step in range(-SHADE_REACH, SHADE_REACH + 1)], axis=0)
    bad = kept[(light < SHADE * brightest)[ring[kept], slits.direction[kept]]]
    out = ring.copy()
    out[bad] = NONE
    return out, len(bad)


def _spans(marks: list[tuple[str, float]]) -> dict[str, float]:
    spans: dict[str, float] = {}
    for (_, before), (name, after) in pairwise(marks):
        spans[name] = spans.get(name, 0.0) + 1e3 * (after - before)
    spans["total"] = 1e3 * (marks[-1][1] - marks[0][1])
    return spans


def _size(image: NDArray[np.uint8]) -> str:
    return f"{image.shape[1]}x{image.shape[0]}" if image.ndim >= 2 else f"an array of shape {image.shape}"


@compiled
def _company(radius, step, reach, least):  # type: ignore[no-untyped-def]
    """(K, J) bool: has at least `least` neighbours of its own ring at nearly its radius."""
    rings, directions = radius.shape
    good = np.zeros((rings, directions), np.bool_)
    for k in range(rings):
        for j in range(directions):
            count = 0
            for d in range(-reach, reach + 1):
                if d != 0 and abs(radius[k, (j + d) % directions] - radius[k, j]) <= step[k]:
                    count += 1
            good[k, j] = count >= least
    return good
