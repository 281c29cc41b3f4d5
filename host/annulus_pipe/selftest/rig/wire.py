"""The rig's line: frames of firmware/rig/README.md over a Port, one request at a time. Numbers: firmware/rig/wire.h."""

import struct
import zlib
from dataclasses import dataclass
from enum import IntEnum

from annulus_pipe.link.port import Port
from annulus_pipe.vocabulary import AnnulusError

PROTOCOL = 2
PAYLOAD_MAX, WORDS_MAX = 240, 56
LIST_WORDS, AREA_WORDS, TRACKS, SLOW_MAX = 8192, 49152, 7, 512
TRACK_ODD, NONE = 0x80, 0xFF
LIST_FIRST_PIN, LIST_PINS, GAP_MIN = 2, 14, 4
PLAYED_AT, CUED_AT, TRACK_AT, SAMPLED_AT = 7, 5, 2, 2  # ticks after the mark: see bench.c
RISE_DEAD, FALL_DEAD = 2, 4
SAMPLER_TRACK = 3  # whose machine the sampler takes

ANSWER_S = 1.0
TRIES = 10  # an emulated rig on a busy machine stands still for seconds
UNHEARD_TRIES = 3  # where not a byte ever came: nobody is there
_HEAD, _CRC = 2, 4
_FRAME_MAX = _HEAD + PAYLOAD_MAX + _CRC + 2


class Operation(IntEnum):
    HELLO = 1
    LEVELS = 2
    LIST = 3
    RECORD = 4
    GO = 5
    STATE = 6
    READ = 7
    STOP = 8
    BOOTLOADER = 9
    DATA = 16


class RigStatus(IntEnum):
    OK = 0
    BAD_LENGTH = 1
    OUT_OF_RANGE = 2
    BUSY = 3
    UNKNOWN = 4


class Area(IntEnum):
    RECORDED = 0
    SLOW = 1


class Runs(IntEnum):
    """Bits of a state's flags."""

    RUNS = 1
    PLAYED = 2
    LOST = 4


@dataclass(frozen=True, slots=True)
class Record:
    """What to record: see bench_record_t."""

    tracks: tuple[int, ...] = (NONE,) * TRACKS
    sample: int = NONE
    cue: int = NONE
    slow: int = 0
    sample_delay: int = 0
    sample_words: int = 0


@dataclass(frozen=True, slots=True)
class RigState:
    flags: int
    tick: int  # of the rig, since the mark
    levels: int
    sampled: int
    unplayed: int
    slow: int
    room: int
    tracked: tuple[int, ...]

    @property
    def played(self) -> bool:
        return bool(self.flags & Runs.PLAYED)

    @property
    def lost(self) -> bool:
        """A FIFO was full: the recording has a hole."""
        return bool(self.flags & Runs.LOST)


_STATE = struct.Struct("<BIIIHHH7H")


def stuff(body: bytes) -> bytes:
    """COBS and the zero; bodies here are shorter than 254 bytes, so no run needs a second code byte."""
    return b"".join(bytes((len(run) + 1,)) + run for run in body.split(b"\0")) + b"\0"


def unstuff(stuffed: bytes) -> bytes | None:
    """None where a code byte points past the end."""
    runs, at = [], 0
    while at < len(stuffed):
        end = at + stuffed[at]
        if end == at or end > len(stuffed):
            return None
        runs.append(stuffed[at + 1 : end])
        at = end
    return b"\0".join(runs)


def frame(operation: int, sequence: int, payload: bytes) -> bytes:
    body = bytes((operation, sequence)) + payload
    return stuff(body + zlib.crc32(body).to_bytes(_CRC, "little"))


def unframe(stuffed: bytes) -> tuple[int, int, bytes] | None:
    """(operation, sequence, payload) of one frame without its zero; None when it is damaged."""
    body = unstuff(stuffed)
    if body is None or len(body) < _HEAD + _CRC:
        return None
    content, crc = body[:-_CRC], int.from_bytes(body[-_CRC:], "little")
    return (content[0], content[1], content[2:]) if zlib.crc32(content) == crc else None


