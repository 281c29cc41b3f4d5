"""Firmware images as a user flashes them: a UF2 or the linked ELF, read without running them and judged before a board
is touched.

    image = read_image(Path("annulus.uf2"))     # AnnulusError: not an image, for another board, incomplete, damaged
    require_ours(image)                         # AnnulusError: sound, but not a controller this host can talk to

Sources: UF2 specification (Microsoft); RP2040 datasheet §2.8.1 (boot sequence: 256 bytes of second stage, CRC32 in the
last word) and §2.8.4.2 (which UF2 blocks the boot ROM takes); RP2350 datasheet §5.9.5 (an IMAGE_DEF in the first 4 KiB,
and the vector table at the start).
"""

import re
import struct
import zlib
from dataclasses import dataclass, replace
from pathlib import Path

from annulus_pipe.controller import UPDATE_MAX_BYTES
from annulus_pipe.flash.chips import CHIPS, RP2040, RP2350, Chip
from annulus_pipe.link.messages import PROTOCOL_VERSION, SCHEMA_HASH
from annulus_pipe.untrusted import read_file
from annulus_pipe.vocabulary import AnnulusError

FLASH_START = 0x10000000
FILE_MAX = 64 << 20  # bytes; a UF2 of the whole flash has 4 MiB, an ELF carries what debuggers want beside it
PAGE_BYTES, SECTOR_BYTES = 256, 4096
BOOT2_BYTES = 256
APPLICATION_AT, APPLICATION_SIZE_AT = 0x1000, 192  # in flash, its first slot; in the application
RECORDS_AT, RECORDS_END = 0x11000, 0x13000  # in flash: which slot starts; blank, so that it is the first
RAM_START = 0x20000000
IMAGE_DEF_WITHIN = 4096  # bytes of flash in which the boot ROM of an RP2350 looks
_IMAGE_DEF = struct.pack("<5I", 0xFFFFDED3, 0x10210142, 0x1FF, 0, 0xAB123579)  # Arm, Secure; the least there is

_BLOCK_BYTES = 512
_MAGIC = (0x0A324655, 0x9E5D5157, 0x0AB16F30)
_NOT_MAIN_FLASH, _HAS_FAMILY = 0x0001, 0x2000
_FAMILIES = {  # of microsoft/uf2's list, those a user may have at hand
    0xE48BFF57: "RP2350, absolute",
    0xE48BFF58: "RP2350, data",
    0xE48BFF5A: "RP2350, RISC-V",
    0xE48BFF5B: "RP2350, non-secure",
    0x68ED2B88: "SAMD21",
    0x55114460: "SAMD51",
    0xADA52840: "nRF52840",
    0xBFDD4EEE: "ESP32-S2",
    0xC47E5767: "ESP32-S3",
}
_PT_LOAD, _EM_ARM = 1, 40
_LEVEL = re.compile(rb"annulus level (\d+)U?\0")
_IDENTITY = re.compile(rb"annulus (\w+) (\S+) (\S+) protocol (\d+)U? schema 0x([0-9A-Fa-f]{8})U?\0")


@dataclass(frozen=True, slots=True)
class Identity:
    """What an annulus image says of itself."""

    board: str
    version: str
    git: str
    protocol: int
    schema: int
    level: int = 1

    @property
    def fits(self) -> bool:
        """Whether this host speaks its protocol: else it can only be diagnosed and flashed anew. Levels may differ."""
        return (self.protocol, self.schema) == (PROTOCOL_VERSION, SCHEMA_HASH)


@dataclass(frozen=True, slots=True)
class FlashImage:
    """Flash contents from FLASH_START on, whole pages; gaps are as erased, as uf2.py fills them."""

    name: str
    data: bytes
    identity: Identity | None  # None: somebody else's program
    chip: Chip = RP2040

    @property
    def sectors(self) -> int:
        return -(-len(self.data) // SECTOR_BYTES)


@dataclass(frozen=True, slots=True)
class Application:
    """What the loader starts; firmware/application.h says how it is laid out."""

    data: bytes
    crc: int  # of all but the last word, which holds it
    board: str


def read_image(path: Path) -> FlashImage:
    """The image in a UF2 or ELF file, checked. AnnulusError says what is wrong with it."""
    try:
        content = read_file(path, FILE_MAX)
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}), expected a UF2 or ELF.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}, expected a UF2 or ELF.") from None
    return parse_image(content, str(path))


