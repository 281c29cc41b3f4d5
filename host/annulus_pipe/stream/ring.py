"""Frames between processes: a ring of slots in shared memory that no crash can leave behind.

The memory is an anonymous file (memfd) made by the owner and inherited by its children as a descriptor. It never has a
name, so nothing is left in /dev/shm whoever is killed however, and a small /dev/shm (a container's 64 MiB) does not
limit it. Not `multiprocessing.shared_memory`: on Python 3.11 its tracker unlinks segments other processes still use.
"""

import mmap
import os
import struct
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import AnnulusError

_STAMP = struct.Struct("<Q")
_PAGE = mmap.PAGESIZE


class Overwritten(Exception):
    """The slot was given to another frame while it was being read: what was read is worth nothing."""


@dataclass(frozen=True, slots=True)
class RingSlot:
    """Where a frame lies: the slot, and the stamp the slot carries as long as that frame is in it."""

    slot: int
    stamp: int


@dataclass(slots=True)
class _Slot:
    stamp: int = 0
    holders: int = 0


class FrameRing:
    """The owner's side. Every slot is free, lent to somebody who writes a frame into it, or held by those the frame was
    handed to.

    Not thread-safe by itself: all but `write` belong to one thread.
    """

    def __init__(self, slots: int, frame_bytes: int) -> None:
        """Raises AnnulusError when the memory is not there."""
        if not 2 <= slots <= 4096 or not 0 < frame_bytes <= 1 << 30:
            raise ValueError(f"a ring of {slots} slots of {frame_bytes} bytes")
        self.frame_bytes = frame_bytes
        self._stride = stride_of(frame_bytes)
        self._slots = [_Slot() for _ in range(slots)]
        self._free = list(range(slots))
        self._lent: set[int] = set()  # slots
        self._next_stamp = 1
        total = slots * self._stride
        self.fd = os.memfd_create("annulus-frames", os.MFD_CLOEXEC)
        try:
            os.posix_fallocate(self.fd, 0, total)  # now, so that a lack of memory is an error here and not SIGBUS later
            self._memory = mmap.mmap(self.fd, total)
        except OSError as error:
            os.close(self.fd)
            raise AnnulusError(
                f"no memory for {slots} frames of {frame_bytes / 1e6:.1f} MB ({error.strerror}). "
                "Ask for fewer stream slots."
            ) from None

    @property
    def free(self) -> int:
        """Slots without a frame, lent ones too."""
        return len(self._free) + len(self._lent)

    def __len__(self) -> int:
        return len(self._slots)

    def claim(self) -> RingSlot | None:
        """A free slot for the next frame, held once by the caller; None when every slot is lent or held."""
        place = self.lend()
        if place is not None:
            self.filled(place)
        return place

    def lend(self) -> RingSlot | None:
        """A free slot for somebody else to write, who says when it is `filled`, or will not be: `give_back`."""
        if not self._free:
            return None
        number = self._free.pop()
        slot = self._slots[number]
        slot.stamp, slot.holders = self._next_stamp, 0
        self._next_stamp += 1
        self._lent.add(number)
        _STAMP.pack_into(
            self._memory, number * self._stride, 0
        )  # readers of the frame before see at once that it is gone
        return RingSlot(number, slot.stamp)

    def filled(self, place: RingSlot) -> None:
        """A lent slot has its frame, and is held once by the caller."""
        self._take_back(place).holders = 1

    def give_back(self, place: RingSlot) -> None:
        """A lent slot is free again. Only when nobody can write it any more."""
        self._take_back(place)
        self._free.append(place.slot)

    def write(self, place: RingSlot, image: Image) -> None:
        """Copy `image` (uint8, any shape, at most `frame_bytes`) into a claimed slot, then put its stamp on it."""
        _write(self._memory, self.frame_bytes, place, image)

    def view(self, header: FrameHeader, place: RingSlot) -> Image:
        """The image in a slot the caller holds; valid until released."""
        return _image(self._memory, self._stride, header, place)

    def hold(self, place: RingSlot) -> None:
        """One more holder."""
        self._checked(place).holders += 1

    def release(self, place: RingSlot) -> None:
        """One holder less; the last one frees the slot."""
        slot = self._checked(place)
        slot.holders -= 1
        if slot.holders == 0:
            self._free.append(place.slot)

    def _take_back(self, place: RingSlot) -> _Slot:
        slot = self._slots[place.slot]
        if slot.stamp != place.stamp or place.slot not in self._lent:
            raise ValueError(f"{place} is not lent")
        self._lent.remove(place.slot)
        return slot

    def _checked(self, place: RingSlot) -> _Slot:
        slot = self._slots[place.slot]
        if slot.stamp != place.stamp or slot.holders <= 0:
            raise ValueError(f"{place} is not held: released twice?")
        return slot

    def close(self) -> None:
        with suppress(BufferError):  # somebody still looks at a frame: the mapping goes when that view does
            self._memory.close()
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1


