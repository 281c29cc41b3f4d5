"""Profiles of a pipe given as a radius function of clock angle and distance: rings cast, shadows kept, noise seeded."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.profile import Profile

RADIUS_MM = 76.2
THETA_FULL_DEG = (37.9, 42.4, 47.5, 52.8, 57.7)
VERTEX_Z_MM = -56.0
NOISE_MM = (0.12, 0.06, 0.04, 0.03, 0.02)

CALIBRATION = Calibration(
    Camera("pinhole", 416, 308, 117.5, 117.5, 207.5, 153.5),
    "RRGBGR",
    tuple(Cone(float(np.radians(t / 2)), (0.0, 0.0, 1.0), (0.0, 0.0, VERTEX_Z_MM)) for t in THETA_FULL_DEG),
    RADIUS_MM,
)
SHADOW_RATIO = 1 / np.tan(np.radians(THETA_FULL_DEG[0] / 2))

RadiusMap = Callable[[np.ndarray, np.ndarray], np.ndarray]  # (clock degrees, z mm) -> mm


def turn(a: np.ndarray, b: float) -> np.ndarray:
    return (a - b + 180) % 360 - 180


def round_pipe(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.full(np.broadcast(clock, z).shape, RADIUS_MM)


def pocket(inner: RadiusMap, clock_deg: float, half_deg: float, z0: float, z1: float, depth: float) -> RadiusMap:
    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        inside = (np.abs(turn(clock, clock_deg)) < half_deg) & (z > z0) & (z < z1)
        return inner(clock, z) + depth * inside

    return radius


def bump(inner: RadiusMap, clock_deg: float, z_mm: float, foot_mm: float, height: float) -> RadiusMap:
    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        away = np.hypot(np.radians(turn(clock, clock_deg)) * RADIUS_MM, z - z_mm) / foot_mm
        return inner(clock, z) - height * np.where(away < 1, np.cos(away * np.pi / 2) ** 2, 0.0)

    return radius


def opening(
    inner: RadiusMap, clock_deg: float, z_mm: float, inner_d: float, outer_d: float = 0.0, stands: float = 0.0
) -> RadiusMap:
    """A bore at right angles to the pipe; its rim, cut square, reaches `stands` into it."""

    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        side, along = np.radians(turn(clock, clock_deg)), z - z_mm
        near, half = np.cos(side) > 0.5, inner_d / 2
        wall = inner(clock, z)
        top = (RADIUS_MM - stands) / np.maximum(np.cos(side), 0.2) if outer_d else wall
        away = np.hypot(top * np.sin(side), along)
        face = np.sqrt(np.maximum(half**2 - along**2, 0.0)) / np.maximum(np.abs(np.sin(side)), 1e-9)
        rim = np.where(near & (away >= half) & (away <= outer_d / 2), np.minimum(wall, top), wall)
        return np.where(near & (away < half), np.minimum(np.maximum(face, top), RADIUS_MM + 60.0), rim)

    return radius


def oval(inner: RadiusMap, clock_deg: float, part: float, z0: float = -1e9, z1: float = 1e9) -> RadiusMap:
    def radius(clock: np.ndarray, z: np.ndarray) -> np.ndarray:
        fade = np.clip(np.minimum(z - z0, z1 - z) / 20.0, 0.0, 1.0)
        return inner(clock, z) + part * RADIUS_MM * fade * np.cos(2 * np.radians(clock - clock_deg))

    return radius


def scan(
    radius: RadiusMap,
    *,
    z_mm: Sequence[float] | None = None,
    rods_deg: Sequence[float] = (107.0, 227.0, 347.0),
    noise: float = 1.0,
    gross: float = 0.0,
    directions: int = 720,
    seed: int = 5,
    steep: bool = False,
) -> list[Profile]:
    """Profiles of a centred sensor at the stations (50 frames 2.4 mm apart, every fifth left to the LED).

    steep : walls may stand upright: light is followed to the hundredth of a millimetre.
    """
    stations = [2.4 * i for i in range(50) if i % 5 != 4] if z_mm is None else z_mm
    return list(_cast(radius, tuple(stations), tuple(rods_deg), noise, gross, directions, seed, steep))


@lru_cache(maxsize=16)
def _cast(
    radius: RadiusMap,
    stations: tuple[float, ...],
    rods_deg: tuple[float, ...],
    noise: float,
    gross: float,
    directions: int,
    seed: int,
    steep: bool,
) -> tuple[Profile, ...]:
    rng = np.random.default_rng(seed)
    clock = (np.arange(directions) + 0.5) * 360.0 / directions
    lit = (
        np.all([np.abs(turn(clock, rod)) > 4.0 for rod in rods_deg], axis=0) if rods_deg else np.ones(len(clock), bool)
    )
    rho = np.arange(RADIUS_MM - 9.0, RADIUS_MM + 9.0, 1.0)[:, None]
    out = []
    for frame, z0 in enumerate(stations):
        points, ring, direction = [], [], []
        for i, full in enumerate(THETA_FULL_DEG):
            z = VERTEX_Z_MM + rho / np.tan(np.radians(full / 2))
            gap = rho - radius(clock[None], z + z0)
            first = np.argmax(gap >= 0, axis=0)
            columns = np.arange(len(clock))
            g0, g1 = gap[first - 1, columns], gap[first, columns]
            r = rho[first - 1, 0] + 1.0 * g0 / (g0 - g1)
            if steep:
                low, high = rho[first - 1, 0], rho[first, 0]
                for _ in range(7):
                    middle = 0.5 * (low + high)
                    beyond = middle >= radius(clock, VERTEX_Z_MM + middle / np.tan(np.radians(full / 2)) + z0)
                    low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
                r = 0.5 * (low + high)
            z_hit = VERTEX_Z_MM + r / np.tan(np.radians(full / 2))
            way = np.linspace(0.8, 0.985, 14)[:, None]  # the camera's line of sight, at the origin, must stay inside
            open_way = (way * r < radius(clock[None], way * z_hit + z0)).all(axis=0)
            ok = lit & open_way & (g1 >= 0)
            r = r + noise * rng.normal(0, NOISE_MM[i], len(r))
            wild = rng.random(len(r)) < gross
            r = np.where(wild, r + rng.uniform(-15, 15, len(r)), r)
            t = np.radians(clock)
            points.append(np.stack([r * np.sin(t), -r * np.cos(t), z_hit + z0], axis=1)[ok])
            ring.append(np.full(int(ok.sum()), i))
            direction.append(columns[ok])
        stacked = np.concatenate(points).astype(np.float32)
        colour = np.full((len(stacked), 3), 200, dtype=np.uint8)
        out.append(
            Profile(
                frame,
                z0,
                Pose(),
                stacked,
                colour,
                np.concatenate(ring).astype(np.uint8),
                np.concatenate(direction).astype(np.uint16),
                0.05,
            )
        )
    return tuple(out)
