"""Raw acoustic data on disk: HDF5 in the IPASC photoacoustic format, or NumPy's .npz (forms: README.md beside this)."""

import math
import re
import uuid
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.extras import need
from annulus_pipe.storage.arrays import require_plain_hdf5, require_plain_npz
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.vocabulary import AnnulusError

POSITIONS_MAX, SAMPLES_MAX, VALUES_MAX = 8192, 1 << 22, 1 << 29
ROUND = 0.05  # of the radius: so far may receivers stand off their common circle
TEXT_MAX = 4096


@dataclass(frozen=True, slots=True, eq=False)
class AcousticRecord:
    """One turn of the stage as recorded: `signals` (positions, samples) and where and when each was heard.

    `code` and `chip_s` say what was sent, empty and None where nobody said; `sound_speed_m_s` likewise. `extra` is
    whatever else the writer wanted kept, plain texts and numbers.
    """

    signals: NDArray[np.float32]
    angles_deg: NDArray[np.float64]  # from +x towards +y
    radius_mm: float
    sampling_rate_hz: float
    t0_s: float = 0.0
    sound_speed_m_s: float | None = None
    code: str = ""
    chip_s: float | None = None
    averages: int = 1
    extra: Mapping[str, str | float] = field(default_factory=dict)


def save_acoustic(path: Path, record: AcousticRecord) -> None:
    """Writes .npz, or IPASC for .h5 and .hdf5. The file appears whole or not at all."""
    if path.suffix not in (".npz", ".h5", ".hdf5"):
        raise AnnulusError(f"{path}: expected a name ending in .hdf5, .h5 (IPASC) or .npz")
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as file:
        if path.suffix == ".npz":
            np.savez(file, **_named(record))
        else:
            with need("h5py").File(file, "w") as root:
                _write_ipasc(root, record)


def load_acoustic(path: Path) -> AcousticRecord:
    """Reads what `save_acoustic` writes, and IPASC files of others whose receivers stand on a circle.

    Raises AnnulusError naming file and key for a missing, cut short, foreign or senseless file.
    """
    if not path.is_file():
        raise AnnulusError(f"{path}: {'not a file' if path.exists() else 'no such file'}")
    try:
        if path.suffix == ".npz":
            require_plain_npz(path)
            with np.load(path, allow_pickle=False) as data:
                return _from_npz(path, data)
        if path.suffix in (".h5", ".hdf5"):
            with need("h5py").File(path, "r") as root:
                require_plain_hdf5(root)
                return _read_ipasc(path, root)
    except (
        zipfile.BadZipFile,
        zlib.error,
        EOFError,
        OSError,
        ArithmeticError,
        AttributeError,
        RuntimeError,
        SystemError,  # of numpy, for text of no characters
        ValueError,
        LookupError,
        TypeError,
    ) as error:
        what = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise AnnulusError(f"{path}: cannot be read as acoustic data ({what}); cut short or of another kind?") from None
    raise AnnulusError(f"{path}: expected a file ending in .hdf5, .h5 (IPASC) or .npz")


def _named(record: AcousticRecord) -> dict[str, Any]:
    named: dict[str, Any] = {
        "signals": record.signals,
        "angles_deg": record.angles_deg,
        "radius_mm": record.radius_mm,
        "sampling_rate_hz": record.sampling_rate_hz,
        "t0_s": record.t0_s,
        "code": record.code,
        "averages": record.averages,
    }
    if record.sound_speed_m_s is not None:
        named["sound_speed_m_s"] = record.sound_speed_m_s
    if record.chip_s is not None:
        named["chip_s"] = record.chip_s
    return named | {f"extra_{key}": value for key, value in record.extra.items()}


def _from_npz(path: Path, data: Mapping[str, Any]) -> AcousticRecord:
    for key in ("signals", "angles_deg", "radius_mm", "sampling_rate_hz"):
        if key not in data:
            raise AnnulusError(f'{path}: "{key}" is missing; there are {", ".join(sorted(data)) or "no arrays"}')
    extra = {key[6:]: _plain(data[key]) for key in data if key.startswith("extra_")}
    return _checked(
        path,
        data["signals"],
        data["angles_deg"],
        _number(path, data, "radius_mm"),
        _number(path, data, "sampling_rate_hz"),
        _number(path, data, "t0_s", 0.0),
        _number(path, data, "sound_speed_m_s", None),
        _text(data.get("code", "")),
        _number(path, data, "chip_s", None),
        int(_number(path, data, "averages", 1.0) or 1),
        extra,
    )


