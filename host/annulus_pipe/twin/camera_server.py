"""The head's camera as another process sees it: `capture.remote.RemoteCamera` is the other end and says how."""

import array
import contextlib
import json
import mmap
import os
import socket
import sys
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.capture.remote import MESSAGE_MAX

SLOTS = 6  # frames between head and camera


class CameraServer:
    """Slots in an anonymous memory file, lent to one viewer at a time. Nothing here waits.

    A slot is free, being filled (`take`), or held by the viewer (`deliver`, until it says so or is gone).
    """

    def __init__(self, hello: Mapping[str, Any], counts: Counter[str], number: int = 0) -> None:
        """hello : width, height, encoding, timing; a frame is width x height bytes. number : which of the head's."""
        self._hello, self._counts = hello, counts
        height, width = int(hello["height"]), int(hello["width"])
        self._memory_fd = os.memfd_create("annulus-twin", os.MFD_CLOEXEC)
        os.ftruncate(self._memory_fd, SLOTS * height * width)
        self._memory = mmap.mmap(self._memory_fd, 0)
        self.slots = np.frombuffer(self._memory, np.uint8).reshape(SLOTS, height, width)
        self._free = list(range(SLOTS))
        self._held: set[int] = set()
        self.address = f"@annulus-twin-{os.getpid()}{f'-{number}' if number else ''}"
        self._listener = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET | socket.SOCK_NONBLOCK)
        self._listener.bind("\0" + self.address[1:])
        self._listener.listen(1)
        self._viewer: socket.socket | None = None
        self.streaming = False
        self._plugged = True
        self.generation = 0  # of the stream: frames of an earlier one are not delivered

    def waitables(self) -> list[socket.socket]:
        return [self._listener, *([self._viewer] if self._viewer else [])]

    def serve(self, readable: list[Any]) -> None:
        """What is to be heard from those of `waitables` that are readable."""
        if self._viewer and self._viewer in readable:
            self._hear(self._viewer)
        if self._listener in readable:
            self._admit()

    def take(self) -> int | None:
        """A free slot, to be filled; None when the viewer has them all."""
        return self._free.pop() if self._free else None

    def give_back(self, slot: int) -> None:
        self._free.append(slot)

    def deliver(self, slot: int, generation: int, metadata: Mapping[str, Any]) -> None:
        """Hand a filled slot to the viewer, or back where it is wanted no more."""
        if self._viewer is None or not self.streaming or generation != self.generation:
            self._free.append(slot)
            return
        try:
            self._viewer.send(json.dumps({"slot": slot, **metadata}).encode())
            self._held.add(slot)
        except BlockingIOError:
            self._free.append(slot)
            self._counts["driver_dropped_no_buffer"] += 1
        except OSError:
            self._free.append(slot)
            self._leave()

    def plug(self, there: bool) -> None:
        """Whether there is a camera: without one its viewer is hung up on, and so is whoever comes."""
        if self._plugged and not there and self._viewer is not None:
            self._leave()
        self._plugged = there

    def close(self) -> None:
        if self._viewer:
            self._viewer.close()
        self._listener.close()

    def _admit(self) -> None:
        with contextlib.suppress(OSError):
            viewer, _ = self._listener.accept()
            credentials = viewer.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12)
            stranger = int.from_bytes(credentials[4:8], sys.byteorder) != os.getuid()
            if self._viewer is not None or stranger or not self._plugged:
                viewer.close()  # a camera has one user, and it is ours
                return
            viewer.setblocking(False)
            rights = [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", [self._memory_fd]))]
            viewer.sendmsg([json.dumps(self._hello).encode()], rights)
            self._viewer = viewer

    def _hear(self, viewer: socket.socket) -> None:
        try:
            while data := viewer.recv(MESSAGE_MAX):
                message = untrusted.mapping(untrusted.parse_json(data, MESSAGE_MAX), "what was told")
                if message["do"] == "release":
                    self._held.remove(message["slot"])
                    self._free.append(message["slot"])
                else:
                    self.streaming = message["do"] == "start"
                    self.generation += 1
            self._leave()
        except BlockingIOError:
            pass
        except (OSError, ValueError, KeyError):
            self._leave()

    def _leave(self) -> None:
        """The camera was closed: its buffers are ours again."""
        if self._viewer is not None:
            self._viewer.close()
        self._viewer, self.streaming = None, False
        self.generation += 1
        self._free += sorted(self._held)
        self._held.clear()
        self._counts["camera_closed"] += 1
