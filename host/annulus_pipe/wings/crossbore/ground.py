"""A capacitive head's log through a buried pipe that sewers cross, with truth: the twin's pipe of `annulus bore`.

A sector reads how its surroundings' permittivity weighs over the wall it looks at, within some millimetres of the wall
and over its own length; what it reads saturates with permittivity. Time passes: speed wanders, the odometer has steps
and slips, sectors are read one after the other, rows are lost, the chip drifts with its temperature, the head wanders
off the axis and rolls. Drawn apart from the detector, and simpler than a field: no edges of electrodes, no water table.
"""

import gzip
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.controller import TICK_S
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.twin.cable import Cable
from annulus_pipe.twin.image_sensor import HostClock
from annulus_pipe.twin.sensors import LATE_NS, Steady
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.measure.grid import Log

PIPE_MM = 44.5  # outer radius of the pipe
AIR_FF = 4575.0  # of a sector in a pipe in air
SWING_FF, HALF_EPS = 330.0, 3.0  # what soil adds: SWING (eps - 1) / (eps + HALF)
DEPTHS_MM, WEIGHTS = np.array([1.0, 4.0, 9.0, 16.0]), np.array([0.4, 0.3, 0.2, 0.1])
ALONG_MM = 27.0  # standard deviation of what a sector sees along the pipe
SECTOR_DEG, MUX_S, RATE_HZ = 110.0, 0.006, 40.0
LIFT_FF, LIFT_MM = 375.0, 4.43
WATER_EPS, WATER_LOSS_FF = 80.0, 10.0
COUPLING_FF, COUPLING_MM = 113.0, 115.0
STEP_MM, STEP_DEG = 4.0, 5.0
ROOM_M = 0.7  # that two things along a pipe are apart, at least
SOILS = (15.0, 4.0, 22.0)  # relative permittivities


@dataclass(frozen=True, slots=True)
class Bore:
    """A sewer: its middle along the pipe, radius, how far its axis passes the pipe's and towards where, crossing angle.

    fill : air, water, or part (water up to the pipe's own axis).
    """

    at_mm: float
    radius_mm: float
    offset_mm: float = 0.0
    phi_deg: float = 90.0
    angle_deg: float = 75.0
    fill: str = "air"


@dataclass(frozen=True, slots=True)
class Ground:
    """What a pipe lies in: soils one after the other, how uneven, and what else is there. Lengths in mm."""

    length_mm: float = 20_000.0
    soils: tuple[float, ...] = (15.0,)  # relative permittivity, each as long as the others
    uneven: float = 0.03  # of a soil's permittivity, over some decimetres
    bores: tuple[Bore, ...] = ()
    couplings_mm: tuple[float, ...] = ()
    beads_mm: tuple[float, ...] = ()
    voids: tuple[tuple[float, float, float], ...] = ()  # at, radius, direction in degrees
    wander_mm: float = 0.15  # of the head off the axis
    pose: bool = False
    loss: bool = False

    @classmethod
    def along(cls, length_mm: float, seed: int) -> "Ground":
        """The ground around a pipe of that length, with as many sewers as there is room for."""
        return some_ground(length_mm, seed, bores=int((length_mm / 1000 / ROOM_M - 5) / 2), near=0)

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> "Ground":
        """The ground again from what `dataclasses.asdict` made of one."""
        columns: dict[str, Any] = {name: tuple(v) if isinstance(v, list | tuple) else v for name, v in data.items()}
        columns["bores"] = tuple(Bore(**one) for one in columns["bores"])
        columns["voids"] = tuple(tuple(one) for one in columns["voids"])
        return cls(**columns)

    def sensors(self, world: World, cable: Cable, clock: HostClock, start_tick: int, seed: int) -> Sequence[Any]:
        """The capacitive sectors of a head in a pipe that lies in this ground."""
        return (Capacitance(self, world, cable, clock, start_tick, seed),)

    def eps_at(self, place_mm: float) -> float:
        """The soil's permittivity, its unevenness left out."""
        each = self.length_mm / len(self.soils)
        return self.soils[min(int(place_mm / each), len(self.soils) - 1)]


