"""From a scan to its survey, however long it is: at once where its points can be held, else range by range and window
by window, with nobody holding all of it.

    done = surveyed(job, place, executor, files)     # done.survey: of the whole, be it of one window or of many

A short scan's profiles go from worker to command. A long one's are written into the place as they are measured; where
windows are cut follows from them alone, and each window is then surveyed wherever there is room. The same scan gives
the same results, whichever way its frames went.
"""

import bisect
import contextlib
import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path

import numpy as np

from annulus_pipe.hooks import added
from annulus_pipe.reprocess.engine import Progress, reprocess
from annulus_pipe.reprocess.executors import Executor, Processes, in_process
from annulus_pipe.reprocess.gather import Ranged, gathered, in_ranges
from annulus_pipe.reprocess.job import Job
from annulus_pipe.reprocess.optics import prior_of
from annulus_pipe.reprocess.ranges import FOLDER, Facts, profiles_of
from annulus_pipe.reprocess.windows import Files, survey_windows
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.vocabulary import Finding, Label
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.scale import AbsoluteScale, find_scale, frames_for_scale
from annulus_pipe.wall.survey import Survey
from annulus_pipe.wall.windows import POINTS_MAX, Reach, plan

FRAMES_HELD = 600  # flashes whose profiles this process holds: of the usual head, two million points
WINDOW_MB = 1000  # that a worker holds at its window; tools/bench/speed/long_scan.py
WINDOWS_AT_ONCE = 2  # unless more workers are asked for: the command and they hold 2 GB, whatever the machine has


@dataclass(frozen=True, slots=True, eq=False)
class Surveyed:
    """job : as it was done. survey : a `Joined` where there were windows, whose files were written. findings, frames,
    drops, timing_ms : as `Reprocessed` has them. ranges, made, left_out : how many, how many of them new, frames.
    windows : which were measured and written, numbers from 0."""

    job: Job
    survey: Survey
    findings: tuple[Finding, ...]
    frames: Mapping[str, int]
    drops: Mapping[str, int]
    timing_ms: Mapping[str, float]
    ranges: int = 0
    made: int = 0
    left_out: int = 0
    windows: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Filed:
    """The profiles of a scan where its ranges lie. facts : of each range, in their order; first : the number of each
    one's first frame, counted over all that were read."""

    place: StoragePath
    facts: tuple[Facts, ...]
    first: tuple[int, ...]

    def of(self, numbers: Sequence[int]) -> list[Profile]:
        out: list[Profile] = []
        held, profiles = -1, tuple[Profile, ...]()
        for number in numbers:
            own, within = self._at(number)
            if own != held:
                held, profiles = own, profiles_of(self.place, self.facts[own])
            out.append(profiles[within])
        return out

    def part(self, numbers: Sequence[int]) -> "Filed":
        kept = sorted({self._at(number)[0] for number in numbers})
        return Filed(self.place, tuple(self.facts[i] for i in kept), tuple(self.first[i] for i in kept))

    def made_from(self) -> tuple[str, ...]:
        return tuple(one.name for one in self.facts)

    def frame(self, number: int) -> int:
        own, within = self._at(number)
        return self.facts[own].frames[within]

    def _at(self, number: int) -> tuple[int, int]:
        """The number of the range that a frame is in, and its place in that."""
        own = bisect.bisect_right(self.first, number) - 1
        return own, number - self.first[own]


@dataclass(frozen=True, slots=True, eq=False)
class Held:
    """The profiles of a scan that is short enough for this process to hold."""

    profiles: tuple[Profile, ...]

    def of(self, numbers: Sequence[int]) -> list[Profile]:
        return [self.profiles[number] for number in numbers]

    def part(self, numbers: Sequence[int]) -> "Held":
        return self

    def made_from(self) -> None:
        return None

    def frame(self, number: int) -> int:
        return self.profiles[number].frame


