"""Two wall maps of one pipe with truth, drawn from a seed: what a year, a cable and another head change, and worse.

A pipe is texture (smooth over `texture_mm`), slowly turning ovality, beads every few metres and defects with flat or
round floors. A survey of it is rows at places that a cable of another scale counts, with slips, a rolling head that
sits off centre and shakes, noise, and places it did not see.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d, map_coordinates

from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.numeric.arrays import FloatArray

FINE_MM = 1.0  # of the drawn texture, along; round it is a degree


@dataclass(frozen=True)
class Scene:
    """What a pair is like. Lengths in mm, angles in degrees."""

    length_mm: float = 12_000.0
    step_mm: float = 4.0
    step_second_mm: float = 4.0
    columns: int = 360
    columns_second: int = 360
    radius_mm: float = 76.2
    radius_second_mm: float = 76.2
    texture_rms_mm: float = 0.04
    texture_mm: float = 14.0  # sigma of its smoothing
    ovality_mm: float = 0.6
    noise_mm: float = 0.05
    zero_mm: float = -150.0
    scale: float = 0.003
    slips_mm: tuple[float, ...] = (18.0, -12.0, 6.0)
    roll_deg: float = 15.0
    drift_deg: float = 1.5  # of the roll, over metres
    jumps_deg: tuple[float, ...] = ()
    imu_noise_deg: float = 0.3
    imu_bias_deg: float = 1.5
    imu: bool = True
    unchanged: int = 8
    grown: int = 6
    new: int = 3
    gone: int = 0
    exponents: tuple[float, ...] = (2.0, 3.0, 4.0, 6.0)  # of a defect's floor: 2 a bowl, 6 a pan
    spots: int = 300  # unseen
    gaps_mm: tuple[float, ...] = ()  # lengths never seen by the second
    least_growth_mm: float = 0.25
    crowded: bool = False  # defects may lie on each other
    oval_growth: float = 0.0  # of ovality, as a part of it: over all of the pipe


@dataclass(frozen=True)
class Defect:
    z_mm: float
    clock_deg: float
    length_mm: float
    arc_deg: float
    depth_mm: float
    growth_mm: float
    exponent: float

    def at(self, z: FloatArray, clock: FloatArray, year: int) -> FloatArray:
        off = (clock - self.clock_deg + 180) % 360 - 180
        shape = (
            np.abs(2 * (z - self.z_mm) / self.length_mm) ** self.exponent
            + np.abs(2 * off / self.arc_deg) ** self.exponent
        )
        return (self.depth_mm + year * self.growth_mm) * np.exp(-shape)


@dataclass(frozen=True)
class Pair:
    first: WallMap
    second: WallMap
    z_of_second: FloatArray
    roll_of_second: FloatArray
    defects: tuple[Defect, ...]
    oval_mm: FloatArray  # (n, 2): places on the first, and by how much ovality's wave grew there
    joints: FloatArray = field(default_factory=lambda: np.empty(0))

    @property
    def grown(self) -> list[Defect]:
        return [one for one in self.defects if one.growth_mm]

    def oval_growth_mm(self, z: FloatArray) -> FloatArray:
        return np.interp(z, self.oval_mm[:, 0], self.oval_mm[:, 1])

    def seen(self, one: Defect) -> float:
        """The share of a defect that both saw: of the one that saw less."""
        shares = []
        turned = np.zeros_like(self.first.z_mm)
        for wall, z, roll in (
            (self.first, self.first.z_mm, turned),
            (self.second, self.z_of_second, self.roll_of_second),
        ):
            clock = wall.column_deg * np.arange(wall.deviation_mm.shape[1])[None] + roll[:, None]
            shape = replace(one, depth_mm=1.0).at(z[:, None], clock, 0)
            whole = self._whole(one) / (wall.step_mm * wall.column_deg)
            shares.append(float(shape[np.isfinite(wall.deviation_mm)].sum() / whole))
        return min(shares)

    @staticmethod
    def _whole(one: Defect) -> float:
        """mm times degrees: of a defect of depth 1."""
        z, clock = one.z_mm + np.arange(-120.0, 120.0, 0.5), one.clock_deg + np.arange(-90.0, 90.0, 0.5)
        return float(replace(one, depth_mm=1.0).at(z[:, None], clock[None], 0).sum() * 0.25)


def draw(seed: int, scene: Scene | None = None, pipe: int | None = None) -> Pair:
    """The pair of a seed. pipe : another seed for the pipe of the second survey, to draw two that do not belong."""
    scene = scene or Scene()
    rng = np.random.default_rng(seed)
    wall = _pipe(np.random.default_rng(rng.integers(1 << 62)), scene)
    other = wall if pipe is None else _pipe(np.random.default_rng(pipe), scene)
    z1 = np.arange(0.0, scene.length_mm, scene.step_mm)
    first = _surveyed(rng, scene, wall, z1, np.zeros_like(z1), 0, scene.step_mm, scene.columns, scene.radius_mm)
    count = round(scene.length_mm / scene.step_second_mm)
    z2 = scene.zero_mm + np.arange(count) * scene.step_second_mm * (1 + scene.scale)
    for slip, row in zip(scene.slips_mm, rng.integers(20, count - 20, len(scene.slips_mm)), strict=True):
        z2[row:] += slip
    metres = np.arange(count) * scene.step_second_mm / 1000
    smooth = gaussian_filter1d(rng.standard_normal(count), 600 / scene.step_second_mm, mode="wrap")
    roll = scene.roll_deg + scene.drift_deg * smooth / max(smooth.std(), 1e-9)
    for jump, row in zip(scene.jumps_deg, rng.integers(20, count - 20, len(scene.jumps_deg)), strict=True):
        roll[row:] += jump
    second = _surveyed(
        rng, scene, other, z2, roll, 1, scene.step_second_mm, scene.columns_second, scene.radius_second_mm
    )
    for gap in scene.gaps_mm:
        at = rng.integers(0, count - int(gap / scene.step_second_mm))
        second.deviation_mm[at : at + int(gap / scene.step_second_mm)] = np.nan
    drift = scene.imu_bias_deg * (1 + 0.1 * np.sin(metres / 3))
    imu = roll + drift + scene.imu_noise_deg * rng.standard_normal(count) if scene.imu else np.full(count, np.nan)
    second = WallMap(
        second.name, second.deviation_mm, 0.0, scene.step_second_mm, scene.radius_second_mm, imu, second.first_deg
    )
    places = wall.begin_mm + FINE_MM * np.arange(len(wall.oval))
    oval = np.stack([places, scene.oval_growth * np.abs(wall.oval)], axis=1)
    return Pair(first, second, z2, roll, wall.defects, oval, wall.joints)


@dataclass(frozen=True)
class _Pipe:
    texture: FloatArray
    oval: FloatArray  # complex, per mm
    joints: FloatArray
    heights: FloatArray
    defects: tuple[Defect, ...]
    begin_mm: float
    oval_growth: float

    def deviation(self, z: FloatArray, clock: FloatArray, year: int) -> FloatArray:
        """(Z, A) mm at z (Z, 1) and clock (Z, A)."""
        row = (z - self.begin_mm) / FINE_MM
        rows, columns = np.broadcast_arrays(row, clock % 360)
        out = map_coordinates(self.texture, [rows, columns], order=1, mode="grid-wrap")
        oval = np.interp(row[:, 0], np.arange(len(self.oval)), self.oval.real) + 1j * np.interp(
            row[:, 0], np.arange(len(self.oval)), self.oval.imag
        )
        out += (1 + year * self.oval_growth) * (oval[:, None] * np.exp(2j * np.radians(clock))).real
        for joint, height in zip(self.joints, self.heights, strict=True):
            out -= height * np.exp(-(((z - joint) / 4.5) ** 2)) * (1 + 0.1 * np.cos(np.radians(clock - 40)))
        for one in self.defects:
            near = np.abs(z[:, 0] - one.z_mm) < 1.5 * one.length_mm
            out[near] += one.at(z[near], clock[near], year)
        return out


def _pipe(rng: np.random.Generator, scene: Scene) -> _Pipe:
    begin, end = -1500.0, scene.length_mm + 2500.0
    fine = round((end - begin) / FINE_MM)
    texture = np.zeros((fine, 360))
    if scene.texture_rms_mm:
        texture = gaussian_filter(
            rng.standard_normal((fine, 360)).astype(np.float32), (scene.texture_mm / FINE_MM, 4.0), mode="wrap"
        )
        texture *= scene.texture_rms_mm / texture.std()
    wave = gaussian_filter1d(rng.standard_normal((2, fine)), 600 / FINE_MM, mode="wrap", axis=1)
    wave *= scene.ovality_mm / max(float(wave.std()), 1e-12)
    way = np.exp(2j * rng.uniform(0, np.pi))
    oval = (wave[0] + 0.2j * wave[1]) * way
    joints = np.arange(rng.uniform(500, 5500), scene.length_mm, 5877.0)
    kinds = ["grown"] * scene.grown + ["unchanged"] * scene.unchanged + ["new"] * scene.new + ["gone"] * scene.gone
    defects: list[Defect] = []
    while len(defects) < len(kinds):
        kind = kinds[len(defects)]
        sign = 1.0 if rng.random() < 0.7 else -1.0
        depth = sign * rng.uniform(0.5, 2.5)
        growth = sign * float(rng.choice([scene.least_growth_mm, 0.5, 1.0]))
        if kind == "unchanged":
            growth = 0.0
        elif kind == "new":
            depth, growth = 0.0, sign * rng.uniform(0.5, 1.2)
        elif kind == "gone":
            growth = -depth
        one = Defect(
            rng.uniform(300, scene.length_mm - 300),
            rng.uniform(0, 360),
            rng.uniform(18, 80),
            rng.uniform(9, 40),
            depth,
            growth,
            float(rng.choice(scene.exponents)),
        )
        if scene.crowded or all(abs(one.z_mm - other.z_mm) > 90 or _apart(one, other) > 50 for other in defects):
            defects.append(one)
    return _Pipe(texture, oval, joints, rng.uniform(1.0, 2.0, len(joints)), tuple(defects), begin, scene.oval_growth)


def _apart(one: Defect, other: Defect) -> float:
    return abs((one.clock_deg - other.clock_deg + 180) % 360 - 180)


def _surveyed(
    rng: np.random.Generator,
    scene: Scene,
    wall: _Pipe,
    z: FloatArray,
    roll: FloatArray,
    year: int,
    step: float,
    columns: int,
    radius: float,
) -> WallMap:
    own = np.arange(columns) * 360.0 / columns
    out = wall.deviation(z[:, None], own[None] + roll[:, None], year) + scene.radius_mm - radius
    travelled = np.arange(len(z)) * step
    out += 0.03 * np.sin(2 * np.pi * travelled / 310 + rng.uniform(0, 6))[:, None]
    centre = 0.08 * np.exp(1j * (2 * np.pi * travelled / 5600 + rng.uniform(0, 6)))
    out += (centre[:, None] * np.exp(1j * np.radians(own))).real
    out += scene.noise_mm * rng.standard_normal(out.shape)
    column = int(rng.integers(columns))
    out[:, np.arange(column, column + max(columns // 72, 1)) % columns] = np.nan
    for _ in range(scene.spots):
        i, c = int(rng.integers(len(z))), int(rng.integers(columns))
        out[i : i + int(rng.integers(2, 12)), np.arange(c, c + int(rng.integers(2, 8))) % columns] = np.nan
    imu = 0.3 * rng.standard_normal(len(z)) if scene.imu else np.full(len(z), np.nan)
    name = ("first", "second")[year]
    return WallMap(name, out.astype(np.float32), 0.0, step, radius, imu)
