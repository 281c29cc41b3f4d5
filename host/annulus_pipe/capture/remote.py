"""A camera that another process on this machine serves: messages over a local socket, pictures through shared memory.

    camera = RemoteCamera("@annulus-twin-1234")
    camera.start()
    frame = grab(camera)

The server listens on an abstract socket of sequenced packets; each packet is one JSON object. It says hello with
`width`, `height`, `encoding` (one of ENCODINGS) and `timing` (fps, exposure_us, readout_us), and passes along a memory
file that holds its frames one behind the other. For every frame it then says `slot`, the place in that file, and its
metadata under Picamera2's names; it hears {"do": "start"}, {"do": "stop"} and {"do": "release", "slot": n}, after which
the slot is its own again. Nothing has a name in the file system, so nothing can be left behind.
"""

import array
import contextlib
import json
import mmap
import os
import socket
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.capture.camera import BGR8, ENCODINGS, SIDE_MAX, CompletedRequest, HeldRequest, OneRequest
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.vocabulary import AnnulusError

MESSAGE_MAX = 4096  # bytes of one packet, either way
FRAME_WAIT_S = 2.0


class RemoteCamera(OneRequest):
    """See capture.camera.CameraDriver. `timing` is the mode the server runs, fixed for as long as it does."""

    def __init__(self, address: str, timeout_s: float = FRAME_WAIT_S) -> None:
        """address : @name of the abstract socket. timeout_s : to wait for a frame.

        Raises AnnulusError when no camera is served there.
        """
        self.address, self._timeout_s = address, timeout_s
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._socket.settimeout(FRAME_WAIT_S)
        self._stopped = False  # frames of a stream that is over may wait
        self._lock = threading.Lock()  # requests may be released in another thread than waits for the next
        descriptor = -1
        try:
            self._socket.connect("\0" + address.removeprefix("@"))
            hello, rights, _, _ = self._socket.recvmsg(MESSAGE_MAX, socket.CMSG_SPACE(4))
            descriptor = array.array("i", rights[0][2][:4])[0]
            about = untrusted.mapping(untrusted.parse_json(hello, MESSAGE_MAX), "hello")
            self.width = untrusted.whole(about.get("width"), "width", 1, SIDE_MAX)
            self.height = untrusted.whole(about.get("height"), "height", 1, SIDE_MAX)
            self.encoding = untrusted.text(about.get("encoding"), "encoding", 32)
            if self.encoding not in ENCODINGS:
                raise ValueError(f"encoding is {self.encoding}, expected one of {', '.join(ENCODINGS)}")
            self.timing = FrameTiming(**untrusted.mapping(about.get("timing"), "timing"))
            self._memory = mmap.mmap(descriptor, 0, prot=mmap.PROT_READ)
        except (OSError, IndexError):
            self._socket.close()
            raise AnnulusError(f"{address}: no camera is served there") from None
        except (ValueError, TypeError, AnnulusError) as error:
            self._socket.close()
            raise AnnulusError(f"{address}: what is served there is no camera: {error}") from None
        finally:
            if descriptor >= 0:
                os.close(descriptor)
        self._socket.settimeout(timeout_s)
        self._shape = (self.height, self.width, 3) if self.encoding == BGR8 else (self.height, self.width)

    def start(self) -> None:
        """Begin to stream; frames lit before the call are not delivered."""
        if self._stopped:
            self._drop_waiting()
        self._say({"do": "start"})

    def stop(self) -> None:
        """Stop streaming; frames on their way are dropped by `start`."""
        self._stopped = True
        self._say({"do": "stop"})

    def close(self) -> None:
        self._socket.close()
        with contextlib.suppress(BufferError):
            self._memory.close()

    def capture_request(self) -> CompletedRequest:
        """Wait for the next frame. Raises TimeoutError when none comes, AnnulusError when the server is gone."""
        try:
            message = self._socket.recv(MESSAGE_MAX)
        except TimeoutError:
            raise TimeoutError(f"{self.address}: no frame within {self._timeout_s:g} s") from None
        except OSError:
            message = b""
        if not message:
            raise AnnulusError(f"{self.address}: the camera went away")
        size = int(np.prod(self._shape))
        try:
            metadata = dict(untrusted.mapping(untrusted.parse_json(message, MESSAGE_MAX), "frame"))
            slot = untrusted.whole(metadata.pop("slot", None), "slot", 0, len(self._memory) // size - 1)
        except ValueError as error:
            raise AnnulusError(f"{self.address}: what came is no frame: {error}") from None
        image = np.frombuffer(self._memory, np.uint8, size, slot * size).reshape(self._shape).copy()
        self._say({"do": "release", "slot": slot})
        return HeldRequest(image, metadata)

    def set_controls(self, controls: Mapping[str, Any]) -> None:
        """The server fixed the mode when it started: others are refused, as by a driver that reads back."""
        period = self.timing.period_us
        fixed = {"ExposureTime": (self.timing.exposure_us,), "FrameDurationLimits": (period, period)}
        for name, value in controls.items():
            wanted = tuple(value) if isinstance(value, tuple | list) else (value,)
            for have, want in zip(fixed.get(name, ()), wanted, strict=False):
                if abs(have - float(want)) > 0.01 * have:
                    raise AnnulusError(f"{self.address}: {name} is {have:g} us, expected {float(want):g}")

    def _drop_waiting(self) -> None:
        """What was on its way when the stream was stopped: taken for the first frame of the next, it would show all
        that the camera did not send in between as missing.
        """
        with contextlib.suppress(OSError):  # nothing waits; one that is gone shows when it is told to start
            while message := self._socket.recv(MESSAGE_MAX, socket.MSG_DONTWAIT):
                with contextlib.suppress(ValueError):
                    frame = untrusted.mapping(untrusted.parse_json(message, MESSAGE_MAX), "frame")
                    self._say({"do": "release", "slot": frame.get("slot")})

    def _say(self, what: Mapping[str, Any]) -> None:
        try:
            with self._lock:
                self._socket.send(json.dumps(what).encode())
        except OSError:
            raise AnnulusError(f"{self.address}: the camera went away") from None
