"""The fields of a protobuf message where they lie: a picture that was read from the disk is not copied to be looked at.

What is read here are two messages whose fields are numbers, texts and bytes (foxglove.RawImage, .CompressedImage); the
library, which makes messages as well, copies their bytes twice, and takes 40 ms to import.
"""

from collections.abc import Mapping

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # how a field's value lies there; what else there was is not written today
_FIXED = {FIXED64: 8, FIXED32: 4}
_FIELDS_MAX = 64  # of one message; a picture has seven
_VARINT_MAX = 10  # bytes
_NUMBER_MAX = (1 << 29) - 1

Fields = Mapping[tuple[int, int], int | memoryview]


def fields(message: memoryview) -> Fields:
    """By number and kind; of one that is there twice the last, as protobuf has it. ValueError where it is none."""
    found: dict[tuple[int, int], int | memoryview] = {}
    at = 0
    for _ in range(_FIELDS_MAX):
        if at == len(message):
            return found
        tag, at = _varint(message, at)
        number, kind = tag >> 3, tag & 7
        if not 0 < number <= _NUMBER_MAX:
            raise ValueError(f"a field of number {number}")
        if kind == VARINT:
            found[number, kind], at = _varint(message, at)
            continue
        length = _FIXED.get(kind, 0)
        if kind == BYTES:
            length, at = _varint(message, at)
        elif not length:
            raise ValueError(f"a field of kind {kind}")
        if length > len(message) - at:
            raise ValueError("a field that is longer than its message")
        value = message[at : at + length]
        found[number, kind] = value if kind == BYTES else int.from_bytes(value, "little")
        at += length
    raise ValueError(f"more than {_FIELDS_MAX} fields")


def number(found: Fields, of: int, kind: int) -> int:
    """0 where it is not there, as protobuf has it."""
    value = found.get((of, kind), 0)
    assert isinstance(value, int)
    return value


def content(found: Fields, of: int) -> memoryview:
    value = found.get((of, BYTES), _EMPTY)
    assert isinstance(value, memoryview)
    return value


def text(found: Fields, of: int) -> str:
    """ValueError where it is none."""
    return str(content(found, of), "utf-8")


_EMPTY = memoryview(b"")


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """A number of 7 bits a byte, and where the next begins."""
    value = 0
    for shift, byte in enumerate(message[at : at + _VARINT_MAX]):
        value |= (byte & 0x7F) << (7 * shift)
        if byte < 0x80:
            return value & (1 << 64) - 1, at + shift + 1
    raise ValueError("a number without an end")