def _write_ipasc(root: Any, record: AcousticRecord) -> None:
    positions, samples = record.signals.shape
    root.create_dataset(
        "binary_time_series_data", data=record.signals.astype(np.float32).reshape(positions, samples, 1, 1)
    )
    device = str(uuid.uuid5(uuid.NAMESPACE_URL, "annulus thermoacoustic bench"))
    meta: dict[str, Any] = {
        "uuid": str(uuid.uuid4()),
        "encoding": "raw",
        "compression": "none",
        "data_type": "float",
        "dimensionality": "time and space",
        "sizes": np.array([positions, samples, 1, 1]),
        "photoacoustic_imaging_device_reference": device,
        "ad_sampling_rate": float(record.sampling_rate_hz),
        "measurements_per_image": positions,
        "scanning_method": "rotating stage, one receiver",
        # not of the consensus: what makes a coded shot readable
        "annulus_t0_s": float(record.t0_s),
        "annulus_radius_mm": float(record.radius_mm),
        "annulus_angles_deg": record.angles_deg,
        "annulus_code": record.code,
        "annulus_averages": record.averages,
    }
    if record.sound_speed_m_s is not None:
        meta["speed_of_sound"] = float(record.sound_speed_m_s)
    if record.chip_s is not None:
        meta["annulus_chip_s"] = float(record.chip_s)
    meta |= {f"annulus_extra_{key}": value for key, value in record.extra.items()}
    for key, value in meta.items():
        root[f"meta_data/{key}"] = value
    reach = record.radius_mm * 1e-3
    root["meta_data_device/general/unique_identifier"] = device
    root["meta_data_device/general/field_of_view"] = np.array([-reach, reach, -reach, reach, 0.0, 0.0])
    root["meta_data_device/general/num_detectors"] = positions
    root["meta_data_device/general/num_illuminators"] = 1
    turn = np.radians(record.angles_deg)
    place = reach * np.stack([np.cos(turn), np.sin(turn), np.zeros(positions)], axis=1)
    for i in range(positions):
        group = f"meta_data_device/detectors/deadbeef{i:08d}"
        root[f"{group}/detector_position"] = place[i]
        root[f"{group}/detector_orientation"] = -place[i] / reach
        root[f"{group}/detector_geometry"] = np.zeros(3)
        root[f"{group}/detector_geometry_type"] = "CUBOID"
    group = "meta_data_device/illuminators/microwave"
    root[f"{group}/illuminator_position"] = np.zeros(3)
    root[f"{group}/illuminator_orientation"] = np.array([0.0, 0.0, 1.0])
    root[f"{group}/illuminator_geometry"] = np.zeros(3)
    root[f"{group}/illuminator_geometry_type"] = "CUBOID"
    if record.chip_s is not None:
        root[f"{group}/pulse_width"] = float(record.chip_s)


def _read_ipasc(path: Path, root: Any) -> AcousticRecord:
    for key in ("binary_time_series_data", "meta_data/ad_sampling_rate", "meta_data_device/detectors"):
        if key not in root:
            raise AnnulusError(f'{path}: "{key}" is missing; expected HDF5 in the IPASC format')
    data = root["binary_time_series_data"]
    if not isinstance(data, need("h5py").Dataset) or data.ndim < 2 or data.size > VALUES_MAX:
        raise AnnulusError(
            f"{path}: binary_time_series_data has shape {getattr(data, 'shape', None)}, "
            "expected (detectors, samples, ..)"
        )
    meta = root["meta_data"]
    detectors = root["meta_data_device/detectors"]
    names = sorted(detectors, key=_counted)
    if len(names) > POSITIONS_MAX:
        raise AnnulusError(f"{path}: {len(names)} detectors, expected at most {POSITIONS_MAX}")
    if "annulus_angles_deg" in meta:
        angles, radius = np.asarray(meta["annulus_angles_deg"][()], float), float(meta["annulus_radius_mm"][()])
    else:
        place = np.array(
            [np.asarray(detectors[name]["detector_position"][()], float).reshape(-1)[:3] for name in names]
        )
        angles, radius = _on_circle(path, place * 1e3)
    values = np.asarray(data[()], np.float64)
    while values.ndim > 2:  # wavelengths and repeated frames: averaged, as one would by hand
        values = values.mean(axis=-1)
    if values.shape[0] != len(angles) and values.shape[1] == len(angles):
        values = values.T
    number = {key: float(np.asarray(meta[key][()]).reshape(-1)[0]) for key in ("ad_sampling_rate",)}
    speed = meta.get("speed_of_sound")
    extra = {key[14:]: _plain(meta[key][()]) for key in meta if key.startswith("annulus_extra_")}
    return _checked(
        path,
        values,
        angles,
        radius,
        number["ad_sampling_rate"],
        float(meta.get("annulus_t0_s", np.zeros(()))[()]),
        None if speed is None or np.size(speed[()]) != 1 or isinstance(speed[()], bytes) else float(speed[()]),
        _text(meta["annulus_code"][()] if "annulus_code" in meta else ""),
        float(meta["annulus_chip_s"][()]) if "annulus_chip_s" in meta else None,
        int(meta["annulus_averages"][()]) if "annulus_averages" in meta else 1,
        extra,
    )


