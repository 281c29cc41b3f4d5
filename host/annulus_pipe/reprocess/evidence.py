"""The evidence of a recording as its labels said again, and where some of it is missing.

Rows are counted through from the scan's first. Each record says the number of its first row, and each `/identity` how
many there were by then, so that a reader knows which are not there: a chunk was damaged, a record lost, a file torn.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from annulus_pipe import untrusted
from annulus_pipe.labelling.evidence import Row
from annulus_pipe.labelling.replay import Replay, Said
from annulus_pipe.record.frames import EVIDENCE, IDENTITY
from annulus_pipe.record.recording import Recording

ROWS_MAX = 1 << 48  # of a scan: beyond is damage
_Batch = tuple[int, list[Row]]  # number of its first row


@dataclass(slots=True)
class Hole:
    """Rows that say nothing. `after`, `before`: the frames whose labels came last before it, and first behind it."""

    first: int
    rows: int | None  # None: not known
    malformed: bool  # they are there, and cannot be read
    after: int | None = None
    before: int | None = None

    def __str__(self) -> str:
        many = "of an unknown number" if self.rows is None else f"to {self.first + self.rows - 1}"
        rows = f"row {self.first}" if self.rows == 1 else f"rows {self.first} {many}"
        verb = "cannot be read" if self.malformed else "is missing" if self.rows == 1 else "are missing"
        return f"{rows} of the evidence {verb}, {_where(self.after, self.before)}"


def _where(after: int | None, before: int | None) -> str:
    if after is None and before is None:
        return "and no label is with it"
    if after is None:
        return f"before frame {before}"
    return f"after frame {after}" if before is None else f"between frames {after} and {before}"


class RecordedEvidence:
    """`holes`: known when all is said."""

    def __init__(self, recording: Recording) -> None:
        self.holes: list[Hole] = []
        self._recording = recording
        self._read = 0  # records
        self._last: int | None = None  # frame that a label was of

    def said_again(self, replay: Replay) -> Iterator[Said]:
        """What `replay` says of every frame that a label was said of."""
        expected = 0
        for first, rows in self._batches():
            if first > expected and not (expected == 0 and _begins(rows)):
                self._hole(expected, first - expected, malformed=False)
                yield from replay.cut()
            for number, row in enumerate(rows, first):
                malformed = replay.malformed
                yield from replay.feed(row)
                if replay.malformed > malformed:
                    self._hole(number, 1, malformed=True)
                else:
                    self._passed(row)
            expected = first + len(rows)
        written = max((_rows_by(body) for body in self._recording.notes(IDENTITY)), default=0)
        if written > expected:
            self._hole(expected, written - expected, malformed=False)
        elif self._recording.count(EVIDENCE) > self._read:
            self._hole(expected, None, malformed=False)
        yield from replay.finish()

    def _batches(self) -> Iterator[_Batch]:
        """In their order. Of two that do not fit together one is left out, and so missing: that which does not go on
        from what was before.
        """
        expected = 0
        held: _Batch | None = None
        for body in self._recording.notes(EVIDENCE):
            self._read += 1
            batch = _batch(body)
            if batch is None:
                continue
            if held is not None and batch[0] >= _end(held):
                expected = _end(held)
                yield held
                held = batch
            elif held is None or held[0] != expected <= batch[0]:
                held = batch
        if held is not None:
            yield held

    def _hole(self, first: int, rows: int | None, malformed: bool) -> None:
        before = self.holes[-1] if self.holes else None
        if before is not None and malformed and before.malformed and before.first + (before.rows or 0) == first:
            before.rows = (before.rows or 0) + 1
        else:
            self.holes.append(Hole(first, rows, malformed, self._last))

    def _passed(self, row: Row) -> None:
        if row["what"] != "label" or type(row.get("index")) is not int:
            return
        self._last = row["index"]
        if self.holes and self.holes[-1].before is None:
            self.holes[-1].before = self._last


def _batch(body: object) -> _Batch | None:
    try:
        record = untrusted.mapping(body, EVIDENCE)
        first, rows = untrusted.whole(record.get("first"), "first", 0, ROWS_MAX), record.get("rows")
    except ValueError:
        return None
    return (first, rows) if isinstance(rows, list) else None


def _end(batch: _Batch) -> int:
    return batch[0] + len(batch[1])


def _begins(rows: list[Any]) -> bool:
    """Whether a recorder begins here that took another's place: it is told all that was known."""
    first = rows[0] if rows else None
    return isinstance(first, dict) and first.get("what") == "odometer" and not first.get("again")


def _rows_by(identity: object) -> int:
    """How many rows there were by then; 0 where it does not say."""
    rows = identity.get("evidence_rows") if isinstance(identity, dict) else None
    return rows if type(rows) is int and 0 <= rows <= ROWS_MAX else 0
