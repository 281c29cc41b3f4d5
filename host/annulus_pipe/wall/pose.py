"""Where the pipe is, from points on its wall that may be dented, holed or wrong."""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import CAUCHY, SIGMA_OF_MAD
from annulus_pipe.vocabulary import AnnulusError

# host/native/wall_pose.c has the method and its thresholds
_fit = door(
    "pose_fit",
    "f8[3,m] points",
    "f8[m] weight",
    "i8 count",
    "f8 radius",
    "f8[4] seed",
    "b1 one_ring",
    "f8 cauchy",
    "f8 sigma_of_mad",
    "f8[w]! work",
    "f8[21]! out",
    returns="b1",
)


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The pose, the robust sigma of the points about the pipe, and how well the pose is known.

    `covariance` (4, 4): of rx, ry (radians), tx, ty (mm), in the pose's own order.
    """

    pose: Pose
    robust_sigma_mm: float
    covariance: FloatArray

    @property
    def lean_sigma_deg(self) -> float:
        """Standard deviation of the lean, in the direction in which it is known worst (of x and y)."""
        return math.degrees(math.sqrt(max(self.covariance[0, 0], self.covariance[1, 1])))


def fit_pose(
    points_mm: FloatArray, radius_mm: float, sigma_mm: FloatArray, seed: Pose | None = None, one_ring: bool = False
) -> Fit | None:
    """Pose of the pipe of known radius, its ovality allowed for.

    Parameters
    ----------
    points_mm : (N, 3) camera frame, finite. sigma_mm : (N,) each point's expected radial error, as weight.
    seed : first guess, such as the previous frame's pose; aligned with the camera when not given.
    one_ring : all points are of one ring, which does not show the lean.

    Returns
    -------
    None where the points do not make a pipe: too few, not round enough the way, or scattered too far.

    Notes
    -----
    Minimises (r - R) with R known (Alzuhiri 2022, Eq. 4.8, free in rx, ry, tx, ty): a quadric (§3.4.3) turns by 90
    degrees on a hole, this does not notice it. A Cauchy loss whose scale shrinks with the residuals comes near. Then
    the most likely pose if errors are normal and some points are wild, both learnt on the way, so that clean points
    count in full: as good as least squares told which points are clean. Damage hides within the noise of a point but
    not within that of a patch of wall: patches whose mean is farther off than means usually are get left out.

    A slightly oval or odd-sized pipe would lean the head to please half of the points (0.8 degrees on 2 % of
    ovality), so a mean and a twofold term of the radius are fitted along, but only where the points show them: on half
    a pipe they would cost the shift its accuracy. One ring alone does not show the lean: its points stay on the wall
    whichever way the head is turned about the ring's middle (turned far, they make an ellipse, as an oval pipe would).
    It is then left at the camera's own alignment, and the covariance says how little is known.
    Should a seed lead nowhere, the fit starts again without.
    """
    fitter = Fitter(len(sigma_mm))
    fitter.points[:] = points_mm.T
    fitter.weight[:] = weight_of(sigma_mm)
    return fitter.fit(len(sigma_mm), radius_mm, seed, one_ring)


def sound_seed(frame: int, z_mm: float, seed: Pose | None) -> Pose | None:
    """The seed of a frame at station z_mm, None for one that is not finite. Raises AnnulusError for such a station."""
    if not math.isfinite(z_mm):
        raise AnnulusError(f"frame {frame}: its station is {z_mm} mm, expected a finite number")
    if seed is None or not math.isfinite(seed.rx + seed.ry + seed.tx + seed.ty):
        return None
    return seed


def weight_of(sigma_mm: FloatArray) -> FloatArray:
    """1 / sigma^2, bounded."""
    return np.asarray(1.0 / np.maximum(np.asarray(sigma_mm, dtype=float), 1e-6) ** 2)


class Fitter:
    """Room for fits of at most `most` points, for who fits a pose in every frame: `fit_pose` without its copies. What
    is fitted is written to points (3, most), mm, and weight (most,), see `weight_of`."""

    def __init__(self, most: int) -> None:
        self.points, self.weight = np.empty((3, most)), np.empty(most)
        self._seed, self._out = np.zeros(4), np.empty(21)
        work = np.empty(16 * most + 700)  # ROOM of wall_pose.c
        fixed = CAUCHY, SIGMA_OF_MAD, work, self._out
        self._fit = _fit.held(self.points, self.weight, ..., ..., self._seed, ..., *fixed)

    def fit(self, count: int, radius_mm: float, seed: Pose | None = None, one_ring: bool = False) -> Fit | None:
        """Of the first `count` points."""
        self._seed[:] = (0.0, 0.0, 0.0, 0.0) if seed is None else (seed.rx, seed.ry, seed.tx, seed.ty)
        if not self._fit(count, radius_mm, one_ring):
            return None
        rx, ry, tx, ty, robust = self._out[:5].tolist()
        return Fit(Pose(rx, ry, tx, ty), robust, self._out[5:].reshape(4, 4).copy())