class RingWriter:
    """The side of one who fills lent slots: the same memory, from the inherited descriptor."""

    def __init__(self, fd: int, frame_bytes: int) -> None:
        self._frame_bytes = frame_bytes
        self._memory = mmap.mmap(fd, os.fstat(fd).st_size)

    def write(self, place: RingSlot, image: Image) -> None:
        """As FrameRing.write."""
        _write(self._memory, self._frame_bytes, place, image)

    def close(self) -> None:
        with suppress(BufferError):
            self._memory.close()


class RingView:
    """A reader's side: the same memory, read-only, from the inherited descriptor."""

    def __init__(self, fd: int, frame_bytes: int) -> None:
        self._stride = stride_of(frame_bytes)
        self._frame_bytes = frame_bytes
        size = os.fstat(fd).st_size
        if size == 0 or size % self._stride:
            raise ValueError(f"the shared memory has {size} bytes, not a whole number of slots of {self._stride}")
        self._slots = size // self._stride
        self._memory = mmap.mmap(fd, size, prot=mmap.PROT_READ)

    @contextmanager
    def frame(self, header: FrameHeader, place: RingSlot) -> Iterator[Image]:
        """The image, without a copy. Raises Overwritten on entry or exit when the slot holds another frame."""
        if not 0 <= place.slot < self._slots or header.size > self._frame_bytes:
            raise ValueError(f"{place} and {header.size} bytes lie outside the ring")
        self._check(place)
        yield _image(self._memory, self._stride, header, place)
        self._check(place)

    def _check(self, place: RingSlot) -> None:
        if _STAMP.unpack_from(self._memory, place.slot * self._stride)[0] != place.stamp:
            raise Overwritten(f"slot {place.slot} no longer holds frame stamp {place.stamp}")

    def close(self) -> None:
        with suppress(BufferError):
            self._memory.close()


def stride_of(frame_bytes: int) -> int:
    """Bytes from slot to slot: one page for the stamp, then the image on a page boundary."""
    return _PAGE + -(-frame_bytes // _PAGE) * _PAGE


def _write(memory: mmap.mmap, frame_bytes: int, place: RingSlot, image: Image) -> None:
    flat = np.ascontiguousarray(image).reshape(-1)
    if image.dtype != np.uint8 or flat.nbytes > frame_bytes:
        raise ValueError(f"{flat.nbytes} bytes of {image.dtype} do not fit a slot of {frame_bytes} bytes")
    start = place.slot * stride_of(frame_bytes)
    np.frombuffer(memory, np.uint8, flat.nbytes, start + _PAGE)[:] = flat
    _STAMP.pack_into(memory, start, place.stamp)


def _image(memory: mmap.mmap, stride: int, header: FrameHeader, place: RingSlot) -> Image:
    return np.frombuffer(memory, np.uint8, header.size, place.slot * stride + _PAGE).reshape(header.shape)
