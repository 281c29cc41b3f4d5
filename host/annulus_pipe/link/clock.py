"""Host time and controller ticks, mapped onto each other. Sans-I/O: the caller says what time it is.

A map is good for one boot of the controller: ticks start again at zero with every reset, and nothing is ever carried
across one. The map is a line fitted to round trips: a command left at `sent_ns`, the controller
stamped it with `tick`, the answer was here at `received_ns`, so the tick happened in between. Short round trips say
most, so a sample weighs with the inverse square of its duration and fades with age. The slope is held near nominal by
the tolerance of a crystal until the samples know better, which makes three quick samples after a reset enough.
"""

from collections import deque
from dataclasses import dataclass

from annulus_pipe.controller import TICK_NS
from annulus_pipe.vocabulary import Tick

SAMPLES_MAX = 128
SAMPLES_TO_LOCK = 3
HALF_LIFE_NS = 10_000_000_000
DRIFT_PRIOR = 100e-6  # one sigma of the two crystals' relative error
FLOOR_NS = 20_000  # no round trip over 1 Mbaud is known better than this
HOLD_NS = 2_000_000_000  # how far beyond its samples the line is trusted
OUTLIER_SLACK_NS = 1_000_000
OUTLIERS_MAX = 3  # in a row: the controller is not the one the map was made for
_WRAP = 1 << 32


@dataclass(frozen=True, slots=True)
class _Sample:
    host_ns: int
    tick: int  # 64 bits
    half_ns: int  # half the round trip: the most `host_ns` can be off


