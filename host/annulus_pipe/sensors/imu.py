"""MPU-6050: the head's roll from gravity, how hard it shakes, temperature. 16-bit registers, high byte first.

The chip lies as the camera looks: x right, y down, z ahead. At rest and level it reads -1 g along y, and its roll is
how far the head is turned clockwise, looking ahead.
"""

import math

from annulus_pipe.sensors.i2c import Bus, I2cChip, I2cError

POWER, FILTER, RANGE, ACCELERATION, TEMPERATURE, WHO = 0x6B, 0x1A, 0x1C, 0x3B, 0x41, 0x75
WHO_AM_I = 0x68
ASLEEP, AWAKE = 0x40, 0x01  # of POWER: what it holds after a brown-out; clocked by a gyroscope
BAND_44_HZ, FOUR_G = 0x03, 0x08
COUNTS_G = 8192.0  # at 4 g
G_M_S2 = 9.80665
SHAKES = 16  # readings over which the shaking is taken
LEAST_G = 0.3  # across the pipe: with less, a head stands on end and has no roll


class Mpu6050(I2cChip):
    def __init__(self, bus: Bus, address: int = 0x68, name: str = "imu") -> None:
        super().__init__(bus, address)
        self.name = name
        self._recent: list[float] = []

    def set_up(self) -> None:
        found = self.read_byte(WHO)
        if found != WHO_AM_I:
            raise I2cError(f"{self}: register 0x{WHO:02x} is 0x{found:02x}, expected 0x{WHO_AM_I:02x}: another chip")
        for register, value in ((POWER, AWAKE), (FILTER, BAND_44_HZ), (RANGE, FOUR_G)):
            self.write_byte(register, value)
            found = self.read_byte(register)
            if found != value:
                raise I2cError(f"{self}: register 0x{register:02x} reads 0x{found:02x} after 0x{value:02x} was written")
        self._recent.clear()

    def values(self) -> tuple[dict[str, float], dict[str, str]]:
        if self.read_byte(POWER) & ASLEEP:
            self.faults["brown-out"] += 1
            self.set_up()
        x, y, z = (_signed(self.read(ACCELERATION + 2 * k)) / COUNTS_G for k in range(3))
        kelvin = _signed(self.read(TEMPERATURE)) / 340.0
        self._recent = [*self._recent[1 - SHAKES :], math.sqrt(x * x + y * y + z * z)]
        mean = sum(self._recent) / len(self._recent)
        shakes = math.sqrt(sum((one - mean) ** 2 for one in self._recent) / len(self._recent)) * G_M_S2
        roll = math.degrees(math.atan2(-x, -y)) if math.hypot(x, y) > LEAST_G else math.nan
        return (
            {"roll_deg": roll, "vibration_m_s2": shakes, "temperature_c": kelvin + 36.53},
            {"roll_deg": "deg", "vibration_m_s2": "m/s^2", "temperature_c": "degC"},
        )


def _signed(word: int) -> int:
    return word - (word >> 15 << 16)
