"""How per-pixel loops are compiled, and the small things they share."""

import hashlib
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import event

from annulus_pipe.numeric import telling

Kernel = TypeVar("Kernel", bound=Callable[..., Any])
Options = dict[str, Any]

# Sums may be regrouped and contracted; NaN keeps its meaning, the loops mark "nothing here" with it.
# Dividing by zero is no exception but inf or NaN, as in numpy: checks for it would keep loops from using vectors.
OPTIONS: Options = {"fastmath": {"contract", "reassoc", "nsz", "arcp"}, "error_model": "numpy", "nogil": True}


def jit_with(options: Options) -> Callable[[Kernel], Kernel]:
    """Compile on first call, keep the machine code on disk: beside the module, or in the user's cache if that is
    read-only. Where nothing can be written the function still works, compiled anew in each process.

    The code on disk is used for as long as neither its own file nor what that one has of others (kernels, constants)
    has changed: also after an upgrade, which leaves the files of old code where they were.
    """

    def compiled(function: Kernel) -> Kernel:
        try:
            kernel = cast(Kernel, numba.njit(cache=True, **options)(function))
        except RuntimeError:  # numba: "no locator available"
            return cast(Kernel, numba.njit(**options)(function))
        _know_by_all_it_uses(kernel)
        return kernel

    return compiled


_stamps: dict[str, str] = {}  # by file: of its content and of all it uses from other files


def _know_by_all_it_uses(kernel: Any) -> None:
    """numba keeps code for as long as the kernel's own file has its time and size, and builds into it what it calls:
    the stamp it compares becomes the content of all of that."""
    kept: Any = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if hasattr(
        kept, "_source_stamp"
    ):  # else a numba that has it elsewhere: it looks at the own file alone, a test tells
        kept._source_stamp = stamp_of(kernel.py_func)  # not the file's time: a checkout and back changes nothing
        kept._load_index = partial(_index_or_none, kept._load_index)


def _index_or_none(load: Callable[[], Any]) -> Any:
    """numba's index of what it keeps, or none: one that names a class of old code cannot be read at all, and is looked
    into before its stamp is."""
    try:
        return load()
    except Exception:  # whatever it is, the code is compiled anew, and the index written over
        return {}


def stamp_of(function: Callable[..., Any]) -> str:
    """Of the file a kernel is in, as that stood when its first kernel was met: what it imports comes before."""
    file = function.__code__.co_filename
    if file not in _stamps:
        digest = hashlib.sha256(_content(file))
        for name, value in sorted(function.__globals__.items()):
            if name.isidentifier() and not name.startswith("__"):  # pytest puts "@pytest_ar" into modules that it reads
                digest.update(f"{name} {_used(value)}\n".encode())
        _stamps[file] = digest.hexdigest()
    return _stamps[file]


def _used(value: object) -> str:
    """What code that is compiled takes from a name of its module; empty for what it cannot take."""
    if hasattr(value, "py_func"):  # another kernel
        return _stamps.get(value.py_func.__code__.co_filename, "")
    if isinstance(value, bool | int | float | str | tuple):
        return repr(value)
    if isinstance(value, type) and issubclass(value, tuple):  # a kernel reads a named tuple's fields by their places
        return repr(getattr(value, "_fields", ()))
    if isinstance(value, np.ndarray):
        return hashlib.sha256(value.tobytes()).hexdigest()
    if isinstance(value, ModuleType) and value.__name__.startswith("annulus_pipe.") and value.__file__:
        return hashlib.sha256(_content(value.__file__)).hexdigest()
    return ""


def _content(file: str) -> bytes:
    try:
        return Path(file).read_bytes()
    except OSError:  # typed at a prompt
        return b""


class _Told(event.Listener):  # type: ignore[misc]
    def on_start(self, event: object) -> None:
        telling.begins()

    def on_end(self, event: object) -> None:
        telling.ends()


event.register("numba:compile", _Told())


jit = cast(Callable[[Callable[..., Any]], Callable[..., Any]], jit_with(OPTIONS))  # kernels without types of their own


@jit
def cos_sin(angle):  # type: ignore[no-untyped-def]
    """Both, to 1e-15 of an angle below 10 rad, 1e-16 of the angle beyond: Taylor's series within a quarter turn of the
    nearest half turn. A third of the C library's time, and no call in the loop."""
    halves = math.floor(angle * (1.0 / math.pi) + 0.5)
    x = angle - halves * math.pi
    q = x * x
    c = 1 + q * (
        -1 / 2
        + q
        * (
            1 / 24
            + q
            * (
                -1 / 720
                + q
                * (
                    1 / 40320
                    + q
                    * (
                        -1 / 3628800
                        + q
                        * (
                            1 / 479001600
                            + q
                            * (
                                -1 / 87178291200
                                + q * (1 / 20922789888000 + q * (-1 / 6402373705728000 + q * (1 / 2432902008176640000)))
                            )
                        )
                    )
                )
            )
        )
    )
    s = 1 + q * (
        -1 / 6
        + q
        * (
            1 / 120
            + q
            * (
                -1 / 5040
                + q
                * (
                    1 / 362880
                    + q
                    * (
                        -1 / 39916800
                        + q
                        * (
                            1 / 6227020800
                            + q * (-1 / 1307674368000 + q * (1 / 355687428096000 + q * (-1 / 121645100408832000)))
                        )
                    )
                )
            )
        )
    )
    sign = 1.0 - 2.0 * (int(halves) & 1)
    return sign * c, sign * x * s


@jit
def ranked(values, size, rank):  # type: ignore[no-untyped-def]
    """The value of that rank, from 0, among the first `size`; reorders them. 0 of nothing. Hoare's selection."""
    if size == 0:
        return 0.0
    low, high = 0, size - 1
    while low < high:
        pivot = values[(low + high) // 2]
        i, k = low, high
        while i <= k:
            while values[i] < pivot:
                i += 1
            while values[k] > pivot:
                k -= 1
            if i <= k:
                values[i], values[k] = values[k], values[i]
                i += 1
                k -= 1
        if rank <= k:
            high = k
        elif rank >= i:
            low = i
        else:
            break
    return values[rank]


@jit
def middle(values, size):  # type: ignore[no-untyped-def]
    """Median of the first `size` values, the upper one of two; reorders them. 0 of nothing."""
    return ranked(values, size, size // 2)


@jit
def around(place, size):  # type: ignore[no-untyped-def]
    """A place at most one turn off, on a circle of that size: what % gives, without a division."""
    return place + size if place < 0 else place - size if place >= size else place
