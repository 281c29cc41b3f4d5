"""The simulated pipe and the sensor head inside it: everything a frame depends on but the light's timing.

A `World` is plain data and a seed. The wall is a radius map r(clock, z) and an albedo map on one grid, both made from
a short list of `Feature`s, so that what the renderer shows and what the score calls true are one and the same.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from annulus.geometry.calibration import Calibration
from annulus.geometry.camera import Camera, Mirror
from annulus.geometry.cone import Cone
from annulus.geometry.pose import Pose
from annulus.numeric.arrays import FloatArray
from annulus.vocabulary import AnnulusError

Response = tuple[tuple[float, float, float], ...]
FeatureKind = Literal["pocket", "bump", "groove", "oval"]
DefectKind = Literal["loss", "bump", "ovality"]
_DEFECT_KIND: Mapping[FeatureKind, DefectKind] = {"pocket": "loss", "groove": "loss", "bump": "bump", "oval": "ovality"}

CLOCKS = 1440  # columns of the wall maps: 0.25 degrees, a third of a millimetre on a 6-inch wall
STEP_Z_MM = 0.4  # rows of the wall maps
AHEAD_MM = 420.0  # wall modelled beyond the last station; past it the pipe is clean
ROLL_WAVE_MM = 150.0  # of the head's roll along the pipe
WAVES = 0.75, 0.45  # of the wobble: the two sinusoids' shares of its amplitude
WHITE = (0.75, 0.77, 0.78)  # albedo of white PVC, red green blue
YELLOW = (0.72, 0.47, 0.06)  # of MDPE gas pipe: blue is absorbed almost wholly
ORANGE = (0.70, 0.22, 0.05)


@dataclass(frozen=True, slots=True)
class Feature:
    """One thing wrong with a wall. Centre, extent and size as a defect list gives them.

    pocket: rectangle of material lost, `depth_mm` deep, walls steep over `edge_mm`. groove: the same all round.
    bump: spherical cap standing `depth_mm` into the pipe, foot `length_mm` across.
    oval: radius changes by +-`depth_mm` as cos 2(clock - clock_deg) over `length_mm`, faded in and out by cosines.
    """

    kind: FeatureKind
    z_mm: float
    length_mm: float
    depth_mm: float
    clock_deg: float = 0.0
    arc_deg: float = 360.0
    edge_mm: float = 0.4

    def deviation(self, clock_deg: FloatArray, z_mm: FloatArray, radius_mm: float) -> FloatArray:
        """Change of the wall's radius in mm (positive = material lost), broadcast over `clock_deg` and `z_mm`."""
        around = np.radians(_wrap(clock_deg - self.clock_deg)) * radius_mm
        along = z_mm - self.z_mm
        if self.kind == "bump":
            foot, height = self.length_mm / 2, self.depth_mm
            ball = (foot * foot + height * height) / (2 * height)
            inside = np.maximum(ball * ball - around * around - along * along, 0.0)
            return np.asarray(-np.maximum(np.sqrt(inside) - (ball - height), 0.0))
        if self.kind == "oval":
            fade = np.clip(2 * np.abs(along) / self.length_mm, 0.0, 1.0)
            swell = np.cos(2 * np.radians(clock_deg - self.clock_deg))
            return np.asarray(self.depth_mm * swell * (0.5 + 0.5 * np.cos(np.pi * fade)))
        within = self.length_mm / 2 - np.abs(along)
        if self.kind == "pocket":
            within = np.minimum(within, math.radians(self.arc_deg) / 2 * radius_mm - np.abs(around))
        return np.asarray(self.depth_mm * np.clip(within / self.edge_mm + 0.5, 0.0, 1.0) + 0.0 * around)

    def edge_distance_mm(self, clock_deg: FloatArray, z_mm: FloatArray, radius_mm: float) -> FloatArray:
        """Distance along the wall (mm) to where this feature's radius jumps; infinite for one that fades.

        Zero where light of the projector, which comes along the pipe, does not reach: the floor behind the near wall,
        the far rim, the lee of a bump. What is seen there is a shadow's edge and not a slit's.
        """
        around = np.abs(np.radians(_wrap(clock_deg - self.clock_deg))) * radius_mm
        along = z_mm - self.z_mm + 0.0 * around
        half = self.length_mm / 2
        if self.kind == "oval":
            return np.full(along.shape, np.inf)
        if self.kind == "bump":
            off_foot = np.hypot(around, along) - half
            return np.where((off_foot < 3.5 * self.depth_mm) & (along > 0), 0.0, np.abs(off_foot))
        over_z = np.abs(along) - half
        over_arc = around - math.radians(self.arc_deg) / 2 * radius_mm if self.kind == "pocket" else over_z - 1e9
        inside = (over_arc < 0) & (over_z < 0)
        outside_mm = np.hypot(np.maximum(over_arc, 0), np.maximum(over_z, 0))
        distance = np.where(inside, -np.maximum(over_arc, over_z), outside_mm)
        lee = np.where(
            inside, along + half < 3 * self.depth_mm, (along > -half - 1) & (along < half + 3 * self.depth_mm)
        )
        return np.where(lee & (over_arc < 2.0), 0.0, distance)

    def as_defect(self, radius_mm: float) -> dict[str, Any]:
        """The row a perfect defect list would hold for this feature (ARCHITECTURE §7); of an oval it is the diameter
        whose departure counts as depth.
        """
        return {
            "kind": _DEFECT_KIND[self.kind],
            "z_mm": self.z_mm,
            "clock_deg": self.clock_deg,
            "clock": clock_text(self.clock_deg),
            "length_mm": self.length_mm,
            "arc_deg": math.degrees(self.length_mm / radius_mm) if self.kind == "bump" else self.arc_deg,
            "depth_mm": 2 * self.depth_mm if self.kind == "oval" else self.depth_mm,
        }


