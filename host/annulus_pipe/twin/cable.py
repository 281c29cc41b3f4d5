"""The cable that pulls the head, and the counter it runs over."""

import math
from dataclasses import dataclass

from annulus_pipe.controller import PIN_ODOMETER_A, PIN_ODOMETER_B, TICK_S

Stimulus = tuple[int, int, int]  # world tick, pin, level
_A, _B = PIN_ODOMETER_A, PIN_ODOMETER_B
_QUADRATURE = ((0, 0), (1, 0), (1, 1), (0, 1))  # A, B as the count rises: A leads
_LEADS = ((_B, 0), (_A, 1), (_B, 1), (_A, 0))  # pin, level that brings a rising count here ..
_FOLLOWS = ((_A, 0), (_B, 0), (_A, 1), (_B, 1))  # .. and a falling one


class Cable:
    """Where the head is at any tick, and what the counter's pins say of it. Call `stimuli` in rising ticks."""

    def __init__(self, travel_mm: float, mm_per_count: float, start_tick: int = 0, speed_mm_s: float = 0.0) -> None:
        self._pulls = [_Pull(start_tick, 0.0, speed_mm_s, travel_mm)]
        self._step = mm_per_count
        self._count = 0

    def z_mm(self, tick: float) -> float:
        """Station of the head."""
        return self._pull_at(tick).z_mm(tick)

    def speed_mm_s(self, tick: float) -> float:
        """Zero where the cable has come to its end."""
        pull = self._pull_at(tick)
        return pull.speed_mm_s if 0.0 < pull.z_mm(tick) < pull.end_mm else 0.0

    def pull(self, tick: int, speed_mm_s: float) -> None:
        """From `tick` on it moves at this speed, until the end of the travel; 0 stops it."""
        self._pulls.append(_Pull(tick, self.z_mm(tick), speed_mm_s, self._pulls[-1].end_mm))

    def levels(self) -> list[tuple[int, int]]:
        """(pin, level) of the counter now."""
        a, b = _QUADRATURE[self._count % 4]
        return [(PIN_ODOMETER_A, a), (PIN_ODOMETER_B, b)]

    def stimuli(self, after: int, until: int, keep: int) -> list[Stimulus]:
        """The counter's transitions in (after, until]; `keep`: ticks before `after` that may still be asked for."""
        out: list[Stimulus] = []
        if len(self._pulls) == 1 and self._pulls[0].tick <= until:
            self._crossings(self._pulls[0], after, until, out)
            return out
        ends = [p.tick for p in self._pulls[1:]] + [until + 1]
        for pull, end in zip(self._pulls, ends, strict=True):
            if pull.tick <= until:
                self._crossings(pull, after, min(end - 1, until), out)
        self._pulls = [p for p, end in zip(self._pulls, ends, strict=True) if end > after - keep] or [self._pulls[-1]]
        return out

    def _crossings(self, pull: "_Pull", after: int, last: int, out: list[Stimulus]) -> None:
        """The counter's transitions while that pull lasts, in (after, last]."""
        if last <= after or pull.speed_mm_s == 0.0:
            return
        count, step = self._count, self._step
        target = math.floor(pull.z_mm(last) / step + 1e-9)
        while count != target:
            up = target > count
            crossing = pull.tick_at((count + up) * step)
            count += 1 if up else -1
            pin, level = (_LEADS if up else _FOLLOWS)[count % 4]
            out.append((min(max(crossing, after + 1), last), pin, level))
        self._count = count

    def _pull_at(self, tick: float) -> "_Pull":
        return next((p for p in reversed(self._pulls) if p.tick <= tick), self._pulls[0])


@dataclass(frozen=True, slots=True)
class _Pull:
    tick: int
    from_mm: float
    speed_mm_s: float
    end_mm: float

    def z_mm(self, tick: float) -> float:
        return min(max(self.from_mm + self.speed_mm_s * (tick - self.tick) * TICK_S, 0.0), self.end_mm)

    def tick_at(self, z_mm: float) -> int:
        return self.tick + math.ceil((z_mm - self.from_mm) / self.speed_mm_s / TICK_S)