def parse_image(content: bytes, name: str) -> FlashImage:
    """As `read_image`, from bytes."""
    if content[:4] == b"\x7fELF":
        pages, chip = _elf_pages(content, name), None
    elif content[:4] == struct.pack("<I", _MAGIC[0]):
        pages, chip = _uf2_pages(content, name)
    else:
        raise AnnulusError(f"{name}: neither UF2 nor ELF, expected an image such as annulus.uf2")
    data = _flash(pages, name, chip or RP2350)
    if chip is None:  # an ELF says no family
        chip = RP2350 if _IMAGE_DEF in data[:IMAGE_DEF_WITHIN] else RP2040
    _require_bootable(data, name, chip)
    image = FlashImage(name, data, _identity(data), chip)
    if has_application(image):  # a debugger's ELF leaves the records out
        image = replace(image, data=data.ljust(RECORDS_END, b"\xff"))
        application(image)  # over USB as well: nobody should have to find it in the boot ROM
    holes = len(data) // PAGE_BYTES - len(pages)
    if holes and image.identity is not None and content[:4] != b"\x7fELF":  # what a linker leaves out, uf2.py fills in
        raise AnnulusError(f"{name}: damaged, {holes} pages between others are missing: a block has another's address")
    return image


def require_ours(image: FlashImage) -> None:
    """AnnulusError unless it is an annulus controller for this board that this host can talk to."""
    who = image.identity
    if who is None:
        raise AnnulusError(
            f"{image.name}: runs on an {image.chip} but is no annulus firmware. It is flashed only by force."
        )
    if who.board != image.chip.board:
        raise AnnulusError(f"{image.name}: annulus for board {who.board}, expected {image.chip.board}")
    if not who.fits:
        raise AnnulusError(
            f"{image.name}: speaks protocol {who.protocol} schema {who.schema:08x}, this host {PROTOCOL_VERSION}"
            f" {SCHEMA_HASH:08x}: it could not be armed. Take host and image from one release, or flash it by force."
        )


def has_application(image: FlashImage) -> bool:
    """Whether it is made of a loader and an application; images from before that are not."""
    return image.identity is not None and bool(_IDENTITY.match(image.data, APPLICATION_AT + APPLICATION_SIZE_AT + 4))


def application(image: FlashImage) -> Application:
    """What of an image a controller takes over its line: all but the loader in the first sector.

    AnnulusError for an image that has none, as those before the loader, or whose CRC says that it is damaged.
    """
    if image.identity is None or not has_application(image):
        raise AnnulusError(
            f"{image.name}: holds no application that a controller takes over its line. Flash it over USB."
        )
    data = image.data[APPLICATION_AT:]
    (size,) = struct.unpack_from("<I", data, APPLICATION_SIZE_AT)
    if not APPLICATION_SIZE_AT + 8 <= size <= min(len(data), UPDATE_MAX_BYTES):
        raise AnnulusError(f"{image.name}: damaged, an application of {size} bytes")
    (crc,) = struct.unpack_from("<I", data, size - 4)
    if crc != zlib.crc32(data[: size - 4]):
        raise AnnulusError(
            f"{image.name}: damaged, the application's CRC is {zlib.crc32(data[: size - 4]):08x}, not {crc:08x}"
        )
    return Application(data[:size], crc, image.identity.board)


