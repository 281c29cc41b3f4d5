"""The chips a controller runs on, as far as a flasher tells them apart. `board` is what firmware and image call it."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Chip:
    board: str
    name: str  # and the Pico that carries it
    family: int  # of its UF2 files
    product: int  # USB, of its boot ROM
    drive: str  # Board-ID in its drive's INFO_UF2.TXT
    image: str  # among what is shipped
    flash_bytes: int
    ram_end: int

    def __str__(self) -> str:
        return self.name


RP2040 = Chip(
    board="rp2040",
    name="RP2040 (Pico)",
    family=0xE48BFF56,
    product=0x0003,
    drive="RPI-RP2",
    image="annulus.uf2",
    flash_bytes=2 << 20,
    ram_end=0x20042000,
)
RP2350 = Chip(
    board="rp2350",
    name="RP2350 (Pico 2)",
    family=0xE48BFF59,  # its Arm cores, Secure; the images for the others are somebody else's
    product=0x000F,
    drive="RP2350",
    image="annulus-rp2350.uf2",
    flash_bytes=4 << 20,
    ram_end=0x20082000,
)
CHIPS = (RP2040, RP2350)
