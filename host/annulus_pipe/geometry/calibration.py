"""The calibration of a ring sensor as a checked value.

Two file formats, both read for ever. `annulus-calibration/1`: one camera, a pattern of slits. `annulus-calibration/2`:
any number of cameras, and other patterns; written only where /1 cannot say it. Examples of each: calibration-1.json and
calibration-2.json in tests/data. Keys that are not known here are passed over.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Literal, cast, get_args

from annulus_pipe import untrusted
from annulus_pipe.geometry.camera import Camera, Mirror, Model
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.geometry.translucency import slit_shift_mm, wall_from_dict, wall_to_dict
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError

ONE_CAMERA, CAMERAS = "annulus-calibration/1", "annulus-calibration/2"
CORRECTION = {ONE_CAMERA: "fine", CAMERAS: "correction"}  # what a ring's residual correction is called in the file
CORRECTION_MAX = 4096  # directions a ring may be corrected in
CAMERAS_MAX, CAMERA_ID_MAX = 16, 255
BESIDE = ("transfer", "motion", "pipe")  # of a head that projects fringes: see fringe.head
SENSOR_MAX = 65535.0  # pixels a side
RINGS_MAX = 64  # of a pattern: rings_by_ring.h has room for no more; test_more_rings_than_are_read_are_refused
ROUNDED = 1e-12  # what a unit vector's length is off by rounding (test_what_was_written_is_read_back)
ROTATION_OFF = 1e-5  # of a unit vector: 2 um at a wall 200 mm away (test_a_rotation_is_one)

Kind = Literal["slits", "line", "lines", "fringe"]
Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

STILL: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True, slots=True)
class RingCorrection:
    """What one slit is off its cone: sample i of n belongs to the azimuth 2 pi i / n about the cone's axis, counted
    from the part of the camera's x across the axis, towards its y. Between samples linear, and closed."""

    offset_rad: tuple[float, ...]  # added to the half-angle
    shift_mm: tuple[float, ...] | None = None  # of the vertex along the axis, as many


