"""The labels of a recording said again from its own evidence, to look into them (`audit`) or to have them better
(`relabel`).

An audit asks every label when the head asked it: what this program says of the same evidence is what that one said, and
whatever differs is listed. Relabelling gives frames that were labelled early, for want of room, the time they lacked.
A frame without evidence is unknown. Where evidence is missing, what follows is said again from what comes behind the
hole (labelling/replay.py); what is missing is said by whoever asked, and in the new recording.
"""

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from annulus_pipe.labelling.evidence import LABEL
from annulus_pipe.labelling.replay import PATIENCE_NS, Replay
from annulus_pipe.record.copy import Copied, copy
from annulus_pipe.record.frames import RecordedFrame, frame_name
from annulus_pipe.record.missing import RELABELLED, missing_note, missing_of
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.reprocess.evidence import Hole, RecordedEvidence
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import AnnulusError, Label

SAME_MM = 1e-3
NO_EVIDENCE = "no evidence"


@dataclass(frozen=True, slots=True)
class LabelChange:
    """What is said of some frames now, and was said of them then."""

    was: str
    now: str
    what: str  # label or place
    why: str  # the reasons, then and now


@dataclass(slots=True)
class Audit:
    """frames: those with a label, recorded or not. holes: of the evidence. lacks: a line for all that is missing."""

    frames: int = 0
    changes: Counter[LabelChange] = field(default_factory=Counter)
    without_evidence: int = 0
    holes: list[Hole] = field(default_factory=list)
    lacks: list[str] = field(default_factory=list)
    damaged: int = 0  # frames whose picture cannot be read, and is not in the new recording

    @property
    def changed(self) -> int:
        return self.changes.total()

    @property
    def missing(self) -> int:
        """Rows of evidence that are not in the recording, as far as it is known how many."""
        return sum(hole.rows or 0 for hole in self.holes if not hole.malformed)

    @property
    def malformed(self) -> int:
        """Rows that are there and cannot be read."""
        return sum(hole.rows or 0 for hole in self.holes if hole.malformed)

    def to_dict(self) -> dict[str, Any]:
        rows = [
            {"was": one.was, "now": one.now, "what": one.what, "why": one.why, "frames": count}
            for one, count in self.changes.most_common()
        ]
        return {
            "frames": self.frames,
            "changed": self.changed,
            "without_evidence": self.without_evidence,
            "rows_missing": self.missing,
            "rows_malformed": self.malformed,
            "frames_damaged": self.damaged,
            "changes": rows,
            **missing_note(self.lacks),
        }


def audit(path: Path) -> Audit:
    """Whether the labels of a recording follow from its evidence. Raises AnnulusError where it has none."""
    recording = open_recording(path)
    found = Audit()
    patience_ns = max((int(note["patience_ns"]) for note in recording.notes(RELABELLED)), default=0)
    _said_again(recording, found, patience_ns)
    found.lacks += missing_of(recording.torn, recording.cut_frames, recording.damage)
    return found


def relabel(path: Path, out: Path) -> Audit:
    """Write `out`, which must not exist: the same recording with the labels said again. The original stays as it is."""
    recording = open_recording(path)
    found = Audit()
    relabelled = _said_again(recording, found, PATIENCE_NS)
    found.lacks += missing_of(recording.torn, recording.cut_frames, recording.check())

    def label_of(frame: RecordedFrame) -> Mapping[str, Any]:
        return _label(recording, frame, relabelled.get((frame.index, frame.camera)))

    def last(copied: Copied) -> tuple[str, Mapping[str, Any]]:
        found.damaged = len(copied.damaged)
        found.lacks += copied.damaged
        return RELABELLED, {"from": recording.path.name, "patience_ns": PATIENCE_NS, **found.to_dict()}

    copy(recording, out, last=last, label_of=label_of)
    return found


_Said = dict[tuple[int, int], FrameHeader | None]  # by index and camera, as the recording has them


def _said_again(recording: Recording, found: Audit, patience_ns: int) -> _Said:
    """What differs goes into `found`."""
    recorded = {(frame.index, frame.camera): frame for frame in recording.frames}
    evidence = RecordedEvidence(recording)
    out: _Said = {}
    any_row = False
    for was, now in evidence.said_again(Replay(patience_ns)):
        any_row = True
        frame = recorded.get((was.get("index", -1), was.get("camera", 0)))
        recorded_label: Mapping[str, Any] = recording.label(frame) if frame is not None else was
        found.frames += 1
        if frame is not None:
            out[frame.index, frame.camera] = now
        if now is None:
            found.without_evidence += 1
        elif (change := _change(recorded_label or was, now)) is not None:
            found.changes[change] += 1
    found.holes = evidence.holes
    if not any_row and not found.holes:
        raise AnnulusError(f"{recording.path}: has no evidence to label it from. Expected a recording that keeps some.")
    lost = sorted(recorded.keys() - out.keys())
    for one in lost:
        found.frames += 1
        found.without_evidence += 1
        out[one] = None
    found.lacks += [str(hole) for hole in evidence.holes]
    if lost:
        found.lacks.append(
            f"of {len(lost)} frames there is no evidence, they are unknown: the first is {frame_name(*lost[0])}, the "
            f"last {frame_name(*lost[-1])}"
        )
    return out


def _change(was: Mapping[str, Any], now: FrameHeader) -> LabelChange | None:
    if was.get("label") != now.label.value:
        why = " -> ".join(str(reason) or "agreed" for reason in (was.get("reason", ""), now.reason))
        return LabelChange(str(was.get("label")), now.label.value, "label", why)
    places = was.get("z_mm"), now.z_mm
    apart = abs((places[0] or 0.0) - (places[1] or 0.0)) if (places[0] is None) == (places[1] is None) else math.inf
    assumed = bool(was.get("z_assumed", False)), now.z_assumed
    if apart <= SAME_MM and assumed[0] == assumed[1]:
        return None
    words = ["assumed" if one else "counted" for one in assumed]
    return LabelChange(now.label.value, now.label.value, "place", f"{words[0]} -> {words[1]}, {apart:.1f} mm apart")


def _label(recording: Recording, frame: RecordedFrame, now: FrameHeader | None) -> dict[str, Any]:
    label = dict(recording.label(frame)) or {"index": frame.index, "camera": frame.camera, "reason": ""}
    if now is None:
        return {**label, "label": Label.UNKNOWN.value, "reason": NO_EVIDENCE, "z_mm": None}
    now_fields = now.to_dict()
    return {**label, **{name: now_fields[name] for name in LABEL if name not in ("index", "camera")}}
