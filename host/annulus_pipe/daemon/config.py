"""head.toml: everything the daemon must know of one head. README.md beside this file shows one with every key."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import Any, cast

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.controller import HOST_TIMEOUT_DEFAULT_MS, HOST_TIMEOUT_MAX_MS, HOST_TIMEOUT_MIN_MS, PREAMBLE_MAX
from annulus_pipe.daemon.camera_config import CAMERA_KINDS, CameraConfig, CameraKind
from annulus_pipe.daemon.wiring import SLIDES_RANGE, check_cycle, check_triggers, inverted_pins, slides_seen, trigger_of
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.job import WORDS, JobSheet, provenance
from annulus_pipe.qualification.quoting import Qualification
from annulus_pipe.record.codec import DEFAULT, Codec
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.sensors.chips import CHIPS
from annulus_pipe.sensors.i2c import bus_number
from annulus_pipe.sensors.odometer import MAX_SPEED_MM_S
from annulus_pipe.sensors.remote import NAME
from annulus_pipe.storage.calibration_file import load_calibration, load_part, load_sections, require_size
from annulus_pipe.stream.access import Keys, curve_pair
from annulus_pipe.stream.frames import CAMERAS_MAX
from annulus_pipe.untrusted import TOML_MAX, parse_toml, read_file, shown
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.optics import Optics
from annulus_pipe.wall.reference import ReferenceSection, sections_from, sections_to_dict

SENSOR_KINDS = ("remote", *CHIPS)
COLOUR_MAKER = "annulus calibrate colour"
HOST_TIMEOUT_LEAST_MS = max(HOST_TIMEOUT_MIN_MS, 200)  # twice what lies between two words of the daemon, PING_NS
PERIOD_MS = 25.0  # of the chips of a bus
SLOTS = 36  # in shared memory, of one camera: 28 that wait while the offset is proved, and intake.BURST_RESERVE


@dataclass(frozen=True, slots=True)
class SensorConfig:
    """device : the address, or the I2C bus. The rest is of a chip: one of sensors.chips, its own settings in theirs."""

    kind: str
    device: str
    name: str = ""
    address: int = 0
    period_ms: float = PERIOD_MS
    settings: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SectorsConfig:
    """Of a head with capacitive sectors. ahead_mm : their middle, ahead of the camera, along the pipe."""

    air_pf: float = 4.575
    coupling_ff: float = 113.0
    ahead_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class SocketConfig:
    """Where others may connect, and who."""

    address: str
    keys: Keys | None = None  # None: this machine only


@dataclass(frozen=True, slots=True)
class LampConfig:
    """Times in microseconds after the falling edge."""

    ratio: int = 4
    projector_delay_us: float = 3000.0
    projector_width_us: float = 5000.0
    led_delay_us: float = 3000.0
    led_width_us: float = 2500.0
    preamble_frames: int = 15  # of an optical preamble; 0: none
    preamble_interval_s: float = 20.0  # from one to the next; 0: on arming and after a doubt only
    slides: int = 1  # that take the projector's flashes in turn, each by a lamp of its own
    host_timeout_ms: int = HOST_TIMEOUT_DEFAULT_MS  # lamps go dark when the daemon is silent for so long

    def check(self, timing: FrameTiming) -> None:
        """Raises AnnulusError when a flash leaves the window in which all rows expose."""
        for lamp, delay, width, used in (
            ("projector flash", self.projector_delay_us, self.projector_width_us, self.ratio > 0),
            ("LED flash", self.led_delay_us, self.led_width_us, True),
        ):
            if used and width > 0:
                timing.check_flash(delay, width, lamp)


@dataclass(frozen=True, slots=True)
class RecordConfig:
    """How a scan is recorded. 0: no such bound."""

    codec: Codec = DEFAULT
    part_minutes: float = 60.0  # a new file when the one at hand is so old,
    part_gb: float = 0.0  # or so large
    sync_s: float = 5.0  # to the disk itself this often; 0: whenever the system likes
    min_free_gb: float = 2.0  # no scan begins with less,
    min_free_minutes: float = 0.0  # or with less than so many minutes of frames
    expect_minutes: float = 0.0  # that a scan takes: one is begun with less room, but a warning given
    reserve_mb: float = 200.0  # a scan ends before the disk has less


@dataclass(frozen=True, slots=True)
class LogConfig:
    """A log file that never takes more than (keep + 1) * max_mb."""

    file: Path
    max_mb: float = 10.0
    keep: int = 5  # old ones, as FILE.1 to FILE.5


@dataclass(frozen=True, slots=True)
class HeadConfig:
    """One head, checked. What is None is not there."""

    cameras: tuple[CameraConfig, ...] = (CameraConfig(),)  # on one sync line; a frame's `camera` counts in this order
    lamps: LampConfig = LampConfig()
    port: str | None = None  # None: labels come with the frames (scan folder) or are unknown
    inverted: tuple[str, ...] = ()  # pins of the controller whose wiring wants the other level, of link.pins.INVERTIBLE
    mm_per_count: float = 0.05
    max_speed_mm_s: float = MAX_SPEED_MM_S  # of the winch: what was not counted is bounded by it
    calibration: Calibration | None = None  # None: no live reconstruction
    colour: ColourProfile | None = None  # of the pipe; each frame's own where None
    record_folder: Path | None = None
    record: RecordConfig = RecordConfig()
    job: JobSheet = field(default_factory=JobSheet)  # goes into the recording
    provenance: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)  # of the calibration
    optics: Optics | None = None  # goes into the recording
    references: tuple[ReferenceSection, ...] = ()  # of the pipe; goes into the recording
    qualification: Qualification = field(default_factory=Qualification)  # what vouches for it; goes into the recording
    publish: SocketConfig | None = None
    control: SocketConfig | None = None
    autostart: bool = True  # False: idle until the control socket says start
    sensors: tuple[SensorConfig, ...] = ()
    sectors: SectorsConfig = SectorsConfig()
    workers: int | None = None  # None: one a core but one
    slots: int = SLOTS
    log: LogConfig | None = None
    realtime: bool | None = None  # None: where it is allowed
    interlock_antivalent: bool = False  # the interlock has a second input

    @property
    def timing(self) -> FrameTiming:
        """All cameras' together: what a flash must fit so that every row of every camera sees all of it."""
        modes = [camera.flash_timing for camera in self.cameras]
        return FrameTiming(
            modes[0].fps, min(mode.exposure_us for mode in modes), max(mode.readout_us for mode in modes)
        )

    def to_dict(self) -> dict[str, Any]:
        """What is attached to a recording: all of it but keys."""
        return {
            "cameras": [asdict(camera) for camera in self.cameras],
            "timing": asdict(self.timing),
            "lamps": asdict(self.lamps),
            "record": asdict(self.record),
            "port": self.port,
            "interlock_antivalent": self.interlock_antivalent,
            "inverted": list(self.inverted),
            "mm_per_count": self.mm_per_count,
            "max_speed_mm_s": self.max_speed_mm_s,
            "job": self.job.to_dict(),
            "calibration_provenance": {name: dict(made) for name, made in self.provenance.items()},
            "optics": {} if self.optics is None else self.optics.to_dict(),
            "reference": sections_to_dict(self.references),
            "qualification": self.qualification.to_dict(),
            "sectors": asdict(self.sectors),
            "sensors": [asdict(sensor) for sensor in self.sensors],
        }


