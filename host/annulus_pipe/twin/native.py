"""The controller's own C code on a simulated board, in virtual time: firmware/native through ctypes."""

import ctypes
from pathlib import Path
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from annulus_pipe.shipped import NATIVE, shipped
from annulus_pipe.untrusted import one_line
from annulus_pipe.vocabulary import AnnulusError

BYTE_TICKS = 1000  # 1 Mbaud, ten bits a byte

TRANSITION = np.dtype(
    {"names": ["tick", "pin", "level"], "formats": ["<u8", "u1", "u1"], "offsets": [0, 8, 9], "itemsize": 16}
)
"""One change of an output pin, at a world tick of 10 ns."""

_SIGNATURES: dict[str, tuple[object, tuple[object, ...]]] = {
    "native_begin": (None, ()),
    "native_power_on": (None, (ctypes.c_uint8, ctypes.c_uint8)),
    "native_input": (ctypes.c_bool, (ctypes.c_uint64, ctypes.c_uint8, ctypes.c_uint8)),
    "native_wire": (None, (ctypes.c_uint8, ctypes.c_uint8)),
    "native_pull": (None, (ctypes.c_uint8, ctypes.c_uint8)),
    "native_serial_write": (ctypes.c_size_t, (ctypes.c_char_p, ctypes.c_size_t)),
    "native_serial_read": (ctypes.c_size_t, (ctypes.c_void_p, ctypes.c_size_t)),
    "native_seed": (None, (ctypes.c_uint32,)),
    "native_run_until": (None, (ctypes.c_uint64,)),
    "native_tick": (ctypes.c_uint64, ()),
    "native_boot_tick": (ctypes.c_uint64, ()),
    "native_pins": (ctypes.c_size_t, (ctypes.c_void_p, ctypes.c_size_t)),
    "native_pin": (ctypes.c_uint8, (ctypes.c_uint8,)),
    "native_stall_cpu": (None, (ctypes.c_uint64,)),
    "native_lost": (None, (ctypes.c_void_p,)),
}


def _load(path: Path) -> ctypes.CDLL:
    if not path.is_file():
        raise AnnulusError(f"{path}: the native firmware is not built. `make setup` builds it.")
    try:
        library = ctypes.CDLL(str(path))
    except OSError as error:
        raise AnnulusError(
            f"{path}: cannot be loaded here ({one_line(str(error))}). Is it of this machine's kind?"
        ) from None
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


class NativeBoard:
    """The one simulated board of this process, in virtual time. A new object begins a new world at tick 0.

    Times are world ticks of 10 ns; the controller counts its own from its last reset (`boot_tick`). Nothing happens but
    in `run_until`. Making a second board takes the first one's place: its methods then raise AnnulusError.

    Example::

        board = NativeBoard()
        board.power_on(boot=1)
        board.input(tick=50_000_000, pin=PIN_SYNC, level=0)
        board.serial_write(frame)
        board.run_until(60_000_000)
        answer, pins = board.serial_read(), board.pins()
    """

    _current: ClassVar["NativeBoard | None"] = None

    def __init__(self, library: Path | None = None) -> None:
        self._c = _load(library or shipped(NATIVE))
        NativeBoard._current = self
        self._c.native_begin()
        self._boot = 0
        self._wires: tuple[tuple[int, int], ...] = ()
        self._bytes = ctypes.create_string_buffer(65536)
        self._pins = np.zeros(16384, TRANSITION)
        self._pins_at = self._pins.ctypes.data

    def _live(self) -> ctypes.CDLL:
        if NativeBoard._current is not self:
            raise AnnulusError("native board: another one was made in this process, which holds only one")
        return self._c

    def power_on(self, boot: int = 1, cause: int = 0) -> None:
        """Power comes on, or comes back: the controller restarts with this boot byte and BootCause."""
        self._boot = boot & 0xFF
        self._live().native_power_on(self._boot, cause)

    def input(self, tick: int, pin: int, level: int) -> None:
        """Schedule a level on an input pin at a world tick, not before now.

        Raises
        ------
        AnnulusError : a tick in the past, no input pin, or more than 65536 waiting.
        """
        if not self._live().native_input(tick, pin, level):
            raise AnnulusError(f"native board: input GP{pin} = {level} at tick {tick} refused, now is {self.tick}")

    def wire(self, *wires: tuple[int, int]) -> None:
        """Jumpers from an output pin to an input each, in place of those before. What is let go is pulled up."""
        for output, _ in self._wires:
            self._live().native_wire(output, 0)
        for _, pin in self._wires:
            self.input(self.tick, pin, 1)
        self._wires = wires
        for output, pin in wires:
            self._live().native_wire(output, pin)

    def pull(self, *pulls: tuple[int, int]) -> None:
        """Resistors outside: (output, level) that its pad shows while nobody drives it."""
        for pin, level in pulls:
            self._live().native_pull(pin, level)

    def serial_write(self, data: bytes) -> int:
        """Send bytes to the controller at line speed, from now on; how many were taken."""
        return int(self._live().native_serial_write(data, len(data)))

    def serial_read(self) -> bytes:
        """All bytes that have arrived from the controller by now, at most 65536 at a time."""
        size = self._live().native_serial_read(self._bytes, len(self._bytes))
        return ctypes.string_at(self._bytes, size) if size else b""

    def seed(self, seed: int) -> None:
        """From now on the main loop's calls take times drawn from this; a new board's from 0."""
        self._live().native_seed(seed)

    def run_until(self, tick: int) -> None:
        """Let the world go on to this tick; one already past does nothing."""
        self._live().native_run_until(tick)

    @property
    def tick(self) -> int:
        """World tick now."""
        return int(self._live().native_tick())

    @property
    def boot(self) -> int:
        """Boot byte the last `power_on` gave; a restart by itself counts on from it, unseen here."""
        return self._boot

    @property
    def boot_tick(self) -> int:
        """World tick of the controller's last reset, by whatever cause."""
        return int(self._live().native_boot_tick())

    def pins(self) -> npt.NDArray[np.void]:
        """Transitions of output pins since the last call, oldest first: structured array of TRANSITION."""
        library = self._live()
        parts = []
        while size := library.native_pins(self._pins_at, len(self._pins)):
            parts.append(self._pins[:size].copy())
            if size < len(self._pins):
                break
        return np.concatenate(parts) if len(parts) > 1 else parts[0] if parts else self._pins[:0].copy()

    def level(self, pin: int) -> int:
        """Level of any pin now."""
        return int(self._live().native_pin(pin))

    def stall_cpu(self, ticks: int) -> None:
        """The controller's main loop stands still for so long; hardware goes on, the watchdog bites after 100 ms."""
        self._live().native_stall_cpu(ticks)

    def lost(self) -> dict[str, int]:
        """What the simulation itself had to drop because nobody drained it; all zero in a sound set-up."""
        counts = (ctypes.c_uint64 * 4)()
        self._live().native_lost(counts)
        return dict(zip(("transitions", "received", "sent", "inputs"), map(int, counts), strict=True))

    def close(self) -> None:
        """Nothing to end."""
