"""PLY files, binary little-endian, straight from numpy records."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_NAMES = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int", "u4": "uint"}


def write_ply(
    path: Path, vertices: NDArray[np.void], triangles: NDArray[np.int32] | None = None, note: str = ""
) -> None:
    """Write (N,) records as vertices, their field names as properties, and (M, 3) vertex indices as faces."""
    lines = ["ply", "format binary_little_endian 1.0"]
    if note:
        lines.append("comment " + " ".join(note.split()))
    lines.append(f"element vertex {len(vertices)}")
    fields = vertices.dtype.descr
    lines += [f"property {_NAMES[str(kind).lstrip('<|')]} {name}" for name, kind, *_ in fields]
    if triangles is not None:
        lines += [f"element face {len(triangles)}", "property list uchar int vertex_indices"]
    lines.append("end_header\n")
    with path.open("wb") as file:
        file.write("\n".join(lines).encode("ascii", "replace"))
        file.write(vertices.tobytes())
        if triangles is not None:
            faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corner", "<i4", 3)])
            faces["count"], faces["corner"] = 3, triangles
            file.write(faces.tobytes())