_LISTS = ("camera", "sensor")  # sections that may come several times, as [[camera]]
_SECTIONS: Mapping[str, tuple[str, ...]] = {
    "controller": ("port", "inverted"),
    "interlock": ("antivalent",),
    "camera": (
        "kind",
        "device",
        "width",
        "height",
        "format",
        "gain",
        "fps",
        "exposure_us",
        "readout_us",
        "trigger",
        "colour_gains",
        "slides",
    ),
    "lamps": tuple(field.name for field in fields(LampConfig)),
    "odometer": ("mm_per_count", "max_speed_mm_s"),
    "calibration": ("file", "colour"),
    "record": ("folder", *(field.name for field in fields(RecordConfig))),
    "job": tuple(WORDS),
    "publish": ("address", "key_file", "viewers"),
    "control": ("address", "key_file", "viewers", "autostart"),
    "sensor": (
        "kind",
        "device",
        "name",
        "address",
        "period_ms",
        *sorted({name for chip in CHIPS.values() for name in chip.settings}),
    ),
    "optics": ("lens", "slide", "tube", "calibrated_c"),
    "reference": ("sections_mm", "diameter_mm", "u_mm"),
    "qualification": ("certificate", "pod"),
    "sectors": ("air_pf", "coupling_ff", "ahead_mm"),
    "workers": ("count", "slots"),
    "log": ("file", "max_mb", "keep"),
    "daemon": ("realtime",),
}


def load_config(path: Path) -> HeadConfig:
    """Read and check head.toml; paths in it are relative to it. Raises AnnulusError naming section and key."""
    try:
        data = parse_toml(read_file(path, TOML_MAX))
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected a head.toml.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}. Expected a head.toml.") from None
    try:
        return _checked(data, path.parent)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}") from None


