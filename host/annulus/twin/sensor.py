"""When the twin's camera looks, and how much light each row then gets. No clock, no thread: ticks in, frames out.

    sensor = Sensor(world, timing, faults, seed=1)
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

import math
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus.capture.timing import FrameTiming
from annulus.controller import (
    PIN_INTERLOCK,
    PIN_LED,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_PROJECTOR,
    PIN_SYNC,
    TICK_NS,
    TICK_S,
    TICKS_PER_US,
)
from annulus.geometry.pose import Pose
from annulus.twin.worlds import World
from annulus.vocabulary import AnnulusError, CameraSequence, Lamp

Stimulus = tuple[int, int, int]  # world tick, pin, level
_QUADRATURE = ((0, 0), (1, 0), (1, 1), (0, 1))  # A, B as the count rises: A leads


@dataclass(frozen=True, slots=True)
class Faults:
    """What goes wrong, as rates a frame or an event, all from one seed."""

    frames_dropped: float = 0.0  # by the camera's driver: a hole in its sequence
    events_lost: float = 0.0  # whole events lost between controller and host
    bytes_flipped: float = 0.0  # of all bytes from the controller
    timestamp_jitter_us: float = 0.0  # standard deviation, normal
    sync_missing: float = 0.0  # edges that never come
    sync_glitches: float = 0.0  # edges doubled by a 20 us spike in the middle of a frame
    resets: tuple[int, ...] = ()  # the controller restarts in the middle of these frames

    def __post_init__(self) -> None:
        for name in ("frames_dropped", "events_lost", "bytes_flipped", "sync_missing", "sync_glitches"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
                raise AnnulusError(f"faults: {name} is {value!r}, expected a share from 0 to 1")
        jitter = self.timestamp_jitter_us
        if isinstance(jitter, bool) or not isinstance(jitter, int | float) or not 0.0 <= jitter <= 1e6:
            raise AnnulusError(f"faults: timestamp_jitter_us is {jitter!r}, expected 0 to 1000000")
        if not all(isinstance(frame, int) and not isinstance(frame, bool) and frame >= 0 for frame in self.resets):
            raise AnnulusError(f"faults: resets is {self.resets!r}, expected frame numbers")


NO_FAULTS = Faults()
NAMED_FAULTS = {
    "none": NO_FAULTS,
    # the acceptance soak; its two resets are placed by whoever knows the length of the run
    "standard": Faults(frames_dropped=0.01, events_lost=0.01, timestamp_jitter_us=2000.0),
    "rough": Faults(
        frames_dropped=0.03, events_lost=0.02, bytes_flipped=1e-4, timestamp_jitter_us=3000.0, sync_missing=0.003,
        sync_glitches=0.003,
    ),
}  # fmt: skip


def load_faults(source: str | Path | None) -> Faults:
    """Faults by name (`none`, `standard`, `rough`) or from a TOML file whose keys are the fields of `Faults`."""
    if source is None:
        return NO_FAULTS
    if str(source) in NAMED_FAULTS:
        return NAMED_FAULTS[str(source)]
    path = Path(source)
    try:
        data: dict[str, Any] = tomllib.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        raise AnnulusError(f"{source}: no such fault file, and not one of {', '.join(NAMED_FAULTS)}") from None
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise AnnulusError(f"{path}: cannot be read as TOML: {error}") from None
    unknown = set(data) - {f.name for f in fields(Faults)}
    if unknown:
        raise AnnulusError(f"{path}: does not know {sorted(unknown)}, expected {[f.name for f in fields(Faults)]}")
    if isinstance(data.get("resets"), list):
        data["resets"] = tuple(data["resets"])
    try:
        return Faults(**data)
    except (AnnulusError, TypeError) as error:
        raise AnnulusError(f"{path}: {error}") from None


@dataclass(frozen=True, slots=True)
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


@dataclass(frozen=True, slots=True)
class Exposure:
    """One frame as the sensor collected it: everything `Renderer.render` asks for, and the truth to score labels by."""

    sequence: CameraSequence
    edge_tick: int  # world tick of the sync edge that ends its readout
    timestamp_ns: int  # what the driver will say: host clock, offset and jitter included
    z_mm: float  # of the head when the light came
    pose: Pose
    projector: NDArray[np.float32]  # (H,) on-time each row saw, over the lamp's nominal on-time
    led: NDArray[np.float32]
    dropped: bool  # the driver lost it

    @property
    def lamps(self) -> frozenset[Lamp]:
        """Lamps that put any light into it; empty for a dark frame."""
        lit = ((Lamp.PROJECTOR, self.projector), (Lamp.LED, self.led))
        return frozenset(lamp for lamp, rows in lit if float(rows.max()) > 1e-4)


class Sensor:
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
    ) -> None:
        """timestamp_offset_us: driver's timestamp minus the sync edge; by default the start of the readout, as V4L2.

        speed_mm_s: of the cable from the start on; see `pull`.
        """
        self.world = world
        self.timing = timing
        self.faults = faults
        self.clock = clock or HostClock()
        self.offset_us = -timing.readout_us if timestamp_offset_us is None else timestamp_offset_us
        self._seed = seed
        self._period = timing.period_us * TICKS_PER_US
        self._readout = round(timing.readout_us * TICKS_PER_US)
        self._exposure = round(timing.exposure_us * TICKS_PER_US)
        self._start = start_tick
        self._ended = 0  # frames handed out
        self._announced = 0  # frames whose sync pulses were handed out
        self._told = start_tick - 1  # stimuli up to here were handed out
        self._pending: list[Stimulus] = []
        self._gates = {PIN_PROJECTOR: _Gate(), PIN_LED: _Gate()}
        self._pulls = [_Pull(start_tick, 0.0, speed_mm_s, world.travel_mm)]
        self._count = 0
        rows = np.arange(world.camera.height) / max(world.camera.height - 1, 1)
        self._row_close = -np.round(self._readout * (1.0 - rows)).astype(np.int64)  # after the edge

    @property
    def next_edge(self) -> int:
        """World tick of the sync edge that ends the readout of the next frame to be handed out."""
        return self.edge(self._ended)

    def edge(self, frame: int) -> int:
        """World tick at which the readout of frame `frame` (from 0) ends."""
        return self._start + round((frame + 1) * self._period)

    def z_mm(self, tick: float) -> float:
        """Station of the head."""
        pull = next((p for p in reversed(self._pulls) if p.tick <= tick), self._pulls[0])
        return pull.z_mm(tick)

    def pull(self, tick: int, speed_mm_s: float) -> None:
        """From `tick` on the cable moves at this speed, until the end of the world's travel; 0 stops it."""
        if tick <= self._told:
            raise ValueError(f"the cable's way up to tick {self._told} is already told, {tick} is too late")
        self._pulls.append(_Pull(tick, self.z_mm(tick), speed_mm_s, self.world.travel_mm))

    def levels(self) -> list[tuple[int, int]]:
        """(pin, level) of every input as it is now: for a board that has just been powered on again."""
        a, b = _QUADRATURE[self._count % 4]
        return [(PIN_INTERLOCK, 0), (PIN_SYNC, 0), (PIN_ODOMETER_A, a), (PIN_ODOMETER_B, b)]

    def stimuli(self, until: int) -> list[Stimulus]:
        """Input pins' transitions after those already told, up to and including tick `until`, in order."""
        if self._told < self._start:
            self._pending += [(self._start, pin, level) for pin, level in self.levels()]
        while self.edge(self._announced) - self._readout <= until:
            self._pending += self._sync_of(self._announced)
            self._announced += 1
        self._pending += self._odometer(self._told, until)
        self._pending.sort(key=lambda stimulus: stimulus[0])
        now = [s for s in self._pending if s[0] <= until]
        self._pending = self._pending[len(now) :]
        self._told = max(self._told, until)
        return now

    def exposures(self, now: int, transitions: Iterable[Sequence[int]] | NDArray[Any] = ()) -> list[Exposure]:
        """Frames whose readout has ended by `now`, oldest first.

        transitions : (tick, pin, level) of all output pins since the last call; they must be complete up to `now`.
        """
        for transition in transitions:
            tick, pin, level = int(transition[0]), int(transition[1]), int(transition[2])
            if pin in self._gates:
                self._gates[pin].change(tick, level)
        done = []
        while self.next_edge <= now:
            done.append(self._expose(self._ended))
            self._ended += 1
        for gate in self._gates.values():
            gate.forget(self.next_edge - self._readout - self._exposure)
        return done

    def _expose(self, frame: int) -> Exposure:
        edge = self.edge(frame)
        close = edge + self._row_close
        projector, at_projector = self._gates[PIN_PROJECTOR].collect(close - self._exposure, close)
        led, at_led = self._gates[PIN_LED].collect(close - self._exposure, close)
        weight = [float(projector.sum()), float(led.sum())]
        dark_at = edge - self._readout // 2 - self._exposure // 2
        at = np.average([at_projector, at_led], weights=weight) if sum(weight) > 0 else dark_at
        z = self.z_mm(float(at))
        rng = np.random.default_rng([self._seed, 1, frame])
        dropped = bool(rng.random() < self.faults.frames_dropped)
        late = self.offset_us + self.faults.timestamp_jitter_us * float(rng.standard_normal())
        nominal = (self.world.projector.nominal_us, self.world.led.nominal_us)
        return Exposure(
            CameraSequence(frame),
            edge,
            self.clock.ns(edge + late * TICKS_PER_US),
            z,
            self.world.pose(z),
            (projector / (nominal[0] * TICKS_PER_US)).astype(np.float32),
            (led / (nominal[1] * TICKS_PER_US)).astype(np.float32),
            dropped,
        )

    def _sync_of(self, frame: int) -> list[Stimulus]:
        """High from the end of the first line to the end of the last."""
        rng = np.random.default_rng([self._seed, 2, frame])
        missing, glitch = rng.random(2) < (self.faults.sync_missing, self.faults.sync_glitches)
        edge = self.edge(frame)
        out: list[Stimulus] = [] if missing else [(edge - max(self._readout, 100), PIN_SYNC, 1), (edge, PIN_SYNC, 0)]
        if glitch:
            spike = edge + round(self._period) // 8
            out += [(spike, PIN_SYNC, 1), (spike + 20 * TICKS_PER_US, PIN_SYNC, 0)]
        return out

    def _odometer(self, after: int, until: int) -> list[Stimulus]:
        out: list[Stimulus] = []
        step = self.world.mm_per_count
        ends = [p.tick for p in self._pulls[1:]] + [until + 1]
        for pull, end in zip(self._pulls, ends, strict=True):
            last = min(end - 1, until)
            if last <= after or pull.tick > until or pull.speed_mm_s == 0.0:
                continue
            target = math.floor(pull.z_mm(last) / step + 1e-9)
            while self._count != target:
                up = target > self._count
                crossing = pull.tick_at((self._count + (1 if up else 0)) * step)
                self._count += 1 if up else -1
                old, new = _QUADRATURE[(self._count - (1 if up else -1)) % 4], _QUADRATURE[self._count % 4]
                pin = 0 if old[0] != new[0] else 1
                tick = min(max(crossing, after + 1), last)
                out.append((tick, (PIN_ODOMETER_A, PIN_ODOMETER_B)[pin], new[pin]))
        self._pulls = [p for p, end in zip(self._pulls, ends, strict=True) if end > after - self._history] or [
            self._pulls[-1]
        ]
        return out

    @property
    def _history(self) -> int:
        """Ticks that a frame still to be handed out may look back."""
        return self._readout + self._exposure + 3 * round(self._period)


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


