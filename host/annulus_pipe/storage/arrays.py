"""Files of arrays from outside, looked at before anything in them is read: what they hold, and what it would become.

HDF5 can point to other files (external links, external and virtual data sets), and both HDF5 and NumPy's archives can
hold far more than their size says. What points elsewhere is refused, and so is what is larger than memory should be.
ValueError, one line.
"""

import ast
import math
import mmap
import struct
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from annulus_pipe.extras import need

BYTES_MAX = 1 << 32  # of one array; a turn of 720 positions and a million samples has 3 GB
NAMES_MAX = 200_000  # in one file; 8192 detectors have 5 each
RATIO_MAX = 100  # of what is unpacked to what is packed; recorded sound is packed to a half
UNPACKED_MAX = 1 << 26  # bytes that may be packed however tightly
FILTERS = {1, 2, 3}  # deflate, shuffle, fletcher32: HDF5's own numbers, H5Z_FILTER_DEFLATE ..
_HEAP, _HEAP_HEAD = b"GCOL\x01\0\0\0", 16  # how a collection of texts begins, and the bytes before its first
_OBJECT = struct.Struct("<HHIQ")  # number, 0 for what is free; users; padding; bytes
_HEAD_MAX = 10_000  # bytes of an array's head in .npy


def require_plain_hdf5(root: Any) -> None:
    """Every name in the file is a group or an array that lies in this file, of a size that may be read, and its texts
    are where reading ends."""
    h5py = need("h5py")
    _require_heaps_that_end(root)
    waiting, seen, count = [root], set(), 0
    while waiting:
        group = waiting.pop()
        place = h5py.h5o.get_info(group.id)
        if (address := (place.fileno, place.addr)) in seen:  # a hard link back up
            continue
        seen.add(address)
        for name in group:
            count += 1
            if count > NAMES_MAX:
                raise ValueError(f"more than {NAMES_MAX} names")
            link = group.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink):
                raise ValueError(f"{group.name}/{name} leads elsewhere ({type(link).__name__})")
            found = group[name]
            if isinstance(found, h5py.Group):
                waiting.append(found)
            elif isinstance(found, h5py.Dataset):
                _require_plain(found)


def _require_heaps_that_end(root: Any) -> None:
    """HDF5 keeps texts in collections of objects, and walks those by the size that each says it has: for ever where one
    says that it has none (libhdf5 2.0, H5HG__cache_heap_deserialize).
    """
    if root.id.get_create_plist().get_sizes() != (8, 8):
        raise ValueError("its addresses or lengths are not of 8 bytes")
    with open(root.filename, "rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        begin, walked = content.find(_HEAP), 0
        while begin >= 0:
            at = begin + _HEAP_HEAD
            (size,) = struct.unpack_from("<Q", content[begin + len(_HEAP) : at].ljust(8, b"\0"))
            end = begin + size
            if end <= len(content):
                walked += size
                if walked > 4 * len(content):  # they lie side by side, but for what was written over
                    raise ValueError("its collections of texts lie within each other")
                while at + _OBJECT.size <= end:
                    number, _, _, length = _OBJECT.unpack_from(content, at)
                    at += _OBJECT.size + length + -length % 8 if number else length
                    if at > end or (number == 0 and length < _OBJECT.size):
                        raise ValueError(f"the texts at byte {begin} do not end where they should")
            begin = content.find(_HEAP, begin + 1)


def _require_plain(data: Any) -> None:
    if data.external or data.is_virtual:
        raise ValueError(f"{data.name} lies in other files")
    size = math.prod(data.shape or ()) * data.dtype.itemsize
    if size > BYTES_MAX:
        raise ValueError(f"{data.name} is of {size >> 20} MiB, expected at most {BYTES_MAX >> 20}")
    filters = data.id.get_create_plist()
    for i in range(filters.get_nfilters()):
        if filters.get_filter(i)[0] not in FILTERS:
            raise ValueError(f"{data.name} is packed by {filters.get_filter(i)[3]!r}, expected deflate or nothing")
    stored = data.id.get_storage_size()
    if size > max(UNPACKED_MAX, RATIO_MAX * stored):
        raise ValueError(f"{data.name} would become {size} bytes from {stored}")


def require_plain_npz(path: Path | BinaryIO, most: Mapping[str, int] | None = None) -> None:
    """Every member is an array that may be read, and is no larger than its head says. most: bytes that an array of that
    name may have; of others, which nobody reads, BYTES_MAX."""
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        if len(members) > NAMES_MAX:
            raise ValueError(f"more than {NAMES_MAX} arrays")
        for member in members:
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"{member.filename} is packed otherwise than NumPy does")
            limit = (most or {}).get(member.filename.removesuffix(".npy"), BYTES_MAX) + _HEAD_MAX
            if member.file_size > min(limit, max(UNPACKED_MAX, RATIO_MAX * member.compress_size)):
                raise ValueError(f"{member.filename} would become {member.file_size} bytes")
            with archive.open(member) as file:
                held = _size_of_array(file.read(_HEAD_MAX))
            if held > member.file_size:
                raise ValueError(f"{member.filename} says it has {held} bytes, and has {member.file_size}")


def _size_of_array(head: bytes) -> int:
    """Bytes of the array whose .npy begins like this. NumPy makes room for all of it before it reads."""
    if head[:6] != b"\x93NUMPY" or len(head) < 12:
        raise ValueError("what is not an array is in it")
    long = head[6] > 1
    (length,) = struct.unpack_from("<I" if long else "<H", head, 8)
    begin = 12 if long else 10
    try:
        about = ast.literal_eval(head[begin : begin + length].decode("latin1"))
        shape, kind = tuple(about["shape"]), np.dtype(about["descr"])
    except (SyntaxError, TypeError, KeyError, MemoryError, RecursionError):
        raise ValueError("an array that does not say what it is") from None
    if len(shape) > 32 or not all(isinstance(side, int) and 0 <= side < 1 << 40 for side in shape):
        raise ValueError("an array of no shape")
    if kind.kind not in "biufUS":
        raise ValueError(f"an array of {kind.name}, expected numbers or a text")
    return int(math.prod(shape) * kind.itemsize)
