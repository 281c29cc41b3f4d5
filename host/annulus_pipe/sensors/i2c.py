"""Chips on an I2C bus, through smbus2: words the right way round, retries within a bound, every fault counted.

A chip's 16-bit registers come with the high byte first, an SMBus word with the low one: they are swapped here and
nowhere else. The kernel waits up to a second for a bus that somebody holds down, so a bus is never asked on the
daemon's own loop: `I2cSensors` asks in a thread of its own and `poll` hands out what came.
"""

import contextlib
import math
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from annulus_pipe.sensors.sample import Sample
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError

T = TypeVar("T")
TRIES = 3  # of one transfer: a glitch is over by the next, a chip that is gone is not back
SAMPLES_KEPT = 256
BACK_OFF_S = 1.0  # between two looks at a chip that is gone
NO_DEVICE = "pip install smbus2, or `make setup` in a checkout"


class I2cError(AnnulusError):
    """A chip does not answer, or is another one. `recover` may bring it back."""


class Bus(Protocol):
    """What smbus2.SMBus offers and a chip needs; OSError where nobody answers."""

    def read_word_data(self, address: int, register: int) -> int: ...

    def write_word_data(self, address: int, register: int, value: int) -> None: ...

    def read_byte_data(self, address: int, register: int) -> int: ...

    def write_byte_data(self, address: int, register: int, value: int) -> None: ...

    def close(self) -> None: ...


def bus_number(device: str) -> int:
    """Of /dev/i2c-1, or 1. AnnulusError for anything else."""
    number = device.removeprefix("/dev/i2c-")
    if not (number.isascii() and number.isdigit() and len(number) < 4):
        raise AnnulusError(f"{shown(device)}: no I2C bus, expected /dev/i2c-1 or the like")
    return int(number)


def open_bus(number: int) -> Bus:
    """/dev/i2c-<number>. AnnulusError in one line where it cannot be had."""
    try:
        from smbus2 import SMBus
    except ModuleNotFoundError:
        raise AnnulusError(f"I2C sensors need smbus2: {NO_DEVICE}") from None
    try:
        bus: Bus = SMBus(number)
    except OSError as error:
        raise AnnulusError(
            f"/dev/i2c-{number}: cannot be opened ({error.strerror}), expected an I2C bus of this machine"
        ) from None
    return bus


class I2cChip:
    """One address on a bus. `faults` counts by reason: retried, no answer, brown-out, stale.

    lit : whether the head's lamps flash, head_c : its temperature; for a chip that judges by them.
    """

    name = "chip"

    def __init__(self, bus: Bus, address: int) -> None:
        self.bus, self.address = bus, address
        self.faults: Counter[str] = Counter()
        self.lit = False
        self.head_c = math.nan

    def read(self, register: int) -> int:
        """A 16-bit register."""
        return _swapped(self._try(lambda: self.bus.read_word_data(self.address, register), register))

    def write(self, register: int, value: int) -> None:
        self._try(lambda: self.bus.write_word_data(self.address, register, _swapped(value)), register)

    def read_byte(self, register: int) -> int:
        return self._try(lambda: self.bus.read_byte_data(self.address, register), register)

    def write_byte(self, register: int, value: int) -> None:
        self._try(lambda: self.bus.write_byte_data(self.address, register, value), register)

    def set(self, register: int, value: int) -> None:
        """Written and read back. I2cError where it is not what was written."""
        self.write(register, value)
        found = self.read(register)
        if found != value:
            raise I2cError(f"{self}: register 0x{register:02x} reads 0x{found:04x} after 0x{value:04x} was written")

    def identify(self, expected: Mapping[int, int]) -> None:
        """I2cError where a register of the chip's name holds another."""
        for register, value in expected.items():
            found = self.read(register)
            if found != value:
                raise I2cError(
                    f"{self}: register 0x{register:02x} is 0x{found:04x}, expected 0x{value:04x}: another chip"
                )

    def __str__(self) -> str:
        return f"{self.name} at 0x{self.address:02x}"

    def _try(self, transfer: Callable[[], T], register: int) -> T:
        for tries in range(TRIES):
            try:
                return transfer()
            except OSError as error:
                last = error
                if tries < TRIES - 1:
                    self.faults["retried"] += 1
        self.faults["no answer"] += 1
        raise I2cError(
            f"{self}: register 0x{register:02x} is not answered ({last.strerror or last}), {TRIES} times"
        ) from None