@dataclass(frozen=True, slots=True)
class Projector:
    """The slide: cones of the slits (camera frame), their half-widths and the stripes' colours, inside to outside.

    `margin_deg`: how far the innermost and outermost stripe reach beyond the outer slits. `response`[c] is what the
    red, green and blue pixels see of stripe colour c: filters of slide and sensor overlap.
    """

    cones: tuple[Cone, ...]
    slit_half_deg: tuple[float, ...]
    colours: str = "RRGBGR"
    margin_deg: tuple[float, float] = (2.25, 2.25)
    peak: float = 225.0  # grey levels above black on the outermost stripe, lit for its nominal time
    leak: float = 0.006  # of a stripe's light through a slit
    response: Response = ((1.0, 0.05, 0.04), (0.045, 1.0, 0.05), (0.03, 0.055, 0.75))
    nominal_us: float = 5000.0  # on-time that gives `peak`


@dataclass(frozen=True, slots=True)
class Led:
    """White LEDs round the lens, seen as one point just behind it."""

    behind_mm: float = 4.0
    peak: float = 150.0  # grey levels above black on a white wall 45 mm ahead
    colour: tuple[float, float, float] = (0.96, 1.0, 0.97)
    nominal_us: float = 2500.0


@dataclass(frozen=True, slots=True)
class Optics:
    """Lens blur (sigma, pixels of the full-size camera) and the sensor's noise, in 8-bit grey levels.

    `balance`: white-balance gains red, green, blue, applied to light and noise before the black level is added and
    the pixel is cut off at full scale.
    """

    blur_px: float = 1.1
    black: float = 2.0
    read: float = 1.5
    shot: float = 0.03  # variance per grey level
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)


@dataclass(frozen=True, slots=True)
class Rod:
    """A bar that holds the projector behind the camera, parallel to the optical axis; it shadows what lies past it."""

    x_mm: float
    y_mm: float
    radius_mm: float = 1.0
    z0_mm: float = -56.0
    z1_mm: float = 0.0


