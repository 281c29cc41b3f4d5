"""The source's own phase shifting (Alzuhiri 2022, §6.2, 6.3, 6.7), as a baseline and for what needs no more.

`four_step` is Eq. 6.5 and 6.17 to 6.19 for steps of a quarter period. `least_squares` is Eq. 6.9 to 6.14 for any known
phase steps: with those of the reference plane it is the "direct formulation", whose error oscillates along the surface
(Figure 6.4 b), for the true steps depend on height. `iterated` is its optimisation: theta = K s / (distance to the
surface), found again from each height until both agree.
"""

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray

ROUNDS_MAX = 100
STILL = 1e-12  # of the distance, where rounds end


def four_step(frames: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """(4, ...) grey levels, a quarter period between them -> phase (rad, -pi..pi), DC, AC as the source's rms, and
    their ratio. I_n = DC + a cos(phase + n pi / 2): the sine is I4 - I2 (6.5 says I2 - I4 and means phase - n pi /
    2)."""
    i1, i2, i3, i4 = frames
    dc = frames.mean(axis=0)  # Eq. 6.17
    ac = np.hypot(i3 - i1, i4 - i2) / np.sqrt(8.0)  # Eq. 6.18
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.arctan2(i4 - i2, i1 - i3), dc, ac, ac / dc  # Eq. 6.5; 6.19


def least_squares(frames: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N, P) grey levels and phase steps (N,) or (N, P), rad -> phase (-pi..pi), DC and amplitude (sqrt(2) AC), (P,).

    Rows [1, cos theta, -sin theta] on [DC, a cos phase, a sin phase], by normal equations (6.13)."""
    theta = np.broadcast_to(theta.reshape(len(theta), -1), frames.shape)
    rows = np.stack([np.ones_like(theta), np.cos(theta), -np.sin(theta)], axis=-1)  # Eq. 6.9
    normal = np.einsum("npi,npj->pij", rows, rows)
    dc, even, odd = np.linalg.solve(normal, np.einsum("npi,np->pi", rows, frames)[..., None])[..., 0].T  # Eq. 6.13
    return np.arctan2(odd, even), dc, np.hypot(even, odd)  # Eq. 6.14


def direct(
    frames: FloatArray, moved: FloatArray, reference: FloatArray, rate: float, baseline: float, distance: float
) -> FloatArray:
    """(P,) heights with the steps of the reference plane. frames : (N, P). moved : (N,). reference : (P,) rad, phase of
    each point on the plane. rate : rad per unit of the tangent. Height unit as distance and baseline; see `height`."""
    phase = least_squares(frames, rate * moved / distance)[0]
    return height(_wrapped(phase - reference), rate, baseline, distance)


def iterated(
    frames: FloatArray, moved: FloatArray, reference: FloatArray, rate: float, baseline: float, distance: float
) -> FloatArray:
    """(P,) heights, the steps found again from each height until both agree, the order kept by the last one."""
    h = direct(frames, moved, reference, rate, baseline, distance)
    for _ in range(ROUNDS_MAX):
        predicted = rate * baseline * h / (distance * (distance - h))
        phase = least_squares(frames, rate * moved[:, None] / (distance - h))[0] - reference
        phase = predicted + _wrapped(phase - predicted)
        new = height(phase, rate, baseline, distance)
        if not (np.abs(new - h) > STILL * distance).any():
            return new
        h = new
    return h


def height(phase: FloatArray, rate: float, baseline: float, distance: float) -> FloatArray:
    """Heights of phases over those of the plane (rad): rate baseline (1 / (distance - h) - 1 / distance), solved for h.
    To first order Eq. 6.15, K = distance^2 / (rate baseline)."""
    turned = phase * distance / (rate * baseline)
    return np.asarray(distance * turned / (1.0 + turned))


def _wrapped(phase: FloatArray) -> FloatArray:
    return np.asarray(np.remainder(phase + np.pi, 2 * np.pi) - np.pi)
