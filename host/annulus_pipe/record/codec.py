"""How a recording keeps its pictures: `[record] codec`. What each costs, and does to a scan: README.md."""

from enum import StrEnum
from typing import cast

import numpy as np

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.numeric.mosaic import Mosaic, Picture, bgr_of

JPEG_QUALITY = 95


class Codec(StrEnum):
    RAW = "raw"  # as the camera gave it
    ZSTD = "zstd"  # the same in chunks that are packed
    JPEG = "jpeg"  # what the eye does not miss is lost


DEFAULT = Codec.ZSTD
SHARE = {Codec.RAW: 1.0, Codec.ZSTD: 0.65, Codec.JPEG: 0.3}  # of a mosaic's bytes, about, before a scan has shown it


def is_mosaic(encoding: str) -> bool:
    return encoding.startswith("bayer_")


def to_picture(image: Image, encoding: str) -> Picture:
    """From any encoding of CHANNELS: a mosaic as it is (of bayer_rggb8 red is at (0, 0)), all else (H, W, 3) BGR."""
    if is_mosaic(encoding):
        return Mosaic(image, encoding.removeprefix("bayer_").removesuffix("8"))
    if encoding == "mono8":
        import cv2  # not by whom imports this: a recorder has to be up at once

        return cast(Image, cv2.cvtColor(image, cv2.COLOR_GRAY2BGR))
    return image


def to_bgr(image: Image, encoding: str) -> Image:
    """(H, W, 3) BGR from any encoding of CHANNELS."""
    return bgr_of(to_picture(image, encoding))


def jpeg(image: Image, encoding: str) -> bytes:
    """A picture in any encoding of CHANNELS as a JPEG, mosaics as what is made of them.

    Colours are kept at every pixel: at every other one the edge of a slit between two colours moves by up to a
    millimetre.
    """
    import cv2  # not by whom imports this: a recorder has to be up at once

    whole = to_bgr(image, encoding) if is_mosaic(encoding) else image
    settings = [
        cv2.IMWRITE_JPEG_QUALITY,
        JPEG_QUALITY,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR,
        cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    ]
    return bytes(np.asarray(cv2.imencode(".jpg", whole, settings)[1]).data)