@dataclass(frozen=True)
class World:
    """A pipe, a sensor head, and how the head travels. Immutable; equal seeds give equal worlds."""

    camera: Camera
    projector: Projector
    radius_mm: float = 76.2
    features: tuple[Feature, ...] = ()
    rods: tuple[Rod, ...] = ()
    housing_mm: float = 0.0  # radius of the camera's housing, as it sees itself in a mirror
    led: Led = field(default_factory=Led)
    optics: Optics = field(default_factory=Optics)
    albedo: tuple[float, float, float] = WHITE
    texture: bool = True  # stains and a printed line
    wobble_deg: float = 1.2  # amplitude of each of two sinusoids a rotation
    wobble_mm: float = 1.7  # the same for the two shifts
    travel_mm: float = 400.0  # stations 0..travel
    mm_per_count: float = 0.05  # of the cable counter
    seed: int = 1
    roll_deg: float = 0.0  # amplitude; then the head has a sensor that says so

    def __post_init__(self) -> None:
        slits = len(self.projector.cones)
        if len(self.projector.slit_half_deg) != slits or len(self.projector.colours) != slits + 1:
            raise AnnulusError(f"world: {slits} cones need {slits} slit widths and {slits + 1} stripe colours")
        if self.travel_mm <= 0 or self.mm_per_count <= 0:
            raise AnnulusError("world: travel_mm and mm_per_count must be above zero")

    # ---- the wall ------------------------------------------------------------------------------------------------
    def deviation(self, clock_deg: FloatArray, z_mm: FloatArray) -> FloatArray:
        """True r - R in mm at clock angles and stations (broadcast)."""
        clock, z = np.asarray(clock_deg, dtype=np.float64), np.asarray(z_mm, dtype=np.float64)
        total = np.zeros(np.broadcast_shapes(clock.shape, z.shape))
        for feature in self.features:
            total = total + feature.deviation(clock, z, self.radius_mm)
        return total

    @cached_property
    def z_range_mm(self) -> tuple[float, float]:
        """Stretch of wall the maps cover; outside it the pipe is clean."""
        return 0.0, self.travel_mm + AHEAD_MM

    @cached_property
    def radius_map(self) -> NDArray[np.float32]:
        """(rows, CLOCKS) deviation in mm; row i at z = z_range[0] + i STEP_Z_MM, column j at clock j 360/CLOCKS deg."""
        low, high = self.z_range_mm
        rows = round((high - low) / STEP_Z_MM)
        out = np.zeros((rows, CLOCKS), np.float32)
        clock: FloatArray = np.arange(CLOCKS, dtype=np.float64) * (360.0 / CLOCKS)
        for feature in self.features:
            first = max(0, math.floor((feature.z_mm - feature.length_mm / 2 - 2 - low) / STEP_Z_MM))
            last = min(rows, math.ceil((feature.z_mm + feature.length_mm / 2 + 2 - low) / STEP_Z_MM))
            z: FloatArray = low + np.arange(first, last, dtype=np.float64)[:, None] * STEP_Z_MM
            out[first:last] += feature.deviation(clock[None, :], z, self.radius_mm)
        return out

    @cached_property
    def albedo_map(self) -> NDArray[np.uint8]:
        """(rows, CLOCKS, 3) red green blue, 255 = reflects all; same grid as `radius_map`."""
        rows = self.radius_map.shape[0]
        base = np.array(self.albedo, np.float32) * np.float32(255.0)
        out = np.empty((rows, CLOCKS, 3), np.uint8)
        out[:] = base + 0.5
        if self.texture:
            _stain(out, base, np.random.default_rng([self.seed, 0x57A1]))
            _print_line(out)
        return out

    # ---- the head ------------------------------------------------------------------------------------------------
    @cached_property
    def _wobble(self) -> NDArray[np.float64]:
        """(4, 2, 2): per degree of freedom two (wavelength mm, phase)."""
        rng = np.random.default_rng([self.seed, 0x90B])
        wave = np.stack([rng.uniform(55, 85, 4), rng.uniform(24, 38, 4)], axis=1)
        return np.stack([wave, rng.uniform(0, 2 * np.pi, (4, 2))], axis=2)

    def pose(self, z_mm: float) -> Pose:
        """The pipe in the camera frame when the head stands at station `z_mm`."""
        angle = 2 * np.pi * z_mm / self._wobble[:, :, 0] + self._wobble[:, :, 1]
        rx, ry, tx, ty = np.sin(angle) @ np.array(WAVES)
        tilt = math.radians(self.wobble_deg)
        roll = math.radians(self.roll_deg) * math.sin(2 * math.pi * z_mm / ROLL_WAVE_MM) if self.roll_deg else None
        return Pose(tilt * rx, tilt * ry, self.wobble_mm * tx, self.wobble_mm * ty, roll)

    def calibration(self) -> Calibration:
        """What a perfect calibration of this head would hold."""
        return Calibration(self.camera, self.projector.colours, self.projector.cones, self.radius_mm)

    def truth(self) -> dict[str, Any]:
        """The world as JSON-able data, defects as a perfect defect list; written beside a scan."""
        return {
            "format": "annulus-truth/1",
            "seed": self.seed,
            "radius_mm": self.radius_mm,
            "features": [
                {
                    "kind": f.kind, "z_mm": f.z_mm, "length_mm": f.length_mm, "depth_mm": f.depth_mm,
                    "clock_deg": f.clock_deg, "arc_deg": f.arc_deg, "edge_mm": f.edge_mm,
                }
                for f in self.features
            ],
            "defects": [f.as_defect(self.radius_mm) for f in self.features],
            "travel_mm": self.travel_mm,
            "mm_per_count": self.mm_per_count,
            "calibration": self.calibration().to_dict(),
        }  # fmt: skip

    def to_dict(self) -> dict[str, Any]:
        """All of the world as JSON-able data; `from_dict` makes an equal one."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "World":
        """Raises AnnulusError for data that is not a world's."""
        try:
            top = dict(data)
            projector = dict(top["projector"])
            projector["cones"] = tuple(_tupled(Cone, cone) for cone in projector["cones"])
            top["projector"] = _tupled(Projector, projector)
            mirror = top["camera"].get("mirror")
            mirror = None if mirror is None else _tupled(Mirror, mirror)
            top["camera"] = _tupled(Camera, {**top["camera"], "mirror": mirror})
            top["features"] = tuple(Feature(**feature) for feature in top["features"])
            top["rods"] = tuple(Rod(**rod) for rod in top["rods"])
            top["led"], top["optics"] = _tupled(Led, top["led"]), _tupled(Optics, top["optics"])
            return _tupled(cls, top)
        except (KeyError, TypeError, ValueError) as error:
            raise AnnulusError(f"world: not a world's data ({error})") from None

    def scaled(self, width: int) -> "World":
        """The same world through a camera `width` pixels wide that sees the same field; blur shrinks with it."""
        k = width / self.camera.width
        camera = replace(
            self.camera,
            width=width,
            height=round(self.camera.height * k),
            fx=self.camera.fx * k,
            fy=self.camera.fy * k,
            cx=(self.camera.cx + 0.5) * k - 0.5,
            cy=(self.camera.cy + 0.5) * k - 0.5,
        )
        return replace(self, camera=camera, optics=replace(self.optics, blur_px=self.optics.blur_px * k))


