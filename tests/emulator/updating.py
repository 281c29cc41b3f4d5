"""What the tests of updates and of the loader share: how an application is staged, and how flash is spoilt."""

import struct
import zlib

from emulated import MS, EmulatedBoard

from annulus_pipe.controller import UPDATE_CHUNK_BYTES
from annulus_pipe.flash.image import Application
from annulus_pipe.link.messages import (
    RESET_MAGIC,
    SCHEMA_HASH,
    Identify,
    IdentifyReply,
    Image,
    ImageReply,
    Reset,
    StatusCode,
    UpdateBegin,
    UpdateBeginReply,
    UpdateData,
    UpdateDataReply,
    UpdateEnd,
    UpdateEndReply,
)

SECTOR = 4096
SLOTS = 0x1000, 0x20000
RECORDS_AT, RECORD_PAGES, PAGE = 0x11000, 32, 256
TRIALS = 3
STARTING = 200 * MS  # a record, a reset, the loader's work and the start after it; typically 25 ms
GATE = "tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"


def begin(board: EmulatedBoard, new: Application, /, **changes: object) -> UpdateBeginReply:
    fields = {"size": len(new.data), "crc": new.crc, "board": b"rp2040\0\0"} | changes
    reply = board.request(UpdateBegin(**fields))  # type: ignore[arg-type]
    assert isinstance(reply, UpdateBeginReply)
    return reply


def chunk(data: bytes, at: int) -> UpdateData:
    return UpdateData(at, data[at : at + UPDATE_CHUNK_BYTES].ljust(UPDATE_CHUNK_BYTES, b"\xff"))


def send_chunks(board: EmulatedBoard, data: bytes, first: int = 0, last: int | None = None) -> None:
    for at in range(first, len(data) if last is None else last, UPDATE_CHUNK_BYTES):
        reply = board.request(chunk(data, at), within=500 * MS)
        assert isinstance(reply, UpdateDataReply)
        assert (reply.status, reply.next) == (StatusCode.OK, at + UPDATE_CHUNK_BYTES)


def end(board: EmulatedBoard) -> tuple[StatusCode, int]:
    reply = board.request(UpdateEnd(), within=500 * MS)
    assert isinstance(reply, UpdateEndReply)
    return reply.status, reply.detail


def stage(board: EmulatedBoard, new: Application) -> None:
    board.identify()
    assert begin(board, new).status == StatusCode.OK
    send_chunks(board, new.data)


def who(board: EmulatedBoard) -> str:
    return board.identify().git.decode()


def image_of(board: EmulatedBoard) -> ImageReply:
    reply = board.request(Image())
    assert isinstance(reply, ImageReply)
    return reply


def sealed(data: bytearray, new: Application) -> Application:
    """With its CRC made right."""
    crc = zlib.crc32(data[:-4])
    data[-4:] = struct.pack("<I", crc)
    return Application(bytes(data), crc, new.board)


def hung(new: Application) -> Application:
    """Whole and for this board, but its first instruction jumps to itself."""
    data = bytearray(new.data)
    at = (struct.unpack_from("<I", data, 4)[0] & ~1) - 0x20000000
    data[at : at + 2] = b"\xfe\xe7"
    return sealed(data, new)


def put(board: EmulatedBoard, slot: int, data: bytes) -> None:
    """Into flash, behind everybody's back."""
    board.spoil_flash(SLOTS[slot], data)


def record(board: EmulatedBoard, page: int, slot: int, crc: int, *, confirmed: bool) -> None:
    """As a controller that staged it had written."""
    fields = struct.pack("<4I", 0x32445055, page + 1, slot, crc)
    rest = struct.pack("<4I", zlib.crc32(fields), 0xFFFFFFFF, 0 if confirmed else 0xFFFFFFFF, 0xFFFFFFFF)
    board.spoil_flash(RECORDS_AT + page * PAGE, fields + rest)


def pend(board: EmulatedBoard, new: Application) -> None:
    """As if it had just been staged and acknowledged: the reset comes now."""
    put(board, 1, new.data)
    record(board, 0, 1, new.crc, confirmed=False)
    board.identify()
    assert board.request(Reset(magic=RESET_MAGIC)).status == StatusCode.OK


def until_it_answers(board: EmulatedBoard, patience: int = STARTING) -> str:
    """The commit of what runs after the loader's work, however long that takes."""
    end = board.now + patience
    while board.now < end:
        board.replies.clear()
        board.send(Identify(protocol=1, schema=SCHEMA_HASH))
        board.run(board.now + 10 * MS)
        if answers := [reply for reply in board.replies if isinstance(reply, IdentifyReply)]:
            return answers[-1].git.decode()
    return "silence"