def _checked(data: Mapping[str, Any], folder: Path) -> HeadConfig:
    for section, content in data.items():
        _check_names(section, content)
    cameras = tuple(_camera(content) for content in _several(data, "camera")) or (CameraConfig(),)
    if len(cameras) > CAMERAS_MAX:
        raise ValueError(f"{len(cameras)} [[camera]] sections, expected at most {CAMERAS_MAX}")
    if len({camera.timing.fps for camera in cameras}) > 1:
        raise ValueError("[camera] fps differs from camera to camera, but they share one frame-sync")
    check_triggers(cameras)
    lamps = _lamps(data.get("lamps", {}))
    check_cycle(lamps.slides, lamps.ratio, cameras)
    calibration_file, record = _optional(data, "calibration", "file"), _optional(data, "record", "folder")
    paint = _optional(data, "calibration", "colour")
    vouching = [_optional(data, "qualification", name) for name in _SECTIONS["qualification"]]
    workers, control = data.get("workers", {}), data.get("control", {})
    config = HeadConfig(
        cameras=cameras,
        lamps=lamps,
        port=_optional(data, "controller", "port"),
        inverted=inverted_pins(data.get("controller", {})),
        mm_per_count=_number(data.get("odometer", {}), "odometer", "mm_per_count", 0.05, -1e3, 1e3),
        max_speed_mm_s=_number(data.get("odometer", {}), "odometer", "max_speed_mm_s", MAX_SPEED_MM_S, 1.0, 1e5),
        calibration=None if calibration_file is None else load_calibration(folder / calibration_file),
        colour=None if paint is None else load_part(folder / paint, ColourProfile.from_dict, COLOUR_MAKER),
        record_folder=None if record is None else folder / record,
        record=_record(data.get("record", {})),
        job=JobSheet.from_dict(data.get("job", {})),
        provenance={} if calibration_file is None else provenance(load_sections(folder / calibration_file)),
        optics=Optics.from_dict(data["optics"]) if "optics" in data else None,
        references=sections_from(data["reference"]) if "reference" in data else (),
        qualification=Qualification.read(*(None if file is None else folder / file for file in vouching)),
        publish=_socket(data, "publish", folder),
        control=_socket(data, "control", folder),
        autostart=_flag(control, "control", "autostart", True),
        sensors=_sensors(data),
        sectors=_sectors(data.get("sectors", {})),
        workers=_whole(workers, "workers", "count", 1, 1, 64) if "count" in workers else None,
        slots=_whole(workers, "workers", "slots", SLOTS * len(cameras), 4, 1024),
        log=_log(data["log"], folder) if "log" in data else None,
        realtime=_realtime(data.get("daemon", {})),
        interlock_antivalent=_flag(data.get("interlock", {}), "interlock", "antivalent", False),
    )
    if config.port is not None:
        config.lamps.check(config.timing)
    if config.calibration is not None:
        require_size(config.calibration, [(camera.width, camera.height) for camera in cameras])
        crops = {one.id: one.camera.sensor_crop for one in config.calibration.cameras}
        shown = tuple(replace(camera, sensor_crop=crops.get(number)) for number, camera in enumerate(cameras))
        config = replace(config, cameras=shown)
    if config.control is None and not config.autostart:
        raise ValueError("[control] autostart is false, but without an address nobody could start a scan")
    return config


def _check_names(section: str, content: object) -> None:
    if section not in _SECTIONS:
        raise ValueError(f"section [{section}] is not known, expected one of {', '.join(_SECTIONS)}")
    several = content if section in _LISTS and isinstance(content, list) else [content]
    for one in several:
        if not isinstance(one, dict):
            raise ValueError(f'"{section}" must be a section, written [{section}]')
        for key in one if section != "job" else ():  # which has names of before, too
            if key not in _SECTIONS[section]:
                raise ValueError(f"[{section}] {key} is not known, expected one of {', '.join(_SECTIONS[section])}")


def _several(data: Mapping[str, Any], section: str) -> list[Mapping[str, Any]]:
    content = data.get(section, [])
    return content if isinstance(content, list) else [content]


