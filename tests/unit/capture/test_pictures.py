"""Promises of pictures from outside: read as they are, or one line; never larger than they may be."""

import random

import cv2
import numpy as np
import pytest

from annulus_pipe.capture.pictures import PIXELS_MAX, SCANS_MAX, decode

H, W = 18, 26
PICTURE = cv2.GaussianBlur(np.random.default_rng(0).integers(0, 256, (H, W, 3), dtype=np.uint8), (0, 0), 2)
KINDS = (".png", ".jpg", ".bmp", ".tiff", ".ppm", ".pgm", ".webp")


def encoded(kind: str, picture: np.ndarray = PICTURE) -> bytes:
    good, data = cv2.imencode(kind, picture[..., 0] if kind == ".pgm" else picture)
    assert good
    return data.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read_as_opencv_reads_it(kind: str) -> None:
    data = encoded(kind)
    assert np.array_equal(decode(data, (W, H)), cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR))
    with pytest.raises(ValueError, match=f"a picture of {W}x{H}, expected 5x6"):
        decode(data, (5, 6))


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_picture_is_one_line_or_of_its_size(kind: str) -> None:
    rng, whole = random.Random(1), encoded(kind)
    for _ in range(150):
        data = bytearray(whole)
        at = rng.randrange(len(data))
        data[at : at + rng.randrange(1, 5)] = rng.randbytes(rng.randrange(5))
        try:
            assert decode(bytes(data)).size <= 3 * PIXELS_MAX
        except ValueError as error:
            assert "\n" not in str(error) and len(str(error)) < 200


@pytest.mark.parametrize("kind", (".png", ".jpg"))
def test_a_picture_cut_anywhere_is_refused(kind: str) -> None:
    whole = encoded(kind)
    for end in range(0, len(whole) - 1, 7):
        with pytest.raises(ValueError, match=r"truncated|neither"):
            decode(whole[:end])


def test_what_costs_more_than_its_pixels_is_refused() -> None:
    data = encoded(".jpg")
    at = data.index(b"\xff\xda")
    with pytest.raises(ValueError, match="scans"):
        decode(data[:at] + data[at:-2] * (SCANS_MAX + 1) + data[-2:])
    with pytest.raises(ValueError, match="a picture of 16384x16384"):
        decode(b"P5 16384 16384 255\n")
    with pytest.raises(ValueError, match="neither JPEG nor PNG"):
        decode(b"GIF89a")
