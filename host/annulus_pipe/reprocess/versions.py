"""What profiles follow from besides the scan: the code that measures, what it calls, and values told apart to the bit.

Two machines with one `measured_with()` make the same of the same frames; whose differ are not to work on one scan.
"""

import dataclasses
import enum
import functools
import hashlib
import platform
from collections.abc import Iterable, Mapping
from importlib import import_module, resources
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from annulus_pipe.numeric import native

ROOMS = (
    "numeric",
    "geometry",
    "wall",
    "rings",
    "stereo",
    "stream",
    "capture",
    "storage",
    "record",
    "scans",
    "reprocess",
)
FILES = ("vocabulary.py", "untrusted.py")  # beside the rooms
PACKAGES = ("numpy", "cv2", "scipy", "zstandard")


@functools.cache
def measured_with() -> Mapping[str, str]:
    """Digest of the sources of all rooms between a frame and its profile, versions of what they call."""
    versions = {"annulus": _sources(), "loops": native.built_from()}
    versions |= {name: str(import_module(name).__version__) for name in PACKAGES}
    versions["python"] = ".".join(platform.python_version_tuple()[:2])
    versions["machine"] = platform.machine()
    return versions


@functools.cache
def processor() -> str:
    """The kind of it. The loops in C are the same bits on all; a sum of numpy's may end in another bit on another."""
    return native.level()


def differing(one: Mapping[str, str], other: Mapping[str, str]) -> str:
    """What two `measured_with` differ in, in words; empty where they agree."""
    names = [name for name in {**one, **other} if one.get(name) != other.get(name)]
    return ", ".join(f"{name} {other.get(name, 'unknown')} for {one.get(name, 'unknown')}" for name in names)


@functools.cache
def made_with() -> Mapping[str, str]:
    """The same of whole results: of all rooms, and what draws and writes."""
    root = Path(str(resources.files("annulus_pipe")))
    versions = {name: str(import_module(name).__version__) for name in ("matplotlib", "PIL")}
    return {**measured_with(), **versions, "annulus": _digest(root, root.rglob("*.py"))}


def _sources() -> str:
    root = Path(str(resources.files("annulus_pipe")))
    return _digest(root, [root / name for name in FILES] + [p for room in ROOMS for p in (root / room).rglob("*.py")])


@functools.cache
def digest_of(folder: str) -> str:
    """Of the sources in a folder of the package: what a wing measures with."""
    root = Path(str(resources.files("annulus_pipe")))
    return _digest(root, (root / folder).rglob("*.py"))


def _digest(root: Path, paths: Iterable[Path]) -> str:
    digest = hashlib.sha256()
    for path in sorted(paths):
        digest.update(f"{path.relative_to(root).as_posix()} ".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def address(*values: Any) -> str:
    """SHA-256 of values, in hex: of dataclasses by their names and fields, of arrays and numbers to the bit. Paths are
    left out, so that moving a file does not change the address. TypeError for a value of another kind."""
    digest = hashlib.sha256()
    for value in values:
        _feed(digest, value)
    return digest.hexdigest()


def _feed(digest: Any, value: Any) -> None:
    """Every value begins with its kind and its length, so that no two can be run together."""
    if isinstance(value, enum.Enum):
        value = f"{type(value).__name__}.{value.name}"
    if value is None or isinstance(value, PurePath):
        digest.update(b"-")
    elif isinstance(value, bool | int | float | str | np.generic):
        text = repr(value.item() if isinstance(value, np.generic) else value).encode()
        digest.update(f"{type(value).__name__} {len(text)} ".encode() + text)
    elif isinstance(value, bytes):
        digest.update(f"bytes {len(value)} ".encode() + value)
    elif isinstance(value, np.ndarray):
        digest.update(f"array {value.dtype.str} {value.shape} ".encode() + np.ascontiguousarray(value).tobytes())
    elif isinstance(value, tuple | list):
        digest.update(f"row {len(value)} ".encode())
        for one in value:
            _feed(digest, one)
    elif isinstance(value, Mapping):
        digest.update(f"names {len(value)} ".encode())
        for name in sorted(value):
            _feed(digest, name)
            _feed(digest, value[name])
    elif dataclasses.is_dataclass(value):
        fields = dataclasses.fields(value)
        digest.update(f"{type(value).__name__} {len(fields)} ".encode())
        for one in fields:
            _feed(digest, one.name)
            _feed(digest, getattr(value, one.name))
    else:
        raise TypeError(f"a {type(value).__name__} has no address")
