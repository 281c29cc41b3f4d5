"""The calibration of a ring sensor as a checked value (file format: README, `annulus-calibration/1`)."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, cast

from annulus.geometry.camera import Camera, Mirror, Model
from annulus.geometry.cone import Cone

FORMAT = "annulus-calibration/1"
FINE_MAX = 4096  # directions a ring may be fine-tuned in


@dataclass(frozen=True, slots=True)
class RingCorrection:
    """What one slit is off its cone: sample i of n belongs to the azimuth 2 pi i / n about the cone's axis, counted
    from the part of the camera's x across the axis, towards its y. Between samples linear, and closed."""

    offset_rad: tuple[float, ...]  # added to the half-angle
    shift_mm: tuple[float, ...] | None = None  # of the vertex along the axis, as many


@dataclass(frozen=True, slots=True)
class Calibration:
    """Camera, the stripes' colours from the innermost outwards, one cone per slit between them, the pipe's radius.

    `covariance` (6K, 6K) says how well the K rings are known: ring after ring half-angle (rad), axis x, y, vertex x, y,
    z (mm). `corrections` say what each ring is off its cone (Alzuhiri 2022, Alg. 3). Either may be missing.
    """

    camera: Camera
    colours: str
    rings: tuple[Cone, ...]
    pipe_radius_mm: float
    covariance: tuple[tuple[float, ...], ...] | None = None
    corrections: tuple[RingCorrection, ...] | None = None

    @classmethod
    def from_dict(cls, data: object) -> "Calibration":
        """Check and convert the parsed JSON. Raises ValueError naming the key that is wrong."""
        top = _mapping(data, "the file")
        if top.get("format") != FORMAT:
            raise ValueError(f'"format" is {top.get("format")!r}, expected "{FORMAT}"')
        camera = camera_from_dict(_need(top, "camera"))
        colours = _colours(top)
        rings = _need(top, "rings")
        if not isinstance(rings, Sequence) or isinstance(rings, str) or len(rings) != len(colours) - 1:
            raise ValueError(
                f'"rings" must list {len(colours) - 1} slits, one between each two of {len(colours)} stripes'
            )
        cones = tuple(_cone(_mapping(ring, f"rings[{i}]"), f"rings[{i}]") for i, ring in enumerate(rings))
        if any(b.half_angle <= a.half_angle for a, b in pairwise(cones)):
            raise ValueError('"rings" must be listed from the innermost outwards, "theta_full_deg" rising')
        radius = _number(_mapping(_need(top, "pipe"), "pipe"), "radius_mm", "pipe", 1.0, 5000.0)
        covariance = None if "covariance" not in top else _covariance(top["covariance"], 6 * len(cones))
        tuned = [isinstance(ring, Mapping) and "fine" in ring for ring in rings]
        if any(tuned) and not all(tuned):
            raise ValueError(f'"rings[{tuned.index(False)}].fine" is missing, other rings have one')
        fine = tuple(_fine(ring["fine"], f"rings[{i}].fine") for i, ring in enumerate(rings)) if any(tuned) else None
        return cls(camera, colours, cones, radius, covariance, fine)

    def to_dict(self) -> dict[str, Any]:
        data: dict[str, Any] = {
            "format": FORMAT,
            "camera": camera_to_dict(self.camera),
            "pattern": {"colours": self.colours},
            "rings": [
                {
                    "theta_full_deg": math.degrees(2 * c.half_angle),
                    "axis": list(c.axis),
                    "vertex_mm": list(c.vertex_mm),
                }
                for c in self.rings
            ],
            "pipe": {"radius_mm": self.pipe_radius_mm},
        }
        for ring, fine in zip(data["rings"], self.corrections or (), strict=False):
            ring["fine"] = {"offset_rad": list(fine.offset_rad)}
            if fine.shift_mm is not None:
                ring["fine"]["shift_mm"] = list(fine.shift_mm)
        if self.covariance is not None:
            data["covariance"] = [list(row) for row in self.covariance]
        return data


def head_from_dict(data: object) -> tuple[Camera, str, float | None, Calibration | None]:
    """Camera and colours of a file that may have no rings yet; the pipe's radius and the whole, where they are there.

    Raises ValueError naming the key that is wrong."""
    top = _mapping(data, "the file")
    whole = Calibration.from_dict(data) if "rings" in top else None
    pipe = top.get("pipe")
    radius = _number(pipe, "radius_mm", "pipe", 1.0, 5000.0) if isinstance(pipe, Mapping) else None
    return camera_from_dict(_need(top, "camera")), _colours(top), radius, whole


def _colours(top: Mapping[str, Any]) -> str:
    colours = _need(_mapping(_need(top, "pattern"), "pattern"), "colours", "pattern")
    if not isinstance(colours, str) or not 2 <= len(colours) <= 65 or set(colours) - set("RGB"):
        raise ValueError(f'"pattern.colours" is {colours!r}, expected letters R, G, B from the innermost outwards')
    return colours


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    section: dict[str, Any] = {
        "model": camera.model, "width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy,
        "cx": camera.cx, "cy": camera.cy, "distortion": list(camera.distortion),
    }  # fmt: skip
    if camera.mirror is not None:
        ball = camera.mirror
        section["mirror"] = {"centre_mm": list(ball.centre_mm), "radius_mm": ball.radius_mm, "looks": ball.looks}
    return section


