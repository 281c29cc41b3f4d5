"""A global-shutter camera that exposes while its trigger is active, and does nothing without one.

It has no clock, but the controller may follow one from outside: then the sync line is that clock's. A trigger that it
misses is a frame that does not exist, and its driver numbers those that do. What disturbs the line beside the
controller's trigger is a trigger to it: a frame between two that nothing lights, whose readout keeps it from seeing the
next one. Frames are numbered by the period in which they came, so that faults fall where the same ones fall on a
camera that runs by itself.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.capture.timing import TRIGGER_EXTRA_US, is_on_sync
from annulus_pipe.controller import PIN_CAMERA_TRIGGER, PIN_LED, TICKS_PER_US
from annulus_pipe.link.messages import PolarityFlag
from annulus_pipe.twin.cable import Stimulus
from annulus_pipe.twin.draws import Draws
from annulus_pipe.twin.image_sensor import Exposure, ImageSensor
from annulus_pipe.vocabulary import CameraSequence

SPIKE_US = 20.0  # of what disturbs the line
SPIKE_AT = 0.5  # of a period after an exposure's end


class TriggeredSensor(ImageSensor):
    """`timing`'s exposure is that of the camera, its readout what comes after it."""

    def __init__(self, *arguments: Any, trigger: str, **more: Any) -> None:
        """trigger : of TRIGGER_EXTRA_US; for so long it goes on exposing when it is over. The rest: see ImageSensor."""
        timing, extra_us = arguments[1], TRIGGER_EXTRA_US[trigger]
        self._on_sync = is_on_sync(trigger)
        more.setdefault("timestamp_offset_us", extra_us)  # the driver stamps the readout's start
        super().__init__(*arguments, **more)
        self._extra = round(extra_us * TICKS_PER_US)
        self._reads_out = self._extra + round(timing.readout_us * TICKS_PER_US)
        self._active = int(PolarityFlag.CAMERA_TRIGGER not in self._pins.inverted)  # level that is a trigger
        self._since: int | None = None  # of the trigger under way
        self._triggers: list[tuple[int, int]] = []  # seen or not, from and to, not yet dealt with
        self._busy_until = 0  # exposing or reading out
        self._line = Draws(more.get("seed", 0), 9) if self._on_sync else self._draws[1]  # the sync line has its own
        self._last = -1  # number of the last frame
        self._frames = 0

    def _sync_of(self, frame: int) -> list[Stimulus]:
        """The outside clock's, where there is one."""
        return super()._sync_of(frame) if self._on_sync else []

    def exposures(self, now: int, transitions: Iterable[Sequence[int]] | NDArray[Any] = ()) -> list[Exposure]:
        moves = transitions.tolist() if isinstance(transitions, np.ndarray) else list(transitions)
        self._lamps_moved(moves)
        for tick, pin, level in moves:
            if pin == PIN_CAMERA_TRIGGER and level == self._active:
                self._since = tick
            elif pin == PIN_CAMERA_TRIGGER and self._since is not None:
                self._triggered(self._since, tick)
                self._since = None
        done = []
        while self._triggers and self._triggers[0][1] + self._extra <= now:
            opens, edge = self._triggers.pop(0)
            exposure = self._seen(opens, edge)
            if exposure is not None:
                done.append(exposure)
        self._forget(now - 3 * round(self._period))
        return done

    def _triggered(self, opens: int, edge: int) -> None:
        """A trigger by the controller, and what comes after it."""
        rng = self._line.of(round(edge / self._period))
        missing, glitch = rng.random(2) < (self.faults.sync_missing, self.faults.sync_glitches)
        if not missing:
            self._triggers.append((opens, edge))
        if glitch:
            spike = edge + round(SPIKE_AT * self._period)
            self._triggers.append((spike, spike + round(SPIKE_US * TICKS_PER_US)))

    def _seen(self, opens: int, edge: int) -> Exposure | None:
        """The frame that this trigger makes; None where the camera was not ready for it."""
        if opens < self._busy_until:
            return None
        self._busy_until = edge + self._reads_out
        number = max(self._last + 1, round((edge - self._start) / self._period) - 1)
        self._last, self._frames = number, self._frames + 1
        return self._exposed(CameraSequence(number), opens, edge, number + 1 - self._frames)

    def _exposed(self, number: CameraSequence, opens: int, edge: int, missed: int) -> Exposure:
        closes = edge + self._extra
        rows = len(self._row_close)
        lights, slides, weight, moment = [], [], 0.0, 0.0
        for lamp, (pin, gate) in enumerate(self._gates.items()):
            total, at = gate.collect(np.full(1, opens), np.full(1, closes))
            ticks = float(total[0])
            lights.append(np.full(rows, ticks / self._nominal[pin], np.float32))
            slides += [lamp] if ticks > 0.0 and pin != PIN_LED else []
            weight, moment = weight + ticks, moment + ticks * at
        z = self.cable.z_mm(moment / weight if weight > 0.0 else (opens + closes) / 2)
        rng = self._draws[0].of(int(number))
        dropped = bool(rng.random() < self.faults.frames_dropped)
        late_us = self.offset_us + self.faults.timestamp_jitter_us * float(rng.standard_normal())
        stamp = self.clock.ns(edge + late_us * TICKS_PER_US)
        projector: NDArray[np.float32] = np.sum(lights[:-1], axis=0, dtype=np.float32)
        return Exposure(
            number,
            edge,
            stamp,
            z,
            self.world,
            projector,
            lights[-1],
            dropped,
            missed=missed,
            reads_out=self._reads_out,
            slides=tuple(slides),
        )


def sensor_of(*arguments: Any, trigger: str = "none", **more: Any) -> ImageSensor:
    """One that runs by itself, or one that takes this kind of trigger."""
    if trigger == "none":
        return ImageSensor(*arguments, **more)
    return TriggeredSensor(*arguments, trigger=trigger, **more)