def crc32_boot2(data: bytes) -> int:
    """The boot ROM's over the second stage: polynomial 0x04C11DB7, MSB first, from all ones, not reflected."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = (crc << 1) ^ (0x104C11DB7 if crc & 0x80000000 else 0)
    return crc


def _uf2_pages(content: bytes, name: str) -> tuple[dict[int, bytes], Chip]:
    """Payloads by address, and the chip they are all for.

    The file must be whole: the boot ROM would wait for a missing block for ever.
    """
    if len(content) % _BLOCK_BYTES:
        raise AnnulusError(f"{name}: truncated, {len(content)} bytes, expected a multiple of {_BLOCK_BYTES}")
    pages: dict[int, bytes] = {}
    numbers: set[int] = set()
    blocks = len(content) // _BLOCK_BYTES
    chip: Chip | None = None
    for at in range(0, len(content), _BLOCK_BYTES):
        start0, start1, flags, address, size, number, count, family = struct.unpack_from("<8I", content, at)
        where = f"{name}: block {at // _BLOCK_BYTES}"
        if (start0, start1, struct.unpack_from("<I", content, at + 508)[0]) != _MAGIC:
            raise AnnulusError(f"{where} is damaged, expected the marks of UF2")
        this = next((c for c in CHIPS if flags & _HAS_FAMILY and c.family == family), None)
        if this is None:
            board = _FAMILIES.get(family, f"family {family:08x}") if flags & _HAS_FAMILY else "no family"
            raise AnnulusError(f"{name}: made for another board ({board}), expected RP2040 or RP2350")
        chip = chip or this
        if this is not chip:
            raise AnnulusError(f"{where} is for an {this}, those before it for an {chip}: expected one board")
        if flags & _NOT_MAIN_FLASH:
            raise AnnulusError(f"{where} is not for the main flash, expected nothing else in it")
        if count != blocks or number >= count:
            raise AnnulusError(f"{name}: incomplete, {blocks} of {count} blocks")
        if number in numbers or address in pages:
            raise AnnulusError(f"{where} comes twice, expected every block once")
        if size != PAGE_BYTES or address % PAGE_BYTES:
            raise AnnulusError(f"{where} holds {size} bytes for {address:08x}, expected whole pages of {PAGE_BYTES}")
        numbers.add(number)
        pages[address] = content[at + 32 : at + 32 + PAGE_BYTES]
    if chip is None:
        raise AnnulusError(f"{name}: holds no block")
    return pages, chip


def _elf_pages(content: bytes, name: str) -> dict[int, bytes]:
    """What a debugger would load into flash, cut into pages."""
    try:
        if content[4:6] != b"\x01\x01" or struct.unpack_from("<H", content, 18)[0] != _EM_ARM:
            raise AnnulusError(f"{name}: an ELF for another processor, expected 32-bit ARM")
        table, size, count = struct.unpack_from("<I", content, 28)[0], *struct.unpack_from("<HH", content, 42)
        headers = [struct.unpack_from("<8I", content, table + i * size) for i in range(count)]
    except struct.error:
        raise AnnulusError(f"{name}: truncated, expected a whole ELF") from None
    pages: dict[int, bytearray] = {}
    for kind, offset, _, physical, in_file, _, _, _ in headers:
        if kind != _PT_LOAD or in_file == 0:
            continue
        if offset + in_file > len(content):
            raise AnnulusError(f"{name}: truncated, expected a whole ELF")
        if physical < FLASH_START or physical + in_file > FLASH_START + RP2350.flash_bytes:
            raise AnnulusError(f"{name}: loads {in_file} bytes to {physical:08x}, expected flash")
        for i in range(in_file):
            page = pages.setdefault((physical + i) & ~(PAGE_BYTES - 1), bytearray(b"\xff" * PAGE_BYTES))
            page[(physical + i) % PAGE_BYTES] = content[offset + i]
    return {address: bytes(page) for address, page in pages.items()}


def _flash(pages: dict[int, bytes], name: str, chip: Chip) -> bytes:
    if not pages:
        raise AnnulusError(f"{name}: holds nothing for the flash")
    first, last = min(pages), max(pages)
    flash_end = FLASH_START + chip.flash_bytes
    if first < FLASH_START or last + PAGE_BYTES > flash_end:
        raise AnnulusError(
            f"{name}: made for addresses {first:08x}..{last + PAGE_BYTES:08x}, expected flash from {FLASH_START:08x}"
            f" to {flash_end:08x}"
        )
    if first != FLASH_START:
        raise AnnulusError(f"{name}: begins at {first:08x}, expected what starts first at {FLASH_START:08x}")
    empty = b"\xff" * PAGE_BYTES
    return b"".join(pages.get(address, empty) for address in range(first, last + PAGE_BYTES, PAGE_BYTES))


def _require_bootable(data: bytes, name: str, chip: Chip) -> None:
    """What the boot ROM checks, and whether there is a program where it goes then."""
    if len(data) < BOOT2_BYTES + 8:
        raise AnnulusError(f"{name}: {len(data)} bytes hold no program")
    vectors_at = 0
    if chip is RP2040:
        vectors_at = BOOT2_BYTES
        found, wanted = struct.unpack_from("<I", data, BOOT2_BYTES - 4)[0], crc32_boot2(data[: BOOT2_BYTES - 4])
        if found != wanted:
            raise AnnulusError(
                f"{name}: CRC of the second stage is {found:08x}, expected {wanted:08x}: it would never start"
            )
    elif _IMAGE_DEF not in data[:IMAGE_DEF_WITHIN]:
        raise AnnulusError(f"{name}: no IMAGE_DEF for an {chip} in its first 4 KiB: it would never start")
    stack, entry = struct.unpack_from("<2I", data, vectors_at)
    entry_ok = entry & 1 and FLASH_START <= entry < FLASH_START + len(data)
    if not (RAM_START < stack <= chip.ram_end and stack % 4 == 0 and entry_ok):
        raise AnnulusError(
            f"{name}: no vector table at {FLASH_START + vectors_at:08x} (stack {stack:08x}, entry {entry:08x})"
        )


def _identity(data: bytes) -> Identity | None:
    match = _IDENTITY.search(data)
    if match is None:
        return None
    board, version, git, protocol, schema = (part.decode("ascii", "replace") for part in match.groups())
    level = _LEVEL.search(data)
    return Identity(board, version, git, int(protocol), int(schema, 16), int(level[1]) if level else 1)