@dataclass(slots=True)
class _Gate:
    """One lamp's gate pin over time."""

    on_since: int | None = None
    pulses: list[tuple[int, int]] = field(default_factory=list)

    def change(self, tick: int, level: int) -> None:
        if level and self.on_since is None:
            self.on_since = tick
        elif not level and self.on_since is not None:
            self.pulses.append((self.on_since, tick))
            self.on_since = None

    def forget(self, before: int) -> None:
        self.pulses = [p for p in self.pulses if p[1] >= before]

    def collect(self, opened: NDArray[np.int64], closed: NDArray[np.int64]) -> tuple[NDArray[np.int64], float]:
        """On-ticks within each row's exposure, and their centre of gravity in time."""
        total = np.zeros(len(opened), np.int64)
        moment = 0.0
        pulses = self.pulses if self.on_since is None else [*self.pulses, (self.on_since, int(closed[-1]))]
        for on, off in pulses:
            start, end = np.maximum(opened, on), np.minimum(closed, off)
            light = np.maximum(end - start, 0)
            total += light
            moment += float((light * ((start + end) / 2.0 - on)).sum()) + float(light.sum()) * on
        weight = float(total.sum())
        return total, moment / weight if weight > 0 else 0.0


class LossyLine:
    """The serial line from controller to host: loses whole events, flips bytes. Bytes may come in any pieces."""

    def __init__(self, faults: Faults, seed: int = 0) -> None:
        self._faults = faults
        self._rng = np.random.default_rng([seed, 3])
        self._frame = bytearray()
        self.events_lost = 0
        self.bytes_flipped = 0

    def carry(self, data: bytes) -> bytes:
        """What arrives of `data`. With event loss an unfinished frame waits here for its delimiter."""
        if self._faults.events_lost > 0:
            data = self._lose_events(data)
        if self._faults.bytes_flipped > 0 and data:
            hit = np.flatnonzero(self._rng.random(len(data)) < self._faults.bytes_flipped)
            flipped = bytearray(data)
            for i in hit:
                flipped[i] ^= 1 << int(self._rng.integers(8))
            self.bytes_flipped += len(hit)
            data = bytes(flipped)
        return data

    def _lose_events(self, data: bytes) -> bytes:
        out = bytearray()
        for byte in data:
            self._frame.append(byte)
            if byte == 0:
                # an event's id is 0x80 or above, never zero, so it stands behind the first COBS code byte
                is_event = len(self._frame) > 2 and 0x80 <= self._frame[1] < 0xF0
                if is_event and self._rng.random() < self._faults.events_lost:
                    self.events_lost += 1
                else:
                    out += self._frame
                self._frame.clear()
        return bytes(out)
