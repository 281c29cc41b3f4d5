"""What the head's own sensors say of it, from the world's truth and the lamps' real gates. No clock: ticks in, samples
out, the same whatever the steps they are asked for in.

    sensors = HeadSensors(world, image_sensor.cable, clock, faults, seed=1)
    samples = sensors.samples(until, board.pins())
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.controller import PIN_LED, PIN_PROJECTOR, TICK_S
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.twin.cable import Cable
from annulus_pipe.twin.faults import NO_FAULTS, Faults
from annulus_pipe.twin.image_sensor import HostClock
from annulus_pipe.twin.worlds.world import World
from annulus_pipe.vocabulary import AnnulusError

LATE_NS = 500_000  # the bus is read so long after a value was taken, at most
GRAVITY_M_S2 = 9.81

Transitions = Iterable[Sequence[int]] | NDArray[Any]


class HeadSensor(Protocol):
    name: str

    def samples(self, until: int, transitions: Transitions = ()) -> list[Sample]:
        """What it read since the last call, up to world tick `until`, oldest first.

        transitions : (tick, pin, level) of all output pins since the last call; they must be complete up to `until`.
        """


class Steady:
    """A sensor that reads at an even rate, whatever the lamps do."""

    RATE_HZ: ClassVar[float]
    _start: int  # tick
    _taken: int

    def samples(self, until: int, transitions: Transitions = ()) -> list[Sample]:
        out = []
        while (tick := self._start + round((self._taken + 1) / self.RATE_HZ / TICK_S)) <= until:
            out.append(self._at(tick, self._taken))
            self._taken += 1
        return out

    def _at(self, tick: int, index: int) -> Sample:
        raise NotImplementedError


class Imu(Steady):
    """Accelerometer and gyroscope, with the roll that its own filter makes of them.

    Frame: the camera's, x right, y down, z ahead. A head at rest and level reads -9.81 m/s2 along y. `roll_deg` is the
    head's, as `Pose.roll` has it. Vibration is that of a head that slides: it grows with the cable's speed.
    """

    name = "imu"
    RATE_HZ = 100.0
    ROLL_DEG, RATE_DEG_S, ACCELERATION_M_S2 = 0.05, 0.1, 0.03  # noise, rms
    VIBRATION_S = 4.0  # m/s2 of vibration for each m/s of speed
    UNITS: ClassVar[Mapping[str, str]] = {
        "roll_deg": "deg",
        "roll_rate_deg_s": "deg/s",
        "x_m_s2": "m/s2",
        "y_m_s2": "m/s2",
        "z_m_s2": "m/s2",
    }

    def __init__(self, world: World, cable: Cable, clock: HostClock, start_tick: int = 0, seed: int = 0) -> None:
        self._world, self._cable, self._clock, self._seed = world, cable, clock, seed
        self._start, self._taken = start_tick, 0

    def _at(self, tick: int, index: int) -> Sample:
        rng = np.random.default_rng([self._seed, 5, index])
        before, now = self._roll_deg(tick - 1 / self.RATE_HZ / TICK_S), self._roll_deg(tick)
        up = self._world.pose(self._cable.z_mm(tick)).rotation @ np.array([0.0, -1.0, 0.0])
        shaken = math.hypot(self.ACCELERATION_M_S2, self.VIBRATION_S * 1e-3 * self._cable.speed_mm_s(tick))
        acceleration = GRAVITY_M_S2 * up + shaken * rng.standard_normal(3)
        values = (
            now + self.ROLL_DEG * rng.standard_normal(),
            (now - before) * self.RATE_HZ + self.RATE_DEG_S * rng.standard_normal(),
            *acceleration,
        )
        host_ns = self._clock.ns(tick) + int(rng.integers(LATE_NS))
        return Sample(self.name, host_ns, dict(zip(self.UNITS, map(float, values), strict=True)), self.UNITS)

    def _roll_deg(self, tick: float) -> float:
        roll = self._world.pose(self._cable.z_mm(tick)).roll
        return 0.0 if roll is None else math.degrees(roll)


class Supply:
    """An INA226 in the head's supply: mean voltage and current since its last reading; a thermometer beside it.

    The current is what the lamps really drew: each one's own, for as long as its gate was open. The cable drops a part
    of the voltage; the head warms with the power it takes.
    """

    name = "supply"
    RATE_HZ = 10.0
    SOURCE_V, CABLE_OHM, IDLE_A = 12.0, 0.8, 0.35
    LAMPS_A: ClassVar[Mapping[int, float]] = {PIN_PROJECTOR: 2.4, PIN_LED: 1.1}  # while lit
    AMBIENT_C, KELVIN_PER_W, WARMING_S = 18.0, 2.2, 240.0
    # of the converters
    STEPS: ClassVar[Mapping[str, float]] = {"voltage_v": 1.25e-3, "current_a": 1e-3, "temperature_c": 0.0625}
    UNITS: ClassVar[Mapping[str, str]] = {"voltage_v": "V", "current_a": "A", "temperature_c": "degC"}

    def __init__(self, clock: HostClock, start_tick: int = 0, seed: int = 0) -> None:
        self._clock, self._seed = clock, seed
        self._start, self._taken = start_tick, 0
        self._now = start_tick
        self._lit: set[int] = set()  # gates open now
        self._charge = 0.0  # ampere-ticks of the lamps since the last reading
        self._warm_k = self.KELVIN_PER_W * self.SOURCE_V * self.IDLE_A  # it has been on for a while

    def samples(self, until: int, transitions: Transitions = ()) -> list[Sample]:
        out: list[Sample] = []
        for transition in transitions:
            tick, pin, level = (int(value) for value in transition)
            if pin in self.LAMPS_A:
                out += self._run_to(tick)
                (self._lit.add if level else self._lit.discard)(pin)
        return out + self._run_to(until)

    def _run_to(self, tick: int) -> list[Sample]:
        out = []
        while (reading := self._start + round((self._taken + 1) / self.RATE_HZ / TICK_S)) <= tick:
            self._draw(reading)
            out.append(self._read(reading))
        self._draw(tick)
        return out

    def _draw(self, tick: int) -> None:
        self._charge += max(tick - self._now, 0) * sum(self.LAMPS_A[pin] for pin in self._lit)
        self._now = max(tick, self._now)

    def _read(self, tick: int) -> Sample:
        rng = np.random.default_rng([self._seed, 6, self._taken])
        self._taken += 1
        current = self.IDLE_A + self._charge * TICK_S * self.RATE_HZ
        voltage = self.SOURCE_V - self.CABLE_OHM * current
        self._warm_k += (self.KELVIN_PER_W * voltage * current - self._warm_k) / (self.RATE_HZ * self.WARMING_S)
        self._charge = 0.0
        true = {"voltage_v": voltage, "current_a": current, "temperature_c": self.AMBIENT_C + self._warm_k}
        values = {
            name: round(value / self.STEPS[name] + float(rng.standard_normal())) * self.STEPS[name]
            for name, value in true.items()
        }
        return Sample(self.name, self._clock.ns(tick) + int(rng.integers(LATE_NS)), values, self.UNITS)


class HeadSensors:
    """All sensors of the simulated head: a new one is a line in `__init__`, or comes with the world's ground."""

    def __init__(
        self,
        world: World,
        cable: Cable,
        clock: HostClock,
        faults: Faults = NO_FAULTS,
        *,
        start_tick: int = 0,
        seed: int = 0,
    ) -> None:
        self._sensors: tuple[HeadSensor, ...] = (
            Imu(world, cable, clock, start_tick, seed),
            Supply(clock, start_tick, seed),
        )
        if world.ground is not None:
            self._sensors += tuple(world.ground.sensors(world, cable, clock, start_tick, seed))
        self._silences: list[tuple[str, int, int]] = []  # name, from, until in host ns
        for name, after_s, lasting_s in faults.sensors_silent:
            self.silence(name, clock.ns(start_tick) + round(after_s * 1e9), lasting_s)

    def silence(self, name: str, from_ns: int, lasting_s: float) -> None:
        """From that moment on nothing is heard of this sensor, for so long. AnnulusError for one there is not."""
        names = [sensor.name for sensor in self._sensors]
        if name not in names:
            raise AnnulusError(f"sensor {name!r}: expected one of {', '.join(names)}")
        self._silences.append((name, from_ns, from_ns + round(lasting_s * 1e9)))

    def samples(self, until: int, transitions: Transitions = ()) -> list[Sample]:
        """See HeadSensor.samples."""
        transitions = list(transitions)
        heard = [sample for sensor in self._sensors for sample in sensor.samples(until, transitions)]
        heard = [sample for sample in heard if not self._is_silent(sample)]
        return sorted(heard, key=lambda sample: sample.host_ns)

    def _is_silent(self, sample: Sample) -> bool:
        return any(name == sample.sensor and low <= sample.host_ns < high for name, low, high in self._silences)
