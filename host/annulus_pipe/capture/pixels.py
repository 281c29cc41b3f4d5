"""Bytes of a video driver to a picture: every fourcc that is read, with its stride, matrix and range.

OpenCV's own conversions know one kind of Y'CbCr, that of old television (BT.601, 16..235). A driver says which it
gives; what is of another kind is converted by its own numbers, not by these.
"""

from dataclasses import dataclass
from typing import cast

import cv2
import numpy as np
from numpy.lib.stride_tricks import as_strided

from annulus_pipe.capture import videodev
from annulus_pipe.capture.camera import BGR8, MONO8, MOSAICS
from annulus_pipe.capture.pictures import decode
from annulus_pipe.numeric.arrays import Image

_YUV = ("YU12", "YV12", "NV12", "NV21", "YUYV", "UYVY", "YVYU")
_PACKED = {"YUYV": (0, 1, 3), "UYVY": (1, 0, 2), "YVYU": (0, 3, 1)}  # where Y, Cb and Cr begin in four bytes
_FAST = {
    "YU12": cv2.COLOR_YUV2BGR_I420,
    "YV12": cv2.COLOR_YUV2BGR_YV12,
    "NV12": cv2.COLOR_YUV2BGR_NV12,
    "NV21": cv2.COLOR_YUV2BGR_NV21,
    "YUYV": cv2.COLOR_YUV2BGR_YUYV,
    "UYVY": cv2.COLOR_YUV2BGR_UYVY,
    "YVYU": cv2.COLOR_YUV2BGR_YVYU,
}
_MOSAICS = {"RGGB": "RGGB", "BA81": "BGGR", "GBRG": "GBRG", "GRBG": "GRBG"}
_JPEG = ("MJPG", "JPEG")

ENCODINGS_OF = {
    **dict.fromkeys((*_YUV, *_JPEG, "BGR3", "RGB3"), BGR8),
    **{fourcc: MOSAICS[order] for fourcc, order in _MOSAICS.items()},  # as they are
    "GREY": MONO8,
}
"""The fourcc that are read, and what they become."""

_WEIGHTS = {  # of red and blue in luma
    videodev.ENC_601: (0.299, 0.114),
    videodev.ENC_XV601: (0.299, 0.114),
    videodev.ENC_709: (0.2126, 0.0722),
    videodev.ENC_XV709: (0.2126, 0.0722),
    videodev.ENC_BT2020: (0.2627, 0.0593),
    videodev.ENC_SMPTE240M: (0.212, 0.087),
}
_USUAL = {
    videodev.COLORSPACE_REC709: videodev.ENC_709,
    videodev.COLORSPACE_DCI_P3: videodev.ENC_709,
    videodev.COLORSPACE_BT2020: videodev.ENC_BT2020,
    videodev.COLORSPACE_SMPTE240M: videodev.ENC_SMPTE240M,
}


