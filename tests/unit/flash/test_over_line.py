"""An update through the line, with a scripted controller that keeps its rules and a line that comes and goes."""

import struct
import zlib
from collections.abc import Callable

import pytest
from boot_rom import Board, Bus
from test_client import far_end, serving
from test_image import program, uf2

from annulus_pipe.flash import over_line, update
from annulus_pipe.flash.image import (
    APPLICATION_AT,
    APPLICATION_SIZE_AT,
    RECORDS_AT,
    RECORDS_END,
    FlashImage,
    application,
    has_application,
    parse_image,
)
from annulus_pipe.flash.over_line import UpdateRefused, write_over_line
from annulus_pipe.flash.update import flash
from annulus_pipe.link.messages import (
    BOOTLOADER_NEEDS_USB,
    SCHEMA_HASH,
    Bootloader,
    BootloaderReply,
    Command,
    Identify,
    Reply,
    StatusCode,
    UpdateBegin,
    UpdateBeginReply,
    UpdateData,
    UpdateDataReply,
    UpdateEnd,
    UpdateEndReply,
    UpdateRefusal,
)
from annulus_pipe.testing.scripted import ScriptedController
from annulus_pipe.vocabulary import AnnulusError

SIZE = 3000


def whole(size: int = SIZE, board: str = "rp2040") -> bytes:
    """Flash contents as the linker lays them out: second stage and loader, then vectors, size, identity, CRC."""
    loader = program(APPLICATION_AT, said=b"")
    said = f"annulus {board} 0.2.0 deadbeef protocol 1U schema 0x{SCHEMA_HASH:08X}U\0".encode()
    body = bytes(APPLICATION_SIZE_AT) + struct.pack("<I", size) + said
    body = body.ljust(size - 4, b"\x5a")
    return loader + body + struct.pack("<I", zlib.crc32(body))


def image_of(data: bytes) -> FlashImage:
    return parse_image(bytes(uf2(data)), "annulus.uf2")


class Updating(ScriptedController):
    """Takes updates as firmware/core/update.c does. `dumb_from`: from the nth chunk on nothing it says
    arrives, until somebody identifies."""

    def __init__(self, *, dumb_from: int | None = None, board: bytes = b"rp2040\0\0", knows: bool = True) -> None:
        super().__init__()
        self.staged = bytearray()
        self.size = self.crc = 0
        self.under_way = False
        self.board, self.knows, self.dumb_from = board, knows, dumb_from
        self.dumb = False
        self.chunks = 0
        self.taken: bytes | None = None
        self.spoil: Callable[[bytearray], None] = lambda staged: None

    def take(self) -> bytes:
        out = super().take()
        return b"" if self.dumb else out

    def _execute(self, command: Command, now: int) -> Reply:
        if isinstance(command, Identify):
            self.dumb = self.under_way = False
        reply = self._update(command)
        return super()._execute(command, now) if reply is None else reply

    def _update(self, command: Command) -> Reply | None:
        due = len(self.staged)
        match command:
            case UpdateBegin(size, crc, board):
                if board != self.board:
                    return UpdateBeginReply(StatusCode.OUT_OF_RANGE, 2, 0)
                if UpdateBegin in self.refuse:
                    return UpdateBeginReply(*self.refuse[UpdateBegin], 0)
                if (size, crc) != (self.size, self.crc):
                    self.staged.clear()
                self.size, self.crc, self.under_way = size, crc, True
                return UpdateBeginReply(StatusCode.OK, 0, len(self.staged))
            case UpdateData(offset, chunk):
                self.chunks += 1
                self.dumb = self.dumb or self.chunks == self.dumb_from
                if not self.under_way:
                    return UpdateDataReply(StatusCode.BAD_STATE, UpdateRefusal.NOT_NOW, due)
                if offset > due:
                    return UpdateDataReply(StatusCode.BAD_STATE, UpdateRefusal.INCOMPLETE, due)
                self.staged += chunk if offset == due else b""
                return UpdateDataReply(StatusCode.OK, 0, len(self.staged))
            case UpdateEnd():
                self.spoil(self.staged)
                data = bytes(self.staged[: self.size])
                if zlib.crc32(data[:-4]) != self.crc:
                    return UpdateEndReply(StatusCode.BAD_STATE, UpdateRefusal.DAMAGED, 0)
                self.taken = data
                return UpdateEndReply(StatusCode.OK, 0, len(self.staged))
            case Bootloader():
                return BootloaderReply(StatusCode.BAD_STATE, BOOTLOADER_NEEDS_USB)
        return None


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    for module, name, value in ((over_line, "AGAIN_S", 0.01), (update, "BACK_S", 0.4), (update, "LOOK_S", 0.01)):
        monkeypatch.setattr(module, name, value)


