"""A rig of the twin in real time: its board keeps up with the clock, or its world is slowed down."""

import contextlib
import select
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TypeVar

from annulus_pipe.twin.emulated import VirtualBoard
from annulus_pipe.twin.line import Line
from annulus_pipe.vocabulary import AnnulusError

SLIP_TICKS = 2_000_000  # a machine that falls further behind than this has its world slowed down
PATIENCE_S = 1e-3
HELD_MAX = 65536  # bytes to a host that does not read


def rounds(
    board: VirtualBoard, serial: Line, others: Sequence[Line], advance: Callable[[int], None], over: threading.Event
) -> Iterator[None]:
    """Until `over`, a round at a time: something came on a line or a millisecond went by, the world went on to now
    (`advance`), and what board and host have to say to one another was said."""
    origin = time.monotonic_ns() - board.tick * 10
    to_host = bytearray()
    while not over.is_set():
        with contextlib.suppress(OSError, ValueError):  # a line that was just closed
            select.select([one for line in (serial, *others) for one in line.waitables()], [], [], PATIENCE_S)
        now = (time.monotonic_ns() - origin) // 10
        if now > board.tick + SLIP_TICKS:
            origin += (now - board.tick - SLIP_TICKS) * 10
            now = board.tick + SLIP_TICKS
        advance(now)
        if heard := serial.read():
            board.serial_write(heard)
        to_host += board.serial_read()
        del to_host[: serial.write(bytes(to_host)) if to_host else 0]
        if len(to_host) > HELD_MAX:
            to_host.clear()
        yield


class Rig(Protocol):
    """What is served in real time."""

    def run(self, over: threading.Event) -> None: ...

    def close(self) -> None: ...


R = TypeVar("R", bound=Rig)


@contextlib.contextmanager
def serving(rig: R) -> Iterator[R]:
    """The rig in real time on a thread of this process; closed at the end."""
    over = threading.Event()
    failed: list[BaseException] = []

    def run() -> None:
        try:
            rig.run(over)
        except BaseException as error:  # told to whoever waits, not to a thread's stderr
            failed.append(error)

    thread = threading.Thread(target=run, name="twin rig", daemon=True)
    thread.start()
    try:
        yield rig
    finally:
        over.set()
        thread.join(5.0)
        rig.close()
    if failed:
        raise AnnulusError(f"twin rig: ended by itself ({failed[0]})")
