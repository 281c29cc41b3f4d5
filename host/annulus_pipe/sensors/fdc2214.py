"""FDC2214: three capacitive sectors and a fixed reference, as the frequencies of four tanks; their loss by an ADC.

A tank of L and C rings at f = 1 / (2 pi sqrt(L C)); the chip counts f against its clock, 28 bits: data / 2^28 =
f / (FIN_SEL f_ref). Of the usual chips this one works at the source's 6.5 MHz (ch. 10). A 28-bit result is two
registers: reading the upper one latches the lower, and its top bits say that the tank stood still (watchdog) or rang
too weakly or too hard (amplitude).

What a tank loses shows in how high it rings. The drive is a constant current, so the amplitude is V = (4 / pi) I R with
R the tank's resistance at resonance, of the coil and of what is round the pipe in parallel: G = 1 / R - 1 / R_coil,
and as a capacitance, G / omega.
"""

import math
from dataclasses import dataclass

from annulus_pipe.sensors.i2c import Bus, I2cChip, I2cError

CHANNELS = ("c1_pf", "c2_pf", "c3_pf", "cref_pf")
LOSSES = ("loss1_ff", "loss2_ff", "loss3_ff")
DATA, RCOUNT, SETTLE, DIVIDERS, STATUS, CONFIG, MUX, DRIVE = 0x00, 0x08, 0x10, 0x14, 0x18, 0x1A, 0x1B, 0x1E
IDENTITY = {0x7E: 0x5449, 0x7F: 0x3055}
WATCHDOG, AMPLITUDE = 0x2000, 0x1000  # top bits of a result's upper register
AT_RESET = 0x2801  # of CONFIG: asleep; what it holds after a brown-out, and never as set here
AWAKE = 0x1681  # external clock, full current while it starts, interrupt pin off; the fixed bits as they have to be
FOUR_IN_TURN = 0xC20D  # autoscan of channels 0 to 3, noise filter at 10 MHz
FULL = 1 << 28


@dataclass(frozen=True, slots=True)
class Tank:
    """inductance_uh and fixed_pf : soldered beside a sector, so that it rings near 6.5 MHz. clock_mhz : of the chip.

    drive : 0 to 31, of the current (16 uA to 1.6 mA, about e^(0.15 n)). coil_kohm : the tank's resistance in air.
    """

    inductance_uh: float = 18.0
    fixed_pf: float = 28.5
    clock_mhz: float = 40.0
    drive: int = 19
    drive_ma: float = 0.264
    coil_kohm: float = 4.5
    count: int = 0x2000  # of clocks / 16 a result: 3.3 ms
    settle: int = 0x0080

    def capacitance_pf(self, data: int) -> float:
        """Of the sector alone."""
        hertz = 2 * 1e6 * self.clock_mhz * data / FULL  # FIN_SEL 2: the sensor's frequency is halved first
        return 1e12 / (1e-6 * self.inductance_uh * (2 * math.pi * hertz) ** 2) - self.fixed_pf

    def data(self, sector_pf: float) -> int:
        """What the chip counts of so much; for the twin."""
        total = 1e-12 * (self.fixed_pf + sector_pf)
        hertz = 1 / (2 * math.pi * math.sqrt(1e-6 * self.inductance_uh * total))
        return round(hertz / (2e6 * self.clock_mhz) * FULL)

    def loss_ff(self, amplitude_v: float, sector_pf: float) -> float:
        """G / omega of what is round the pipe."""
        if not amplitude_v > 0:
            return math.nan
        siemens = 4 / math.pi * 1e-3 * self.drive_ma / amplitude_v - 1e-3 / self.coil_kohm
        omega = 1 / math.sqrt(1e-18 * self.inductance_uh * (self.fixed_pf + sector_pf))
        return 1e15 * siemens / omega

    def amplitude_v(self, loss_ff: float, sector_pf: float) -> float:
        """The other way round; for the twin."""
        omega = 1 / math.sqrt(1e-18 * self.inductance_uh * (self.fixed_pf + sector_pf))
        return 4 / math.pi * 1e-3 * self.drive_ma / (1e-15 * loss_ff * omega + 1e-3 / self.coil_kohm)