def why(head: ScriptedController, image: FlashImage, error: type[AnnulusError] = AnnulusError) -> str:
    with far_end(serving(head)) as port, pytest.raises(error) as caught:
        flash(image, port=port)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_head_on_another_line_than_usb_takes_the_image_over_it() -> None:
    data = whole()
    head = Updating()
    said: list[str] = []
    told: list[tuple[str, int, int]] = []
    with far_end(serving(head)) as port:
        done = flash(image_of(data), port=port, say=said.append, progress=lambda *now: told.append(now))
    assert head.taken == data[APPLICATION_AT:]
    assert (done.how, done.where, done.read_back, done.running) == ("line", port, True, "deadbeef")
    assert said == [f"{port}: sending the image over this line", f"{port}: restarting into it"]
    assert told[-1] == ("sending", SIZE, SIZE)
    assert [now for _, now, _ in told] == sorted(now for _, now, _ in told)


@pytest.mark.parametrize("nth", [1, 40])
def test_a_line_that_goes_away_costs_nothing_but_time(nth: int) -> None:
    data = whole()
    head = Updating(dumb_from=nth)
    with far_end(serving(head)) as port:
        assert write_over_line(port, application(image_of(data)))
    assert head.taken == data[APPLICATION_AT:]
    assert head.chunks <= -(-SIZE // 32) + 6  # it went on where it broke off; repeats of the chunk nobody answered


def test_a_line_that_stays_away_is_told_with_how_far_it_came(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(over_line, "PATIENCE_S", 0.1)

    class Gone(Updating):
        def _execute(self, command: Command, now: int) -> Reply:
            reply = super()._execute(command, now)
            self.dumb = self.chunks >= 10
            return reply

    said = why(Gone(), image_of(whole()))
    assert "broke off after" in said and "The head runs on as before" in said


def test_what_cannot_help_is_not_tried_again() -> None:
    image = image_of(whole())
    assert "another board, the image for rp2040" in why(Updating(board=b"native\0\0"), image, UpdateRefused)
    small = Updating()
    small.refuse[UpdateBegin] = (StatusCode.OUT_OF_RANGE, 0)  # of 28 KiB, in one slot
    assert "no room for" in why(small, image, UpdateRefused)
    armed = Updating()
    armed.refuse[UpdateBegin] = (StatusCode.BAD_STATE, 0)
    assert "annulus head disarm" in why(armed, image, UpdateRefused)
    spoilt = Updating()
    spoilt.spoil = lambda staged: staged.__setitem__(500, 0)
    assert "another CRC" in why(spoilt, image, UpdateRefused)


def test_older_firmware_without_usb_is_never_sent_into_its_boot_loader(monkeypatch: pytest.MonkeyPatch) -> None:
    """It would acknowledge `bootloader` and be silent until its power is switched off."""
    monkeypatch.setattr(update, "find_controllers", list)

    class Older(Updating):
        def receive(self, data: bytes, now: int) -> None:
            for frame in filter(None, data.split(b"\0")):
                if len(frame) > 1 and frame[1] not in (0x14, 0x0D):  # it has no layout for these, or must not hear it
                    super().receive(frame + b"\0", now)

        def _update(self, command: Command) -> Reply | None:
            assert not isinstance(command, Bootloader)
            return None

    assert "the boot loader speaks USB only" in why(Older(), image_of(whole()))


def test_only_an_image_with_a_whole_application_goes_over_a_line() -> None:
    old = image_of(program(2048))
    assert not has_application(old)
    with pytest.raises(AnnulusError, match="holds no application"):
        application(old)
    damaged = bytearray(whole())
    damaged[APPLICATION_AT + 1000] ^= 1
    with pytest.raises(AnnulusError, match="damaged"):
        application(image_of(bytes(damaged)))
    damaged = bytearray(whole())
    damaged[APPLICATION_AT + APPLICATION_SIZE_AT + 2] = 0xFF
    with pytest.raises(AnnulusError, match="damaged"):
        application(image_of(bytes(damaged)))


@pytest.mark.parametrize("ours", [True, False])
def test_after_picoboot_nothing_recorded_starts_another_application(ours: bool) -> None:
    board = Board()
    image = image_of(whole() if ours else program(8192))
    done = flash(image, backend=Bus(board))
    assert done.read_back and board.rebooted
    assert set(board.flash[RECORDS_AT:RECORDS_END]) == ({0xFF} if ours else {0x55})
