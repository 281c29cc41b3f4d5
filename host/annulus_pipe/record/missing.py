"""What a recording lacks that was written from another: whoever wrote it says so in it, and readers say it again."""

from collections.abc import Sequence
from typing import Any

from annulus_pipe.record.recording import Recording
from annulus_pipe.record.walk import Damage
from annulus_pipe.untrusted import printable

RECOVERED, RELABELLED = "/recovered", "/relabelled"
LINES_MAX, LINE_MAX = 100, 300  # of one note; characters


def missing_of(torn: bool, cut_frames: int | None, damage: Sequence[Damage]) -> list[str]:
    """Of a file: the places where what was written cannot be read, a line each."""
    lines = [f"{one.text}, at byte {one.offset}" for one in damage]
    if torn and cut_frames != 0:
        many = "an unknown number of frames" if cut_frames is None else f"{cut_frames} frame at most"
        lines.append(f"its end: it was not closed, and {many} with it")
    return lines


def missing_note(lines: Sequence[str]) -> dict[str, Any]:
    """The part of a note that says what is missing, and where."""
    return {"missing": [line[:LINE_MAX] for line in lines[:LINES_MAX]], "missing_places": len(lines)}


def missing_told(recording: Recording) -> list[str]:
    """A line for each place where the recording that this one was written from had lost something."""
    lines: list[str] = []
    for topic in (RECOVERED, RELABELLED):
        for note in recording.notes(topic):
            if isinstance(note, dict):
                lines += _lines(note)
    return list(dict.fromkeys(lines))  # a recovered one that is relabelled says some of it twice


def _lines(note: dict[str, Any]) -> list[str]:
    listed = note.get("missing", note.get("damage"))  # notes of before have `damage` alone
    texts = [one for one in listed if isinstance(one, str)] if isinstance(listed, list) else []
    lines = [printable(one[:LINE_MAX]) for one in texts[:LINES_MAX]]
    rows = note.get("rows_missing")
    if "missing" not in note and type(rows) is int and rows > 0:
        lines.append(f"{rows} rows of the evidence are missing")
    places = note.get("missing_places")
    if type(places) is int and places > len(lines):
        lines.append(f"and {places - len(lines)} places more")
    return lines
