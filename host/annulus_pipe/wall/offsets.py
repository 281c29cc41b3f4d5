"""How far each ring lies off the wall that all rings of a scan share, whatever the cause.

A spot of the wall is seen by one ring after the other as the head goes by, from a different distance each time. So the
wall, the heads and the rings' own offsets come apart: one robust least squares of all three. What all rings are off
alike cannot be told from a wider pipe, unless a section of the pipe is of known size.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.late import linalg, sparse
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.wall.profile import Profile

SECTORS = 24  # of a ring's turn, an observation each ..
SECTOR_POINTS = 5  # .. that has so many points at least
NODE_OF_RADIUS = 0.2  # of the radius, along the pipe, from one node of the wall to the next
WAVES = 3  # round the pipe, that the wall has at each node
WALL_PART = 0.05  # of the radius: how far the wall may be from where it is taken to be
LEAN = 0.1  # radians, and of the radius: how far heads may be, likewise
BLOCK = 4  # observations beside one another, whose mean scatters by more than theirs do: sectors share pixels
NOISE_LEAST_MM = 0.004
LOOSE = 2.5  # times the usual residual: from there on an observation counts less, a defect's hardly at all
ROUNDS = 6
# Of the radius, from one end of a scan to the other, beforehand: 3 K of a plastic lens.
SCAN_DRIFT = 1e-3
TERMS = 5  # of a ring's offset: even; one wave and two round the head, cosine and sine


@dataclass(frozen=True, slots=True, eq=False)
class RingObservations:
    """(N,): head, ring, point in its camera's frame (N, 3) mm; each head's pose and station."""

    head: NDArray[np.intp]
    ring: NDArray[np.intp]
    points: FloatArray
    poses: tuple[Pose, ...]
    z_mm: FloatArray

    def in_pipe(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm, of points (N, 3) in the heads' camera frames."""
        turns = np.array([pose.rotation for pose in self.poses])[self.head]
        shifts = np.array([pose.translation for pose in self.poses])[self.head]
        out = np.einsum("nij,ni->nj", turns, points - shifts)
        out[:, 2] += self.z_mm[self.head]
        return np.asarray(out)

    @property
    def round_head(self) -> FloatArray:
        """(N, TERMS) of each observation: what the terms of its ring's offset count there. Round the pipe's axis, as
        the head is rolled: what goes with a lean or a shift is too little to be told from how edges are drawn."""
        x, y, _ = self.in_pipe(self.points).T
        roll = np.array([pose.roll or 0.0 for pose in self.poses])[self.head]
        return _waves(np.arctan2(y, x) - roll, 2)


@dataclass(frozen=True, slots=True)
class KnownSection:
    """A stretch whose radius is known: mm along the pipe, mm, standard deviation."""

    from_mm: float
    to_mm: float
    radius_mm: float
    sigma_mm: float


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """mm (K, TERMS) outwards, and their covariance (K TERMS, K TERMS). weight (N,) of the observations, 1 / mm^2.
    noise_mm : of one observation. per_mm : by how much more all of them stand out, the head a mm farther on than at
    `middle_mm`. sections_mm, uneven_mm (S,): radius of each
    section with the calibration as it is, and the standard deviation of its rows. bent_mm : how far the
    wall's middle winds about a straight line (standard deviation)."""

    mm: FloatArray
    covariance: FloatArray
    weight: FloatArray
    noise_mm: float
    middle_mm: float
    per_mm: float = 0.0
    per_mm_sigma: float = 0.0
    sections_mm: FloatArray = field(default_factory=lambda: np.zeros(0))
    uneven_mm: FloatArray = field(default_factory=lambda: np.zeros(0))
    bent_mm: float = 0.0

    def at(self, z_mm: float) -> FloatArray:
        """(K, TERMS), the head at a station."""
        out = self.mm.copy()
        out[:, 0] += (z_mm - self.middle_mm) * self.per_mm
        return out


