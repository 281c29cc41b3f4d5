"""A new application over the line, beside and then instead of the one that runs, whatever happens on the way. The flash
is written by the boot ROM's functions only; the emulator keeps its contents over resets and cuts of power.
"""

import random
import struct
import zlib
from pathlib import Path

import pytest
from emulated import BOOTED, MS, EmulatedBoard, arm, edges_from

from annulus.controller import PIN_LED, UPDATE_CHUNK_BYTES
from annulus.flash.image import Application, application, read_image
from annulus.link.messages import (
    SCHEMA_HASH,
    Arm,
    ArmFlag,
    BootCause,
    Identify,
    IdentifyReply,
    Move,
    Ping,
    PingReply,
    StatusCode,
    UpdateBegin,
    UpdateBeginReply,
    UpdateData,
    UpdateDataReply,
    UpdateEnd,
    UpdateEndReply,
    UpdateRefusal,
)

SECTOR = 4096
STAGED_AT = 0x10000
APPLICATION_AT = 0x1000
COPYING = 800 * MS  # the loader's work and the start after it; typically 0.3 s


@pytest.fixture
def new(other: Path) -> Application:
    return application(read_image(other))


@pytest.fixture
def ours(image: Path) -> str:
    identity = read_image(image).identity
    assert identity is not None
    return identity.git


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


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
def test_a_whole_update_over_the_uart_then_runs(board: EmulatedBoard, new: Application, ours: str) -> None:
    before = board.identify()
    began = board.now
    stage(board, new)
    print(f"{len(new.data)} bytes staged in {(board.now - began) / MS:.0f} ms")
    assert board.identify().git.decode() == ours  # and nothing is changed so far
    assert begin(board, new).next >= len(new.data)
    assert end(board) == (StatusCode.OK, 0)
    board.run(board.now + COPYING)
    after = board.identify()
    assert after.git.decode() == "0therone"
    assert (after.cause, after.boot) == (BootCause.HOST_RESET, (before.boot + 1) % 256)
    arm(board, ratio=0)
    edges = edges_from(board, 3)
    for edge in edges:
        board.pulse(edge)
    board.run_alive(edges[-1] + 10 * MS)
    assert len(board.rises(PIN_LED)) == 3
    writes = board.flash
    board.power_cycle()
    board.run(board.now + BOOTED)
    assert who(board) == "0therone"
    assert board.flash == writes  # the loader had nothing more to do


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
def test_an_update_over_usb_as_well(board: EmulatedBoard, new: Application) -> None:
    board.plug_in()
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    board.over_usb = False
    board.run(board.now + COPYING)
    assert who(board) == "0therone"


def until_it_answers(board: EmulatedBoard, patience: int = COPYING) -> str:
    """The commit of what runs after the loader's work, however long that takes."""
    end = board.now + patience
    while board.now < end:
        board.replies.clear()
        board.send(Identify(protocol=1, schema=SCHEMA_HASH))
        board.run(board.now + 10 * MS)
        if answers := [reply for reply in board.replies if isinstance(reply, IdentifyReply)]:
            return answers[-1].git.decode()
    return "silence"


