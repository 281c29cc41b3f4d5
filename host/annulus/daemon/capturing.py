"""The thread that waits for the camera, so that nobody else has to."""

import queue
import threading
import time
from collections import Counter
from dataclasses import dataclass

from annulus.capture.camera import Camera, CapturedFrame, EndOfFrames, grab
from annulus.vocabulary import AnnulusError

QUEUE_FRAMES = 4


@dataclass(frozen=True, slots=True)
class Arrived:
    """A frame, and when we had it (host monotonic, ns)."""

    frame: CapturedFrame
    at_ns: int


class Capturing(threading.Thread):
    """Takes frames from a started camera into a short queue; drops and counts the new frame when the queue is full.

    A file's frames carry timestamps of the future when it is read faster than it was filmed: they wait for their time.
    """

    def __init__(self, camera: Camera) -> None:
        super().__init__(name="capture", daemon=True)
        self.counts: Counter[str] = Counter()
        self.problem = ""  # why it ended, empty when told to or at the end of a file
        self._camera = camera
        self._frames: queue.Queue[Arrived] = queue.Queue(QUEUE_FRAMES)
        self._stopping = threading.Event()
        self._ended = threading.Event()

    @property
    def ended(self) -> bool:
        """No frame will come any more, and none waits."""
        return self._ended.is_set() and self._frames.empty()

    def run(self) -> None:
        try:
            while not self._stopping.is_set():
                try:
                    frame = grab(self._camera)
                except TimeoutError:
                    self.counts["camera_silent"] += not self._stopping.is_set()
                    continue
                self._stopping.wait(min(1.0, (frame.timestamp_ns - time.monotonic_ns()) / 1e9))
                try:
                    self._frames.put_nowait(Arrived(frame, time.monotonic_ns()))
                except queue.Full:
                    self.counts["capture_queue"] += 1
        except EndOfFrames:
            pass
        except AnnulusError as error:
            self.problem = str(error)
        except Exception as error:
            self.problem = f"camera: {type(error).__name__}: {error}"
        finally:
            self._ended.set()

    def take(self) -> list[Arrived]:
        """What came since the last call, oldest first."""
        frames = []
        while True:
            try:
                frames.append(self._frames.get_nowait())
            except queue.Empty:
                return frames

    def end(self, patience_s: float) -> None:
        """Stop taking frames; waits for a camera that is busy, but not for ever."""
        self._stopping.set()
        if self.is_alive():
            self.join(patience_s)
