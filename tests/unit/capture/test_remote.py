"""A camera served by another process, whoever that is: believed only where what it says makes sense."""

import array
import json
import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from annulus_pipe.capture.camera import BGR8, MONO8, grab
from annulus_pipe.capture.picamera import plug
from annulus_pipe.capture.remote import RemoteCamera
from annulus_pipe.vocabulary import AnnulusError

HELLO = {"width": 8, "height": 4, "encoding": MONO8, "timing": {"fps": 25.0, "exposure_us": 38e3, "readout_us": 28e3}}


@contextmanager
def served(hello: dict[str, Any], *frames: dict[str, Any], pixels: bytes = bytes(range(64))) -> Iterator[str]:
    """The address of a camera that says these and then waits until the other end has gone."""
    name = f"annulus-test-{os.getpid()}-{threading.get_ident()}"
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    listener.bind("\0" + name)
    listener.listen(1)
    memory = os.memfd_create("test")
    os.write(memory, pixels)

    def serve() -> None:
        host, _ = listener.accept()
        rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [memory]))]
        host.sendmsg([json.dumps(hello).encode()], rights)
        for frame in frames:
            host.send(json.dumps(frame).encode())
        while host.recv(4096):
            pass
        host.close()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield "@" + name
    finally:
        thread.join(5.0)
        listener.close()
        os.close(memory)


def test_pictures_come_out_of_shared_memory_in_the_encoding_that_was_said() -> None:
    with served(HELLO, {"slot": 1, "SensorTimestamp": 5, "FrameSequence": 7}) as address:
        camera = plug(RemoteCamera(address))
        camera.start()
        frame = grab(camera)
        assert (frame.encoding, frame.timestamp_ns, frame.sequence) == (MONO8, 5, 7)
        assert np.array_equal(frame.image, np.arange(32, 64, dtype=np.uint8).reshape(4, 8))
        with pytest.raises(AnnulusError, match="ExposureTime is 38000 us, expected 5000"):
            camera.set_controls({"ExposureTime": 5000})
        camera.close()
    coloured = {**HELLO, "width": 4, "encoding": BGR8}
    with served(coloured, {"slot": 0, "SensorTimestamp": 5}) as address:
        camera = RemoteCamera(address)
        assert grab(camera).image.shape == (4, 4, 3)
        camera.close()


@pytest.mark.parametrize(
    ("changed", "complaint"),
    [
        ({"width": 0}, "width is 0"),
        ({"encoding": "yuv"}, "encoding is yuv"),
        ({"timing": {"fps": 25.0}}, "exposure_us"),
        ({"timing": {**HELLO["timing"], "exposure_us": 1e5}}, "does not fit a frame"),  # type: ignore[dict-item]
    ],
)
def test_a_hello_that_makes_no_sense_is_refused_by_name(changed: dict[str, Any], complaint: str) -> None:
    with served({**HELLO, **changed}) as address, pytest.raises(AnnulusError, match=complaint):
        RemoteCamera(address)


def test_a_slot_outside_the_memory_is_refused() -> None:
    with served(HELLO, {"slot": 2, "SensorTimestamp": 5}) as address:
        camera = RemoteCamera(address)
        with pytest.raises(AnnulusError, match="slot is 2"):
            camera.capture_request()
        camera.close()


def test_nobody_there_is_one_plain_line() -> None:
    with pytest.raises(AnnulusError, match="@nobody-at-all: no camera is served there"):
        RemoteCamera("@nobody-at-all")