def observations(profiles: Sequence[Profile]) -> RingObservations:
    """The middle one of each sector's points. profiles : with poses and points."""
    head, ring, points = [], [], []
    for number, profile in enumerate(profiles):
        assert profile.pose is not None
        x, y, _ = profile.points_mm.astype(np.float64).T
        sector = np.floor((np.arctan2(y, x) / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp) % SECTORS
        key = profile.ring.astype(np.intp) * SECTORS + sector
        order = np.lexsort((np.hypot(x, y), key))
        start = np.flatnonzero(np.append(True, np.diff(key[order]) != 0))
        count = np.diff(np.append(start, len(key)))
        middle = order[(start + count // 2)[count >= SECTOR_POINTS]]
        head.append(np.full(len(middle), number, np.intp))
        ring.append(profile.ring[middle].astype(np.intp))
        points.append(profile.pose.to_camera(profile.points_mm[middle].astype(np.float64), profile.z_mm))
    poses = tuple(profile.pose for profile in profiles if profile.pose is not None)
    z_mm = np.array([profile.z_mm for profile in profiles])
    return RingObservations(np.concatenate(head), np.concatenate(ring), np.concatenate(points), poses, z_mm)


def ring_offsets(
    seen: RingObservations, rings: int, radius_mm: float, sections: Sequence[KnownSection] = (), held: bool = True
) -> Offsets:
    """radius_mm : of the pipe, roughly. sections : of which something was seen. With two of them offsets may change
    evenly from one to the other. held : to their radii; else they are only read.

    Notes
    -----
    Least squares of r - R = W + w(z, clock) + b(ring, turn) - (head's lean and shift): w even between nodes, five waves
    round; all of them free but for bounds far beyond what is real. W is the whole wall's: without it a hundred nodes'
    bounds would hold their mean, and what a pipe of two sizes departs from R be the rings'. Cauchy's weights, scale
    from the median residual.
    """
    x, y, z = seen.in_pipe(seen.points).T
    radius, clock = np.hypot(x, y), np.arctan2(y, x)
    rows, heads = np.arange(len(radius)), len(seen.poses)
    at = (z - z.min()) / (NODE_OF_RADIUS * radius_mm)
    node = np.floor(at).astype(np.intp)
    part = at - node
    used, both = np.unique(np.concatenate([node, node + 1]), return_inverse=True)
    waves, own = _waves(clock, WAVES), seen.round_head
    of_wall, of_ring = waves.shape[1], TERMS
    ahead = z - seen.z_mm[seen.head]
    pull = np.stack([-ahead * y, ahead * x, x, y], axis=1) / radius[:, None]
    first_head = len(used) * of_wall
    first_ring = first_head + 4 * heads
    drifting = first_ring + rings * of_ring
    whole, size = drifting + 1, drifting + 2
    station = seen.z_mm[seen.head]
    middle = 0.5 * float(station.min() + station.max())
    columns = [
        both[: len(node), None] * of_wall + np.arange(of_wall),
        both[len(node) :, None] * of_wall + np.arange(of_wall),
        first_head + 4 * seen.head[:, None] + np.arange(4),
        first_ring + of_ring * seen.ring[:, None] + np.arange(of_ring),
        np.full((len(rows), 1), drifting),
        np.full((len(rows), 1), whole),
    ]
    values = [
        (1 - part)[:, None] * waves,
        part[:, None] * waves,
        pull,
        own,
        (station - middle)[:, None] * float(held and len(sections) > 1),
        np.ones((len(rows), 1)),
    ]
    column, value = np.concatenate(columns, axis=1), np.concatenate(values, axis=1)
    design = sparse.csr_matrix((value.ravel(), (np.repeat(rows, column.shape[1]), column.ravel())), (len(rows), size))
    loose = np.empty(size)
    loose[:first_head] = WALL_PART * radius_mm
    loose[first_head:first_ring] = np.tile([LEAN, LEAN, LEAN * radius_mm, LEAN * radius_mm], heads)
    loose[first_ring:] = WALL_PART * radius_mm
    span = max(float(np.ptp(seen.z_mm)), radius_mm)
    loose[drifting] = SCAN_DRIFT * radius_mm / span  # mm a mm
    loose[whole] = radius_mm
    known = [_section((z >= one.from_mm) & (z <= one.to_mm), both, part, of_wall, size) for one in sections]
    answer, excess = np.zeros(size), radius - radius_mm
    noise, alike = np.inf, 1.0
    for _ in range(ROUNDS):
        residual = excess - design @ answer
        noise = max(SIGMA_OF_MAD * float(np.median(np.abs(residual))), NOISE_LEAST_MM)
        weight = 1.0 / (1.0 + (residual / (LOOSE * noise)) ** 2) / (alike * noise**2)
        weighted = design.multiply(weight[:, None]).tocsr()
        normal = np.asarray((weighted.T @ design).todense())
        right = np.asarray(weighted.T @ excess)
        normal[np.diag_indices(size)] += 1.0 / loose**2
        for section, row in zip(sections if held else (), known if held else (), strict=True):
            normal += np.outer(row, row) / section.sigma_mm**2
            right += row * (section.radius_mm - radius_mm) / section.sigma_mm**2
        answer = linalg.solve(normal, right, assume_a="pos")
        alike = _alike(seen, clock, np.clip(residual, -LOOSE * noise, LOOSE * noise))
    mine = slice(first_ring, drifting)
    inverse = linalg.inv(normal)
    offsets = answer[mine].reshape(rings, of_ring)
    share = np.bincount(seen.ring, minlength=rings) / len(seen.ring)
    middle_mm = radius_mm + float(share @ offsets[:, 0])
    return Offsets(
        offsets,
        inverse[mine, mine],
        weight,
        noise,
        middle,
        float(answer[drifting]),
        math.sqrt(max(float(inverse[drifting, drifting]), 0.0)),
        np.array([middle_mm + row @ answer for row in known]),
        np.array([_spread(row[:first_head:of_wall], answer[:first_head:of_wall]) for row in known]),
        _winding(used, np.stack([answer[i:first_head:of_wall] for i in (1, 2)], axis=1)),
    )


def _alike(seen: RingObservations, clock: FloatArray, residual: FloatArray) -> float:
    """How many observations say as much as one: those beside one another round a ring, and from frame to frame."""
    sector = np.floor((clock / (2 * np.pi) + 0.5) * SECTORS).astype(np.intp) % SECTORS
    out = 1.0
    for keys in ((sector, seen.ring, seen.head), (seen.head, seen.ring, sector)):
        order = np.lexsort(keys)
        blocks = len(order) // BLOCK
        if blocks > 1:
            means = residual[order[: blocks * BLOCK]].reshape(blocks, BLOCK).mean(axis=1)
            out *= max(float(BLOCK * np.var(means) / max(np.var(residual), 1e-20)), 1.0)
    return out


def _spread(weight: FloatArray, value: FloatArray) -> float:
    """Standard deviation of weighted values; the weights sum to 1."""
    return math.sqrt(max(float(weight @ (value - weight @ value) ** 2), 0.0))


def _winding(nodes: NDArray[np.intp], middle: FloatArray) -> float:
    """Standard deviation, mm, of the wall's middle (N, 2) about a line through it along the nodes."""
    along = np.stack([np.ones(len(nodes)), nodes - nodes.mean()], axis=1)
    left = middle - along @ np.linalg.lstsq(along, middle, rcond=None)[0]
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


def _section(inside: BoolArray, both: NDArray[np.intp], part: FloatArray, waves: int, size: int) -> FloatArray:
    """(size,) what the mean radius of a section is made of: of its wall as it was seen."""
    row = np.zeros(size)
    for node, share in zip(both.reshape(2, -1), (1.0 - part, part), strict=True):
        np.add.at(row, node[inside] * waves, share[inside] / np.count_nonzero(inside))
    row[-1] = 1.0
    return row


def _waves(turn: FloatArray, count: int) -> FloatArray:
    """(N, 1 + 2 count) of turns (N,) radians: 1, cosine and sine of each wave."""
    return np.stack(
        [np.ones_like(turn), *(of(n * turn) for n in range(1, count + 1) for of in (np.cos, np.sin))], axis=1
    )
