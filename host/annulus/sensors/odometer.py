"""How far along the pipe: the controller's odometer counts to millimetres, across restarts and across being zeroed."""

from collections import deque
from dataclasses import dataclass

from annulus.sensors.sample import Sample
from annulus.vocabulary import Flash

SPEED_SPAN_NS = 1_000_000_000  # over which the head's speed is taken
EXPECT_NS = 5_000_000_000  # for so long at most a head nobody heard of is taken to have moved on
SAMPLE_NS = 200_000_000  # between two samples
SEGMENTS_KEPT = 16


@dataclass(frozen=True, slots=True)
class _Segment:
    """From one edge of one boot on: z = start_mm + counts * mm_per_count."""

    boot: int
    first_edge: int
    start_mm: float


class Odometer:
    """Counts begin at zero with every boot of the controller; the pipe does not. Also a Sensor: counts and z_mm.

    After a restart the head is taken to have moved on at the speed it had. `gaps` counts how often that was assumed.
    """

    name = "odometer"

    def __init__(self, mm_per_count: float) -> None:
        self.gaps = 0
        self.zeroed_mm: float | None = None  # where the head was when the last `zero` took effect
        self._mm_per_count = mm_per_count
        self._segments: deque[_Segment] = deque(maxlen=SEGMENTS_KEPT)
        self._recent: deque[tuple[int, float]] = deque()  # host ns, z mm: about the last second
        self._zero_next = False
        self._samples: list[Sample] = []
        self._next_sample_ns = 0

    @property
    def here_mm(self) -> float | None:
        """Where the head was at the last edge; None before the first."""
        return self._recent[-1][1] if self._recent else None

    def zero(self) -> None:
        """The next edge that is heard is at z = 0, and so it goes on from there. Frames lit before keep their z."""
        self._zero_next = True

    def edge(self, flash: Flash, host_ns: int) -> None:
        """Every edge, as it is heard. One that had to be read again, and so comes late, places its frame only."""
        moved = flash.odometer * self._mm_per_count
        if not any(segment.boot == flash.boot for segment in self._segments):
            self.gaps += bool(self._segments)
            self._begin(flash, self._expected(host_ns) - moved if self._segments else 0.0)
        elif self._recent and host_ns <= self._recent[-1][0]:
            return
        z = self._place(flash)
        if self._zero_next:
            self._zero_next, self.zeroed_mm = False, z
            self._begin(flash, -moved)
            z = 0.0
        self._recent.append((host_ns, z))
        while self._recent[-1][0] - self._recent[0][0] > SPEED_SPAN_NS:
            self._recent.popleft()
        if host_ns >= self._next_sample_ns:
            self._next_sample_ns = host_ns + SAMPLE_NS
            values = {"counts": float(flash.odometer), "z_mm": z}
            self._samples.append(Sample(self.name, host_ns, values, {"counts": "counts", "z_mm": "mm"}))
            del self._samples[:-SEGMENTS_KEPT]

    def z_mm(self, flash: Flash) -> float | None:
        """The station of a frame from its flash; None when that boot's edges were never heard, or too long ago."""
        return self._place(flash) if any(segment.boot == flash.boot for segment in self._segments) else None

    def poll(self) -> list[Sample]:
        samples, self._samples = self._samples, []
        return samples

    def close(self) -> None:
        pass

    def _begin(self, flash: Flash, start_mm: float) -> None:
        self._segments.append(_Segment(flash.boot, flash.edge, start_mm))
        self._recent.clear()

    def _place(self, flash: Flash) -> float:
        of_boot = [segment for segment in self._segments if segment.boot == flash.boot]
        begun = [segment for segment in of_boot if segment.first_edge <= flash.edge]
        return (begun[-1] if begun else of_boot[0]).start_mm + flash.odometer * self._mm_per_count

    def _expected(self, host_ns: int) -> float:
        (first_ns, first), (last_ns, last) = self._recent[0], self._recent[-1]
        speed = (last - first) / (last_ns - first_ns) if last_ns > first_ns else 0.0
        return last + speed * min(host_ns - last_ns, EXPECT_NS)
