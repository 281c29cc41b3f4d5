"""One camera's frames on their way in: a thread that waits for the camera, a slot of the ring, a label."""

import contextlib
import os
import queue
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass

from annulus.capture.camera import Camera, CapturedFrame, EndOfFrames, grab
from annulus.capture.photometry import measure
from annulus.daemon.account import Account
from annulus.daemon.cameras import apply_controls
from annulus.daemon.config import CameraConfig
from annulus.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus.stream.frames import FrameHeader
from annulus.stream.ring import FrameRing, Place
from annulus.vocabulary import AnnulusError, CameraSequence

QUEUE_FRAMES = 4
RESERVE = 4  # free slots below which frames that cannot be labelled yet, or reconstructed, make way for new ones
CAMERA_END_S = 2.5


@dataclass(frozen=True, slots=True)
class Arrived:
    """A frame, and when we had it (host monotonic, ns)."""

    frame: CapturedFrame
    at_ns: int


class CaptureThread(threading.Thread):
    """Takes frames from a started camera into a short queue; drops and counts the new frame when the queue is full.

    A file's frames carry timestamps of the future when it is read faster than it was filmed: they wait for their time.
    """

    def __init__(self, camera: Camera) -> None:
        super().__init__(name="capture", daemon=True)
        self.counts: Counter[str] = Counter()
        self.problem = ""  # why it ended, empty when told to or at the end of a file
        self.silent = False  # no frame came when one was due
        self._camera = camera
        self._frames: queue.Queue[Arrived] = queue.Queue(QUEUE_FRAMES)
        self._stopping = threading.Event()
        self._ended = threading.Event()
        self.waitable = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)  # readable when frames wait

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
                    if not self._stopping.is_set():
                        self.counts["camera_silent"] += 1
                        self.silent = True
                    continue
                self.silent = False
                self._stopping.wait(min(1.0, (frame.timestamp_ns - time.monotonic_ns()) / 1e9))
                try:
                    self._frames.put_nowait(Arrived(frame, time.monotonic_ns()))
                    os.eventfd_write(self.waitable, 1)
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
        with contextlib.suppress(OSError):  # nothing has come, or nothing will any more
            os.eventfd_read(self.waitable)
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
        if not self.is_alive():
            os.close(self.waitable)
            self.waitable = -1


@dataclass(frozen=True, slots=True)
class InSlot:
    """A frame in its slot of the ring, held for whoever has this."""

    seen: FrameSeen
    place: Place
    at_ns: int  # when we had it


class Intake:
    """One camera in one scan: started, its frames taken into the ring, labelled in the order of capture."""

    def __init__(self, camera: Camera, mode: CameraMode, labelling: Labelling, ring: FrameRing) -> None:
        self.camera, self.labelling = camera, labelling
        self._mode, self._ring = mode, ring
        self._thread = CaptureThread(camera)
        self._waiting: deque[InSlot] = deque()  # for their labels
        self._last: tuple[CameraSequence | None, int] | None = None  # driver sequence, timestamp
        self._known_holes = 0  # frames lost on the way from the capture thread, and not met in the driver's count yet
        self._counted: Counter[str] = Counter()  # of the thread's counts, those in the account

    def start(self, config: CameraConfig) -> list[str]:
        """Start the camera and begin to take its frames. Returns what the operator should know; raises AnnulusError
        when it cannot be.
        """
        self.camera.start()
        remarks = apply_controls(self.camera, config)
        self._thread.start()
        return remarks

    def stop(self) -> None:
        """Take no more; what was taken can still be labelled."""
        self._thread.end(CAMERA_END_S)  # while the camera still runs: its next frame ends the wait
        self.camera.stop()

    @property
    def waitable(self) -> int:
        """Readable when frames have come; negative once stopped."""
        return self._thread.waitable

    @property
    def ended(self) -> bool:
        """No frame will come any more, and none waits."""
        return self._thread.ended and not self._waiting

    @property
    def problem(self) -> str:
        """Why the camera gave up, one line; empty when it did not."""
        return self._thread.problem

    @property
    def trouble(self) -> str:
        return f"camera {self._mode.camera} is silent" if self._thread.silent else ""

    def take(self, account: Account) -> None:
        """From the capture thread into the ring."""
        arrived = self._thread.take()  # before its counts: then these have all that was lost before the last of them
        if not arrived and not self._thread.silent:
            return
        for kind in ("capture_queue", "camera_silent"):
            new = self._thread.counts[kind] - self._counted[kind]
            account.lose(kind, new)
            self._counted[kind] += new
            self._known_holes += new if kind == "capture_queue" else 0
        for one in arrived:
            account.taken += 1
            holes = self._holes(one.frame)
            known = min(holes, self._known_holes)  # in the driver's count they look like what it dropped itself
            self._known_holes -= known
            account.lose("camera", holes - known)
            place = self._ring.claim()
            if place is None:  # the frame has no label and never will
                account.lose("no_slot")
                continue
            frame = one.frame
            self._ring.write(place, frame.image)
            picture = measure(frame.image)
            seen = FrameSeen(frame.sequence, frame.timestamp_ns, one.at_ns, picture, frame.metadata)
            self.labelling.saw(seen)
            self._waiting.append(InSlot(seen, place, one.at_ns))

    def labelled(self, final: bool = False) -> Iterator[tuple[FrameHeader, InSlot]]:
        """Frames whose label waiting cannot better, or that there is no room to let wait; all of them when `final`."""
        while self._waiting and (final or self._crowded or self._settled(self._waiting[0])):
            frame = self._waiting.popleft()
            yield self.labelling.header(frame.seen), frame

    @property
    def _crowded(self) -> bool:
        return not self.labelling.offset_known and self._ring.free < RESERVE

    def _settled(self, frame: InSlot) -> bool:
        return self.labelling.settled(frame.seen, time.monotonic_ns())

    def _holes(self, frame: CapturedFrame) -> int:
        """What the driver dropped before this frame: holes in its count, or in time where it does not count."""
        last, self._last = self._last, (frame.sequence, frame.timestamp_ns)
        if last is None:
            return 0
        if frame.sequence is not None and last[0] is not None:
            return max(0, frame.sequence - last[0] - 1)
        return max(0, round((frame.timestamp_ns - last[1]) / self._mode.period_ns) - 1)
