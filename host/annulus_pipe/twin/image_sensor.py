"""When the twin's camera looks, and how much light each row then gets. No clock, no thread: ticks in, frames out.

    sensor = ImageSensor(world, timing, faults, seed=1)
    while True:
        until = sensor.next_edge
        for tick, pin, level in sensor.stimuli(until):      # sync line, cable counter, interlock
            board.input(tick, pin, level)
        board.run_until(until)
        for exposure in sensor.exposures(until, board.pins()):
            if not exposure.dropped:
                renderer.render(exposure.pose, exposure.z_mm, exposure.projector, exposure.led, seed=exposure.sequence)

The lamps of a frame are nothing but the gate pins the firmware moved: each row integrates them from its own opening to
its own closing, so a wrong delay makes a dark or banded frame, as on the bench. World ticks are 10 ns of true time.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.controller import PIN_INTERLOCK, PIN_LED, PIN_SYNC, TICK_NS, TICKS_PER_US
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.link.messages import PolarityFlag
from annulus_pipe.link.pins import AS_WIRED, SLIDE_PINS, Pins
from annulus_pipe.twin.cable import Cable, Stimulus
from annulus_pipe.twin.draws import Draws
from annulus_pipe.twin.faults import NO_FAULTS, Faults
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.vocabulary import CameraSequence, Lamp

_LAMPS = {**dict.fromkeys(SLIDE_PINS, PolarityFlag.PROJECTOR), PIN_LED: PolarityFlag.LED}
UNLIT = 1e-4  # of a lamp's nominal light: less is none


@dataclass(slots=True)
class HostClock:
    """The host's monotonic clock against world ticks. `drift_ppm` > 0: the world (camera, controller) runs fast."""

    start_ns: int = 0
    drift_ppm: float = 0.0

    def tick(self, ns: int) -> int:
        """World tick at a host time, as a whole number."""
        return round((ns - self.start_ns) * (1 + self.drift_ppm * 1e-6)) // TICK_NS

    def ns(self, tick: float) -> int:
        """Host time in ns at a world tick."""
        return self.start_ns + round(tick * TICK_NS / (1 + self.drift_ppm * 1e-6))

    def stretch(self, ns: int) -> None:
        """The world stood still for so long."""
        self.start_ns += ns


@dataclass(frozen=True)
class Exposure:
    """One frame as the sensor collected it: everything `Renderer.render` asks for, and the truth to score labels by."""

    sequence: CameraSequence
    edge_tick: int  # world tick of the sync edge that ends its readout
    timestamp_ns: int  # what the driver will say: host clock, offset and jitter included
    z_mm: float  # of the head when the light came
    world: World = field(repr=False)
    projector: NDArray[np.float32]  # (H,) on-time each row saw, over the lamp's nominal on-time
    led: NDArray[np.float32]
    dropped: bool  # the driver lost it
    missed: int = 0  # triggers until then that made no frame: none of its numbers, though `sequence` has them
    reads_out: int = 0  # ticks from the edge to the end of its readout
    slides: tuple[int, ...] = ()  # of those lit in turn, the ones that put light into it

    @property
    def pose(self) -> Pose:
        """Of the pipe in the camera frame when the light came."""
        return self.world.pose(self.z_mm)

    @cached_property
    def extremes(self) -> Mapping[Lamp, tuple[float, float]]:
        """Of each lamp, the light of the row that got least and of the one that got most."""
        rows = ((Lamp.PROJECTOR, self.projector), (Lamp.LED, self.led))
        return {lamp: (float(light.min()), float(light.max())) for lamp, light in rows}

    @cached_property
    def lamps(self) -> frozenset[Lamp]:
        """Lamps that put any light into it; empty for a dark frame."""
        return frozenset(lamp for lamp, (_, most) in self.extremes.items() if most > UNLIT)


