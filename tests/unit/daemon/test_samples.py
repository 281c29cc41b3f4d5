"""Promises about sensors: a dead one is noticed, counted and said, and nothing waits for it."""

import errno

import pytest

from annulus_pipe.daemon import samples
from annulus_pipe.daemon.account import Account
from annulus_pipe.daemon.config import SensorConfig
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.samples import RETRY_NS, SILENT_NS, SensorSamples, open_sensors
from annulus_pipe.labelling.navigation import Navigation
from annulus_pipe.sensors.fdc2214 import Tank
from annulus_pipe.sensors.i2c import I2cSensors
from annulus_pipe.sensors.sample import Sample
from annulus_pipe.twin.i2c_chips import TwinBus, ads1115, fdc2214, ina226, mpu6050
from annulus_pipe.vocabulary import AnnulusError

S = 1_000_000_000


class Scripted:
    """A sensor that gives what it was given."""

    def __init__(self, name: str) -> None:
        self.name, self.next, self.malformed, self.polls = name, [], 0, 0

    def poll(self) -> list[Sample]:
        self.polls += 1
        if isinstance(self.next, Exception):
            raise self.next
        given, self.next = self.next, []
        return given

    def close(self) -> None: ...


class Listener(Observer):
    def __init__(self) -> None:
        self.samples: list[Sample] = []
        self.told: list[str] = []

    def sample(self, sample: Sample) -> None:
        self.samples.append(sample)

    def event(self, kind: str, text: str) -> None:
        assert kind == "sensor"
        self.told.append(text)


class Rig:
    def __init__(self, *names: str, on_bus: I2cSensors | None = None) -> None:
        self.sensors = [Scripted(name) for name in names]
        self.account, self.heard, self.navigation = Account(), Listener(), Navigation(0.05)
        self.samples = SensorSamples(
            self.sensors if on_bus is None else [on_bus], self.navigation, self.account, self.heard
        )

    def poll(self, now_ns: int, *values: tuple[str, float], sensor: int = 0) -> None:
        if values:
            self.sensors[sensor].next = [Sample(name, now_ns, {"u": value}, {"u": "V"}) for name, value in values]
        self.samples.poll(now_ns)


def test_samples_go_to_who_listens_and_the_last_ones_into_the_telemetry() -> None:
    rig = Rig("ipc://x", "ipc://y")
    rig.poll(0, ("supply", 12.0), ("other", float("nan")))
    rig.poll(1, ("supply", 11.5))
    assert [sample.sensor for sample in rig.heard.samples] == ["supply", "other", "supply"]
    assert rig.samples.numbers() == {"supply": {"u": 11.5}, "other": {"u": None}}
    assert rig.account.samples == {"supply": 2, "other": 1}
    rig.sensors[1].malformed = 3
    rig.poll(2)
    rig.poll(3)
    assert rig.account.drops == {"sensor_malformed": 3}


