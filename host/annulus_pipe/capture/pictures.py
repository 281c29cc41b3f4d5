"""Pictures as files and cameras send them: their size is read, and bounded, before anything is decoded.

A PNG of 1 MB can say it has 16384 x 16384 pixels and be decoded to 2.35 GB; OpenCV fills the missing part of a
truncated picture with grey and says nothing. So a picture is decoded only when its head names a size that is one, and
its own structure says it is whole.
"""

import re
import struct
import zlib
from collections.abc import Callable

import cv2
import numpy as np

from annulus_pipe.capture.camera import SIDE_MAX
from annulus_pipe.numeric.arrays import Image

PIXELS_MAX = 1 << 26  # the largest sensors of industrial cameras have 65 million
SCANS_MAX = 32  # of a JPEG; each costs as much as all its pixels, and ten are usual

_PNM = re.compile(rb"P[2356](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
_SIDES = (256, 257, 322, 323)  # tags of a TIFF: width and height of the picture and of a tile
_Size = tuple[int, int]


def decode(data: bytes, size: _Size | None = None) -> Image:
    """A JPEG, PNG, TIFF, BMP, PNM or WebP as (H, W, 3) uint8 BGR, whole or not at all.

    size : (width, height) that it must have, where that is known. Raises ValueError, one line.
    """
    found = size_of(data)
    if found is not None:
        width, height = found
        if not (0 < width <= SIDE_MAX and 0 < height <= SIDE_MAX and width * height <= PIXELS_MAX):
            most = f"sides of at most {SIDE_MAX} and {PIXELS_MAX >> 20} Mi pixels"
            raise ValueError(f"a picture of {width}x{height}, expected {most}")
        if size is not None and size != found:
            raise ValueError(f"a picture of {width}x{height}, expected {size[0]}x{size[1]}")
        try:
            image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        except cv2.error:
            image = None
        if image is not None and image.shape == (height, width, 3):
            return np.asarray(image, np.uint8)
    raise ValueError(f"truncated or damaged image ({len(data)} bytes)")


def size_of(data: bytes) -> _Size | None:
    """Width and height that a picture's head says, undecoded; None where it is cut short or damaged.

    Raises ValueError, one line, for what is no picture at all.
    """
    read = next((read for begin, read in _KINDS.items() if data.startswith(begin)), None)
    if read is None:
        raise ValueError(f"{len(data)} bytes that are neither JPEG nor PNG, TIFF, BMP, PNM or WebP")
    try:
        return read(data)
    except (struct.error, IndexError):
        return None


def _jpeg(data: bytes) -> _Size | None:
    """None where the end-of-image marker is missing after the picture's own data (a thumbnail's does not count)."""
    at, size = 2, None
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte
            at += 1
        elif marker == 0xDA:  # start of scan: in what follows FF D9 can only be the end
            if data.count(b"\xff\xda", at) > SCANS_MAX:
                raise ValueError(f"a JPEG of over {SCANS_MAX} scans")
            return size if data.find(b"\xff\xd9", at) >= 0 else None
        else:
            if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
                height, width = struct.unpack_from(">HH", data, at + 5)
                if size is not None:
                    return None
                size = width, height
            at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
    return None


def _png(data: bytes) -> _Size | None:
    """None where a chunk is missing or has the wrong checksum, up to the end chunk."""
    if data[12:16] != b"IHDR":
        return None
    at = 8
    while at + 12 <= len(data):
        size = int.from_bytes(data[at : at + 4], "big")
        end = at + 12 + size
        if end > len(data) or zlib.crc32(data[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end], "big"):
            return None
        if data[at + 4 : at + 8] == b"IEND":
            width, height = struct.unpack_from(">II", data, 16)
            return width, height
        at = end
    return None


def _bmp(data: bytes) -> _Size | None:
    small = struct.unpack_from("<I", data, 14)[0] == 12
    width, height = struct.unpack_from("<HH" if small else "<ii", data, 18)
    return width, abs(height)


def _pnm(data: bytes) -> _Size | None:
    found = _PNM.match(data)
    return None if found is None else (int(found[1]), int(found[2]))


def _tiff(data: bytes) -> _Size | None:
    """Of the first picture, the one that is decoded. None where it is laid out in tiles larger than itself could be."""
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    (entries,) = struct.unpack_from(f"{order}H", data, at)
    sides = {}
    for i in range(entries):
        tag, kind = struct.unpack_from(f"{order}HH", data, at + 2 + 12 * i)
        if tag in _SIDES:
            if tag in sides or kind not in (3, 4):
                return None
            (sides[tag],) = struct.unpack_from(f"{order}{'H' if kind == 3 else 'I'}", data, at + 10 + 12 * i)
    if sides.get(322, 1) * sides.get(323, 1) > PIXELS_MAX:
        return None
    return (sides[256], sides[257]) if 256 in sides and 257 in sides else None


def _webp(data: bytes) -> _Size | None:
    match data[8:16]:
        case b"WEBPVP8 ":
            width, height = struct.unpack_from("<HH", data, 26)
            return width & 0x3FFF, height & 0x3FFF
        case b"WEBPVP8L":
            (sides,) = struct.unpack_from("<I", data, 21)
            return (sides & 0x3FFF) + 1, (sides >> 14 & 0x3FFF) + 1
        case b"WEBPVP8X":
            return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    return None


_KINDS: dict[bytes, Callable[[bytes], _Size | None]] = {
    b"\xff\xd8": _jpeg,
    b"\x89PNG\r\n\x1a\n": _png,
    b"BM": _bmp,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"RIFF": _webp,
    **dict.fromkeys((b"P2", b"P3", b"P5", b"P6"), _pnm),
}
