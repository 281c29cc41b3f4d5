"""The part of Linux's linux/videodev2.h that a camera needs: its structures, and calls that raise OSError.

Names are the kernel's, without V4L2_ and VIDIOC_. Sizes follow from the structures, so that they are right on machines
of 32 bits too. What a device answers is checked where it is used.
"""

import fcntl
import os
from collections.abc import Iterator
from ctypes import Structure, Union, c_char, c_int, c_int32, c_long, c_uint8, c_uint32, c_ulong, sizeof
from typing import Any, TypeVar

CAPTURE = 1  # BUF_TYPE_VIDEO_CAPTURE
MMAP = 1  # MEMORY_MMAP

CAP_VIDEO_CAPTURE = 0x1
CAP_STREAMING = 0x0400_0000
CAP_DEVICE_CAPS = 0x8000_0000
CAP_TIMEPERFRAME = 0x1000  # of a stream's parameters

FIELD_ANY, FIELD_NONE = 0, 1
PRIV_MAGIC = 0xFEED_CAFE  # says that what follows it in `Pixels` is meant

COLORSPACE_SMPTE240M, COLORSPACE_REC709, COLORSPACE_JPEG, COLORSPACE_BT2020, COLORSPACE_DCI_P3 = 2, 3, 7, 10, 12
ENC_DEFAULT, ENC_601, ENC_709, ENC_XV601, ENC_XV709, ENC_BT2020, ENC_SMPTE240M = 0, 1, 2, 3, 4, 6, 8
QUANTIZATION_DEFAULT, QUANTIZATION_FULL, QUANTIZATION_LIMITED = 0, 1, 2

BUF_FLAG_ERROR = 0x40
BUF_FLAG_TIMESTAMP_MASK = 0xE000
BUF_FLAG_TIMESTAMP_MONOTONIC = 0x2000

CID_AUTOGAIN = 0x0098_0912
CID_GAIN = 0x0098_0913
CID_EXPOSURE_AUTO = 0x009A_0901
CID_EXPOSURE_ABSOLUTE = 0x009A_0902
CID_EXPOSURE_AUTO_PRIORITY = 0x009A_0903
EXPOSURE_AUTO, EXPOSURE_MANUAL, EXPOSURE_APERTURE_PRIORITY = 0, 1, 3
CTRL_FLAG_DISABLED = 0x1


