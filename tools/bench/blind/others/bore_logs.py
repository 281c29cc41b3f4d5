"""A capacitive head's log through a pipe that sewers cross, by other physics than the twin's.

A sector is an electrode over a boundary: what lies beyond the wall adds by its image charge, (eps - wall) / (eps +
wall) and a term of second order; what lies in layers mixes by its logarithm. It sees along the pipe as an electrode of
finite length with fading ends, and round it as a raised cosine. Soil is a Markov walk along the pipe with sharp layers
(correlation falls by an exponential, not a bell), sand round stones, a trench whose bottom stands in water for a
stretch; sewers have walls of clay or plastic and water to any level. The head sags and is knocked, the cable sticks
and slips, the chip's noise is of first order, what it reads is rounded.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import convolve1d
from scipy.signal import lfilter

STEP_MM, STEP_DEG = 5.0, 6.0
DEPTHS_MM = np.array([0.5, 3.0, 7.0, 14.0, 25.0])
PLASTIC_EPS, WATER_EPS = 2.35, 79.0
PIPE_MM = 44.5
NEAR_FILL = 0.12, 0.88  # of a hole: with less wet wall it is air, with more water


@dataclass(slots=True)
class Sewer:
    """level_mm : of its water over its axis, upwards; wall_mm, wall_eps : its own pipe."""

    at_mm: float
    radius_mm: float
    offset_mm: float
    phi_deg: float
    angle_deg: float
    level_mm: float
    wall_mm: float
    wall_eps: float
    kind: str = ""
    span_mm: tuple[float, float] = (0.0, 0.0)
    change_ff: float = 0.0  # of the sectors' mean over what is beside it


@dataclass(slots=True)
class Tool:
    """What one head is: told on a bench beforehand, but for what it sees with."""

    air_ff: float
    swing_ff: float  # from air to eps 20
    sector_deg: float
    electrode_mm: float
    fading_mm: float
    depth_mm: float
    noise_ff: float
    wander_mm: float
    rate_hz: float
    speed_mm_s: float
    pose: bool
    loss: bool
    coupling_ff: float
    coupling_mm: float


@dataclass(slots=True)
class Drawn:
    tool: Tool
    length_mm: float
    sewers: list[Sewer]
    couplings: list[float]
    stones: list[tuple[float, float, float, float]]  # at, radius, direction in degrees, eps
    soil: str
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    course: tuple[np.ndarray, np.ndarray] = (np.empty(0), np.empty(0))

    def odometer_mm(self, place_mm: float) -> float:
        place, odometer = self.course
        return float(np.interp(place_mm, np.maximum.accumulate(place), odometer))


def draw(rng: np.random.Generator) -> Drawn:
    air = rng.uniform(2500, 7000)
    swing = air * rng.uniform(0.05, 0.085)
    both = rng.random() < 0.5
    tool = Tool(
        air,
        swing,
        rng.uniform(95, 118),
        rng.uniform(40, 65),
        rng.uniform(5, 12),
        rng.uniform(4, 9),
        rng.uniform(0.3, 1.5),
        rng.uniform(0.05, 0.25),
        rng.uniform(25, 60),
        rng.uniform(90, 200),
        both or rng.random() < 0.3,
        both or rng.random() < 0.3,
        swing * rng.uniform(0.28, 0.42),
        rng.uniform(100, 160),
    )
    length = 40_000.0
    places = list(rng.permutation((np.arange(16) + 1.2 + rng.uniform(-0.25, 0.25, 16)) * length / 17.5))
    sewers = []
    for k in range(7):
        radius, clay = float(rng.choice([51.0, 76.0, 101.0, 127.0])), rng.random() < 0.6
        phi = float(rng.uniform(0, 360))
        offset = radius + PIPE_MM + rng.uniform(15, 60) if k >= 5 else rng.uniform(0, radius + 15)
        fill = rng.random()
        level = -2 * radius if fill < 0.5 else 2 * radius if fill < 0.7 else rng.uniform(-0.6, 0.6) * radius
        sewers.append(
            Sewer(
                float(places.pop()),
                radius,
                float(offset),
                phi,
                float(rng.uniform(55, 90)),
                float(level),
                rng.uniform(10, 20) if clay else rng.uniform(3, 8),
                6.5 if clay else 3.2,
            )
        )
    stones = [
        (
            float(places.pop()),
            float(rng.uniform(12, 45)),
            float(rng.uniform(0, 360)),
            float(rng.choice([1.0, 5.5, 5.5])),
        )
        for _ in range(5)
    ]
    return Drawn(tool, length, sewers, [float(places.pop()) for _ in range(2)], stones, "")


def walk(rng: np.random.Generator, count: int, length: float) -> np.ndarray:
    """Of unit variance, its correlation exp(-steps / length)."""
    keep = math.exp(-1 / length)
    return lfilter([math.sqrt(1 - keep * keep)], [1, -keep], rng.standard_normal(count + int(5 * length)))[-count:]


def ground(drawn: Drawn, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """(Z, T) what the wall's surroundings add and lose, as a part of the swing and of the loss in soil of eps 20."""
    z, theta = np.arange(0.0, drawn.length_mm, STEP_MM), np.radians(np.arange(0.0, 360.0, STEP_DEG))
    edges = np.sort(rng.uniform(0, drawn.length_mm, int(rng.integers(1, 4))))
    levels = np.exp(rng.uniform(math.log(4), math.log(28), len(edges) + 1))
    eps = levels[np.searchsorted(edges, z)]
    drawn.soil = "eps " + ", ".join(f"{level:.0f}" for level in levels)
    rough = rng.uniform(0.02, 0.08)
    round_the_pipe = walk(rng, len(z), 400 / STEP_MM)[:, None] * np.cos(theta - rng.uniform(0, 6.28))
    logs = np.log(eps)[:, None] + rough * (walk(rng, len(z), rng.uniform(100, 600) / STEP_MM)[:, None] + round_the_pipe)
    lossy = rng.uniform(0.4, 1.6) * np.exp(logs) / 20.0
    if rng.random() < 0.4:  # the trench's bottom stands in water for some metres
        wet = np.clip(np.minimum(z - rng.uniform(2, 8) * 1e3, rng.uniform(12, 20) * 1e3 - z) / 1500, 0, 1)
        logs += (wet[:, None] * np.clip(np.sin(theta), 0, 1) > 0.5) * (math.log(32) - logs)
        drawn.soil += ", wet below"
    mixed, loss = np.zeros_like(logs), np.zeros_like(logs)
    weight = np.exp(-DEPTHS_MM / drawn.tool.depth_mm) * np.gradient(DEPTHS_MM)
    weight /= weight.sum()
    for depth, part in zip(DEPTHS_MM, weight, strict=True):
        here, gone = logs.copy(), lossy.copy()
        x, y = (PIPE_MM + depth) * np.cos(theta), (PIPE_MM + depth) * np.sin(theta)
        for at, radius, phi, eps_stone in drawn.stones:
            off = PIPE_MM + radius + 1.0
            away2 = (
                (z[:, None] - at) ** 2
                + (x - off * math.cos(math.radians(phi))) ** 2
                + (y - off * math.sin(math.radians(phi))) ** 2
            )
            here[away2 < radius**2] = math.log(eps_stone)
            gone[away2 < radius**2] = 0.0
        for one in drawn.sewers:
            away, up = across(one, z, x, y)
            wall = (away < one.radius_mm + one.wall_mm) & (away >= one.radius_mm)
            wet = (away < one.radius_mm) & (up < one.level_mm)
            dry = (away < one.radius_mm) & (up >= one.level_mm)
            for where, value, loses in ((wall, one.wall_eps, 0.05), (wet, WATER_EPS, 0.12), (dry, 1.0, 0.0)):
                here[where], gone[where] = math.log(value), loses
        mixed += part * here
        loss += part * gone
    image = (np.exp(mixed) - PLASTIC_EPS) / (np.exp(mixed) + PLASTIC_EPS)

    def series(value: np.ndarray | float) -> np.ndarray | float:
        return value + 0.25 * value * value

    low, high = (series((eps - PLASTIC_EPS) / (eps + PLASTIC_EPS)) for eps in (1.0, 20.0))
    added = (series(image) - low) / (high - low)
    for at in drawn.couplings:
        added -= drawn.tool.coupling_ff / drawn.tool.swing_ff * (np.abs(z - at) < 0.5 * drawn.tool.coupling_mm)[:, None]
    for one in drawn.sewers:
        settle(one, z, theta)
    return along(added, drawn.tool), along(loss, drawn.tool)


