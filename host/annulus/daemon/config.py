"""head.toml: everything the daemon must know of one head. README.md beside this file shows one with every key."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal, cast

import zmq

from annulus.capture.timing import FrameTiming
from annulus.geometry.calibration import Calibration
from annulus.record.calibration_file import load_calibration
from annulus.stream.publish import Keys
from annulus.vocabulary import AnnulusError

CameraKind = Literal["v4l2", "picamera2", "video", "folder", "twin"]
CAMERA_KINDS = ("v4l2", "picamera2", "video", "folder", "twin")


@dataclass(frozen=True, slots=True)
class CameraConfig:
    kind: CameraKind = "v4l2"
    device: str = "/dev/video0"  # or the file, folder or twin address
    width: int = 1664
    height: int = 1232
    gain: float = 1.0


@dataclass(frozen=True, slots=True)
class LampConfig:
    """Times in microseconds after the falling edge."""

    ratio: int = 4
    projector_delay_us: float = 3000.0
    projector_width_us: float = 5000.0
    led_delay_us: float = 3000.0
    led_width_us: float = 2500.0

    def check(self, timing: FrameTiming) -> None:
        """Raises AnnulusError when a flash leaves the window in which all rows expose."""
        for lamp, delay, width, used in (
            ("projector flash", self.projector_delay_us, self.projector_width_us, self.ratio > 0),
            ("LED flash", self.led_delay_us, self.led_width_us, True),
        ):
            if used and width > 0:
                timing.check_flash(delay, width, lamp)


@dataclass(frozen=True, slots=True)
class HeadConfig:
    """One head, checked. `port` None: no controller, labels come with the frames (scan folder) or are unknown."""

    camera: CameraConfig
    timing: FrameTiming
    lamps: LampConfig
    port: str | None
    mm_per_count: float
    calibration: Calibration | None  # None: no live reconstruction
    record_folder: Path | None  # None: nothing is recorded
    publish: str | None  # None: nothing is published
    keys: Keys | None
    workers: int | None  # None: one a core but one
    slots: int = 24

    def to_dict(self) -> dict[str, Any]:
        """What is attached to a recording: all of it but keys."""
        return {
            "camera": asdict(self.camera),
            "timing": asdict(self.timing),
            "lamps": asdict(self.lamps),
            "port": self.port,
            "mm_per_count": self.mm_per_count,
        }


_SECTIONS: Mapping[str, tuple[str, ...]] = {
    "controller": ("port",),
    "camera": (*(field.name for field in fields(CameraConfig)), "fps", "exposure_us", "readout_us"),
    "lamps": tuple(field.name for field in fields(LampConfig)),
    "odometer": ("mm_per_count",),
    "calibration": ("file",),
    "record": ("folder",),
    "publish": ("address", "key_file", "viewers"),
    "workers": ("count", "slots"),
}


def load_config(path: Path) -> HeadConfig:
    """Read and check head.toml; paths in it are relative to it. Raises AnnulusError naming section and key."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a head.toml.") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise AnnulusError(f"{path}: not TOML: {str(error).splitlines()[0]}") from None
    try:
        return _checked(data, path.parent)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None