@dataclass(frozen=True, slots=True)
class HeadCamera:
    """One camera of a head. A point X of the first camera's frame lies at rotation X + translation_mm in this one's."""

    id: int
    camera: Camera
    rotation: Matrix = STILL
    translation_mm: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Calibration:
    """Camera, the stripes' colours from the innermost outwards, one cone per slit between them, the pipe's radius.

    `camera` is the first one and `camera_id` its name in scans and recordings; rings are in its frame. `others` are the
    further cameras of a head that has several. `pattern` is None where slits are projected; else it is the section as
    it stands in the file, with "kind", to be understood by the method for that kind, and there may be no rings; so are
    the sections BESIDE it, and what else "pipe" says.

    `covariance` (6K, 6K) says how well the K rings are known: ring after ring half-angle (rad), axis x, y, vertex x, y,
    z (mm). `corrections` say what each ring is off its cone (Alzuhiri 2022, Alg. 3). Either may be missing.

    `translucency_mm`: how far red, green and blue edges of light move down the pipe within the wall it is for, beyond
    what the rings have in them from the wall that they were measured in; 0: the two are alike. With a sigma where
    it was measured.
    """

    camera: Camera
    colours: str
    rings: tuple[Cone, ...]
    pipe_radius_mm: float
    covariance: tuple[tuple[float, ...], ...] | None = None
    corrections: tuple[RingCorrection, ...] | None = None
    others: tuple[HeadCamera, ...] = ()
    camera_id: int = 0
    pattern: Mapping[str, Any] | None = field(default=None, hash=False)
    beside: Mapping[str, Any] = field(default_factory=dict, hash=False)
    translucency_mm: Vector = (0.0, 0.0, 0.0)
    translucency_sigma_mm: Vector | None = None

    @property
    def cameras(self) -> tuple[HeadCamera, ...]:
        """All cameras of the head; the first stands where it stands."""
        return (HeadCamera(self.camera_id, self.camera), *self.others)

    @property
    def kind(self) -> Kind:
        """What is projected."""
        return "slits" if self.pattern is None else cast(Kind, self.pattern["kind"])

    @property
    def frame_by_frame(self) -> bool:
        """Whether the frames of one flash say a profile; those of a fringe are recorded, and measured together."""
        return self.kind in ("slits", "line")

    def only(self, *kinds: Kind) -> "Calibration":
        """Itself, for a method that knows one camera and these kinds of light (slits if none is named).

        Raises AnnulusError, one line, where there is more."""
        if self.others:
            raise AnnulusError(f"calibration: {_more_than_one(self.cameras)}")
        if self.kind not in (kinds or ("slits",)):
            expected = " or ".join(kinds or ("slits",))
            raise AnnulusError(f"calibration: the head projects {self.kind}, expected {expected} for this method")
        return self

    def in_wall(self) -> "Calibration":
        """Itself as its wall shows it, for whoever measures: rings where their light leaves, no translucency left over.

        A ring that leaves m farther along a pipe on the cone's axis is the cone with its vertex moved by m, exactly. In
        one that leans by e it is off by m e cot(half-angle) at most, one way on one side and the other on the other:
        0.02 mm of radius for 0.3 mm, 1 degree and the demo's narrowest ring, nothing in its mean (test_a_leaning_pipe).
        """
        if not any(self.translucency_mm):
            return self
        shifts = slit_shift_mm(self.translucency_mm, self.colours)
        rings = []
        for ring, shift in zip(self.rings, shifts, strict=True):
            x, y, z = (v + float(shift) * a for v, a in zip(ring.vertex_mm, ring.axis, strict=True))
            rings.append(replace(ring, vertex_mm=(x, y, z)))
        return replace(self, rings=tuple(rings), translucency_mm=(0.0, 0.0, 0.0), translucency_sigma_mm=None)

    @classmethod
    def from_dict(cls, data: object) -> "Calibration":
        """Check and convert the parsed JSON. Raises ValueError naming the key that is wrong."""
        top = _section(data, "the file")
        if top.get("format") not in list(CORRECTION):
            raise ValueError(
                f'"format" is {untrusted.shown(top.get("format"))}, expected "{ONE_CAMERA}" or "{CAMERAS}"'
            )
        cameras = _cameras(top)
        pattern = _section(_need(top, "pattern"), "pattern")
        kind = pattern.get("kind", "slits")
        if kind not in get_args(Kind):
            raise ValueError(f'"pattern.kind" is {untrusted.shown(kind)}, expected one of {", ".join(get_args(Kind))}')
        colours = _colours(top) if kind == "slits" else ""
        cones = _need(top, "rings") if kind in ("slits", "line") else top.get("rings", ())
        rings = _rings(cones, len(colours) - 1 if colours else None)
        if kind == "line" and not rings:
            raise ValueError('"rings" must list at least one: a head of bright lines has a cone for each')
        if kind == "fringe" and "pipe" not in top:
            raise ValueError('"pipe" is missing: this is the calibration of fringes on a plate, no pipe\'s')
        radius = _radius(_need(top, "pipe"))
        covariance = None if "covariance" not in top else _covariance(top["covariance"], 6 * len(rings))
        if "wall" in top and kind != "slits":
            raise ValueError(f'"wall" is there, expected none: what is known of a wall is by colour, {kind} has none')
        moved, sigma = wall_from_dict(top["wall"]) if "wall" in top else ((0.0, 0.0, 0.0), None)
        first, *others = cameras
        return cls(
            first.camera,
            colours,
            tuple(cone for cone, _ in rings),
            radius,
            covariance,
            _corrections(rings),
            tuple(others),
            first.id,
            None if kind == "slits" else dict(pattern),
            _beside(top) if kind == "fringe" else {},
            moved,
            sigma,
        )

    def to_dict(self) -> dict[str, Any]:
        """As JSON has it: `annulus-calibration/1` where that can say everything."""
        single = not self.others and self.pattern is None and self.camera_id == 0
        head = {"camera": camera_to_dict(self.camera)} if single else {"cameras": _cameras_to_list(self.cameras)}
        pattern = {"colours": self.colours} if single else self.pattern or {"kind": "slits", "colours": self.colours}
        data: dict[str, Any] = {
            "format": ONE_CAMERA if single else CAMERAS,
            **head,
            "pattern": dict(pattern),
            "rings": [
                {"theta_full_deg": math.degrees(2 * c.half_angle), "axis": list(c.axis), "vertex_mm": list(c.vertex_mm)}
                for c in self.rings
            ],
            "pipe": {"radius_mm": self.pipe_radius_mm},
        }
        for key, section in self.beside.items():
            data[key] = {**section, **data[key]} if key == "pipe" else section
        for ring, correction in zip(data["rings"], self.corrections or (), strict=False):
            written = ring[CORRECTION[data["format"]]] = {"offset_rad": list(correction.offset_rad)}
            if correction.shift_mm is not None:
                written["shift_mm"] = list(correction.shift_mm)
        if any(self.translucency_mm) or self.translucency_sigma_mm is not None:
            data["wall"] = wall_to_dict(self.translucency_mm, self.translucency_sigma_mm)
        if self.covariance is not None:
            data["covariance"] = [list(row) for row in self.covariance]
        return data


