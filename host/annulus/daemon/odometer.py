"""How far along the pipe: odometer counts to millimetres, across restarts of the controller."""

from collections import deque

from annulus.vocabulary import Flash

_SPEED_SPAN_NS = 1_000_000_000


class Odometer:
    """Counts begin at zero with every boot of the controller; the pipe does not.

    After a restart the head is taken to have moved on at the speed it had. `gaps` counts how often that was assumed.
    """

    def __init__(self, mm_per_count: float) -> None:
        self.gaps = 0
        self._mm_per_count = mm_per_count
        self._boot: int | None = None
        self._start_mm = 0.0
        self._recent: deque[tuple[int, float]] = deque()  # host ns, z mm: about the last second

    def z_mm(self, flash: Flash, host_ns: int) -> float:
        """The station of a frame from its flash; `host_ns` is the frame's time. Ask in the order of frames."""
        moved = flash.odometer * self._mm_per_count
        if self._boot is None:
            self._boot = flash.boot
        elif flash.boot != self._boot:
            self._boot = flash.boot
            self.gaps += 1
            self._start_mm = self._expected(host_ns) - moved
            self._recent.clear()
        z = self._start_mm + moved
        self._recent.append((host_ns, z))
        while self._recent[-1][0] - self._recent[0][0] > _SPEED_SPAN_NS:
            self._recent.popleft()
        return z

    def _expected(self, host_ns: int) -> float:
        (first_ns, first), (last_ns, last) = self._recent[0], self._recent[-1]
        speed = (last - first) / (last_ns - first_ns) if last_ns > first_ns else 0.0
        return last + speed * (host_ns - last_ns)
