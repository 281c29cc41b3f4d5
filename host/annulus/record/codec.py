"""How a recording keeps its pictures: `[record] codec`. What each costs, and does to a scan: README.md."""

from enum import StrEnum

import numpy as np

from annulus.numeric.arrays import Image

JPEG_QUALITY = 95


class Codec(StrEnum):
    RAW = "raw"  # as the camera gave it
    ZSTD = "zstd"  # the same in chunks that are packed
    JPEG = "jpeg"  # what the eye does not miss is lost


DEFAULT = Codec.ZSTD
SHARE = {Codec.RAW: 1.0, Codec.ZSTD: 0.65, Codec.JPEG: 0.3}  # of a mosaic's bytes, about, before a scan has shown it


def jpeg(image: Image, encoding: str) -> bytes:
    """A picture in any encoding of CHANNELS as a JPEG, mosaics as what is made of them.

    Colours are kept at every pixel: at every other one the edge of a slit between two colours moves by up to a
    millimetre.
    """
    import cv2  # not by whom imports this: a recorder has to be up at once

    whole = cv2.cvtColor(image, cv2.COLOR_BayerRGGB2BGR) if encoding == "bayer_rggb8" else image
    settings = [
        cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444
    ]  # fmt: skip
    return bytes(np.asarray(cv2.imencode(".jpg", whole, settings)[1]).data)