def vector_of(value: FloatArray) -> Vector:
    """(3,) as a file and a `HeadCamera` have it."""
    x, y, z = (float(one) for one in value)
    return x, y, z


def matrix_of(value: FloatArray) -> Matrix:
    """(3, 3) the same."""
    x, y, z = (vector_of(row) for row in value)
    return x, y, z


def head_from_dict(data: object) -> tuple[Camera, str, float | None, Calibration | None]:
    """Camera and colours of a file that may have no rings yet; the pipe's radius and the whole, where they are there.

    Raises ValueError naming the key that is wrong, also for a head with more than one camera."""
    camera = camera_alone(data)
    top = _section(data, "the file")
    radius = _radius(top["pipe"]) if isinstance(top.get("pipe"), Mapping) else None
    return camera, _colours(top), radius, Calibration.from_dict(data) if "rings" in top else None


def head_cameras_from_dict(data: object) -> tuple[tuple[HeadCamera, ...], str]:
    """Cameras and colours of a head with several, wherever they stand: for a file that is to be calibrated.

    Raises ValueError naming the key that is wrong."""
    top = _section(data, "the file")
    sections = _camera_sections(top)
    still = {"rotation": STILL, "translation_mm": (0.0, 0.0, 0.0)}
    cameras = _cameras({**top, "cameras": [{**_section(one, "cameras"), **still} for one in sections]})
    if len(cameras) < 2:
        raise ValueError('"cameras" lists one camera, expected two or more')
    return tuple(cameras), _colours(top)


def cameras_from_dict(data: object) -> tuple[HeadCamera, ...]:
    """All cameras of a file, whatever the head projects and whatever wall it stands before.

    Raises ValueError naming the key that is wrong."""
    return tuple(_cameras(_section(data, "the file")))


def several_cameras(data: object) -> bool:
    """Whether a parsed file is of a head with several cameras."""
    cameras = data.get("cameras") if isinstance(data, Mapping) else None
    return isinstance(cameras, Sequence) and not isinstance(cameras, str) and len(cameras) > 1


def camera_alone(data: object) -> Camera:
    """The camera of a file that may have nothing else yet.

    Raises ValueError naming the key that is wrong, also for a head with more than one camera."""
    top = _section(data, "the file")
    if top.get("format") != CAMERAS:
        return camera_from_dict(_need(top, "camera"))
    sections = _camera_sections(top)
    if len(sections) > 1:
        raise ValueError(_more_than_one(sections))
    return _head_camera(sections[0], "cameras[0]", first=True).camera


def _more_than_one(cameras: Sequence[object]) -> str:
    return f"the head has {len(cameras)} cameras, expected one: this method does not join views"


