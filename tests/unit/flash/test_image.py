"""No file but a sound annulus image for this board gets near a board, and every refusal says why in one line."""

import random
import re
import struct
from pathlib import Path

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from annulus_pipe.flash.chips import CHIPS, RP2040, RP2350, Chip
from annulus_pipe.flash.image import (
    FLASH_START,
    FlashImage,
    application,
    crc32_boot2,
    parse_image,
    read_image,
    require_ours,
)
from annulus_pipe.flash.update import image_fields, to_uf2
from annulus_pipe.link.messages import SCHEMA_HASH
from annulus_pipe.shipped import shipped
from annulus_pipe.vocabulary import AnnulusError

# The least an RP2350 starts (datasheet 5.9.5): IMAGE_TYPE Arm, Secure, executable; last item; no other block.
IMAGE_DEF = bytes.fromhex("d3deffff 42012110 ff010000 00000000 793512ab")
BUILT = Path(__file__).resolve().parents[3] / "firmware/build"


def program(size: int = 1024, *, said: bytes | None = None, seed: int = 0) -> bytes:
    """Flash contents the boot ROM would start: second stage, vectors, what the image says of itself, noise."""
    stage = random.Random(seed).randbytes(252)
    vectors = struct.pack("<2I", 0x20041000, FLASH_START + 0x1C1)
    if said is None:
        said = b"annulus rp2040 0.1.0 deadbeef protocol 1U schema 0x%08XU\0" % SCHEMA_HASH
    body = (stage + struct.pack("<I", crc32_boot2(stage)) + vectors + said).ljust(512, b"\0")
    return body + random.Random(seed + 1).randbytes(size - 512)


def program_rp2350(size: int = 1024, board: bytes = b"rp2350") -> bytes:
    """The same for an RP2350: vectors, IMAGE_DEF."""
    vectors = struct.pack("<2I", 0x20081000, FLASH_START + 0x115)
    said = b"annulus %s 0.1.0 deadbeef protocol 1U schema 0x%08XU\0" % (board, SCHEMA_HASH)
    return (vectors.ljust(256, b"\0") + IMAGE_DEF + said).ljust(size, b"\x5a")


def uf2(data: bytes | None = None) -> bytearray:
    return bytearray(to_uf2(FlashImage("test", data or program(), None)))


def uf2_rp2350(data: bytes | None = None) -> bytearray:
    return bytearray(to_uf2(FlashImage("test", data or program_rp2350(), None, RP2350)))


def elf(data: bytes, cut: int = 300, machine: int = 40, address: int = FLASH_START) -> bytes:
    """Two segments of flash, as a linker leaves them, and one of RAM that holds nothing."""
    header = struct.pack(
        "<4s12xHHIIIIIHHHHHH", b"\x7fELF", 2, machine, 1, FLASH_START | 1, 52, 0, 0, 52, 32, 3, 0, 0, 0
    )
    header = header[:4] + b"\x01\x01\x01" + header[7:]
    at = 52 + 96
    segments = [(at, address, cut), (at + cut, address + cut, len(data) - cut), (0, 0x20000000, 0)]
    table = b"".join(struct.pack("<8I", 1, o, a, a, n, n or 64, 5, 4) for o, a, n in segments)
    return header + table + data


def refused(content: bytes) -> str:
    with pytest.raises(AnnulusError) as caught:
        require_ours(parse_image(bytes(content), "x.uf2"))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@settings(max_examples=40, deadline=None)
@given(pages=st.integers(3, 40), seed=st.integers(0, 2**32), order=st.randoms(use_true_random=False))
def test_a_uf2_is_read_whatever_the_order_of_its_blocks(pages: int, seed: int, order: random.Random) -> None:
    data = program(pages * 256, seed=seed)
    content = uf2(data)
    blocks = [bytes(content[i : i + 512]) for i in range(0, len(content), 512)]
    order.shuffle(blocks)
    image = parse_image(b"".join(blocks), "x.uf2")
    assert image.data == data
    assert image.identity is not None and image.identity.fits
    require_ours(image)


@settings(max_examples=25, deadline=None)
@given(pages=st.integers(3, 20), cut=st.integers(1, 700), seed=st.integers(0, 2**32))
def test_an_elf_holds_the_same_image_as_its_uf2(pages: int, cut: int, seed: int) -> None:
    data = program(pages * 256, seed=seed)
    assert parse_image(elf(data, cut), "x.elf").data == parse_image(bytes(uf2(data)), "x.uf2").data == data


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=1600) | st.builds(lambda rest: b"UF2\n" + rest, st.binary(max_size=1100)))
def test_bytes_that_are_no_image_are_refused_in_one_line(content: bytes) -> None:
    refused(content)


@settings(max_examples=80, deadline=None)
@given(at=st.integers(0, 4 * 512 - 1), bit=st.integers(0, 7))
@example(at=3 * 512 + 14, bit=0)  # the last block's address: 64 kB of nothing before it were taken for a part of it
def test_a_flipped_bit_is_refused_or_leaves_what_the_second_stages_crc_cannot_see(at: int, bit: int) -> None:
    content = uf2()
    content[at] ^= 1 << bit
    in_block, block = at % 512, at // 512
    checked = in_block < 32 or in_block >= 508 or (block == 0 and in_block < 32 + 256)
    if checked and in_block not in (8, 9, 10, 11):  # flags that say nothing to us may differ
        refused(content)


