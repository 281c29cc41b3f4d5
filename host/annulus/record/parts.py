"""One scan in several files: which belong together.

    NAME.mcap, NAME-002.mcap, NAME-003.mcap, ..

Every part is a recording of its own, calibration and configuration attached. That parts are of one scan is not believed
from their names: each has an attachment `part.json`, {"scan": .., "part": ..}, and `scan` is drawn anew for each scan.
"""

import json
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

PART_FILE = "part.json"
PARTS_MAX = 999
_LATER = re.compile(r"(.+)-(\d{3})")
_HEAD_MAX = 1 << 16  # bytes at the beginning of a file that hold the attachment
_MAGIC_SIZE = 8
_ATTACHMENT = 0x09


@dataclass(frozen=True, slots=True)
class Part:
    """Which part of which scan a file is."""

    scan: str
    number: int  # from 1

    def to_dict(self) -> dict[str, Any]:
        return {"scan": self.scan, "part": self.number}

    @classmethod
    def from_dict(cls, data: Mapping[str, Any] | None) -> "Part | None":
        """None where it is none."""
        scan, number = (data or {}).get("scan"), (data or {}).get("part")
        if not isinstance(scan, str) or not scan or isinstance(number, bool) or not isinstance(number, int):
            return None
        return cls(scan, number) if 1 <= number <= PARTS_MAX else None


def part_path(first: Path, number: int) -> Path:
    """Where a part lies, from where the first one does."""
    return first if number == 1 else first.with_name(f"{first.stem}-{number:03d}.mcap")


def later_paths(first: Path) -> list[tuple[int, Path]]:
    """Files that are parts after that first one by their names, by their numbers."""
    found = []
    for path in first.parent.glob("*.mcap"):
        named = _LATER.fullmatch(path.stem)
        if named and named[1] == first.stem and int(named[2]) > 1:
            found.append((int(named[2]), path))
    return sorted(found)


def first_paths(folder: Path) -> list[Path]:
    """The first, or only, files of the recordings in a folder, by their names."""
    stems = {path.stem for path in folder.glob("*.mcap")}
    later = {stem for stem in stems if (named := _LATER.fullmatch(stem)) and named[1] in stems}
    return [folder / f"{stem}.mcap" for stem in sorted(stems - later)]


def part_of(path: Path) -> Part | None:
    """Which part a file says it is, from its first records; None where it does not, or cannot be read."""
    try:
        with path.open("rb") as file:
            head = file.read(_HEAD_MAX)
        for content in _attachments(head):
            (length,) = struct.unpack_from("<I", content, 16)
            if content[20 : 20 + length] != PART_FILE.encode():
                continue
            at = 20 + length
            (media,) = struct.unpack_from("<I", content, at)
            (size,) = struct.unpack_from("<Q", content, at + 4 + media)
            data = json.loads(content[at + 12 + media : at + 12 + media + size])
            return Part.from_dict(data if isinstance(data, dict) else None)
    except (OSError, ValueError, struct.error, RecursionError):
        pass
    return None


def _attachments(head: bytes) -> Iterator[bytes]:
    at = _MAGIC_SIZE
    while at + 9 <= len(head):
        opcode, length = struct.unpack_from("<BQ", head, at)
        at += 9
        if opcode == _ATTACHMENT:
            yield head[at : at + length]
        at += length
