"""A new application over the line, beside and then instead of the one that runs, whatever happens on the way."""

import random
import struct
import zlib

import pytest
from emulated import BOOTED, MS, ROUND_MAX, EmulatedBoard, arm, edges_from
from updating import (
    GATE,
    SECTOR,
    STARTING,
    TRIALS,
    begin,
    chunk,
    end,
    image_of,
    send_chunks,
    stage,
    until_it_answers,
    who,
)

from annulus_pipe.controller import PIN_LED, UPDATE_CHUNK_BYTES
from annulus_pipe.flash.image import Application
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    BootCause,
    Edge,
    Move,
    StatusCode,
    UpdateDataReply,
    UpdateEnd,
    UpdateRefusal,
)


@pytest.mark.deep(gate=GATE)
def test_a_whole_update_over_the_uart_then_runs(board: EmulatedBoard, new: Application, ours: str) -> None:
    before = board.identify()
    began = board.now
    stage(board, new)
    print(f"{len(new.data)} bytes staged in {(board.now - began) / MS:.0f} ms")
    assert board.identify().git.decode() == ours  # and nothing is changed so far
    assert begin(board, new).next >= len(new.data)
    assert end(board) == (StatusCode.OK, 0)
    board.run(board.now + STARTING)
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
    for _ in range(TRIALS + 1):
        board.power_cycle()
        board.run(board.now + BOOTED)
    assert who(board) == "0therone"
    assert board.flash == writes  # the loader had nothing more to do: it was confirmed
    assert (image_of(board).slot, image_of(board).starts, image_of(board).crc) == (1, 0, new.crc)


@pytest.mark.deep(gate=GATE)
def test_an_update_over_usb_as_well(board: EmulatedBoard, new: Application) -> None:
    board.plug_in()
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    board.over_usb = False
    board.run(board.now + STARTING)
    assert who(board) == "0therone"


@pytest.mark.deep(gate=GATE)
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


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("seed", range(10))
def test_power_lost_from_the_last_chunk_to_the_first_answer_starts_one_or_the_other(
    board: EmulatedBoard, pair: list[tuple[str, Application]], seed: int
) -> None:
    """Two moments each, up to three cuts at a time: in the record, while the loader counts a start, while it loads."""
    rng = random.Random(seed)
    for _ in range(2):
        (old, _), (name, new) = pair
        board.identify()
        if begin(board, new).next < len(new.data):
            send_chunks(board, new.data)
        board.send(UpdateEnd())
        for _ in range(rng.randrange(1, TRIALS + 1)):
            board.run(board.now + rng.choice([rng.randrange(2 * MS), rng.randrange(40 * MS)]))
            board.power_cycle()
        runs = until_it_answers(board)
        assert runs in (old, name)
        if runs == name:
            pair.reverse()


# ---- what is refused, and changes nothing ----


def test_wrong_board_size_or_state_is_refused(board: EmulatedBoard, new: Application) -> None:
    board.identify()
    reply = begin(board, new, board=b"rp2350\0\0")
    assert (reply.status, reply.detail) == (StatusCode.OUT_OF_RANGE, 2)
    for size in (0, 64 * 1024 + 1):
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
    assert board.flash == {"erased": 0, "programmed": 0}  # confirmed from the start
    board.plug_in()
    assert begin(board, new).status == StatusCode.SCHEMA  # the session is the other line's
    board.over_usb = False


@pytest.mark.deep(gate=GATE)
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


@pytest.mark.deep(gate=GATE)
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


# ---- time ----


def test_edges_and_ticks_go_on_through_the_slowest_erase(board: EmulatedBoard, new: Application) -> None:
    """400 ms: the main loop stood still for it, and after 128 edges every stamp was 15.36 us late."""
    board.identify()
    board.erase_takes(400 * MS)
    begin(board, new)
    edges = [board.now + (i + 1) * 2 * MS + i % 7 for i in range(220)]
    for edge in edges:
        board.pulse(edge)
    board.events.clear()
    send_chunks(board, new.data, 0, 2 * UPDATE_CHUNK_BYTES)
    board.run(edges[-1] + 20 * MS)
    assert board.resets == []
    stamps = [event.tick + board.origin for event in board.heard(Edge)]
    assert {stamp - edge for stamp, edge in zip(stamps, edges, strict=True)} <= {-1, 0, 1}
    assert board.longest[0] < ROUND_MAX
