"""What a camera's driver makes of its exposures: pictures, counts, stamps and the moment it hands them over, each with
what goes wrong there. No clock: exposures in, deliveries out.

    driver = Driver(faults, timing, seed)
    for exposure in sensor.exposures(now, pins):
        delivered = driver.take(exposure)             # None: the driver lost it
        if delivered is not None: ...                 # the host has it at delivered.due_tick, and not before
"""

import math
from collections import Counter, deque
from typing import NamedTuple

import numpy as np

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.controller import TICK_NS, TICK_S, TICKS_PER_US
from annulus_pipe.twin.draws import Draws
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.image_sensor import Exposure
from annulus_pipe.vocabulary import CameraSequence

LAG_US = 1500.0  # end of readout -> frame in the host's hands, at least ..
LAG_SPREAD_US = 400.0  # .. and as much more on the average
LATE_MAX_S = 0.5
BUFFERS = 8  # of the driver: what it keeps while nobody asks
QUEUED_MAX = 10.0  # frames that it keeps back for good: two lamp cycles of a head with four to one
BEHIND_MAX = 16  # frames by which its pictures may be older than what it says of them
_DRAWN_AT_ONCE = 1024
_DRAWS = 8


class PicturePart(NamedTuple):
    """Rows of a picture, from one share of its height to another, that one exposure left there. None: blank."""

    exposure: Exposure
    top: float
    bottom: float


class Delivered(NamedTuple):
    """One frame as the host gets it."""

    number: int  # the exposure in whose turn it came
    sequence: CameraSequence | None  # what the driver says its count is; None where it does not count
    timestamp_ns: int
    due_tick: int
    parts: tuple[PicturePart, ...]  # of the picture, from the top; more than one: torn


