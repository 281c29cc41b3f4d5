"""Two clocks of one recording: it is measured on the monotonic one, and its file says times of day.

The pair is read once, when the scan begins, and kept for all its parts: when the wall clock is set meanwhile, messages
stay in order and as far apart as they were. What the wall clock was later, `/identity` says.
"""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

CLOCK_FILE = "clock.json"
TIME_MAX_NS = (1 << 64) - 1  # of a message, which has no sign


@dataclass(frozen=True, slots=True)
class Clock:
    """One moment on both."""

    host_ns: int  # monotonic
    utc_ns: int

    @classmethod
    def now(cls) -> "Clock":
        return cls(time.monotonic_ns(), time.time_ns())

    @property
    def offset_ns(self) -> int:
        """What a message's time is later than the monotonic clock's."""
        return self.utc_ns - self.host_ns

    def utc(self, host_ns: int) -> int:
        """As a message says it."""
        return min(max(0, host_ns + self.offset_ns), TIME_MAX_NS)

    def to_dict(self) -> dict[str, int]:
        return {"host_ns": self.host_ns, "utc_ns": self.utc_ns}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any] | None) -> "Clock | None":
        """None where it is none."""
        host_ns, utc_ns = (data or {}).get("host_ns"), (data or {}).get("utc_ns")
        if type(host_ns) is not int or type(utc_ns) is not int:
            return None
        return cls(host_ns, utc_ns) if max(abs(host_ns), abs(utc_ns)) <= TIME_MAX_NS else None


def clock_of(offset_ns: int, identities: Iterable[Any]) -> Clock:
    """A recording's own; of before there was one, what its `/identity` says; else none, and its times stay what they
    are."""
    if offset_ns:
        return Clock(0, offset_ns)
    clocks = (Clock.from_dict(body) for body in identities if isinstance(body, dict))
    return next((clock for clock in clocks if clock is not None), Clock(0, 0))
