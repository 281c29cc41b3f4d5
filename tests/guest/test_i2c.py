"""An I2C sensor's path, to the kernel's stub of one: the bus is found by name, registers are written and read."""

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


def test_registers_of_a_stub_are_written_and_read_and_nobody_else_answers(guest: Guest) -> None:
    guest.modprobe("i2c-dev")
    guest.modprobe("i2c-stub", "chip_addr=0x68")
    done = guest.python(SCRIPT)
    assert done.status == 0, done.stderr
    assert done.stdout.splitlines() == ["1 24 0x1234", str(list(range(14))), "No such device"]