@dataclass(frozen=True, slots=True, eq=False)
class Drawn:
    """columns : of a log, (N,) each, NaN where a reading failed; those of `record.bore_log`."""

    ground: Ground
    columns: dict[str, FloatArray]
    _course: tuple[FloatArray, FloatArray]

    def rows(self) -> Log:
        """The columns as a detector takes them."""
        c = self.columns
        loss = np.stack([c[f"loss{k}_ff"] for k in (1, 2, 3)], axis=1) if "loss1_ff" in c else None
        off = np.stack([c["off_x_mm"], c["off_y_mm"]], axis=1) if "off_x_mm" in c else None
        three = np.stack([c[f"c{k}_pf"] for k in (1, 2, 3)], axis=1)
        return Log(c["t_s"], c["odometer_mm"], three, c["cref_pf"], c["roll_deg"], loss, off)

    def odometer_mm(self, place_mm: float) -> float:
        """What the odometer read when the head was first at this place."""
        place, odometer = self._course
        first = np.maximum.accumulate(place)
        return float(np.interp(place_mm, first, odometer))

    def truth(self) -> dict[str, Any]:
        """Bores and near misses in the form of the logs of other programs: what a scorer reads. Never a detector's."""
        bores, near = [], []
        for one in self.ground.bores:
            clear = one.offset_mm - one.radius_mm - PIPE_MM
            if clear > 0:
                near.append({"odometer_mm": self.odometer_mm(one.at_mm), "clear_mm": clear, "phi_deg": one.phi_deg})
                continue
            half = _half_length(one)
            odo = [self.odometer_mm(one.at_mm + way * half) for way in (-1, 1)]
            bores.append(
                {
                    "kind": one.fill,
                    "odo0_mm": odo[0],
                    "odo1_mm": odo[1],
                    "radius_mm": one.radius_mm,
                    "offset_mm": one.offset_mm,
                    "phi_deg": one.phi_deg,
                    "soil_eps": self.ground.eps_at(one.at_mm),
                }
            )
        return {"scene": {"length_m": self.ground.length_mm / 1000}, "bores": bores, "near": near}


def _half_length(bore: Bore) -> float:
    """Half of the stretch along which a sewer touches the pipe, mm."""
    z, theta = np.arange(-500.0, 500.0, 2.0), np.radians(np.arange(0.0, 360.0, 5.0))
    here = _inside(replace(bore, at_mm=0.0), z, PIPE_MM * np.cos(theta), PIPE_MM * np.sin(theta))
    inside = np.flatnonzero(here.any(axis=1))
    return 0.5 * float(np.ptp(z[inside])) if len(inside) else 1.0


class Capacitance(Steady):
    """Three capacitive sectors and a reference, through the wall of a pipe in the ground: see `ground`.

    The ground lies along the world's pipe; the head's place, roll and offset are the world's, and so is its speed.
    """

    name = "capacitance"
    RATE_HZ = 40.0
    NOISE_FF, LOSS_FF = 0.6, 1.5  # rms

    def __init__(
        self, ground: Ground, world: World, cable: Cable, clock: HostClock, start_tick: int = 0, seed: int = 0
    ) -> None:
        self._buried = Buried(ground, seed)
        self._world, self._cable, self._clock, self._seed = world, cable, clock, seed
        self._start, self._taken = start_tick, 0

    def _at(self, tick: int, index: int) -> Sample:
        rng = np.random.default_rng([self._seed, 7, index])
        values: dict[str, float] = {}
        for k in range(3):  # one after the other
            z_mm = self._cable.z_mm(tick + round(MUX_S * k / TICK_S))
            pose = self._world.pose(z_mm)
            off = pose.to_pipe(np.zeros((1, 3)))[0, :2]
            roll = 0.0 if pose.roll is None else math.degrees(pose.roll)
            c, loss = self._buried.sees(z_mm, roll + 120.0 * k, (float(off[0]), float(off[1])))
            values[f"c{k + 1}_pf"] = (c + self.NOISE_FF * rng.standard_normal()) / 1000
            values[f"loss{k + 1}_ff"] = loss + self.LOSS_FF * rng.standard_normal()
        values["cref_pf"] = 4.697 + 3e-4 * rng.standard_normal()
        units = {name: "pF" if name.endswith("_pf") else "fF" for name in values}
        host_ns = self._clock.ns(tick) + int(rng.integers(LATE_NS))
        return Sample(self.name, host_ns, {name: float(value) for name, value in values.items()}, units)


