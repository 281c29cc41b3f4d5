"""The chips on I2C that head.toml may name: what each may be told, within what, and the driver that comes of it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

from annulus_pipe.sensors.fdc2214 import TANK, Ads1115, Fdc2214, Tank
from annulus_pipe.sensors.i2c import Bus, Reader
from annulus_pipe.sensors.imu import Mpu6050
from annulus_pipe.sensors.ina226 import RAIL, Ina226, Rail

Settings = Mapping[str, float]


@dataclass(frozen=True, slots=True)
class ChipKind:
    """name : of its samples, where nobody says another. settings : least and most of each, in the unit of its name."""

    address: int
    name: str
    settings: Mapping[str, tuple[float, float]]
    build: Callable[[Bus, int, str, Settings], Reader]


def _fdc2214(bus: Bus, address: int, name: str, settings: Settings) -> Reader:
    adc = Ads1115(bus, int(settings["adc_address"])) if "adc_address" in settings else None
    chip = Fdc2214(bus, address, _tank(settings), adc, name)
    if adc is not None:
        adc.faults = chip.faults  # one sample, one count
    return chip


def _tank(settings: Settings) -> Tank:
    usual = {field.name: type(getattr(TANK, field.name)) for field in fields(Tank)}
    return Tank(**{name: usual[name](value) for name, value in settings.items() if name in usual})


def _ina226(bus: Bus, address: int, name: str, settings: Settings) -> Reader:
    return Ina226(bus, address, Rail(**dict(settings)), name)


def _mpu6050(bus: Bus, address: int, name: str, settings: Settings) -> Reader:
    return Mpu6050(bus, address, name)


CHIPS: Mapping[str, ChipKind] = {
    "fdc2214": ChipKind(
        0x2A,
        "capacitance",
        {
            "adc_address": (0x48, 0x4B),
            "inductance_uh": (0.1, 1e3),
            "fixed_pf": (0.0, 1e3),
            "clock_mhz": (2.0, 40.0),
            "drive": (0, 31),
            "drive_ma": (0.01, 2.0),
            "coil_kohm": (0.1, 1e3),
        },
        _fdc2214,
    ),
    "ina226": ChipKind(
        0x40,
        "supply",
        {
            "shunt_mohm": (0.1, 1e4),
            "least_v": (0.0, 36.0),
            "most_a": (0.001, 100.0),
            "draws_ma": (0.1, 1e5),
            "derated_from_c": (-40.0, 125.0),
            "derated_a_per_k": (0.0, 10.0),
        },
        _ina226,
    ),
    "mpu6050": ChipKind(0x68, "imu", {}, _mpu6050),
}
assert {name for name in CHIPS["ina226"].settings} == {field.name for field in fields(RAIL)}
