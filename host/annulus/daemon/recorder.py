"""The recorder process. Run as `python -m annulus.daemon.recorder`.

A process of its own, so that a slow disk stalls nothing but the recording, and nothing but itself can break it.
"""

import sys
import time
from pathlib import Path
from typing import Any

from annulus.numeric.arrays import Image
from annulus.record.writer import RecordingWriter
from annulus.stream.frames import FrameHeader
from annulus.stream.working import serve
from annulus.vocabulary import AnnulusError


class RecorderJob:
    """A RecordingWriter as a job. Answers each frame with whether it is on disk; reports whenever losses grow."""

    def __init__(self, folder: Path, name: str, calibration: Any, configuration: Any) -> None:
        self.path, self._writer = _begin(folder, name, calibration, configuration)
        self._reported = -1

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        return self._writer.frame(header.to_dict(), image, header.timestamp_ns)

    def note(self, kind: str, body: Any) -> None:
        time_ns, content, sequence = body
        self._writer.note(kind, content, time_ns, sequence)

    def idle(self) -> Any:
        if self._writer.waiting_s > 0.5:
            self._writer.flush()
        lost = self._writer.lost.total()
        if lost == self._reported:
            return None
        self._reported = lost
        return self._state()

    def close(self) -> Any:
        self._writer.close()
        return self._state()

    def _state(self) -> dict[str, Any]:
        writer = self._writer
        return {
            "path": str(self.path),
            "written": dict(writer.written),
            "lost": dict(writer.lost),
            "problem": writer.problem,
        }


def _begin(folder: Path, name: str, calibration: Any, configuration: Any) -> tuple[Path, RecordingWriter]:
    """The first free name: a recorder that replaces a dead one leaves the dead one's file alone."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be made ({error.strerror}). Choose another folder.") from None
    for number in range(1, 1000):
        path = folder / (f"{name}.mcap" if number == 1 else f"{name}-{number}.mcap")
        if not path.exists():
            now_ns = time.monotonic_ns()
            return path, RecordingWriter(path, calibration=calibration, configuration=configuration, now_ns=now_ns)
    raise AnnulusError(f"{folder}: holds {name}.mcap to {name}-999.mcap already. Choose another folder.")


def _prepare(setup: Any) -> RecorderJob:
    return RecorderJob(Path(setup["folder"]), setup["name"], setup["calibration"], setup["configuration"])


if __name__ == "__main__":
    serve(sys.argv[-1], _prepare)
