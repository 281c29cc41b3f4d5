"""What each projected ring is off its cone, direction by direction: scratches and lumps of the slide."""

from dataclasses import replace

import numpy as np

from annulus_pipe.geometry.calibration import RingCorrection
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import sparse
from annulus_pipe.numeric.robust import prior_sigma
from annulus_pipe.rings.calibration.autocalibration import calibrate
from annulus_pipe.rings.calibration.bundle import Solution
from annulus_pipe.rings.calibration.observations import Observations, azimuths

# By topic fine_tuning (held-out radius error, <= 0.28 mm).
DIRECTIONS = 1440  # two for each that is looked in, so that what lies between them is not smoothed
STRAIGHT_PX = 1.5  # an offset that moves a slit farther is found again from there: lines are not straight ..
ROUNDS = 4  # .. so often at most


def fit_corrections(
    seen: Observations, solution: Solution, *, directions: int = DIRECTIONS, axial_mm: float = 0.0
) -> tuple[Solution, FloatArray]:
    """Each ring's offsets from its cone, and the cones and poses found anew with such offsets allowed.

    Parameters
    ----------
    solution : of `calibrate` on the same observations.
    axial_mm : standard deviation that a direction's shift along the axis is believed to have; 0 = there is none. A
    shift looks much like an offset wherever the pipe is: without such a belief the two run away against each other.

    Returns
    -------
    The solution, its errors those that remain, and the corrections (K, 2, directions): half-angle rad, shift mm.

    Notes
    -----
    Alzuhiri 2022, §4.3.3, Alg. 3, with three differences: the error is in the image, where the noise is; offsets are
    believed to be of one size, found from the data, so a direction that few frames saw stays near its cone (ridge, in
    closed form); and the cones are those that fit best with the offsets there, for lumps must not lean a cone.
    """
    corrections = np.zeros((len(solution.rings), 2, directions))
    for _ in range(ROUNDS):
        solution = calibrate(seen, solution.radius_mm, start=solution, corrections=corrections, directions=directions)
        more, explained = _offsets(seen, solution, directions, axial_mm)
        corrections += more
        solution = replace(solution, error_px=solution.error_px - explained)
        if np.percentile(np.abs(explained), 99) < STRAIGHT_PX:
            break
    return solution, corrections


def _offsets(seen: Observations, solution: Solution, directions: int, axial_mm: float) -> tuple[FloatArray, FloatArray]:
    """(K, 2, directions) rad, mm, and (N,) px that they explain."""
    rings = len(solution.rings)
    turn = azimuths(seen, solution.rings, solution.poses, solution.radius_mm) * directions
    out, explained = np.zeros((rings, 2, directions)), np.zeros(len(seen))
    for k in range(rings):
        mine = np.flatnonzero((seen.ring == k) & np.isfinite(solution.error_px))
        if not len(mine):
            continue
        node = np.minimum(turn[mine].astype(np.int64), directions - 1)
        part = turn[mine] - node
        slope, push = solution.slope_px[mine], solution.axial_px[mine]
        rows = [(node, slope * (1 - part)), ((node + 1) % directions, slope * part)]
        if axial_mm > 0:
            rows += [(directions + at, push / slope * a) for at, a in rows]
        size = directions * (2 if axial_mm > 0 else 1)
        weight = solution.weight[mine] / (solution.sigma_px[k] ** 2 * solution.correlation_length[k])
        place = np.tile(np.arange(len(mine)), len(rows))
        jacobian = sparse.csr_array(
            (np.concatenate([a for _, a in rows]), (place, np.concatenate([at for at, _ in rows]))),
            shape=(len(mine), size),
        )
        weighted = jacobian.T.multiply(weight)
        matrix, right = (weighted @ jacobian).tocsc(), weighted @ solution.error_px[mine]
        usual = prior_sigma(matrix[:directions, :directions].sum(axis=0), right[:directions])
        belief = np.repeat([usual, axial_mm or 1.0], directions)[:size]
        found = sparse.linalg.spsolve(matrix + sparse.diags_array(1.0 / belief**2, format="csc"), right)
        out[k].flat[:size] = found
        explained[mine] = jacobian @ found
    return out, explained


def ring_corrections(corrections: FloatArray) -> tuple[RingCorrection, ...]:
    """The same as a calibration keeps it, (K, 2, n), to a millionth of a radian and of a millimetre."""
    return tuple(
        RingCorrection(
            tuple(round(float(v), 7) for v in ring[0]),
            tuple(round(float(v), 6) for v in ring[1]) if ring[1].any() else None,
        )
        for ring in corrections
    )
