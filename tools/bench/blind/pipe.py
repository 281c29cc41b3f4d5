"""What is drawn of one scan: the pipe, what is in it, the head, how it travelled, and what the sensor did.

Lengths in mm, clock angles in degrees clockwise from 12 looking ahead, chainage z along the centre line. The camera's x
goes right, its y down, its z ahead; so do the pipe's.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Piece:
    """A stretch of centre line from `start_mm` on. At its start the line jumps by `offset_mm` (x, y) and turns by
    `turn_rad` towards (x, y). `curvature` (x, y), 1/mm, points to where it bends; `taper` is radius a mm."""

    start_mm: float
    radius_mm: float
    offset_mm: tuple[float, float] = (0.0, 0.0)
    turn_rad: tuple[float, float] = (0.0, 0.0)
    curvature: tuple[float, float] = (0.0, 0.0)
    taper: float = 0.0


@dataclass(frozen=True, slots=True)
class Thing:
    """One thing an inspector would name. depth_mm : how far it departs, outwards for a loss, inwards for all else; its
    edges rise over `ramp_mm`. numbers : what else is true of it, by the names of summary.json, and what the drawer
    needs. beside : the kind of thing it was put next to."""

    kind: str
    z_mm: float
    length_mm: float
    clock_deg: float = 0.0
    arc_deg: float = 360.0
    depth_mm: float = 0.0
    ramp_mm: float = 0.0
    numbers: Mapping[str, float] = field(default_factory=dict)
    beside: str = ""

    @property
    def span_mm(self) -> tuple[float, float]:
        return self.z_mm - self.length_mm / 2, self.z_mm + self.length_mm / 2


@dataclass(frozen=True, slots=True)
class Material:
    """Of the wall. gloss : strength of the highlight, 0..1; dirt : part of it under specks; grain : of its normals."""

    name: str
    albedo: tuple[float, float, float]
    gloss: float
    gloss_width: float
    mirror: float
    dirt: float
    grain: float


@dataclass(frozen=True, slots=True)
class Pipe:
    """oval : part of the radius, cos 2t; its swell is what it grows by about `swell_mm`; lobes : cos 3t, cos 4t."""

    pieces: tuple[Piece, ...]
    things: tuple[Thing, ...]
    material: Material
    oval: float
    oval_clock_deg: float
    swell: float
    swell_mm: tuple[float, float]  # its middle, and its width
    lobes: tuple[tuple[float, float], ...]  # of order 3 and 4: part of the radius, clock

    @property
    def radius_mm(self) -> float:
        return self.pieces[0].radius_mm


@dataclass(frozen=True, slots=True)
class Head:
    """Camera, slide projector and rods. slits : (inner, outer) half-angle of each, radians; stripes lie between, and
    `margin_rad` of light within the first slit and outside the last. vertex and axis in the camera's frame."""

    width: int
    height: int
    model: str  # pinhole | fisheye
    focal_px: float
    centre_px: tuple[float, float]
    vertex_mm: tuple[float, float, float]
    axis: tuple[float, float, float]
    slits: tuple[tuple[float, float], ...]
    colours: str
    margin_rad: float
    dyes: tuple[tuple[float, float, float], ...]  # what red, green and blue stripes let through
    rods: tuple[tuple[float, float, float], ...]  # clock, distance from the camera's axis, radius


@dataclass(frozen=True, slots=True)
class Stand:
    """Where the head was for one frame: a point p before the pipe's cross-section at z lies at Ry Rx p + (tx, ty)."""

    index: int
    lamp: str  # projector | led
    z_mm: float
    reported_mm: float  # what the odometer says
    rx: float
    ry: float
    tx_mm: float
    ty_mm: float
    drift: float  # 0..1, how much of the scene's drift has come


@dataclass(frozen=True, slots=True)
class Sensor:
    """blur_px : sigma of the lens. full : electrons at white. exposure : white is this part of the projector's 99th
    percentile; above 1 it burns out. burnt_deg : a band (clock, arc) in which the light is `burnt` times as strong."""

    blur_px: float
    full: float
    read: float
    exposure: float
    veil: float
    jpeg: int
    burnt: float
    burnt_deg: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Change:
    """After the calibration: focal length and projector's angles (parts), its turn (radians) and shift (mm)."""

    focal: float = 0.0
    angles: float = 0.0
    turn_rad: tuple[float, float] = (0.0, 0.0)
    shift_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    grows: bool = False  # over the scan; else it was there from its first frame

    @property
    def any(self) -> bool:
        return bool(self.focal or self.angles or any(self.turn_rad) or any(self.shift_mm))


@dataclass(frozen=True, slots=True)
class Scene:
    """All of it. limits : what limits.toml says, by section and quantity. marks : what was put in on purpose."""

    seed: int
    pipe: Pipe
    head: Head
    stands: tuple[Stand, ...]
    sensor: Sensor
    change: Change
    limits: Mapping[str, Mapping[str, float]]
    marks: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> "Scene":
        """Of `to_dict`, by way of JSON: what a folder was drawn from, whatever its seed would draw today."""
        pipe = data["pipe"]
        return cls(
            data["seed"],
            Pipe(
                **{
                    **_tuples(pipe),
                    "pieces": tuple(Piece(**_tuples(one)) for one in pipe["pieces"]),
                    "things": tuple(Thing(**one) for one in pipe["things"]),
                    "material": Material(**_tuples(pipe["material"])),
                }
            ),
            Head(**_tuples(data["head"])),
            tuple(Stand(**one) for one in data["stands"]),
            Sensor(**_tuples(data["sensor"])),
            Change(**_tuples(data["change"])),
            data["limits"],
            tuple(data["marks"]),
        )


def _tuples(section: Mapping[str, Any]) -> dict[str, Any]:
    def frozen(value: Any) -> Any:
        return tuple(map(frozen, value)) if isinstance(value, list) else value

    return {name: frozen(value) for name, value in section.items()}