TANK = Tank()


class Fdc2214(I2cChip):
    """`adc` reads the tanks' rectified amplitudes, where there is one."""

    def __init__(
        self, bus: Bus, address: int = 0x2A, tank: Tank = TANK, adc: "Ads1115 | None" = None, name: str = "capacitance"
    ) -> None:
        super().__init__(bus, address)
        self.name, self._tank, self._adc = name, tank, adc

    def set_up(self) -> None:
        self.identify(IDENTITY)
        self.write(CONFIG, AT_RESET)  # settings are taken while it sleeps
        for k in range(len(CHANNELS)):
            self.set(RCOUNT + k, self._tank.count)
            self.set(SETTLE + k, self._tank.settle)
            self.set(DIVIDERS + k, 0x2001)  # FIN_SEL 2, clock undivided
            self.set(DRIVE + k, self._tank.drive << 11)
        self.set(MUX, FOUR_IN_TURN)
        self.set(CONFIG, AWAKE)
        if self._adc is not None:
            self._adc.set_up()

    def values(self) -> tuple[dict[str, float], dict[str, str]]:
        if self.read(CONFIG) == AT_RESET:
            self.faults["brown-out"] += 1
            self.set_up()
        numbers = {name: self._channel(k) for k, name in enumerate(CHANNELS)}
        units = dict.fromkeys(CHANNELS, "pF")
        if self._adc is not None:
            for k, name in enumerate(LOSSES):
                c = numbers[CHANNELS[k]]
                numbers[name] = self._tank.loss_ff(self._adc.volts(k), c) if math.isfinite(c) else math.nan
                units[name] = "fF"
        return numbers, units

    def _channel(self, k: int) -> float:
        upper = self.read(DATA + 2 * k)
        lower = self.read(DATA + 2 * k + 1)  # latched by the upper
        for bit, why in ((WATCHDOG, "tank stands still"), (AMPLITUDE, "tank's amplitude out of range")):
            if upper & bit:
                self.faults[why] += 1
        data = (upper & 0x0FFF) << 16 | lower
        if upper & (WATCHDOG | AMPLITUDE) or data == 0:
            return math.nan
        return self._tank.capacitance_pf(data)


class Ads1115(I2cChip):
    """ADC of the tanks' amplitudes: one reading a call, +-2.048 V over 16 bits, 475 a second."""

    CONVERSION, CONFIG = 0x00, 0x01
    SINGLE = 0x85C3  # start, one shot, 2.048 V, 475 a second, comparator off; the input's bits are added
    DONE, LOOKS = 0x8000, 50

    def __init__(self, bus: Bus, address: int = 0x48, name: str = "amplitude") -> None:
        super().__init__(bus, address)
        self.name = name

    def set_up(self) -> None:
        self.write(self.CONFIG, self.SINGLE & 0x7FFF)  # told, and not started
        found = self.read(self.CONFIG) & 0x7FFF
        if found != self.SINGLE & 0x7FFF:
            raise I2cError(f"{self}: register 0x01 reads 0x{found:04x}, expected 0x{self.SINGLE & 0x7FFF:04x}")

    def volts(self, channel: int) -> float:
        """Against ground; NaN where it is not done after as many looks as it needs ten times over."""
        self.write(self.CONFIG, self.SINGLE | (4 + channel) << 12)
        for _ in range(self.LOOKS):
            if self.read(self.CONFIG) & self.DONE:
                raw = self.read(self.CONVERSION)
                return (raw - (raw >> 15 << 16)) * 2.048 / 32768
        self.faults["not done"] += 1
        return math.nan
