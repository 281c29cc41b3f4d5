"""A walk that took long, kept: beside its recording as NAME.mcap.index, or in a cache where nobody may write there.

What has no index at its end (torn, made before there was one, another program's) is walked over, and over a store that
moves every byte. What was found is kept as an index is (index.py), with what else a walk says: damage, and how the file
ends. It holds for the file as it was: of these bytes, this time or tag, and this end; for any other it is none.
"""

import contextlib
import hashlib
import os
import struct
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

from annulus_pipe import untrusted
from annulus_pipe.record.frames import FRAME_TOPIC, LABEL_TOPIC
from annulus_pipe.record.index import VERSION, blocks_of, pack, unpack
from annulus_pipe.record.indexed import TAIL, Indexed
from annulus_pipe.record.walk import ATTACHMENT_MAX, DAMAGE_MAX, Damage, Walk, piece
from annulus_pipe.storage.place import StoragePath, Where, read_whole
from annulus_pipe.storage.remote import StoreEntry, Url
from annulus_pipe.vocabulary import AnnulusError

KEEP_S = 2.0  # a walk over a local file that takes longer is kept; every one over a store
KEPT_MAX = 1 << 30  # bytes of what is kept: of a scan of 100 000 frames 10 MB
_BEGINS = b"annulus walk 2\n"  # 1: kept of files of two scans, too
_LENGTH = struct.Struct("<Q")

Stamp = list[Any]


def stamp_of(path: Where, file: IO[bytes], size: int, known: StoreEntry | None) -> Stamp:
    """What a file is known by: its bytes, when it was changed or its tag, the checksum of its end."""
    when = str(path.stat().st_mtime_ns) if isinstance(path, Path) else "" if known is None else known.tag
    start = max(0, size - TAIL)
    return [size, when, zlib.crc32(piece(file, start, size - start))]


def kept_walk(path: Where, file: IO[bytes], stamp: Stamp) -> Indexed | None:
    """What was kept of a walk over this file as it is; None where nothing was."""
    for place in _places(path):
        try:
            return _unpacked(read_whole(place, KEPT_MAX), file, stamp)
        except (OSError, ValueError, struct.error, IndexError):
            continue
    return None


def keep(path: Where, file: IO[bytes], stamp: Stamp, walk: Walk) -> Indexed | None:
    """Keep a walk, whose labels are asked for by it; what was kept, read again. None where it cannot be kept."""
    content = _packed(stamp, walk)
    try:
        found = _unpacked(content, file, stamp)
    except (ValueError, struct.error, IndexError):
        return None
    for place in _places(path):
        with contextlib.suppress(OSError, AnnulusError):
            if isinstance(place, Path):
                place.parent.mkdir(parents=True, exist_ok=True)
            StoragePath(place.parent).write(place.name, content)
            break
    return found


def _places(path: Where) -> Iterator[Where]:
    yield path.with_name(f"{path.name}.index")
    full = str(path.resolve())
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    yield cache / "annulus" / f"{hashlib.sha256(full.encode()).hexdigest()[:32]}.index"


def _packed(stamp: Stamp, walk: Walk) -> bytes:
    head, blocks, notes = blocks_of(walk, LABEL_TOPIC, FRAME_TOPIC)
    head |= {
        "stamp": stamp,
        "ended": walk.ended,
        "data_crc": walk.data_crc,
        "cut": walk.cut_messages,
        "damage": [[one.offset, one.text, one.messages] for one in walk.damage],
        "attachments": walk.attachments,
    }
    pieces = [pack(head), *blocks, *notes]
    content = _BEGINS + b"".join(_LENGTH.pack(len(one)) + one for one in pieces)
    return content + struct.pack("<I", zlib.crc32(content))


def _unpacked(content: bytes, file: IO[bytes], stamp: Stamp) -> Indexed:
    (crc,) = struct.unpack("<I", content[-4:])
    if not content.startswith(_BEGINS) or zlib.crc32(content[:-4]) != crc:
        raise ValueError("not a walk that was kept")
    pieces = _pieces(content)
    head = unpack(pieces[0])
    untrusted.whole(head.get("version"), "version", VERSION, VERSION)
    if head.get("stamp") != stamp or len(pieces) % 2 != 1:
        raise ValueError("of another file, or of this one before")
    half = 1 + len(pieces) // 2
    attachments = untrusted.mapping(head.get("attachments"), "attachments")
    if any(not isinstance(one, bytes) or len(one) > ATTACHMENT_MAX for one in attachments.values()):
        raise ValueError("attachments that are none")
    found = Indexed(file, stamp[0], head, pieces[1:half], dict(attachments), LABEL_TOPIC, tuple(pieces[half:]))
    found.ended = head.get("ended") is True
    cut, data_crc = head.get("cut"), head.get("data_crc")
    found.cut_messages = None if cut is None else untrusted.whole(cut, "cut", 0, 1 << 32)
    if data_crc is not None:
        found.data_crc = _whole(data_crc[0]), _whole(data_crc[1])
    for offset, text, messages in head.get("damage", ())[:DAMAGE_MAX]:
        lost = None if messages is None else _whole(messages)
        found.damage.append(Damage(_whole(offset), untrusted.text(text, "damage", 1000), lost))
    return found


def _whole(value: object) -> int:
    return untrusted.whole(value, "a walk's number", 0, (1 << 64) - 1)


def _pieces(content: bytes) -> Sequence[bytes]:
    out, at, end = [], len(_BEGINS), len(content) - 4
    while at < end:
        (length,) = _LENGTH.unpack_from(content, at)
        at += _LENGTH.size
        if at + length > end:
            raise ValueError("cut short")
        out.append(content[at : at + length])
        at += length
    return out


def is_kept(path: Where, took_s: float) -> bool:
    """Whether a walk that took so long is worth it."""
    return isinstance(path, Url) or took_s > KEEP_S
