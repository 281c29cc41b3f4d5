"""From what a scan says to result files, for every command that makes them: of a short scan at once, of a long one
window by window."""

import contextlib
import hashlib
import math
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from annulus_pipe import hooks
from annulus_pipe.cli.show import progress
from annulus_pipe.job import Origin
from annulus_pipe.qualification.applicability import HeadInUse
from annulus_pipe.qualification.quoting import Qualification
from annulus_pipe.report import ScanAccount, keep_windows, prepare_folder, write, write_whole, write_window
from annulus_pipe.report.summary import versions
from annulus_pipe.report.whole import WINDOWS, window_folder
from annulus_pipe.reprocess.job import Job
from annulus_pipe.reprocess.photographs import photographs
from annulus_pipe.scans.scan import Scan
from annulus_pipe.storage.calibration_file import fingerprint
from annulus_pipe.storage.place import StoragePath
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.conformity import Criteria, judge
from annulus_pipe.wall.joined import Joined
from annulus_pipe.wall.sections import worth_showing
from annulus_pipe.wall.survey import Survey

if TYPE_CHECKING:
    from annulus_pipe.report import Paper
    from annulus_pipe.reprocess.executors import Executor
    from annulus_pipe.reprocess.whole import Surveyed

SUMMARY = "summary.json"
ABSTRACT = "abstract.npz"  # of a window: what the whole is told from, for another run that has it from the same


@dataclass(frozen=True, slots=True)
class ReportContext:
    """What a report states beside the survey. source : what was scanned, for people. limits : of a verdict.
    qualification : the files that vouch for the head."""

    source: str
    origin: Origin
    limits: Criteria | None = None
    qualification: Qualification = field(default_factory=Qualification)

    def account(self, job: Job, survey: Survey, **counted: Any) -> ScanAccount:
        """counted : the fields of ScanAccount that come from the scan: frames, drops, timing, findings."""
        verdict = None if self.limits is None else judge(survey, self.limits)
        shown = worth_showing(survey.defects, first=verdict.foremost if verdict else ())
        pictures = () if isinstance(survey, Joined) else photographs(job, survey, shown)  # its windows have them
        origin = replace(self.origin, calibration_fingerprint=fingerprint(job.calibration))
        anchored = survey.scale is not None and bool(survey.scale.references)
        return ScanAccount(
            self.source,
            origin=origin,
            stated=self.qualification.quoted(_in_use(origin, survey), anchored=anchored),
            verdict=verdict,
            photographs=pictures,
            covariance_stated=job.calibration.covariance is not None,
            **counted,
        )

    def within(self, first_mm: float, last_mm: float) -> "ReportContext":
        """The same of a stretch: what an operator marked elsewhere is left out."""
        marked = tuple(one for one in self.origin.observations if first_mm <= one.z_mm < last_mm)
        return replace(self, origin=replace(self.origin, observations=marked))


def qualification_of(scan: Scan, certificate: Path | None = None, pod: Path | None = None) -> Qualification:
    """The files that vouch for a scan's head: those named, and where none is, the recording's own. Raises AnnulusError
    for one named that is none."""
    recorded = (scan.recording.configuration or {}) if scan.recording is not None else {}
    return Qualification.read(certificate, pod).over(Qualification.recorded(recorded.get("qualification")))


def _in_use(origin: Origin, survey: Survey) -> HeadInUse:
    """What a scan states of the head that made it."""
    diameter = survey.diameter_mean_mm
    return HeadInUse(
        origin.job.head,
        origin.calibration_fingerprint,
        " ".join(origin.controller[name] for name in ("version", "git") if origin.controller.get(name)),
        versions()["annulus"],
        diameter if math.isfinite(diameter) else None,
        origin.job.temperature_c,
        origin.day,
    )