def _cameras(top: Mapping[str, Any]) -> list[HeadCamera]:
    """At least one; the first stands still."""
    if top.get("format") != CAMERAS:
        return [HeadCamera(0, camera_from_dict(_need(top, "camera")))]
    cameras: list[HeadCamera] = []
    for i, section in enumerate(_camera_sections(top)):
        one = _head_camera(section, f"cameras[{i}]", first=i == 0)
        if one.id in {camera.id for camera in cameras}:
            raise ValueError(f'"cameras[{i}].id" is {one.id}, and so is another\'s')
        cameras.append(one)
    return cameras


def _camera_sections(top: Mapping[str, Any]) -> Sequence[object]:
    sections = _need(top, "cameras")
    if not isinstance(sections, Sequence) or isinstance(sections, str) or not 1 <= len(sections) <= CAMERAS_MAX:
        raise ValueError(f'"cameras" must be a list of 1..{CAMERAS_MAX} cameras')
    return sections


def _head_camera(data: object, where: str, *, first: bool) -> HeadCamera:
    section = _section(data, where)
    number = untrusted.whole(_need(section, "id", where), f'"{where}.id"', 0, CAMERA_ID_MAX)
    camera = camera_from_dict(section, where)
    if first and "rotation" not in section and "translation_mm" not in section:
        return HeadCamera(number, camera)
    rotation, moved = placement_from_dict(section, where)
    if first and (rotation != STILL or any(moved)):
        raise ValueError(
            f'"{where}" is the first camera, the others stand relative to it: expected the unit matrix for its '
            '"rotation" and zeros for its "translation_mm"'
        )
    return HeadCamera(number, camera, rotation, moved)


def placement_from_dict(section: Mapping[str, Any], where: str) -> tuple[Matrix, Vector]:
    """ "rotation" and "translation_mm" of a section. Raises ValueError naming the key that is wrong."""
    return _rotation(_need(section, "rotation", where), f"{where}.rotation"), _vector(section, "translation_mm", where)


def _rotation(value: object, where: str) -> Matrix:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise ValueError(f'"{where}" must be three rows of three numbers')
    x, y, z = (cast(Vector, untrusted.numbers(row, f'"{where}[{i}]"', (3,), 1.001)) for i, row in enumerate(value))
    # two rows of length one across each other, and the third is the first crossed with the second: right is not left
    third = (x[1] * y[2] - x[2] * y[1], x[2] * y[0] - x[0] * y[2], x[0] * y[1] - x[1] * y[0])
    across = sum(a * b for a, b in zip(x, y, strict=True))
    lengths = (math.hypot(*x) - 1, math.hypot(*y) - 1)
    off = max(abs(v) for v in (*lengths, across, *(a - b for a, b in zip(third, z, strict=True))))
    if off > ROTATION_OFF:
        raise ValueError(f'"{where}" is no rotation: it is off by {off:.2g}, expected at most {ROTATION_OFF:g}')
    return x, y, z


def _cameras_to_list(cameras: Sequence[HeadCamera]) -> list[dict[str, Any]]:
    return [
        {
            "id": one.id,
            **camera_to_dict(one.camera),
            "rotation": [list(row) for row in one.rotation],
            "translation_mm": list(one.translation_mm),
        }
        for one in cameras
    ]


def _beside(top: Mapping[str, Any]) -> dict[str, Any]:
    pipe = {key: value for key, value in top["pipe"].items() if key != "radius_mm"}
    return {key: top[key] for key in BESIDE if key in top and key != "pipe"} | ({"pipe": pipe} if pipe else {})


def _colours(top: Mapping[str, Any]) -> str:
    colours = _need(_section(_need(top, "pattern"), "pattern"), "colours", "pattern")
    if not isinstance(colours, str) or not 2 <= len(colours) <= RINGS_MAX + 1 or set(colours) - set("RGB"):
        raise ValueError(
            f'"pattern.colours" is {untrusted.shown(colours)}, expected letters R, G, B from the innermost outwards'
        )
    return colours


