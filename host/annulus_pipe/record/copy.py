"""A recording written anew: whole where it was torn, with other labels, or its pictures kept in another way.

Times, notes and attachments go with it; what viewers show is said again from them. A frame that cannot be read is left
out and counted. The original stays as it is, and the copy appears when all of it is written.
"""

import heapq
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from annulus_pipe.record.clock import clock_of
from annulus_pipe.record.codec import DEFAULT, Codec
from annulus_pipe.record.frames import IDENTITY, LABEL_TOPIC, RecordedFrame
from annulus_pipe.record.missing import RECOVERED, missing_note, missing_of
from annulus_pipe.record.recording import Recording
from annulus_pipe.record.walk import Damage
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.vocabulary import AnnulusError

LabelOf = Callable[[RecordedFrame], Mapping[str, Any]]
Progress = Callable[[str, int, int], None]


@dataclass(slots=True)
class Copied:
    """What became of a recording's frames and notes."""

    frames: int = 0
    notes: int = 0
    damaged: list[str] = field(default_factory=list)  # frames that could not be read, each a line

    def to_dict(self) -> dict[str, Any]:
        return {"frames": self.frames, "notes": self.notes, "frames_damaged": len(self.damaged)}


Last = Callable[[Copied], tuple[str, Mapping[str, Any]]]


@dataclass(frozen=True, slots=True)
class Recovered:
    """`cut_frames`: at most, that the file ended in the middle of; None: not known."""

    copied: Copied
    torn: bool
    cut_frames: int | None
    damage: tuple[Damage, ...]

    @property
    def missing(self) -> list[str]:
        """What was written of the old one and is not in the new one, and where; a line each."""
        return missing_of(self.torn, self.cut_frames, self.damage) + self.copied.damaged

    def to_dict(self) -> dict[str, Any]:
        damage = [{"offset": one.offset, "text": one.text, "messages": one.messages} for one in self.damage]
        return {**self.copied.to_dict(), "torn": self.torn, "cut_frames_at_most": self.cut_frames, "damage": damage}


def copy(
    recording: Recording,
    out: Path,
    *,
    codec: Codec | None = None,
    last: Last | None = None,
    label_of: LabelOf | None = None,
    progress: Progress | None = None,
) -> Copied:
    """Write `out`, which must not exist.

    codec : of the new one; where None, pictures that are JPEGs stay what they are, byte for byte, others are packed.
    last : topic and body of a note to end with, which says what became of the rest. label_of : what to say of a frame,
    all but its form and size; what was said before by default. Raises AnnulusError, one line.
    """
    if out.exists():
        raise AnnulusError(f"{out}: is there already. Choose another name.")
    begun = out.with_name(out.name + ".part")
    begun.unlink(missing_ok=True)
    try:
        copied = _copied(recording, begun, codec, last, label_of or recording.label, progress)
        begun.rename(out)
    except OSError as error:
        raise AnnulusError(f"{out}: cannot be written ({error.strerror}).") from None
    finally:
        begun.unlink(missing_ok=True)
    return copied


def recover(recording: Recording, out: Path, progress: Progress | None = None) -> Recovered:
    """A whole recording with an index, of all that can be read of a torn or damaged one: its parts in one file."""
    damage = recording.check()
    torn, cut = recording.torn, recording.cut_frames

    def last(copied: Copied) -> tuple[str, Mapping[str, Any]]:
        missing = Recovered(copied, torn, cut, damage).missing
        return RECOVERED, {
            "from": recording.path.name,
            "torn": torn,
            "cut_frames_at_most": cut,
            "damage": [one.text for one in damage[:100]],
            **missing_note(missing),
        }

    return Recovered(copy(recording, out, last=last, progress=progress), torn, cut, damage)


def _copied(
    recording: Recording,
    out: Path,
    codec: Codec | None,
    last: Last | None,
    label_of: LabelOf,
    progress: Progress | None,
) -> Copied:
    copied = Copied()
    first_ns = min((frame.timestamp_ns for frame in recording.frames), default=0)
    with RecordingWriter(
        out,
        calibration=recording.calibration,
        configuration=recording.configuration or {},
        now_ns=first_ns,
        codec=codec or DEFAULT,
        clock=clock_of(recording.utc_offset_ns, recording.notes(IDENTITY)),
    ) as writer:
        for time_ns, _, topic, content in heapq.merge(_notes(recording), _frames(recording), key=lambda one: one[:2]):
            if not isinstance(content, RecordedFrame):
                sequence, body = content
                if isinstance(body, dict):
                    writer.note(topic, body, time_ns, sequence)
                    copied.notes += 1
                continue
            try:
                image, encoding = recording.read_raw(content)
                kept = recording.read_jpeg(content) if content.jpeg and codec in (None, Codec.JPEG) else None
            except AnnulusError as error:
                copied.damaged.append(str(error).removeprefix(f"{recording.path}: "))
                continue
            shape = {"encoding": encoding, "width": image.shape[1], "height": image.shape[0]}
            named = {"index": content.index, "camera": content.camera}
            if not writer.frame({**named, **label_of(content), **shape}, image, time_ns, as_jpeg=kept):
                break
            copied.frames += 1
            if progress is not None:
                progress("frames", copied.frames, len(recording.frames))
        if last is not None:
            writer.note(*last(copied), max((frame.timestamp_ns for frame in recording.frames), default=first_ns))
    if writer.lost:
        raise AnnulusError(f"{out}: cannot be written ({writer.problem}). The recording is as it was.")
    return copied


_Entry = tuple[int, int, str, Any]  # time, order among equals, topic, a frame or (sequence, body)


def _notes(recording: Recording) -> Iterator[_Entry]:
    """All that is neither label nor frame, by time."""

    def of(topic: str) -> Iterator[_Entry]:
        return ((time_ns, 0, topic, (sequence, body)) for time_ns, sequence, body in recording.timed_notes(topic))

    streams = [of(topic) for topic in recording.topics if topic != LABEL_TOPIC]
    return iter(heapq.merge(*streams, key=lambda one: one[0]))


def _frames(recording: Recording) -> Iterator[_Entry]:
    return ((frame.timestamp_ns, 1, "", frame) for frame in sorted(recording.frames, key=lambda one: one.timestamp_ns))
