"""Flashing by PICOBOOT against a boot ROM that does what the real one's code does; see boot_rom.py."""

import errno
import struct
from collections.abc import Callable

import pytest
import usb.core
from boot_rom import FLASH, SECTOR, Board, Bus, usb_error
from hypothesis import given, settings
from hypothesis import strategies as st
from test_image import program

from annulus_pipe.flash.chips import RP2040, RP2350
from annulus_pipe.flash.picoboot import (
    CommandId,
    PicoBoot,
    PicoBootStatus,
    choose,
    command,
    find_boot_loaders,
    parse_status,
    write_flash,
)
from annulus_pipe.shipped import UDEV, shipped
from annulus_pipe.vocabulary import AnnulusError

IMAGE = program(3 * SECTOR + 512, seed=4)


def put(board: Board, data: bytes = IMAGE, progress: Callable[[str, int, int], None] | None = None) -> None:
    with PicoBoot(choose(find_boot_loaders(Bus(board)))) as boot:
        write_flash(boot, data, progress)
        boot.reboot()


def one_line(act: Callable[[], object]) -> str:
    with pytest.raises(AnnulusError) as caught:
        act()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def failing(what: str, number: int, nth: int = 1) -> Callable[[Board, str], None]:
    """The nth time the board does this, USB reports an error instead."""
    count = 0

    def before(board: Board, doing: str) -> None:
        nonlocal count
        count += doing == what
        if doing == what and count == nth:
            if number == errno.ENODEV:
                board.plugged = False
            raise usb_error(number)

    return before


# ---- bytes ----


def test_a_command_is_the_32_bytes_of_the_boot_roms_header() -> None:
    wire = command(CommandId.WRITE, 7, b"\x00\x01\x00\x10\x00\x10\x00\x00", 4096)
    assert wire.hex() == ("0bd11f4307000000050800000010000000010010001000000000000000000000")
    assert command(CommandId.EXIT_XIP, 1)[8:16] == bytes((6, 0, 0, 0, 0, 0, 0, 0))


@given(st.binary(max_size=40))
def test_a_status_is_16_bytes_or_refused(data: bytes) -> None:
    if len(data) != 16:
        with pytest.raises(ValueError):
            parse_status(data)
        return
    status = parse_status(data)
    assert status.token == int.from_bytes(data[:4], "little")
    assert (status.text in {code.name.lower() for code in PicoBootStatus}) == (status.code <= 8)


# ---- flashing ----


