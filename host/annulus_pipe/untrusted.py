"""Bytes and values from outside (wire, files, sockets), bounded and checked before anybody believes them.

Every check raises ValueError with one line that names the field, what it is and what was expected. What a parser gives
back here is no deeper than DEPTH_MAX, and has no whole number that fills a page; JSON has finite numbers and no key
twice.
"""

import json
import math
import os
import re
import reprlib
import stat
import sys
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

DEPTH_MAX = 32  # of values within values; what annulus writes has six
WHOLE_MAX = 1 << 64  # a whole number is a count or a time
LINE_MAX = 500  # characters of one line for people
SHOWN_MAX = 80  # .. of a value that a message quotes
TOML_MAX = 1 << 16  # bytes; a head.toml of eight cameras has 3 kB
_DOTS_MAX = 500  # in a line of TOML: the time for a.b.c.d = 1 grows with their square

# what a terminal obeys, or shows otherwise than it stands: C0, DEL, C1, Unicode's line ends, turned and unseen signs,
# halves of surrogates (in names of files that are not UTF-8)
_UNSEEN = re.compile("[\x00-\x1f\x7f-\x9f\xad\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ud800-\udfff]")
_HALF = re.compile("[\ud800-\udfff]")
_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 60
_SHORT.maxlevel = 2


def printable(text: str, keep: str = "") -> str:
    """The text with every sign that a terminal would obey written as its escape, but for those in `keep`."""
    return _UNSEEN.sub(lambda found: found[0] if found[0] in keep else repr(found[0])[1:-1], text)


def one_line(text: str) -> str:
    """The text on one line that any terminal may be shown; of a long one the middle is left out."""
    line = printable(" ".join(text.split("\n")))
    end = LINE_MAX // 3
    return line if len(line) <= LINE_MAX else f"{line[: LINE_MAX - end - 4]} .. {line[-end:]}"


def shown(value: object) -> str:
    """A value as messages quote it: short, whatever it is."""
    try:
        quoted = printable(_SHORT.repr(value))
    except ValueError:  # Python does not write out a whole number of over 4300 digits
        return "a whole number of thousands of digits"
    return quoted if len(quoted) <= SHOWN_MAX else f"{quoted[: SHOWN_MAX - 3]}..."


def read_file(path: Path, limit: int) -> bytes:
    """All bytes of a file, at most `limit`.

    ValueError for a larger one, and for what is no file: a pipe would keep us waiting for ever. OSError as it comes.
    """
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | os.O_NONBLOCK)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise ValueError("not a file")
        data = file.read(limit + 1)
    if len(data) > limit:
        raise ValueError(f"larger than {limit >> 20} MiB" if limit >> 20 else f"larger than {limit >> 10} KiB")
    return data