@pytest.fixture
def pair(image: Path, new: Application, ours: str) -> list[tuple[str, Application]]:
    """What runs, and what comes; each update turns them round."""
    return [(ours, application(read_image(image))), ("0therone", new)]


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
def test_power_lost_while_staging_leaves_the_old_one_running(
    board: EmulatedBoard, pair: list[tuple[str, Application]]
) -> None:
    rng = random.Random(11)
    (old, _), (_, new) = pair
    for cut in range(6):
        board.identify()
        begin(board, new)
        at = rng.randrange(0, len(new.data), UPDATE_CHUNK_BYTES)
        at -= at % SECTOR if cut % 2 else 0  # in the middle of an erase, or of a page
        send_chunks(board, new.data, 0, at)
        board.send(chunk(new.data, at))
        board.run(board.now + rng.randrange(MS, 46 * MS if at % SECTOR == 0 else 2 * MS))
        board.power_cycle()
        board.run(board.now + BOOTED)
        assert until_it_answers(board) == old
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    assert until_it_answers(board) == "0therone"


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
@pytest.mark.parametrize("seed", range(2))
def test_power_lost_while_the_loader_works_only_delays_it(
    board: EmulatedBoard, pair: list[tuple[str, Application]], seed: int
) -> None:
    """Cut up to four times, at any moment from the acknowledgement to the first answer; the copy begins anew each time.
    Then the next update goes the other way."""
    rng = random.Random(seed)
    stage(board, pair[1][1])
    assert end(board) == (StatusCode.OK, 0)
    began = board.now
    assert until_it_answers(board) == "0therone"
    work = board.now - began
    print(f"the loader's work and the start: {work / MS:.0f} ms")
    for _ in range(3):
        pair.reverse()
        stage(board, pair[1][1])
        assert end(board) == (StatusCode.OK, 0)
        for _ in range(rng.randrange(1, 5)):
            board.run(board.now + rng.randrange(work))
            board.power_cycle()
        board.run(board.now + BOOTED)
        assert until_it_answers(board) == pair[1][0]
        assert board.flash["erased"] > 0


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
def test_power_lost_around_the_record_starts_one_or_the_other(
    board: EmulatedBoard, pair: list[tuple[str, Application]]
) -> None:
    rng = random.Random(5)
    found = set()
    for cut in (5 * MS, *(rng.randrange(40 * MS, 90 * MS) for _ in range(4)), 120 * MS):
        (old, _), (name, new) = pair
        board.identify()
        if begin(board, new).next < len(new.data):
            send_chunks(board, new.data)
        board.send(UpdateEnd())
        board.run(board.now + cut)  # the check, an erase of 45 ms, a page, the reset
        board.power_cycle()
        board.run(board.now + BOOTED)
        runs = until_it_answers(board)
        assert runs in (old, name)
        found.add(runs == old)
        if runs == name:
            pair.reverse()
    assert found == {True, False}


# ---- what is refused, and changes nothing ----


def test_wrong_board_size_or_state_is_refused(board: EmulatedBoard, new: Application) -> None:
    board.identify()
    reply = begin(board, new, board=b"rp2350\0\0")
    assert (reply.status, reply.detail) == (StatusCode.OUT_OF_RANGE, 2)
    for size in (0, 28 * 1024 + 1):
        reply = begin(board, new, size=size)
        assert (reply.status, reply.detail) == (StatusCode.OUT_OF_RANGE, 0)
    reply_ = board.request(chunk(new.data, 0))
    assert (reply_.status, reply_.detail) == (StatusCode.BAD_STATE, UpdateRefusal.NOT_NOW)
    assert end(board) == (StatusCode.BAD_STATE, UpdateRefusal.NOT_NOW)
    arm(board)
    assert begin(board, new).status == StatusCode.BAD_STATE
    assert board.request(Arm(ArmFlag(0))).status == StatusCode.OK
    assert board.request(Move(position=100, period=100_000, hold=0)).status == StatusCode.OK
    assert begin(board, new).status == StatusCode.BAD_STATE
    assert board.flash == {"erased": 0, "programmed": 0}
    board.plug_in()
    assert begin(board, new).status == StatusCode.SCHEMA  # the session is the other line's
    board.over_usb = False


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
def test_nothing_is_armed_or_moved_while_an_update_is_under_way(board: EmulatedBoard, new: Application) -> None:
    arm(board)
    board.request(Arm(ArmFlag(0)))
    assert begin(board, new).status == StatusCode.OK
    move = Move(position=10, period=20_000, hold=0)
    for command in (Arm(ArmFlag.LAMPS), Arm(ArmFlag.MICROWAVE), move):
        assert board.request(command).status == StatusCode.BAD_STATE
    board.run_alive(board.now + 4_900 * MS, every=500 * MS)
    assert board.request(Arm(ArmFlag.LAMPS)).status == StatusCode.BAD_STATE
    board.run_alive(board.now + 200 * MS)  # given up after five seconds without a chunk
    assert board.request(Arm(ArmFlag.LAMPS)).status == StatusCode.OK
    board.request(Arm(ArmFlag(0)))
    assert begin(board, new).status == StatusCode.OK
    board.identify()  # and by whoever begins anew
    assert board.request(Arm(ArmFlag.LAMPS)).status == StatusCode.OK


