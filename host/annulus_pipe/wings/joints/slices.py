"""One slice of a CT volume out of a TIFF page or a DICOM file: its tags are looked at before anything is unpacked.

A page of 0.2 MB may say that it has 65536^2 pixels, a tile be larger than its page, a picture inside have a size of its
own, and a deflated DICOM file is packed whole, tags and all. So no more is unpacked than a slice of the size that is
expected has.
"""

import io
import math
import zlib
from pathlib import Path
from typing import Any

from annulus_pipe.extras import need

# TIFF's names of none, LZW, LZMA, Deflate (two numbers), PackBits and Zstandard: tifffile tells these how many bytes
# they may make. Codecs of pictures (JPEG, JPEG 2000, WebP ..) believe their own stream.
BOUNDED = {1, 5, 8, 32773, 32946, 34925, 50000}
TILE_OVER = 1024  # pixels that tiles may stand over the page's edge, a side: tiles of 1024 are the largest in use
TAGS_MAX = 4 << 20  # bytes of a deflated DICOM file before its pixels; a scanner writes kilobytes
ELEMENTS_MAX = 20_000  # of a DICOM file, which cost 5 us each; a scanner writes 200
_PIXELS = {0x7FE00008, 0x7FE00009, 0x7FE00010}
PIXEL_BYTES = 8  # of a pixel, at most


def tiff_size(tiff: Any) -> tuple[int, int]:
    """Rows and columns of a file of one slice. ValueError where it is none."""
    if len(tiff.pages) != 1:
        raise ValueError(f"{len(tiff.pages)} pages, expected one slice")
    shape = tiff.pages[0].shape
    if len(shape) != 2:
        raise ValueError(f"{' x '.join(map(str, shape))}, expected one grey slice")
    return int(shape[0]), int(shape[1])


def tiff_page(page: Any, size: tuple[int, int]) -> Any:
    """The greys of a page, (rows, columns). ValueError where its tags say that it is no slice of that size."""
    if tuple(page.shape) != size or page.dtype is None or page.dtype.kind not in "iuf":
        raise ValueError(f"{page.dtype} of {' x '.join(map(str, page.shape))}, expected greys of {size[0]} x {size[1]}")
    if int(page.compression) not in BOUNDED:
        raise ValueError(f"packed as {page.compression}, expected none, LZW, Deflate, LZMA, PackBits or Zstandard")
    if math.prod(page.chunks) > (size[0] + TILE_OVER) * (size[1] + TILE_OVER):
        raise ValueError(f"tiles of {' x '.join(map(str, page.chunks))}, larger than their page")
    if max(page.databytecounts, default=0) > page.parent.filehandle.size:
        raise ValueError("more bytes than the file has")
    return page.asarray(maxworkers=1)  # one tile at a time


def dicom_tags(path: Path) -> Any:
    """All that a file says except its pixels."""
    return _dicom(path, TAGS_MAX, pixels=False)


def dicom_pixels(path: Path, size: tuple[int, int]) -> Any:
    """Its pixels, (rows, columns). ValueError where it is no slice of that size."""
    tags = _dicom(path, TAGS_MAX + size[0] * size[1] * PIXEL_BYTES, pixels=True)
    shape = int(tags.Rows), int(tags.Columns), int(tags.get("NumberOfFrames", 1) or 1), int(tags.SamplesPerPixel)
    if shape != (*size, 1, 1):
        raise ValueError(f"{' x '.join(map(str, shape))}, expected one grey slice of {size[0]} x {size[1]}")
    return tags.pixel_array


def _dicom(path: Path, most: int, pixels: bool) -> Any:
    """most : bytes that a deflated file is unpacked to."""
    need("pydicom")
    from pydicom.filereader import read_partial

    seen, last = 0, False

    def is_enough(tag: Any, _vr: object, _length: int) -> bool:
        """What follows the pixels is nobody's, and may be a gigabyte of nothing."""
        nonlocal seen, last
        seen += 1
        if seen > ELEMENTS_MAX:
            raise ValueError(f"more than {ELEMENTS_MAX} elements")
        enough, last = last or (tag in _PIXELS and not pixels), tag in _PIXELS
        return enough

    with path.open("rb") as file:
        deflated = _deflated(file, most)
        file.seek(0)
        return read_partial(file if deflated is None else deflated, stop_when=is_enough)


def _deflated(file: Any, most: int) -> io.BytesIO | None:
    """A deflated file as one that is not, cut off after `most` bytes of what was packed; None where it is none."""
    from pydicom.filebase import DicomBytesIO  # after need()
    from pydicom.filereader import _read_file_meta_info, read_preamble
    from pydicom.filewriter import write_file_meta_info
    from pydicom.uid import DeflatedExplicitVRLittleEndian, ExplicitVRLittleEndian

    read_preamble(file, force=False)
    meta = _read_file_meta_info(file)
    if meta.get("TransferSyntaxUID") != DeflatedExplicitVRLittleEndian:
        return None
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    plain = DicomBytesIO()
    plain.is_little_endian, plain.is_implicit_VR = True, False
    plain.write(bytes(128) + b"DICM")
    write_file_meta_info(plain, meta, enforce_standard=False)
    plain.write(zlib.decompressobj(-zlib.MAX_WBITS).decompress(file.read(), most))
    return io.BytesIO(plain.getvalue())
