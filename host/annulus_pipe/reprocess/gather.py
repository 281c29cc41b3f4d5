"""The ranges of a scan, measured wherever an executor says, gathered again: what `reprocess` gives, from files."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

from annulus_pipe.reprocess.engine import AccountBasis, Progress, Reprocessed, account, decisions
from annulus_pipe.reprocess.executors import Executor, Failed
from annulus_pipe.reprocess.job import Job, stage_medians
from annulus_pipe.reprocess.ranges import CHUNKS, Facts, clear, measure_ranges, profiles_of
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.vocabulary import Finding

LEFT_OUT, PROCESSORS = "left-out", "processors"  # kinds of finding


@dataclass(frozen=True, slots=True)
class Ranged:
    """What became of a scan's ranges. facts : of those that were measured, in their order; findings : what is wrong
    with the scan's frames, ranges that were left out first; left_out : frames of those, by index."""

    job: Job
    facts: tuple[Facts, ...]
    findings: tuple[Finding, ...]
    left_out: tuple[int, ...]
    frames: dict[str, int]
    drops: dict[str, int]

    @property
    def made(self) -> int:
        """Ranges that were not there before."""
        return sum(one.made for one in self.facts)


def in_ranges(
    job: Job, place: StoragePath, executor: Executor, progress: Progress | None = None, chunks: int = CHUNKS
) -> Ranged:
    """Every range of a scan measured, its profiles in the place; one that cannot be is left out, and told.

    chunks : of a range. Raises AnnulusError, one line, where nothing can be measured."""
    job, which, decided = decisions(job)
    report = progress or (lambda stage, done, total: None)
    facts: list[Facts] = []
    failed: list[tuple[Sequence[int], Failed]] = []
    for one, outcome in measure_ranges(job, place, executor, partial(report, "frames"), chunks):
        if isinstance(outcome, Failed):
            failed.append((one.indices, outcome))
        else:
            facts.append(outcome)
    facts.sort(key=lambda one: one.number)
    failed.sort(key=lambda one: one[0][0])
    if not facts:
        raise failed[0][1].raised()
    left_out = tuple(frame for frames, _ in failed for frame in frames)
    seen = AccountBasis(
        [light for one in facts for light in one.lights],
        [pose for one in facts for pose in one.poses],
        [frame for one in facts for frame in one.apart],
        sum(one.pairs for one in facts),
        left_out,
    )
    findings, frames, drops = account(job, which, decided, seen)
    if left_out:
        drops["frames_left_out"] = len(left_out)
    else:
        clear(place, facts)
    remarks = tuple(_left_out(failed)) + tuple(_processors(facts))
    return Ranged(job, tuple(facts), remarks + findings, left_out, frames, drops)


def gathered(ranged: Ranged, place: StoragePath, started: float) -> Reprocessed:
    """With all profiles in this process. started : time.perf_counter() of when the work began."""
    profiles = tuple(profile for one in ranged.facts for profile in profiles_of(place, one))
    timing = {**stage_medians(profiles), "scan_to_profiles": (time.perf_counter() - started) * 1e3}
    return Reprocessed(ranged.job, profiles, ranged.findings, ranged.frames, ranged.drops, timing)


def _left_out(failed: Sequence[tuple[Sequence[int], Failed]]) -> list[Finding]:
    out = []
    for frames, why in failed:
        text = (
            f"frames {frames[0]} to {frames[-1]} could not be measured in {why.tries} tries and are left out: {why.why}"
        )
        out.append(Finding(LEFT_OUT, text, tuple(frames)))
    return out


def _processors(facts: Sequence[Facts]) -> list[Finding]:
    kinds = sorted({one.processor for one in facts})
    if len(kinds) < 2:
        return []
    text = (
        f"measured on {len(kinds)} kinds of processor ({', '.join(kinds)}): the last bit of a point may be another "
        "than on one kind"
    )
    return [Finding(PROCESSORS, text)]
