"""Makes the UF2 a user flashes from the linked image: `uf2.py rp2040 image.elf image.uf2`. Standard library only.

Fills in the CRC32 that the boot ROM of an RP2040 wants behind the second stage, and the application's size and CRC-32
of application.h (in the ELF too, so that a debugger flashes the same bytes), checks the budgets and prints them.
"""

import struct
import sys
import zlib
from pathlib import Path

FLASH_START = 0x10000000
APPLICATION_BUDGET, RAM_BUDGET, LOADER_BUDGET = 64 * 1024, 96 * 1024, 4 * 1024  # bytes
BOOT2_BYTES, PAGE_BYTES = 256, 256
FAMILIES = {"rp2040": 0xE48BFF56, "rp2350": 0xE48BFF59}  # the latter for its Arm cores, Secure
APPLICATION, SIZE_AT = 0x1000, 192  # rp2040.ld, application.h
RECORDS_END = 0x13000  # flash.h: blank in the UF2, so that nothing recorded before starts another application
RAM_START, RAM_END = 0x20000000, 0x20040000
PT_LOAD = 1


def crc32_boot2(data: bytes) -> int:
    """The boot ROM's: polynomial 0x04C11DB7, most significant bit first, from all ones, not reflected."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte << 24
        for _ in range(8):
            crc = ((crc << 1) ^ 0x04C11DB7 if crc & 0x80000000 else crc << 1) & 0xFFFFFFFF
    return crc


def segments(elf: bytes) -> list[tuple[int, int, int, int, int]]:
    """(file offset, physical address, virtual address, bytes in the file, bytes in memory) of what is loaded."""
    if elf[:6] != b"\x7fELF\x01\x01":
        raise SystemExit("uf2.py: not a little-endian 32-bit ELF")
    offset, size, count = struct.unpack_from("<I", elf, 28)[0], *struct.unpack_from("<HH", elf, 42)
    headers = [struct.unpack_from("<8I", elf, offset + i * size) for i in range(count)]
    return [(h[1], h[3], h[2], h[4], h[5]) for h in headers if h[0] == PT_LOAD and h[5] > 0]


def uf2(image: bytes, family: int) -> bytes:
    """Blocks of 256 payload bytes in 512."""
    pages = [image[i : i + PAGE_BYTES].ljust(PAGE_BYTES, b"\xff") for i in range(0, len(image), PAGE_BYTES)]
    blocks = []
    for number, page in enumerate(pages):
        address = FLASH_START + number * PAGE_BYTES
        head = struct.pack("<8I", 0x0A324655, 0x9E5D5157, 0x2000, address, PAGE_BYTES, number, len(pages), family)
        blocks.append((head + page).ljust(508, b"\0") + struct.pack("<I", 0x0AB16F30))
    return b"".join(blocks)


def put(elf: bytearray, image: bytearray, at: int, word: int) -> None:
    """A word into the image and into the segment of the ELF that is loaded there."""
    image[at : at + 4] = struct.pack("<I", word)
    for offset, physical, _, in_file, _ in segments(elf):
        if physical <= FLASH_START + at < physical + in_file:
            place = offset + FLASH_START + at - physical
            elf[place : place + 4] = struct.pack("<I", word)


def main(chip: str, elf_path: Path, uf2_path: Path) -> None:
    elf = bytearray(elf_path.read_bytes())
    image = bytearray()
    ram = loader = 0
    for offset, physical, virtual, in_file, in_memory in sorted(segments(elf), key=lambda s: s[1]):
        if RAM_START <= virtual < RAM_END:
            ram += in_memory
        if in_file and physical < FLASH_START + 0x01000000:
            loader = loader or len(image)
            image = image.ljust(physical - FLASH_START, b"\xff") + elf[offset : offset + in_file]
    if chip == "rp2040":
        put(elf, image, BOOT2_BYTES - 4, crc32_boot2(bytes(image[: BOOT2_BYTES - 4])))
    put(elf, image, APPLICATION + SIZE_AT, len(image) - APPLICATION)
    application = len(image) - APPLICATION
    put(elf, image, len(image) - 4, zlib.crc32(image[APPLICATION:-4]))
    said = (
        f"{chip}: application {application} of {APPLICATION_BUDGET} bytes, RAM {ram} of {RAM_BUDGET} bytes with it,"
        f" loader {loader} of {LOADER_BUDGET} bytes"
    )
    if application > APPLICATION_BUDGET or ram > RAM_BUDGET or loader > LOADER_BUDGET:
        raise SystemExit(f"uf2.py: over budget: {said}")
    print(said)
    elf_path.write_bytes(elf)
    uf2_path.write_bytes(uf2(bytes(image.ljust(RECORDS_END, b"\xff")), FAMILIES[chip]))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]))
