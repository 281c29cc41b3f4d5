"""Frames of a pipe along a centre line: rings cast, a head that wobbles, each frame posed by itself as a real one."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation
from synthetic_pipe import NOISE_MM, RADIUS_MM, THETA_FULL_DEG, VERTEX_Z_MM

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.pose import fit_pose
from annulus_pipe.wall.profile import Profile

DIRECTIONS = 360
Departure = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (clock degrees, chainage mm) -> mm outwards


def smooth(clock: np.ndarray, chainage: np.ndarray) -> np.ndarray:
    return np.zeros(np.broadcast(clock, chainage).shape)


def bead(at_mm: float, height: float, half_width: float, inner: Departure = smooth) -> Departure:
    """Two rolls side by side, each half an ellipse."""

    def departure(clock: np.ndarray, chainage: np.ndarray) -> np.ndarray:
        u = 2 * np.abs(chainage - at_mm) / half_width - 1
        return inner(clock, chainage) - np.where(u < 1, height * np.sqrt(np.maximum(1 - u * u, 0.0)), 0.0)

    return departure


def pit(clock_deg: float, at_mm: float, depth: float, inner: Departure = smooth) -> Departure:
    def departure(clock: np.ndarray, chainage: np.ndarray) -> np.ndarray:
        inside = (np.abs((clock - clock_deg + 180) % 360 - 180) < 12) & (np.abs(chainage - at_mm) < 10)
        return inner(clock, chainage) + depth * inside

    return departure


def frames(
    line: Centreline,
    chainages: Sequence[float],
    departure: Departure = smooth,
    *,
    roll: bool = False,
    seed: int = 3,
    step_mm: float = 5.0,
) -> list[Profile]:
    """A profile a chainage. roll : the head turns, and a sensor says how far, to a third of a degree. step_mm : along a
    ray; what is shorter may be passed through."""
    return ridden(line, chainages, departure, roll=roll, seed=seed, step_mm=step_mm)[0]


def ridden(
    line: Centreline,
    chainages: Sequence[float],
    departure: Departure = smooth,
    *,
    roll: bool = False,
    seed: int = 3,
    step_mm: float = 5.0,
) -> tuple[list[Profile], list[Pose]]:
    """The same, and where the head really was, of every chainage."""
    rng = np.random.default_rng(seed)
    out, heads = [], []
    for number, chainage in enumerate(chainages):
        lean, shift = rng.normal(0, 0.012, 2), rng.normal(0, 1.2, 2)
        turned = float(rng.normal(0, 0.03)) if roll else None
        head = Pose(*lean, *shift, turned)
        heads.append(head)
        said = None if turned is None else turned + float(rng.normal(0, 0.006))
        points, ring, direction = _rays(line, departure, head, float(chainage), rng, step_mm)
        sigma = np.array(NOISE_MM)[ring].astype(np.float32)
        fit = fit_pose(points, RADIUS_MM, sigma.astype(float), seed=out[-1].pose if out else None)
        if fit is None:  # a frame whose pipe was not found has no points
            continue
        pose = Pose(fit.pose.rx, fit.pose.ry, fit.pose.tx, fit.pose.ty, said)
        in_pipe = pose.to_pipe(points, float(chainage)).astype(np.float32)
        colour = np.full((len(points), 3), 200, np.uint8)
        out.append(
            Profile(
                number,
                float(chainage),
                pose,
                in_pipe,
                colour,
                ring.astype(np.uint8),
                direction.astype(np.uint16),
                fit.robust_sigma_mm,
                sigma_mm=sigma,
            )
        )
    return out, heads


def gyroscope(
    line: Centreline, chainages: Sequence[float], heads: Sequence[Pose], bias_deg: Sequence[float], noise_deg: float
) -> dict[int, tuple[float, float, float]]:
    """What one says of every frame: turned since the one before about the camera's axes, degrees."""
    rng = np.random.default_rng(11)
    along = line.frames_at(np.array(chainages, dtype=float))[1]
    camera = [frame @ head.rotation.T for frame, head in zip(along, heads, strict=True)]
    turns = [np.zeros(3)]
    turns += [np.degrees(Rotation.from_matrix(a.T @ b).as_rotvec()) for a, b in itertools.pairwise(camera)]
    said = np.array(turns) + np.array(bias_deg) + rng.normal(0, noise_deg, (len(turns), 3))
    return {i: (float(x), float(y), float(z)) for i, (x, y, z) in enumerate(said)}


def _rays(
    line: Centreline, departure: Departure, head: Pose, chainage: float, rng: np.random.Generator, step_mm: float = 5.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Camera-frame points of all directions of five rings, those the wall hides from lamp or lens left out."""
    clock = np.radians((np.arange(DIRECTIONS) + 0.5) * 360 / DIRECTIONS)
    half = np.radians(np.array(THETA_FULL_DEG)) / 2
    ways = np.stack(
        [
            np.outer(np.sin(half), np.sin(clock)),
            -np.outer(np.sin(half), np.cos(clock)),
            np.outer(np.cos(half), np.ones(DIRECTIONS)),
        ],
        axis=-1,
    ).reshape(-1, 3)
    ring, direction = np.divmod(np.arange(len(ways)), DIRECTIONS)
    vertex = np.array([0.0, 0.0, VERTEX_Z_MM])

    def outside(points: np.ndarray) -> np.ndarray:
        """mm beyond the wall, of camera-frame points (N, 3)."""
        pipe = line.from_head(head.to_pipe(points), chainage)
        radius = np.hypot(pipe[:, 0], pipe[:, 1])
        t = np.degrees(np.arctan2(pipe[:, 0], -pipe[:, 1])) % 360
        return radius - line.radius_at(pipe[:, 2]) - departure(t, pipe[:, 2])

    steps = np.arange(108.0, 408.0, step_mm)
    first = np.full(len(ways), np.nan)
    for a, b in itertools.pairwise(steps):
        open_ = np.flatnonzero(np.isnan(first))
        if not len(open_):
            break
        first[open_[outside(vertex + b * ways[open_]) >= 0]] = a
    crossed = np.flatnonzero(np.isfinite(first))
    low = first[crossed]
    high = low + step_mm
    for _ in range(14):
        middle = (low + high) / 2
        out = outside(vertex + middle[:, None] * ways[crossed]) >= 0
        low, high = np.where(out, low, middle), np.where(out, middle, high)
    first[crossed] = high
    hit = np.isfinite(first)
    points = vertex + np.where(hit, first, 1.0)[:, None] * ways
    seen = hit.copy()
    for part in np.linspace(0.6, 0.985, 12):  # the lens, at the origin, must see it
        seen &= outside(part * points) < 0
    noise = rng.normal(0, 1, len(ways)) * np.array(NOISE_MM)[ring]
    outward = ways[:, :2] / np.linalg.norm(ways[:, :2], axis=1)[:, None]
    # an error of the slit's place moves a point along its cone: out, and ahead
    points[:, :2] += noise[:, None] * outward
    points[:, 2] += noise / np.tan(half)[ring]
    return points[seen], ring[seen], direction[seen]