def require_replaceable(path: Path) -> None:
    """ValueError where something else than a file stands there: renaming onto a device or a pipe would take it away,
    and who reads from it would hear nothing. OSError as it comes."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return
    if not stat.S_ISREG(mode):
        kinds = {stat.S_IFDIR: "folder", stat.S_IFIFO: "pipe", stat.S_IFSOCK: "socket"}
        raise ValueError(f"is a {kinds.get(stat.S_IFMT(mode), 'device')}, expected a file's name")


def parse_json(
    data: bytes | str, limit: int, restore: Callable[[dict[str, Any]], Any] = lambda members: members
) -> Any:
    """One JSON value of at most `limit` bytes. `restore`: what becomes of each object, innermost first."""
    if len(data) > limit:
        raise ValueError(f"{len(data)} bytes of JSON, expected at most {limit}")

    def members(pairs: list[tuple[str, Any]]) -> Any:
        found = dict(pairs)
        if len(found) < len(pairs):
            raise ValueError(f"{shown(Counter(name for name, _ in pairs).most_common(1)[0][0])} is there twice")
        return restore(found)

    try:
        text = data if isinstance(data, str) else data.decode("utf-8-sig")
        return sane(json.loads(text, object_pairs_hook=members, parse_constant=_no_constant))
    except UnicodeDecodeError:
        raise ValueError("not a text file") from None
    except json.JSONDecodeError as error:
        raise ValueError(f"line {error.lineno}: not JSON ({error.msg})") from None
    except RecursionError:
        raise ValueError(f"nested deeper than {DEPTH_MAX}") from None


def sayable(value: Any) -> Any:
    """The value itself, whose texts can be passed on: JSON may say half a sign ("\\ud800"), which no encoding has."""
    level: list[Any] = [value]
    while level:
        one = level.pop()
        if isinstance(one, dict):
            level += [*one.keys(), *one.values()]
        elif isinstance(one, list):
            level += one
        elif isinstance(one, str) and not one.isascii() and _HALF.search(one):
            raise ValueError(f"{shown(one)} has half a sign in it, expected whole ones")
    return value


def parse_toml(data: bytes) -> dict[str, Any]:
    """A TOML document of at most TOML_MAX bytes."""
    if len(data) > TOML_MAX:
        raise ValueError(f"{len(data)} bytes of TOML, expected at most {TOML_MAX}")
    for number, line in enumerate(data.split(b"\n"), start=1):
        if line.count(b".") > _DOTS_MAX:
            raise ValueError(f"line {number}: {line.count(b'.')} dots, expected at most {_DOTS_MAX}")
    import tomllib  # every process imports this module, and few parse TOML, or a message

    try:
        found: dict[str, Any] = sane(
            tomllib.loads(data.decode("utf-8")), finite=False
        )  # whose key it is the reader says
        return found
    except UnicodeDecodeError:
        raise ValueError("not a text file") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(f"not TOML: {one_line(str(error))}") from None
    except RecursionError:
        raise ValueError(f"nested deeper than {DEPTH_MAX}") from None


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number, expected null where nothing is known")


def sane(value: Any, finite: bool = True) -> Any:
    """The value itself, which a parser made: not deeper than DEPTH_MAX, its numbers finite and below WHOLE_MAX."""
    level: list[Any] = [value]
    for _ in range(DEPTH_MAX + 1):
        below: list[Any] = []
        for one in level:
            if one is None or type(one) is str:  # most, and a recording has labels by the hundred thousand
                continue
            if isinstance(one, dict):
                below.extend(one.values())
            elif isinstance(one, list | tuple):
                below.extend(one)
            elif isinstance(one, float):
                if finite and not math.isfinite(one):
                    raise ValueError(f"{one} stands for a number, expected a finite one")
            elif isinstance(one, int) and not -WHOLE_MAX < one < WHOLE_MAX:
                raise ValueError(f"a whole number of {one.bit_length()} bits, expected at most 64")
        if not below:
            return value
        level = below
    raise ValueError(f"nested deeper than {DEPTH_MAX}")


def unpack(packed: bytes, limit: int) -> Any:
    """One msgpack value of at most `limit` bytes; ValueError on anything else, whatever msgpack calls it."""
    if len(packed) > limit:
        raise ValueError(f"message of {len(packed)} bytes, at most {limit} expected")
    import msgpack

    try:
        value = msgpack.unpackb(packed)  # lengths inside are bounded by len(packed)
    except (ValueError, TypeError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise ValueError(f"not one msgpack value: {one_line(str(error)) or type(error).__name__}") from None
    return sane(value, finite=False)  # a profile's numbers may be NaN


def mapping(value: object, what: str) -> Mapping[str, Any]:
    """A mapping with text for keys."""
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ValueError(f"{what} must be a mapping of names")
    return value


def whole(value: object, what: str, low: int, high: int) -> int:
    """A whole number in low..high; True and 1.0 are none."""
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueError(f"{what} is {shown(value)}, expected a whole number in {low}..{high}")
    return value


def number(value: object, what: str, most: float = sys.float_info.max) -> float:
    """A finite number, not larger than `most` either way."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not -most <= value <= most:
        raise ValueError(f"{what} is {shown(value)}, expected a number")
    return float(value)


def within(value: object, what: str, low: float, high: float) -> float:
    """A number in low..high."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueError(f"{what} is {shown(value)}, expected a number in {low:g}..{high:g}")
    return float(value)


def numbers(value: object, what: str, counts: Collection[int], most: float) -> tuple[float, ...]:
    """A list of finite numbers, not larger than `most` either way; `counts`: how many there may be."""
    if not isinstance(value, Sequence) or isinstance(value, str | bytes) or len(value) not in counts:
        raise ValueError(f"{what} must be a list of {_counted(counts)} numbers")
    return tuple(within(item, f"{what}, number {i + 1},", -most, most) for i, item in enumerate(value))


def text(value: object, what: str, longest: int) -> str:
    """A text of at most `longest` characters."""
    if not isinstance(value, str) or len(value) > longest:
        raise ValueError(f"{what} must be a text of at most {longest} characters")
    return value


def _counted(counts: Collection[int]) -> str:
    return f"{counts[0]}..{counts[-1]}" if isinstance(counts, range) else " or ".join(map(str, counts))
