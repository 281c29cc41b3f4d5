"""The head's roll at any moment, from an attitude sensor that speaks when it likes."""

from bisect import bisect_left
from collections import deque

NEAR_NS = 100_000_000  # a moment further than this from every sample has no roll
KEPT = 1024  # samples: ten seconds at 100 Hz


class Roll:
    """Interpolates between samples, across the step from 359 to 0 degrees. Between two samples further apart than
    2 * NEAR_NS nothing is assumed: only what lies within NEAR_NS of one of them has that one's roll.
    """

    def __init__(self) -> None:
        self._times: deque[int] = deque(maxlen=KEPT)
        self._angles: deque[float] = deque(maxlen=KEPT)  # degrees, unwrapped

    def add(self, host_ns: int, roll_deg: float) -> None:
        """A sample, oldest first; one that is not newer than the last is left out."""
        if self._times and host_ns <= self._times[-1]:
            return
        if self._angles:
            turned = (roll_deg - self._angles[-1] + 180.0) % 360.0 - 180.0
            roll_deg = self._angles[-1] + turned
        self._times.append(host_ns)
        self._angles.append(roll_deg)

    def at(self, host_ns: int) -> float | None:
        """Degrees in -180..180, clockwise looking forward; None where no sample is near."""
        if not self._times:
            return None
        after = bisect_left(self._times, host_ns)
        around = [i for i in (after - 1, after) if 0 <= i < len(self._times)]
        near = [i for i in around if abs(self._times[i] - host_ns) <= NEAR_NS]
        if not near:
            return None
        if len(around) == 2 and self._times[after] - self._times[after - 1] <= 2 * NEAR_NS:
            span = self._times[after] - self._times[after - 1]
            part = (host_ns - self._times[after - 1]) / span
            angle = self._angles[after - 1] + part * (self._angles[after] - self._angles[after - 1])
        else:
            angle = self._angles[min(near, key=lambda i: abs(self._times[i] - host_ns))]
        return (angle + 180.0) % 360.0 - 180.0
