"""Windows of a scan under fringes, each measured wherever there is room and, where a place is given, kept there.

A window's places are joined to those of the one before it, so windows go one after the other; what each follows from
goes with it, and its outcome is the same to the bit whoever measures it. A kept window lies under the address of all
that it follows from: frames, where the head was, calibration, code. What is there and sound is not made again.
"""

import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from annulus_pipe.reprocess.executors import Executor, Failed
from annulus_pipe.reprocess.ranges import FOLDER, identity, part_of
from annulus_pipe.reprocess.versions import address, digest_of, measured_with
from annulus_pipe.scans.scan import Scan
from annulus_pipe.storage.arrays import require_plain_npz
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.vocabulary import AnnulusError

Arrays = Mapping[str, Any]


class WindowPart(Protocol):
    """What a window comes to, as arrays and back."""

    def arrays(self) -> Arrays: ...


Job = TypeVar("Job")
Part = TypeVar("Part", bound=WindowPart)


@dataclass(frozen=True, slots=True)
class FringeWindow:
    """Some flashes of a scan. part : the scan's frames of those, and nothing else of it; flashes : as the job has them,
    with numbers into the part's frames; known : what else the window follows from, arrays and numbers by name."""

    number: int
    part: Scan
    flashes: tuple[Any, ...]
    known: Mapping[str, Any]


def window_of(scan: Scan, number: int, flashes: Any, frames: Callable[[Any], list[int]], known: Arrays) -> FringeWindow:
    """frames : the numbers of a flash's frames in the scan."""
    kept = sorted({i for flash in flashes for i in frames(flash)})
    where = {i: k for k, i in enumerate(kept)}
    return FringeWindow(number, part_of(scan, kept), tuple(_renumbered(flash, where) for flash in flashes), known)


def _renumbered(flash: Any, where: Mapping[int, int]) -> Any:
    """(x_mm, {camera: number}) of a plate, ((eye, number), ..) of a pipe."""
    if isinstance(flash[0], tuple):
        return tuple((eye, where[i]) for eye, i in flash)
    return flash[0], {camera: where[i] for camera, i in flash[1].items()}


@dataclass(frozen=True)
class FringeWindowWork(Generic[Job, Part]):
    """Work of the executors: a window to its part. job : its scan's frames left out. measure, read : functions of a
    module. place : where parts are kept; None: they come back whole. code : digest of what measures. beside : what one
    process keeps from window to window; it does not travel."""

    job: Job
    measure: Callable[[Job, FringeWindow, dict[str, Any]], Part]
    read: Callable[[Job, Arrays], Part]
    place: StoragePath | None = None
    code: str = field(default_factory=lambda: digest_of("wings/fringe"))  # of who asks: it travels
    beside: dict[str, Any] = field(default_factory=dict, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "beside": {}}

    def ready(self) -> Callable[[FringeWindow], tuple[str, bool, Part | None]]:
        """(window) -> name of its file, whether it was made now, and the part where nothing is kept."""
        place = self.place
        if self.code != digest_of("wings/fringe"):
            raise AnnulusError(
                "a worker measures fringes with other code than the command's. Expected one version on all."
            )
        given = "" if place is None else address(measured_with(), self.code, self.job)

        def do(one: FringeWindow) -> tuple[str, bool, Part | None]:
            if place is None:
                return "", True, self.measure(self.job, one, self.beside)
            name = f"{FOLDER}/{one.number:06d}-{address(given, one.flashes, one.known, identity(one.part))[:32]}.npz"
            try:
                self.kept(name)
                return name, False, None
            except AnnulusError:  # not there, half of it, or another's: made anew
                pass
            content = io.BytesIO()
            np.savez(content, **self.measure(self.job, one, self.beside).arrays())
            place.write(name, content.getvalue())
            return name, True, None

        return do

    def kept(self, name: str) -> Part:
        """Raises AnnulusError where no sound part lies there."""
        assert self.place is not None
        content = self.place.read(name)
        if content is None:
            raise AnnulusError(f"{self.place}: {name} is no longer there. Expected what was measured a moment ago.")
        try:
            require_plain_npz(io.BytesIO(content))
            with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
                return self.read(self.job, {name: arrays[name] for name in arrays.files})
        except Exception as error:  # whatever a bent file makes of zipfile and NumPy: it is measured anew
            raise AnnulusError(f"{self.place}: {name}: not a window of this scan ({error})") from None

    def of(self, executor: Executor, one: FringeWindow) -> tuple[Part, bool]:
        """The part of a window, and whether it was made now. Raises what measuring it raised."""
        [(_, outcome)] = list(executor(self, [one]))
        if isinstance(outcome, Failed):
            raise outcome.raised()
        name, made, part = outcome
        return (self.kept(name) if part is None else part), made


def without_frames(job: Job) -> Job:
    """What goes with the work once; frames go with each window."""
    bare: Any = job
    scan = replace(bare.scan, frames=(), calibration=None, recording=None)
    stripped: Job = replace(bare, scan=scan, flashes=(), findings=(), refuses={})
    return stripped
