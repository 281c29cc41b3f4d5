"""A PNG of 1 MB was decoded to 2.35 GB: its size was believed. Fails where `capture.pictures.decode` has no bound."""

import struct
import zlib
from pathlib import Path

import pytest

from annulus_pipe.scans.scan import read_image
from annulus_pipe.vocabulary import AnnulusError

SIDE = 12_000


def chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def test_a_small_file_with_many_pixels_is_not_decoded(tmp_path: Path) -> None:
    head = struct.pack(">IIBBBBB", SIDE, SIDE, 1, 0, 0, 0, 0)  # a bit a pixel
    rows = zlib.compress(bytes(SIDE * (1 + SIDE // 8)), 1)
    data = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")
    assert len(data) < 100_000
    (tmp_path / "bomb.png").write_bytes(data)
    with pytest.raises(
        AnnulusError, match=r"bomb\.png: a picture of 12000x12000, expected sides of at most 16384 and 64 Mi"
    ):
        read_image(tmp_path / "bomb.png")
