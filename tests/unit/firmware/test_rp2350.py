"""The image for the RP2350, by what its file holds: nothing here runs it. firmware/README.md says what that leaves."""

import struct
import subprocess
import zlib
from pathlib import Path

import pytest

BUILD = Path(__file__).resolve().parents[3] / "firmware/build"
FLASH, APPLICATION, SIZE_AT, NAME_AT = 0x10000000, 0x1000, 192, 196
SIGNATURE_BYTES = 64  # application.h
# RP2350 datasheet 5.9.5: IMAGE_TYPE of an executable, Arm, Secure; the last item; the next block is this one.
IMAGE_DEF = struct.pack("<5I", 0xFFFFDED3, 0x10210142, 0x000001FF, 0, 0xAB123579)
RP2350_ARM_S = 0xE48BFF59
IRQ = {"timer0": 0, "timer1": 1, "usb": 14, "io_bank0": 21, "uart0": 33}  # datasheet 3.2


@pytest.fixture(scope="module", autouse=True)
def images() -> None:
    """Built anew where anything is newer: one that is not there must not pass for one that is right."""
    subprocess.run(["make", "--silent", "-C", str(BUILD.parent), "image"], check=True, stdout=subprocess.DEVNULL)


class Elf:
    """Symbols of a linked image, and the words at them."""

    def __init__(self, path: Path) -> None:
        self.bytes = path.read_bytes()
        table, size, count = struct.unpack_from("<I", self.bytes, 32)[0], *struct.unpack_from("<HH", self.bytes, 46)
        self.sections = [struct.unpack_from("<10I", self.bytes, table + i * size) for i in range(count)]
        symbols = next(s for s in self.sections if s[1] == 2)
        names = self.sections[symbols[6]][4]
        self.symbols: list[tuple[str, int, int, int]] = []  # name, address, bytes, section
        for at in range(symbols[4], symbols[4] + symbols[5], 16):
            name_at, value, length, _, _, section = struct.unpack_from("<IIIBBH", self.bytes, at)
            name = self.bytes[names + name_at : self.bytes.index(b"\0", names + name_at)].decode()
            self.symbols.append((name, value, length, section))

    def address(self, name: str) -> int:
        return next(value for found, value, _, _ in self.symbols if found == name)

    def pio_programs(self) -> list[tuple[int, ...]]:
        """The tables called program or counter: what goes into the PIOs' memories."""
        found = []
        for name, value, length, section in self.symbols:
            if name.split(".")[0] in ("program", "counter") and length:
                at = self.sections[section][4] + value - self.sections[section][3]
                found.append(struct.unpack_from(f"<{length // 2}H", self.bytes, at))
        return sorted(found)


@pytest.fixture(scope="module")
def flash() -> bytes:
    """What the UF2 puts there."""
    blocks = (BUILD / "annulus-rp2350.uf2").read_bytes()
    pages = []
    for number, at in enumerate(range(0, len(blocks), 512)):
        _, _, flags, address, size, index, count, family = struct.unpack_from("<8I", blocks, at)
        assert (flags, address, size, index) == (0x2000, FLASH + 256 * number, 256, number)
        assert (count, family) == (len(blocks) // 512, RP2350_ARM_S)
        pages.append(blocks[at + 32 : at + 288])
    return b"".join(pages)


def test_the_boot_rom_finds_an_image_def_and_enters_the_loader_with_a_stack(flash: bytes) -> None:
    assert flash[:4096].count(IMAGE_DEF) == 1
    stack, entry = struct.unpack_from("<2I", flash)
    assert entry == Elf(BUILD / "rp2350/loader.elf").address("loader_enter") | 1
    assert FLASH <= entry < FLASH + 4096 and stack == 0x20081000


def test_the_application_is_laid_out_as_every_loader_expects_it(flash: bytes) -> None:
    application = flash[APPLICATION:]
    (size,) = struct.unpack_from("<I", application, SIZE_AT)
    assert application[NAME_AT:].startswith(b"annulus rp2350 ")
    assert size <= 64 * 1024
    assert struct.unpack_from("<I", application, size - 4) == (zlib.crc32(application[: size - 4]),)
    stack, entry = struct.unpack_from("<2I", application)
    assert stack == 0x20081000 and 0x20000000 <= entry < 0x20000000 + size


def test_every_interrupt_that_is_used_leads_to_its_handler_and_the_table_is_aligned(flash: bytes) -> None:
    elf = Elf(BUILD / "annulus-rp2350.elf")
    at = elf.address("interrupt_vectors")
    assert at % 512 == 0  # 68 vectors, rounded up to 128
    vectors = struct.unpack_from("<68I", flash, APPLICATION + at - 0x20000000)
    assert vectors[:2] == struct.unpack_from("<2I", flash, APPLICATION)
    handlers = ("alarm", "stuck", "usb", "pins", "serial")
    for number, handler in zip(IRQ.values(), handlers, strict=True):
        assert vectors[16 + number] == elf.address(f"{handler}_handler") | 1
    assert all(vectors[n] == elf.address("fault_handler") | 1 for n in (2, 3, 4, 5, 6, 7))
    assert sum(vector != 0 for vector in vectors[16:]) == len(IRQ)


def test_pio_programs_are_those_of_the_rp2040() -> None:
    programs = Elf(BUILD / "annulus-rp2350.elf").pio_programs()
    assert len(programs) == 3 and programs == Elf(BUILD / "annulus.elf").pio_programs()


def test_both_images_keep_room_for_a_signature_before_their_crc() -> None:
    for board in ("annulus", "annulus-rp2350"):
        blocks = (BUILD / f"{board}.uf2").read_bytes()
        data = b"".join(blocks[at + 32 : at + 288] for at in range(0, len(blocks), 512))[APPLICATION:]
        (size,) = struct.unpack_from("<I", data, SIZE_AT)
        assert data[size - 4 - SIGNATURE_BYTES : size - 4] == b"\xff" * SIGNATURE_BYTES, board