class ImageSensor:
    """The rolling-shutter camera, its sync line and the cable counter of one head. Call in rising ticks."""

    def __init__(
        self,
        world: World,
        timing: FrameTiming,
        faults: Faults = NO_FAULTS,
        *,
        seed: int = 0,
        clock: HostClock | None = None,
        start_tick: int = 0,
        timestamp_offset_us: float | None = None,
        speed_mm_s: float = 0.0,
        pins: Pins = AS_WIRED,
    ) -> None:
        """timestamp_offset_us: driver's timestamp minus the sync edge; by default the start of the readout, as V4L2.

        speed_mm_s: of the cable from the start on; see `pull`. pins: lamps whose drivers are active low, a sync line
        that rests low.
        """
        self.world = world
        self.timing = timing
        self.faults = faults
        self.clock = clock or HostClock()
        self.offset_us = -timing.readout_us if timestamp_offset_us is None else timestamp_offset_us
        self._pins = pins
        self._dark = {pin: int(flag in pins.inverted) for pin, flag in _LAMPS.items()}  # level at which it is
        self._draws = (Draws(seed, 1), Draws(seed, 2), Draws(seed, 7), Draws(seed, 8))
        self._period = timing.period_us * TICKS_PER_US
        self._readout = round(timing.readout_us * TICKS_PER_US)
        self._exposure = round(timing.exposure_us * TICKS_PER_US)
        self._start = start_tick
        self._ended = 0  # frames handed out
        self._announced = 0  # frames whose sync pulses were handed out
        self._announces = self.edge(0) - self._readout  # tick at which that of the next one begins
        self._handed_out = start_tick - 1  # stimuli up to here were handed out
        self._pending: list[Stimulus] = []
        self._gates = {pin: _Gate() for pin in (*SLIDE_PINS[: pins.slides], PIN_LED)}
        self.cable = Cable(world.travel_mm, world.mm_per_count, start_tick, speed_mm_s)
        rows = np.arange(world.camera.height) / max(world.camera.height - 1, 1)
        self._nominal = {
            **dict.fromkeys(SLIDE_PINS, world.projector.nominal_us * TICKS_PER_US),
            PIN_LED: world.led.nominal_us * TICKS_PER_US,
        }
        self._alike: dict[tuple[int, int], tuple[NDArray[np.float32], tuple[float, float]]] = {}  # rows by pin, ticks
        self._row_close = -np.round(self._readout * (1.0 - rows)).astype(np.int64)  # after the edge
        self._closes = (int(self._row_close[0]), int(self._row_close[-1]))

    @property
    def next_edge(self) -> int:
        """World tick of the sync edge that ends the readout of the next frame to be handed out."""
        return self.edge(self._ended)

    def edge(self, frame: int) -> int:
        """World tick at which the readout of frame `frame` (from 0) ends."""
        return self._start + round((frame + 1) * self._period)

    def pull(self, tick: int, speed_mm_s: float) -> None:
        """From `tick` on the cable moves at this speed, until the end of the world's travel; 0 stops it."""
        if tick <= self._handed_out:
            raise ValueError(f"the cable's way up to tick {self._handed_out} is already told, {tick} is too late")
        self.cable.pull(tick, speed_mm_s)

    def is_lit(self, pin: int, level: int) -> bool:
        """Whether a lamp is, whose gate stands so."""
        return level != self._dark[pin]

    def levels(self) -> list[tuple[int, int]]:
        """(pin, level) of every input as it is now: for a board that has just been powered on again."""
        return [(PIN_INTERLOCK, 0), (PIN_SYNC, self._sync_level(0)), *self.cable.levels()]

    def stimuli(self, until: int) -> list[Stimulus]:
        """Input pins' transitions after those already told, up to and including tick `until`, in order."""
        if self._handed_out < self._start:
            self._pending += [(self._start, pin, level) for pin, level in self.levels()]
        while self._announces <= until:
            self._pending += self._sync_of(self._announced)
            self._announced += 1
            self._announces = self.edge(self._announced) - self._readout
        self._pending += self.cable.stimuli(self._handed_out, until, self._history)
        self._handed_out = max(self._handed_out, until)
        if not self._pending:
            return []
        self._pending.sort(key=itemgetter(0))
        now = [s for s in self._pending if s[0] <= until]
        self._pending = self._pending[len(now) :]
        return now

    def exposures(self, now: int, transitions: Iterable[Sequence[int]] | NDArray[Any] = ()) -> list[Exposure]:
        """Frames whose readout has ended by `now`, oldest first.

        transitions : (tick, pin, level) of all output pins since the last call; they must be complete up to `now`.
        """
        self._lamps_moved(transitions.tolist() if isinstance(transitions, np.ndarray) else transitions)
        done = []
        while self.edge(self._ended) <= now:
            done.append(self._expose(self._ended))
            self._ended += 1
        self._forget(self.next_edge - self._readout - self._exposure)
        return done

    def _lamps_moved(self, transitions: Iterable[Sequence[int]]) -> None:
        for tick, pin, level in transitions:
            lit = pin in self._gates and self.is_lit(pin, level)
            if pin in self._gates and not (self.faults.flashes_failed and lit and self._fails(tick)):
                self._gates[pin].change(tick, lit)

    def _forget(self, before: int) -> None:
        for gate in self._gates.values():
            if gate.pulses:
                gate.forget(before)

    def _expose(self, frame: int) -> Exposure:
        edge = self.edge(frame)
        by_slide = [self._collected(pin, edge) for pin in SLIDE_PINS[: self._pins.slides]]
        slides = tuple(number for number, light in enumerate(by_slide) if light.weight > 0.0)
        projector = _together([by_slide[number] for number in slides] or by_slide[:1])
        led = self._collected(PIN_LED, edge)
        at = float(edge - self._readout // 2 - self._exposure // 2)  # where nothing lit it
        weight = projector.weight + led.weight
        if weight > 0.0:
            at = (projector.at * projector.weight + led.at * led.weight) / weight
        z = self.cable.z_mm(at)
        dropped, late = False, self.offset_us
        if self.faults.frames_dropped or self.faults.timestamp_jitter_us:
            rng = self._draws[0].of(frame)
            dropped = bool(rng.random() < self.faults.frames_dropped)
            late += self.faults.timestamp_jitter_us * float(rng.standard_normal())
        stamp = self.clock.ns(edge + late * TICKS_PER_US)
        rows = (projector.rows, led.rows)
        exposure = Exposure(CameraSequence(frame), edge, stamp, z, self.world, *rows, dropped, slides=slides)
        if projector.alike is not None and led.alike is not None:  # known without a look at the rows
            exposure.__dict__["extremes"] = {Lamp.PROJECTOR: projector.alike, Lamp.LED: led.alike}
        return exposure

    def _collected(self, pin: int, edge: int) -> "_Light":
        """Of one lamp, in the frame that ends there."""
        gate, nominal = self._gates[pin], self._nominal[pin]
        closes = (edge + self._closes[0], edge + self._closes[1])
        alike = gate.of_all((closes[0] - self._exposure, closes[1] - self._exposure), closes)
        if alike is None:
            close = edge + self._row_close
            total, at = gate.collect(close - self._exposure, close)
            return _Light((total / nominal).astype(np.float32), float(total.sum()), at)
        ticks, at = alike
        if (pin, ticks) not in self._alike:
            rows = np.full(len(self._row_close), ticks / nominal, np.float32)
            rows.setflags(write=False)
            self._alike[pin, ticks] = rows, (float(rows[0]), float(rows[0]))
        rows, extremes = self._alike[pin, ticks]
        return _Light(rows, float(ticks * len(rows)), at, extremes)

    def _fails(self, tick: int) -> bool:
        """Whether the lamp does not follow a gate that opens then."""
        return bool(self._draws[2].of(round(tick / self._period)).random() < self.faults.flashes_failed)

    def _sync_level(self, level: int) -> int:
        return 1 - level if PolarityFlag.SYNC in self._pins.inverted else level

    def _sync_of(self, frame: int) -> list[Stimulus]:
        """High from the end of the first line to the end of the last."""
        missing = glitch = False
        if self.faults.sync_missing or self.faults.sync_glitches:
            rng = self._draws[1].of(frame)
            missing, glitch = rng.random(2) < (self.faults.sync_missing, self.faults.sync_glitches)
        edge = self.edge(frame)
        begins, ends = edge - max(self._readout, 100), edge
        if self.faults.sync_late_us:
            late = self._draws[3].of(frame).exponential(self.faults.sync_late_us * TICKS_PER_US, 2)
            begins, ends = begins + round(late[0]), max(ends + round(late[1]), begins + round(late[0]) + 1)
        out: list[Stimulus] = [] if missing else [(begins, PIN_SYNC, 1), (ends, PIN_SYNC, 0)]
        if glitch:
            spike = edge + round(self._period) // 8
            out += [(spike, PIN_SYNC, 1), (spike + 20 * TICKS_PER_US, PIN_SYNC, 0)]
        return [(tick, pin, self._sync_level(level)) for tick, pin, level in out]

    @property
    def _history(self) -> int:
        """Ticks that a frame still to be handed out may look back."""
        return self._readout + self._exposure + 3 * round(self._period)


class _Light(NamedTuple):
    """What a frame got of one lamp."""

    rows: NDArray[np.float32]  # over the lamp's nominal on-time
    weight: float  # ticks, over all rows
    at: float  # centre of gravity, tick
    alike: tuple[float, float] | None = None  # least and most, where all rows are known to have got the same


def _together(lights: "Sequence[_Light]") -> "_Light":
    """Of several slides, of which one at most should have been lit."""
    if len(lights) == 1:
        return lights[0]
    weight = sum(light.weight for light in lights)
    at = sum(light.at * light.weight for light in lights) / weight
    return _Light(np.sum([light.rows for light in lights], axis=0), weight, at)


@dataclass(slots=True)
class _Gate:
    """One lamp's gate pin over time."""

    on_since: int | None = None
    pulses: list[tuple[int, int]] = field(default_factory=list)

    def change(self, tick: int, level: bool) -> None:
        if level and self.on_since is None:
            self.on_since = tick
        elif not level and self.on_since is not None:
            self.pulses.append((self.on_since, tick))
            self.on_since = None

    def forget(self, before: int) -> None:
        self.pulses = [p for p in self.pulses if p[1] >= before]

    def of_all(self, opens: tuple[int, int], closes: tuple[int, int]) -> tuple[int, float] | None:
        """On-ticks that each row saw and their centre of gravity, if every pulse was all rows' or none's. `opens`,
        `closes`: the first row and the last, for they do so one after the other.
        """
        if self.on_since is not None and self.on_since < closes[1]:
            return None
        total, moment = 0, 0.0
        for on, off in self.pulses:
            if on >= opens[1] and off <= closes[0]:
                total += off - on
                moment += (off - on) * (on + off) / 2.0
            elif on < closes[1] and off > opens[0]:
                return None
        return total, moment / total if total else 0.0

    def collect(self, opened: NDArray[np.int64], closed: NDArray[np.int64]) -> tuple[NDArray[np.int64], float]:
        """On-ticks within each row's exposure, and their centre of gravity in time."""
        total = np.zeros(len(opened), np.int64)
        moment = 0.0
        pulses = self.pulses if self.on_since is None else [*self.pulses, (self.on_since, int(closed[-1]))]
        for on, off in pulses:
            if (
                on >= opened[-1] and off <= closed[0]
            ):  # all rows saw all of it: rows open, and close, one after the other
                total += off - on
                weight = float(len(total) * (off - on))
                moment += weight * (on + off) / 2.0
                continue
            if on >= closed[-1] or off <= opened[0]:
                continue
            start, end = np.maximum(opened, on), np.minimum(closed, off)
            light = np.maximum(end - start, 0)
            total += light
            moment += float((light * ((start + end) / 2.0 - on)).sum()) + float(light.sum()) * on
        weight = float(total.sum())
        return total, moment / weight if weight > 0 else 0.0