def _checked(data: Mapping[str, Any], folder: Path) -> HeadConfig:
    for section, content in data.items():
        if section not in _SECTIONS:
            raise ValueError(f"section [{section}] is not known, expected one of {', '.join(_SECTIONS)}")
        if not isinstance(content, dict):
            raise ValueError(f'"{section}" must be a section, written [{section}]')
        for key in content:
            if key not in _SECTIONS[section]:
                raise ValueError(f"[{section}] {key} is not known, expected one of {', '.join(_SECTIONS[section])}")
    camera, lamps = data.get("camera", {}), data.get("lamps", {})
    kind = _text(camera, "camera", "kind", "v4l2")
    if kind not in CAMERA_KINDS:
        raise ValueError(f"[camera] kind is {kind!r}, expected one of {', '.join(CAMERA_KINDS)}")
    timing = FrameTiming(
        _number(camera, "camera", "fps", 25.0, 1.0, 500.0),
        _number(camera, "camera", "exposure_us", 38_000.0, 1.0, 1e6),
        _number(camera, "camera", "readout_us", 28_000.0, 0.0, 1e6),
    )
    default = LampConfig()
    lamp = LampConfig(
        _whole(lamps, "lamps", "ratio", default.ratio, 0, 15),
        *(
            _number(lamps, "lamps", field.name, getattr(default, field.name), 0.0, 1e6)
            for field in fields(LampConfig)
            if field.name != "ratio"
        ),
    )
    port = _optional(data, "controller", "port")
    if port is not None:
        lamp.check(timing)
    calibration_file = _optional(data, "calibration", "file")
    calibration = None if calibration_file is None else load_calibration(folder / calibration_file)
    usual = CameraConfig()
    config = CameraConfig(
        cast(CameraKind, kind),
        _text(camera, "camera", "device", usual.device),
        _whole(camera, "camera", "width", usual.width, 16, 16384),
        _whole(camera, "camera", "height", usual.height, 16, 16384),
        _number(camera, "camera", "gain", usual.gain, 0.0, 1e3),
    )
    if calibration is not None:
        require_size(calibration, config.width, config.height)
    record = _optional(data, "record", "folder")
    workers = data.get("workers", {})
    return HeadConfig(
        camera=config,
        timing=timing,
        lamps=lamp,
        port=port,
        mm_per_count=_number(data.get("odometer", {}), "odometer", "mm_per_count", 0.05, -1e3, 1e3),
        calibration=calibration,
        record_folder=None if record is None else folder / record,
        publish=_optional(data, "publish", "address"),
        keys=_keys(data.get("publish", {}), folder),
        workers=_whole(workers, "workers", "count", 1, 1, 64) if "count" in workers else None,
        slots=_whole(workers, "workers", "slots", 24, 4, 1024),
    )


def require_size(calibration: Calibration, width: int, height: int) -> None:
    """Raises AnnulusError when the calibration is of a camera of another size."""
    camera = calibration.camera
    if (camera.width, camera.height) != (width, height):
        raise AnnulusError(
            f"calibration is for {camera.width}x{camera.height} but the camera gives {width}x{height}. "
            "Calibrate with the camera in use."
        )


def _keys(section: Mapping[str, Any], folder: Path) -> Keys | None:
    """The key file holds the server's secret key, 40 characters of Z85, and nothing else."""
    name = section.get("key_file")
    if name is None:
        return None
    path = folder / str(name)
    try:
        secret = path.read_text(encoding="ascii").strip()
        public = zmq.curve_public(secret.encode()).decode()
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected the publisher's secret key.") from None
    except (ValueError, zmq.ZMQError):
        raise AnnulusError(f"{path}: not a CURVE secret key. Expected 40 characters of Z85.") from None
    viewers = section.get("viewers", [])
    if not isinstance(viewers, list) or not all(isinstance(key, str) for key in viewers):
        raise ValueError("[publish] viewers must be a list of public keys")
    return Keys(public, secret, frozenset(viewers))


def _optional(data: Mapping[str, Any], section: str, key: str) -> str | None:
    content = data.get(section, {})
    return _text(content, section, key, "") if key in content else None


def _text(content: Mapping[str, Any], section: str, key: str, default: str) -> str:
    value = content.get(key, default)
    if not isinstance(value, str) or (key in content and not value):
        raise ValueError(f"[{section}] {key} is {value!r}, expected a text")
    return value


def _number(content: Mapping[str, Any], section: str, key: str, default: float, low: float, high: float) -> float:
    value = content.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"[{section}] {key} is {value!r}, expected a number in {low:g}..{high:g}")
    if not low <= value <= high:
        raise ValueError(f"[{section}] {key} is {value:g}, expected a number in {low:g}..{high:g}")
    return float(value)


def _whole(content: Mapping[str, Any], section: str, key: str, default: int, low: int, high: int) -> int:
    value = _number(content, section, key, default, low, high)
    if value % 1:
        raise ValueError(f"[{section}] {key} is {value:g}, expected a whole number in {low}..{high}")
    return int(value)
