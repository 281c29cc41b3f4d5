"""What a file of one scan has once, beside its frames: its attachments, and a beginning.

Somebody may have joined two (`mcap merge`): then frames.py sees it where frames share names or clocks differ, and this
where they do not, as with cameras of other names. Parts of one scan say the same but for their number, and only the
first begins it.
"""

import contextlib

from annulus_pipe import untrusted
from annulus_pipe.record.clock import CLOCK_FILE, Clock
from annulus_pipe.record.frames import IDENTITY, Labels, RecordedFrame, TwoScansError, from_json
from annulus_pipe.record.indexed import Indexed
from annulus_pipe.record.parts import PART_FILE, Part
from annulus_pipe.record.walk import ATTACHMENT_MAX, Chunk, Walk


def check_one_scan(found: Walk | Indexed) -> None:
    """Raises TwoScansError."""
    if isinstance(found, Walk):
        for name, content in found.disagreeing.items():
            if name != PART_FILE or _scan_of(content) != _scan_of(found.attachments[name]):
                raise TwoScansError(f"two {name}")
    begun = _beginnings(found)
    if len(begun) > 1 and (isinstance(found, Indexed) or sum(found.look_at(one) for one in begun) > 1):
        raise TwoScansError(f"{IDENTITY} says {len(begun)} times that it begins")


def check_clock(found: Walk | Indexed, frames: tuple[RecordedFrame, ...], labels: Labels, clock: Clock) -> None:
    """The clock that is attached is the one that the labels are of. frames : times as they are written. Raises
    TwoScansError."""
    stamps = (labels.get((frame.index, frame.camera), {}).get("timestamp_ns") for frame in frames)
    timed = [(frame, value) for frame, value in zip(frames, stamps, strict=True) if type(value) is int]
    later = {frame.timestamp_ns - value for frame, value in timed if frame.timestamp_ns}
    if later and clock.offset_ns not in later and any(found.look_at(frame.chunk) for frame, _ in timed):
        raise TwoScansError(f"{CLOCK_FILE} is not of the labels")


def _beginnings(found: Walk | Indexed) -> list[Chunk | None]:
    """The chunks in which a recorder says that a scan begins. A file that its own index opens was made by one writer,
    and is not asked; of a walk that was kept the chunks are not known."""
    if isinstance(found, Indexed):
        try:
            identities = found.notes.of(IDENTITY, found.file) if found.notes.blocks else iter(())
            return [None for _, _, content in identities if _begins(content)]
        except ValueError:
            raise TwoScansError("it cannot be seen who recorded it") from None  # and it is walked over again
    numbers = {number for number, one in found.channels.items() if one.topic == IDENTITY}
    begun: list[Chunk | None] = []
    for message in found.messages:
        if message.channel in numbers:
            with contextlib.suppress(ValueError):
                if _begins(found.content(message)):
                    begun.append(message.chunk)
    return begun


def _begins(content: bytes) -> bool:
    try:
        identity = from_json(content)
    except ValueError:
        return False
    return isinstance(identity, dict) and identity.get("why") == "start"


def _scan_of(content: bytes) -> str | None:
    """Whose part a part.json is of; None where it says none."""
    try:
        part = Part.from_dict(untrusted.mapping(untrusted.parse_json(content, ATTACHMENT_MAX), PART_FILE))
    except ValueError:
        return None
    return None if part is None else part.scan
