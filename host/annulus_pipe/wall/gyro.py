"""How far a gyroscope says the head turned from frame to frame, weighed against what the rings say of a bend.

Assumed: what it says of a frame is the turn about the camera's axes, plus a bias that stays, plus noise, of which
nobody knows more than that both are small. Rings tell the head's lean against the centre line in each frame; so the
turn from one head to the next is the centre line's, their leans taken off. One update of the line's numbers, with the
bias: linear, heads following, their leans' errors tied from link to link, a banded system as long as the scan.

What carries it: the noise is what is left, summed over runs of links, by a line that may go its own way within ten
standard deviations of the rings'. That one's distance from theirs must then be explained by both; a gyroscope that has
sign, axis or scale wrong stands far off, or scatters, and is left out.
When it breaks: a bias that changes exactly where the bend begins is a part of the bend; its prior bounds that.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import composed, rotations
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import linalg, transform
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.adjustment import (
    APART_LEAST_MM,
    HEAD,
    HEAD_STEPS,
    PIECE,
    PIECE_STEPS,
    START,
    Adjusted,
    AdjustmentState,
    Sightings,
    adjust,
)

# Rotation vectors in degrees about the camera's axes, by frame: turned since the frame before; of every frame of the
# scan, NaN where not known.
Turns = Mapping[int, tuple[float, float, float]]
NO_TURNS: Turns = MappingProxyType({})
GYRO = "gyro"  # kind of finding

BIAS_SIGMA = math.radians(0.1)  # a frame
NOISE_LEAST = math.radians(0.005)  # a frame: no gyroscope is so good
LINKS_LEAST = 8  # to tell noise from bias and bend: two of the shorter runs
RUNS = (4, 16)  # links in a row whose sums say what the noise is
LIMITED = 3.0  # times its noise: what a link that is farther off has no more say than
ROUNDS = 8
DISAGREES = math.radians(0.4)  # a frame; eight times a cheap gyroscope's noise
APART_MOST = 3.0  # standard deviations: lines farther apart are not measurements of one
LOOSE = 10.0  # times what the rings allow: how far the gyroscope's own line may be from theirs


@dataclass(frozen=True, slots=True, eq=False)
class _Links:
    """From one head to another whose turn is known: heads a and b (E,), frames between them (E,), turns (E, 3, 3)."""

    a: NDArray[np.intp]
    b: NDArray[np.intp]
    frames: FloatArray
    turned: FloatArray


def weigh(
    seen: Sightings, found: Adjusted, frame: NDArray[np.intp], turns: Turns
) -> tuple[Adjusted, tuple[Finding, ...]]:
    """The adjusted line and heads, moved to where rings and gyroscope together say they are; as they were, and a
    finding, where the two disagree too far to be measurements of one thing. frame : (F,) number of each head's."""
    links = _links(frame, turns)
    if links is None:
        return found, ()
    difference = _difference(seen, found.state, links)
    by_line = _by_line(seen, found, links, difference)
    tie = _tie(seen, found, links, difference)
    n = len(found.free)
    design = np.concatenate([-by_line, np.kron(links.frames[:, None], np.eye(3))], axis=1)
    rings = found.covariance
    frames = links.frames[:, None]
    left = difference - frames * np.clip(np.median(difference / frames, axis=0), -BIAS_SIGMA, BIAS_SIGMA)
    # what it scatters about any line near the rings' is its noise; that its own line is another one is not
    for _ in range(ROUNDS):
        noise = _noise(left, links.frames)
        off = left / (LIMITED * noise * np.sqrt(frames))
        band = tie.copy()
        band[-1] += (noise**2 * frames * np.maximum(off**2, 1.0)).ravel()
        counted = linalg.solveh_banded(band, np.column_stack([design, difference.ravel()]))
        normal, right = design.T @ counted[:, :-1], design.T @ counted[:, -1]
        step, covariance = _solved(normal, right, LOOSE**2 * rings)
        left = difference - (design @ step).reshape(-1, 3)
    apart = float(step[:n] @ np.linalg.solve(rings + covariance[:n, :n], step[:n]))
    step, covariance = _solved(normal, right, rings)
    pieces = found.state.pieces.copy()
    pieces.flat[found.free] += step[:n]
    in_order = bool((np.diff(pieces[:, START]) > APART_LEAST_MM).all())
    if noise.max() > DISAGREES or apart > APART_MOST**2 or not in_order:
        return found, (
            Finding(
                GYRO,
                f"gyroscope and rings disagree about how the head turned: by {math.degrees(noise.max()):.2g} degrees a "
                f"frame, {math.sqrt(apart):.1f} standard deviations over the bend. The gyroscope was not used",
            ),
        )
    moved = replace(found.state, pieces=pieces, heads=found.state.heads + found.follow @ step[:n])
    settled = adjust(seen, moved, np.zeros(pieces.shape, np.bool_))
    return replace(settled, free=found.free, covariance=covariance[:n, :n], follow=found.follow), ()


