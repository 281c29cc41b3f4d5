"""Chips of a head's I2C bus on the level of their registers, with the faults of a real bus; the twin's `Bus`.

Words come as SMBus sends them, low byte first, from registers that hold the high byte first: a driver that forgets to
swap reads nonsense here, as it would on a head.
"""

import errno
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from annulus_pipe.sensors.fdc2214 import AT_RESET as FDC_AT_RESET
from annulus_pipe.sensors.fdc2214 import CHANNELS, LOSSES, Tank
from annulus_pipe.sensors.imu import G_M_S2
from annulus_pipe.sensors.ina226 import AT_RESET as INA_AT_RESET
from annulus_pipe.sensors.remote import RemoteSensors

TRANSFER_S = 1e-4  # of a word at 400 kHz


@dataclass(slots=True)
class SimulatedChip:
    """Registers by address; `reset` is what they hold after power came. on_read and on_write may compute."""

    reset: dict[int, int]
    on_read: Callable[[int, dict[int, int]], None] = lambda register, held: None
    on_write: Callable[[int, dict[int, int]], None] = lambda register, held: None
    bytes_wide: bool = False  # registers of 8 bits, words of two neighbours
    held: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.brown_out()

    def brown_out(self) -> None:
        self.held = dict(self.reset)

    def word(self, register: int) -> int:
        self.on_read(register, self.held)
        if self.bytes_wide:
            return self.held.get(register, 0) | self.held.get(register + 1, 0) << 8
        value = self.held.get(register, 0)
        return value >> 8 | (value & 0xFF) << 8


class TwinBus:
    """Chips by address. `faults` : transfers from now on that fail, by what they raise; `stuck` fails all."""

    def __init__(self, chips: dict[int, SimulatedChip]) -> None:
        self.chips = chips
        self.faults: list[int] = []  # errno
        self.stuck = self.closed = False
        self.transfers = 0

    def read_word_data(self, address: int, register: int) -> int:
        return self._chip(address).word(register)

    def write_word_data(self, address: int, register: int, value: int) -> None:
        chip = self._chip(address)
        chip.held[register] = value >> 8 | (value & 0xFF) << 8
        chip.on_write(register, chip.held)

    def read_byte_data(self, address: int, register: int) -> int:
        chip = self._chip(address)
        chip.on_read(register, chip.held)
        return chip.held.get(register, 0) & 0xFF

    def write_byte_data(self, address: int, register: int, value: int) -> None:
        chip = self._chip(address)
        chip.held[register] = value & 0xFF
        chip.on_write(register, chip.held)

    def close(self) -> None:
        self.closed = True

    def _chip(self, address: int) -> SimulatedChip:
        self.transfers += 1
        if self.stuck:
            raise OSError(errno.ETIMEDOUT, "Connection timed out")
        if self.faults:
            raise OSError(self.faults.pop(0), "Remote I/O error")
        if address not in self.chips:
            raise OSError(errno.ENXIO, "No such device or address")
        return self.chips[address]


class HeadBus(TwinBus):
    """A running head's chips: what its sensors say over ZeroMQ is what they hold. A transfer takes a bus's time.

    address : of the head's samples. Chips: fdc2214 at 0x2a with an ads1115 at 0x48, ina226 at 0x40, mpu6050 at 0x68.
    """

    def __init__(self, address: str, tank: Tank, shunt_mohm: float) -> None:
        nan = float("nan")
        self._plays = dict.fromkeys((*CHANNELS, *LOSSES), nan) | {
            "voltage_v": 5.0,
            "current_a": 0.0,
            "x_g": 0.0,
            "y_g": -1.0,
            "z_g": 0.0,
            "temperature_c": 20.0,
        }
        plays = self._plays
        super().__init__(
            {
                0x2A: fdc2214(plays, tank),
                0x48: ads1115(plays, tank),
                0x40: ina226(plays, shunt_mohm),
                0x68: mpu6050(plays),
            }
        )
        self._head = RemoteSensors(address)

    def close(self) -> None:
        super().close()
        self._head.close()

    def _chip(self, address: int) -> SimulatedChip:
        for sample in self._head.poll():
            self._plays.update({name: value for name, value in sample.values.items() if name in self._plays})
            self._plays.update(
                {
                    f"{axis}_g": sample.values[f"{axis}_m_s2"] / G_M_S2
                    for axis in "xyz"
                    if f"{axis}_m_s2" in sample.values
                }
            )
        time.sleep(TRANSFER_S)
        return super()._chip(address)


def fdc2214(plays: dict[str, float], tank: Tank) -> SimulatedChip:
    """plays : c1_pf .. cref_pf, NaN where a tank stands still. Reading a result's upper half latches its lower."""

    def on_read(register: int, held: dict[int, int]) -> None:
        if register in (0, 2, 4, 6):
            pf = plays[CHANNELS[register // 2]]
            data = 0 if pf != pf else tank.data(pf)
            held[register] = data >> 16 | (0x2000 if pf != pf else 0)
            held[register + 1] = data & 0xFFFF

    return SimulatedChip({0x1A: FDC_AT_RESET, 0x1B: 0x020F, 0x7E: 0x5449, 0x7F: 0x3055}, on_read)


def ads1115(plays: dict[str, float], tank: Tank) -> SimulatedChip:
    """The amplitudes of the same tanks; plays : loss1_ff .. and c1_pf ..; a conversion is done when it is looked at."""

    def on_write(register: int, held: dict[int, int]) -> None:
        if register == 1 and held[1] & 0x8000:
            k = (held[1] >> 12 & 7) - 4
            volts = tank.amplitude_v(plays[LOSSES[k]], plays[CHANNELS[k]])
            held[0] = round(volts / 2.048 * 32768) & 0xFFFF

    return SimulatedChip({1: 0x8583}, on_write=on_write)


def ina226(plays: dict[str, float], shunt_mohm: float) -> SimulatedChip:
    """plays : voltage_v, current_a."""

    def on_read(register: int, held: dict[int, int]) -> None:
        held[1] = round(plays["current_a"] * shunt_mohm / 2.5e-3) & 0xFFFF
        held[2] = round(plays["voltage_v"] / 1.25e-3) & 0x7FFF

    return SimulatedChip({0x00: INA_AT_RESET, 0xFE: 0x5449, 0xFF: 0x2260}, on_read)


def mpu6050(plays: dict[str, float]) -> SimulatedChip:
    """plays : x_g, y_g, z_g, temperature_c."""

    def on_read(register: int, held: dict[int, int]) -> None:
        counts = [round(plays[f"{axis}_g"] * 8192) for axis in "xyz"] + [round((plays["temperature_c"] - 36.53) * 340)]
        for k, count in enumerate(counts):
            held[0x3B + 2 * k], held[0x3C + 2 * k] = count >> 8 & 0xFF, count & 0xFF

    return SimulatedChip({0x6B: 0x40, 0x75: 0x68}, on_read, bytes_wide=True)
