"""What a calibration is worth on frames that it has not seen."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.bundle import SETTLED, Bundle, Solution, packed
from annulus_pipe.rings.calibration.observations import Observations


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """A pipe as rings measure it, frame by frame, the poses as found from the rings."""

    error_px: FloatArray  # (N,) where each slit was seen less where it should be; NaN where it has no weight, and ..
    off_mm: FloatArray  # (N,) .. the wall's radius less the pipe's there
    off_radius_mm: FloatArray  # (F,) the same for each frame's pipe as a whole, and ..
    sigma_mm: FloatArray  # (F,) .. its standard deviation

    def rms_mm(self, which: NDArray[np.bool_] | slice = slice(None)) -> float:
        return float(np.sqrt(np.nanmean(self.off_mm[which] ** 2)))


def measure(
    seen: Observations, solution: Solution, poses: Sequence[Pose], corrections: FloatArray | None = None
) -> Measured:
    """Measure frames with a solution's rings, starting from `poses` of them. corrections : see `calibrate`."""
    rings, frames = len(solution.rings), len(poses)
    known = np.zeros((rings, 2, 0)) if corrections is None else corrections
    px, mm, of_frame, sigma = (np.full(n, np.nan) for n in (len(seen), len(seen), frames, frames))
    for j, pose in enumerate(poses):
        mine = np.flatnonzero(seen.frame == j)
        one = replace(seen.take(mine), frame=np.zeros(len(mine), np.int64))
        problem = Bundle(one, rings, 1, solution.radius_mm, known)
        problem.descend(packed(replace(solution, poses=(pose,))), robust=False, settled=SETTLED, poses_only=True)
        weight, _ = problem.weights(problem.sigma_px(), robust=False)
        px[mine] = np.where(weight > 0, problem.error, np.nan)
        mm[mine] = px[mine] / problem.rows[:, 10]
        matrix, vector = problem.normal(weight / solution.correlation_length[one.ring])
        own = [*range(6 * rings, 6 * rings + 5)]
        cover = np.linalg.inv(matrix[np.ix_(own, own)])
        of_frame[j], sigma[j] = (cover @ vector[own])[4], math.sqrt(cover[4, 4])
    return Measured(px, mm, of_frame, sigma)


def hold_out(
    seen: Observations,
    solution: Solution,
    folds: int,
    *,
    fit: Callable[[Observations, Solution], tuple[Solution, FloatArray]] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Measured:
    """Calibrate `folds` times, each time without one part of the frames, and measure the pipe in those.

    `fit` goes on from a part's solution and adds what the rings are off their cones, as `fit_corrections` does.
    """
    frames = len(solution.poses)
    out = Measured(*(np.full(n, np.nan) for n in (len(seen), len(seen), frames, frames)))
    part = np.arange(frames) % folds
    for fold in range(folds):
        found, corrections = None, None
        for chosen in (np.flatnonzero(part != fold), np.flatnonzero(part == fold)):
            number = np.full(frames, -1)
            number[chosen] = np.arange(len(chosen))
            mine = np.flatnonzero(number[seen.frame] >= 0)
            few = seen.take(mine)
            few = replace(few, frame=number[few.frame])
            poses = tuple(solution.poses[j] for j in chosen)
            if found is None:
                start = replace(solution, poses=poses)
                found = calibrate(few, solution.radius_mm, start=start)
                if fit is not None:
                    found, corrections = fit(few, found)
            else:
                one = measure(few, found, poses, corrections)
                out.error_px[mine], out.off_mm[mine] = one.error_px, one.off_mm
                out.off_radius_mm[chosen], out.sigma_mm[chosen] = one.off_radius_mm, one.sigma_mm
        if progress is not None:
            progress(fold + 1, folds)
    return out
