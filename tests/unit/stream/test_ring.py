"""Promises of the ring: a slot is written only when nobody holds it, and nothing is left behind."""

import os
import random
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.ring import FrameRing, Overwritten, RingSlot, RingView
from annulus_pipe.vocabulary import Label


def left_in_shm() -> set[str]:
    """Files in shared memory, but for the semaphores of tests that run beside this one."""
    return {name for name in os.listdir("/dev/shm") if not name.startswith("sem.mp-")}


def header(index: int = 0, width: int = 40, height: int = 30, encoding: str = "mono8") -> FrameHeader:
    return FrameHeader(index, 0, 0, Label.UNKNOWN, "", None, None, None, None, encoding, width, height)  # type: ignore[arg-type]


def test_a_reader_sees_what_the_owner_wrote() -> None:
    ring = FrameRing(3, 3 * 40 * 30)
    view = RingView(ring.fd, ring.frame_bytes)
    rng = np.random.default_rng(0)
    for encoding, shape in (("bgr8", (30, 40, 3)), ("mono8", (30, 40)), ("bayer_rggb8", (30, 40))):
        image = rng.integers(0, 256, shape, dtype=np.uint8)
        place = ring.claim()
        assert place is not None
        ring.write(place, image)
        with view.frame(header(encoding=encoding), place) as seen:
            assert np.array_equal(seen, image)
            assert not seen.flags.writeable
    assert ring.claim() is None


def test_a_held_slot_is_never_given_away() -> None:
    """A thousand seeded steps of claim, hold and release against a model that counts on its fingers."""
    ring, rng = FrameRing(5, 100), random.Random(3)
    model: dict[RingSlot, int] = {}
    for _ in range(1000):
        what = rng.choice(["claim", "hold", "release", "release"])
        if what == "claim":
            place = ring.claim()
            assert (place is None) == (len(model) == 5)
            if place is not None:
                assert place.slot not in {held.slot for held in model}
                model[place] = 1
        elif model:
            place = rng.choice(list(model))
            if what == "hold":
                ring.hold(place)
                model[place] += 1
            else:
                ring.release(place)
                model[place] -= 1
                if not model[place]:
                    del model[place]
        assert ring.free == 5 - len(model)


def test_a_reader_of_a_slot_given_to_another_frame_is_told() -> None:
    ring = FrameRing(2, 40 * 30)
    view = RingView(ring.fd, ring.frame_bytes)
    place = ring.claim()
    assert place is not None
    ring.write(place, np.zeros((30, 40), np.uint8))
    with pytest.raises(Overwritten), view.frame(header(), place):
        ring.release(place)
        assert ring.claim() == RingSlot(place.slot, place.stamp + 1)
    with pytest.raises(Overwritten), view.frame(header(), place):
        pytest.fail("entered")


def test_wrong_use_is_refused() -> None:
    ring = FrameRing(2, 40 * 30)
    view = RingView(ring.fd, ring.frame_bytes)
    place = ring.claim()
    assert place is not None
    with pytest.raises(ValueError, match="do not fit"):
        ring.write(place, np.zeros((31, 40), np.uint8))
    with pytest.raises(ValueError, match="do not fit"):
        ring.write(place, np.zeros((3, 4), np.float32))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="outside"), view.frame(header(), RingSlot(9, 1)):
        pass
    with pytest.raises(ValueError, match="outside"), view.frame(header(width=4000), place):
        pass
    ring.release(place)
    with pytest.raises(ValueError, match="released twice"):
        ring.release(place)


def mapped() -> int:
    """Rings in this process: of a test that failed before, too."""
    return Path("/proc/self/maps").read_text().count("annulus-frames")


def test_nothing_is_left_behind_and_no_descriptor_leaks() -> None:
    shm, descriptors, maps = left_in_shm(), len(os.listdir("/proc/self/fd")), mapped()
    for _ in range(20):
        ring = FrameRing(4, 1 << 20)
        assert left_in_shm() == shm
        ring.close()
        ring.close()
    assert len(os.listdir("/proc/self/fd")) == descriptors
    assert mapped() == maps
