"""A scan recorded in parts, with no frame lost between two: the next file is open before the one at hand is let go.

A part ends when it is old or large enough. If the next one cannot be begun, the one at hand goes on, and it is tried
again. What ends a part takes long (an index is written, the disk waited for) and is done by a thread of its own.

Power may be cut at any moment. Every `sync_s` the file is told to be on the disk itself (fdatasync), by a thread too,
one at a time: what is lost is what came since the last one began that ended, so `sync_s` and the time that one takes.
"""

import contextlib
import os
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.parts import PARTS_MAX, Part, part_of, part_path
from annulus_pipe.record.writer import RecordingWriter
from annulus_pipe.vocabulary import AnnulusError

RETRY_S = 10.0  # between two attempts to begin a part that cannot be begun
CLOSE_S = 5.0  # for parts that are still being ended when the scan ends


@dataclass(frozen=True, slots=True)
class Bounds:
    """0: no such bound."""

    part_s: float = 0.0
    part_bytes: float = 0.0
    sync_s: float = 0.0


UNBOUNDED = Bounds()
Begin = Callable[[Path, Part], RecordingWriter]


class RotatingWriter:
    """Writes one scan, as RecordingWriter does one file. The counters are of all parts it wrote."""

    def __init__(
        self, folder: Path, name: str, scan: str, bounds: Bounds, begin: Begin, now_s: Callable[[], float]
    ) -> None:
        """Begins at once: with the first part, or, where the scan `scan` has parts already, with the next one.

        begin : makes the writer of one part; raises AnnulusError when it cannot. Where `name` is another scan's, this
        one's is name-2, ..
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise AnnulusError(f"{folder}: cannot be made ({error.strerror}). Choose another folder.") from None
        self._scan, self._bounds, self._begin, self._now_s = scan, bounds, begin, now_s
        self._first, number = _place(folder, name, scan)
        self.problem = ""  # the last reason for a loss
        self.remark = ""  # why the next part cannot be begun: nothing is lost by that
        self._written: Counter[str] = Counter()  # of the parts that are ended
        self._lost: Counter[str] = Counter()
        self._ending: list[threading.Thread] = []
        self._syncing: threading.Thread | None = None
        self._part = Part(scan, number)
        self.path = part_path(self._first, number)
        self._writer = begin(self.path, self._part)
        self._began_s = self._synced_s = now_s()
        self._try_s = 0.0
        self._closed = False
        self._in_thread(_sync_folder, folder, "names to the disk itself")  # a busy one takes seconds

    @property
    def parts(self) -> int:
        """The number of the part at hand."""
        return self._part.number

    @property
    def written(self) -> Counter[str]:
        return self._written + self._writer.written

    @property
    def lost(self) -> Counter[str]:
        return self._lost + self._writer.lost

    @property
    def waiting_s(self) -> float:
        return self._writer.waiting_s

    def frame(
        self, label: Mapping[str, Any], image: Image, time_ns: int, hurried: bool = False, preview: bool = True
    ) -> bool:
        """A frame with its label; False when it was lost. `hurried`: as it is, others wait. `preview`: with a small
        picture beside it, where it is a mosaic.
        """
        now_s = self._now_s()
        if self._is_due(now_s):
            self._rotate(now_s, time_ns)
        self._writer.hurried = hurried
        done = self._writer.frame(label, image, time_ns, preview=preview)
        self.problem = self._writer.problem or self.problem
        if self._bounds.sync_s and now_s - self._synced_s >= self._bounds.sync_s:
            self._sync(now_s)
        return done

    def gone(self) -> str:
        """Why the part at hand is not what is at `path` any more, a few words; empty when it is."""
        return self._writer.gone(self.path)

    def abandon(self) -> None:
        """Let go of a part that is gone; those that are being ended still are."""
        self._closed = True
        self._writer.abandon()

    def note(self, topic: str, body: Mapping[str, Any], time_ns: int, sequence: int = 0) -> None:
        self._writer.note(topic, body, time_ns, sequence)

    def flush(self) -> None:
        self._writer.flush()

    def close(self) -> None:
        """Everything is on the disk itself then, unless the disk is slower than CLOSE_S."""
        if self._closed:
            return
        self._closed = True
        end = time.monotonic() + CLOSE_S
        self._end(self._writer)
        for thread in self._ending:
            thread.join(max(0.0, end - time.monotonic()))
        self.problem = self._writer.problem or self.problem

    def _is_due(self, now_s: float) -> bool:
        bounds = self._bounds
        old = 0.0 < bounds.part_s <= now_s - self._began_s
        large = 0.0 < bounds.part_bytes <= self._writer.size
        return (old or large) and now_s >= self._try_s

    def _rotate(self, now_s: float, time_ns: int) -> None:
        number = self._part.number + 1
        while os.path.lexists(path := part_path(self._first, number)):  # somebody's; never written over
            number += 1
        try:
            if number > PARTS_MAX:
                raise AnnulusError(f"{self._first}: has {PARTS_MAX} parts, the last one goes on")
            fresh = self._begin(path, Part(self._scan, number))
        except AnnulusError as error:
            self.remark, self._try_s = f"the next part cannot be begun, this one goes on: {error}", now_s + RETRY_S
            return
        self.remark = ""
        old = self._writer
        old.note("/event", {"kind": "part_ended", "text": f"goes on in {path.name}"}, time_ns)
        old.flush()
        self._written, self._lost = self._written + old.written, self._lost + old.lost
        self._writer, self._part, self._began_s, self.path = fresh, Part(self._scan, number), now_s, path
        self._in_thread(self._end, old, f"ends part {number - 1}")

    def _in_thread(self, work: Callable[[Any], None], what: Any, name: str) -> None:
        thread = threading.Thread(target=work, args=(what,), name=name, daemon=True)
        thread.start()
        self._ending = [one for one in self._ending if one.is_alive()] + [thread]

    def _sync(self, now_s: float) -> None:
        if self._syncing is not None and self._syncing.is_alive():
            return  # the disk is slower than that
        self._synced_s = now_s
        file = os.dup(self._writer.fileno())
        self._syncing = threading.Thread(target=_synced, args=(file,), name="to the disk itself", daemon=True)
        self._syncing.start()

    def _end(self, writer: RecordingWriter) -> None:
        file = os.dup(writer.fileno())
        try:
            writer.close()
        finally:
            if self._bounds.sync_s:
                _synced(file)
                _sync_folder(self._first.parent)
            else:
                os.close(file)


def _place(folder: Path, name: str, scan: str) -> tuple[Path, int]:
    """The first part of that scan, and the number of the part to begin."""
    for number in range(1, PARTS_MAX + 1):
        first = folder / (f"{name}.mcap" if number == 1 else f"{name}-{number}.mcap")
        if not os.path.lexists(first):
            return first, 1
        known = part_of(first)
        if known is not None and known.scan == scan:
            for part in range(2, PARTS_MAX + 1):
                if not os.path.lexists(part_path(first, part)):
                    return first, part
    raise AnnulusError(f"{folder}: holds {name}.mcap to {name}-{PARTS_MAX}.mcap already. Choose another folder.")


def _synced(file: int) -> None:
    """The disk has it all; closes `file`. What it cannot take is told by the next write."""
    try:
        os.fdatasync(file)
    except OSError:
        pass
    finally:
        os.close(file)


def _sync_folder(folder: Path) -> None:
    """The names of its files are on the disk too."""
    try:
        file = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except OSError:
        return
    with contextlib.suppress(OSError):
        os.fsync(file)
    os.close(file)
