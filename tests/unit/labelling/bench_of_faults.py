"""A head in virtual time for labels' sake: edges, flashes, frames and when they come, with truth known and every fault
a function of the frame's number. Frame k ends at edge k and was lit by the flash after edge k-1.
"""

import heapq
import random
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from annulus_pipe.capture.photometry import Light, Photometry
from annulus_pipe.labelling.labelling import CameraMode, FrameSeen, Labelling
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.link.head import EdgeSeen
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

MS = 1_000_000
PERIOD = 40 * MS
START = 10**12
MODE = CameraMode(0, 64, 48, "mono8", PERIOD)
WAITING_MAX = 28  # frames there are slots for
SPREAD = {Light.DARK: 0.0, Light.LED: 0.001, Light.BOTH: 0.1, Light.PROJECTOR: 0.38}


def picture(light: Light, fingerprint: int | None = None, **bands: Any) -> Photometry:
    """What a picture of this light measures."""
    return Photometry(5.0 if light is Light.DARK else 200.0, 0.4, SPREAD[light], fingerprint=fingerprint, **bands)


@dataclass
class Faults:
    """Each a function of the frame's number."""

    stamp_ms: Callable[[int], float] = lambda k: 0.0  # on top of what the driver always says
    on_arrival: bool = False  # the driver's stamps do not reach us: a frame's is the moment we had it
    count: Callable[[int], int | None] = lambda k: 1000 + k
    dropped: Callable[[int], bool] = lambda k: False
    edge_lost: Callable[[int], bool] = lambda k: False
    edge_late: Callable[[int], bool] = lambda k: False
    stall_until: Callable[[int], int] = lambda k: 0  # nothing is taken before this frame's edge
    pictured: Callable[[int], int] = lambda k: k  # whose picture this frame brings
    blank: Callable[[int], bool] = lambda k: False  # nothing was written into its buffer
    torn: Callable[[int], bool] = lambda k: False
    garbage: Callable[[int], bool] = lambda k: False  # something was written into its buffer that is no picture
    kept: Callable[[int], int] = lambda k: 0  # frames in the driver's hands before this one is given away
    reset: Callable[[int], bool] = lambda k: False  # the controller restarts before this edge, three edges are missed
    lamp: Callable[[int], Lamp] | None = None  # after edge k; else the cycle
    preamble: Callable[[int], bool] = lambda k: False  # whether that lamp is of a preamble


@dataclass
class Score:
    frames: int = 0
    wrong: list[int] = field(default_factory=list)
    unknown: list[int] = field(default_factory=list)
    reasons: Counter[str] = field(default_factory=Counter)
    told: list[str] = field(default_factory=list)

    def share(self, first: int = 0) -> float:
        """Of unknown frames from that one on."""
        return sum(k >= first for k in self.unknown) / max(1, self.frames - first)

    def relock(self, first: int) -> int:
        """Frames from that one on until, and with, the first known."""
        unknown, k = set(self.unknown), first
        while k in unknown:
            k += 1
        return k - first + 1