def surveyed(
    job: Job,
    place: StoragePath,
    executor: Executor,
    files: Files,
    progress: Progress | None = None,
    *,
    vibration: bool = False,
    fps: float | None = None,
    keep: bool = False,
    points_max: int = POINTS_MAX,
) -> Surveyed:
    """Everything a scan says of its pipe.

    place : where ranges and windows' results go. files : of windows; not asked of a scan of one.
    keep : ranges are written however short the scan is, and stay, so that the same work again finds them. points_max :
    of a window.
    Raises AnnulusError, one line, where nothing can be measured.
    """
    started = time.perf_counter()
    if not keep and len(job.flashes(Label.PROJECTOR)) <= FRAMES_HELD:
        done = reprocess(job, executor, progress)
        cut = plan([Reach.of(one) for one in done.profiles], job.calibration.pipe_radius_mm, points_max)
        if len(cut.windows) == 1:
            survey = done.survey(vibration=vibration, fps=fps, progress=progress)
            return Surveyed(done.job, survey, done.findings, done.frames, done.drops, done.timing_ms)
        scale = find_scale(done.profiles, job.calibration, job.sections, prior_of(job.scan))
        pipe, numbers, timing = survey_windows(
            done.job, Held(done.profiles), cut, files, in_process, progress, vibration=vibration, fps=fps, scale=scale
        )
        complete = added(pipe, done.job.scan, done.profiles)
        timing_ms = {**done.timing_ms, **timing}
        return Surveyed(done.job, complete, done.findings, done.frames, done.drops, timing_ms, windows=numbers)
    with _ranges_in(place, keep):
        ranged = in_ranges(job, place, executor, progress)
        counts = len(ranged.facts), ranged.made, len(ranged.left_out)
        cut = plan([one for facts in ranged.facts for one in facts.reaches], job.calibration.pipe_radius_mm, points_max)
        if len(cut.windows) == 1:
            done = gathered(ranged, place, started)
            survey = done.survey(vibration=vibration, fps=fps, progress=progress)
            return Surveyed(done.job, survey, done.findings, done.frames, done.drops, done.timing_ms, *counts)
        measured_ms = 1e3 * (time.perf_counter() - started)
        filed = _filed(ranged, place)
        scale = _scale(ranged, filed)
        pipe, numbers, timing = survey_windows(
            ranged.job, filed, cut, files, _fewer(executor), progress, vibration=vibration, fps=fps, scale=scale
        )
    complete = added(pipe, ranged.job.scan, _poses(ranged))
    timing_ms = {**_timing(ranged), "scan_to_profiles": measured_ms, **timing}
    return Surveyed(ranged.job, complete, ranged.findings, ranged.frames, ranged.drops, timing_ms, *counts, numbers)


@contextlib.contextmanager
def _ranges_in(place: StoragePath, keep: bool) -> Iterator[None]:
    """Ranges that are not to stay are taken away again, however the work ends."""
    try:
        yield
    finally:
        if not keep:
            for name in place.names(f"{FOLDER}/"):
                place.remove(name)
            if place.local is not None:
                with contextlib.suppress(OSError):
                    (place.local / FOLDER).rmdir()


def _filed(ranged: Ranged, place: StoragePath) -> Filed:
    ends = accumulate((len(one.reaches) for one in ranged.facts), initial=0)
    bare = tuple(replace(one, poses=(), reaches=()) for one in ranged.facts)
    return Filed(place, bare, tuple(ends)[:-1])


def _scale(ranged: Ranged, filed: Filed) -> AbsoluteScale | None:
    """Of a scan whose profiles nobody holds: from some of them."""
    z_of = {frame.index: frame.z_mm for frame in ranged.job.scan.frames}
    z_mm = np.array([z_of[filed.frame(i)] for i in range(sum(len(one.reaches) for one in ranged.facts))])
    job = ranged.job
    numbers = np.sort(frames_for_scale(z_mm, job.calibration.pipe_radius_mm, job.sections))
    return find_scale(filed.of([int(i) for i in numbers]), job.calibration, job.sections, prior_of(job.scan))


def _fewer(executor: Executor) -> Executor:
    """As many workers as have room for a window each; a cluster's have what they were given."""
    if not isinstance(executor, Processes):
        return executor
    wanted = executor.workers or min(os.cpu_count() or 1, WINDOWS_AT_ONCE)
    room = max(1.0, min(wanted, _free_mb() // WINDOW_MB))
    return replace(executor, workers=int(room), apart=True)


def _free_mb() -> float:
    """Memory that is free to this process: of the machine, or what is left of a control group's."""
    free = math.inf
    with contextlib.suppress(OSError, ValueError, IndexError), open("/proc/meminfo", encoding="ascii") as file:
        free = next(int(line.split()[1]) / 1024 for line in file if line.startswith("MemAvailable:"))
    with contextlib.suppress(OSError, ValueError, IndexError):
        with open("/proc/self/cgroup", encoding="ascii") as file:
            group = "/sys/fs/cgroup" + file.readline().strip().rpartition(":")[2].rstrip("/")
        limit, used = (Path(group, f"memory.{what}").read_text(encoding="ascii") for what in ("max", "current"))
        free = min(free, (int(limit) - int(used)) / 2**20)  # ValueError where there is none: "max"
    return free


def _poses(ranged: Ranged) -> list[Profile]:
    """Where the head was, frame by frame, without the points."""
    z = {frame.index: frame.z_mm for frame in ranged.job.scan.frames}
    out = []
    nothing = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros(0, np.uint8), np.zeros(0, np.uint16)
    for facts in ranged.facts:
        without = set(facts.without_pose)
        frames = [frame for frame in facts.frames if frame not in without]
        out += [Profile(frame, z[frame], pose, *nothing) for frame, pose in zip(frames, facts.poses, strict=True)]
    return out


def _timing(ranged: Ranged) -> dict[str, float]:
    names = {name: None for facts in ranged.facts for name in facts.timing_ms}
    return {
        name: float(np.median([one.timing_ms[name] for one in ranged.facts if name in one.timing_ms])) for name in names
    }
