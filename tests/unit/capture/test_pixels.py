"""Bytes of a driver become the picture it meant, whatever its fourcc, stride, matrix and range, or none."""

import cv2
import numpy as np
import pytest

from annulus_pipe.capture import videodev
from annulus_pipe.capture.pixels import ENCODINGS_OF, Layout

W, H = 24, 16
RNG = np.random.default_rng(10)
# Y, Cb, Cr of saturated colours: blocks of 8 x 8, so that half-size chroma loses nothing
COLOURS = np.kron(RNG.integers(40, 210, (H // 8, W // 8, 3)), np.ones((8, 8, 1))).astype(np.uint8)
YUV = sorted(name for name in ENCODINGS_OF if name[0] in "YNU" and name != "GREY")


def laid_out(fourcc: str, padding: int = 0) -> tuple[np.ndarray, int]:
    """The bytes and the stride of COLOURS as a driver would give them."""
    y, cb, cr = (COLOURS[..., i] for i in range(3))
    half = [c[::2, ::2] for c in (cb, cr)]
    match fourcc:
        case "YU12" | "YV12":
            planes = [y, *(half if fourcc == "YU12" else half[::-1])]
        case "NV12" | "NV21":
            planes = [y, np.dstack(half if fourcc == "NV12" else half[::-1]).reshape(H // 2, W)]
        case _:
            at = {"YUYV": (0, 1, 3), "UYVY": (1, 0, 2), "YVYU": (0, 3, 1)}[fourcc]
            packed = np.zeros((H, W // 2, 4), np.uint8)
            packed[..., at[0]], packed[..., at[0] + 2] = y[:, ::2], y[:, 1::2]
            packed[..., at[1]], packed[..., at[2]] = cb[:, ::2], cr[:, ::2]
            planes = [packed.reshape(H, 2 * W)]
    padded = [
        np.pad(plane, ((0, 0), (0, padding * plane.shape[1] // planes[0].shape[1])), constant_values=99)
        for plane in planes
    ]
    return np.concatenate([plane.ravel() for plane in padded]), padded[0].shape[1]


def meant(red: float, blue: float, full: bool) -> np.ndarray:
    """BGR by the definition of Y'CbCr (ITU-R BT.601, BT.709), in floating point."""
    y, cb, cr = (COLOURS[..., i].astype(float) for i in range(3))
    y, cb, cr = (
        (y, cb - 128, cr - 128) if full else ((y - 16) * 255 / 219, (cb - 128) * 255 / 224, (cr - 128) * 255 / 224)
    )
    r, b = y + 2 * (1 - red) * cr, y + 2 * (1 - blue) * cb
    g = (y - red * r - blue * b) / (1 - red - blue)
    return np.clip(np.dstack([b, g, r]), 0, 255)


@pytest.mark.parametrize("padding", [0, 16])
@pytest.mark.parametrize("fourcc", YUV)
def test_every_matrix_and_range_gives_the_colours_that_were_meant(fourcc: str, padding: int) -> None:
    data, stride = laid_out(fourcc, padding)
    for encoding, red, blue in ((videodev.ENC_601, 0.299, 0.114), (videodev.ENC_709, 0.2126, 0.0722)):
        for full in (False, True):
            image = Layout(fourcc, W, H, stride, encoding, full).picture(data)
            assert image is not None and image.shape == (H, W, 3)
            assert np.abs(image - meant(red, blue, full)).max() <= 1.5  # levels


def test_what_a_driver_leaves_open_is_what_the_kernels_own_table_says() -> None:
    def layout(**said: int) -> tuple[int, bool]:
        pixels = videodev.Pixels(width=W, height=H, pixelformat=videodev.number("YUYV"), bytesperline=2 * W, **said)
        got = Layout.of(pixels)
        return got.encoding, got.full

    assert layout() == (videodev.ENC_601, False)
    assert layout(colorspace=videodev.COLORSPACE_REC709) == (videodev.ENC_709, False)
    assert layout(colorspace=videodev.COLORSPACE_JPEG) == (videodev.ENC_601, True)
    assert layout(colorspace=videodev.COLORSPACE_JPEG, quantization=2) == (videodev.ENC_601, False)
    assert layout(ycbcr_enc=videodev.ENC_709, quantization=1) == (videodev.ENC_709, True)
    with pytest.raises(ValueError, match="Y'CbCr encoding 7"):
        layout(ycbcr_enc=7)


def test_mosaics_stay_as_they_are_and_say_which_colour_comes_first() -> None:
    for fourcc, first in {"RGGB": "RGGB", "BA81": "BGGR", "GBRG": "GBRG", "GRBG": "GRBG"}.items():
        colour = {"R": 200, "G": 100, "B": 30}
        mosaic = np.tile(np.array([colour[c] for c in first], np.uint8).reshape(2, 2), (H // 2, W // 2))
        image = Layout(fourcc, W, H, W + 8).picture(np.pad(mosaic, ((0, 0), (0, 8))).ravel()[: H * (W + 8) - 8])
        assert image is not None
        assert np.array_equal(image, mosaic) and ENCODINGS_OF[fourcc] == f"bayer_{first.lower()}8"


def test_rgb_and_grey() -> None:
    bgr = RNG.integers(0, 256, (H, W, 3)).astype(np.uint8)
    for fourcc, data in (("BGR3", bgr), ("RGB3", bgr[..., ::-1])):
        assert np.array_equal(Layout(fourcc, W, H, 3 * W).picture(data.copy().ravel()), bgr)  # type: ignore[arg-type]
    grey = Layout("GREY", W, H, W).picture(bgr[..., 0].copy().ravel())
    assert np.array_equal(grey, bgr[..., 0])  # type: ignore[arg-type]


def test_a_picture_that_is_cut_off_is_none() -> None:
    for fourcc in YUV:
        data, stride = laid_out(fourcc)
        assert Layout(fourcc, W, H, stride).picture(data) is not None
        assert Layout(fourcc, W, H, stride).picture(data[:-1]) is None
    jpeg = cv2.imencode(".jpg", np.full((H, W, 3), 77, np.uint8))[1]
    layout = Layout("MJPG", W, H, 0)
    for good in (jpeg, np.pad(jpeg, (0, 40))):
        image = layout.picture(good)
        assert image is not None and abs(int(image.mean()) - 77) <= 1
    for cut in (jpeg[:-1], jpeg[: len(jpeg) // 2], jpeg[:0], np.zeros(50, np.uint8)):
        assert layout.picture(cut) is None


def test_a_motion_jpeg_without_huffman_tables_is_read() -> None:
    """Webcams leave them out: they are the standard's."""
    jpeg = bytearray(cv2.imencode(".jpg", np.full((H, W, 3), 77, np.uint8))[1])
    while (at := jpeg.find(b"\xff\xc4")) >= 0:
        del jpeg[at : at + 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")]
    image = Layout("MJPG", W, H, 0).picture(np.frombuffer(bytes(jpeg), np.uint8))
    assert image is not None and abs(int(image.mean()) - 77) <= 1


def test_a_layout_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="rows of 20 bytes, expected 24"):
        Layout("GREY", 24, 16, 20)
    with pytest.raises(ValueError, match="even sides"):
        Layout("YU12", 23, 16, 24)
