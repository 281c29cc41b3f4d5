"""I2C sensors' path, to the kernel's stub of chips: drivers through smbus2, and what is said when nobody answers.

The stub takes word and byte commands and holds each register's word as it came, so that what a chip would say is put
there the way the bus sends it: low byte first.
"""

import pytest
from machine import Guest

SCRIPT = """
from pathlib import Path
from smbus2 import SMBus
buses = [f for f in Path("/sys/bus/i2c/devices").glob("i2c-*") if "stub" in (f / "name").read_text()]
with SMBus(int(buses[0].name[4:])) as bus:
    bus.write_byte_data(0x68, 0x1C, 0x18)
    bus.write_word_data(0x68, 0x20, 0x1234)
    bus.write_i2c_block_data(0x68, 0x3B, list(range(14)))
    print(len(buses), bus.read_byte_data(0x68, 0x1C), hex(bus.read_word_data(0x68, 0x20)))
    print(bus.read_i2c_block_data(0x68, 0x3B, 14))
    try:
        bus.read_byte_data(0x50, 0)
    except OSError as error:
        print(error.strerror)
"""


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_registers_of_a_stub_are_written_and_read_and_nobody_else_answers(guest: Guest) -> None:
    guest.modprobe("i2c-dev")
    guest.modprobe("i2c-stub", "chip_addr=0x68")
    done = guest.python(SCRIPT)
    assert done.status == 0, done.stderr
    assert done.stdout.splitlines() == ["1 24 0x1234", str(list(range(14))), "No such device"]


DRIVERS = """
import errno
from pathlib import Path
from annulus_pipe.sensors.fdc2214 import Ads1115, Fdc2214, Tank
from annulus_pipe.sensors.i2c import I2cError, I2cSensors, open_bus
from annulus_pipe.sensors.imu import Mpu6050
from annulus_pipe.sensors.ina226 import Ina226

buses = [f for f in Path("/sys/bus/i2c/devices").glob("i2c-*") if "stub" in (f / "name").read_text()]
bus = open_bus(int(buses[-1].name[4:]))
put = lambda chip, register, word: bus.write_word_data(chip, register, word >> 8 & 0xFF | (word & 0xFF) << 8)
tank = Tank()
for register, word in ((0x7E, 0x5449), (0x7F, 0x3055)):
    put(0x2A, register, word)
for k, pf in enumerate((4.8, 4.85, 4.57, 4.7)):
    put(0x2A, 2 * k, tank.data(pf) >> 16)
    put(0x2A, 2 * k + 1, tank.data(pf) & 0xFFFF)
put(0x48, 0, round(tank.amplitude_v(20.0, 4.8) / 2.048 * 32768))
for register, word in ((0xFE, 0x5449), (0xFF, 0x2260), (1, 3200), (2, 4016)):
    put(0x40, register, word)
bus.write_byte_data(0x68, 0x75, 0x68)
for k, count in enumerate((-4096, -7094, 0, round((21.0 - 36.53) * 340))):
    put(0x68, 0x3B + 2 * k, count & 0xFFFF)
readers = [Fdc2214(bus, adc=Ads1115(bus)), Ina226(bus), Mpu6050(bus)]
sensors = I2cSensors("head", bus, readers, 0.05)
sensors.step(0.0, 1)
for sample in sensors.poll():
    print(sample.sensor, {k: round(v, 3) for k, v in sample.values.items()})
try:
    Ina226(bus, 0x41).set_up()
except I2cError as error:
    print(error)
put(0x40, 0, 0x4127)  # its supply was away
sensors.step(0.1, 2)
print(readers[1].faults["brown-out"], [sample.sensor for sample in sensors.poll()])
put(0x2A, 0x7F, 0x3054)
put(0x2A, 0x1A, 0x2801)
sensors.step(0.2, 3)
print([sample.sensor for sample in sensors.poll()])
sensors.step(0.3, 4)
sensors.poll()
try:
    sensors.poll()
except I2cError as error:
    print(error)
"""


@pytest.mark.deep(gate="tests/guest/test_usb.py::test_our_host_configures_arms_and_fires_through_cdc_acm")
def test_drivers_read_their_chips_and_say_what_is_wrong(guest: Guest) -> None:
    guest.modprobe("i2c-dev")
    guest.run(["modprobe", "-r", "i2c-stub"])  # another test's, with another's addresses
    guest.modprobe("i2c-stub", "chip_addr=0x2a,0x40,0x48,0x68")
    done = guest.python(DRIVERS)
    assert done.status == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("capacitance {'c1_pf': 4.8, 'c2_pf': 4.85, 'c3_pf': 4.57, 'cref_pf': 4.7, 'loss1_ff': ")
    assert lines[1].startswith("supply {'voltage_v': 5.02, 'current_a': 0.8, ")
    assert lines[2].startswith("imu {'roll_deg': 30.0") and "'temperature_c': 21.0" in lines[2]
    assert lines[3] == "supply at 0x41: register 0xfe is not answered (No such device), 3 times"
    assert lines[4] == "1 ['capacitance', 'supply', 'imu']"
    assert lines[5] == "['supply', 'imu']"
    assert lines[6] == "capacitance at 0x2a: register 0x7f is 0x3054, expected 0x3055: another chip"
