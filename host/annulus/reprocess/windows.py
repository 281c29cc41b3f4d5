"""The windows of a long pipe, worked on wherever there is room: each from its frames' profiles to its own results.

Nobody holds a scan: a worker holds one window's points, and hands back what the whole is told from
(`wall.joined.Abstract`). What files a window's results become is the caller's: `write`.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from annulus.numeric.rounding import DISTANCE, said, span
from annulus.reprocess.engine import Progress, led_frames
from annulus.reprocess.executors import Executor, Failed, in_process
from annulus.reprocess.job import Job, turns_of
from annulus.vocabulary import AnnulusError, Finding
from annulus.wall import survey
from annulus.wall.joined import Abstract, Joined, abstract, joined
from annulus.wall.profile import Profile
from annulus.wall.survey import Survey
from annulus.wall.windows import Plan, Window, between

NOT_MEASURED, THINNED = "stretch-not-measured", "frames-thinned"  # kinds of finding


class Profiles(Protocol):
    """Where the profiles of a scan's flashes are; a small value that can be pickled."""

    def of(self, numbers: Sequence[int]) -> list[Profile]:
        """Those of some flashes, numbers into the scan's projector flashes, rising; a damaged one has none."""
        ...


# (which window, from 0; its survey, what lies beyond its cuts left out; the job of its frames) -> its files
Write = Callable[[int, Survey, Job], None]


@dataclass(frozen=True, slots=True)
class WindowWork:
    """Work on the windows of a plan, by their numbers."""

    job: Job
    profiles: Profiles
    plan: Plan
    write: Write
    vibration: bool = False
    fps: float | None = None

    def ready(self) -> Callable[[int], "Abstract | Finding"]:
        return self._do

    def _do(self, number: int) -> "Abstract | Finding":
        window = self.plan.windows[number]
        profiles = self.profiles.of(window.frames)
        job = _about(self.job, profiles)
        try:
            whole = survey(
                profiles,
                job.calibration,
                led_frames(job),
                turns=turns_of(self.job.scan),
                vibration=self.vibration,
                fps=self.fps,
                z_step_mm=self.plan.z_step_mm,
            )
            kept = between(whole, window)
            if not len(kept.wall.z_mm):
                raise AnnulusError("no wall between its cuts")
        except AnnulusError as error:
            return Finding(NOT_MEASURED, f"nothing is measured {_where(window)}: {error}")
        self.write(number, kept, job)
        return abstract(kept, window, self.plan.whole_step_mm)


def _about(job: Job, profiles: Sequence[Profile]) -> Job:
    """The job of the frames that were taken where the head was while these profiles were."""
    z = [profile.z_mm for profile in profiles]
    low, high = (min(z), max(z)) if z else (math.inf, -math.inf)
    keep = [i for i, frame in enumerate(job.scan.frames) if low <= frame.z_mm <= high]
    return replace(job, scan=job.scan.part(keep))


def survey_windows(
    work: WindowWork, executor: Executor = in_process, progress: Progress | None = None
) -> tuple[Joined, tuple[int, ...], Mapping[str, float]]:
    """All windows surveyed and written: what they say together, which of them were measured, and ms that it took.

    Raises AnnulusError where not one of them could be measured, or a worker could not do one.
    """
    began = time.perf_counter()
    parts: dict[int, Abstract] = {}
    findings: dict[int, Finding] = {}
    count = len(work.plan.windows)
    report = progress or (lambda stage, done, total: None)
    report("wall", 0, count)
    for number, outcome in executor(work, range(count)):
        if isinstance(outcome, Failed):
            raise outcome.raised()
        if isinstance(outcome, Finding):
            findings[number] = outcome
        else:
            parts[number] = outcome
        report("wall", len(parts) + len(findings), count)
    if not parts:
        raise AnnulusError(f"{work.job.scan.path}: {findings[0].text}.")
    told = [*(findings[number] for number in sorted(findings)), *_thinned(work.plan.windows)]
    pipe = joined([parts[number] for number in sorted(parts)], told)
    return pipe, tuple(sorted(parts)), {"windows": 1e3 * (time.perf_counter() - began)}


def _thinned(windows: Sequence[Window]) -> Iterator[Finding]:
    for one in windows:
        if one.thinned:
            text = f"{one.thinned} of {one.thinned + len(one.frames)} frames are left out {_where(one)}, evenly:"
            yield Finding(THINNED, f"{text} they have more points than can be held, and others beside saw the same")


def _where(window: Window) -> str:
    if math.isinf(window.first_mm):
        return f"before {said(window.last_mm, DISTANCE)}"
    if math.isinf(window.last_mm):
        return f"behind {said(window.first_mm, DISTANCE)}"
    return f"from {span(window.first_mm, window.last_mm, DISTANCE)}"
