"""What a viewer is told, as bytes. README.md has the layouts; this is the one place that knows them.

Little-endian; the first byte says the kind. Each is made once, whoever many read it.
"""

import json
import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.vocabulary import Label

STATUS, PICTURE, POINTS, WALL, ROWS, SLITS = range(1, 7)
ANEW, LAST = 1, 2  # flags of points
LABELS = {Label.UNKNOWN.value: 0, Label.PROJECTOR.value: 1, Label.LED.value: 2}
WALLS = {"recent": 0, "whole": 1}

_PICTURE = struct.Struct("<BBBBIfd")
_POINTS = struct.Struct("<BBHII")
_WALL = struct.Struct("<BBHIiffI")
_ROWS = struct.Struct("<BBBBIHH")
_SLITS = struct.Struct("<BBHI")


def status(topic: str, body: Any) -> bytes:
    """JSON, in which what is no number is null, and bytes are left out."""
    try:
        text = json.dumps({"topic": topic, "body": body}, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    except (TypeError, ValueError):
        message = {"topic": topic, "body": plain(body)}
        text = json.dumps(message, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return bytes([STATUS]) + text.encode("utf-8", "replace")


def plain(value: Any) -> Any:
    """What JSON can say of a value that msgpack brought."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(one) for key, one in value.items() if not isinstance(one, bytes | bytearray)}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    return value if isinstance(value, str | int | None) else None


def picture(camera: int, label: int, index: int, z_mm: float | None, published: float, jpeg: bytes) -> bytes:
    """z_mm None: not known. published : Unix time, s."""
    z = math.nan if z_mm is None else z_mm
    return _PICTURE.pack(PICTURE, camera, label, 0, index, z, published) + jpeg


def points(flags: int, frame: int, xyz_mm: NDArray[np.float32], rgb: NDArray[np.uint8]) -> bytes:
    """xyz_mm, rgb : (N, 3)."""
    head = _POINTS.pack(POINTS, flags, 0, frame & 0xFFFFFFFF, len(xyz_mm))
    return head + xyz_mm.astype("<f4", copy=False).tobytes() + rgb.astype(np.uint8, copy=False).tobytes()


def wall(
    of: str, first: int, step_mm: float, radius_mm: float, scan: int, columns: int, rows: Sequence[bytes]
) -> bytes:
    """rows : of 2 x columns bytes each, one beside the other."""
    head = _WALL.pack(WALL, WALLS[of], columns, len(rows), first, step_mm, radius_mm, scan & 0xFFFFFFFF)
    return head + b"".join(rows)


def rows(camera: int, label: int, index: int, light: bytes) -> bytes:
    """light : float32, little-endian."""
    return _ROWS.pack(ROWS, camera, label, 0, index, len(light) // 4, 0) + light


def slits(camera: int, index: int, part: bytes) -> bytes:
    """part : n times int16 x, y, then n times u8 ring."""
    return _SLITS.pack(SLITS, camera, len(part) // 5, index) + part
