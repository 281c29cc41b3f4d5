"""How fast the disk is that recordings go to, measured, and what that is in frames."""

import os
import time
from pathlib import Path

from annulus_pipe.daemon.check import CheckRow, bytes_per_s
from annulus_pipe.daemon.config import HeadConfig
from annulus_pipe.daemon.disk import GB, MB, free_bytes

MEASURED_BYTES = 128_000_000
PIECE = 4_000_000
PATIENCE_S = 20.0  # a slower one is judged by what it did until then
FRAME_BYTES, FPS = 1664 * 1232, 25.0  # a frame of the head that annulus was built round, as its sensor sends it
SPARE = 1.5  # a disk pauses now and then: so much faster than needed is enough


def disk(folder: Path, head: HeadConfig | None = None, size: int = MEASURED_BYTES) -> list[CheckRow]:
    """Two rows: speed and free space. The folder need not be there yet."""
    there = folder.absolute()
    while not there.exists() and there != there.parent:
        there = there.parent
    try:
        rate, free = speed(there, size), free_bytes(there)
    except OSError as error:
        return [CheckRow("disk", False, f"{folder}: cannot be written ({error.strerror}). Choose another folder.")]
    need = FRAME_BYTES * FPS if head is None else bytes_per_s(head.cameras)
    frame = FRAME_BYTES if head is None else need / max(one.timing.fps for one in head.cameras)
    what = f"{frame / MB:.1f} MB a frame" + ("" if head is not None else ", raw")
    text = f"{folder}: {rate / MB:.0f} MB/s written, holds {rate / SPARE / frame:.0f} fps of {what}"
    if rate < SPARE * need:
        text += f"; {need / MB:.0f} MB/s come. Record to an SSD, or at fewer frames a second."
    hours = free / need / 3600
    return [
        CheckRow("disk", rate >= SPARE * need, text),
        CheckRow("free space", free > 2 * GB, f"{folder}: {free / GB:.1f} GB, {hours:.1f} h at {need / MB:.0f} MB/s"),
    ]


def speed(folder: Path, size: int = MEASURED_BYTES) -> float:
    """Bytes a second, on the disk itself (fdatasync), of noise: some disks pack what is even. Raises OSError."""
    piece = os.urandom(min(PIECE, size))
    name = folder / f".annulus-speed-{os.getpid()}"
    file = os.open(name, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600)
    try:
        os.unlink(name)
        begun = time.monotonic()
        written = 0
        while written < size and time.monotonic() - begun < PATIENCE_S:
            written += os.write(file, piece)
            os.fdatasync(file)
        return written / max(time.monotonic() - begun, 1e-6)
    finally:
        os.close(file)
