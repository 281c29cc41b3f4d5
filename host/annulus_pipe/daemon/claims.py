"""What one daemon has for itself: its controller's line, its cameras, its addresses and the folder it records into. A
second one is told before it opens anything, within the second in which it has read its head.toml.

Each is claimed by an abstract socket of its name: it ends with the process, however that ends, is seen by every user of
this machine, holds no file open on the disk, and says who has it. Of a port and of a TCP address this is the sooner
word only, they have locks of their own. An `ipc://` address has none: libzmq takes it from whoever has it. Two daemons
that recorded into one folder wrote each other's health.json.
"""

import errno
import hashlib
import os
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from annulus_pipe.daemon.camera_config import FILES
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.vocabulary import AnnulusError


@contextmanager
def claimed(config: HeadConfig) -> Iterator[None]:
    """Raises AnnulusError, one line, when another daemon has some of it."""
    with ExitStack() as stack:
        for what, name in _names(config):
            mine = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
            address = "\0annulus-daemon-" + hashlib.sha256(name.encode("utf-8", "surrogateescape")).hexdigest()[:40]
            try:
                mine.bind(address)
                mine.listen(1)
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    continue  # a system without them: what has a lock of its own is locked
                raise AnnulusError(
                    f"{what}: in use by another annulus daemon{_holder(address)}, expected one daemon for it. "
                    "Stop that one first, or name another in head.toml."
                ) from None
        yield


def _names(config: HeadConfig) -> Iterator[tuple[str, str]]:
    """What people call it, and what no two others have."""
    if config.port is not None:
        yield config.port, f"port {_real(config.port)}"
    for camera in config.cameras:
        if camera.kind not in FILES:  # those many may read
            yield f"camera {camera.device}", f"camera {camera.kind} {_real(camera.device)}"
    for one in (config.publish, config.control):
        if one is not None and not one.address.endswith((":0", ":*")):
            scheme, _, place = one.address.partition("://")
            yield one.address, f"address {scheme} {_real(place) if scheme == 'ipc' else place}"
    if config.record_folder is not None:
        yield f"{config.record_folder}: the recording folder", f"folder {os.path.realpath(config.record_folder)}"


def _real(device: str) -> str:
    """/dev/serial/by-id/.. is a link to the one that everybody means; an address of no file is itself."""
    return os.path.realpath(device) if Path(device).exists() else device


def _holder(address: str) -> str:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        try:
            asking.setblocking(False)
            asking.connect(address)
            pid = struct.unpack("3i", asking.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))[0]
        except OSError:
            return ""
    return f" (process {pid})" if pid else ""
