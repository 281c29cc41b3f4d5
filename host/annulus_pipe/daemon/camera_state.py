"""What a camera is doing, as a table: (state, event) -> state. What is not in the table changes nothing.

    closed -open-> opening -opened-> streaming -silence-> silent -frame-> streaming
                    ^   |                |                 |  |
                    |   +------lost------+------lost-------+  |
                    |   v                                     |
                    |  gone                                   |
                    +---+---------------retry-----------------+
    anything -close-> closed

A camera that is gone or silent is opened again, with all its settings, after 0.5 s, then 1 s, and so on every second;
the first frame sets that back. Frames missed meanwhile are counted by whoever knows when they were due.
"""

from collections import Counter
from collections.abc import Mapping
from enum import StrEnum

RETRY_FIRST_S = 0.5
RETRY_LAST_S = 1.0  # a cable put back in is found within this; one attempt is milliseconds of work


class CameraState(StrEnum):
    CLOSED = "closed"  # nobody wants frames
    OPENING = "opening"  # being opened, set up and started
    STREAMING = "streaming"
    SILENT = "silent"  # it streams, but no frame came when one was due
    GONE = "gone"  # it cannot be opened, or said that it is no more


class CameraEvent(StrEnum):
    OPEN = "open"
    OPENED = "opened"
    FRAME = "frame"
    SILENCE = "silence"
    LOST = "lost"
    RETRY = "retry"
    CLOSE = "close"


TRANSITIONS: Mapping[tuple[CameraState, CameraEvent], CameraState] = {
    (CameraState.CLOSED, CameraEvent.OPEN): CameraState.OPENING,
    (CameraState.OPENING, CameraEvent.OPENED): CameraState.STREAMING,
    (CameraState.OPENING, CameraEvent.LOST): CameraState.GONE,
    (CameraState.STREAMING, CameraEvent.SILENCE): CameraState.SILENT,
    (CameraState.STREAMING, CameraEvent.LOST): CameraState.GONE,
    (CameraState.SILENT, CameraEvent.FRAME): CameraState.STREAMING,
    (CameraState.SILENT, CameraEvent.LOST): CameraState.GONE,
    (CameraState.SILENT, CameraEvent.RETRY): CameraState.OPENING,
    (CameraState.GONE, CameraEvent.RETRY): CameraState.OPENING,
    **{(state, CameraEvent.CLOSE): CameraState.CLOSED for state in CameraState if state is not CameraState.CLOSED},
}


class BackOff:
    """Longer and longer between attempts that bring nothing."""

    def __init__(self, last_s: float | None = None) -> None:
        """`last_s`: it grows no longer than this, by default RETRY_LAST_S."""
        self._next_s, self._last_s = RETRY_FIRST_S, RETRY_LAST_S if last_s is None else last_s

    def wait_s(self) -> float:
        """Before the next attempt."""
        now, self._next_s = self._next_s, min(2 * self._next_s, self._last_s)
        return now

    def succeeded(self) -> None:
        self._next_s = RETRY_FIRST_S


class CameraWatch:
    """The state of one camera. Sans-I/O: the caller says what happened and what time it is."""

    def __init__(self) -> None:
        self.state = CameraState.CLOSED
        self.why = ""  # it is gone or silent
        self.entered: Counter[CameraState] = Counter()  # times each state was come to
        self._back_off = BackOff()
        self._retry_s = 0.0

    def happened(self, event: CameraEvent, now_s: float, why: str = "") -> bool:
        """Whether the state changed."""
        if event is CameraEvent.FRAME:
            self._back_off.succeeded()
        to = TRANSITIONS.get((self.state, event))
        if to is None:
            return False
        self.state, self.why = to, why
        self.entered[to] += 1
        if to in (CameraState.GONE, CameraState.SILENT):
            self._retry_s = now_s + self._back_off.wait_s()
        return True

    def retry_in_s(self, now_s: float) -> float:
        """How long to wait until it is opened again; 0 when it is due now, infinite where nothing is wrong."""
        waits = self.state in (CameraState.GONE, CameraState.SILENT)
        return max(0.0, self._retry_s - now_s) if waits else float("inf")