class Bench:
    def __init__(
        self,
        faults: Faults,
        *,
        seed: int = 0,
        ratio: int = 4,
        offset_ms: float = -28.0,
        lag_ms: float = 6.0,
        jitter_ms: float = 0.3,
        late_ms: float = 1.0,
        first: int = 1,
        **options: Any,
    ) -> None:
        self.faults, self.ratio, self.offset_ms, self.lag_ms = faults, ratio, offset_ms, lag_ms
        self.jitter_ms, self.late_ms = jitter_ms, late_ms
        self.random = random.Random(seed)
        self.navigation = Navigation(0.05)
        self.score = Score()
        tell = lambda kind, text: self.score.told.append(f"{kind}: {text}")  # noqa: E731
        self.labelling = Labelling(MODE, self.navigation, tell, False, **options)
        self.waiting: deque[tuple[int, FrameSeen]] = deque()
        self.epoch, self.index, self.deaf = 1, 0, 0
        self.taken_ns = 0

    def lamp(self, k: int) -> Lamp:
        if self.faults.lamp is not None:
            return self.faults.lamp(k)
        return Lamp.LED if k % (self.ratio + 1) == self.ratio else Lamp.PROJECTOR

    def run(self, frames: int) -> Score:
        happenings: list[tuple[int, int, int, Any]] = []
        number = 0
        for k in range(frames):
            for at, what in (*self._edge(k), *self._frame(k)):
                number += 1
                heapq.heappush(happenings, (at, number, k, what))
            while happenings and (happenings[0][0] <= START + (k - 1) * PERIOD or k == frames - 1):
                self._happens(*heapq.heappop(happenings))
        self._label(START + (frames + 100) * PERIOD)
        return self.score

    def _edge(self, k: int) -> list[tuple[int, Any]]:
        if self.faults.reset(k):
            self.epoch, self.index, self.deaf = self.epoch + 1, 0, 3
        if self.deaf:
            self.deaf -= 1
            return []
        placed = START + k * PERIOD + round(self.random.gauss(0, 0.2) * MS)
        flags = (EdgeFlag.FIRST if self.index == 0 else EdgeFlag(0)) | (
            EdgeFlag.PREAMBLE if self.faults.preamble(k) else EdgeFlag(0)
        )
        flash = Flash(
            EdgeIndex(self.index),
            Tick(self.index * 4_000_000),
            Slot(k % (self.ratio + 1)),
            self.lamp(k),
            300_000,
            500_000,
            k,
            1,
            self.epoch,
            flags,
        )
        self.index += 1
        if self.faults.edge_lost(k):
            return []
        heard = START + k * PERIOD + (70 if self.faults.edge_late(k) else 3) * MS
        return [(heard, EdgeSeen(flash, placed, 1000, self.epoch))]

    def _frame(self, k: int) -> list[tuple[int, Any]]:
        if self.faults.dropped(k):
            return []
        ends = START + k * PERIOD
        jitter = self.random.gauss(0, self.jitter_ms)
        stamp = ends + round((self.offset_ms + jitter + self.faults.stamp_ms(k)) * MS)
        came = (
            ends + round((self.lag_ms + self.random.expovariate(1 / self.late_ms)) * MS) + self.faults.kept(k) * PERIOD
        )
        came = max(came, START + self.faults.stall_until(k) * PERIOD + 6 * MS, self.taken_ns + 2 * MS)
        self.taken_ns = came
        if self.faults.on_arrival:
            stamp = came
        shown = self.faults.pictured(k)
        light = {Lamp.LED: Light.LED, Lamp.PROJECTOR: Light.PROJECTOR, Lamp.DARK: Light.DARK}[self.lamp(shown - 1)]
        if self.faults.blank(k):
            light, shown = Light.DARK, -k
        if self.faults.garbage(k):
            light, shown = Light.BOTH, -k
        bands = (Light.BOTH,) + (light,) * 7 if self.faults.torn(k) else (light,) * 8
        count = self.faults.count(k)
        sequence = None if count is None else CameraSequence(count)
        return [(came, FrameSeen(sequence, stamp, came, picture(light, 1 + shown, bands=bands), {}))]

    def _happens(self, at: int, _: int, k: int, what: Any) -> None:
        if isinstance(what, EdgeSeen):
            self.navigation.heard(what)
        else:
            self.labelling.saw(what)
            self.waiting.append((k, what))
        self.labelling.look_for_offset(at / 1e9)
        self._label(at)

    def _label(self, now: int) -> None:
        while self.waiting:
            k, seen = self.waiting[0]
            crowded = not self.labelling.offset_known and len(self.waiting) > WAITING_MAX
            if not crowded and not self.labelling.settled(seen, now):
                return
            self.waiting.popleft()
            header = self.labelling.header(seen)
            self.score.frames += 1
            self.score.reasons[header.reason or "agreed"] += 1
            if header.label is Label.UNKNOWN:
                self.score.unknown.append(k)
            elif (
                header.odometer != self.faults.pictured(k) - 1
                or header.label.value != self.lamp(self.faults.pictured(k) - 1).name.lower()
                or self.faults.torn(k)
                or self.faults.garbage(k)
            ):
                self.score.wrong.append(k)
