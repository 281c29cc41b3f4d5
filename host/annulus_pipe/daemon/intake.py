"""One camera's frames in one scan: what was missed is counted, and each waits for its label, in order of capture."""

import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.camera_feed import Arrived, Began, CameraFeed, Happened
from annulus_pipe.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.ring import FrameRing, RingSlot

RESERVE = 4  # free slots below which frames that cannot be labelled yet, or reconstructed, make way for new ones
BURST_RESERVE = 2 * RESERVE  # .. while an offset is searched for: when it is found all that waited go out at once
CAMERA_END_S = 2.5
LABEL_PERIODS = 12  # a frame waits no longer for its edges, whatever its stamp says


@dataclass(frozen=True, slots=True)
class InSlot:
    """A frame in its slot of the ring, held for whoever has this."""

    seen: FrameSeen
    place: RingSlot
    at_ns: int  # when we had it


class Intake:
    """`take` and `labelled` each turn."""

    def __init__(self, feed: CameraFeed, mode: CameraMode, labelling: Labelling, ring: FrameRing) -> None:
        self.labelling = labelling
        self._feed, self._mode, self._ring = feed, mode, ring
        self._late: list[Happened] = []  # what came while the camera was stopped
        self._waiting: deque[InSlot] = deque()  # for their labels
        self._out: list[tuple[FrameHeader, InSlot]] = []  # labelled before the camera began anew
        self._last: Arrived | None = None
        self._began = False  # anew: its count from before says nothing of the next frame
        self._since_ns = 0  # the stream that comes was begun

    def start(self) -> None:
        """Its frames from now on."""
        self._feed.stream()

    def stop(self) -> None:
        """Take no more; what was taken can still be labelled."""
        self._late = self._feed.rest(CAMERA_END_S)

    def go_on(self) -> None:
        """Frames again after a `stop`, of the same scan: nothing of before says which they are, and none was missed."""
        self._last, self._began = None, False
        self.labelling.restarted()
        self.start()

    @property
    def is_open(self) -> bool:
        """Whether frames come, or came."""
        return self._feed.is_open

    @property
    def ended(self) -> bool:
        """No frame will come any more, and none waits."""
        return self._feed.ended and not self._waiting and not self._out

    @property
    def problem(self) -> str:
        """Why the scan cannot have this camera, one line; empty when it can."""
        return self._feed.problem or self._feed.refused

    @property
    def trouble(self) -> str:
        """What it lacks that may come back."""
        return self._feed.trouble

    def take(self, account: Account) -> None:
        """What has come, on its way to a label."""
        happened, self._late = [*self._late, *self._feed.poll()], []
        for one in happened:
            match one:
                case Began(since_ns):
                    self._since_ns = since_ns
                    if self._last is not None:
                        self._begin_anew()
                case Arrived():
                    self._arrived(one, account)

    def labelled(self, final: bool = False) -> Iterator[tuple[FrameHeader, InSlot]]:
        """Frames whose label waiting cannot better, or that there is no room to let wait; all of them when `final`."""
        while self._out:
            yield self._out.pop(0)
        while self._waiting and (final or self._crowded or self._settled(self._waiting[0])):
            yield self._label()

    def _label(self) -> tuple[FrameHeader, InSlot]:
        frame = self._waiting.popleft()
        return self.labelling.header(frame.seen), frame

    def _arrived(self, one: Arrived, account: Account) -> None:
        account.taken += 1
        camera = self._mode.camera
        kind = "camera_away" if self._began else "camera"
        account.lose(kind, self._holes(one), camera=camera)
        if one.place is None:  # the frame has no label and never will
            account.lose("no_slot", camera=camera)
            return
        seen = FrameSeen(one.sequence, one.timestamp_ns, one.arrived_ns, one.picture, one.metadata)
        self.labelling.saw(seen)
        self._waiting.append(InSlot(seen, one.place, one.arrived_ns))

    def _begin_anew(self) -> None:
        """What the labelling knows of this camera's stamps and count is over with the frames from before."""
        while self._waiting:
            self._out.append(self._label())
        self.labelling.restarted()
        self._began = True

    @property
    def _crowded(self) -> bool:
        return not self.labelling.offset_known and self._ring.free < BURST_RESERVE

    def _settled(self, frame: InSlot) -> bool:
        now = time.monotonic_ns()
        waited = self.labelling.offset_known and now - frame.at_ns > LABEL_PERIODS * self._mode.period_ns
        return waited or self.labelling.settled(frame.seen, now)

    def _holes(self, frame: Arrived) -> int:
        """What was missed before this frame: holes in the driver's count, or in time where that says nothing.

        No more can be missing than the camera had time for since it was started. Where more seems to be, the frame
        before was a late one of an earlier stream, before a pause: then nothing says what is missing.
        """
        last, self._last = self._last, frame
        began, self._began = self._began, False
        if last is None:
            return 0
        period_ns = self._mode.period_ns
        if began:
            return max(0, round((frame.arrived_ns - last.arrived_ns) / period_ns) - 1)
        missed = [round((frame.timestamp_ns - last.timestamp_ns) / period_ns) - 1]
        if frame.sequence is not None and last.sequence is not None:
            missed.insert(0, frame.sequence - last.sequence - 1)
        had_time_ns = frame.arrived_ns - self._since_ns
        return max(0, next((count for count in missed if count * period_ns <= had_time_ns), 0))