def _counted(name: str) -> tuple[int, str]:
    """HDF5 lists names as texts, element 10 before element 2; the data are in the order of their numbers."""
    digits = re.search(r"(\d+)$", name)
    return (int(digits[1]) if digits else 0, name)


def _on_circle(path: Path, place_mm: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Angles and radius of receivers about the centre of the circle that fits them best."""
    if len(place_mm) < 3 or not np.isfinite(place_mm).all():
        raise AnnulusError(f"{path}: {len(place_mm)} detector positions, expected at least 3 finite ones")
    spread = place_mm.std(axis=0)
    flat = place_mm[:, np.sort(np.argsort(spread)[-2:])] if place_mm.shape[1] > 2 else place_mm
    rows = np.column_stack([2 * flat, np.ones(len(flat))])
    solution, _, rank, _ = np.linalg.lstsq(rows, (flat**2).sum(axis=1), rcond=None)
    centre = solution[:2]
    radius = math.sqrt(max(float(solution[2] + centre @ centre), 0.0))
    off = np.abs(np.hypot(*(flat - centre).T) - radius)
    if rank < 3 or radius <= 0 or float(off.max()) > ROUND * radius:
        raise AnnulusError(
            f"{path}: the detectors do not stand on a circle; expected a ring or an arc about the object"
        )
    if np.hypot(*centre) < 0.02 * radius:  # a ring about the origin is meant to be about the origin
        centre, radius = np.zeros(2), float(np.hypot(*flat.T).mean())
    return np.degrees(np.arctan2(flat[:, 1] - centre[1], flat[:, 0] - centre[0])), radius


def _checked(
    path: Path,
    signals: Any,
    angles: Any,
    radius: float | None,
    rate: float | None,
    t0: float | None,
    speed: float | None,
    code: str,
    chip: float | None,
    averages: int,
    extra: Mapping[str, str | float],
) -> AcousticRecord:
    values, turn = np.asarray(signals), np.asarray(angles, float).reshape(-1)
    if values.ndim != 2 or values.dtype.kind not in "fiu" or values.size > VALUES_MAX:
        raise AnnulusError(
            f"{path}: signals of shape {values.shape} and type {values.dtype}, expected numbers (positions, samples)"
        )
    if not (1 <= len(values) <= POSITIONS_MAX and 16 <= values.shape[1] <= SAMPLES_MAX):
        raise AnnulusError(
            f"{path}: {len(values)} positions of {values.shape[1]} samples, "
            f"expected 1..{POSITIONS_MAX} of 16..{SAMPLES_MAX}"
        )
    if len(turn) != len(values) or not np.isfinite(turn).all():
        raise AnnulusError(f"{path}: {len(turn)} angles for {len(values)} traces, expected one finite number each")
    assert radius is not None and rate is not None and t0 is not None
    for name, value, low, high in (
        ("radius_mm", radius, 0.1, 1e4),
        ("sampling_rate_hz", rate, 1e3, 1e11),
        ("t0_s", t0, -1.0, 1.0),
        ("sound_speed_m_s", speed, 100.0, 1e4),
        ("chip_s", chip, 1e-8, 1e-3),
    ):
        if value is not None and not (math.isfinite(value) and low <= value <= high):
            raise AnnulusError(f"{path}: {name} is {value:g}, expected {low:g}..{high:g}")
    return AcousticRecord(values.astype(np.float32), turn, radius, rate, t0, speed, code, chip, max(averages, 1), extra)


def _number(path: Path, data: Mapping[str, Any], key: str, default: float | None = math.nan) -> float | None:
    if key not in data:
        return default
    value = np.asarray(data[key])
    if value.size != 1 or value.dtype.kind not in "fiu":
        raise AnnulusError(f'{path}: "{key}" has shape {value.shape} and type {value.dtype}, expected one number')
    return float(value.reshape(-1)[0])


def _text(value: Any) -> str:
    value = value.item() if isinstance(value, np.ndarray | np.generic) else value
    return (value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value))[:TEXT_MAX]


def _plain(value: Any) -> str | float:
    array = np.asarray(value)
    return float(array.reshape(-1)[0]) if array.dtype.kind in "fiub" and array.size == 1 else _text(value)
