"""What happens in a WorkerPool, as its owner is told."""

from dataclasses import dataclass
from typing import Any

from annulus_pipe.stream.frames import FrameHeader


@dataclass(frozen=True, slots=True)
class Ready:
    """A worker has prepared itself and takes frames."""

    worker: int


@dataclass(frozen=True, slots=True)
class Done:
    worker: int
    header: FrameHeader
    body: Any


@dataclass(frozen=True, slots=True)
class FrameFailed:
    """The worker says it cannot do this frame; it lives on."""

    worker: int
    header: FrameHeader
    why: str


@dataclass(frozen=True, slots=True)
class FrameLost:
    """The worker died, or was killed because it hung, with this frame in its hands."""

    worker: int
    header: FrameHeader
    why: str


@dataclass(frozen=True, slots=True)
class Died:
    """A worker ended unasked. `replaced` is False when it said it cannot work, or when too many in its place died in
    vain. Of spares it is said once, when they die in vain too often.
    """

    worker: int
    why: str
    replaced: bool
    spare: bool = False


@dataclass(frozen=True, slots=True)
class Report:
    """A worker's own words: what its job reported, or its last words (`final`)."""

    worker: int
    body: Any
    final: bool


PoolEvent = Ready | Done | FrameFailed | FrameLost | Died | Report
