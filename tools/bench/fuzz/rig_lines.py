"""A rig that says anything: its answers made wrong, and what the host makes of them."""

import struct
from pathlib import Path
from random import Random
from typing import cast

from annulus_pipe.link.port import Port
from annulus_pipe.selftest.rig.recording import merged, samples, track
from annulus_pipe.selftest.rig.wire import Area, Operation, Record, RigLine, frame, unframe
from tools.bench.fuzz.mutate import of_bytes

READ_NS = 200_000_000  # a read that finds nothing takes so long here


class _RigPort:
    """As much of a Port as a RigLine uses, with the rig at its other end."""

    def __init__(self, rng: Random) -> None:
        self.bytes_read = 0
        self._rng = rng
        self._wrong = rng.choice((0.0, 0.05, 0.5))
        self._now, self._held, self._answers = 0, b"", b""

    def now_ns(self) -> int:
        return self._now

    def write(self, data: bytes) -> None:
        *frames, self._held = (self._held + data).split(b"\0")
        for asked in filter(None, map(unframe, frames)):
            for operation, payload in self._answered(*asked[::2]):
                said = frame(operation, asked[1], payload)
                self._answers += of_bytes(self._rng, said) if self._rng.random() < self._wrong else said

    def read(self, timeout_s: float) -> bytes:
        size = self._rng.choice((1, 7, 64, 4096))
        data, self._answers = self._answers[:size], self._answers[size:]
        self._now += 1_000_000 if data else READ_NS
        self.bytes_read += len(data)
        return data

    def close(self) -> None:
        pass

    def _answered(self, operation: int, payload: bytes) -> list[tuple[int, bytes]]:
        rng = self._rng
        if operation == Operation.HELLO:
            return [(operation, b"\0\x01" + b"E" * 16 + b"0.1.0\0")]
        if operation == Operation.STATE:
            return [(operation, b"\0" + rng.randbytes(33))]
        if operation == Operation.READ and len(payload) == 9:
            at, count = struct.unpack("<II", payload[1:])
            parts = [(at + i, min(56, count - i)) for i in range(0, count, 56)]
            data = [(int(Operation.DATA), struct.pack("<I", i) + rng.randbytes(4 * n)) for i, n in parts]
            return [(operation, b"\0"), *data]
        return [(operation, bytes((rng.choice((1, 2, 3, 9)) if rng.random() < 0.02 else 0,)))]


def rig_case(rng: Random) -> bytes:
    return rng.randbytes(8)


def rig_read(data: bytes, _: Path) -> None:
    rng = Random(data)
    line = RigLine("rig", cast(Port, _RigPort(rng)))
    line.levels(4, 4)
    line.load([rng.randrange(2**32) for _ in range(56)], 0)
    line.record(Record())
    line.go(56)
    state = line.state()
    both = [track(line.read(Area.RECORDED, 0, min(n, 200)), odd) for odd, n in enumerate(state.tracked[:2])]
    merged(*both)
    samples(line.read(Area.RECORDED, 0, min(state.sampled, 64)), 3, 0)
    line.read(Area.SLOW, 0, 2 * state.slow)
    line.stop()