class RigLine:
    """A rig behind a port. AnnulusError, in one line, for whatever is not as it should be."""

    def __init__(self, url: str, port: Port | None = None) -> None:
        """Open the port, or take one that is open."""
        self.url = url
        self._port = port or Port(url)
        self._sequence = 0
        self._held = bytearray()
        try:
            hello = self._ask(Operation.HELLO, b"")
        except AnnulusError:
            seen = self._port.bytes_read
            self._port.close()
            what = f"{seen} bytes came and none was a rig's" if seen else "nothing came"
            raise AnnulusError(
                f"{url}: {what}, expected a second Pico with rig.uf2. Are the two ports the other way round?"
            ) from None
        if len(hello) < 18 or hello[0] != PROTOCOL:
            self._port.close()
            raise AnnulusError(
                f"{url}: this rig speaks protocol {hello[0] if hello else '?'}, expected {PROTOCOL}."
                " Flash it with the rig.uf2 of this version."
            )
        self.serial = hello[1:17].decode("ascii", "replace")
        self.version = hello[17:].rstrip(b"\0").decode("ascii", "replace")

    def close(self) -> None:
        self._port.close()

    def levels(self, drive: int, levels: int) -> None:
        """Drive the pins of this mask, let go of all others. Ends what runs."""
        self._ask(Operation.LEVELS, struct.pack("<HH", drive, levels))

    def load(self, words: list[int], at: int) -> None:
        """Up to WORDS_MAX words of the list, from place `at` on."""
        self._ask(Operation.LIST, struct.pack(f"<H{len(words)}I", at, *words))

    def record(self, what: Record) -> None:
        pins = struct.pack("<7BBBH", *what.tracks, what.sample, what.cue, what.slow)
        self._ask(Operation.RECORD, pins + struct.pack("<II", what.sample_delay, what.sample_words))

    def go(self, words: int) -> None:
        self._ask(Operation.GO, struct.pack("<H", words))

    def state(self) -> RigState:
        answer = self._ask(Operation.STATE, b"")
        if len(answer) != _STATE.size:
            raise AnnulusError(f"{self.url}: a state of {len(answer)} bytes, expected {_STATE.size}")
        flags, tick, levels, sampled, unplayed, slow, room, *tracked = _STATE.unpack(answer)
        room = min(room, AREA_WORDS // TRACKS)  # whatever it says: no more is ever asked for
        return RigState(
            flags,
            tick,
            levels,
            min(sampled, AREA_WORDS),
            unplayed,
            min(slow, SLOW_MAX),
            room,
            tuple(min(n, room) for n in tracked),
        )

    def stop(self) -> None:
        self._ask(Operation.STOP, b"")

    def read(self, area: Area, at: int, count: int) -> list[int]:
        """Words of what was recorded."""
        words: list[int] = []
        for _ in range(TRIES):
            missing = count - len(words)
            if missing == 0:
                break
            sequence = self._send(Operation.READ, struct.pack("<BII", area, at + len(words), missing))
            self._collect(sequence, at, count, words)
        if len(words) < count:
            raise AnnulusError(f"{self.url}: {len(words)} of {count} words came, expected all of them")
        return words

    # ---- frames ----

    def _collect(self, sequence: int, at: int, count: int, words: list[int]) -> None:
        """Data frames, in order, until all are there or none comes for a while."""
        deadline = self._now_s() + ANSWER_S
        while len(words) < count and self._now_s() < deadline:
            for operation, answered, payload in self._receive():
                if operation != Operation.DATA or answered != sequence or len(payload) % 4 or len(payload) < 8:
                    continue
                first, *more = struct.unpack(f"<{len(payload) // 4}I", payload)
                if first != at + len(words):
                    return
                words += more[: count - len(words)]
                deadline = self._now_s() + ANSWER_S

    def _ask(self, operation: Operation, payload: bytes) -> bytes:
        """The answer without its status."""
        for attempt in range(TRIES):
            if attempt >= UNHEARD_TRIES and not self._port.bytes_read:
                break
            sequence = self._send(operation, payload)
            deadline = self._now_s() + ANSWER_S
            while self._now_s() < deadline:
                for answered, of, content in self._receive():
                    if (answered, of) != (operation, sequence) or not content:
                        continue
                    if content[0] == RigStatus.BUSY and attempt and operation is Operation.GO:
                        return b""  # its answer to the first try was lost
                    if content[0]:
                        known = content[0] in set(RigStatus)
                        why = RigStatus(content[0]).name.lower() if known else str(content[0])
                        raise AnnulusError(f"{self.url}: the rig refuses {operation.name.lower()}: {why}")
                    return content[1:]
        raise AnnulusError(
            f"{self.url}: no answer to {operation.name.lower()}, expected one within {TRIES * ANSWER_S:g} s"
        )

    def _send(self, operation: Operation, payload: bytes) -> int:
        self._sequence = (self._sequence + 1) % 256
        self._port.write(frame(operation, self._sequence, payload))
        return self._sequence

    def _receive(self) -> list[tuple[int, int, bytes]]:
        self._port.write(b"")
        *complete, rest = (bytes(self._held) + self._port.read(0.002)).split(b"\0")
        self._held = bytearray(rest if len(rest) <= _FRAME_MAX else b"")
        frames = [unframe(part) for part in complete if part and len(part) <= _FRAME_MAX]
        return [found for found in frames if found is not None]

    def _now_s(self) -> float:
        return self._port.now_ns() * 1e-9
