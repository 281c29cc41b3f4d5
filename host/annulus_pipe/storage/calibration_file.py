"""calibration.json on disk."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeVar

from annulus_pipe.geometry.calibration import CAMERAS, ONE_CAMERA, Calibration, camera_alone, several_cameras
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.storage.place import Where, read_whole
from annulus_pipe.storage.whole import written_whole
from annulus_pipe.untrusted import parse_json
from annulus_pipe.vocabulary import AnnulusError

Part = TypeVar("Part")

FINGERPRINT_DIGITS = 16  # 64 bits: people compare them, and nobody forges a calibration
SIZE_MAX = 4 << 20  # per-direction fine-tuning of a dozen rings stays far below


def load_calibration(path: Where) -> Calibration:
    """The calibration in a file of format annulus-calibration/1 or /2. Raises AnnulusError naming file and key."""
    data = _read(path)
    try:
        return Calibration.from_dict(data)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None


def fingerprint(calibration: Calibration) -> str:
    """What tells a calibration from every other, whichever file has it: the first digits of its numbers' SHA-256."""
    numbers = json.dumps(calibration.to_dict(), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(numbers.encode()).hexdigest()[:FINGERPRINT_DIGITS]


def require_size(calibration: Calibration, sizes: Sequence[tuple[int, int]]) -> None:
    """Raises AnnulusError when the calibration is of cameras of other sizes, or of more than the head has."""
    for one in calibration.cameras:
        if one.id >= len(sizes):
            raise AnnulusError(f"calibration knows a camera {one.id}, but the head has {len(sizes)}, from 0")
        (width, height), camera = sizes[one.id], one.camera
        if (camera.width, camera.height) != (width, height):
            raise AnnulusError(
                f"calibration is for {camera.width}x{camera.height} but the camera gives {width}x{height}. "
                "Calibrate with the camera in use."
            )


def load_sections(path: Where) -> dict[str, Any]:
    """All sections of a calibration that may be in the making, unchecked. Raises AnnulusError naming the file."""
    data = _read(path)
    if not isinstance(data, dict):
        raise AnnulusError(f"{path}: not a JSON object. Expected a calibration.json.")
    return data


def load_camera(path: Path) -> Camera:
    """The one camera of a file that may have no rings yet. Raises AnnulusError naming file and key."""
    data = _read(path)
    if not isinstance(data, dict) or not {"camera", "cameras"} & data.keys():
        raise AnnulusError(f'{path}: has no "camera". Make one with `annulus calibrate camera`.')
    try:
        return camera_alone(data)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None


def projects_rings(file: Path) -> bool:
    """Whether a calibration.json has a slide of rings, in a pipe. AnnulusError where it cannot be read."""
    pattern = load_sections(file).get("pattern")
    slide = pattern.get("projector") if isinstance(pattern, dict) else None
    return isinstance(slide, dict) and slide.get("kind") == "rings"


def update_calibration(
    path: Path, sections: Mapping[str, Any], provenance: Mapping[str, Any] | None = None
) -> tuple[str, ...]:
    """Replace these sections of the file and keep its others; a new file gets only these.

    A section given as None is taken out; so is "wall" where other rings come, as it says what a wall has beyond the old
    ones. `provenance`: how each section came about, kept under "provenance" by the section's name, with the time; what
    was said of a section that is replaced by another goes. Returns the names of the sections that were kept as they
    are. Raises AnnulusError when the file is there but is no calibration of one camera, or cannot be written.
    """
    data = _read(path) if path.exists() else {}
    listed = "cameras" in sections  # a head that format 1 has no words for, though of one camera
    several = several_cameras(data) and several_cameras(sections)
    if isinstance(data, dict) and data.get("format") == CAMERAS and not (listed and (several or _has_one_camera(data))):
        raise AnnulusError(f'{path}: is of a head with several cameras ("{CAMERAS}"). Choose another file.')
    if not isinstance(data, dict) or data.get("format", ONE_CAMERA) not in (ONE_CAMERA, CAMERAS):
        raise AnnulusError(f'{path}: is there but is not "{ONE_CAMERA}". Choose another file or move it away.')
    if "rings" in sections and sections["rings"] != data.get("rings"):
        sections = {"wall": None, **sections}
    before = data.get("provenance")
    replaced = {key for key, section in sections.items() if data.get(key) != section}
    still = {key: made for key, made in (before if isinstance(before, dict) else {}).items() if key not in replaced}
    now = datetime.now(UTC).isoformat(timespec="seconds")
    origins = {**still, **{key: {**made, "utc": now} for key, made in (provenance or {}).items()}}
    if listed:
        data.pop("camera", None)
    merged = {"format": None, **data, **sections, "provenance": origins or None}
    merged["format"] = CAMERAS if listed else ONE_CAMERA
    _write(path, {key: value for key, value in merged.items() if value is not None})
    return tuple(key for key in data if key not in {*sections, "format", "provenance"})


def _has_one_camera(data: object) -> bool:
    try:
        camera_alone(data)
    except ValueError:
        return False
    return True


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write the file whole or not at all. Raises AnnulusError when it cannot be written."""
    _write(path, calibration.to_dict())


def load_part(path: Where, parse: Callable[[object], Part], made_by: str) -> Part:
    """A file beside the calibration (a pipe's colours, a reference), parsed by what raises ValueError naming the key.

    made_by: the command that makes such files. Raises AnnulusError naming file and key.
    """
    data = _read(path, f"a file made by `{made_by}`")
    try:
        return parse(data)
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}. Expected a file made by `{made_by}`.") from None


def save_part(path: Path, data: Mapping[str, Any]) -> None:
    """Write such a file whole or not at all. Raises AnnulusError when it cannot be written."""
    _write(path, data)


def _read(path: Where, expected: str = "the calibration.json of the head that scanned") -> Any:
    try:
        return parse_json(read_whole(path, SIZE_MAX), SIZE_MAX)
    except FileNotFoundError:
        raise AnnulusError(f"{path}: no such file. Expected {expected}.") from None
    except IsADirectoryError:
        raise AnnulusError(f"{path}: is a folder. Expected {expected}.") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}). Expected {expected}.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}. Expected {expected}.") from None


def _write(path: Path, data: object) -> None:
    """A number that nobody knows becomes null, as `_read` asks."""
    try:
        with written_whole(path) as file:
            file.write(f"{json.dumps(_known(data), indent=1, allow_nan=False)}\n".encode())
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be written ({error.strerror}).") from None


def _known(data: object) -> object:
    if isinstance(data, Mapping):
        return {key: _known(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_known(value) for value in data]
    return None if isinstance(data, float) and not math.isfinite(data) else data