def _radius(pipe: object) -> float:
    return _number(_section(pipe, "pipe"), "radius_mm", "pipe", 1.0, 5000.0)


def _rings(rings: object, slits: int | None) -> list[tuple[Cone, RingCorrection | None]]:
    """`slits`: how many there must be, where the stripes' colours tell."""
    if not isinstance(rings, Sequence) or isinstance(rings, str) or slits not in (None, len(rings)):
        many = "" if slits is None else f" {slits} slits, one between each two of {slits + 1} stripes"
        raise ValueError(f'"rings" must list{many or " slits"}')
    if len(rings) > RINGS_MAX:
        raise ValueError(f'"rings" lists {len(rings)}, expected at most {RINGS_MAX}')
    out = []
    for i, ring in enumerate(rings):
        where = f"rings[{i}]"
        section = _section(ring, where)
        key = next((key for key in CORRECTION.values() if key in section), None)
        out.append((_cone(section, where), None if key is None else _correction(section[key], f"{where}.{key}")))
    if any(b.half_angle <= a.half_angle for (a, _), (b, _) in pairwise(out)):
        raise ValueError('"rings" must be listed from the innermost outwards, "theta_full_deg" rising')
    return out


def _corrections(rings: Sequence[tuple[Cone, RingCorrection | None]]) -> tuple[RingCorrection, ...] | None:
    known = [correction for _, correction in rings if correction is not None]
    if known and len(known) < len(rings):
        bare = next(i for i, (_, correction) in enumerate(rings) if correction is None)
        raise ValueError(
            f'"rings[{bare}]" has no correction ({" or ".join(CORRECTION.values())}), other rings have one'
        )
    return tuple(known) or None


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    section: dict[str, Any] = {
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        "distortion": list(camera.distortion),
    }
    if camera.mirror is not None:
        ball = camera.mirror
        section["mirror"] = {"centre_mm": list(ball.centre_mm), "radius_mm": ball.radius_mm, "looks": ball.looks}
    if camera.sensor_crop is not None:
        section["sensor_crop"] = list(camera.sensor_crop)
    if camera.colour_shift_px:
        section["colour_shift_px"] = [list(row) for row in camera.colour_shift_px]
    return section


def camera_from_dict(data: object, where: str = "camera") -> Camera:
    """The `camera` section, or what stands at `where`. Raises ValueError naming the key that is wrong."""
    section = _section(data, where)
    model = section.get("model")
    if model not in get_args(Model):
        raise ValueError(f'"{where}.model" is {untrusted.shown(model)}, expected one of {", ".join(get_args(Model))}')
    lengths = (0, 4) if model == "fisheye" else (0, 4, 5, 8, 12, 14)
    distortion = untrusted.numbers(section.get("distortion", []), f'"{where}.distortion" ({model})', lengths, 1e3)
    width, height = (_number(section, key, where, 16, 16384) for key in ("width", "height"))
    if width % 1 or height % 1:
        raise ValueError(f'"{where}.width" and "{where}.height" must be whole pixels')
    fx, fy = (_number(section, key, where, 1.0, 1e6) for key in ("fx", "fy"))
    cx, cy = (_number(section, key, where, -1e5, 1e5) for key in ("cx", "cy"))
    mirror = _mirror(_need(section, "mirror", where), f"{where}.mirror") if model == "mirror" else None
    crop = sensor_crop(section["sensor_crop"], f'"{where}.sensor_crop"') if "sensor_crop" in section else None
    shifts = _colour_shift(section["colour_shift_px"], where) if "colour_shift_px" in section else ()
    return Camera(cast(Model, model), int(width), int(height), fx, fy, cx, cy, distortion, mirror, crop, shifts)


def _colour_shift(value: object, where: str) -> tuple[tuple[float, float, float, float], ...]:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise ValueError(f'"{where}.colour_shift_px" must be three rows, red, green, blue')
    rows = (untrusted.numbers(row, f'"{where}.colour_shift_px[{i}]"', (4,), 10.0) for i, row in enumerate(value))
    return tuple(cast(tuple[float, float, float, float], row) for row in rows)


