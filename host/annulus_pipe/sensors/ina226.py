"""INA226: volts and amperes of the head's supply, or of a lamp's rail. 16-bit registers, 2.5 uV and 1.25 mV a count.

What is wrong is told beside the numbers: undervoltage, overcurrent, a lamp that draws nothing while it should. What it
may draw is less in a hot head: the limit falls with the head's temperature, and is told, too.
"""

import math
from dataclasses import dataclass

from annulus_pipe.sensors.i2c import Bus, I2cChip

CONFIG, SHUNT, VOLTS, CALIBRATION, MANUFACTURER, DIE = 0x00, 0x01, 0x02, 0x05, 0xFE, 0xFF
IDENTITY = {MANUFACTURER: 0x5449, DIE: 0x2260}
AT_RESET = 0x4127  # of CONFIG: what it holds after a brown-out, and never as set here
SETTING = 0x4527  # 16 averages, 1.1 ms each, both continuously
SHUNT_UV, VOLTS_MV = 2.5, 1.25  # a count


@dataclass(frozen=True, slots=True)
class Rail:
    """shunt_mohm : between its sense pins. The rest is what counts as wrong; draws_ma : the least that its lamps draw
    in the mean while they flash. Above derated_from_c most_a falls by derated_a_per_k.
    """

    shunt_mohm: float = 10.0
    least_v: float = 4.75
    most_a: float = 3.0
    draws_ma: float = math.nan  # no lamp
    derated_from_c: float = 60.0
    derated_a_per_k: float = 0.0

    def limit_a(self, head_c: float) -> float:
        """The most it may draw in a head so warm, not derated while the temperature is not known."""
        over = max(head_c - self.derated_from_c, 0.0) if math.isfinite(head_c) else 0.0
        return max(self.most_a - self.derated_a_per_k * over, 0.0)

    @property
    def calibration(self) -> int:
        """For the chip's own current register, 1 mA a count. We do not read that: we compute the current from the shunt
        voltage, without its rounding."""
        return min(round(0.00512 / (1e-3 * self.shunt_mohm * 1e-3)), 0x7FFF)


RAIL = Rail()


class Ina226(I2cChip):
    """Needs `lit` and `head_c` of I2cChip to say what a lamp should draw, and may."""

    def __init__(self, bus: Bus, address: int = 0x40, rail: Rail = RAIL, name: str = "supply") -> None:
        super().__init__(bus, address)
        self.name, self._rail = name, rail

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
        limit = self._rail.limit_a(self.head_c)
        wrong = {"undervoltage": volts < self._rail.least_v, "overcurrent": abs(amperes) > limit, "draws_nothing": dark}
        measured = {"voltage_v": volts, "current_a": amperes, "current_limit_a": limit}
        units = {"voltage_v": "V", "current_a": "A", "current_limit_a": "A"}
        return measured | {name: float(is_so) for name, is_so in wrong.items()}, units | dict.fromkeys(wrong, "1")
