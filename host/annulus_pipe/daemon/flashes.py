"""Frames of one flash, gathered from a head's cameras before they are measured together.

Frames belong together by their flash: one edge, one index, whichever camera they are of (labelling). When they come
decides nothing but how long to wait. A flash is complete with a frame of every camera, or of those that
can still bring one: a camera whose frames have come to a later edge brings none of an earlier one, for its frames come
in the order of capture. Where a camera says nothing at all, patience ends.

    for flash in flashes.ready(now_ns): ...      # after each of
    flashes.take(header, frame, now_ns)          # a labelled projector frame, each held by us
    flashes.passed(header)                       # any labelled frame
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from annulus_pipe.stream.frames import FrameHeader

REMEMBERED = (
    256  # flashes handed out: a frame that comes after its flash was is late by less; as navigation.INDICES_KEPT
)

T = TypeVar("T")
_Edge = tuple[int, int]  # segment, for edges are counted anew with it; number


@dataclass(slots=True)
class Gathered(Generic[T]):
    """The frames that came of one flash, in the order of the cameras' numbers."""

    index: int
    edge: _Edge | None  # None: nobody counts edges, as without a controller
    since_ns: int
    frames: dict[int, tuple[FrameHeader, T]] = field(default_factory=dict)


class Flashes(Generic[T]):
    """Sans-I/O. With one camera a flash is complete with its frame, and waits for nothing."""

    def __init__(self, cameras: Sequence[int], patience_ns: int) -> None:
        """cameras : of the head, by id. patience_ns : how long a flash waits for a camera that says nothing."""
        self.cameras = tuple(sorted(cameras))
        self._patience_ns = patience_ns
        self._waiting: dict[int, Gathered[T]] = {}  # by index, in the order they were begun
        self._out: dict[int, None] = {}  # indices handed out, the latest last
        self._last: dict[int, _Edge] = {}  # by camera: the edge its frames have come to

    def __len__(self) -> int:
        """Flashes that wait."""
        return len(self._waiting)

    def take(self, header: FrameHeader, frame: T, now_ns: int) -> bool | None:
        """True: the first frame of its flash; False: one more of it; None: too late, its flash was handed out."""
        if header.index in self._out:
            return None
        is_first = header.index not in self._waiting
        flash = self._waiting.setdefault(header.index, Gathered(header.index, _edge_of(header), now_ns))
        flash.frames[header.camera] = header, frame
        flash.frames = dict(sorted(flash.frames.items()))
        return is_first

    def passed(self, header: FrameHeader) -> None:
        """A camera's frames have come to this one."""
        edge = _edge_of(header)
        if edge is not None:
            self._last[header.camera] = edge

    def ready(self, now_ns: int, all_of_them: bool = False) -> Iterator[Gathered[T]]:
        """Those that nothing more will come to, in the order they were begun."""
        for index in list(self._waiting):
            flash = self._waiting[index]
            if not (all_of_them or self._complete(flash) or now_ns - flash.since_ns > self._patience_ns):
                continue
            del self._waiting[index]
            self._out[index] = None
            if len(self._out) > REMEMBERED:
                del self._out[next(iter(self._out))]
            yield flash

    def missing(self, flash: Gathered[T]) -> tuple[int, ...]:
        """Cameras it has no frame of."""
        return tuple(camera for camera in self.cameras if camera not in flash.frames)

    def _complete(self, flash: Gathered[T]) -> bool:
        return all(
            camera in flash.frames
            or (flash.edge is not None and camera in self._last and self._last[camera] > flash.edge)
            for camera in self.cameras
        )


def _edge_of(header: FrameHeader) -> _Edge | None:
    return None if header.edge is None else (header.segment, int(header.edge))
