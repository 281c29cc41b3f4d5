"""Calls of doors, written down as they are made and made again elsewhere: with another library, on another machine.

    with recording() as calls: ...          # of what is made inside; Reconstructors and the like have to be new
    differing(calls, library)               # here: what another library writes otherwise
    differing_on_aarch64(calls, folder)     # by a C program without Python, under QEMU

As a plugin of pytest (`-p recorded`, ANNULUS_RECORD=file) it writes down what all tests of a run call.
"""

import contextlib
import ctypes
import os
import pickle
import subprocess
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from annulus_pipe.numeric.native import _KINDS, DOORS, Argument, LoopDoor, level, library

NATIVE = Path(__file__).resolve().parents[3] / "host/native"
RECORD = "ANNULUS_RECORD"
LARGE = 4  # a size up to this is a kind of its own: bytes of a pixel, arrays that may be empty
MOST_BYTES = 32 << 20  # of one call; a larger one is not written down


class Block(NamedTuple):
    """A stretch of memory that a call is given, before and after it."""

    before: bytes
    after: bytes


class Call(NamedTuple):
    """values : of a scalar itself, of an array (block, offset) or None; then the sizes."""

    name: str
    values: list[Any]
    blocks: list[Block]
    result: Any


def argument_bytes(one: Argument, sizes: dict[str, int]) -> int:
    return int(np.prod([size if isinstance(size, int) else sizes[size] for size in one.sizes])) * one.dtype.itemsize


def of_door(name: str) -> LoopDoor:
    return next(one for one in DOORS if one.name == name)


@contextlib.contextmanager
def recording(most: int = 2) -> Iterator[list[Call]]:
    """At most so many calls of a kind: of one door, with the same arrays left out and sizes alike."""
    calls: list[Call] = []
    counted: Counter[Any] = Counter()
    opened, active = LoopDoor._opened, True

    def recorded(door: LoopDoor) -> Callable[..., Any]:
        function = opened(door)

        def call(*packed: Any) -> Any:
            sizes = packed[len(door.arguments) :]
            kind = door.name, tuple(value is None for value in packed), tuple(min(size, LARGE) for size in sizes)
            if not active or counted[kind] == most:
                return function(*packed)
            counted[kind] += 1
            made = _made(door, function, packed)
            if made is None:  # too large
                return function(*packed)
            calls.append(made)
            return made.result

        door._function = call
        return call

    LoopDoor._opened = recorded  # type: ignore[method-assign]
    try:
        with fresh_doors():
            yield calls
    finally:
        active = False
        LoopDoor._opened = opened  # type: ignore[method-assign]


@contextlib.contextmanager
def fresh_doors() -> Iterator[None]:
    """Within, and after, the library is chosen anew and every door opened anew."""
    _forget()
    try:
        yield
    finally:
        _forget()


def _forget() -> None:
    library.cache_clear()
    level.cache_clear()
    for one in DOORS:
        one._function = None


def _made(door: LoopDoor, function: Callable[..., Any], packed: tuple[Any, ...]) -> Call | None:
    """The call is made, and written down; neither, if it is too large. Arrays that share memory share a block."""
    sizes = dict(zip(door.letters, packed[len(door.arguments) :], strict=True))
    pairs = list(zip(door.arguments, packed, strict=False))
    lying = {
        n: (at, argument_bytes(one, sizes)) for n, (one, at) in enumerate(pairs) if one.is_array and at is not None
    }
    stretches: list[list[int]] = []
    for start, length in sorted(lying.values()):
        if stretches and start < sum(stretches[-1]):
            stretches[-1][1] = max(stretches[-1][1], start + length - stretches[-1][0])
        elif length:
            stretches.append([start, length])
    if sum(length for _, length in stretches) > MOST_BYTES:
        return None
    before = [ctypes.string_at(*stretch) for stretch in stretches]
    result = function(*packed)
    blocks = [Block(was, ctypes.string_at(*stretch)) for was, stretch in zip(before, stretches, strict=True)]
    values = list(packed)
    for n, (start, length) in lying.items():
        at = next((i for i, (s, size) in enumerate(stretches) if s <= start < s + size), -1)
        values[n] = (at, start - stretches[at][0]) if length and at >= 0 else (-1, 0)
    return Call(door.name, values, blocks, result)


