"""The simulated pipe and the sensor head inside it: everything a frame depends on but the light's timing.

A `World` is plain data and a seed. The wall is a radius map r(clock, z) and an albedo map on one grid, both made from
a short list of `WorldFeature`s, so that what the renderer shows and what the score calls true are one and the same.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import STILL, Calibration, HeadCamera, Matrix, Vector
from annulus_pipe.geometry.camera import Camera, Mirror
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.geometry.translucency import Translucency
from annulus_pipe.hooks import merged
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.twin.worlds.course import Course
from annulus_pipe.twin.worlds.features import WorldFeature
from annulus_pipe.twin.worlds.paint import WHITE, print_line, stain
from annulus_pipe.twin.worlds.sensor_head import CameraOptics, Led, Projector, Rod, WingLight
from annulus_pipe.vocabulary import AnnulusError

CLOCKS = 1440  # columns of the wall maps: 0.25 degrees, a third of a millimetre on a 6-inch wall
STEP_Z_MM = 0.4  # rows of the wall maps
AHEAD_MM = 420.0  # wall modelled beyond the last station; past it the pipe is clean
ROLL_WAVE_MM = 150.0  # of the head's roll along the pipe
WAVES = 0.75, 0.45  # of the wobble: the two sinusoids' shares of its amplitude


class WorldGround(Protocol):
    """What a pipe lies in. `sensors` of a head that is pulled through it there, as twin.sensors.HeadSensor."""

    def sensors(self, world: "World", cable: Any, clock: Any, start_tick: int, seed: int) -> Sequence[Any]: ...


@dataclass(frozen=True)
class World:
    """A pipe, a sensor head, and how the head travels. Immutable; equal seeds give equal worlds."""

    camera: Camera
    projector: Projector | WingLight
    radius_mm: float = 76.2
    features: tuple[WorldFeature, ...] = ()
    rods: tuple[Rod, ...] = ()
    housing_mm: float = 0.0  # radius of the camera's housing, as it sees itself in a mirror
    led: Led = field(default_factory=Led)
    optics: CameraOptics = field(default_factory=CameraOptics)
    albedo: tuple[float, float, float] = WHITE
    translucency: Translucency | None = None  # of a wall that light enters; None: it leaves where it came in
    texture: bool = True  # stains and a printed line
    wobble_deg: float = 1.2  # amplitude of each of two sinusoids a rotation
    wobble_mm: float = 1.7  # the same for the two shifts
    travel_mm: float = 400.0  # stations 0..travel
    mm_per_count: float = 0.05  # of the cable counter
    seed: int = 1
    roll_deg: float = 0.0  # amplitude; then the head has a sensor that says so
    others: tuple[HeadCamera, ...] = ()  # further cameras, on the first one's sync line; all else is in its frame
    centre_mm: tuple[float, float] = (0.0, 0.0)  # of the head: where the pipe's axis passes when it does not wobble
    mounted: tuple[Matrix, Vector] = STILL, (0.0, 0.0, 0.0)  # the first camera in the head's frame, as a HeadCamera is
    ground: WorldGround | None = None  # around the pipe, for a head with sensors that look through its wall
    course: Course | None = None  # of a pipe of several pieces: then z is chainage, `radius_mm` what is calibrated with

    def __post_init__(self) -> None:
        if self.travel_mm <= 0 or self.mm_per_count <= 0:
            raise AnnulusError("world: travel_mm and mm_per_count must be above zero")
        if any(one.camera.height != self.camera.height for one in self.others):
            raise AnnulusError("world: cameras on one sync line must have equally many rows")
        if self.course is not None and (self.others or not self.camera.central):
            raise AnnulusError("world: a pipe of several pieces is drawn for one camera without a mirror")
        slits = isinstance(self.projector, Projector) and self.projector.line is None
        if self.translucency is not None and not (slits and self.course is None):
            raise AnnulusError("world: a wall that light enters is drawn for slits, in a pipe of one piece")

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
            stain(out, base, STEP_Z_MM, np.random.default_rng([self.seed, 0x57A1]))
            print_line(out)
        return out

    # ---- the head ------------------------------------------------------------------------------------------------
    @property
    def cameras(self) -> tuple[HeadCamera, ...]:
        """The first stands where it stands, the others beside it."""
        return (HeadCamera(0, self.camera, *self.mounted), *self.others)

    @property
    def turns(self) -> int:
        """Slides that are lit in turn; 1: there is one, or all are lit by every flash."""
        return 1 if isinstance(self.projector, Projector) else self.projector.turns

    def sees(self, camera: int) -> tuple[int, ...]:
        """Of these, the ones whose light a camera of that number is about; none: all."""
        light = self.projector
        if isinstance(light, Projector) or light.turns == 1:
            return ()
        return tuple(slide for slide in range(light.turns) if camera in light.looking(slide))

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
        aside, down = self.centre_mm
        return Pose(tilt * rx, tilt * ry, aside + self.wobble_mm * tx, down + self.wobble_mm * ty, roll)

    def calibration(self) -> Calibration:
        """What a perfect calibration of this head would hold."""
        head = self.projector
        if not isinstance(head, Projector):
            return head.calibration(self)
        if head.line is not None:
            line = {"kind": "line"}
            return Calibration(self.camera, "", head.cones, self.radius_mm, others=self.others, pattern=line)
        return Calibration(self.camera, head.colours, head.cones, self.radius_mm, others=self.others)

    def truth(self) -> dict[str, Any]:
        """The world as JSON-able data, defects as a perfect defect list; written beside a scan."""
        return {
            "format": "annulus-truth/1",
            "seed": self.seed,
            "radius_mm": self.radius_mm,
            "features": [
                {
                    "kind": f.kind,
                    "z_mm": f.z_mm,
                    "length_mm": f.length_mm,
                    "depth_mm": f.depth_mm,
                    "clock_deg": f.clock_deg,
                    "arc_deg": f.arc_deg,
                    "edge_mm": f.edge_mm,
                }
                for f in self.features
            ],
            "defects": [f.as_defect(self.radius_mm) for f in self.features],
            **({} if self.translucency is None else {"translucency": asdict(self.translucency)}),
            **({} if self.course is None else {"course": asdict(self.course), **self.course.truth()}),
            **({} if self.ground is None else {"ground": self.to_dict()["ground"]}),
            "travel_mm": self.travel_mm,
            "mm_per_count": self.mm_per_count,
            "calibration": self.calibration().to_dict(),
        }

    def to_dict(self) -> dict[str, Any]:
        """All of the world as JSON-able data; `from_dict` makes an equal one."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "World":
        """Raises AnnulusError for data that is not a world's."""
        try:
            top = dict(data)
            top["projector"] = _light(top["projector"])
            top["camera"] = _camera(top["camera"])
            top["others"] = tuple(
                tupled(HeadCamera, {**one, "camera": _camera(one["camera"])}) for one in top.get("others", ())
            )
            if top.get("ground") is not None:
                top["ground"] = merged("lights")["ground"].read(top["ground"])
            if top.get("course") is not None:
                top["course"] = Course.from_dict(top["course"])
            top["features"] = tuple(WorldFeature(**feature) for feature in top["features"])
            top["rods"] = tuple(Rod(**rod) for rod in top["rods"])
            if top.get("translucency") is not None:
                top["translucency"] = tupled(Translucency, top["translucency"])
            top["led"], top["optics"] = tupled(Led, top["led"]), tupled(CameraOptics, top["optics"])
            return tupled(cls, top)
        except (KeyError, TypeError, ValueError) as error:
            raise AnnulusError(f"world: not a world's data ({error})") from None

    def scaled(self, width: int) -> "World":
        """The same world through a camera `width` pixels wide that sees the same field; blur shrinks with it."""
        k = width / self.camera.width
        others = tuple(replace(one, camera=_scaled(one.camera, k)) for one in self.others)
        optics = replace(self.optics, blur_px=self.optics.blur_px * k)
        return replace(self, camera=_scaled(self.camera, k), others=others, optics=optics)


def _scaled(camera: Camera, k: float) -> Camera:
    return replace(
        camera,
        width=round(camera.width * k),
        height=round(camera.height * k),
        fx=camera.fx * k,
        fy=camera.fy * k,
        cx=(camera.cx + 0.5) * k - 0.5,
        cy=(camera.cy + 0.5) * k - 0.5,
    )


def _light(data: Mapping[str, Any]) -> Projector | WingLight:
    for name, kind in merged("lights").items():
        if name in data:
            light: WingLight = kind.read(data)
            return light
    return tupled(Projector, {**data, "cones": tuple(tupled(Cone, cone) for cone in data["cones"])})


def _camera(data: Mapping[str, Any]) -> Camera:
    mirror = data.get("mirror")
    return tupled(Camera, {**data, "mirror": None if mirror is None else tupled(Mirror, mirror)})


Record = TypeVar("Record")


def tupled(kind: type[Record], data: Mapping[str, Any]) -> Record:
    """A dataclass from JSON-able data: lists become tuples, however deep."""
    return kind(**{key: _frozen(value) for key, value in data.items()})


def _frozen(value: object) -> object:
    return tuple(_frozen(v) for v in value) if isinstance(value, list | tuple) else value
