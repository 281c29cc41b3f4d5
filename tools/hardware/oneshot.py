"""One-shots behind the gates: how long each lasts at most and at least, whatever the controller does.

The 74LVC1G123 ends its pulse when its capacitor has been charged through its resistor to 0.632 of the supply: t = R C
(Texas Instruments, SLVA720A, "Designing With the SN74LVC1G123"). Its datasheet (SCES586) has 90..110 us where R C is
100 us, and 0.9..1.1 ms where it is 1 ms. Here the longest must not be over the controller's own limit, so that the
shortest is what a lamp may count on.
"""

from dataclasses import dataclass

from annulus_pipe.controller import LAMP_WIDTH_MAX_TICKS, MICROWAVE_PULSE_MAX_TICKS, TICK_HZ

PART_TOLERANCE = 0.10  # of the one-shot itself, over supply and temperature
RESISTOR_TOLERANCE = 0.01
CAPACITOR_TOLERANCE = 0.05  # C0G
RESISTOR_LEAST_OHM, RESISTOR_MOST_OHM = 1e3, 1e6  # at 3.3 V
CAPACITOR_LEAST_F = 10e-9  # below, the datasheet's curves hold and not the product


@dataclass(frozen=True, slots=True)
class OneShot:
    ohm: float
    farad: float
    limit_s: float  # of the controller, for this output

    @property
    def longest_s(self) -> float:
        return self.ohm * self.farad * (1 + PART_TOLERANCE) * (1 + RESISTOR_TOLERANCE) * (1 + CAPACITOR_TOLERANCE)

    @property
    def shortest_s(self) -> float:
        return self.ohm * self.farad * (1 - PART_TOLERANCE) * (1 - RESISTOR_TOLERANCE) * (1 - CAPACITOR_TOLERANCE)


PREFIXES = {"M": 1e6, "k": 1e3, "": 1.0, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12}


def shown(value: float) -> str:
    """As it stands at a part: 169k, 2.55k, 100n."""
    prefix, unit = next((prefix, unit) for prefix, unit in PREFIXES.items() if value >= unit * 0.9999)
    return f"{value / unit:g}{prefix}"


def read(text: str) -> float:
    """What `shown` wrote, or whoever wrote a part's value."""
    return float(text[:-1]) * PREFIXES[text[-1]] if text[-1] in PREFIXES else float(text)


LAMP = OneShot(169e3, 100e-9, LAMP_WIDTH_MAX_TICKS / TICK_HZ)
MICROWAVE = OneShot(2.55e3, 10e-9, MICROWAVE_PULSE_MAX_TICKS / TICK_HZ)