def made_again(call: Call, of: ctypes.CDLL | None = None) -> Call:
    """By a library, or the usual one: with the result that it gives, and its blocks as they are after it."""
    door = of_door(call.name)
    function = getattr(of or library(), call.name)
    function.argtypes = [ctypes.c_void_p if one.is_array else _KINDS[one.kind] for one in door.arguments]
    function.argtypes += [ctypes.c_int64] * len(door.letters)
    function.restype = _KINDS[door.returns] if door.returns else None
    memory = [np.frombuffer(block.before, np.uint8).copy() for block in call.blocks]
    nothing = np.empty(0, np.uint8)  # an array of no size
    packed = list(call.values)
    for _, span, n in _lying(door, call):
        packed[n] = (nothing if span is None else memory[span[0]][span[1] :]).__array_interface__["data"][0]
    result = function(*packed)
    blocks = [Block(block.before, part.tobytes()) for block, part in zip(call.blocks, memory, strict=True)]
    return call._replace(result=result, blocks=blocks)


def with_other(call: Call, name: str, changed: Callable[[Any], Any]) -> Call:
    """The call with other values in one of its arrays, made by the usual library. changed : from those there were."""
    blocks = list(call.blocks)
    for one, span, _ in _lying(of_door(call.name), call):
        if one.name == name and span is not None:
            at, offset, size = span
            memory = np.frombuffer(blocks[at].before, np.uint8).copy()
            values = memory[offset : offset + size].view(one.dtype)
            values[:] = changed(values)
            blocks[at] = Block(memory.tobytes(), b"")
    return made_again(call._replace(blocks=blocks))


def _lying(door: LoopDoor, call: Call) -> Iterator[tuple[Argument, tuple[int, int, int] | None, int]]:
    """Arrays that were given: (block, offset, bytes), and which argument each is."""
    sizes = dict(zip(door.letters, call.values[len(door.arguments) :], strict=True))
    for n, (one, value) in enumerate(zip(door.arguments, call.values, strict=False)):
        if one.is_array and value is not None:
            yield one, None if value[0] < 0 else (*value, argument_bytes(one, sizes)), n


def given(call: Call) -> list[str]:
    """The arrays that hold something, by their names."""
    return [one.name for one, span, _ in _lying(of_door(call.name), call) if span is not None]


def differing(calls: list[Call], of: ctypes.CDLL) -> list[str]:
    """What a library writes otherwise than was recorded; a NaN is a NaN, whatever its sign."""
    found = []
    for call in calls:
        made = made_again(call, of)
        if made.result != call.result and not (made.result != made.result and call.result != call.result):
            found.append(f"{call.name}: gives {made.result}, expected {call.result}")
        for one, span, _ in _lying(of_door(call.name), call):
            if span is None or not one.written:
                continue
            at, offset, size = span
            written, expected = (
                np.frombuffer(one_call.blocks[at].after[offset : offset + size], one.dtype) for one_call in (made, call)
            )
            other = np.flatnonzero((written != expected) & ((written == written) | (expected == expected)))
            if len(other):
                first = other[0]
                found.append(f"{call.name}: {one.name}[{first}] is {written[first]}, expected {expected[first]}")
    return found


def write(calls: list[Call], path: Path) -> None:
    """What replay.c reads: 8 bytes a number, blocks as they are. First all blocks that differ, then the calls."""
    blobs: dict[bytes, int] = {}
    rows = [len(calls)]
    for call in calls:
        door = of_door(call.name)
        rows += [DOORS.index(door), len(call.blocks)]
        rows += [blobs.setdefault(part, len(blobs)) for block in call.blocks for part in block]
        for one, value in zip(door.arguments, call.values, strict=False):
            if one.is_array:
                rows += [-2, 0] if value is None else list(value)
            else:
                rows.append(_bits(one.kind, value))
        rows += call.values[len(door.arguments) :]
        rows.append(_bits(door.returns, call.result) if door.returns else 0)
    with path.open("wb") as file:
        file.write(np.int64(len(blobs)).tobytes())
        for blob in blobs:
            file.write(np.int64(len(blob)).tobytes() + blob + bytes(-len(blob) % 8))
        file.write(np.array(rows, np.int64).tobytes())