@settings(max_examples=60, deadline=None)
@given(cut=st.integers(0, 4 * 512 - 1))
def test_a_truncated_uf2_is_refused(cut: int) -> None:
    assert re.search("truncated|incomplete|neither UF2", refused(uf2()[:cut]))


def test_what_is_wrong_is_said() -> None:
    def changed(block: int, word: int, value: int) -> bytearray:
        content = uf2()
        struct.pack_into("<I", content, 512 * block + 4 * word, value)
        return content

    assert "another board (RP2350, RISC-V)" in refused(changed(0, 7, 0xE48BFF5A))
    assert "block 2 is for an RP2350 (Pico 2), those before it for an RP2040" in refused(changed(2, 7, 0xE48BFF59))
    assert "another board (SAMD51)" in refused(changed(3, 7, 0x55114460))
    assert "another board (family 12345678)" in refused(changed(1, 7, 0x12345678))
    assert "another board (no family)" in refused(changed(1, 2, 0))
    assert "not for the main flash" in refused(changed(2, 2, 0x2001))
    assert "block 2 is damaged" in refused(changed(2, 1, 0))
    assert "incomplete, 4 of 5 blocks" in refused(changed(1, 6, 5))
    assert "comes twice" in refused(changed(1, 5, 0))
    assert "comes twice" in refused(changed(1, 3, FLASH_START))
    assert "whole pages" in refused(changed(1, 4, 476))
    assert "whole pages" in refused(changed(1, 3, FLASH_START + 384))
    assert "addresses 10000000..20000100, expected flash" in refused(changed(3, 3, 0x20000000))
    assert "addresses 10000000..10200100, expected flash" in refused(changed(3, 3, 0x10200000))
    assert "begins at 10000100" in refused(changed(0, 3, FLASH_START + 0x2000))
    assert "CRC of the second stage" in refused(changed(0, 8 + 5, 0xDEADBEEF))
    assert "no vector table" in refused(changed(1, 8, 0x10000000))
    assert "no vector table" in refused(changed(1, 9, FLASH_START + 0x1C0))  # not Thumb
    assert "incomplete" in refused(uf2()[: 3 * 512])
    assert "truncated" in refused(uf2()[:-1])


def test_somebody_elses_program_needs_force() -> None:
    assert "no annulus firmware. It is flashed only by force" in refused(uf2(program(said=b"blink\0")))
    other = b"annulus rp2350 0.1.0 deadbeef protocol 1U schema 0x%08XU\0" % SCHEMA_HASH
    assert "for board rp2350" in refused(uf2(program(said=other)))
    old = b"annulus rp2040 0.0.9 deadbeef protocol 1U schema 0x00000001U\0"
    assert "schema 00000001, this host" in refused(uf2(program(said=old)))
    image = parse_image(bytes(uf2(program(said=old))), "x.uf2")  # but it can be looked at
    assert image_fields(image) == {
        "image": "x.uf2",
        "firmware": "annulus",
        "version": "0.0.9",
        "git": "deadbeef",
        "board": "rp2040",
        "bytes": 1024,
        "protocol": 1,
        "schema": "00000001",
        "level": 1,
        "fits_this_host": False,
    }


def test_an_image_of_any_level_fits_and_says_which() -> None:
    ours = b"annulus rp2040 0.1.0 deadbeef protocol 1U schema 0x%08XU\0" % SCHEMA_HASH
    for said, level in ((ours, 1), (ours + b"annulus level 2U\0", 2), (ours + b"annulus level 9U\0", 9)):
        image = parse_image(bytes(uf2(program(said=said))), "x.uf2")
        require_ours(image)
        assert image.identity is not None and image.identity.level == level


def test_an_elf_for_another_processor_or_place_is_refused() -> None:
    assert "another processor" in refused(elf(program(), machine=62))
    assert "expected flash" in refused(elf(program(), address=0x08000000))
    assert "truncated" in refused(elf(program())[:-600])
    assert "truncated" in refused(elf(program())[:60])


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(AnnulusError, match=r"none\.uf2: cannot be read \(No such file"):
        read_image(tmp_path / "none.uf2")


def test_an_image_for_an_rp2350_is_told_from_one_for_an_rp2040_and_both_are_held_to_what_their_rom_starts() -> None:
    image = parse_image(bytes(uf2_rp2350()), "x.uf2")
    require_ours(image)
    assert image.chip is RP2350 and image_fields(image)["board"] == "rp2350"
    assert parse_image(elf(program_rp2350()), "x.elf").chip is RP2350  # an ELF says no family
    assert parse_image(elf(program()), "x.elf").chip is RP2040
    assert "annulus for board rp2040, expected rp2350" in refused(uf2_rp2350(program_rp2350(board=b"rp2040")))
    assert "no IMAGE_DEF" in refused(uf2_rp2350(program_rp2350().replace(IMAGE_DEF[:4], b"\0" * 4)))
    assert "no IMAGE_DEF" in refused(uf2_rp2350(program()))
    assert "CRC of the second stage" in refused(uf2(program_rp2350()))


@pytest.mark.parametrize("chip", CHIPS, ids=str)
def test_the_image_built_here_passes_and_its_elf_is_the_same(chip: Chip) -> None:
    built = BUILT / chip.image
    if not built.is_file():
        pytest.skip("image not built: make firmware")
    image = read_image(built)
    require_ours(image)
    assert image.chip is chip
    assert shipped(chip.image).read_bytes() == built.read_bytes()
    assert image.data == read_image(built.with_suffix(".elf")).data
    assert to_uf2(image) == built.read_bytes()
    assert application(image).board == chip.board
