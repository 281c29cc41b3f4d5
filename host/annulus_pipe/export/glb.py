"""The wall as one coloured surface in a GLB: glTF 2.0, metres, y up; no package needed.

glTF's colours of vertices are linear light and the mesh's are what a screen is given, so they are turned; the material
shines nowhere and has two sides, for one looks at a pipe from inside and outside. What it is from stands in the extras
of the scene.
"""

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.export.axes import Y_UP, in_space, y_up
from annulus_pipe.export.results import Results
from annulus_pipe.vocabulary import AnnulusError

CHUNK = 1 << 18  # points or faces
UNKNOWN_MM = -9999.0  # glTF has no NaN
BYTES_MAX = (1 << 32) - (1 << 20)  # of a GLB, whose length is 32 bits
_FLOAT, _U32 = 5126, 5125
_SCREEN = np.arange(256) / 255.0  # what a screen is given (sRGB), as light:
_LIGHT = np.where(_SCREEN <= 0.04045, _SCREEN / 12.92, ((_SCREEN + 0.055) / 1.055) ** 2.4).astype("<f4")
_VERTICES, _CORNERS = 34962, 34963  # what a buffer view is for


def write(results: Results, path: Path) -> None:
    mesh = results.mesh
    count, corners = len(mesh.vertices), mesh.faces.size
    if not corners:
        raise AnnulusError(f"{results.folder / 'mesh.ply'}: has no faces, expected the wall's triangles")
    sizes = (12 * count, 12 * count, 4 * count, 4 * corners)
    if sum(sizes) > BYTES_MAX:
        raise AnnulusError(f"{results.folder / 'mesh.ply'}: {count} points are more than a GLB of 4 GB holds")
    views, at = [], 0
    for size, target in zip(sizes, (_VERTICES, _VERTICES, _VERTICES, _CORNERS), strict=True):
        views.append({"buffer": 0, "byteOffset": at, "byteLength": size, "target": target})
        at += size

    def places(part: NDArray[np.void]) -> NDArray[np.float32]:
        return (1e-3 * y_up(in_space(part, results.folder / "mesh.ply"))).astype("<f4")

    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for part in _parts(mesh.vertices):
        points = places(part)
        low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    tree = _tree(results, views, at)
    tree["accessors"] = [
        {
            "bufferView": 0,
            "componentType": _FLOAT,
            "count": count,
            "type": "VEC3",
            "min": low.tolist(),
            "max": high.tolist(),
        },
        {"bufferView": 1, "componentType": _FLOAT, "count": count, "type": "VEC3"},
        {"bufferView": 2, "componentType": _FLOAT, "count": count, "type": "SCALAR"},
        {"bufferView": 3, "componentType": _U32, "count": corners, "type": "SCALAR"},
    ]
    head = json.dumps(tree, ensure_ascii=False).encode()
    head += b" " * (-len(head) % 4)
    with path.open("wb") as file:
        file.write(b"glTF" + struct.pack("<II", 2, 12 + 8 + len(head) + 8 + at))
        file.write(struct.pack("<I", len(head)) + b"JSON" + head)
        file.write(struct.pack("<I", at) + b"BIN\0")
        for of in (places, _colours, _deviations):
            for part in _parts(mesh.vertices):
                file.write(of(part).tobytes())
        for part in _parts(mesh.faces):
            file.write(part.astype("<u4").tobytes())


def _parts(array: NDArray[Any]) -> Iterator[NDArray[Any]]:
    """A part at a time, so that memory does not grow with the mesh."""
    for at in range(0, len(array), CHUNK):
        yield np.asarray(array[at : at + CHUNK])


def _colours(part: NDArray[np.void]) -> NDArray[np.float32]:
    return np.stack([_LIGHT[part[name]] for name in ("red", "green", "blue")], axis=1)


def _deviations(part: NDArray[np.void]) -> NDArray[np.float32]:
    return np.asarray(np.where(np.isfinite(part["quality"]), part["quality"], UNKNOWN_MM), "<f4")


def _tree(results: Results, views: list[dict[str, int]], size: int) -> dict[str, Any]:
    about = {
        "axes": Y_UP,
        "unit": "m",
        "_DEVIATION": "of the radius, mm, outwards positive; -9999 where not known",
        "source": results.source,
        "created": results.created,
        "job": dict(results.job),
    }
    attributes = {"POSITION": 0, "COLOR_0": 1, "_DEVIATION": 2}
    return {
        "asset": {"version": "2.0", "generator": results.made_by},
        "scene": 0,
        "scenes": [{"name": "pipe", "nodes": [0], "extras": about}],
        "nodes": [{"name": "pipe wall", "mesh": 0}],
        "meshes": [
            {"name": "pipe wall", "primitives": [{"attributes": attributes, "indices": 3, "material": 0, "mode": 4}]}
        ],
        "materials": [
            {"name": "wall", "doubleSided": True, "pbrMetallicRoughness": {"metallicFactor": 0, "roughnessFactor": 1}}
        ],
        "bufferViews": views,
        "buffers": [{"byteLength": size}],
    }