def _camera(content: Mapping[str, Any]) -> CameraConfig:
    usual = CameraConfig()
    kind = _text(content, "camera", "kind", usual.kind)
    if kind not in CAMERA_KINDS:
        raise ValueError(f"[camera] kind is {kind!r}, expected one of {', '.join(CAMERA_KINDS)}")
    return CameraConfig(
        cast(CameraKind, kind),
        _text(content, "camera", "device", usual.device),
        _whole(content, "camera", "width", usual.width, 16, 16384),
        _whole(content, "camera", "height", usual.height, 16, 16384),
        _text(content, "camera", "format", "raw" if kind == "picamera2" else usual.format),
        _number(content, "camera", "gain", usual.gain, 0.0, 1e3),
        FrameTiming(
            _number(content, "camera", "fps", usual.timing.fps, 1.0, 500.0),
            _number(content, "camera", "exposure_us", usual.timing.exposure_us, 1.0, 1e6),
            _number(content, "camera", "readout_us", usual.timing.readout_us, 0.0, 1e6),
        ),
        trigger_of(content),
        _gains(content),
        slides=slides_seen(content),
    )


def _gains(content: Mapping[str, Any]) -> tuple[float, float] | None:
    """[red, blue] as `annulus calibrate colour` prints them."""
    gains = content.get("colour_gains")
    if gains is None:
        return None
    if not isinstance(gains, list) or len(gains) != 2:
        raise ValueError(f"[camera] colour_gains is {gains!r}, expected [red, blue]")
    red, blue = (_number({"colour_gains": gain}, "camera", "colour_gains", 1.0, 0.01, 32.0) for gain in gains)
    return red, blue


def _lamps(content: Mapping[str, Any]) -> LampConfig:
    usual = LampConfig()
    whole = {  # and in which range; the others are numbers
        "ratio": (0, 15),
        "preamble_frames": (0, PREAMBLE_MAX),
        "slides": SLIDES_RANGE,
        "host_timeout_ms": (HOST_TIMEOUT_LEAST_MS, HOST_TIMEOUT_MAX_MS),
    }
    given: dict[str, Any] = {
        field.name: _whole(content, "lamps", field.name, getattr(usual, field.name), *whole[field.name])
        if field.name in whole
        else _number(content, "lamps", field.name, getattr(usual, field.name), 0.0, 1e6)
        for field in fields(LampConfig)
    }
    return LampConfig(**given)


def _record(content: Mapping[str, Any]) -> RecordConfig:
    usual = RecordConfig()
    codec = _text(content, "record", "codec", usual.codec)
    if codec not in list(Codec):
        raise ValueError(f"[record] codec is {shown(codec)}, expected one of {', '.join(Codec)}")
    return RecordConfig(
        codec=Codec(codec),
        part_minutes=_bound(content, "record", "part_minutes", usual.part_minutes, 0.01, 1e5),
        part_gb=_bound(content, "record", "part_gb", usual.part_gb, 0.01, 1e5),
        sync_s=_bound(content, "record", "sync_s", usual.sync_s, 0.1, 3600.0),
        min_free_gb=_number(content, "record", "min_free_gb", usual.min_free_gb, 0.0, 1e5),
        min_free_minutes=_number(content, "record", "min_free_minutes", usual.min_free_minutes, 0.0, 1e5),
        expect_minutes=_number(content, "record", "expect_minutes", usual.expect_minutes, 0.0, 1e5),
        reserve_mb=_number(content, "record", "reserve_mb", usual.reserve_mb, 0.0, 1e5),
    )


def _log(content: Mapping[str, Any], folder: Path) -> LogConfig:
    if "file" not in content:
        raise ValueError("[log] file is missing, expected where the log is written")
    file = folder / _text(content, "log", "file", "")
    usual = LogConfig(file)
    return LogConfig(
        file,
        _number(content, "log", "max_mb", usual.max_mb, 0.01, 1e4),
        _whole(content, "log", "keep", usual.keep, 1, 100),
    )


def _realtime(content: Mapping[str, Any]) -> bool | None:
    value = content.get("realtime", "auto")
    if value != "auto" and not isinstance(value, bool):
        raise ValueError(f'[daemon] realtime is {value!r}, expected true, false or "auto"')
    return None if value == "auto" else value


