"""Makes the rig's UF2 of its linked image: `uf2.py rig.elf rig.uf2`. Standard library only."""

import struct
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "rp2040"))

from uf2 import BOOT2_BYTES, FAMILIES, FLASH_START, crc32_boot2, segments, uf2


def main(elf_path: Path, uf2_path: Path) -> None:
    elf = elf_path.read_bytes()
    image = bytearray()
    for offset, physical, _, in_file, _ in sorted(segments(elf), key=lambda s: s[1]):
        if in_file:
            image = image.ljust(physical - FLASH_START, b"\0") + elf[offset : offset + in_file]
    image[BOOT2_BYTES - 4 : BOOT2_BYTES] = struct.pack("<I", crc32_boot2(bytes(image[: BOOT2_BYTES - 4])))
    print(f"rig: flash {len(image)} bytes")
    uf2_path.write_bytes(uf2(bytes(image), FAMILIES["rp2040"]))


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
