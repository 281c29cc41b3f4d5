"""The two boards an attack runs on, behind one face: the native one in this process, the shipped image in another.

Ticks are the world's, 10 ns. `origin` is the tick at which the controller began to count its own.
"""

import ctypes
import json
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from annulus_pipe.controller import TICKS_PER_US
from annulus_pipe.shipped import IMAGE, shipped
from annulus_pipe.twin.native import NativeBoard

US = TICKS_PER_US
MS = 1000 * US
ROOT = Path(__file__).resolve().parents[2]
UART, USB = 0, 1
BOOTED = 30 * MS  # boot ROM, loader, clocks, first event
Edge = tuple[int, int, int]  # tick, pin, level


class BrokenPromiseError(Exception):
    """An invariant does not hold."""


def insist(holds: bool, what: str, tick: int | None = None) -> None:
    if not holds:
        raise BrokenPromiseError(what if tick is None else f"{what} (tick {tick})")


@dataclass(slots=True)
class Heard:
    """What a board did since the last look."""

    transitions: list[Edge] = field(default_factory=list)
    lines: tuple[bytes, bytes] = (b"", b"")


class Board(Protocol):
    """Nothing happens but in `run`."""

    name: str
    now: int
    latency: int  # falling edge to lamp, beyond the loaded delay
    stamp: int  # an edge's stamp is right, or late by at most this
    round_max: int  # ticks; budget of the main loop's longest round
    longest: int  # seen so far; 0 where it cannot be told

    @property
    def origin(self) -> int: ...
    def run(self, until: int) -> Heard: ...
    def input(self, edges: list[Edge]) -> None: ...
    def write(self, line: int, data: bytes) -> None: ...
    def plug(self, plugged: bool) -> None: ...
    def connected(self) -> bool: ...
    def stall(self, ticks: int) -> None: ...
    def pull_up(self, pins: list[int]) -> None: ...
    def erase_takes(self, ticks: int) -> None: ...
    def close(self) -> None: ...


class Native:
    """firmware/native; `library` may be that of another revision."""

    name, latency, stamp, round_max, longest = "native", 0, 0, MS // 5, 0

    def __init__(self, seed: int, library: Path | None = None) -> None:
        self._board = NativeBoard(library) if library else NativeBoard()
        self._c = self._board._live()
        if hasattr(self._c, "native_seed"):
            self._c.native_seed(ctypes.c_uint32(seed))
        self._usb = ctypes.create_string_buffer(65536)
        self._plugged = False
        self._board.power_on(boot=1)
        self.now = 0

    @property
    def origin(self) -> int:
        return self._board.boot_tick

    def run(self, until: int) -> Heard:
        self._board.run_until(until)
        self.now = until
        size = self._c.native_usb_read(self._usb, ctypes.c_size_t(65536))
        pins = self._board.pins()
        changes = list(zip(pins["tick"].tolist(), pins["pin"].tolist(), pins["level"].tolist(), strict=True))
        return Heard(changes, (self._board.serial_read(), self._usb.raw[:size] if size else b""))

    def input(self, edges: list[Edge]) -> None:
        for tick, pin, level in edges:
            self._board.input(tick, pin, level)

    def write(self, line: int, data: bytes) -> None:
        if line == UART:
            self._board.serial_write(data)
        else:
            self._c.native_usb_write(data, ctypes.c_size_t(len(data)))

    def plug(self, plugged: bool) -> None:
        self._c.native_usb_connect(ctypes.c_bool(plugged))
        self._plugged = plugged

    def connected(self) -> bool:
        return self._plugged

    def stall(self, ticks: int) -> None:
        self._board.stall_cpu(ticks)

    def pull_up(self, pins: list[int]) -> None:
        self._board.pull(*((pin, 1) for pin in pins))

    def erase_takes(self, ticks: int) -> None:
        """It has no flash."""

    def close(self) -> None:
        pass


class Emulated:
    """The shipped image on tools/emulator."""

    name, latency, stamp, round_max = "emulated", 9, 1, MS // 2

    def __init__(self, image: Path | None = None) -> None:
        command = ["node", str(ROOT / "tools/emulator/emulate.mjs"), str(image or shipped(IMAGE))]
        self._process = subprocess.Popen(
            [*command, "--drive"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.now = self._origin = self.longest = 0
        self._open = False
        self._held = Heard()
        self._do(op="run", until=BOOTED)  # what was heard waits for the first look

    def _do(self, **op: object) -> None:
        assert self._process.stdin
        assert self._process.stdout
        self._process.stdin.write(json.dumps(op) + "\n")
        self._process.stdin.flush()
        answer = json.loads(self._process.stdout.readline() or '{"fault": "the emulator ended", "now": 0}')
        if "fault" in answer:
            raise BrokenPromiseError(
                f"the image did what silicon does not forgive: {answer['fault']}, tick {answer['now']}"
            )
        self.now, self._origin = answer["now"], answer["origin"]
        self.longest = max(self.longest, answer.get("round", [0])[0])
        usb = answer["usb"]
        self._open = bool(usb and usb["open"])
        self._held.transitions += [(tick, pin, level) for tick, pin, level in answer["pins"]]
        uart = bytes(byte for _, byte in answer["sent"])
        over_usb = bytes.fromhex(usb["received"]) if usb else b""
        self._held.lines = (self._held.lines[0] + uart, self._held.lines[1] + over_usb)

    @property
    def origin(self) -> int:
        return self._origin

    def run(self, until: int) -> Heard:
        self._do(op="run", until=until)
        heard, self._held = self._held, Heard()
        return heard

    def input(self, edges: list[Edge]) -> None:
        self._do(op="input", edges=edges)

    def write(self, line: int, data: bytes) -> None:
        if line == UART:
            self._do(op="write", hex=data.hex())
        else:
            self._do(op="usb", do="write", hex=data.hex())

    def power_cycle(self) -> None:
        """Off and on again; what was wired to it stays as it is."""
        self._do(op="power-cycle")

    def plug(self, plugged: bool) -> None:
        self._do(op="usb", do="attach" if plugged else "detach")

    def connected(self) -> bool:
        return self._open

    def stall(self, ticks: int) -> None:
        self._do(op="stall", ticks=ticks)

    def pull_up(self, pins: list[int]) -> None:
        self._do(op="pulls", pulls=[[pin, 1] for pin in pins])

    def erase_takes(self, ticks: int) -> None:
        self._do(op="flash", erase_ticks=ticks)

    def close(self) -> None:
        assert self._process.stdin
        self._process.stdin.close()
        self._process.wait(10)