def _solved(normal: FloatArray, right: FloatArray, line: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n + 3,) the line's numbers and the biases, and their covariance; `line` (n, n): the first's, known before."""
    n = len(line)
    known = np.zeros_like(normal)
    known[:n, :n] = np.linalg.inv(line)
    known[n:, n:] = np.eye(3) / BIAS_SIGMA**2
    covariance = np.asarray(np.linalg.inv(known + normal), dtype=np.float64)
    return covariance @ right, covariance


def _links(frame: NDArray[np.intp], turns: Turns) -> _Links | None:
    order = np.argsort(frame)
    numbers = np.array(sorted(turns))
    found = []
    for a, b in pairwise(order):
        between = numbers[np.searchsorted(numbers, frame[a], "right") : np.searchsorted(numbers, frame[b], "right")]
        vectors = np.radians(np.array([turns[int(i)] for i in between]).reshape(-1, 3))
        if len(between) and between[-1] == frame[b] and np.isfinite(vectors).all():
            found.append((a, b, len(between), composed(vectors)))
    if len(found) < LINKS_LEAST:
        return None
    a, b, count, turned = zip(*found, strict=True)
    return _Links(
        np.array(a), np.array(b), np.array(count, np.float64), transform.Rotation.from_rotvec(turned).as_matrix()
    )


def _difference(seen: Sightings, state: AdjustmentState, links: _Links) -> FloatArray:
    """(E, 3) radians that the gyroscope says more than heads and line do, about the camera's axes."""
    heads = state.heads
    to_camera = rotations(heads[:, 0], heads[:, 1], heads[:, 4])
    in_space = state.centreline().frames_at(seen.chainage_mm)[1] @ to_camera.transpose(0, 2, 1)
    turned = in_space[links.a].transpose(0, 2, 1) @ in_space[links.b]
    return np.asarray(transform.Rotation.from_matrix(turned.transpose(0, 2, 1) @ links.turned).as_rotvec())


def _by_line(seen: Sightings, found: Adjusted, links: _Links, difference: FloatArray) -> FloatArray:
    """(3 E, n) what each free number of the line does to the difference, heads following."""
    out = np.empty((difference.size, len(found.free)))
    for j, column in enumerate(found.free):
        step = PIECE_STEPS[column % PIECE]
        pieces = found.state.pieces.copy()
        pieces.flat[column] += step
        moved = replace(found.state, pieces=pieces, heads=found.state.heads + step * found.follow[:, :, j])
        out[:, j] = (_difference(seen, moved, links) - difference).ravel() / step
    return out


def _tie(seen: Sightings, found: Adjusted, links: _Links, difference: FloatArray) -> FloatArray:
    """(6, 3 E) upper band of the differences' covariance from errors of the heads: links that share one are
    neighbours."""
    e = len(difference)
    by_a, by_b = np.zeros((e, 3, HEAD)), np.zeros((e, 3, HEAD))
    for i in (0, 1, 4):
        for by, mine in ((by_a, links.a), (by_b, links.b)):
            # a head is one link's end and the next one's start: one at a time
            for part in (slice(0, None, 2), slice(1, None, 2)):
                heads = found.state.heads.copy()
                heads[mine[part], i] += HEAD_STEPS[i]
                change = (_difference(seen, replace(found.state, heads=heads), links) - difference) / HEAD_STEPS[i]
                by[part, :, i] = change[part]
    cover_a, cover_b = found.head_covariance[links.a], found.head_covariance[links.b]
    block = by_a @ cover_a @ by_a.transpose(0, 2, 1) + by_b @ cover_b @ by_b.transpose(0, 2, 1)
    next_to = by_b[:-1] @ cover_b[:-1] @ by_a[1:].transpose(0, 2, 1)
    next_to *= (links.b[:-1] == links.a[1:])[:, None, None]
    band = np.zeros((6, 3 * e))
    for r in range(3):
        for c in range(3):
            if c >= r:
                band[5 + r - c, c::3] = block[:, r, c]
            band[2 + r - c, 3 + c :: 3] = next_to[:, r, c]
    return band


def _noise(left: FloatArray, frames: FloatArray) -> FloatArray:
    """(3,) radians a frame, of what is left (E, 3): root mean square of the sums of runs of links, the worst of these.

    Noise adds up as a root, a disagreement does not, and of the heads' leans only the first and last remain."""
    worst = np.full(3, NOISE_LEAST)
    for run in RUNS:
        if len(left) >= 2 * run:
            ones = np.ones(run)
            total = np.stack([np.convolve(axis, ones, "valid") for axis in left.T], axis=1)
            scatter = np.mean(total**2 / np.convolve(frames, ones, "valid")[:, None], axis=0)
            worst = np.maximum(worst, np.sqrt(scatter))
    return worst
