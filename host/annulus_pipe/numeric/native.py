"""Loops over pixels and points, in C: host/native, built by `make setup` and part of a wheel.

    _deviations = door("deviations", "f8[n,k,3] points", "f8[3,3] rotation", "f8 radius", "f8[n,k]! out")
    _deviations(points, rotation, radius, out)

A door is declared where it is used, by the name and the arguments that its function has in C. `f8[n,k]` is an array in
order of memory, its letters are sizes that must agree between the arrays of a call; `!` says that it is written; a
`?`, that it may be None. Every call is checked against that before any memory is touched, and the sizes are handed to C
after the arguments, in the order in which their letters first appear. tests/unit/numeric/test_native.py holds the
declarations to the C.

One library is loaded, the best that the processor can run; which one changes no bit of any result. ANNULUS_LOOPS names
another, by its level ("x86-64-v2") or as a file by its whole path, for tests.
"""

import ctypes
import functools
import hashlib
import os
import platform
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from annulus_pipe.shipped import BUILD, LOOPS, is_shipped, of_checkout, shipped
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

LEVELS = {2: "x86-64-v2", 3: "x86-64-v3", 4: "x86-64-v4", 0: "armv8-a"}
CHOSEN = "ANNULUS_LOOPS"
_KINDS: dict[str, Any] = {
    "f8": ctypes.c_double,
    "f4": ctypes.c_float,
    "i8": ctypes.c_int64,
    "i4": ctypes.c_int32,
    "i2": ctypes.c_int16,
    "u8": ctypes.c_uint64,
    "u4": ctypes.c_uint32,
    "u2": ctypes.c_uint16,
    "u1": ctypes.c_uint8,
    "b1": ctypes.c_bool,
}
_BYTE = ctypes.c_char.from_buffer
_ARGUMENT = re.compile(r"(?P<kind>\w\d)(\[(?P<sizes>[\w, ]*)\](?P<written>!?)(?P<optional>\??))? (?P<name>\w+)")


@functools.cache
def library() -> ctypes.CDLL:
    """The loops for this processor. Raises AnnulusError where they were not built or cannot be loaded."""
    name = level()
    return _load(Path(name) if os.path.isabs(name) else shipped(f"{LOOPS}{name}.so"))


@functools.cache
def level() -> str:
    """Which of LEVELS is loaded, or what CHOSEN names. Raises AnnulusError as `library` does."""
    chosen = os.environ.get(CHOSEN, "")
    if os.path.isabs(chosen):
        return chosen
    usual = LEVELS[2 if platform.machine() == "x86_64" else 0]
    able = _load(shipped(f"{LOOPS}{usual}.so")).processor_level
    able.restype = ctypes.c_int64
    best = able()
    runs = [name for one, name in LEVELS.items() if one <= best and bool(one) == bool(best)]
    if chosen and chosen not in runs:
        raise AnnulusError(f"{CHOSEN}={chosen}: expected {', '.join(runs)} or a library's whole path")
    return chosen or runs[-1]


def _load(path: Path) -> ctypes.CDLL:
    try:
        whole = _is_whole(path)
    except OSError as error:
        raise AnnulusError(f"{path}: {error.strerror}, expected a library of annulus's loops") from None
    if not whole:
        raise AnnulusError(
            f"{path}: is cut short, or no library. `make setup` builds it, a wheel has it: install again."
        )
    try:
        loaded = ctypes.CDLL(str(path))
    except OSError as error:
        raise AnnulusError(
            f"{path}: cannot be loaded here ({one_line(str(error))}). Is it of this machine's kind?"
        ) from None
    if not hasattr(loaded, "library_sources"):
        raise AnnulusError(f"{path}: is another library. Run `make setup`, or install annulus again.")
    loaded.library_sources.restype = ctypes.c_char_p
    if (ours := sources()) not in ("", loaded.library_sources().decode()):
        raise AnnulusError(f"{path}: was built from other sources than this checkout has ({ours}). Run `make setup`.")
    return loaded


def _is_whole(path: Path) -> bool:
    """Whether a 64-bit ELF file has all that its header speaks of: a load of one cut short ends the process."""
    with path.open("rb") as file:
        head = file.read(64)
    if len(head) < 64 or head[:4] != b"\x7fELF":
        return False
    (sections,), (size, count) = struct.unpack_from("<Q", head, 40), struct.unpack_from("<HH", head, 58)
    return int(sections) + int(size) * int(count) <= path.stat().st_size


def built_from() -> str:
    """A digest of the C that the loaded library was built from."""
    return str(library().library_sources().decode())


@functools.cache
def sources() -> str:
    """A digest of the C in this checkout, as its Makefile makes it; empty where annulus came as a wheel."""
    if is_shipped(BUILD):  # a wheel's, even where its environment lies in a checkout
        return ""
    try:
        folder = of_checkout("host/native/level.c").parent
    except AnnulusError:
        return ""
    found = [*sorted(folder.glob("*.c")), *sorted(folder.glob("*.h"))]
    files = [file for file in found if not file.name.startswith(".")]  # an editor's; make's wildcards pass them over
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