def _sensor(content: Mapping[str, Any]) -> SensorConfig:
    kind = _text(content, "sensor", "kind", "remote")
    if kind not in SENSOR_KINDS:
        raise ValueError(f"[sensor] kind is {kind!r}, expected one of {', '.join(SENSOR_KINDS)}")
    if "device" not in content:
        raise ValueError("[sensor] device is missing, expected the address of the sensor")
    device = _text(content, "sensor", "device", "")
    chip = CHIPS.get(kind)
    own = ("name", "address", "period_ms", *chip.settings) if chip is not None else ()
    strange = [key for key in content if key not in ("kind", "device", *own)]
    if strange:
        raise ValueError(
            f"[sensor] {strange[0]} does not go with kind {kind!r}, expected device {' '.join(own)}".strip()
        )
    if chip is None:
        return SensorConfig(kind, device)
    try:
        bus_number(device)
    except AnnulusError as error:
        raise ValueError(f"[sensor] device is {error}") from None
    name = _text(content, "sensor", "name", chip.name)
    if not NAME.fullmatch(name):
        raise ValueError(f"[sensor] name is {name!r}, expected letters, digits, . _ -, at most 32")
    settings = {k: _number(content, "sensor", k, 0.0, *chip.settings[k]) for k in chip.settings if k in content}
    period = _number(content, "sensor", "period_ms", PERIOD_MS, 5.0, 10_000.0)
    return SensorConfig(
        kind, device, name, _whole(content, "sensor", "address", chip.address, 0x03, 0x77), period, settings
    )


def _sectors(content: Mapping[str, Any]) -> SectorsConfig:
    usual = SectorsConfig()
    return SectorsConfig(
        _number(content, "sectors", "air_pf", usual.air_pf, 0.01, 1e3),
        _number(content, "sectors", "coupling_ff", usual.coupling_ff, 1.0, 1e4),
        _number(content, "sectors", "ahead_mm", usual.ahead_mm, -2000.0, 2000.0),
    )


def _sensors(data: Mapping[str, Any]) -> tuple[SensorConfig, ...]:
    sensors = tuple(_sensor(content) for content in _several(data, "sensor"))
    chips = [one for one in sensors if one.kind in CHIPS]
    for what, taken in (
        ("name", [one.name for one in chips]),
        ("address", [f"0x{one.address:02x} on {one.device}" for one in chips]),
    ):
        twice = [one for one in taken if taken.count(one) > 1]
        if twice:
            raise ValueError(f"[sensor] {what} {twice[0]} is there twice, expected one a chip")
    return sensors


def _socket(data: Mapping[str, Any], section: str, folder: Path) -> SocketConfig | None:
    address = _optional(data, section, "address")
    keys = _keys(data.get(section, {}), section, folder)
    return None if address is None else SocketConfig(address, keys)


def _keys(content: Mapping[str, Any], section: str, folder: Path) -> Keys | None:
    """The key file holds the server's secret key, 40 characters of Z85, and nothing else."""
    if "key_file" not in content:
        return None
    path = folder / _text(content, section, "key_file", "")
    public, secret = curve_pair(path, "the daemon's")
    viewers = content.get("viewers", [])
    if not isinstance(viewers, list) or not all(isinstance(key, str) for key in viewers):
        raise ValueError(f"[{section}] viewers must be a list of public keys")
    return Keys(public, secret, frozenset(viewers))


def _optional(data: Mapping[str, Any], section: str, key: str) -> str | None:
    content = data.get(section, {})
    return _text(content, section, key, "") if key in content else None


def _text(content: Mapping[str, Any], section: str, key: str, default: str) -> str:
    value = content.get(key, default)
    if not isinstance(value, str) or (key in content and not value):
        raise ValueError(f"[{section}] {key} is {shown(value)}, expected a text")
    return value


def _flag(content: Mapping[str, Any], section: str, key: str, default: bool) -> bool:
    value = content.get(key, default)
    if not isinstance(value, bool):
        raise ValueError(f"[{section}] {key} is {shown(value)}, expected true or false")
    return value


def _number(content: Mapping[str, Any], section: str, key: str, default: float, low: float, high: float) -> float:
    value = content.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"[{section}] {key} is {shown(value)}, expected a number in {low:g}..{high:g}")
    if not low <= value <= high:
        raise ValueError(f"[{section}] {key} is {value:g}, expected a number in {low:g}..{high:g}")
    return float(value)


def _bound(content: Mapping[str, Any], section: str, key: str, default: float, low: float, high: float) -> float:
    """A number in low..high, or 0 for no bound."""
    value = _number(content, section, key, default, 0.0, high)
    if 0.0 < value < low:
        raise ValueError(f"[{section}] {key} is {value:g}, expected 0 or a number in {low:g}..{high:g}")
    return value


def _whole(content: Mapping[str, Any], section: str, key: str, default: int, low: int, high: int) -> int:
    value = _number(content, section, key, default, low, high)
    if value % 1:
        raise ValueError(f"[{section}] {key} is {value:g}, expected a whole number in {low}..{high}")
    return int(value)
