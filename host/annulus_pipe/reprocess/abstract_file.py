"""What a window says of the whole (`wall.joined.Abstract`) as one file, and back, the same to the bit: so that a window
that was surveyed and written is found, not surveyed again.

A NumPy archive: its arrays by number, and JSON of all that is between them, a tree of this program's own dataclasses
by name, with a SHA-256 over everything. A file is either all that was written, or it is not read; nothing is imported
or called for what it says but dataclasses and enumerations that are loaded here already.
"""

import enum
import hashlib
import io
import json
import sys
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.storage.arrays import require_plain_npz
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.joined import Abstract

FORMAT = 1
FAST = 1  # of zlib's levels: a fifth of the usual one's time, and a tenth more bytes
_OURS = "annulus_pipe."
_DEEP = 40  # of trees in trees; an abstract's is 8


def packed(abstract: Abstract, about: Mapping[str, Any]) -> bytes:
    """`about` is JSON: what else is to be known of the window."""
    arrays: list[NDArray[Any]] = []
    tree = _tree(abstract, arrays)
    text = json.dumps({"format": FORMAT, "about": about, "tree": tree})
    named = {str(i): array for i, array in enumerate(arrays)}
    named |= {"told": np.array(text), "sha256": np.array(_digest(text, arrays))}
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED, compresslevel=FAST) as archive:
        for name, array in named.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    return out.getvalue()


def unpacked(data: bytes) -> tuple[Abstract, Mapping[str, Any]]:
    """ValueError, one line, where it is not what was written."""
    try:
        require_plain_npz(io.BytesIO(data))
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:
            text, sha256 = str(archive["told"]), str(archive["sha256"])
            arrays = [archive[str(i)] for i in range(len(archive.files) - 2)]
        if sha256 != _digest(text, arrays):
            raise ValueError("its SHA-256 is another")
        whole = json.loads(text)
        value = _value(whole["tree"], arrays) if whole["format"] == FORMAT else None
        if not isinstance(value, Abstract) or not isinstance(whole["about"], dict):
            raise ValueError("of another format")
    except Exception as error:  # of whatever it is instead
        raise ValueError(f"not what was written of a window: {error}") from None
    return value, whole["about"]


def _digest(text: str, arrays: list[NDArray[Any]]) -> str:
    digest = hashlib.sha256(text.encode())
    for array in arrays:
        digest.update(f"{array.dtype.str}{array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _tree(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """As JSON knows it, arrays by their number."""
    if isinstance(value, enum.Enum):
        return {"enum": _name(type(value)), "is": value.name}
    if value is None or type(value) in (bool, int, float, str):
        return value
    if isinstance(value, np.ndarray | np.generic):
        arrays.append(np.asarray(value))
        return {"array" if isinstance(value, np.ndarray) else "number": len(arrays) - 1}
    if isinstance(value, tuple):
        return {"row": [_tree(one, arrays) for one in value]}
    if isinstance(value, Mapping):
        return {"names": [[_tree(key, arrays), _tree(one, arrays)] for key, one in value.items()]}
    if isinstance(value, Centreline):
        return {"line": _tree(value.pieces, arrays)}
    if is_dataclass(value) and all(one.init for one in fields(value)):
        parts = [_tree(getattr(value, one.name), arrays) for one in fields(value)]
        return {"of": _name(type(value)), "fields": parts}
    raise TypeError(f"a {type(value).__name__} cannot be kept")


def _value(tree: Any, arrays: list[NDArray[Any]], deep: int = 0) -> Any:
    """ValueError, KeyError, TypeError for what `_tree` makes nothing like."""
    if deep > _DEEP:
        raise ValueError("too deep")
    if not isinstance(tree, dict):
        return tree
    if "array" in tree:
        return arrays[tree["array"]]
    if "number" in tree:
        return arrays[tree["number"]][()]
    if "row" in tree:
        return tuple(_value(one, arrays, deep + 1) for one in tree["row"])
    if "line" in tree:
        return Centreline(_value(tree["line"], arrays, deep + 1))
    if "names" in tree:
        return {_value(key, arrays, deep + 1): _value(one, arrays, deep + 1) for key, one in tree["names"]}
    kind = _kind(tree["enum"] if "enum" in tree else tree["of"])
    if issubclass(kind, enum.Enum):
        return kind[tree["is"]]
    parts = {one.name: _value(part, arrays, deep + 1) for one, part in zip(fields(kind), tree["fields"], strict=True)}
    return kind(**parts)


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _kind(name: str) -> Any:
    module, _, own = name.partition(":")
    kind = getattr(sys.modules[module], own) if module.startswith(_OURS) else None
    if not isinstance(kind, type) or not (is_dataclass(kind) or issubclass(kind, enum.Enum)):
        raise ValueError("names what is none of its parts")
    return kind