class Argument:
    """One argument of a door, as declared."""

    def __init__(self, text: str) -> None:
        match = _ARGUMENT.fullmatch(text)
        if match is None:
            raise ValueError(f"{text!r}: expected an argument like 'f8[n,3]! out'")
        self.text, self.name, self.kind = text, match["name"], match["kind"]
        self.is_array = match["sizes"] is not None
        self.written, self.optional = bool(match["written"]), bool(match["optional"])
        sizes = [size.strip() for size in (match["sizes"] or "").split(",") if size.strip()]
        self.sizes: tuple[int | str, ...] = tuple(int(size) if size.isdigit() else size for size in sizes)
        self.dtype = np.dtype(self.kind) if self.kind != "b1" else np.dtype(np.bool_)


class Like:
    """Stands for an array that is given later, of the kind and shape of this one."""

    def __init__(self, array: Any) -> None:
        self.array = array

    def address(self, value: Any) -> int:
        like = self.array
        if value.shape != like.shape or value.dtype != like.dtype or not value.flags.c_contiguous:
            expected = f"{like.dtype} {like.shape} in order of memory"
            raise ValueError(f"array: expected {expected}, got {value.dtype} {value.shape}")
        return _address(value)


def _address(array: Any) -> int:
    try:
        return ctypes.addressof(_BYTE(array))  # a third of the time of what follows
    except (TypeError, ValueError):  # read only, or empty
        return int(array.__array_interface__["data"][0])


class LoopDoor:
    """A function of the library; see the module."""

    def __init__(self, name: str, *arguments: str, returns: str = "") -> None:
        self.name, self.returns = name, returns
        self.arguments = [Argument(text) for text in arguments]
        letters = [size for one in self.arguments for size in one.sizes if isinstance(size, str)]
        self.letters = list(dict.fromkeys(letters))
        self._function: Callable[..., Any] | None = None

    def __call__(self, *values: Any) -> Any:
        packed = self._packed(values)
        return (self._function or self._opened())(*packed)

    def held(self, *values: Any) -> Callable[..., Any]:
        """The same call on the same memory, checked once: a tenth of the time, for loops that every frame goes through.

        What is given as `...` (a scalar) or `Like(array)` (another array of its kind and shape) is given with each
        call, in order. Not for two threads at a time.
        """
        holes = [(n, value) for n, value in enumerate(values) if value is ... or isinstance(value, Like)]
        packed = self._packed(tuple(value.array if isinstance(value, Like) else value for value in values))
        function = self._function or self._opened()

        def call(*given: Any, kept: object = values) -> Any:  # kept: the memory lives as long as the call
            for (n, like), value in zip(holes, given, strict=True):
                packed[n] = value if like is ... else like.address(value)
            return function(*packed)

        return call

    def _packed(self, values: tuple[Any, ...]) -> list[Any]:
        if len(values) != len(self.arguments):
            raise ValueError(f"{self.name}: {len(values)} arguments, expected {len(self.arguments)}")
        sizes: dict[int | str, int] = {}
        known = sizes.setdefault
        packed: list[Any] = []
        for one, value in zip(self.arguments, values, strict=True):
            if not one.is_array:
                packed.append(0 if value is ... else value)
                continue
            if value is None and one.optional:
                packed.append(None)
                continue
            shape, flags = value.shape, value.flags
            if (
                value.dtype != one.dtype
                or len(shape) != len(one.sizes)
                or not flags.c_contiguous
                or (one.written and not flags.writeable)
            ):
                self._refuse(one, value)
            for size, length in zip(one.sizes, shape, strict=True):
                if size != length and (size.__class__ is int or known(size, length) != length):
                    self._refuse(one, value, sizes)
            packed.append(_address(value))
        packed += [sizes.get(letter, 0) for letter in self.letters]
        return packed

    def _refuse(self, one: Argument, value: Any, sizes: dict[int | str, int] | None = None) -> None:
        got = f"{value.dtype} {value.shape}, {'' if value.flags.c_contiguous else 'not '}in order of memory"
        raise ValueError(f"{self.name}: {one.name}: expected {one.text}{f' with {sizes}' if sizes else ''}, got {got}")

    def _opened(self) -> Callable[..., Any]:
        function = getattr(library(), self.name)
        function.argtypes = [ctypes.c_void_p if one.is_array else _KINDS[one.kind] for one in self.arguments]
        function.argtypes += [ctypes.c_int64] * len(self.letters)
        function.restype = _KINDS[self.returns] if self.returns else None
        self._function = function
        return function  # type: ignore[no-any-return]


DOORS: list[LoopDoor] = []  # all that were declared, for the test that holds them to the C


def door(name: str, *arguments: str, returns: str = "") -> LoopDoor:
    DOORS.append(LoopDoor(name, *arguments, returns=returns))
    return DOORS[-1]
