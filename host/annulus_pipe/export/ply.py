"""PLY files as `reconstruct` writes them, read without a copy: their head is believed only as far as the file is long.

ValueError, one line, on anything else.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.untrusted import shown

HEAD_MAX = 1 << 14  # bytes; ours have 500
COUNT_MAX = 1 << 31  # vertices or faces
_KINDS = {
    "char": "i1",
    "uchar": "u1",
    "short": "<i2",
    "ushort": "<u2",
    "int": "<i4",
    "uint": "<u4",
    "float": "<f4",
    "double": "<f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "float32": "<f4",
    "float64": "<f8",
}
_FACE = np.dtype([("count", "u1"), ("corner", "<i4", 3)])
_CORNERS = {"property list uchar int vertex_indices", "property list uint8 int32 vertex_indices"}


@dataclass(frozen=True, slots=True)
class Ply:
    """vertices (N,) records on disk; faces (M, 3) vertex indices on disk, none of a cloud."""

    vertices: NDArray[np.void]
    faces: NDArray[np.int32]


def open_ply(path: Path, fields: tuple[str, ...]) -> Ply:
    """Map a little-endian PLY of vertices with at least these scalar properties, and triangles."""
    if not path.is_file():
        raise ValueError(_why_not(path))
    with path.open("rb") as file:
        head = file.read(HEAD_MAX)
    end = head.find(b"end_header\n")
    if not head.startswith(b"ply\n") or end < 0:
        raise ValueError("not a PLY file")
    begin = end + len(b"end_header\n")
    vertices, faces, kind = _counts(head[:end].decode("ascii", "replace").split("\n")[1:])
    missing = [name for name in fields if name not in (kind.names or ())]
    if missing:
        raise ValueError(f"its points have no {missing[0]}, expected {', '.join(fields)}")
    need = begin + vertices * kind.itemsize + faces * _FACE.itemsize
    size = path.stat().st_size
    if size != need:
        raise ValueError(f"says {vertices} points and {faces} faces, {need} bytes, and has {size}")
    if not vertices:
        raise ValueError("has no points")
    points = np.memmap(path, dtype=kind, mode="r", offset=begin, shape=(vertices,))
    corners = np.empty((0, 3), np.int32)
    if faces:
        found = np.memmap(path, dtype=_FACE, mode="r", offset=need - faces * _FACE.itemsize, shape=(faces,))
        for at in range(0, faces, 1 << 20):
            part = found[at : at + (1 << 20)]
            if (part["count"] != 3).any():
                raise ValueError("has faces that are no triangles")
            if part["corner"].min() < 0 or part["corner"].max() >= vertices:
                raise ValueError("has faces whose corners are not there")
        corners = found["corner"]
    return Ply(points, corners)


def _counts(lines: list[str]) -> tuple[int, int, np.dtype[np.void]]:
    """Vertices, faces and a vertex's record, of a head's lines."""
    count = {"vertex": 0, "face": 0}
    properties: list[tuple[str, str]] = []
    element, order = "", []
    for line in lines:
        words = line.split()
        match words:
            case [] | ["comment", *_]:
                continue
            case ["format", form, _]:
                if form != "binary_little_endian":
                    raise ValueError(f"is {shown(form)}, expected binary_little_endian")
            case ["element", "vertex" | "face" as element, number]:
                if not (number.isascii() and number.isdigit() and len(number) < 11 and int(number) <= COUNT_MAX):
                    raise ValueError(f"says it has {shown(number)} of {element}")
                count[element] = int(number)
                order.append(element)
            case ["property", kind, name] if element == "vertex" and kind in _KINDS:
                properties.append((name, _KINDS[kind]))
            case ["property", *_] if element == "face" and line in _CORNERS:
                continue
            case _:
                raise ValueError(f"has {shown(line)} in its head")
    if order not in (["vertex"], ["vertex", "face"]):
        raise ValueError("expected vertices, and after them faces or nothing")
    if len({name for name, _ in properties}) < len(properties) or len(properties) > 100:
        raise ValueError("names a property twice, or more than 100")
    return count["vertex"], count["face"], np.dtype(properties)


def _why_not(path: Path) -> str:
    if path.exists():
        return "not a file"
    if (path.parent / "windows").is_dir():
        return "is not there: of a long pipe each folder in windows has its own, to be exported by itself"
    return "is not there"
