"""Pipes with one thing over a limit, or with none, scanned well or badly: drawn from a seed, for what a verdict says.

Of each draw `pipe` has the thing in it and `sound` has not; both are scanned alike. Nothing is rendered: profiles only.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from synthetic_pipe import NOISE_MM, RADIUS_MM, RadiusMap, oval, pocket, round_pipe, scan, turn

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.profile import Profile

LIMITS = {
    "pocket": "[[loss]]\nseverity = 3\ndepth_mm = 2.0\n",
    "dent": "[[loss]]\nseverity = 3\ndepth_mm = 2.0\n",
    "bump": "[[bump]]\nseverity = 3\nheight_mm = 2.0\n",
    "ovality": "[[ovality]]\nseverity = 3\npercent = 3.0\n",
    "narrow": "[[bore]]\nseverity = 3\nsmallest_mm = 144.0\n",
    "joint": "[[joint]]\nseverity = 3\nhilo_mm = 1.5\n",
}  # of a thing's own kind: no other may leave its verdict open
RODS_DEG = (107.0, 227.0, 347.0)
FIRST_MM, LAST_MM = 84.0, 280.0  # of the wall that such a scan sees
KINDS = "pocket", "dent", "bump", "ovality", "narrow", "joint"
WAYS = "well", "well", "every second", "some lost", "arc hidden", "at rest"


@dataclass(frozen=True)
class Drawn:
    """over (clock degrees, z mm) -> bool: where the thing is over its limit, along and round the pipe."""

    kind: str
    way: str
    place: str
    wall: RadiusMap
    sound: RadiusMap
    over: Callable[[np.ndarray, np.ndarray], np.ndarray]
    seed: int

    def pipe(self) -> list[Profile]:
        return _scanned(self.wall, self.way, self.seed)

    def sound_pipe(self) -> list[Profile]:
        return _scanned(self.sound, self.way, self.seed)

    def __str__(self) -> str:
        return f"{self.seed}: {self.kind}, {self.place}, {self.way}"


def draw(seed: int) -> Drawn:
    rng = np.random.default_rng([seed, 77])
    kind, way = KINDS[int(rng.integers(len(KINDS)))], WAYS[int(rng.integers(len(WAYS)))]
    place = ("anywhere", "beside a rod", "at an end", "beside a joint")[int(rng.integers(4))]
    much = float(rng.choice([1.2, 1.5, 2.0, 3.0]))  # of the limit
    clock, z = float(rng.uniform(0, 360)), float(rng.uniform(120, 240))
    half_deg, half_mm = float(rng.uniform(3.5, 16)), float(rng.uniform(4.5, 16))
    base: RadiusMap = round_pipe
    if place == "beside a rod":
        clock = float(rng.choice(RODS_DEG) + rng.uniform(-1, 1) * (4.0 + half_deg))
    elif place == "at an end":
        z = float(rng.choice([FIRST_MM + rng.uniform(0, 1.2) * half_mm, LAST_MM - rng.uniform(0, 1.2) * half_mm]))
    elif place == "beside a joint":
        base = _bead(
            base, z - float(rng.choice([-1, 1])) * (half_mm + float(rng.uniform(0, 8))), float(rng.uniform(1.0, 1.8))
        )
    depth = 2.0 * much
    inside: Callable[[np.ndarray, np.ndarray], np.ndarray]
    if kind == "pocket":
        wall = pocket(base, clock, half_deg, z - half_mm, z + half_mm, depth)
    elif kind in ("dent", "bump"):
        wall = _dent(base, clock, 1.6 * half_deg, z, 1.6 * half_mm, depth if kind == "dent" else -depth)
    elif kind == "ovality":
        long = float(rng.uniform(40, 90))
        z0, z1 = (z - long, z + long) if place != "at an end" else (z - 2 * long, z + long / 2)
        fourth = float(rng.choice([0.0, 0.25])) * float(rng.choice([-1, 1]))
        part = 0.03 * float(rng.choice([1.3, 1.7, 2.5]))
        wall = _oval(base, clock, part, fourth, z0, z1)
    elif kind == "narrow":
        wall = _narrow(base, z, float(rng.uniform(15, 40)), 4.2 + 1.5 * much)
    else:
        wall = _aside(base if place == "beside a joint" else _bead(base, z, 1.5), clock, z, 1.5 * much)
    if kind == "ovality":

        def inside(c: np.ndarray, at: np.ndarray) -> np.ndarray:
            return np.broadcast_to((at > z0 + 20) & (at < z1 - 20), np.broadcast(c, at).shape)
    elif kind == "narrow":

        def inside(c: np.ndarray, at: np.ndarray) -> np.ndarray:
            return np.broadcast_to(round_pipe(c, at) - wall(c, at) > 4.2, np.broadcast(c, at).shape)
    elif kind == "joint":

        def inside(c: np.ndarray, at: np.ndarray) -> np.ndarray:
            return np.broadcast_to(np.abs(at - z) < 4, np.broadcast(c, at).shape)
    else:

        def inside(c: np.ndarray, at: np.ndarray) -> np.ndarray:
            return np.abs(wall(c, at) - base(c, at)) >= 2.0

    return Drawn(kind, way, place, wall, base, inside, seed)


def _dent(inner: RadiusMap, clock: float, half_deg: float, z0: float, half_mm: float, depth: float) -> RadiusMap:
    def radius(c: np.ndarray, z: np.ndarray) -> np.ndarray:
        away = np.hypot(turn(c, clock) / half_deg, (z - z0) / half_mm)
        return inner(c, z) + depth * np.where(away < 1, np.cos(away * np.pi / 2) ** 2, 0.0)

    return radius


def _oval(inner: RadiusMap, clock: float, part: float, fourth: float, z0: float, z1: float) -> RadiusMap:
    two = oval(inner, clock, part, z0, z1)

    def radius(c: np.ndarray, z: np.ndarray) -> np.ndarray:
        fade = np.clip(np.minimum(z - z0, z1 - z) / 20.0, 0.0, 1.0)
        return two(c, z) + fourth * part * RADIUS_MM * fade * np.cos(4 * np.radians(c - clock))

    return radius


def _narrow(inner: RadiusMap, z0: float, half_mm: float, much: float) -> RadiusMap:
    def radius(c: np.ndarray, z: np.ndarray) -> np.ndarray:
        return inner(c, z) - much * np.clip((half_mm - np.abs(z - z0)) / 10.0, 0.0, 1.0)

    return radius


def _aside(inner: RadiusMap, clock: float, z0: float, hilo: float) -> RadiusMap:
    def radius(c: np.ndarray, z: np.ndarray) -> np.ndarray:
        return inner(c, z) + hilo * np.cos(np.radians(c - clock)) * (z > z0)

    return radius


def _bead(inner: RadiusMap, z0: float, height: float) -> RadiusMap:
    def radius(c: np.ndarray, z: np.ndarray) -> np.ndarray:
        u = np.abs(z - z0) / 5.0
        return inner(c, z) - np.where(u < 1, height * np.sqrt(np.maximum(1 - u * u, 0.0)), 0.0)

    return radius


def scanned(
    wall: RadiusMap, *, stations: np.ndarray | None = None, hidden: tuple[float, float] = (0.0, 0.0), seed: int = 5
) -> list[Profile]:
    """Profiles that say their sigma; hidden : middle and half, degrees, of an arc that none of them sees."""
    at = np.array([2.4 * i for i in range(50) if i % 5 != 4]) if stations is None else stations
    profiles = scan(wall, z_mm=at.tolist(), directions=360, seed=seed, rods_deg=RODS_DEG)
    profiles = [replace(one, sigma_mm=np.array(NOISE_MM, np.float32)[one.ring]) for one in profiles]
    middle, half = hidden
    return [one.without(np.abs(turn(_clock(one), middle)) < half, "hidden") for one in profiles]


def resting(
    profiles: list[Profile],
    frames: int,
    *,
    middle_deg: float,
    half_deg: float,
    off_mm: float,
    seed: int = 5,
    shrunk: float = 1.0,
) -> list[Profile]:
    """And then the head rests: so many frames more from where it is, which see an arc only and take it aside for it.
    shrunk : how much narrower they take the pipe for."""
    rng = np.random.default_rng([seed, 79])
    last, t = profiles[-1], np.radians(middle_deg)
    aside = off_mm * np.array([np.sin(t), -np.cos(t)])
    out = list(profiles)
    for k in range(frames):
        x, y = aside + rng.normal(0, 0.1, 2)
        kept = last.without(np.abs(turn(_clock(last), middle_deg)) > half_deg, "hidden")
        points = kept.points_mm * np.array([shrunk, shrunk, 1.0], np.float32) + np.array([x, y, 0.0], np.float32)
        z = last.z_mm + float(rng.normal(0, 0.02))
        pose = Pose(0.0, 0.0, float(x), float(y))
        out.append(replace(kept, frame=last.frame + 1 + k, z_mm=z, points_mm=points, pose=pose))
    return out


def _scanned(wall: RadiusMap, way: str, seed: int) -> list[Profile]:
    rng = np.random.default_rng([seed, 78])
    stations = np.array([2.4 * i for i in range(50) if i % 5 != 4])
    hidden = (0.0, 0.0)
    if way == "every second":
        stations = stations[::2]
    elif way == "some lost":
        stations = stations[np.sort(rng.choice(len(stations), int(rng.integers(16, 30)), replace=False))]
    elif way == "arc hidden":
        hidden = float(rng.uniform(0, 360)), float(rng.choice([12, 20, 35, 50]))
    profiles = scanned(wall, stations=stations, hidden=hidden, seed=seed)
    if way != "at rest":
        return profiles
    middle, half = float(rng.uniform(0, 360)), 180.0 * float(rng.uniform(0.23, 0.41))
    return resting(profiles, 60, middle_deg=middle, half_deg=half, off_mm=float(rng.uniform(1, 5)), seed=seed)


def _clock(one: Profile) -> np.ndarray:
    return np.degrees(np.arctan2(one.points_mm[:, 0], -one.points_mm[:, 1]))
