"""INA226: volts and amperes of the head's supply, or of a lamp's rail. 16-bit registers, 2.5 uV and 1.25 mV a count.

What is wrong is told beside the numbers: undervoltage, overcurrent, a lamp that draws nothing while it should.
"""

import math
from dataclasses import dataclass

from annulus.sensors.i2c import Bus, Chip

CONFIG, SHUNT, VOLTS, CALIBRATION, MANUFACTURER, DIE = 0x00, 0x01, 0x02, 0x05, 0xFE, 0xFF
IDENTITY = {MANUFACTURER: 0x5449, DIE: 0x2260}
AT_RESET = 0x4127  # of CONFIG: what it holds after a brown-out, and never as set here
SETTING = 0x4527  # 16 averages, 1.1 ms each, both continuously
SHUNT_UV, VOLTS_MV = 2.5, 1.25  # a count


@dataclass(frozen=True, slots=True)
class Rail:
    """shunt_mohm : between its sense pins. The rest is what counts as wrong; draws_ma : least that a lamp lit draws."""

    shunt_mohm: float = 10.0
    least_v: float = 4.75
    most_a: float = 3.0
    draws_ma: float = math.nan  # no lamp

    @property
    def calibration(self) -> int:
        """For the chip's own current register, 1 mA a count; ours is computed, so that no rounding is in it."""
        return min(round(0.00512 / (1e-3 * self.shunt_mohm * 1e-3)), 0x7FFF)


RAIL = Rail()


class Ina226(Chip):
    """`lit` says whether the lamp behind it should draw; None where there is none."""

    def __init__(self, bus: Bus, address: int = 0x40, rail: Rail = RAIL, name: str = "supply") -> None:
        super().__init__(bus, address)
        self.name, self._rail = name, rail
        self.lit: bool | None = None

    def set_up(self) -> None:
        self.identify(IDENTITY)
        self.set(CALIBRATION, self._rail.calibration)
        self.set(CONFIG, SETTING)

    def values(self) -> tuple[dict[str, float], dict[str, str]]:
        if self.read(CONFIG) == AT_RESET:
            self.faults["brown-out"] += 1
            self.set_up()
        raw = self.read(SHUNT)
        amperes = (raw - (raw >> 15 << 16)) * SHUNT_UV * 1e-3 / self._rail.shunt_mohm
        volts = (self.read(VOLTS) & 0x7FFF) * VOLTS_MV * 1e-3
        dark = bool(self.lit) and 1000 * amperes < self._rail.draws_ma
        wrong = {
            "undervoltage": volts < self._rail.least_v,
            "overcurrent": abs(amperes) > self._rail.most_a,
            "draws_nothing": dark,
        }
        numbers = {"voltage_v": volts, "current_a": amperes, **{name: float(is_so) for name, is_so in wrong.items()}}
        return numbers, {"voltage_v": "V", "current_a": "A", **dict.fromkeys(wrong, "1")}