def clock_text(clock_deg: float) -> str:
    """Clock position as written in a report: 90 degrees -> "3:00", rounded to five minutes of the dial."""
    minutes = round((clock_deg % 360.0) * 2 / 5) * 5 % 720
    return f"{(minutes // 60) or 12}:{minutes % 60:02d}"


# ---- presets -----------------------------------------------------------------------------------------------------
# Full cone angles, axes and vertices of the source's simulated sensor (Alzuhiri 2022, Table 4.1): refraction in the
# glass gives every ring its own vertex.
_RINGS = (
    (37.893, -0.016, 0.015, 1.106, -1.211, -56.503),
    (42.382, -0.016, 0.014, 1.283, -0.940, -56.490),
    (47.473, -0.017, 0.014, 1.436, -1.065, -55.994),
    (52.829, -0.013, 0.011, 0.785, 0.339, -54.579),
    (57.745, -0.015, 0.011, 0.986, 0.103, -54.244),
)
_SLIT_HALF_DEG = (0.244, 0.217, 0.187, 0.158, 0.132)  # about nine pixels wide on a 6-inch wall, each


def demo_projector() -> Projector:
    """Five slits, R R G B G R, cones as in the source's Table 4.1."""
    cones = tuple(
        Cone(math.radians(theta / 2), (ax, ay, math.sqrt(1 - ax * ax - ay * ay)), (vx, vy, vz))
        for theta, ax, ay, vx, vy, vz in _RINGS
    )
    return Projector(cones, _SLIT_HALF_DEG)


def demo_rods() -> tuple[Rod, ...]:
    """Three bars on a circle of 22 mm."""
    angles = (math.radians(17 + 120 * i) for i in range(3))
    return tuple(Rod(22.0 * math.cos(a), 22.0 * math.sin(a)) for a in angles)


def pinhole_camera() -> Camera:
    """IMX219 at 1664x1232 behind a wide lens without distortion, the source's simulated camera."""
    return Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5)


def fisheye_camera() -> Camera:
    """The same sensor behind a 160-degree lens (Kannala-Brandt)."""
    return Camera("fisheye", 1664, 1232, 545.0, 545.0, 835.0, 612.0, (-0.012, 0.004, -0.0015, 0.0002))