@dataclass(frozen=True, slots=True)
class WindowFiles:
    """Writes windows' results below a place, wherever the worker is."""

    about: ReportContext
    place: StoragePath

    def __call__(self, number: int, survey: Survey, job: Job) -> dict[str, str]:
        first, last, *_ = survey.wall.extent
        nothing: Mapping[str, Any] = {}
        account = self.about.within(first, last).account(
            job, survey, frames=job.scan.counts(), drops=nothing, timing_ms=nothing
        )
        if self.place.local is not None:
            write_window(survey, account, self.place.local, number)
            return self.digests(number)
        self.place.remove(SUMMARY)
        with tempfile.TemporaryDirectory(prefix="annulus-") as made:
            write_window(survey, account, Path(made), number)
            self.place.write_folder(Path(made), last=SUMMARY)
            return replace(self, place=StoragePath(made)).digests(number)

    def made_from(self) -> str:
        return repr(self.about)

    def digests(self, number: int) -> dict[str, str]:
        names = [name for name in self.place.names(f"{_folder(number)}/") if not name.endswith(f"/{ABSTRACT}")]
        return {name: hashlib.sha256(self.place.read(name) or b"").hexdigest() for name in names}

    def keep(self, number: int, data: bytes) -> None:
        self.place.write(f"{_folder(number)}/{ABSTRACT}", data)

    def kept(self, number: int) -> bytes | None:
        return self.place.read(f"{_folder(number)}/{ABSTRACT}")


def _folder(number: int) -> str:
    """Of a window, as a place names it."""
    return window_folder(Path(), number).as_posix()


def refuse(job: hooks.WingJob, given: Mapping[str, Any]) -> None:
    """AnnulusError where an option that was given does not go with a wing's scan. given : by its name in `refuses`."""
    for name, why in job.refuses.items():
        if given.get(name):
            raise AnnulusError(f"--{name.replace('_', '-')} does not go with {why}")


def measured_by(
    wing: tuple[hooks.WingJob, Callable[..., hooks.WingResults]],
    place: StoragePath,
    account: ReportContext,
    executor: "Executor",
    bars: Any,
    *,
    paper: "Paper | None" = None,
    keep: bool = False,
) -> hooks.WingResults:
    """All result files of a wing's scan. bars : as `show.progress` takes it, or what it gives. keep : windows stay, so
    that the same command again goes on from there."""
    job, measure = wing
    if place.local is not None:
        prepare_folder(place.local)
    with contextlib.nullcontext(bars) if callable(bars) else progress(bars) as report:
        if place.local is not None:
            return measure(job, executor, place, place.local, account, progress=report, paper=paper, keep=keep)
        with tempfile.TemporaryDirectory(prefix="annulus-") as made:
            results = measure(job, executor, place, Path(made), account, progress=report, paper=paper, keep=keep)
            place.write_folder(Path(made), last=SUMMARY)
            return results


def write_results(
    done: "Surveyed", about: ReportContext, place: StoragePath, paper: "Paper | None" = None
) -> dict[str, Any]:
    """All result files of a scan; of its windows there are some already. Returns what summary.json says."""
    if place.local is not None:
        return _written(done, about, place.local, paper)
    with tempfile.TemporaryDirectory(prefix="annulus-") as made:
        folder = Path(made)
        for number in done.windows:
            own = window_folder(folder, number)
            own.mkdir(parents=True)
            for name in (SUMMARY, "wall.npz"):
                (own / name).write_bytes(place.read(f"{_folder(number)}/{name}") or b"")
        summary = _written(done, about, folder, paper)
        kept = {window_folder(folder, number).name for number in done.windows}
        for name in place.names(f"{WINDOWS}/"):
            if name.split("/")[1] not in kept:
                place.remove(name)
        place.write_folder(folder, last=SUMMARY, leave_out=WINDOWS)
    return summary


def _written(done: "Surveyed", about: ReportContext, out: Path, paper: "Paper | None") -> dict[str, Any]:
    account = about.account(
        done.job, done.survey, frames=done.frames, drops=done.drops, timing_ms=done.timing_ms, findings=done.findings
    )
    if isinstance(done.survey, Joined):
        return write_whole(done.survey, account, out, done.windows, paper=paper)
    summary = write(done.survey, account, out, paper=paper)
    keep_windows(out)
    return summary
