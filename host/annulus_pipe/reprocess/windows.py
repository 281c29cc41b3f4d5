"""The windows of a long pipe, worked on wherever there is room: each from its frames' profiles to its own results.

Nobody holds a scan: a worker holds one window's points, and hands back what the whole is told from
(`wall.joined.Abstract`). What a window's results become is the caller's: `Files`.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from annulus_pipe.numeric.rounding import DISTANCE, quoted, span
from annulus_pipe.reprocess.abstract_file import packed, unpacked
from annulus_pipe.reprocess.engine import LedFrames, Progress
from annulus_pipe.reprocess.executors import Executor, Failed, in_process
from annulus_pipe.reprocess.job import Job, turns_of
from annulus_pipe.reprocess.ranges import identity, part_of, without_frames
from annulus_pipe.reprocess.versions import address, made_with
from annulus_pipe.scans.scan import Scan
from annulus_pipe.vocabulary import AnnulusError, Finding, Label
from annulus_pipe.wall.joined import Abstract, Joined, abstract, joined
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.scale import AbsoluteScale
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.windows import Window, WindowPlan
from annulus_pipe.wall.within import between

NOT_MEASURED, THINNED = "stretch-not-measured", "frames-thinned"  # kinds of finding


class Profiles(Protocol):
    """Where the profiles of a scan's flashes are; a small value that can be pickled."""

    def of(self, numbers: Sequence[int]) -> list[Profile]:
        """Those of some flashes, numbers into the scan's projector flashes that were read, rising."""
        ...

    def part(self, numbers: Sequence[int]) -> "Profiles":
        """What it takes to know those, and no more."""
        ...

    def frame(self, number: int) -> int:
        """Index of that flash's frame."""
        ...

    def made_from(self) -> tuple[str, ...] | None:
        """Addresses of what they follow from; None where they were only just measured."""
        ...


class Files(Protocol):
    """What becomes of a window's survey, and stays; windows are numbered from 0. A small value that can be pickled."""

    def __call__(self, number: int, survey: Survey, job: Job) -> Mapping[str, str]:
        """Write them; SHA-256 of each, by name. survey : what lies beyond the window's cuts left out; job : of its
        frames."""
        ...

    def made_from(self) -> str:
        """All that they follow from beside survey and job."""
        ...

    def digests(self, number: int) -> Mapping[str, str]:
        """The same of what is there now."""
        ...

    def keep(self, number: int, data: bytes) -> None:
        """Beside them, what the whole is told from."""
        ...

    def kept(self, number: int) -> bytes | None: ...


@dataclass(frozen=True, slots=True)
class Portion:
    """One window, with what is needed of the scan for it. part : the frames that were taken where the window's were."""

    number: int
    window: Window
    part: Scan
    profiles: Profiles


class Portions(Sequence[Portion]):
    """A scan's windows, cut as they are asked for."""

    def __init__(self, scan: Scan, profiles: Profiles, plan: WindowPlan) -> None:
        self._scan, self._profiles, self._windows = scan, profiles, plan.windows
        self._z_mm = {frame.index: frame.z_mm for frame in scan.frames}

    def __len__(self) -> int:
        return len(self._windows)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[one] for one in range(*number.indices(len(self)))]
        window = self._windows[number]
        z = [self._z_mm[self._profiles.frame(i)] for i in window.frames]
        low, high = (min(z), max(z)) if z else (math.inf, -math.inf)
        kept = [i for i, frame in enumerate(self._scan.frames) if low <= frame.z_mm <= high]
        return Portion(number, window, part_of(self._scan, kept), self._profiles.part(window.frames))