def clean_world(seed: int = 1, camera: Camera | None = None, travel_mm: float = 120.0) -> World:
    """A round, unmarked pipe."""
    return World(
        camera or pinhole_camera(), demo_projector(), rods=demo_rods(), texture=False, travel_mm=travel_mm, seed=seed
    )


# What red, green and blue pixels see of the stripes through cheap filters: the green one lets much blue by.
CONTAMINATED = ((1.0, 0.12, 0.05), (0.10, 1.0, 0.22), (0.04, 0.15, 0.80))


def painted(world: World, albedo: tuple[float, float, float], response: Response | None = None) -> World:
    """The same world in a pipe of another colour (`WHITE`, `YELLOW`, `ORANGE`), seen through other filters if given.

    The projector is as strong as before and the exposure such that the pipe's brightest channel is.
    """
    projector = world.projector if response is None else replace(world.projector, response=response)
    return replace(world, albedo=albedo, projector=projector)


def demo_world(seed: int = 7, travel_mm: float = 330.0) -> World:
    """The demo: a 6-inch white PVC pipe with two pockets, a bump and a short oval stretch.

    All of them lie where every ring passes when the head travels 330 mm or more, whatever the frame rate.
    """
    features = (
        Feature("pocket", z_mm=180.0, length_mm=32.0, depth_mm=4.0, clock_deg=100.0, arc_deg=26.0),
        Feature("bump", z_mm=214.0, length_mm=26.0, depth_mm=4.0, clock_deg=215.0, arc_deg=20.0),
        Feature("pocket", z_mm=246.0, length_mm=12.0, depth_mm=2.0, clock_deg=330.0, arc_deg=80.0),
        Feature("oval", z_mm=332.0, length_mm=84.0, depth_mm=1.5, clock_deg=20.0),
    )
    return World(
        pinhole_camera(), demo_projector(), features=features, rods=demo_rods(), travel_mm=travel_mm, seed=seed
    )


# The small sensor of §3.6 (Fig. 3.13: projector, mirror, camera in a row): seven slits of the nine that three colours
# in pairs allow, 25 mm behind the ball, whose shadow the innermost ring clears.
_SMALL_COLOURS = "RRGBBRBG"
_SMALL_RIMS_DEG = (31.0, 50.0)  # half-angles of the innermost and outermost slit
_SMALL_SLIT_PX = 7.5


def mirror_camera() -> Camera:
    """A narrow lens 45 mm from a ball 20 mm across, which fills nine tenths of the image's height."""
    ball = Mirror((0.25, -0.15, 45.0), 10.0)
    return Camera("mirror", 1664, 1232, 2450.0, 2450.0, 829.0, 618.0, (-0.04, 0.01, 0.0, 0.0), ball)


def mirror_projector() -> Projector:
    """Slits that stand at even distances, and are equally wide, in the mirror's image of a 3-inch pipe."""
    camera, wall_mm, behind_mm = mirror_camera(), 38.1, 25.0
    half = np.radians(np.linspace(_SMALL_RIMS_DEG[0] - 3, _SMALL_RIMS_DEG[1] + 3, 600))
    wall = np.stack([np.full_like(half, wall_mm), 0 * half, wall_mm / np.tan(half) - behind_mm], axis=1)
    away = np.abs(camera.project(wall)[:, 0] - camera.project(np.array([[0.0, 0.0, 30.0]]))[0, 0])
    first, last = np.interp(np.radians(_SMALL_RIMS_DEG), half, away)
    slits = np.linspace(first, last, len(_SMALL_COLOURS) - 1)
    angles = np.interp(slits, away, half)
    halves = np.interp(slits + _SMALL_SLIT_PX / 2, away, half) - angles
    cones = tuple(  # glass moves each ring's vertex by its own amount, less the wider it is
        Cone(
            float(t),
            (-0.008, 0.006, math.sqrt(1 - 1e-4)),
            (0.35 - 0.1 * i, -0.3 + 0.08 * i, -behind_mm - 0.6 + 0.2 * i),
        )
        for i, t in enumerate(angles)
    )
    return Projector(cones, tuple(float(h) for h in np.degrees(halves)), _SMALL_COLOURS, peak=180.0)


