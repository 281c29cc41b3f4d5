"""All sensors of a head, read without waiting: samples to whoever observes, silence noticed and said."""

import math
import time
from collections.abc import Mapping, Sequence
from typing import Any

from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import SensorConfig
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.sensors.chips import CHIPS
from annulus_pipe.sensors.i2c import I2cSensors, bus_number, open_bus
from annulus_pipe.sensors.odometer import Odometer
from annulus_pipe.sensors.remote import RemoteSensors
from annulus_pipe.sensors.sample import Sample, Sensor
from annulus_pipe.vocabulary import AnnulusError

SILENT_NS = 2_000_000_000
RETRY_NS = 1_000_000_000  # between two looks at a sensor that broke
WRONG = {"undervoltage", "overcurrent", "draws_nothing"}  # what a supply's sample may say beside its numbers
WRONG_READINGS = 3  # in a row, before it is said: lamps have been armed before their first flash


def open_sensors(wanted: Sequence[SensorConfig]) -> list[Sensor]:
    """Raises AnnulusError when an address or a bus is none; whether anybody speaks there is seen later.

    Chips of one bus are one sensor here: one thread asks them in turn, as often as the most eager of them wants.
    """
    opened: list[Sensor] = [RemoteSensors(sensor.device) for sensor in wanted if sensor.kind not in CHIPS]
    buses: dict[str, list[SensorConfig]] = {}
    for sensor in wanted:
        if sensor.kind in CHIPS:
            buses.setdefault(sensor.device, []).append(sensor)
    try:
        for device, chips in buses.items():
            bus = open_bus(bus_number(device))
            readers = [CHIPS[one.kind].build(bus, one.address, one.name, one.settings) for one in chips]
            on_bus = I2cSensors(device, bus, readers, 1e-3 * min(one.period_ms for one in chips))
            on_bus.start()
            opened.append(on_bus)
    except AnnulusError:
        for one in opened:
            one.close()
        raise
    return opened


class SensorSamples:
    """A sensor that breaks or falls silent costs its samples, nothing else."""

    def __init__(self, sensors: Sequence[Sensor], navigation: Navigation, account: Account, observer: Observer) -> None:
        self._sensors, self._navigation, self._account, self._observer = sensors, navigation, account, observer
        self._last: dict[str, Sample] = {}  # by sensor
        self._heard_ns: dict[str, int] = {}  # the same, by our clock
        self._spoken: set[str] = set()  # sensors that have given a sample
        self._silent: set[str] = set()
        self._broken: dict[str, int] = {}  # name -> when it is looked at again
        self._malformed = self._faults = self._dropped = 0
        self._wrong: dict[tuple[str, str], int] = {}  # of a supply, by sensor and name: how many readings in a row

    def poll(self, now_ns: int | None = None, lit: bool = False) -> None:
        """One look at every sensor. lit : whether the lamps flash, so that one that draws nothing is seen."""
        now = time.monotonic_ns() if now_ns is None else now_ns
        for sensor in self._sensors:
            if isinstance(sensor, I2cSensors):
                sensor.lit = lit
            if now < self._broken.get(sensor.name, 0):
                continue
            try:
                samples = sensor.poll()
            except Exception as error:  # whatever it is, the scan goes on
                if sensor.name not in self._broken:
                    self._account.lose("sensor_silent")
                    why = str(error) if isinstance(error, AnnulusError) else f"{type(error).__name__}: {error}"
                    self._observer.event("sensor", f"sensor {sensor.name} broke: {why}")
                self._broken[sensor.name] = now + RETRY_NS
                continue
            if self._broken.pop(sensor.name, None) is not None:
                self._heard_ns.pop(sensor.name, None)
                self._observer.event("sensor", f"sensor {sensor.name} can be read again")
            if sensor.name not in self._spoken:
                self._heard_ns.setdefault(sensor.name, now)  # until it has spoken, its address is what is silent
            for sample in samples:
                if sensor.name not in self._spoken:
                    self._spoken.add(sensor.name)
                    del self._heard_ns[sensor.name]
                    self._is_back(sensor.name)
                self._one(sample)
                self._heard_ns[sample.sensor] = now
                self._is_back(sample.sensor)
        for sample in self._navigation.odometer.poll():  # silent whenever the camera's sync is
            self._one(sample)
        for name, heard in self._heard_ns.items():
            if now - heard > SILENT_NS and name not in self._silent and name not in self._broken:
                self._silent.add(name)
                self._account.lose("sensor_silent")
                self._observer.event("sensor", f"sensor {name} is silent")
        malformed = sum(getattr(sensor, "malformed", 0) for sensor in self._sensors)
        self._account.lose("sensor_malformed", malformed - self._malformed)
        self._malformed = malformed
        on_buses = [sensor for sensor in self._sensors if isinstance(sensor, I2cSensors)]
        faults, dropped = sum(one.faults for one in on_buses), sum(one.dropped for one in on_buses)
        self._account.lose("sensor_fault", faults - self._faults)
        self._account.lose("sensor_dropped", dropped - self._dropped)
        self._faults, self._dropped = faults, dropped

    def numbers(self) -> Mapping[str, Any]:
        """For the telemetry: the last values, by sensor; what is no number is None."""
        return {
            name: {key: value if math.isfinite(value) else None for key, value in sample.values.items()}
            for name, sample in self._last.items()
        }

    def _is_back(self, name: str) -> None:
        if name in self._silent:
            self._silent.discard(name)
            self._observer.event("sensor", f"sensor {name} is back")

    def _one(self, sample: Sample) -> None:
        self._last[sample.sensor] = sample
        self._account.samples[sample.sensor] += 1
        self._navigation.sampled(sample)
        self._observer.sample(sample)
        for name in WRONG & sample.values.keys():
            key = sample.sensor, name
            self._wrong[key] = self._wrong.get(key, 0) + 1 if sample.values[name] > 0 else 0
            if self._wrong[key] == WRONG_READINGS:
                self._account.lose("supply_fault")
                volts, amperes = (sample.values.get(unit, math.nan) for unit in ("voltage_v", "current_a"))
                text = f"{sample.sensor}: {name.replace('_', ' ')}, {volts:.2f} V, {1000 * amperes:.0f} mA"
                self._observer.event("sensor", text)


def place_numbers(odometer: Odometer) -> dict[str, Any]:
    """For the telemetry."""
    here = odometer.here
    return {
        "speed_mm_s": odometer.speed_mm_s if here is not None else None,
        "z_mm": here.z_mm if here is not None else None,
        "z_bound_mm": here.bound_mm if here is not None else None,  # 0: counted
        "z_assumed": here.assumed if here is not None else False,
        "segment": here.segment if here is not None else 0,
    }


def tell_place(odometer: Odometer, observer: Observer) -> None:
    """What people should know of the odometer since the last call."""
    if odometer.zeroed_mm is not None:
        observer.event("odometer", f"odometer zeroed at {odometer.zeroed_mm:.1f} mm; z begins again there")
        odometer.zeroed_mm = None
    if odometer.gap is not None:
        observer.event("odometer", str(odometer.gap))
        odometer.gap = None