@dataclass(frozen=True, slots=True)
class WindowWork:
    """Work on a plan's windows, each found where it was done before. job : its scan's frames left out; z_step_mm,
    whole_step_mm : the plan's."""

    job: Job
    z_step_mm: float
    whole_step_mm: float
    files: Files
    vibration: bool = False
    fps: float | None = None
    scale: AbsoluteScale | None = None

    def ready(self) -> "Callable[[Portion], Abstract | Finding]":
        return self._do

    def _do(self, portion: Portion) -> "Abstract | Finding":
        made_from = self._made_from(portion)
        there = self._found(portion.number, made_from)
        if there is not None:
            return there
        window, job = portion.window, replace(self.job, scan=portion.part)
        leds = LedFrames(job, None, window.first_mm, window.last_mm)  # of its halo nothing is kept
        try:
            whole = survey(
                portion.profiles.of(window.frames),
                job.calibration,
                leds,
                turns=turns_of(job.scan),
                vibration=self.vibration,
                fps=self.fps,
                z_step_mm=self.z_step_mm,
                scale=self.scale,
            )
            kept = between(replace(whole, disbelieved=(*whole.disbelieved, *leds.findings())), window)
            if not len(kept.wall.z_mm):
                raise AnnulusError("no wall between its cuts")
        except AnnulusError as error:
            return Finding(NOT_MEASURED, f"nothing is measured {_where(window)}: {error}")
        digests = self.files(portion.number, kept, job)
        summary = abstract(kept, window, self.whole_step_mm)
        if made_from is not None:
            about = {"made_from": made_from, "files": digests}
            self.files.keep(portion.number, packed(summary, about))
        return summary

    def _made_from(self, portion: Portion) -> str | None:
        """Address of all that a window's files and its abstract follow from; None where that is not known."""
        profiles = portion.profiles.made_from()
        if profiles is None:
            return None
        job = self.job
        more = (self.z_step_mm, self.whole_step_mm, self.vibration, self.fps, job.sections, self.scale)
        part = portion.part
        pictures = part.part([i for i, frame in enumerate(part.frames) if frame.label is Label.LED])  # in no range
        return address(
            made_with(),
            job.calibration,
            job.colour,
            job.reference,
            more,
            self.files.made_from(),
            portion.window,
            profiles,
            identity(pictures),
        )

    def _found(self, number: int, made_from: str | None) -> "Abstract | None":
        kept = None if made_from is None else self.files.kept(number)
        if kept is None:
            return None
        try:
            summary, about = unpacked(kept)
        except ValueError:  # half of it, or another's: made anew
            return None
        written = about.get("files")
        if about.get("made_from") != made_from or not isinstance(written, dict):
            return None
        there = self.files.digests(number)
        return summary if all(there.get(name) == digest for name, digest in written.items()) else None


def survey_windows(
    job: Job,
    profiles: Profiles,
    plan: WindowPlan,
    files: Files,
    executor: Executor = in_process,
    progress: Progress | None = None,
    *,
    vibration: bool = False,
    fps: float | None = None,
    scale: AbsoluteScale | None = None,
) -> tuple[Joined, tuple[int, ...], Mapping[str, float]]:
    """All windows surveyed and written: what they say together, which of them were measured, and ms that it took.

    Raises AnnulusError where not one of them could be measured, or a worker could not do one.
    """
    began = time.perf_counter()
    parts: dict[int, Abstract] = {}
    findings: dict[int, Finding] = {}
    portions = Portions(job.scan, profiles, plan)
    work = WindowWork(without_frames(job), plan.z_step_mm, plan.whole_step_mm, files, vibration, fps, scale)
    report = progress or (lambda stage, done, total: None)
    report("wall", 0, len(portions))
    for number, outcome in executor(work, portions):
        if isinstance(outcome, Failed):
            raise outcome.raised()
        if isinstance(outcome, Finding):
            findings[number] = outcome
        else:
            parts[number] = outcome
        report("wall", len(parts) + len(findings), len(portions))
    if not parts:
        raise AnnulusError(f"{job.scan.path}: {findings[0].text}.")
    remarks = [*(findings[number] for number in sorted(findings)), *_thinned(plan.windows)]
    pipe = joined([parts[number] for number in sorted(parts)], remarks)
    return pipe, tuple(sorted(parts)), {"windows": 1e3 * (time.perf_counter() - began)}


def _thinned(windows: Sequence[Window]) -> Iterator[Finding]:
    for one in windows:
        if one.thinned:
            text = f"{one.thinned} of {one.thinned + len(one.frames)} frames are left out {_where(one)}, evenly:"
            yield Finding(THINNED, f"{text} they have more points than can be held, and others beside saw the same")


def _where(window: Window) -> str:
    if math.isinf(window.first_mm):
        return f"before {quoted(window.last_mm, DISTANCE)}"
    if math.isinf(window.last_mm):
        return f"behind {quoted(window.first_mm, DISTANCE)}"
    return f"from {span(window.first_mm, window.last_mm, DISTANCE)}"
