"""Updates of the application over a line: what a host sends, and what the controller must say to it."""

import random
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

from annulus_pipe.controller import UPDATE_CHUNK_BYTES, UPDATE_MAX_BYTES, UPDATE_SILENCE_MS
from annulus_pipe.flash.image import APPLICATION_SIZE_AT, application, read_image
from annulus_pipe.link.messages import (
    Arm,
    Command,
    Identify,
    Move,
    Reset,
    StatusCode,
    UpdateBegin,
    UpdateData,
    UpdateDataReply,
    UpdateEnd,
    UpdateRefusal,
)
from annulus_pipe.shipped import IMAGE, shipped
from tools.attack.boards import MS, insist
from tools.attack.kept import Asked, Kept, accepted

RAM = 0x2000_0000  # applications are linked for its beginning
SILENCE = UPDATE_SILENCE_MS * MS
LEAST_CHUNKS = 10  # room for what an application begins and ends with
NAMES = {"native": b"native\0\0", "emulated": b"rp2040\0\0"}


@dataclass(frozen=True, slots=True)
class Update:
    """`kind`: "broken off" in the middle, told to end "early" as well, "damaged", "foreign" or "whole"."""

    kind: str
    chunks: int
    seed: int


def sent(update: Update, board: str) -> Iterator[Command]:
    """What a host says one after another, each once the last is answered."""
    rng = random.Random(update.seed)
    name, size = NAMES[board], update.chunks * UPDATE_CHUNK_BYTES
    if update.kind == "whole" and board == "emulated":
        data = application(read_image(shipped(IMAGE))).data  # it is started
    else:
        data = made_up(rng, size, b"rp2350" if update.kind == "foreign" else name.rstrip(b"\0"))
    (crc,) = struct.unpack("<I", data[-4:])
    if update.kind == "damaged":
        at = rng.randrange(len(data))
        data = data[:at] + bytes([data[at] ^ 1 << rng.randrange(8)]) + data[at + 1 :]
    yield UpdateBegin(len(data), crc, name)
    offsets = range(0, len(data), UPDATE_CHUNK_BYTES)
    for at in offsets:
        if update.kind == "early" and at == offsets[len(offsets) // 2]:
            yield UpdateEnd()
        if update.kind == "broken off" and at == offsets[-1]:
            return
        yield UpdateData(at, data[at : at + UPDATE_CHUNK_BYTES].ljust(UPDATE_CHUNK_BYTES, b"\0"))
    yield UpdateEnd()


def made_up(rng: random.Random, size: int, name: bytes) -> bytes:
    """Looks like an application: firmware/application.h."""
    data = bytearray(rng.randbytes(size - 4))
    label = b"annulus " + name + b" "
    data[APPLICATION_SIZE_AT : APPLICATION_SIZE_AT + 4 + len(label)] = struct.pack("<I", size) + label
    return bytes(data) + struct.pack("<I", zlib.crc32(data))


def leaves(asked: Asked) -> bool:
    return isinstance(asked.command, UpdateEnd) and accepted(asked)


def judge(kept: Kept, board: str) -> None:
    """While one is surely under way nothing is armed or moved; every chunk is taken, and in its place; what has come is
    started only if it is whole, and for this board.
    """
    begun: Asked | None = None
    data, heard, came = bytearray(), 0, 0
    told_to_go = any(isinstance(asked.command, Reset) or leaves(asked) for asked in kept.asked)
    for asked in kept.asked if told_to_go or not kept.boots else ():
        command = asked.command
        if isinstance(command, UpdateBegin) and accepted(asked):
            begun, heard, data, came = asked, asked.sent, bytearray(command.size), 0
        elif isinstance(command, (Identify, Reset)):
            begun = None
        elif isinstance(command, UpdateData) and isinstance(asked.reply, UpdateDataReply) and begun:
            insist(accepted(asked), f"a chunk in its turn refused: {asked.reply}", asked.sent)
            came = command.offset + UPDATE_CHUNK_BYTES
            insist(asked.reply.next == came, f"chunk {command.offset} taken, next is {asked.reply}", asked.sent)
            data[command.offset : came] = command.chunk[: len(data) - command.offset]
            heard = asked.sent
        elif isinstance(command, UpdateEnd) and asked.reply and begun and asked.answered < heard + SILENCE:
            status, why = verdict(begun.command, bytes(data), came, board)
            said = (asked.reply.status, asked.reply.detail)
            insist(said == (status, why), f"update_end answered {asked.reply}, due was {why!r}", asked.sent)
            begun = begun if why == UpdateRefusal.INCOMPLETE else None
        elif begun and asked.sent > begun.answered and asked.answered < begun.answered + SILENCE:
            live = isinstance(command, Move) or (isinstance(command, Arm) and bool(command.outputs))
            insist(not live or not accepted(asked), f"{command} taken while an update was under way", asked.sent)


def verdict(begin: Command, data: bytes, came: int, board: str) -> tuple[StatusCode, int]:
    """Status and detail that `update_end` must have."""
    assert isinstance(begin, UpdateBegin)
    label = data[APPLICATION_SIZE_AT + 4 :]
    if came < begin.size:
        return StatusCode.BAD_STATE, UpdateRefusal.INCOMPLETE
    sums = {begin.crc, zlib.crc32(data[:-4]), struct.unpack("<I", data[-4:])[0]}
    sized = struct.unpack_from("<I", data, APPLICATION_SIZE_AT)[0] == begin.size
    if len(sums) > 1 or not sized or not label.startswith(b"annu"):
        return StatusCode.BAD_STATE, UpdateRefusal.DAMAGED
    entry = struct.unpack_from("<I", data, 4)[0]
    starts = entry != 0 if board == "native" else entry & 1 and RAM <= entry < RAM + UPDATE_MAX_BYTES
    if not label.startswith(b"annulus " + NAMES[board].rstrip(b"\0") + b" ") or not starts:
        return StatusCode.BAD_STATE, UpdateRefusal.FOREIGN
    return StatusCode.OK, 0
