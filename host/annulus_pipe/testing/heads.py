"""Heads behind a mocked serial port: `head.url` is what any program of this process opens with pyserial.

    with SimulatedHead(camera_fps=25) as head, Client(head.url) as client:
        client.request(Arm(ArmFlag.LAMPS))
        head.run(1.0)
        print(head.rises(PIN_LED))                 # ticks of 10 ns

Time is virtual: it passes while somebody reads the port, or in `run`; a Client measures its own patience in it. So a
test costs what happens in it, and always gives the same pins. `live` is the same head in real time for other processes.
"""

import contextlib
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

from annulus_pipe.controller import PIN_INTERLOCK, PIN_SYNC, TICK_HZ, TICK_NS, TICKS_PER_US
from annulus_pipe.testing.protocol_simulated import publish, withdraw
from annulus_pipe.testing.scripted import BadLine, ScriptedController
from annulus_pipe.twin.emulated import EmulatedBoard, VirtualBoard, open_board
from annulus_pipe.twin.faults import Faults, LossyLine
from annulus_pipe.twin.line import TcpLine
from annulus_pipe.twin.profiles import load_faults

SYNC_LOW_TICKS = 100 * TICKS_PER_US
AHEAD_TICKS = 10_000 * TICKS_PER_US  # camera edges are given to the board so far ahead
LIVE_STEP_S = 0.001


class SimulatedHead:
    """The real firmware: on the native board, or `board="emulated"`, the shipped image on an emulated RP2040; `image`:
    another one than the one built here, `vcd`: a file for all that its pins do.

    Interlock closed, no camera unless `camera_fps`. Of the native board there is one a process: a new head takes the
    place of the one before. `faults` and `seed`: of the line, as twin.faults knows them: events lost, bytes flipped.
    """

    def __init__(
        self,
        board: str = "native",
        *,
        image: Path | None = None,
        vcd: Path | None = None,
        camera_fps: float = 0.0,
        faults: Faults | str | None = None,
        seed: int = 0,
        wires: tuple[tuple[int, int], ...] = (),
    ) -> None:
        chosen = faults if isinstance(faults, Faults) else load_faults(faults)
        self.board: VirtualBoard = EmulatedBoard(image, vcd=vcd) if image or vcd else open_board(board)
        self._to_host = LossyLine(chosen, seed)
        self._to_head = BadLine(seed, chosen.bytes_flipped)
        self._waiting = bytearray()
        self._changes: list[tuple[int, int, int]] = []
        self._edge_ticks = 0
        self._next_edge = 0
        self.board.input(0, PIN_INTERLOCK, 0)
        self.wire(*wires)
        self.board.power_on()
        self.camera(camera_fps)
        self.url = publish(self)

    def camera(self, fps: float) -> None:
        """From now on a frame-sync edge falls this often; 0 ends them."""
        self._edge_ticks = round(TICK_HZ / fps) if fps else 0
        self._next_edge = max(self._next_edge, self.board.tick + max(self._edge_ticks, AHEAD_TICKS))

    def interlock(self, *, is_open: bool) -> None:
        self.board.input(self.board.tick + 1, PIN_INTERLOCK, int(is_open))

    def wire(self, *wires: tuple[int, int]) -> None:
        """Jumpers from an output pin to an input each, in place of those before."""
        self.board.wire(*wires)

    def run(self, seconds: float) -> None:
        """Let time go on. What the head says meanwhile waits at the port."""
        self.pass_ns(round(seconds * 1e9))

    def rises(self, pin: int) -> list[int]:
        """Ticks of 10 ns since the world began, of all rising edges of an output so far."""
        return [tick for tick, p, level in self.changes() if p == pin and level == 1]

    def falls(self, pin: int) -> list[int]:
        return [tick for tick, p, level in self.changes() if p == pin and level == 0]

    def changes(self) -> list[tuple[int, int, int]]:
        """(tick, pin, level) of every change of an output so far."""
        self._changes += [(int(tick), int(pin), int(level)) for tick, pin, level in self.board.pins()]
        return self._changes

    @contextlib.contextmanager
    def live(self) -> Iterator[str]:
        """Serve it in real time; the URL is good for other processes. Nobody else may use the head meanwhile."""
        line = TcpLine()
        done = threading.Event()
        thread = threading.Thread(target=self._serve, args=(line, done), daemon=True)
        thread.start()
        try:
            yield line.url
        finally:
            done.set()
            thread.join()
            line.close()

    def close(self) -> None:
        withdraw(self.url)
        self.board.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # ---- what the simulated port asks ----

    def now_ns(self) -> int:
        return self.board.tick * TICK_NS

    def pass_ns(self, ns: int) -> None:
        end = self.board.tick + max(1, ns // TICK_NS)
        while (now := self.board.tick) < end:
            taken = self.board.serial_write(bytes(self._waiting))
            del self._waiting[:taken]
            while self._edge_ticks and self._next_edge < now + 2 * AHEAD_TICKS:
                self.board.input(self._next_edge, PIN_SYNC, 0)
                self.board.input(self._next_edge + SYNC_LOW_TICKS, PIN_SYNC, 1)
                self._next_edge += self._edge_ticks
            self.board.run_until(min(end, now + AHEAD_TICKS))

    def take(self, data: bytes) -> None:
        self._waiting += self._to_head.carry(data)

    def give(self) -> bytes:
        return self._to_host.carry(self.board.serial_read())

    def _serve(self, line: TcpLine, done: threading.Event) -> None:
        began = time.monotonic_ns() - self.now_ns()
        while not done.wait(LIVE_STEP_S):
            self.take(line.read())
            behind = time.monotonic_ns() - began - self.now_ns()
            self.pass_ns(max(behind, TICK_NS))
            line.write(self.give())


class ScriptedHead:
    """A ScriptedController behind a port, in virtual time: it answers what it is told to answer, without physics.

    `head.controller.refuse[Arm] = (StatusCode.UNSAFE, 0)`; `head.controller.emit(event)`; `head.controller.executed`.
    """

    def __init__(self, controller: ScriptedController | None = None) -> None:
        self.controller = controller or ScriptedController()
        self._now = 1_000_000_000
        self.url = publish(self)

    def close(self) -> None:
        withdraw(self.url)

    def now_ns(self) -> int:
        return self._now

    def pass_ns(self, ns: int) -> None:
        self._now += ns

    def take(self, data: bytes) -> None:
        self.controller.receive(data, self._now)

    def give(self) -> bytes:
        return self.controller.take()
