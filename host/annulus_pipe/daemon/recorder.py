"""The recorder process. Run as `python -m annulus_pipe.daemon.recorder`.

A process of its own, so that a slow disk stalls nothing but the recording, and nothing but itself can break it. It
imports no OpenCV: a spare one must be up at once. OpenCV comes while it waits to be called.

A frame that is there as soon as the one before it is done with, and others before it, says that frames come faster than
they are written: then they are written as they are, which takes a third of the time, until there is a pause again.
A small picture is two thirds of a raw frame's work, and to see by: five a second are made of each camera under each
lamp, none while more frames wait than one flash has cameras. A copy (`annulus record export`) has one of each frame.

Recording comes before reconstructing, and before whatever else this machine does: it has real-time priority where that
is allowed, below who feeds it.

A file that lost its name (it, or its folder, was removed) or is shorter than what was written into it is lost with all
its frames. That is reported, and the recording goes on in a new file where one can be begun.
"""

import sys
import threading
import time
import uuid
from pathlib import Path
from typing import Any

from annulus_pipe.daemon.priority import RECORDER_LEVEL, raise_process, share_priority
from annulus_pipe.daemon.rotation import UNBOUNDED, Bounds, RotatingWriter
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.clock import Clock
from annulus_pipe.record.codec import DEFAULT, Codec
from annulus_pipe.record.parts import Part
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.stream.frames import CAMERAS_MAX, FrameHeader
from annulus_pipe.stream.working import serve
from annulus_pipe.vocabulary import AnnulusError, Label

LOOK_S = 0.5  # between two looks at the file, and between two attempts to begin another
HURRY_AFTER = CAMERAS_MAX + 1  # frames without a pause; so many of one flash come at once
PAUSE_S = 0.002
PREVIEW_NS = 180_000_000  # between two small pictures of a camera under one lamp: a fifth of a second, less its jitter
GET_OPENCV_S = 1.0  # after the start: at once it was up half a second later
NOT_RECORDED = "frames are labelled but not recorded"


class RecorderJob:
    """A scan's parts, one after the other, as a job; one that replaces a dead one begins the scan's next part. Answers
    each frame with the file it is in, empty when it is in none; reports each file that is begun or gone, and whenever
    losses grow.
    """

    def __init__(
        self,
        folder: Path,
        name: str,
        calibration: Any,
        configuration: Any,
        bounds: Bounds = UNBOUNDED,
        scan: str = "",
        codec: Codec = DEFAULT,
        clock: Clock | None = None,
    ) -> None:
        """`scan`: what all parts of it have in common, drawn when empty; so is the `clock`."""
        self._codec, self._clock = codec, clock or Clock.now()
        self._done_s, self._without_pause = 0.0, 0
        self._cameras: set[int] = set()  # whose frames have come
        self._shown_ns: dict[tuple[int, Label], int] = {}  # when a camera's last small picture under a lamp was taken
        self._folder, self._name, self._calibration, self._configuration = folder, name, calibration, configuration
        self._bounds, self._scan = bounds, scan or uuid.uuid4().hex
        self.path = folder
        self._writer: RotatingWriter | None = None
        self._next_look = 0.0
        self._reported = 0, ""  # frames lost, and the remark
        self._reports: list[dict[str, Any]] = []
        self._problem = ""
        self._begin()

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        paused = time.monotonic() - self._done_s >= PAUSE_S
        self._without_pause = 0 if paused else self._without_pause + 1
        self._cameras.add(header.camera)
        self._look()
        writer = self._writer
        written = writer is not None and writer.frame(
            header.to_dict(),
            image,
            header.timestamp_ns,
            hurried=self._without_pause >= HURRY_AFTER,
            preview=self._without_pause < len(self._cameras) and self._is_due(header),
        )
        self._done_s = time.monotonic()
        if writer is not None and writer.path != self.path:  # another part
            self._tell(writer)
        return str(self.path) if written else ""

    def _is_due(self, header: FrameHeader) -> bool:
        key = header.camera, header.label
        before = self._shown_ns.get(key)
        if before is not None and 0 <= header.timestamp_ns - before < PREVIEW_NS:
            return False
        self._shown_ns[key] = header.timestamp_ns
        return True

    def note(self, kind: str, body: Any) -> None:
        time_ns, content, sequence = body
        if self._writer is not None:
            self._writer.note(kind, content, time_ns, sequence)

    def idle(self) -> Any:
        self._look()
        if self._writer is not None:
            if self._writer.waiting_s > 0.5:
                self._writer.flush()
            if (self._writer.lost.total(), self._writer.remark) != self._reported:
                self._tell(self._writer)
        reports, self._reports = self._reports, []
        return reports or None

    def close(self) -> Any:
        self._next_look = 0.0
        self._look(more=False)
        if self._writer is not None:
            self._writer.close()
            if self._state() not in self._reports:
                self._reports.append(self._state())
        return self._reports

    def _look(self, more: bool = True) -> None:
        """Whether the file is still what it should be; if not, another is begun (if `more` is to come)."""
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + LOOK_S
        share_priority()  # with those that bring parts to the disk: they share the interpreter's lock
        if self._writer is not None and (why := self._writer.gone()):
            self._writer.abandon()
            self._writer = None
            self._reports.append(self._state(gone=True, problem=f"{why}; the frames in it are lost"))
        if self._writer is None and more:
            try:
                self._begin()
            except AnnulusError as error:
                if str(error) != self._problem:
                    self._problem = str(error)
                    self._reports.append(self._state(gone=True, problem=f"{error}; {NOT_RECORDED}"))

    def _begin(self) -> None:
        self._writer = RotatingWriter(self._folder, self._name, self._scan, self._bounds, self._part, time.monotonic)
        self._problem = ""
        self._tell(self._writer)

    def _tell(self, writer: RotatingWriter) -> None:
        self.path, self._reported = writer.path, (writer.lost.total(), writer.remark)
        self._reports.append(self._state())

    def _part(self, path: Path, part: Part) -> RecordingWriter:
        now_ns = self._clock.host_ns if part.number == 1 else time.monotonic_ns()  # the scan began before we were up
        return RecordingWriter(
            path,
            calibration=self._calibration,
            configuration=self._configuration,
            now_ns=now_ns,
            part=part,
            codec=self._codec,
            clock=self._clock,
        )

    def _state(self, gone: bool = False, problem: str = "") -> dict[str, Any]:
        """`gone`: there is no such file, or not any more."""
        if self._writer is not None and self._writer.problem:
            problem = f"{self._writer.problem}; {NOT_RECORDED}"
        elif self._writer is not None:
            problem = problem or self._writer.remark
        return {"path": str(self.path), "problem": problem, "gone": gone}


def _prepare(setup: Any) -> RecorderJob:
    raise_process(setup["realtime"], RECORDER_LEVEL)  # what is refused the daemon has told of itself
    return RecorderJob(
        Path(setup["folder"]),
        setup["name"],
        setup["calibration"],
        setup["configuration"],
        Bounds(*setup["bounds"]),
        setup["scan"],
        Codec(setup["codec"]),
        Clock.from_dict(setup["clock"]),
    )


def _get_opencv() -> None:
    """50 ms and 40 MB, while nobody waits for it."""
    import cv2

    cv2.setNumThreads(1)  # others have use for the other cores


if __name__ == "__main__":
    getting = threading.Timer(GET_OPENCV_S, _get_opencv)
    getting.daemon = True
    getting.start()
    serve(sys.argv[-1], _prepare)
