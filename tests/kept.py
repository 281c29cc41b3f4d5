"""Scenes that tests draw, kept in build/scenes by what they are made of: the arguments, and the text of the drawers.

Drawn once on a machine, then read: `picture` for one image, `folder` for a scan. What has a function in it is drawn
each time: a function is known by its name, and may have become another under it.
"""

import contextlib
import functools
import hashlib
import io
import os
import pickle
import shutil
import tempfile
import time
import types
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

ROOT = Path(__file__).resolve().parents[1]
SCENES = ROOT / "build/scenes"
DRAWERS = (
    "host/annulus_pipe",
    "tests/unit/rings/drawn.py",
)  # all of the package: what a drawer imports is in its pictures
OLD_S = 86_400.0  # s; a shelf that nobody took from for a day is of drawers that are gone


class _Content(pickle.Pickler):
    def reducer_override(self, value: object) -> object:
        if isinstance(value, types.FunctionType | types.MethodType):
            raise pickle.PicklingError("a function is no content")
        return NotImplemented


def _digest() -> str:
    digest = hashlib.sha256(f"{np.__version__} {scipy.__version__} {cv2.__version__}\n".encode())
    for path in sorted(one for name in DRAWERS for one in [ROOT / name, *(ROOT / name).rglob("*.py")] if one.is_file()):
        digest.update(f"{path.relative_to(ROOT)}\n".encode() + path.read_bytes())
    return digest.hexdigest()[:16]


DIGEST = _digest()  # of the text that is imported with this, not of one that is edited while tests run


@functools.cache
def _shelf() -> Path:
    """Of what these drawers draw; what older ones drew is taken away."""
    shelf = SCENES / DIGEST
    shelf.mkdir(parents=True, exist_ok=True)
    os.utime(shelf)
    for other in SCENES.iterdir():
        with contextlib.suppress(OSError):
            if time.time() - other.stat().st_mtime > OLD_S:
                shutil.rmtree(other)
    return shelf


def _made(make: Callable[[Path], None], parts: tuple[object, ...]) -> Path | None:
    """Where it lies, made if need be; None for what cannot be known by its content."""
    content = io.BytesIO()
    try:
        _Content(content).dump(parts)
    except (pickle.PicklingError, AttributeError, TypeError):
        return None
    place = _shelf() / hashlib.sha256(content.getvalue()).hexdigest()[:32]
    if not place.exists():
        new = Path(tempfile.mkdtemp(prefix="new-", dir=place.parent))
        try:
            make(new / "it")
            os.rename(new / "it", place)  # whole, or not there
        except OSError:
            if not place.exists():  # another worker was first
                raise
        finally:
            shutil.rmtree(new)
    return place


def picture(draw: Callable[[], NDArray[np.uint8]], *parts: object) -> NDArray[np.uint8]:
    """What `draw` draws from `parts`."""

    def make(path: Path) -> None:
        with path.open("wb") as file:
            np.save(file, draw())

    place = _made(make, ("picture", *parts))
    return draw() if place is None else np.load(place)


def folder(write: Callable[[Path], None], where: Path, *parts: object) -> None:
    """What `write` writes from `parts` into `where`, which must not be there: a copy, to be changed at will."""
    place = _made(write, ("folder", *parts))
    if place is None:
        write(where)
    else:
        shutil.copytree(place, where)