def test_silence_is_said_and_counted_once_and_so_is_its_end() -> None:
    rig = Rig("ipc://x")
    rig.poll(0, ("imu", 1.0), ("supply", 1.0))
    for tenth in range(1, 41):
        rig.poll(tenth * S // 10, ("supply", 1.0))
    assert rig.heard.told == ["sensor imu is silent"]
    rig.poll(5 * S, ("imu", 1.0), ("supply", 1.0))
    assert rig.heard.told[1:] == ["sensor imu is back"]
    rig.poll(5 * S + SILENT_NS + 1)
    assert sorted(rig.heard.told[2:]) == ["sensor imu is silent", "sensor supply is silent"]
    assert rig.account.drops == {"sensor_silent": 3}


def test_an_address_where_nobody_ever_spoke_is_said_too() -> None:
    rig = Rig("ipc://nobody")
    rig.poll(0)
    rig.poll(SILENT_NS + 1)
    assert rig.heard.told == ["sensor ipc://nobody is silent"]
    rig.poll(3 * S, ("imu", 1.0))
    rig.poll(4 * S, ("imu", 1.0))
    assert rig.heard.told[1:] == ["sensor ipc://nobody is back"]
    rig.poll(4 * S + SILENT_NS + 1)
    assert rig.heard.told[2:] == ["sensor imu is silent"]


def test_a_sensor_that_breaks_costs_only_itself_and_is_looked_at_again() -> None:
    rig = Rig("a", "b")
    for trouble, says in ((AnnulusError("bus gone"), "sensor a broke: bus gone"), (OSError("no"), "OSError: no")):
        rig.sensors[0].next = trouble
        rig.sensors[0].polls = 0
        begun = 10 * S if isinstance(trouble, OSError) else 0
        for step in range(100):
            rig.poll(begun + step * RETRY_NS // 50, ("b", 1.0), sensor=1)
        assert rig.sensors[0].polls == 2 and says in rig.heard.told[0] and len(rig.heard.told) == 1
        rig.sensors[0].next = []
        rig.poll(begun + 5 * RETRY_NS, ("b", 1.0), sensor=1)
        assert rig.heard.told == [rig.heard.told[0], "sensor a can be read again"]
        rig.heard.told.clear()
    assert rig.account.samples == {"b": 202}


def test_whoever_gives_roll_in_degrees_is_the_attitude_sensor() -> None:
    rig = Rig("a")
    rig.sensors[0].next = [
        Sample("imu", 0, {"roll_deg": 3.0, "pitch_deg": 1.0}, {"roll_deg": "deg", "pitch_deg": "deg"}),
        Sample("imu", 1, {"roll_deg": float("nan")}, {"roll_deg": "deg"}),
        Sample("odd", 2, {"roll_deg": 50.0}, {"roll_deg": "rad"}),
    ]
    rig.samples.poll(2)
    assert rig.navigation.roll.at(2) == 3.0


PLAYS = {
    "voltage_v": 5.0,
    "current_a": 0.4,
    "x_g": 0.5,
    "y_g": -0.866,
    "z_g": 0.0,
    "temperature_c": 21.0,
    "c1_pf": 4.8,
    "c2_pf": 4.85,
    "c3_pf": 4.57,
    "cref_pf": 4.7,
    "loss1_ff": 20.0,
    "loss2_ff": 0.0,
    "loss3_ff": 30.0,
}


def head_on_i2c(monkeypatch: pytest.MonkeyPatch) -> tuple[TwinBus, dict[str, float], Rig, I2cSensors]:
    """A supply with lamps, an IMU and three sectors on the twin's bus, opened as head.toml names them."""
    plays = dict(PLAYS)
    bus = TwinBus(
        {0x40: ina226(plays, 10.0), 0x68: mpu6050(plays), 0x2A: fdc2214(plays, Tank()), 0x48: ads1115(plays, Tank())}
    )
    monkeypatch.setattr(samples, "open_bus", lambda number: bus)
    monkeypatch.setattr(I2cSensors, "start", lambda self: None)  # the test takes its steps
    rail = {"draws_ma": 50.0, "most_a": 1.0, "derated_from_c": 40.0, "derated_a_per_k": 0.02}
    (on_bus,) = open_sensors(
        (
            SensorConfig("ina226", "/dev/i2c-1", "supply", 0x40, 25.0, rail),
            SensorConfig("fdc2214", "/dev/i2c-1", "capacitance", 0x2A, 25.0, {"adc_address": 0x48}),
            SensorConfig("mpu6050", "/dev/i2c-1", "imu", 0x68),
        )
    )
    assert isinstance(on_bus, I2cSensors)
    return bus, plays, Rig(on_bus=on_bus), on_bus


def test_chips_of_head_toml_give_samples_and_their_roll_is_the_heads(monkeypatch: pytest.MonkeyPatch) -> None:
    _, _, rig, on_bus = head_on_i2c(monkeypatch)
    on_bus.step(0.0, S)
    rig.samples.poll(S)
    said = {sample.sensor: sample for sample in rig.heard.samples}
    assert set(said) == {"supply", "capacitance", "imu"}
    assert said["capacitance"].values["c2_pf"] == pytest.approx(4.85, abs=1e-5)
    assert said["capacitance"].values["loss3_ff"] == pytest.approx(30.0, abs=0.5)
    assert said["imu"].values["roll_deg"] == pytest.approx(-30.0, abs=0.1)
    assert not rig.account.drops and not rig.heard.told


def test_a_lamp_that_draws_nothing_and_a_limit_that_falls_with_heat_are_said_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    _, plays, rig, on_bus = head_on_i2c(monkeypatch)
    now = 0

    def readings(count: int, lit: bool) -> None:
        nonlocal now
        for _ in range(count):
            now += 1
            rig.samples.poll(now * S // 40, lit)
            on_bus.step(now / 40, now * S // 40)
        rig.samples.poll(now * S // 40, lit)

    plays["current_a"] = 0.002
    readings(10, lit=False)
    assert not rig.heard.told
    readings(10, lit=True)
    assert rig.heard.told == ["supply: draws nothing, 5.00 V, 2 mA"]
    plays["current_a"] = 0.8
    readings(10, lit=True)
    assert rig.account.drops == {"supply_fault": 1}
    plays["temperature_c"] = 60.0  # 0.6 A are left of the 1 A
    readings(10, lit=True)
    assert rig.heard.told[1:] == ["supply: overcurrent, 5.00 V, 800 mA"]
    plays.update(temperature_c=20.0, voltage_v=4.2)
    readings(10, lit=True)
    assert rig.heard.told[2:] == ["supply: undervoltage, 4.20 V, 800 mA"]


def test_faults_of_a_bus_are_counted_and_a_stuck_one_is_said_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    bus, _, rig, on_bus = head_on_i2c(monkeypatch)
    bus.faults = [errno.EREMOTEIO] * 2
    on_bus.step(0.0, S)
    rig.samples.poll(S)
    assert rig.account.drops == {"sensor_fault": 2} and not rig.heard.told
    bus.stuck = True
    on_bus.step(1.0, 2 * S)
    rig.samples.poll(2 * S)
    assert "not answered" in rig.heard.told[0] and rig.account.drops["sensor_silent"] == 1
    bus.stuck = False
    on_bus.step(3.0, 4 * S)
    rig.samples.poll(4 * S)
    assert rig.heard.told[-1].endswith("can be read again")
    assert rig.heard.samples[-1].host_ns == 4 * S


def test_a_bus_that_is_none_is_one_line() -> None:
    with pytest.raises(AnnulusError, match="/dev/i2c-199: cannot be opened"):
        open_sensors((SensorConfig("mpu6050", "/dev/i2c-199", "imu", 0x68),))