def some_ground(
    length_mm: float,
    seed: int,
    soils: tuple[float, ...] = SOILS,
    bores: int = 3,
    near: int = 2,
    pose: bool = False,
    loss: bool = False,
) -> Ground:
    """A pipe with sewers of all kinds through, half into and beside it, couplings, beads and voids between."""
    rng = np.random.default_rng(seed)
    count = bores + near
    places = (np.arange(2 * count + 4) + 1 + rng.uniform(-0.2, 0.2, 2 * count + 4)) * length_mm / (2 * count + 5)
    order = list(rng.permutation(places))
    sewers = []
    for k in range(count):
        radius, phi = float(rng.choice([51.0, 76.0, 101.0])), float(rng.uniform(0, 360))
        fill = str(rng.choice(["air", "water", "part"], p=[0.5, 0.3, 0.2]))
        offset = 0.0 if rng.random() < 0.3 else float(rng.uniform(0.0, radius + 15.0))
        if k >= bores:
            offset, fill = radius + PIPE_MM + float(rng.uniform(15.0, 80.0)), "air"
        sewers.append(Bore(float(order.pop()), radius, offset, phi, float(rng.uniform(58, 90)), fill))
    voids = tuple((float(order.pop()), float(rng.uniform(10, 28)), float(rng.uniform(0, 360))) for _ in range(count))
    couplings, beads = tuple(float(order.pop()) for _ in range(2)), tuple(float(order.pop()) for _ in range(2))
    return Ground(
        length_mm, soils, bores=tuple(sewers), couplings_mm=couplings, beads_mm=beads, voids=voids, pose=pose, loss=loss
    )


def log(ground: Ground, seed: int) -> Drawn:
    """The log of one passage through the ground."""
    rng = np.random.default_rng(seed)
    z = np.arange(0.0, ground.length_mm, STEP_MM)
    theta = np.arange(0.0, 360.0, STEP_DEG)
    level, loss = _round_the_pipe(ground, z, np.radians(theta), rng)
    time, place, odometer = _course(ground, rng)
    rows = len(time)
    roll = 10.0 + np.cumsum(rng.normal(0, 0.15, rows))
    off = np.stack([_wander(rng, rows, ground.wander_mm), 0.2 + _wander(rng, rows, ground.wander_mm)])
    kelvin = 6.0 * (1 - np.exp(-time / 260.0))
    speed = np.gradient(place, time)
    columns: dict[str, FloatArray] = {"t_s": time, "odometer_mm": odometer}
    losses: dict[str, FloatArray] = {}
    failed = rng.random(rows) < 5e-4
    for k in range(3):
        at = place + speed * MUX_S * k
        look = roll + 120.0 * k
        sees = _window(theta, look)
        index = np.clip((at / STEP_MM).astype(int), 0, len(z) - 1)
        towards = off[0] * np.cos(np.radians(look)) + off[1] * np.sin(np.radians(look))
        lift = LIFT_FF * np.expm1(towards / LIFT_MM)
        c = AIR_FF + np.sum(sees * level[index], axis=1) + lift
        c += 60.0 * sum(np.exp(-0.5 * ((at - bead) / 3.0) ** 2) for bead in ground.beads_mm)
        c += rng.normal(0, 0.6, rows) + np.where(rng.random(rows) < 2e-4, rng.normal(0, 40.0, rows), 0.0)
        c *= 1 + 8e-5 * kelvin
        columns[f"c{k + 1}_pf"] = np.where(failed, np.nan, c / 1000)
        losses[f"loss{k + 1}_ff"] = np.sum(sees * loss[index], axis=1) + rng.normal(0, 1.5, rows)
    columns["cref_pf"] = 4.697 * (1 + 8e-5 * kelvin) + rng.normal(0, 3e-4, rows)
    columns["temp_c"], columns["roll_deg"] = 14 + kelvin, roll
    if ground.loss:
        columns |= losses
    if ground.pose:
        columns |= {"off_x_mm": off[0], "off_y_mm": off[1]}
    kept = rng.random(rows) > 5e-4
    return Drawn(ground, {name: column[kept] for name, column in columns.items()}, (place, odometer))


