"""The second view of `annulus reconstruct`: of a head that looked back, joined with the forward one."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from annulus_pipe.vocabulary import AnnulusError

if TYPE_CHECKING:
    from annulus_pipe.reprocess.executors import Executor
    from annulus_pipe.reprocess.job import Job
    from annulus_pipe.reprocess.whole import Surveyed

FALLS = "place_backwards"  # kind of a finding: of a head on another's carrier its places do


@dataclass(frozen=True, slots=True)
class BackView:
    """apart_mm, turned_deg : of the mounting; None of a scan with its own odometer, None where nobody measured it."""

    job: "Job"
    apart_mm: float | None
    turned_deg: float | None


def back_view(
    scan: Path | None, calibration: Path | None, apart_mm: float | None, turned_deg: float | None
) -> BackView | None:
    """What the options say, looked at. AnnulusError for those that go with another that was not given."""
    for option, value, needs, given in (
        ("--back-calibration", calibration, "--back", scan),
        ("--apart-mm", apart_mm, "--back", scan),
        ("--turned-deg", turned_deg, "--apart-mm", apart_mm),
    ):
        if value is not None and given is None:
            raise AnnulusError(f"{option} goes with {needs}")
    if scan is None:
        return None
    from annulus_pipe.reprocess.job import look_at, looking_back, open_job

    job = open_job(scan, calibration)
    if apart_mm is not None:
        job = looking_back(job)
    look_at(job)
    return BackView(job, apart_mm, turned_deg)


def joined_with(
    done: "Surveyed", back: BackView, executor: "Executor", bars: Callable[[str, int, int], None]
) -> "Surveyed":
    """The forward view's survey with what the backward one adds to it. AnnulusError where they do not belong together,
    or one is too long to be held at once."""
    from annulus_pipe.archive.there_and_back import Mount, placed
    from annulus_pipe.reprocess.engine import reprocess
    from annulus_pipe.storage.calibration_file import fingerprint
    from annulus_pipe.wall.facing import BACKWARD, facing

    if done.windows:
        raise AnnulusError(
            f"{done.job.scan.path}: is surveyed in windows, and two views are joined in one. Expected a shorter scan."
        )
    other = reprocess(back.job, executor, lambda what, *counted: bars(BACKWARD + what, *counted))
    aft = other.survey(progress=bars)
    names = str(done.job.scan.path), str(back.job.scan.path)
    turned = math.nan if back.turned_deg is None else back.turned_deg
    mount = None if back.apart_mm is None else Mount(back.apart_mm, turned)
    where = placed(done.survey, aft, mount, names, bars)
    calibrations = done.job.calibration, other.job.calibration
    same = fingerprint(calibrations[0]) == fingerprint(calibrations[1])
    survey = facing(done.survey, aft, where, calibrations, one_head=same)
    findings = [replace(one, text=BACKWARD + one.text) for one in other.findings if one.kind != FALLS]
    return replace(done, survey=survey, findings=(*done.findings, *findings))