class Capability(Structure):
    _fields_ = (
        ("driver", c_char * 16),
        ("card", c_char * 32),
        ("bus_info", c_char * 32),
        ("version", c_uint32),
        ("capabilities", c_uint32),
        ("device_caps", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FormatDescription(Structure):
    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("flags", c_uint32),
        ("description", c_char * 32),
        ("pixelformat", c_uint32),
        ("mbus_code", c_uint32),
        ("reserved", c_uint32 * 3),
    )


class FrameSize(Structure):
    """kind 1: width, height. Others: from the first to the second by steps of the third, width then height."""

    _fields_ = (
        ("index", c_uint32),
        ("pixelformat", c_uint32),
        ("kind", c_uint32),
        ("sides", c_uint32 * 6),
        ("reserved", c_uint32 * 2),
    )


class FrameInterval(Structure):
    """kind 1: one interval, numerator and denominator in seconds. Others: the first to the second."""

    _fields_ = (
        ("index", c_uint32),
        ("pixelformat", c_uint32),
        ("width", c_uint32),
        ("height", c_uint32),
        ("kind", c_uint32),
        ("fractions", c_uint32 * 6),
        ("reserved", c_uint32 * 2),
    )


class Pixels(Structure):
    _fields_ = tuple(
        (name, c_uint32)
        for name in (
            "width",
            "height",
            "pixelformat",
            "field",
            "bytesperline",
            "sizeimage",
            "colorspace",
            "priv",
            "flags",
            "ycbcr_enc",
            "quantization",
            "xfer_func",
        )
    )


class _FormatOf(Union):
    _fields_ = (("pix", Pixels), ("raw", c_uint8 * 200), ("pointer", c_ulong))  # as aligned as the kernel's


class Format(Structure):
    _fields_ = (("type", c_uint32), ("of", _FormatOf))


class StreamParameters(Structure):
    """The frame interval is numerator / denominator seconds."""

    _fields_ = (
        ("type", c_uint32),
        ("capability", c_uint32),
        ("mode", c_uint32),
        ("numerator", c_uint32),
        ("denominator", c_uint32),
        ("raw", c_uint8 * 184),
    )


class RequestBuffers(Structure):
    _fields_ = (
        ("count", c_uint32),
        ("type", c_uint32),
        ("memory", c_uint32),
        ("capabilities", c_uint32),
        ("flags", c_uint32),
    )


class _BufferAt(Union):
    _fields_ = (("offset", c_uint32), ("pointer", c_ulong))


class Buffer(Structure):
    _fields_ = (
        ("index", c_uint32),
        ("type", c_uint32),
        ("bytesused", c_uint32),
        ("flags", c_uint32),
        ("field", c_uint32),
        ("seconds", c_long),
        ("microseconds", c_long),
        ("timecode", c_uint32 * 4),
        ("sequence", c_uint32),
        ("memory", c_uint32),
        ("at", _BufferAt),
        ("length", c_uint32),
        ("reserved", c_uint32 * 2),
    )


class Control(Structure):
    _fields_ = (("id", c_uint32), ("value", c_int32))


class ControlDescription(Structure):
    _fields_ = (
        ("id", c_uint32),
        ("type", c_uint32),
        ("name", c_char * 32),
        ("minimum", c_int32),
        ("maximum", c_int32),
        ("step", c_int32),
        ("usual", c_int32),
        ("flags", c_uint32),
        ("reserved", c_uint32 * 2),
    )


_READ, _WRITE = 2, 1


def _request(direction: int, number: int, argument: type[Any]) -> int:
    return direction << 30 | sizeof(argument) << 16 | ord("V") << 8 | number


QUERYCAP = _request(_READ, 0, Capability)
ENUM_FMT = _request(_READ | _WRITE, 2, FormatDescription)
S_FMT = _request(_READ | _WRITE, 5, Format)
REQBUFS = _request(_READ | _WRITE, 8, RequestBuffers)
QUERYBUF = _request(_READ | _WRITE, 9, Buffer)
QBUF = _request(_READ | _WRITE, 15, Buffer)
DQBUF = _request(_READ | _WRITE, 17, Buffer)
STREAMON = _request(_WRITE, 18, c_int)
STREAMOFF = _request(_WRITE, 19, c_int)
G_PARM = _request(_READ | _WRITE, 21, StreamParameters)
S_PARM = _request(_READ | _WRITE, 22, StreamParameters)
G_CTRL = _request(_READ | _WRITE, 27, Control)
S_CTRL = _request(_READ | _WRITE, 28, Control)
QUERYCTRL = _request(_READ | _WRITE, 36, ControlDescription)
ENUM_FRAMESIZES = _request(_READ | _WRITE, 74, FrameSize)
ENUM_FRAMEINTERVALS = _request(_READ | _WRITE, 75, FrameInterval)

T = TypeVar("T")

LISTED_MAX = 256  # entries of one list: a driver that never ends it is broken


class Device:
    """An open video device. Reading does not wait: `select.poll` on `fd` does."""

    def __init__(self, path: str) -> None:
        self.fd = os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def close(self) -> None:
        os.close(self.fd)

    def call(self, request: int, argument: T) -> T:
        """`argument` as the driver left it."""
        fcntl.ioctl(self.fd, request, argument)  # type: ignore[call-overload]
        return argument

    def set(self, control: int, value: int) -> int:
        """The value that the control has afterwards."""
        self.call(S_CTRL, Control(control, value))
        return int(self.call(G_CTRL, Control(control)).value)

    def control(self, id: int) -> ControlDescription | None:
        """None where the device has no such control."""
        try:
            described = self.call(QUERYCTRL, ControlDescription(id))
        except OSError:
            return None
        return None if described.flags & CTRL_FLAG_DISABLED else described

    def formats(self) -> list[str]:
        """The fourcc of every format that is offered."""
        return [letters(one.pixelformat) for one in self._listed(ENUM_FMT, FormatDescription(type=CAPTURE))]

    def sizes(self, fourcc: str) -> list[str]:
        """The frame sizes of a format, in words."""
        return [
            f"{a}x{b}" if one.kind == 1 else f"{a}x{d} to {b}x{e} in steps of {c}x{f}"
            for one in self._listed(ENUM_FRAMESIZES, FrameSize(pixelformat=number(fourcc)))
            for a, b, c, d, e, f in [one.sides]
        ]

    def rates(self, fourcc: str, width: int, height: int) -> list[str]:
        """The frame rates of a format and size, in words."""
        asked = FrameInterval(pixelformat=number(fourcc), width=width, height=height)
        return [
            f"{b / a:g}" if one.kind == 1 else f"{d / c:g} to {b / a:g}"
            for one in self._listed(ENUM_FRAMEINTERVALS, asked)
            for a, b, c, d, _, _ in [one.fractions]
            if a and (c or one.kind == 1)
        ]

    def _listed(self, request: int, asked: Any) -> Iterator[Any]:
        for index in range(LISTED_MAX):
            asked.index = index
            try:
                yield self.call(request, asked)
            except OSError:
                return


def letters(pixelformat: int) -> str:
    """The fourcc, as people write it."""
    return (pixelformat & 0x7FFF_FFFF).to_bytes(4, "little").decode("ascii", "replace").rstrip()


def number(fourcc: str) -> int:
    return int.from_bytes(fourcc.ljust(4).encode("ascii", "replace")[:4], "little")