def _bits(kind: str, value: Any) -> int:
    """A number as the first bytes of a union of all kinds."""
    raw = np.array(value, Argument(f"{kind} x").dtype).tobytes()
    return int.from_bytes(raw + bytes(8 - len(raw)), "little", signed=True)


OF_C = {"f8": "double", "f4": "float", "b1": "bool"} | {
    f"{sign}{size}": f"{'u' * (sign == 'u')}int{8 * size}_t" for sign in "iu" for size in (1, 2, 4, 8)
}


def replay_c() -> str:
    """replay.c with all doors, in their order: how each is called, and what of its arrays is written."""
    text = Path(__file__).with_name("replay.c").read_text(encoding="utf-8")
    rows = ",\n".join(_row(n, door) for n, door in enumerate(DOORS))
    table = f"static const door DOORS[] = {{\n{rows},\n}};"
    return text.replace("// DOORS", "\n".join([*(_of_c(n, door) for n, door in enumerate(DOORS)), table]))


def _of_c(n: int, door: LoopDoor) -> str:
    """Its prototype, a function that calls it with slots, and its arguments."""
    kinds, given, described = [], [], []
    for k, one in enumerate(door.arguments):
        kind = ("" if one.written or not one.is_array else "const ") + OF_C[one.kind] + "*" * one.is_array
        kinds.append(kind)
        given.append(f"({kind})a[{k}].p" if one.is_array else f"a[{k}].{one.kind}")
        sizes = [str(-size if isinstance(size, int) else door.letters.index(size)) for size in one.sizes]
        about = f"'{one.kind[0]}', {one.dtype.itemsize}, {int(one.is_array)}, {int(one.written)}, {len(sizes)}"
        described.append(f'{{"{one.name}", {about}, {{{", ".join(sizes) or 0}}}}}')
    kinds += ["int64_t"] * len(door.letters)
    given += [f"a[{len(door.arguments) + k}].i8" for k in range(len(door.letters))]
    returns, result = ("void", "") if not door.returns else (OF_C[door.returns], f"out.{door.returns} = ")
    called = f"slot out = {{0}}; {result}{door.name}({', '.join(given)}); return out;"
    return (
        f"{returns} {door.name}({', '.join(kinds)});\n"
        f"static slot run_{n}(const slot* a) {{ {called} }}\n"
        f"static const argument of_{n}[] = {{{', '.join(described)}}};"
    )


def _row(n: int, door: LoopDoor) -> str:
    returns = f"'{door.returns[0]}', {door.returns[1]}" if door.returns else "0, 0"
    return f'    {{"{door.name}", run_{n}, of_{n}, {len(door.arguments)}, {len(door.letters)}, {returns}}}'


@pytest.hookimpl(wrapper=True)
def pytest_runtestloop() -> Iterator[Any]:
    with recording() as calls:
        done = yield
    Path(os.environ[RECORD]).write_bytes(pickle.dumps(calls))
    return done


def differing_on(calls: list[Call], folder: Path, build: list[str], run: list[str]) -> list[str]:
    """By a program of its own. build : the compiler, its options and what is linked; run : what starts a program."""
    write(calls, folder / "calls")
    (folder / "doors.c").write_text(replay_c(), encoding="utf-8")
    program = folder / "replay"
    subprocess.run([*build, "-o", str(program), str(folder / "doors.c"), "-lm"], check=True)
    done = subprocess.run([*run, str(program), str(folder / "calls")], capture_output=True, text=True)
    found = done.stdout.splitlines()
    assert not done.stderr and done.returncode == bool(found), done.stderr
    return found
