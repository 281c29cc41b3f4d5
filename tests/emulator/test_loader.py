"""What the loader makes of what it finds in flash: applications on trial, given up, damaged, flashed over USB. The
emulator keeps its contents over resets and cuts of power."""

import random
from pathlib import Path

import pytest
from emulated import BOOTED, MS, EmulatedBoard, arm
from updating import (
    PAGE,
    RECORD_PAGES,
    RECORDS_AT,
    SECTOR,
    SLOTS,
    STARTING,
    TRIALS,
    end,
    hung,
    image_of,
    pend,
    put,
    record,
    sealed,
    stage,
    until_it_answers,
    who,
)

from annulus_pipe.flash.image import Application, application, read_image
from annulus_pipe.link.messages import (
    SCHEMA_HASH,
    Crash,
    CrashKind,
    CrashReply,
    Identify,
    ImageFlash,
    ImageWhy,
    Info,
    StatusCode,
    UpdateRefusal,
)

# ---- on trial, and back ----


def test_one_that_hangs_is_given_up_by_itself(board: EmulatedBoard, new: Application, ours: str) -> None:
    """It was silent for ever: three cuts of power later, too."""
    pend(board, hung(new))
    began = board.now
    assert until_it_answers(board, 4_000 * MS) == ours
    print(f"back after {(board.now - began) / MS:.0f} ms and {len(board.resets)} resets")
    assert len(board.resets) == 1 + TRIALS
    image = image_of(board)
    assert (image.slot, image.starts, image.why) == (0, 0, ImageWhy.GIVEN_UP)


def test_one_that_no_host_understands_is_given_up_after_three_starts(
    board: EmulatedBoard, new: Application, ours: str
) -> None:
    pend(board, new)
    board.run(board.now + STARTING)
    for start in range(1, TRIALS + 1):
        assert (image_of(board).starts, image_of(board).crc) == (start, new.crc)  # asked, and not identified
        board.power_cycle()
        board.run(board.now + BOOTED)
    assert image_of(board).why == ImageWhy.GIVEN_UP
    assert who(board) == ours


@pytest.mark.deep(gate="tests/emulator/test_loader.py::test_one_that_hangs_is_given_up_by_itself")
def test_what_was_refused_or_broken_off_is_never_started_either(
    board: EmulatedBoard, image: Path, new: Application
) -> None:
    """A whole image for another board had been refused and lay there whole: one flipped bit in the other started it."""
    data = bytearray(new.data)
    data[196 : 196 + 14] = b"annulus rp2350"
    stage(board, sealed(data, new))
    assert end(board) == (StatusCode.BAD_STATE, UpdateRefusal.FOREIGN)
    whole = application(read_image(image)).data
    record(board, 0, 0, application(read_image(image)).crc, confirmed=True)
    board.spoil_flash(SLOTS[0] + 7_000, bytes([whole[7_000] ^ 1]))
    board.power_cycle()
    board.run(board.now + 2 * BOOTED)  # the one that is recorded is looked at again where there is no other
    assert board.bootloader is not None


@pytest.mark.deep(gate="tests/emulator/test_loader.py::test_one_that_hangs_is_given_up_by_itself")
def test_the_last_one_that_hangs_ends_in_the_boot_rom(board: EmulatedBoard, new: Application) -> None:
    """Given up, and the other one rots later: it was started for ever."""
    pend(board, hung(new))
    board.spoil_flash(SLOTS[0] + 7_000, b"\x00\x00\x00\x00\x00\x00")
    board.run(board.now + 4_500 * MS)
    assert board.bootloader is not None


@pytest.mark.deep(gate="tests/emulator/test_loader.py::test_one_that_hangs_is_given_up_by_itself")
def test_a_host_of_another_schema_confirms_nothing(board: EmulatedBoard, new: Application) -> None:
    pend(board, new)
    board.run(board.now + STARTING)
    assert board.request(Identify(protocol=1, schema=SCHEMA_HASH ^ 1)).status == StatusCode.SCHEMA
    assert image_of(board).starts == 1
    board.identify()
    assert image_of(board).starts == 0


@pytest.mark.deep(gate="tests/emulator/test_loader.py::test_one_that_hangs_is_given_up_by_itself")
def test_records_go_round_their_sectors(board: EmulatedBoard, pair: list[tuple[str, Application]]) -> None:
    """From the last page but one on, past one left half programmed: over the end, into a sector of old ones."""
    for page in range(RECORD_PAGES - 2):
        record(board, page, 0, pair[0][1].crc, confirmed=True)
    board.spoil_flash(RECORDS_AT + (RECORD_PAGES - 2) * PAGE, b"\x55" * 7)
    board.power_cycle()
    board.run(board.now + BOOTED)
    board.erase_takes(MS)
    for _ in range(3):  # to the last page; to the first, which is erased; to the next
        stage(board, pair[1][1])
        assert end(board) == (StatusCode.OK, 0)
        assert until_it_answers(board) == pair[1][0]
        pair.reverse()