def across(one: Sewer, z: np.ndarray, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(Z, T) distance from a sewer's axis, and height over it; y is down, as in the log's angles."""
    phi, turn = math.radians(one.phi_deg), math.radians(one.angle_deg)
    to = x * math.cos(phi) + y * math.sin(phi) - one.offset_mm
    side = -x * math.sin(phi) + y * math.cos(phi)
    away = np.hypot((z[:, None] - one.at_mm) * math.sin(turn) - side * math.cos(turn), to)
    up = np.broadcast_to(-(y - one.offset_mm * math.sin(phi)), away.shape)
    return away, up


def settle(one: Sewer, z: np.ndarray, theta: np.ndarray) -> None:
    """What of a sewer the pipe meets: its kind by how much of its own wall is wet, and from where to where."""
    away, up = across(one, z, PIPE_MM * np.cos(theta), PIPE_MM * np.sin(theta))
    hole = away < one.radius_mm
    if not hole.any():
        return
    wet = float((hole & (up < one.level_mm)).sum() / hole.sum())
    one.kind = "air" if wet < NEAR_FILL[0] else "water" if wet > NEAR_FILL[1] else "part"
    seen = np.flatnonzero(hole.any(axis=1))
    one.span_mm = float(z[seen[0]]), float(z[seen[-1]])


def along(values: np.ndarray, tool: Tool) -> np.ndarray:
    """As an electrode sees it that ends softly."""
    reach = np.arange(-30, 31) * STEP_MM
    beyond = np.maximum(np.abs(reach) - 0.5 * tool.electrode_mm, 0.0)
    kernel = np.exp(-beyond / tool.fading_mm)
    return convolve1d(values, kernel / kernel.sum(), axis=0, mode="nearest")


def course(drawn: Drawn, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times, places and the odometer: a cable that sticks and slips, a wheel that slips on what is wet."""
    tool = drawn.tool
    rows = int(1.6 * drawn.length_mm / tool.speed_mm_s * tool.rate_hz)
    speed = tool.speed_mm_s * np.exp(0.3 * walk(rng, rows, 3 * tool.rate_hz))
    speed *= 1 + 0.5 * np.sin(2 * math.pi * np.cumsum(rng.uniform(0.5, 1.5, rows)) / tool.rate_hz / 1.7)
    place = np.cumsum(speed) / tool.rate_hz
    rows = int(np.argmax(place > drawn.length_mm - 50)) or rows
    place = np.minimum(place[:rows], drawn.length_mm - 50)
    slip = np.clip(rng.uniform(-0.004, 0.004) + 0.002 * walk(rng, rows, 10 * tool.rate_hz), -0.02, 0.02)
    odometer = np.cumsum(np.diff(place, prepend=0.0) * (1 + slip))
    drawn.course = place, odometer
    return (np.arange(rows) + 1) / tool.rate_hz, place, np.round(odometer, 0)


def logged(drawn: Drawn, rng: np.random.Generator) -> None:
    """Fills in the columns of the log, and what each sewer changes in it."""
    tool = drawn.tool
    added, loss = ground(drawn, rng)
    time, place, odometer = course(drawn, rng)
    rows = len(time)
    roll = rng.uniform(-180, 180) + 20 * walk(rng, rows, 60 * tool.rate_hz)
    off = np.stack([tool.wander_mm * walk(rng, rows, 1.5 * tool.rate_hz) for _ in range(2)])
    off[1] += rng.uniform(0, 0.4)  # it sags
    warm = rng.uniform(-5, 8) * (1 - np.exp(-time / 300))
    theta = np.arange(0.0, 360.0, STEP_DEG)
    z = np.arange(len(added)) * STEP_MM
    for one in drawn.sewers:
        here = np.abs(z - one.at_mm) < 40
        beside = (np.abs(z - one.at_mm) > 300) & (np.abs(z - one.at_mm) < 600)
        one.change_ff = tool.swing_ff * float(added[here].mean() - np.median(added[beside].mean(axis=1)))
    columns = {"t_s": time, "odometer_mm": odometer}
    for k in range(3):
        look = roll + 120.0 * k
        off_deg = np.abs((theta - look[:, None] + 180) % 360 - 180)
        sees = np.clip((0.62 * tool.sector_deg - off_deg) / (0.24 * tool.sector_deg), 0, 1)
        sees = 0.5 - 0.5 * np.cos(math.pi * sees)
        sees /= sees.sum(axis=1, keepdims=True)
        at = np.interp(time + 0.006 * k, time, place) / STEP_MM
        index = np.clip(at.astype(int), 0, len(added) - 1)
        nearer = off[0] * np.cos(np.radians(look)) + off[1] * np.sin(np.radians(look))
        c = tool.air_ff + tool.swing_ff * np.sum(sees * added[index], axis=1)
        c = c + 0.019 * tool.air_ff * (nearer + 0.11 * nearer**2)
        c = (c + tool.noise_ff * (0.8 * rng.standard_normal(rows) + 0.6 * walk(rng, rows, 6.0))) * (1 + 7e-5 * warm)
        columns[f"c{k + 1}_pf"] = np.round(c / 1000, 5)
        if tool.loss:
            columns[f"loss{k + 1}_ff"] = 30.0 * np.sum(sees * loss[index], axis=1) + rng.normal(0, 1.5, rows)
    columns["cref_pf"] = tool.air_ff / 1000 * (1 + 7e-5 * warm) + rng.normal(0, 3e-4, rows)
    columns["roll_deg"] = roll
    if tool.pose:
        columns |= {"off_x_mm": off[0], "off_y_mm": off[1]}
    drawn.columns = columns