class ClockMap:
    """The map of the controller's present boot.

    The high half of a 64-bit tick counts wraps since the host first heard of this boot, not since the reset itself:
    the controller says 32 bits, and how long it had been up before is not known. Differences are what matters.
    """

    def __init__(self) -> None:
        self._samples: deque[_Sample] = deque()
        self._sums = (0.0, 0.0, 0.0, 0.0, 0.0)  # of w, wx, wxx, wy, wxy over the samples, as seen from the last one
        self._anchor: tuple[int, int] | None = None  # some (host_ns, tick), good to seconds, for the extension
        self._ref_ns = 0
        self._ref_tick = 0
        self._offset_ns = 0.0  # controller minus host at the reference
        self._half_ns = 0  # of the best sample
        self._outliers = 0
        self.drift = 0.0  # controller seconds per host second, minus one
        self.rejected = 0  # samples that contradicted the map

    @property
    def locked(self) -> bool:
        """True once there are enough samples for ticks to be mapped."""
        return len(self._samples) >= SAMPLES_TO_LOCK

    @property
    def samples(self) -> int:
        return len(self._samples)

    def restart(self) -> None:
        """The controller has started again: forget everything but the counters."""
        self._samples.clear()
        self._sums = (0.0, 0.0, 0.0, 0.0, 0.0)
        self._anchor = None
        self._outliers = 0
        self.drift = 0.0

    def sample(self, tick: int, sent_ns: int, received_ns: int) -> bool:
        """One round trip; `tick` is the 32-bit stamp. False when it contradicts the map: rejected and counted.

        Several contradictions in a row mean that this is not the boot the map was made for: the map is
        then dropped (`locked` turns False), and the caller should ask who is there.
        """
        middle = (sent_ns + received_ns) // 2
        half = max(0, received_ns - sent_ns + 1) // 2
        tick64 = self.extend(tick, middle)
        if not self._agrees(tick64, middle, half):
            self.rejected += 1
            self._outliers += 1
            if not self.locked or self._outliers >= OUTLIERS_MAX:
                self.restart()
            return False
        self._outliers = 0
        self._keep(_Sample(middle, tick64, half))
        self._anchor = (middle, tick64)
        self._fit()
        return True

    def extend(self, tick: int, now_ns: int) -> Tick:
        """A 32-bit tick that was stamped within 21 s of `now_ns`, as 64 bits."""
        if self._anchor is None:
            self._anchor = (now_ns, tick)
        host_ns, anchor_tick = self._anchor
        expected = anchor_tick + (now_ns - host_ns) // TICK_NS
        distance = (tick - expected) % _WRAP
        if distance >= _WRAP // 2:
            distance -= _WRAP
        return Tick(expected + distance)

    def to_host(self, tick: Tick) -> int | None:
        """Host ns of a tick; None while not locked, or too far from any sample to be trusted."""
        if not self.locked:
            return None
        controller_ns = (tick - self._ref_tick) * TICK_NS - self._offset_ns
        host_ns = self._ref_ns + round(controller_ns / (1.0 + self.drift))
        return host_ns if self._covers(host_ns) else None

    def to_tick(self, host_ns: int) -> Tick | None:
        """Tick of a host time, or None as in `to_host`."""
        if not self.locked or not self._covers(host_ns):
            return None
        dt = host_ns - self._ref_ns
        return Tick(self._ref_tick + round((dt + self.drift * dt + self._offset_ns) / TICK_NS))

    def error_ns(self, host_ns: int) -> int | None:
        """Bound on the map's error near `host_ns`: half the best round trip, and drift beyond the samples."""
        if not self.locked:
            return None
        outside = max(0, host_ns - self._samples[-1].host_ns, self._samples[0].host_ns - host_ns)
        return self._half_ns + round(2 * DRIFT_PRIOR * outside)

    def _covers(self, host_ns: int) -> bool:
        return self._samples[0].host_ns - HOLD_NS <= host_ns <= self._samples[-1].host_ns + HOLD_NS

    def _agrees(self, tick: int, middle: int, half: int) -> bool:
        """Whether a sample can be of the same boot as those before it."""
        if not self._samples:
            return True
        last = self._samples[-1]
        off = (tick - last.tick) * TICK_NS - (middle - last.host_ns)
        slack = OUTLIER_SLACK_NS + round(2 * DRIFT_PRIOR * abs(middle - last.host_ns))
        return abs(off) <= half + last.half_ns + slack

    def _keep(self, new: _Sample) -> None:
        """Another sample, and one fewer of the oldest. The sums go along, for nobody wants to add up 128 of them anew
        ten times a second; what rounding leaves in them fades with the samples.
        """
        sw, swx, swxx, swy, swxy = self._sums
        if self._samples:
            last = self._samples[-1]
            dx = float(new.host_ns - last.host_ns)
            dy = (new.tick - last.tick) * TICK_NS - dx
            faded = 2.0 ** (-dx / HALF_LIFE_NS)
            swxy = faded * (swxy - dx * swy - dy * swx + dx * dy * sw)
            swxx = faded * (swxx - 2.0 * dx * swx + dx * dx * sw)
            swx = faded * (swx - dx * sw)
            swy = faded * (swy - dy * sw)
            sw *= faded
        self._samples.append(new)
        self._half_ns = new.half_ns if len(self._samples) == 1 else min(self._half_ns, new.half_ns)
        if len(self._samples) > SAMPLES_MAX:
            old = self._samples.popleft()
            x = float(old.host_ns - new.host_ns)
            y = (old.tick - new.tick) * TICK_NS - x
            w = 2.0 ** (x / HALF_LIFE_NS) * _weight(old)
            sw, swx, swxx, swy, swxy = sw - w, swx - w * x, swxx - w * x * x, swy - w * y, swxy - w * x * y
            if old.half_ns == self._half_ns:
                self._half_ns = min(sample.half_ns for sample in self._samples)
        self._sums = (sw + _weight(new), swx, swxx, swy, swxy)

    def _fit(self) -> None:
        """Weighted line through the samples, slope drawn to its prior. Two unknowns: closed form."""
        last = self._samples[-1]
        self._ref_ns, self._ref_tick = last.host_ns, last.tick
        sw, swx, swxx, swy, swxy = self._sums
        swxx += (1.0 / DRIFT_PRIOR) ** 2
        determinant = sw * swxx - swx * swx
        self._offset_ns = (swy * swxx - swxy * swx) / determinant
        self.drift = (sw * swxy - swx * swy) / determinant


def _weight(sample: _Sample) -> float:
    return 1.0 / max(sample.half_ns, FLOOR_NS) ** 2
