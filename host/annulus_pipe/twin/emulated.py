"""The controller's shipped image on an emulated RP2040, in virtual time: tools/emulator as a child process, with the
verbs of the native board, so that whatever runs on the one runs on the other.

    with EmulatedBoard() as board:              # powered on; about 25 ms until it answers
        board.input(tick=50_000_000, pin=PIN_SYNC, level=0)
        board.run_until(60_000_000)
        answer, pins = board.serial_read(), board.pins()

What differs from `NativeBoard`: there may be many; the boot byte is the image's own choice; a restart takes 25 ms of
boot ROM and loader until the controller counts; and a run ends with an instruction, so an input given for the very
next ticks may come up to a tenth of a microsecond late.
"""

import json
import os
import shutil
import subprocess
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
import numpy.typing as npt

from annulus_pipe.controller import INPUT_PINS
from annulus_pipe.link.codec import Decoder, Frame
from annulus_pipe.link.messages import Event
from annulus_pipe.shipped import EMULATOR, IMAGE, of_checkout, shipped
from annulus_pipe.twin.native import TRANSITION, NativeBoard
from annulus_pipe.vocabulary import AnnulusError

BOARDS = ("native", "emulated")

_BOOT_TICKS = 3_000_000  # boot ROM, loader, clocks, first event


class VirtualBoard(Protocol):
    """What the twin needs of a controller in virtual time; see NativeBoard."""

    def power_on(self, boot: int = 1, cause: int = 0) -> None: ...

    def input(self, tick: int, pin: int, level: int) -> None: ...

    def wire(self, *wires: tuple[int, int]) -> None: ...

    def pull(self, *pulls: tuple[int, int]) -> None: ...

    def serial_write(self, data: bytes) -> int: ...

    def serial_read(self) -> bytes: ...

    def run_until(self, tick: int) -> None: ...

    @property
    def tick(self) -> int: ...

    @property
    def boot(self) -> int: ...

    @property
    def boot_tick(self) -> int: ...

    def pins(self) -> npt.NDArray[np.void]: ...

    def level(self, pin: int) -> int: ...

    def stall_cpu(self, ticks: int) -> None: ...

    def lost(self) -> dict[str, int]: ...

    def close(self) -> None: ...


def open_board(kind: str) -> VirtualBoard:
    """A board of this process in virtual time, not yet powered. AnnulusError for a kind that is none of BOARDS."""
    if kind not in BOARDS:
        raise AnnulusError(f"board {kind!r}: expected one of {', '.join(BOARDS)}")
    return NativeBoard() if kind == "native" else EmulatedBoard()