class Buried:
    """The ground round a pipe, as a sector at any place of it reads it."""

    def __init__(self, ground: Ground, seed: int) -> None:
        self._theta = np.arange(0.0, 360.0, STEP_DEG)
        z = np.arange(0.0, ground.length_mm, STEP_MM)
        rng = np.random.default_rng(seed)
        self._level, self._loss = _round_the_pipe(ground, z, np.radians(self._theta), rng)
        self._beads = ground.beads_mm

    def sees(self, z_mm: float, look_deg: float, off_mm: tuple[float, float]) -> tuple[float, float]:
        """Capacitance and loss, fF, of a sector that looks there; off_mm : of the head from the pipe's axis, x, y."""
        i = int(np.clip(z_mm / STEP_MM, 0, len(self._level) - 1))
        sees = _window(self._theta, np.array([look_deg]))[0]
        towards = off_mm[0] * math.cos(math.radians(look_deg)) + off_mm[1] * math.sin(math.radians(look_deg))
        bead = sum(60.0 * math.exp(-0.5 * ((z_mm - at) / 3.0) ** 2) for at in self._beads)
        c = AIR_FF + float(sees @ self._level[i]) + LIFT_FF * math.expm1(towards / LIFT_MM) + bead
        return c, float(sees @ self._loss[i])