def camera_from_dict(data: object) -> Camera:
    """The `camera` section. Raises ValueError naming the key that is wrong."""
    section = _mapping(data, "camera")
    model = section.get("model")
    if model not in ("pinhole", "fisheye", "mirror"):
        raise ValueError(f'"camera.model" is {model!r}, expected "pinhole", "fisheye" or "mirror"')
    numbers = section.get("distortion", [])
    if not isinstance(numbers, Sequence) or isinstance(numbers, str):
        raise ValueError('"camera.distortion" must be a list of numbers')
    lengths = (0, 4) if model == "fisheye" else (0, 4, 5, 8, 12, 14)
    if len(numbers) not in lengths:
        raise ValueError(f'"camera.distortion" has {len(numbers)} numbers, expected one of {lengths} for {model}')
    distortion = tuple(_number({"k": value}, "k", "camera.distortion", -1e3, 1e3) for value in numbers)
    width, height = (_number(section, key, "camera", 16, 16384) for key in ("width", "height"))
    if width % 1 or height % 1:
        raise ValueError('"camera.width" and "camera.height" must be whole pixels')
    fx, fy = (_number(section, key, "camera", 1.0, 1e6) for key in ("fx", "fy"))
    cx, cy = (_number(section, key, "camera", -1e5, 1e5) for key in ("cx", "cy"))
    mirror = _mirror(_mapping(_need(section, "mirror", "camera"), "camera.mirror")) if model == "mirror" else None
    return Camera(cast(Model, model), int(width), int(height), fx, fy, cx, cy, distortion, mirror)


def _mirror(section: Mapping[str, Any]) -> Mirror:
    centre = _vector(section, "centre_mm", "camera.mirror")
    radius = _number(section, "radius_mm", "camera.mirror", 0.1, 1000.0)
    if centre[2] <= 0 or math.hypot(*centre) <= radius:
        raise ValueError(
            f'"camera.mirror.centre_mm" is {list(centre)}, expected a ball of {radius:g} mm before the camera (z > 0) '
            "that does not hold it"
        )
    looks = section.get("looks", "back")
    if looks not in ("back", "ahead"):
        raise ValueError(f'"camera.mirror.looks" is {looks!r}, expected "back" or "ahead"')
    return Mirror(centre, radius, looks)


def _cone(ring: Mapping[str, Any], where: str) -> Cone:
    theta = _number(ring, "theta_full_deg", where, 1.0, 178.0)
    axis = _vector(ring, "axis", where)
    length = math.sqrt(sum(v * v for v in axis))
    if abs(length - 1.0) > 1e-3 or axis[2] <= 0:
        raise ValueError(
            f'"{where}.axis" must be a unit vector pointing down the pipe (z > 0), its length is {length:.4g}'
        )
    unit = cast(tuple[float, float, float], tuple(v / length for v in axis))
    return Cone(math.radians(theta / 2), unit, _vector(ring, "vertex_mm", where))


def _fine(data: object, where: str) -> RingCorrection:
    section = _mapping(data, where)
    offset = _numbers(section, "offset_rad", where, 0.5)
    shift = _numbers(section, "shift_mm", where, 1e3) if "shift_mm" in section else None
    if shift is not None and len(shift) != len(offset):
        raise ValueError(f'"{where}.shift_mm" has {len(shift)} numbers, expected {len(offset)} as in "offset_rad"')
    return RingCorrection(offset, shift)


def _numbers(section: Mapping[str, Any], key: str, where: str, most: float) -> tuple[float, ...]:
    value = _need(section, key, where)
    if not isinstance(value, Sequence) or isinstance(value, str) or not 3 <= len(value) <= FINE_MAX:
        raise ValueError(f'"{where}.{key}" must be a list of 3..{FINE_MAX} numbers')
    return tuple(_number({key: v}, key, where, -most, most) for v in value)


def _covariance(value: object, size: int) -> tuple[tuple[float, ...], ...]:
    """A symmetric matrix whose every correlation is one; that it is positive too is for its users to mind."""
    what = f'"covariance" must be {size} rows of {size} numbers, six for each ring'
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != size:
        raise ValueError(what)
    rows: list[tuple[float, ...]] = []
    for row in value:
        if not isinstance(row, Sequence) or isinstance(row, str) or len(row) != size:
            raise ValueError(what)
        rows.append(tuple(_number({"n": v}, "n", "covariance", -1e10, 1e10) for v in row))
    for i in range(size):
        for j in range(i + 1):
            bound = math.sqrt(max(rows[i][i], 0.0) * max(rows[j][j], 0.0))
            if abs(rows[i][j] - rows[j][i]) > 1e-6 * bound or abs(rows[i][j]) > (1 + 1e-6) * bound or rows[i][i] < 0:
                raise ValueError(f'"covariance" is none: row {i + 1}, column {j + 1} does not fit')
    return tuple(rows)


def _vector(section: Mapping[str, Any], key: str, where: str) -> tuple[float, float, float]:
    value = _need(section, key, where)
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise ValueError(f'"{where}.{key}" must be three numbers')
    x, y, z = (_number({key: v}, key, where, -1e5, 1e5) for v in value)
    return x, y, z


def _number(section: Mapping[str, Any], key: str, where: str, low: float, high: float) -> float:
    value = _need(section, key, where)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f'"{where}.{key}" is {value!r}, expected a number in {low:g}..{high:g}')
    return float(value)


def _need(section: Mapping[str, Any], key: str, where: str = "") -> Any:
    if key not in section:
        raise ValueError(f'"{where + "." if where else ""}{key}" is missing')
    return section[key]


def _mapping(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{where} must be an object")
    return value