def test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on(
    board: EmulatedBoard, new: Application
) -> None:
    board.erase_takes(2 * MS)
    board.identify()
    begin(board, new)
    reply = board.request(chunk(new.data, 64))
    assert isinstance(reply, UpdateDataReply)
    assert (reply.status, reply.detail, reply.next) == (StatusCode.BAD_STATE, UpdateRefusal.INCOMPLETE, 0)
    send_chunks(board, new.data, 0, 5 * 1024)
    writes = board.flash
    for at in (0, 4096, 5 * 1024 - 32):
        reply = board.request(chunk(bytes(len(new.data)), at))  # other bytes, even
        assert isinstance(reply, UpdateDataReply)
        assert (reply.status, reply.next) == (StatusCode.OK, 5 * 1024)
    assert end(board) == (StatusCode.BAD_STATE, UpdateRefusal.INCOMPLETE)
    assert board.flash == writes
    board.identify()
    assert begin(board, new).next == 5 * 1024
    send_chunks(board, new.data, 5 * 1024)
    assert end(board) == (StatusCode.OK, 0)
    assert until_it_answers(board) == "0therone"


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
@pytest.mark.parametrize("what", ["bit", "truncated", "crc", "foreign"])
def test_a_damaged_or_foreign_one_is_never_started(
    board: EmulatedBoard, new: Application, ours: str, what: str
) -> None:
    data, crc = bytearray(new.data), new.crc
    if what == "bit":
        data[9_001] ^= 4
    elif what == "truncated":
        del data[-512:]
    elif what == "crc":
        crc ^= 1
    else:
        data[196 : 196 + 14] = b"annulus rp2350"
        crc = zlib.crc32(data[:-4])
        data[-4:] = struct.pack("<I", crc)
    wrong = Application(bytes(data), crc, new.board)
    stage(board, wrong)
    refusal = UpdateRefusal.FOREIGN if what == "foreign" else UpdateRefusal.DAMAGED
    assert end(board) == (StatusCode.BAD_STATE, refusal)
    board.power_cycle()
    board.run(board.now + BOOTED)
    assert who(board) == ours
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    assert until_it_answers(board) == "0therone"


# ---- the loader, USB and time ----


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
def test_a_staged_one_that_rots_before_the_copy_is_ignored(board: EmulatedBoard, new: Application, ours: str) -> None:
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    board.spoil_flash(STAGED_AT + 8_000, bytes([new.data[8_000] ^ 1]))
    assert until_it_answers(board) == ours
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    assert until_it_answers(board) == "0therone"


def test_without_a_whole_application_the_board_waits_on_usb(board: EmulatedBoard, image: Path, ours: str) -> None:
    board.spoil_flash(APPLICATION_AT, b"\xff" * SECTOR)
    board.power_cycle()
    board.run(board.now + BOOTED)
    assert board.bootloader is not None
    board.copy_uf2(image)
    assert until_it_answers(board) == ours


@pytest.mark.deep(
    gate="tests/emulator/test_update.py::test_chunks_out_of_order_or_repeated_are_harmless_and_a_broken_update_goes_on"
)
@pytest.mark.parametrize(("after_ms", "same"), [(3, False), (70, False), (130, True), (250, False)])
def test_what_was_flashed_over_usb_is_not_overwritten_by_an_update_left_pending(
    board: EmulatedBoard, image: Path, third: Path, new: Application, ours: str, after_ms: int, same: bool
) -> None:
    """Power goes before or while the loader copies, and the next start is with BOOTSEL held. The one exception: the
    very image that ran, flashed again within the tenth of a second before the copy begins, is still replaced."""
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    board.run(board.now + after_ms * MS)
    board.power_cycle(bootsel=True)
    board.run(board.now + MS)
    board.copy_uf2(image if same else third)
    expected = ours if same else "athird00"
    assert until_it_answers(board) == expected
    board.power_cycle()
    board.run(board.now + BOOTED)
    assert until_it_answers(board) == expected


def test_ticks_go_on_through_the_slowest_erase(board: EmulatedBoard, new: Application) -> None:
    """400 ms with no look at a counter that wraps every 168, edges and cable going on."""
    board.identify()
    board.erase_takes(400 * MS)
    begin(board, new)
    for i in range(10):
        board.pulse(board.now + i * 40 * MS + 1_000)
    send_chunks(board, new.data, 0, 2 * UPDATE_CHUNK_BYTES)
    assert board.resets == []
    sent = board.now
    reply = board.request(Ping())
    assert isinstance(reply, PingReply)
    assert 0 <= reply.tick + board.origin - sent - 6_000 <= 20_000
