"""Valid samples made wrong: in their bytes, and in their values while the form around them stays right."""

import copy
import json
from random import Random
from typing import Any

NESTED = "NESTED"  # stands for a value within a value within .., which no writer would write; see `as_json`
HOSTILE: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    1,
    -1,
    2,
    255,
    256,
    2**31,
    2**32,
    2**53 + 1,
    2**63 - 1,
    2**64 - 1,
    -(2**63),
    0.0,
    -0.0,
    1e-308,
    1e300,
    -1e300,
    1.5,
    "",
    "\0",
    "\x1b[2J",
    "\u202e",
    "../../etc/passwd",
    "/dev/zero",
    "/proc/self/mem",
    "x" * 70_000,
    "1e999",
    "nan",
    [],
    {},
    [[]],
    [{}],
    {"": None},
    [None] * 1000,
    {"base64": 1},
    {"base64": "????"},
    {"__proto__": {}},
    [1e300] * 3,
)
UNWRITABLE: tuple[Any, ...] = (float("nan"), float("inf"), 10**400, 10**5000, NESTED)  # in JSON and TOML only
_EXTREMES = (0, 1, 0x7F, 0x80, 0xFF)


def of_bytes(rng: Random, data: bytes) -> bytes:
    """Some of: flipped bits, other bytes, numbers at their limits, cut, doubled, moved, zeroed, filled."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        at = rng.randrange(len(out) + 1)
        length = min(rng.choice((1, 2, 4, 8, 64, 600, 5000)), len(out) - at)
        match rng.randrange(9):
            case 0 | 1 if at < len(out):
                out[at] ^= 1 << rng.randrange(8)
            case 2:
                out[at : at + length] = rng.randbytes(length)
            case 3:
                out[at : at + length] = bytes([rng.choice(_EXTREMES)]) * length
            case 4:
                del out[at:]
            case 5:
                del out[at : at + length]
            case 6:
                begin = rng.randrange(len(out) + 1)
                out[at:at] = out[begin : begin + length]
            case 7:
                begin = rng.randrange(len(out) + 1)
                out[at : at + length] = out[begin : begin + length]
            case _:
                size = rng.choice((1, 2, 4, 8))
                number = rng.choice(
                    (0, 1, 2 ** (8 * size) - 1, 2 ** (8 * size - 1), len(data), rng.randrange(2 ** (8 * size)))
                )
                out[at : at + size] = (number % 256**size).to_bytes(size, "little")
    return bytes(out)


def of_values(rng: Random, value: Any, hostile: tuple[Any, ...]) -> Any:
    """The same with one or a few of its values or names replaced, taken away, doubled or wrapped."""
    out = json.loads(json.dumps(value))
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(out))
        if not places:
            return copy.deepcopy(rng.choice(hostile))
        inside, key = rng.choice(places)
        match rng.randrange(8):
            case 0:
                del inside[key]
            case 1:
                inside[key] = [inside[key]]
            case 2 if isinstance(inside[key], int | float) and not isinstance(inside[key], bool):
                inside[key] = rng.choice((-inside[key], inside[key] * 1_000_000, inside[key] + 1, "9"))
            case 3 if isinstance(inside, dict):
                inside[rng.choice(("", "\x1b", "unknown", "format", key + "x"))] = inside.pop(key)
            case 4 if isinstance(inside, list):
                inside.extend([inside[key]] * rng.choice((1, 2, 5000)))
            case _:
                inside[key] = copy.deepcopy(rng.choice(hostile))  # what is done to it later is this case's alone
    return out


def _places(value: Any) -> Any:
    """Every (container, key) in it."""
    waiting = [value]
    while waiting:
        one = waiting.pop()
        pairs = one.items() if isinstance(one, dict) else enumerate(one) if isinstance(one, list) else ()
        for key, item in pairs:
            yield one, key
            if isinstance(item, dict | list):
                waiting.append(item)


def as_json(rng: Random, value: Any) -> bytes:
    """With numbers of any length, and now and then a name twice."""
    text = _dumps(value)
    deep = rng.choice((33, 900, 100_000))
    text = text.replace(
        f'"{NESTED}"', "[" * deep + "]" * deep if rng.random() < 0.7 else '{"a":' * deep + "0" + "}" * deep
    )
    if rng.random() < 0.02 and text.startswith("{"):
        text = '{"format": 1, ' + text[1:]
    return text.encode("utf-8", "surrogatepass")


def _dumps(value: Any) -> str:
    import sys

    before = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(0)
    try:
        return json.dumps(value)
    finally:
        sys.set_int_max_str_digits(before)


def of_rows(rng: Random, text: str) -> str:
    """A table with cells, rows and columns made wrong."""
    rows = [line.split(",") for line in text.splitlines()]
    cells = (
        "",
        "nan",
        "inf",
        "-1",
        "1e400",
        "9" * 30,
        "0",
        "../x.png",
        "/etc/passwd",
        "frames",
        "\x1b[2J",
        '"',
        "1_0",
        "x" * 5000,
        "led",
    )
    for _ in range(rng.choice((1, 1, 2, 4))):
        row = rng.randrange(len(rows))
        match rng.randrange(6):
            case 0:
                del rows[row]
            case 1:
                rows.insert(row, list(rows[row]))
            case 2:
                rows[row].append(rng.choice(cells))
            case _ if rows[row]:
                rows[row][rng.randrange(len(rows[row]))] = rng.choice(cells)
        if not rows:
            break
    return "\n".join(map(",".join, rows)) + rng.choice(("\n", "", "\r\n", "\0"))


def of_toml(rng: Random, text: str) -> str:
    """Lines of `key = value` with other values, lines and headings twice, gone or elsewhere."""
    lines = text.splitlines()
    values = (
        "nan",
        "inf",
        "-1",
        "0",
        "1e400",
        "9" * 5000,
        "0x" + "f" * 5000,
        "[]",
        "{}",
        "[" * 5000,
        "{a=" * 2000,
        '""',
        '"\\u001b[2J"',
        "true",
        '"../../etc/passwd"',
        "1979-05-27",
        "[[1]]",
        '["a", 1]',
        "'/dev/zero'",
        "1.5",
        '"' + "x" * 60_000 + '"',
        '"\\u0000"',
        "{a = 1}",
    )
    for _ in range(rng.choice((1, 1, 2, 4))):
        at = rng.randrange(len(lines))
        match rng.randrange(7):
            case 0:
                del lines[at]
            case 1:
                lines.insert(rng.randrange(len(lines)), lines[at])
            case 2:
                lines.insert(
                    at,
                    rng.choice(
                        (
                            "[",
                            "[[camera]]",
                            "[camera]",
                            "[a.b.c]",
                            "a." * 400 + "a = 1",
                            "= 1",
                            "\x1b",
                            "[\x1b]",
                            "[[sensor]]",
                        )
                    ),
                )
            case _:
                lines[at] = lines[at].split("=")[0] + "= " + rng.choice(values)
        if not lines:
            break
    return "\n".join(lines) + "\n"