class Driver:
    """Call `take` with every exposure, in order. `counts` says what was done, `disturbed` which frame is the first that
    a disturbance of that kind no longer touches.
    """

    def __init__(
        self, faults: Faults, timing: FrameTiming, seed: int = 0, *, start_tick: int = 0, camera: int = 0
    ) -> None:
        """start_tick : the sensor's. camera : 0, or another on its sync line, which loses frames of its own."""
        self.counts: Counter[str] = Counter()
        self.disturbed: list[tuple[str, int]] = []
        self._faults, self._start = faults, start_tick
        self._period = timing.period_us * TICKS_PER_US
        self._rng = np.random.default_rng([seed, 5, camera] if camera else [seed, 5])
        self._loses = Draws(seed + camera, 8) if camera else None
        self._drawn: list[list[float]] = []
        self._picture: tuple[PicturePart, ...] = ()  # in the last buffer that was handed over
        self._due = 0
        self._held = False  # the last frame came late, or had to wait behind one that did
        self._steps = sorted(faults.stamp_steps)
        self._stepped = 0.0  # frames
        self._past: deque[Exposure] = deque(maxlen=BEHIND_MAX + 1)
        self._turned = sorted(faults.pictures_behind)
        self._behind = 0  # frames
        self._hiccups = sorted(faults.hiccups)
        self._deepened = sorted(faults.queue_steps)
        self._queued = 0.0  # frames
        self._jumps = sorted(
            [(at, float(by)) for at, by in faults.count_jumps] + [(at, None) for at in faults.count_resets],
            key=lambda jump: jump[0],
        )
        self._counted_from = 0
        self._frozen = sorted(faults.frozen)
        self._unplugged = sorted(faults.unplugged)
        self._stalls = sorted(faults.stalls)
        self._stalled = 0  # frames that wait for the end of a stall

    def take(self, exposure: Exposure) -> Delivered | None:
        number = int(exposure.sequence)
        self._past.append(exposure)
        draws = self._draws()
        self._changes(number, exposure.missed)
        if self.absent(number):
            self.counts["unplugged"] += 1
            return None
        if self._dropped(exposure):
            self._lost("dropped", number)
            return None
        hiccup = self._hiccup(number, draws)
        if hiccup == "lost":
            return None
        due = self._due_tick(exposure, draws)
        if due is None:
            self.counts["dropped_in_stall"] += 1
            return None
        picture = self._pictured(exposure, number, draws)
        if hiccup == "again" and self._picture:
            picture = self._picture
        elif hiccup:
            picture = (PicturePart(exposure, 0.0, 0.0),)
        self._picture, self._due = picture, due
        count = (
            None if self._faults.uncounted else CameraSequence(max(0, number - exposure.missed - self._counted_from))
        )
        stamp = self._stamp(exposure, number, draws)
        if self._faults.stamped_when_handed_over:
            stamp += round((due - exposure.edge_tick - exposure.reads_out - LAG_US * TICKS_PER_US) * TICK_NS)
        return Delivered(number, count, stamp, due, picture)

    def absent(self, number: int) -> bool:
        """Whether there is no camera in this frame."""
        return bool(self._unplugged) and self._unplugged[0][0] <= number

    def unplug(self, number: int, frames: int) -> None:
        """No camera from frame `number` on, for so many frames."""
        self._unplugged = sorted([*self._unplugged, (number, float(frames))])

    # ---- what comes at its time ----

    def _dropped(self, exposure: Exposure) -> bool:
        if self._loses is None:
            return exposure.dropped
        return bool(self._loses.of(int(exposure.sequence)).random() < self._faults.frames_dropped)

    def _changes(self, number: int, missed: int) -> None:
        while self._steps and self._steps[0][0] <= number:
            self._stepped += self._steps.pop(0)[1]
            self._lost("stamp_step", number - 1)
        while self._deepened and self._deepened[0][0] <= number:
            self._queued = min(max(self._queued + self._deepened.pop(0)[1], 0.0), QUEUED_MAX)
            self._lost("queue_step", number - 1)
        while self._turned and self._turned[0][0] <= number:
            self._behind = min(max(self._behind + int(self._turned.pop(0)[1]), 0), BEHIND_MAX)
            self._lost("pictures_behind", number - 1)
        while self._jumps and self._jumps[0][0] <= number:
            by = self._jumps.pop(0)[1]
            self._counted_from = number - missed if by is None else self._counted_from - int(by)
            self._lost("count_reset" if by is None else "count_jump", number - 1)
        while self._unplugged and sum(self._unplugged[0]) <= number:
            self._unplugged.pop(0)
            self._counted_from = number - missed
            self._lost("unplug", number - 1)
        while self._frozen and sum(self._frozen[0]) <= number:
            self._frozen.pop(0)
            self._lost("freeze", number - 1)

    def _lost(self, kind: str, number: int) -> None:
        """Frame `number` is the last that this touches."""
        self.counts[kind] += 1
        self.disturbed.append((kind, number + 1))

    # ---- one frame ----

    def _pictured(self, exposure: Exposure, number: int, draws: list[float]) -> tuple[PicturePart, ...]:
        if self._behind:
            exposure = self._past[max(0, len(self._past) - 1 - self._behind)]
        if self._picture:
            if self._frozen and self._frozen[0][0] <= number:
                self.counts["frozen"] += 1
                return self._picture
            if draws[0] < self._faults.frames_repeated:
                self._lost("repeated", number)
                return self._picture
            if draws[1] < self._faults.frames_torn:
                self._lost("torn", number)
                tear = 0.05 + 0.9 * draws[2]
                below = [PicturePart(p.exposure, max(p.top, tear), p.bottom) for p in self._picture if p.bottom > tear]
                return (PicturePart(exposure, 0.0, tear), *below)
        return (PicturePart(exposure, 0.0, 1.0),)

    def _hiccup(self, number: int, draws: list[float]) -> str:
        """What comes in place of a picture that is kept: "again", "blank", or "lost" where nobody counts."""
        while self._hiccups and sum(self._hiccups[0]) <= number:
            self._hiccups.pop(0)
            self._lost("hiccup", number - 1)
        if not self._hiccups or self._hiccups[0][0] > number or self._behind >= BEHIND_MAX:
            return ""
        self._behind += 1
        kinds = ("again", "blank", "lost") if self._faults.uncounted else ("again", "blank")
        return kinds[int(len(kinds) * draws[2])]

    def _stamp(self, exposure: Exposure, number: int, draws: list[float]) -> int:
        faults = self._faults
        frames = faults.stamp_offset_frames + self._stepped + self._queued
        if draws[3] < faults.stamps_late:
            self._lost("stamp_late", number)
            much = 0.1 + 2.9 * draws[4]
            frames += max(1, round(much)) if draws[5] < 0.5 else much
        elif draws[3] >= 1.0 - faults.stamps_odd:
            self._lost("stamp_odd", number)
            frames += 1 if draws[5] < 0.5 else -1
        passed_s = (exposure.edge_tick - self._start) * TICK_S
        drifted_s = _accumulated_s(passed_s, faults.stamp_drift_turn_s) * faults.stamp_drift_ppm * 1e-6
        return exposure.timestamp_ns + round(frames * self._period * TICK_NS + drifted_s * 1e9)

    def _due_tick(self, exposure: Exposure, draws: list[float]) -> int | None:
        """When the host has it; None when the driver had no buffer left while the host stood still."""
        faults = self._faults
        lag_us = LAG_US - LAG_SPREAD_US * math.log(1.0 - draws[6])
        due = (
            exposure.edge_tick
            + exposure.reads_out
            + lag_us * TICKS_PER_US
            + (faults.delivery_frames + self._queued) * self._period
        )
        soonest = self._due + 50 * TICKS_PER_US
        if draws[7] < faults.frames_late:
            self.counts["late"] += 1
            due += draws[4] * LATE_MAX_S / TICK_S
            self._held = True
        elif self._held and due >= soonest:
            self._held = False
            self.disturbed.append(("late", int(exposure.sequence)))
        while self._stalls and due >= self.stall_ends(self._stalls[0]):
            at, seconds = self._stalls.pop(0)
            self.counts["stall"] += 1
            self.disturbed.append(("stall", at + 1 + int(seconds / TICK_S / self._period)))
            self._stalled = 0
        if self._stalls and due >= self.stall_begins(self._stalls[0]):
            self._stalled += 1
            if self._stalled > BUFFERS:
                return None
            due = self.stall_ends(self._stalls[0])
        return max(round(due), soonest)

    def stall_begins(self, stall: tuple[int, float]) -> float:
        """World tick, in the middle of the frame that was named."""
        return self._start + (stall[0] + 0.5) * self._period

    def stall_ends(self, stall: tuple[int, float]) -> float:
        return self.stall_begins(stall) + stall[1] / TICK_S

    def _draws(self) -> list[float]:
        if not self._drawn:
            self._drawn = self._rng.random((_DRAWN_AT_ONCE, _DRAWS)).tolist()
        return self._drawn.pop()


def _accumulated_s(passed_s: float, turn_s: float) -> float:
    """Seconds that a drift has acted one way, less those it has acted the other."""
    if turn_s <= 0.0:
        return passed_s
    turns, rest = divmod(passed_s, turn_s)
    return rest if int(turns) % 2 == 0 else turn_s - rest
