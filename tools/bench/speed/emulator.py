"""Lamps of the shipped image over 200 000 edges, read off its pins.

Needs `make firmware emulator`. 500 Hz, the fastest there is, R = 4, a burst train beside it, and one line flooded both
ways: the serial one in four parts, then USB with a tenth of the edges. Two processes at a time; some ten minutes.
Fewer edges: `python -m tools.bench.speed.emulator EDGES`.
"""

import random
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

from annulus_pipe.controller import PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_SYNC, TICK_S
from annulus_pipe.link.codec import Frame, encode
from annulus_pipe.link.messages import Arm, ArmFlag, Burst, BurstCode, BurstReply, Commit, Status, StatusCode
from tests.emulator.emulated import BOOTED, IMAGE, MS, EmulatedBoard, configuration
from tools.bench.table import Row

PERIOD, DELAY, WIDTH = 200_000, 30_000, 20_000  # ticks
CHIP, TRAIN = 50, 70_000
AT_ONCE = 250  # edges a step


@dataclass
class Seen:
    """Smallest and largest of what was measured, in ticks."""

    least: int = 1 << 62
    most: int = -(1 << 62)

    def add(self, value: int) -> None:
        self.least, self.most = min(self.least, value), max(self.most, value)

    def __str__(self) -> str:
        return f"{self.least}..{self.most}"


def measure(line: str, part: int, edges: int) -> Row:
    """One line, flooded, beside lamps and bursts."""
    board = EmulatedBoard(IMAGE)
    board.run(BOOTED)
    if line == "USB":
        board.plug_in()
    board.identify()
    outputs = ArmFlag.LAMPS | ArmFlag.MICROWAVE
    for command in (configuration(period=PERIOD, delay=DELAY, width=WIDTH), Commit(generation=1), Arm(outputs=outputs)):
        board.request(command)
    rng = random.Random(part)
    latency, width, grid = Seen(), Seen(), Seen()
    wrong = fired = 0
    trains: list[int] = []  # their first chips, in ticks of the board
    begun, busy = time.monotonic(), board.now
    bytes_out = 0
    first = board.now + MS
    for begin in range(0, edges, AT_ONCE):
        board.transitions.clear()
        started = board.request(Burst(code=BurstCode.MPSL25, chip=CHIP, repeat=5_000, period=TRAIN, trigger_offset=-25))
        if isinstance(started, BurstReply) and started.status == StatusCode.OK:  # else the last one still runs
            behind = (board.now - started.start - board.origin + (1 << 31)) % (1 << 32) - (1 << 31)
            trains.append(board.now - behind)
        some = [first + i * PERIOD + rng.randrange(-50, 50) for i in range(begin, min(begin + AT_ONCE, edges))]
        board.input(*[item for edge in some for item in ((edge, PIN_SYNC, 0), (edge + 3_000, PIN_SYNC, 1))])
        for edge in some[::25]:
            noise = b"" if line == "USB" else rng.randbytes(80) + b"\0"  # USB delivers no noise
            board.write(b"".join(encode(Frame(Status(), rng.randrange(256))) + noise for _ in range(50)))
            board.run(edge + 24 * PERIOD)
        board.run(some[-1] + DELAY + WIDTH + 1_000)
        rises = sorted((tick, pin) for pin in (PIN_PROJECTOR, PIN_LED) for tick in board.rises(pin))
        falls = sorted((tick, pin) for pin in (PIN_PROJECTOR, PIN_LED) for tick in board.falls(pin))
        if not len(rises) == len(falls) == len(some):
            raise SystemExit(f"{line}: {len(rises)} flashes after {len(some)} edges")
        for i, (edge, (rise, pin), (fall, _)) in enumerate(zip(some, rises, falls, strict=True), begin):
            latency.add(rise - edge - DELAY)
            width.add(fall - rise - WIDTH)
            wrong += pin != (PIN_LED if i % 5 == 4 else PIN_PROJECTOR)
        chips = sorted(board.rises(PIN_MICROWAVE) + board.falls(PIN_MICROWAVE))
        for tick in chips:
            mine = max(start for start in trains if start <= tick)
            off = (tick - mine) % TRAIN % CHIP
            grid.add(min(off, CHIP - off))
        fired += len(chips) // 2
        bytes_out = board.usb_bytes if line == "USB" else bytes_out + len(board.sent)
        board.sent.clear()
        board.events.clear()
        board.event_sequences.clear()
        board.replies.clear()
    seconds = (board.now - busy) * TICK_S
    board.close()
    return Row(
        f"{line}, {edges} edges: latency less delay; width error; pulses off the grid; wrong lamps",
        "-",
        "one constant; 0; 0; 0",
        f"{latency}; {width}; {grid} ticks ({fired} pulses); {wrong}. {bytes_out / seconds / 1000:.0f} kB/s out, "
        f"{seconds:.1f} s in {time.monotonic() - begun:.0f} s",
        latency.least == latency.most and (width.least, width.most, grid.most, wrong) == (0, 0, 0, 0),
    )


def rows(edges: int = 200_000) -> list[Row]:
    parts = [("UART", part, edges // 4) for part in range(4)] + [("USB", 4, edges // 10)]
    with ProcessPoolExecutor(2) as pool:
        return list(pool.map(measure, *zip(*parts, strict=True)))


if __name__ == "__main__":
    for row in rows(int(sys.argv[1])):
        print(row.what, "|", row.measured, "|", row.ok)