class EmulatedBoard:
    """World ticks of 10 ns since its power came on."""

    def __init__(self, image: Path | None = None, *, vcd: Path | None = None) -> None:
        """Start the emulator, with the image that comes with annulus if none is named.

        AnnulusError when the image, node or the emulator's packages are missing, and outside a checkout.
        """
        emulator = of_checkout(EMULATOR)
        node = shutil.which("node")
        if node is None:
            raise AnnulusError("node: not found, expected Debian's nodejs to run the emulated board")
        image = image or shipped(IMAGE)
        if not image.is_file():
            raise AnnulusError(f"{image}: the image is not built. `make firmware` builds it.")
        if not (emulator.parent / "node_modules/rp2040js").is_dir():
            raise AnnulusError(f"{emulator.parent}: the emulator is not set up. `make emulator` does it.")
        command = [node, str(emulator), str(image), "--drive", *(["--vcd", str(vcd)] if vcd else [])]
        # a session of its own: Ctrl-C is for whoever uses the board, whose end of the pipe ends this one
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True, text=True
        )
        self._tick = self._now = 0  # asked for, and where the last instruction ended
        self._levels = dict.fromkeys(INPUT_PINS, 1)
        self._waiting: list[tuple[int, int, int]] = []
        self._to_board = bytearray()
        self._from_board = bytearray()
        self._decoder = Decoder()
        self._transitions: list[tuple[int, int, int]] = []
        self._stall = 0
        self._overruns = 0
        self._boot, self._boot_tick = -1, 0
        self._powered = False

    def power_on(self, boot: int = 1, cause: int = 0) -> None:
        """The first time: until it answers. After that a reset as by the watchdog. `boot` and `cause` are its own."""
        if self._powered:
            self._do({"op": "reset"})
            return
        self._powered = True
        self.run_until(self._tick + _BOOT_TICKS)

    def input(self, tick: int, pin: int, level: int) -> None:
        """Schedule a level on an input pin at a world tick, not before now. AnnulusError for a tick in the past."""
        if tick < self._tick or pin not in INPUT_PINS or level not in (0, 1):
            raise AnnulusError(f"emulated board: input GP{pin} = {level} at tick {tick} refused, now is {self._tick}")
        self._waiting.append((max(tick, self._now), pin, level))

    def wire(self, *wires: tuple[int, int]) -> None:
        """Jumpers from an output pin to an input each, in place of those before. What is let go is pulled."""
        self._do({"op": "wires", "wires": wires})

    def pull(self, *pulls: tuple[int, int]) -> None:
        """Resistors outside: (output, level) that its pad shows while nobody drives it."""
        self._do({"op": "pulls", "pulls": pulls})

    def serial_write(self, data: bytes) -> int:
        """Send bytes to the controller's UART at line speed, from now on; all are taken."""
        self._to_board += data
        return len(data)

    def serial_read(self) -> bytes:
        """All bytes that have arrived from the controller's UART by now."""
        data = bytes(self._from_board)
        self._from_board.clear()
        return data

    def run_until(self, tick: int) -> None:
        """Let the world go on to this tick; one already past does nothing. AnnulusError where silicon would have
        hung or worse.
        """
        if tick <= self._tick:
            return
        if self._stall:
            self._do({"op": "stall", "ticks": self._stall})
            self._stall = 0
        op = {"op": "run", "until": tick, "edges": self._waiting, "hex": self._to_board.hex()}
        self._waiting = []
        self._to_board.clear()
        self._do(op)
        self._tick = tick

    @property
    def tick(self) -> int:
        """World tick now."""
        return self._tick

    @property
    def boot(self) -> int:
        """Boot byte of the life whose first event came last; -1 before the first."""
        return self._boot

    @property
    def boot_tick(self) -> int:
        """World tick at which that life began to count its own."""
        return self._boot_tick

    def pins(self) -> npt.NDArray[np.void]:
        """Transitions of output pins since the last call, oldest first: structured array of TRANSITION."""
        drained = np.array(self._transitions, TRANSITION)
        self._transitions = []
        return drained

    def level(self, pin: int) -> int:
        """Level of any pin now."""
        return self._levels.get(pin, 0)

    def hurry(self) -> None:
        """Before most others on this machine, but not all the time: it needs most of a processor. Raises OSError."""
        os.setpriority(os.PRIO_PROCESS, self._process.pid, -10)

    def stall_cpu(self, ticks: int) -> None:
        """The processor stands still for so long, from the next run on; hardware goes on."""
        self._stall = ticks

    def lost(self) -> dict[str, int]:
        """Bytes the UART had no room for; the emulator itself drops nothing."""
        return {"transitions": 0, "received": self._overruns, "sent": 0, "inputs": 0}

    def close(self) -> None:
        """End the emulator. Safe to call twice."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.close()
            self._process.wait(5.0)
        except (OSError, subprocess.TimeoutExpired):
            self._process.kill()
            self._process.wait()

    def __enter__(self) -> Self:
        self.power_on()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _do(self, op: dict[str, Any]) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps(op) + "\n")
            self._process.stdin.flush()
            answer = json.loads(self._process.stdout.readline())
        except (OSError, ValueError):
            raise AnnulusError("emulated board: the emulator ended, expected it to run until closed") from None
        if "fault" in answer:
            raise AnnulusError(f"emulated board: {answer['fault']} (tick {answer['now']}, pc {answer['pc']:08x})")
        self._now, self._overruns = answer["now"], answer["overruns"]
        for tick, pin, level in answer["pins"]:
            self._transitions.append((tick, pin, level))
            self._levels[pin] = level
        sent = bytes(byte for _, byte in answer["sent"])
        self._from_board += sent
        for item in self._decoder.feed(sent):
            if isinstance(item, Frame) and isinstance(item.message, Event) and item.boot != self._boot:
                self._boot, self._boot_tick = item.boot, answer["origin"]