@settings(max_examples=25, deadline=None)
@given(pages=st.integers(3, 50), seed=st.integers(0, 999))
def test_what_was_asked_for_stands_in_the_flash_and_nothing_else_is_touched(pages: int, seed: int) -> None:
    data = program(256 * pages, seed=seed)
    board = Board()
    put(board, data)
    sectors = -(-len(data) // SECTOR)
    assert bytes(board.flash[: len(data)]) == data
    assert set(board.flash[len(data) : sectors * SECTOR]) <= {0xFF}
    assert set(board.flash[sectors * SECTOR :]) == {0x55}
    assert board.erased == [FLASH + i * SECTOR for i in range(sectors)]
    assert board.exclusive and board.rebooted and not board.claimed


def test_the_page_without_which_nothing_starts_is_written_last_after_all_was_read_back() -> None:
    board = Board()
    put(board)
    assert board.programmed[-1] == FLASH and board.programmed.count(FLASH) == 1
    last_write = len(board.commands) - 1 - board.commands[::-1].index(CommandId.WRITE)
    assert board.commands[last_write:] == [CommandId.WRITE, CommandId.READ, CommandId.REBOOT]
    assert board.commands.count(CommandId.READ) == 5  # four sectors, and the first page
    assert board.commands[:3] == [CommandId.EXCLUSIVE_ACCESS, CommandId.EXIT_XIP, CommandId.FLASH_ERASE]


def test_progress_is_told_to_its_end() -> None:
    told: list[tuple[str, int, int]] = []
    put(Board(), progress=lambda *step: told.append(step))
    assert told == [(what, i, 4) for what in ("erasing", "writing", "reading back") for i in (1, 2, 3, 4)]


def starts(board: Board) -> bool:
    """Whether the boot ROM would start what is in the flash."""
    return bytes(board.flash[:256]) == IMAGE[:256]


@pytest.mark.parametrize("what", ["erase", "write", "read"])
@pytest.mark.parametrize("nth", [1, 2, 4])
def test_pulled_out_half_way_it_comes_up_in_its_boot_loader_and_can_be_flashed(what: str, nth: int) -> None:
    board = Board(before=failing(what, errno.ENODEV, nth))
    assert "went away while" in one_line(lambda: put(board))
    assert not starts(board) and set(board.flash[:256]) <= {0xFF, 0x55}
    board.plugged, board.before = True, lambda board, what: None
    board.configure()
    put(board)
    assert starts(board) and bytes(board.flash[: len(IMAGE)]) == IMAGE


def test_a_bit_that_cannot_be_written_is_found_and_the_board_does_not_start() -> None:
    at = next(i for i in range(5000, 6000) if IMAGE[i] & 0x10)
    board = Board(stuck_bits={FLASH + at: 0x10})
    assert f"flash at {FLASH + at:08x} reads {IMAGE[at] & ~0x10:02x}, written {IMAGE[at]:02x}" in one_line(
        lambda: put(board)
    )
    assert not starts(board) and not board.rebooted


def test_a_bit_of_the_very_first_page_is_found_as_well() -> None:
    at = next(i for i in range(256) if IMAGE[i] & 1)
    board = Board(stuck_bits={FLASH + at: 1})
    assert f"flash at {FLASH + at:08x}" in one_line(lambda: put(board))
    assert not board.rebooted


def test_an_erase_the_boot_rom_only_pretends_to_have_done_is_found() -> None:
    board = Board()
    with PicoBoot(choose(find_boot_loaders(Bus(board)))) as boot:
        boot.erase(FLASH + 1, 4096)  # refused inside, acknowledged outside, as the boot ROM's code does
    assert board.erased == [] and board.status[1] == PicoBootStatus.OK
    board.before = lambda board, what: setattr(board, "xip_exited", False)  # the first erase is the last
    assert "reads ff, written" in one_line(lambda: put(board))


@pytest.mark.parametrize(
    ("act", "why"),
    [
        (lambda boot: boot.write(FLASH + 128, bytes(256)), "bad_alignment"),
        (lambda boot: boot.write(0x40000000, bytes(256)), "invalid_address"),
        (lambda boot: boot.read(0x11000000, 256), "invalid_address"),
        (lambda boot: boot._run(CommandId.EXIT_XIP, b"\0"), "invalid_cmd_length"),
        (lambda boot: boot._run(CommandId.WRITE, bytes(8), b"x" * 256), "invalid_transfer_length"),
    ],
)
def test_after_a_stall_the_reason_is_told_and_the_interface_works_again(
    act: Callable[[PicoBoot], object], why: str
) -> None:
    board = Board()
    with PicoBoot(choose(find_boot_loaders(Bus(board)))) as boot:
        assert why in one_line(lambda: act(boot))
        assert board.halted == set()
        write_flash(boot, IMAGE)
    assert bytes(board.flash[: len(IMAGE)]) == IMAGE


def test_a_board_that_stalled_for_an_earlier_program_is_put_right_when_opened() -> None:
    board = Board()
    board.halted |= {0x03, 0x84}
    put(board)
    assert starts(board)


@pytest.mark.parametrize("what", ["exclusive", "erase", "write", "read"])
def test_no_answer_is_told(what: str) -> None:
    assert "no answer in time" in one_line(lambda: put(Board(before=failing(what, errno.ETIMEDOUT))))


def test_a_board_that_is_gone_before_it_says_yes_to_the_restart_is_restarted() -> None:
    board = Board(before=failing("reboot", errno.ENODEV))
    put(board)
    assert starts(board)


# ---- finding ----


def test_no_permission_names_the_rule_and_how_to_install_it() -> None:
    text = one_line(lambda: put(Board(open_error=errno.EACCES)))
    assert "USB 1-2: no permission" in text
    assert f"sudo cp {shipped(UDEV)} /etc/udev/rules.d/ && sudo udevadm control --reload" in text


def test_a_boot_loader_in_use_is_told() -> None:
    assert "another program" in one_line(lambda: put(Board(claim_error=errno.EBUSY)))


def test_two_boards_are_listed_and_one_is_chosen_by_serial_or_place() -> None:
    # all chips of a revision have the same serial number: the boot ROM makes it of its own version
    boards = [Board(ports=(4,)), Board(ports=(1, 3)), Board(ports=(2,), serial="E0C912952D54")]
    found = find_boot_loaders(Bus(*boards))
    assert [b.place for b in found] == ["1-1.3", "1-2", "1-4"]
    text = one_line(lambda: choose(found))
    assert (
        "3 boards in their boot loaders, name one by place or serial: 1-1.3 (E0C9125B0D9B), 1-2 (E0C912952D54)" in text
    )
    assert choose(found, "E0C912952D54").place == "1-2"
    assert choose(found, "1-4").place == "1-4"
    assert "2 boards" in one_line(lambda: choose(found, "E0C9125B0D9B"))
    assert "no board 1-9 in its boot loader, there is" in one_line(lambda: choose(found, "1-9"))


def test_no_board_says_what_to_do() -> None:
    assert "Hold BOOTSEL" in one_line(lambda: choose(find_boot_loaders(Bus())))


def test_a_serial_number_nobody_may_read_does_not_hide_the_board() -> None:
    [found] = find_boot_loaders(Bus(Board(open_error=errno.EACCES)))
    assert found.serial is None and "not readable" in str(found)


def test_an_rp2350_is_flashed_and_restarted_by_its_own_command() -> None:
    board = Board(product=0x000F, serial="51A8E9F3C0D2B471")
    put(board)
    assert bytes(board.flash[: len(IMAGE)]) == IMAGE and board.rebooted
    assert struct.unpack("<IIII", board.reboot_arguments) == (0, 500, 0, 0)


def test_a_board_with_another_chip_than_the_images_is_refused_and_never_taken_instead() -> None:
    pico, pico2 = Board(ports=(1,)), Board(ports=(2,), product=0x000F)
    found = find_boot_loaders(Bus(pico, pico2))
    assert choose(found, chip=RP2040).place == "1-1"
    assert choose(found, chip=RP2350).place == "1-2"
    told = "the board at USB 1-2 is an RP2350 (Pico 2), the image is for an RP2040 (Pico)"
    assert one_line(lambda: choose(found, "1-2", RP2040)) == told
    assert one_line(lambda: choose(found[1:], chip=RP2040)) == told


def test_a_boot_loader_without_picoboot_is_told() -> None:
    assert "no PICOBOOT interface" in one_line(lambda: put(Board(has_picoboot=False)))


def test_no_libusb_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def find(**_: object) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", find)
    assert "libusb-1.0-0" in one_line(find_boot_loaders)