def _round_the_pipe(
    ground: Ground, z: FloatArray, theta: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """(Z, T) fF over air, and loss, of the wall's surroundings, blurred along the pipe as a sector sees them."""
    each = ground.length_mm / len(ground.soils)
    eps = np.array(ground.soils)[np.minimum((z / each).astype(int), len(ground.soils) - 1)]
    eps = ndimage.gaussian_filter1d(eps, 200.0 / STEP_MM, mode="nearest")
    soft = ndimage.gaussian_filter(
        rng.standard_normal((len(z), len(theta))), (150.0 / STEP_MM, 6), mode=("nearest", "wrap")
    )
    soil = eps[:, None] * (1 + ground.uneven * soft / soft.std())
    soil_loss = 1.5 * soil
    level, loss = np.zeros_like(soil), np.zeros_like(soil)
    for depth, weight in zip(DEPTHS_MM, WEIGHTS, strict=True):
        here, lossy = soil.copy(), soil_loss.copy()
        x, y = (PIPE_MM + depth) * np.cos(theta), (PIPE_MM + depth) * np.sin(theta)
        for bore in ground.bores:
            inside = _inside(bore, z, x, y)
            wet = np.full(len(theta), bore.fill == "water") | ((bore.fill == "part") & (y > 0))
            here = np.where(inside, np.where(wet, WATER_EPS, 1.0), here)
            lossy = np.where(inside, np.where(wet, WATER_LOSS_FF, 0.0), lossy)
        for at, radius, phi in ground.voids:
            off = PIPE_MM + 0.5 * radius
            away = np.sqrt(
                (z[:, None] - at) ** 2
                + (x - off * math.cos(math.radians(phi))) ** 2
                + (y - off * math.sin(math.radians(phi))) ** 2
            )
            here = np.where(away < radius, 1.0, here)
        level += weight * SWING_FF * (here - 1) / (here + HALF_EPS)
        loss += weight * lossy
    for at in ground.couplings_mm:
        level -= COUPLING_FF * (np.abs(z - at) < 0.5 * COUPLING_MM)[:, None]
    blur = ALONG_MM / STEP_MM
    return ndimage.gaussian_filter1d(level, blur, axis=0), ndimage.gaussian_filter1d(loss, blur, axis=0)


def _inside(bore: Bore, z: FloatArray, x: FloatArray, y: FloatArray) -> np.ndarray:
    """(Z, T) within the sewer: a cylinder whose axis passes the pipe's at `offset`, at right angles to that way."""
    phi, turn = math.radians(bore.phi_deg), math.radians(bore.angle_deg)
    to, side = x * math.cos(phi) + y * math.sin(phi), -x * math.sin(phi) + y * math.cos(phi)
    # Along its axis nothing changes: what is left of (z, side) is the part across it.
    across = (z[:, None] - bore.at_mm) * math.sin(turn) - side * math.cos(turn)
    return np.asarray(across**2 + (to - bore.offset_mm) ** 2 < bore.radius_mm**2)


def _window(theta: FloatArray, look_deg: FloatArray) -> FloatArray:
    """(N, T) what a sector that looks there sees of the circumference; its sides are soft, its sum one."""
    off = np.abs((theta - look_deg[:, None] + 180) % 360 - 180)
    soft = np.clip((0.5 * SECTOR_DEG + 7.5 - off) / 15.0, 0, 1)
    return np.asarray(soft / soft.sum(axis=1, keepdims=True))


def _course(ground: Ground, rng: np.random.Generator) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Times, true places and the odometer's: uneven speed, now and then backwards, steps of 1 mm, a scale, slips."""
    rows = int(ground.length_mm / 150.0 * RATE_HZ * 1.3)
    speed = 150.0 + 45.0 * _wander(rng, rows, 1.0)
    back = rng.integers(0, rows, max(1, rows // 4000))
    for start in back:
        speed[start : start + 40] = -40.0
    place = np.cumsum(speed) / RATE_HZ
    rows = int(np.argmax(place > ground.length_mm - 5)) or rows
    place = np.clip(place[:rows], 0, ground.length_mm - 5)
    slips = np.cumsum(np.where(rng.random(rows) < 3e-4, rng.uniform(2, 8, rows), 0.0))
    return np.arange(1, rows + 1) / RATE_HZ, place, np.floor(1.002 * place + slips)


def _wander(rng: np.random.Generator, rows: int, size: float) -> FloatArray:
    """(rows,) about nought, smooth over a few seconds, of this standard deviation."""
    slow = ndimage.gaussian_filter1d(rng.standard_normal(rows + 400), 60.0)[200:-200]
    return np.asarray(size * slow / slow.std())


def write(drawn: Drawn, path: Path) -> Path:
    """The log as CSV (gzipped where its name ends so), its truth beside it as NAME.truth.json; that path."""
    names = list(drawn.columns)
    places = {"t_s": 3, "odometer_mm": 1, "temp_c": 2, "roll_deg": 1}
    lines = [",".join(names)]
    for row in zip(*(drawn.columns[name] for name in names), strict=True):
        cells = ("" if math.isnan(v) else f"{v:.{places.get(n, 5)}f}" for n, v in zip(names, row, strict=True))
        lines.append(",".join(cells))
    text = "\n".join(lines).encode() + b"\n"
    truth = path.with_name(path.name.removesuffix(".gz").removesuffix(".csv") + ".truth.json")
    try:
        path.write_bytes(gzip.compress(text, mtime=0) if path.suffix == ".gz" else text)
        truth.write_text(json.dumps(drawn.truth(), indent=1) + "\n")
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror})") from None
    return truth


def simulate_log(
    path: Path, length_m: float, seed: int, soils: tuple[float, ...], bores: int, near: int, pose: bool, loss: bool
) -> Path:
    """The log of one passage through some ground, and its truth beside it; that path."""
    room = length_m / (2 * (bores + near) + 5)
    if room < ROOM_M:
        raise AnnulusError(
            f"{bores + near} sewers in {length_m:g} m: {1000 * room:.0f} mm each, expected at least {1000 * ROOM_M:g}"
        )
    return write(log(some_ground(1000 * length_m, seed, soils, bores, near, pose, loss), seed), path)