# ---- what the loader finds in flash ----


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("part", range(40))
def test_one_with_a_flipped_bit_is_never_started(
    board: EmulatedBoard, image: Path, new: Application, ours: str, part: int
) -> None:
    """Five bits each, anywhere: the other application answers. Its CRC was looked at by nobody."""
    rng = random.Random(part)
    whole = application(read_image(image)).data
    put(board, 1, new.data)
    record(board, 0, 0, application(read_image(image)).crc, confirmed=True)
    for _ in range(5):
        at, bit = rng.randrange(len(whole)), 1 << rng.randrange(8)
        board.spoil_flash(SLOTS[0] + at, bytes([whole[at] ^ bit]))
        board.power_cycle()
        board.run(board.now + BOOTED)
        assert who(board) == "0therone", (at, bit)
        reply = image_of(board)
        assert (reply.slot, reply.why) == (1, ImageWhy.DAMAGED)
        board.spoil_flash(SLOTS[0] + at, whole[at : at + 1])
    board.power_cycle()
    board.run(board.now + BOOTED)
    assert who(board) == ours


@pytest.mark.deep(but=1)
@pytest.mark.parametrize("part", range(4))
def test_a_new_head_over_an_old_tail_is_never_started(
    board: EmulatedBoard, image: Path, new: Application, part: int
) -> None:
    """A copy to the drive that broke off, at five places: without another application the board waits on USB."""
    old = application(read_image(image)).data
    shifted = bytes(new.data[:200]) + bytes(reversed(new.data[200:-4])) + new.data[-4:]
    for cut in range(part, 20, 4):
        at = (cut + 1) * len(shifted) // 21
        put(board, 0, shifted[:at] + old[at:])
        board.power_cycle()
        board.run(board.now + BOOTED)
        assert board.bootloader is not None, at
    board.copy_uf2(image)
    board.identify()


def test_a_copy_in_flash_that_rots_is_told_before_the_next_start_finds_it(
    board: EmulatedBoard, image: Path, ours: str
) -> None:
    board.identify()
    board.run_alive(board.now + 500 * MS, every=200 * MS)
    assert image_of(board).flash == ImageFlash.WHOLE
    whole = application(read_image(image)).data
    board.spoil_flash(SLOTS[0] + 9_000, bytes([whole[9_000] ^ 1]))
    board.run_alive(board.now + 500 * MS, every=200 * MS)
    assert image_of(board).flash == ImageFlash.DAMAGED
    assert who(board) == ours and not board.resets


def test_code_that_changes_in_ram_goes_dark_and_starts_anew(board: EmulatedBoard, image: Path) -> None:
    arm(board, delay=100_000, width=1_500_000, period=4_000_000)
    whole = application(read_image(image)).data
    board.spoil_ram(0x20000000 + len(whole) - 100, b"\x00\x01")  # nobody runs or reads it
    board.run_alive(board.now + 300 * MS, every=100 * MS)
    assert len(board.resets) == 1
    board.identify()
    crash = board.request(Crash())
    assert isinstance(crash, CrashReply)
    assert (crash.kind, crash.crashes) == (CrashKind.DAMAGED, 1)
    assert board.request(Info(level=2)).status == StatusCode.OK
    crash = board.request(Crash())
    assert isinstance(crash, CrashReply)
    assert crash.kind == CrashKind.STUCK  # to a host that has no name for it


# ---- USB, and time ----


@pytest.mark.deep(gate="tests/emulator/test_loader.py::test_one_that_hangs_is_given_up_by_itself")
def test_a_staged_one_that_rots_before_it_starts_is_not_started(
    board: EmulatedBoard, new: Application, ours: str
) -> None:
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    board.spoil_flash(SLOTS[1] + 8_000, bytes([new.data[8_000] ^ 1]))
    assert until_it_answers(board) == ours
    assert image_of(board).why == ImageWhy.DAMAGED
    stage(board, new)
    assert end(board) == (StatusCode.OK, 0)
    assert until_it_answers(board) == "0therone"


def test_without_a_whole_application_the_board_waits_on_usb(board: EmulatedBoard, image: Path, ours: str) -> None:
    board.spoil_flash(SLOTS[0], b"\xff" * SECTOR)
    board.power_cycle()
    board.run(board.now + BOOTED)
    assert board.bootloader is not None
    board.copy_uf2(image)
    assert until_it_answers(board) == ours


@pytest.mark.deep(gate="tests/emulator/test_loader.py::test_one_that_hangs_is_given_up_by_itself")
@pytest.mark.parametrize(("after_ms", "same"), [(0, False), (3, False), (20, True), (90, False)])
def test_what_was_flashed_over_usb_starts_whatever_update_was_pending(
    board: EmulatedBoard, image: Path, third: Path, new: Application, ours: str, after_ms: int, same: bool
) -> None:
    """Power goes at any moment after the acknowledgement, and the next start is with BOOTSEL held."""
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