@dataclass(frozen=True, slots=True)
class Layout:
    """How one driver lays a picture out. Raises ValueError when that is no layout that is read."""

    fourcc: str
    width: int
    height: int
    stride: int  # bytes from one row to the next, of the first plane
    encoding: int = videodev.ENC_601  # videodev.ENC_*, never ENC_DEFAULT
    full: bool = False  # luma 0..255 instead of 16..235

    def __post_init__(self) -> None:
        if self.fourcc in _YUV and (self.width % 2 or self.height % 2):
            raise ValueError(f"{self.fourcc} of {self.width}x{self.height}, expected even sides")
        if self.fourcc in _YUV and self.encoding not in _WEIGHTS:
            raise ValueError(f"Y'CbCr encoding {self.encoding}, expected one of {', '.join(map(str, _WEIGHTS))}")
        if self.fourcc not in _JPEG and self.stride < self.row_bytes:
            raise ValueError(f"rows of {self.stride} bytes, expected {self.row_bytes} for {self.width} {self.fourcc}")

    @classmethod
    def of(cls, pixels: videodev.Pixels) -> "Layout":
        """What the driver said when the format was set."""
        encoding = pixels.ycbcr_enc or _USUAL.get(pixels.colorspace, videodev.ENC_601)
        is_jpeg = pixels.colorspace == videodev.COLORSPACE_JPEG
        full = pixels.quantization == videodev.QUANTIZATION_FULL or (not pixels.quantization and is_jpeg)
        return cls(
            videodev.letters(pixels.pixelformat), pixels.width, pixels.height, pixels.bytesperline, encoding, full
        )

    @property
    def row_bytes(self) -> int:
        """Of a row of the first plane, without what pads it."""
        return self.width * {"YUYV": 2, "UYVY": 2, "YVYU": 2, "BGR3": 3, "RGB3": 3}.get(self.fourcc, 1)

    def picture(self, data: Image) -> Image | None:
        """(bytes,) uint8 to the picture, a copy; None where bytes are missing or a JPEG is cut off."""
        if self.fourcc in _JPEG:
            return _decode(data, (self.width, self.height))
        h, w = self.height, self.width
        planes = [(h, self.stride, self.row_bytes)]  # rows, from one to the next, of it picture
        if self.fourcc in ("YU12", "YV12"):
            planes.append((h, self.stride // 2, w // 2))  # one above the other
        elif self.fourcc in ("NV12", "NV21"):
            planes.append((h // 2, self.stride, w))
        parts, at = [], 0
        for rows, stride, used in planes:
            if len(data) < at + stride * (rows - 1) + used:
                return None
            parts.append(np.ascontiguousarray(as_strided(data[at:], (rows, used), (stride, 1))))
            at += rows * stride
        return self._converted(parts)

    def _converted(self, parts: list[Image]) -> Image:
        h, w = self.height, self.width
        match self.fourcc:
            case "GREY" | "RGGB" | "BA81" | "GBRG" | "GRBG":
                return parts[0].copy()
            case "BGR3":
                return parts[0].reshape(h, w, 3).copy()
            case "RGB3":
                return _cv(cv2.cvtColor(parts[0].reshape(h, w, 3), cv2.COLOR_RGB2BGR))
        if self.encoding in (videodev.ENC_601, videodev.ENC_XV601) and not self.full:
            packed = self.fourcc in _PACKED
            whole = parts[0].reshape(h, w, 2) if packed else np.concatenate([part.ravel() for part in parts])
            return _cv(cv2.cvtColor(whole if packed else whole.reshape(h * 3 // 2, w), _FAST[self.fourcc]))
        luma = parts[0][:, _PACKED[self.fourcc][0] :: 2] if self.fourcc in _PACKED else parts[0]
        chroma = (cv2.resize(small, (w, h), interpolation=cv2.INTER_NEAREST) for small in self._chroma(parts))
        ycc = cv2.merge([np.ascontiguousarray(luma), *chroma])
        return _cv(cv2.transform(ycc, _matrix(*_WEIGHTS[self.encoding], self.full)))

    def _chroma(self, parts: list[Image]) -> list[Image]:
        """Cb and Cr, smaller than the picture."""
        h, w = self.height // 2, self.width // 2
        if self.fourcc in _PACKED:  # as high as the picture
            _, cb, cr = _PACKED[self.fourcc]
            return [np.ascontiguousarray(parts[0][:, begin::4]) for begin in (cb, cr)]
        if self.fourcc in ("NV12", "NV21"):
            pair = [np.ascontiguousarray(parts[1][:, begin::2]) for begin in (0, 1)]
        else:
            pair = [half.reshape(h, w) for half in np.split(parts[1].ravel(), 2)]
        return pair if self.fourcc in ("YU12", "NV12") else pair[::-1]


def _matrix(red: float, blue: float, full: bool) -> np.ndarray:
    """(3, 4): Y, Cb, Cr and 1 to B, G, R."""
    luma, colour, black = (1.0, 1.0, 0.0) if full else (255 / 219, 255 / 224, 16.0)
    green = 1 - red - blue
    rows = np.array(
        [
            [luma, 2 * (1 - blue) * colour, 0],
            [luma, -2 * blue * (1 - blue) / green * colour, -2 * red * (1 - red) / green * colour],
            [luma, 0, 2 * (1 - red) * colour],
        ]
    )
    return np.column_stack([rows, -rows @ [black, 128.0, 128.0]])


def _decode(data: Image, size: tuple[int, int]) -> Image | None:
    """OpenCV fills what is missing of a JPEG with grey and says nothing: it must have its end."""
    end = len(data) - int(np.argmax(data[::-1] != 0)) if len(data) else 0  # drivers pad with zeros
    if end < 4 or bytes(data[:2]) != b"\xff\xd8" or bytes(data[end - 2 : end]) != b"\xff\xd9":
        return None
    try:
        return decode(bytes(data[:end]), size)
    except ValueError:
        return None


def _cv(image: object) -> Image:
    return cast(Image, image)