class Reader(Protocol):
    """A driver: set up once, then read; `set_up` again after a brown-out or a loss."""

    name: str
    faults: Counter[str]
    lit: bool
    head_c: float

    def set_up(self) -> None: ...

    def values(self) -> tuple[dict[str, float], dict[str, str]]:
        """Values and their units, NaN where one was not to be had. I2cError where the chip is gone."""


class I2cSensors:
    """A Sensor of the daemon: drivers read in turn, every `period_s`, in a thread of their own.

    A chip that does not answer costs its own samples: it is looked at again after BACK_OFF_S, set up anew, and its
    samples carry how many faults it had. What nobody fetches is dropped, oldest first, and counted in `dropped`.
    """

    def __init__(self, name: str, bus: Bus, readers: Sequence[Reader], period_s: float) -> None:
        self.name = name
        self.dropped = 0
        self.lit = False  # whether the head's lamps flash; whoever lights them says so
        self._head_c = math.nan
        self._bus, self._readers, self._period = bus, list(readers), period_s
        self._samples: deque[Sample] = deque(maxlen=SAMPLES_KEPT)
        self._gone: dict[str, tuple[float, str]] = {}  # by reader: when it is looked at again, why it is gone
        self._reported: set[str] = set()
        self._ready: set[str] = set()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        self._thread = threading.Thread(target=self._run, name=f"i2c {self.name}", daemon=True)
        self._thread.start()

    def step(self, now_s: float, host_ns: int) -> None:
        """One reading of every chip that is not given up for now."""
        for reader in self._readers:
            again, _ = self._gone.get(reader.name, (0.0, ""))
            if now_s < again:
                continue
            reader.lit, reader.head_c = self.lit, self._head_c
            try:
                if reader.name not in self._ready:
                    reader.set_up()
                    self._ready.add(reader.name)
                values, units = reader.values()
            except I2cError as error:
                self._ready.discard(reader.name)
                self._gone[reader.name] = (now_s + BACK_OFF_S, str(error))
                continue
            self._gone.pop(reader.name, None)
            self._reported.discard(reader.name)
            if len(self._samples) == SAMPLES_KEPT:
                self.dropped += 1
            self._head_c = values.get("temperature_c", self._head_c)
            faults = float(sum(reader.faults.values()))
            self._samples.append(Sample(reader.name, host_ns, {**values, "faults": faults}, {**units, "faults": "1"}))

    def poll(self) -> list[Sample]:
        """Samples since the last call. I2cError, once for each loss, where a chip is gone and no samples wait."""
        samples = []
        while self._samples:
            samples.append(self._samples.popleft())
        if not samples:
            for name, (_, why) in list(self._gone.items()):
                if name not in self._reported:
                    self._reported.add(name)
                    raise I2cError(why)
        return samples

    @property
    def faults(self) -> int:
        """Of all its chips, retries and brown-outs too."""
        return sum(sum(reader.faults.values()) for reader in self._readers)

    def close(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join(timeout=2.0)  # the kernel's own wait for a stuck bus is one second
        with contextlib.suppress(OSError):
            self._bus.close()

    def _run(self) -> None:
        due = time.monotonic()
        while not self._stop.wait(max(due - time.monotonic(), 0.0)):
            self.step(time.monotonic(), time.monotonic_ns())
            due = max(due + self._period, time.monotonic())


def _swapped(word: Any) -> int:
    return int(word >> 8 & 0xFF | (word & 0xFF) << 8)