def sensor_crop(data: object, where: str) -> tuple[int, int, int, int]:
    """[x, y, width, height] in pixels of the whole sensor. Raises ValueError."""
    x, y, width, height = (int(value) for value in untrusted.numbers(data, where, (4,), SENSOR_MAX))
    if min(x, y) < 0 or min(width, height) < 16:
        raise ValueError(f"{where} is {untrusted.shown(data)}, expected x, y, width, height in pixels of the sensor")
    return x, y, width, height


def _mirror(data: object, where: str) -> Mirror:
    section = _section(data, where)
    centre = _vector(section, "centre_mm", where)
    radius = _number(section, "radius_mm", where, 0.1, 1000.0)
    if centre[2] <= 0 or math.hypot(*centre) <= radius:
        raise ValueError(
            f'"{where}.centre_mm" is {list(centre)}, expected a ball of {radius:g} mm before the camera (z > 0) '
            "that does not hold it"
        )
    looks = section.get("looks", "back")
    if looks not in ("back", "ahead"):
        raise ValueError(f'"{where}.looks" is {untrusted.shown(looks)}, expected "back" or "ahead"')
    return Mirror(centre, radius, looks)


def _cone(ring: Mapping[str, Any], where: str) -> Cone:
    theta = _number(ring, "theta_full_deg", where, 1.0, 180.0)  # a flat plane at most
    axis = _vector(ring, "axis", where)
    length = math.sqrt(sum(v * v for v in axis))
    if abs(length - 1.0) > 1e-3 or axis[2] <= 0:
        raise ValueError(
            f'"{where}.axis" must be a unit vector pointing down the pipe (z > 0), its length is {length:.4g}'
        )
    if abs(length - 1.0) > ROUNDED:  # what was written here is read again as it was
        axis = cast(tuple[float, float, float], tuple(v / length for v in axis))
    return Cone(math.radians(theta / 2), axis, _vector(ring, "vertex_mm", where))


def _correction(data: object, where: str) -> RingCorrection:
    section = _section(data, where)
    counts = range(3, CORRECTION_MAX + 1)
    offset = untrusted.numbers(_need(section, "offset_rad", where), f'"{where}.offset_rad"', counts, 0.5)
    if "shift_mm" not in section:
        return RingCorrection(offset)
    return RingCorrection(
        offset, untrusted.numbers(section["shift_mm"], f'"{where}.shift_mm" (as "offset_rad")', (len(offset),), 1e3)
    )


def _covariance(value: object, size: int) -> tuple[tuple[float, ...], ...]:
    """A symmetric matrix whose every correlation is one; that it is positive too is for its users to mind."""
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != size:
        raise ValueError(f'"covariance" must be {size} rows of {size} numbers, six for each ring')
    rows = [untrusted.numbers(row, f'"covariance[{i}]"', (size,), 1e10) for i, row in enumerate(value)]
    for i in range(size):
        for j in range(i + 1):
            bound = math.sqrt(max(rows[i][i], 0.0) * max(rows[j][j], 0.0))
            if abs(rows[i][j] - rows[j][i]) > 1e-6 * bound or abs(rows[i][j]) > (1 + 1e-6) * bound or rows[i][i] < 0:
                raise ValueError(f'"covariance" is none: row {i + 1}, column {j + 1} does not fit')
    return tuple(rows)


def _vector(section: Mapping[str, Any], key: str, where: str) -> Vector:
    return cast(Vector, untrusted.numbers(_need(section, key, where), f'"{where}.{key}"', (3,), 1e5))


def _number(section: Mapping[str, Any], key: str, where: str, low: float, high: float) -> float:
    return untrusted.within(_need(section, key, where), f'"{where}.{key}"', low, high)


def _need(section: Mapping[str, Any], key: str, where: str = "") -> Any:
    if key not in section:
        raise ValueError(f'"{where + "." if where else ""}{key}" is missing')
    return section[key]


def _section(value: object, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise ValueError(f"{where} must be an object")
    return value
