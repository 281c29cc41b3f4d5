"""The emulated image as a USB device for another machine's kernel: its time runs in a thread, as fast as it can and
never ahead of the clock on the wall. A frame-sync edge comes every 10 ms, the interlock is closed.
"""

import threading
import time
from pathlib import Path
from types import TracebackType

from emulated import BOOTED, MS, OUTPUTS, EmulatedBoard

from annulus_pipe.controller import TICK_NS

STEP = 2 * MS
EDGES_APART = 10 * MS


class Served:
    """Served from construction to `close`. Pins and requests are read at any time; ticks of 10 ns, as the board's."""

    def __init__(self, image: Path) -> None:
        self._board = EmulatedBoard(image)
        self._board.run(BOOTED)
        self.port = self._board.serve_usbip()
        self._lock = threading.Lock()
        self._ends = False
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._drive, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Served":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ends = True
        self._thread.join()
        self._board.close()
        if self._error:
            raise self._error

    @property
    def now(self) -> int:
        with self._lock:
            if self._error:
                raise self._error
            return self._board.now

    @property
    def resets(self) -> list[int]:
        return list(self._board.resets)

    def changes(self, since: int) -> list[tuple[int, int, int]]:
        """Every (tick, pin, level) of the outputs from this tick on."""
        with self._lock:
            return [change for change in self._board.transitions if change[0] >= since and change[1] in OUTPUTS]

    def requests(self, since: int) -> list[tuple[int, bytes]]:
        """Every (tick, setup packet) of the kernel from this tick on."""
        with self._lock:
            return [request for request in self._board.usb_requests if request[0] >= since]

    def run(self, ticks: int) -> None:
        """Until so much of its time is over."""
        end = self.now + ticks
        while self.now < end:
            time.sleep(0.001)

    def _drive(self) -> None:
        edge = self._board.now + EDGES_APART
        origin_ns = time.monotonic_ns() - self._board.now * TICK_NS
        while not self._ends:
            behind = (time.monotonic_ns() - origin_ns) // TICK_NS - self._board.now
            if behind <= 0:
                time.sleep(0.001)
                continue
            if behind > 10 * STEP:  # what it could not keep up with it need not make up for
                origin_ns += (behind - 10 * STEP) * TICK_NS
            with self._lock:
                try:
                    while edge < self._board.now + STEP:
                        self._board.pulse(max(edge, self._board.now))  # a run ends with an instruction, some ticks late
                        edge += EDGES_APART
                    self._board.run(self._board.now + STEP)
                except Exception as error:
                    self._error = error
                    return