def mirror_world(seed: int = 5, radius_mm: float = 38.1, travel_mm: float = 160.0) -> World:
    """The small sensor in a 3-inch pipe (or another, of 2 to 4 inches) with a pocket, a bump and a groove."""
    features = (
        Feature("pocket", z_mm=80.0, length_mm=16.0, depth_mm=2.0, clock_deg=100.0, arc_deg=40.0),
        Feature("bump", z_mm=112.0, length_mm=12.0, depth_mm=2.0, clock_deg=215.0, arc_deg=18.0),
        Feature("groove", z_mm=144.0, length_mm=8.0, depth_mm=1.0),
    )
    return World(
        mirror_camera(), mirror_projector(), radius_mm, features, (Rod(-9.0, -12.0, 0.6, -25.0, 45.0),), 7.0,
        Led(behind_mm=25.0, peak=40.0), wobble_deg=1.0, wobble_mm=0.02 * radius_mm, travel_mm=travel_mm, seed=seed,
    )  # fmt: skip


WORLDS: Mapping[str, Callable[[int], World]] = {
    "demo": demo_world,
    "clean": clean_world,
    "mirror-2inch": lambda seed: mirror_world(seed, 25.4),
    "mirror-3inch": mirror_world,
    "mirror-4inch": lambda seed: mirror_world(seed, 50.8),
}


Record = TypeVar("Record")


def _tupled(kind: type[Record], data: Mapping[str, Any]) -> Record:
    """A dataclass from JSON-able data: lists become tuples, however deep."""
    return kind(**{key: _frozen(value) for key, value in data.items()})


def _frozen(value: object) -> object:
    return tuple(_frozen(v) for v in value) if isinstance(value, list | tuple) else value


# ---- paint -------------------------------------------------------------------------------------------------------
def _stain(albedo: NDArray[np.uint8], base: NDArray[np.float32], rng: np.random.Generator) -> None:
    """A dull invert where silt has lain and brown water stains with soft rims, painted in place."""
    rows = albedo.shape[0]
    clock = np.arange(CLOCKS, dtype=np.float64) * (360.0 / CLOCKS)
    silt = np.exp(-((_wrap(clock - 180.0) / 20.0) ** 2))
    albedo[:] = base * (1.0 - silt[:, None] * np.array([0.10, 0.15, 0.22])) + 0.5
    reach = 90  # of a stain and its rim, map cells each way
    for _ in range(round(rows * STEP_Z_MM / 28.0)):
        row, column = int(rng.integers(rows)), int(rng.integers(CLOCKS))
        size = (int(rng.integers(10, 60)), int(rng.integers(8, 36)))
        patch = np.zeros((2 * reach + 1, 2 * reach + 1), np.uint8)
        cv2.ellipse(patch, (reach, reach), size, float(rng.uniform(0, 180)), 0, 360, 255, -1)
        soft = cv2.GaussianBlur(patch, (0, 0), 7.0).astype(np.float32) / np.float32(255.0)
        strength = np.array([0.14, 0.26, 0.42], np.float32) * np.float32(rng.uniform(0.5, 1.0))
        low, high = max(0, row - reach), min(rows, row + reach + 1)
        around = np.arange(column - reach, column + reach + 1) % CLOCKS
        shade = soft[low - row + reach : high - row + reach, :, None] * strength
        albedo[low:high, around] = albedo[low:high, around] * (1.0 - shade) + 0.5


def _print_line(albedo: NDArray[np.uint8]) -> None:
    """The maker's print along the pipe at two o'clock, in place. Text runs along z."""
    rows = albedo.shape[0]
    tall = 16  # columns of 0.25 degrees: letters 5 mm high
    ink = np.zeros((tall + 12, rows), np.uint8)
    for x in range(20, rows, 560):
        cv2.putText(ink, "ANNULUS TWIN PVC-U 160 SDR 17", (x, tall + 4), cv2.FONT_HERSHEY_SIMPLEX, 0.62, 255, 2)
    soft = cv2.GaussianBlur(ink, (0, 0), 0.8).astype(np.float32).T / np.float32(255.0)
    first = round(60.0 * CLOCKS / 360.0)
    part = albedo[:, first : first + soft.shape[1]]
    part[:] = part * (1.0 - 0.5 * soft[:, :, None]) + 0.5


def _wrap(degrees: FloatArray) -> FloatArray:
    return np.asarray((degrees + 180.0) % 360.0 - 180.0)
