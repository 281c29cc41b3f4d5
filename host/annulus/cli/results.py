"""From what was measured to result files, for every command that makes them: of a short scan at once, of a long one
window by window."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from annulus.job import Origin
from annulus.record.storage import Place
from annulus.report import Account, begin_whole, head_kind, write, write_whole, write_window
from annulus.report.whole import WINDOWS, window_folder
from annulus.reprocess import Job, photographs
from annulus.vocabulary import Finding
from annulus.wall.conformity import Criteria, judge
from annulus.wall.sections import worth_showing
from annulus.wall.survey import Survey

if TYPE_CHECKING:
    from annulus.report import Paper
    from annulus.reprocess import Reprocessed
    from annulus.wall.joined import Joined

Say = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Told:
    """What a report is told beside the survey. source : what was scanned, for people. limits : of a verdict."""

    source: str
    origin: Origin
    limits: Criteria | None = None

    def account(
        self, job: Job, survey: Survey, frames: Mapping[str, int], drops: Mapping[str, int],
        timing_ms: Mapping[str, float], findings: Sequence[Finding] = (), *, pictures: bool = True,
    ) -> Account:  # fmt: skip
        """pictures : photographs of the defects are cut out of the job's LED frames."""
        verdict = None if self.limits is None else judge(survey, self.limits)
        shown = worth_showing(survey.defects, first=verdict.foremost if verdict else ())
        return Account(
            self.source, frames, drops, timing_ms, tuple(findings), origin=self.origin, verdict=verdict,
            photographs=photographs(job, survey, shown) if pictures else (), method=head_kind(job.calibration),
            covariance_stated=job.calibration.covariance is not None,
        )  # fmt: skip

    def within(self, first_mm: float, last_mm: float) -> "Told":
        """The same of a stretch: what an operator marked elsewhere is left out."""
        marked = tuple(one for one in self.origin.observations if first_mm <= one.z_mm < last_mm)
        return replace(self, origin=replace(self.origin, observations=marked))


def write_at_once(done: "Reprocessed", survey: Survey, told: Told, out: Path, paper: "Paper | None") -> dict[str, Any]:
    """All result files of a scan that is one window."""
    begin_whole(out)  # windows of a scan before
    account = told.account(done.job, survey, done.frames, done.drops, done.timing_ms, done.findings)
    return write(survey, account, out, paper=paper)


@dataclass(frozen=True, slots=True)
class WindowFiles:
    """Writes windows' results below a place, wherever the worker is."""

    told: Told
    place: Place

    def __call__(self, number: int, survey: Survey, job: Job) -> None:
        first, last, *_ = survey.wall.extent
        account = self.told.within(first, last).account(job, survey, job.scan.counts(), {}, {})
        if self.place.local is not None:
            write_window(survey, account, self.place.local, number)
            return
        with tempfile.TemporaryDirectory(prefix="annulus-") as made:
            write_window(survey, account, Path(made), number)
            upload(window_folder(Path(made), number), self.place / f"{WINDOWS}/{number + 1:04d}")


def write_all(
    pipe: "Joined", job: Job, told: Told, place: Place, paper: "Paper | None", *, frames: Mapping[str, int],
    drops: Mapping[str, int], timing_ms: Mapping[str, float], findings: Sequence[Finding],
) -> dict[str, Any]:  # fmt: skip
    """The files of the whole, beside those of its windows."""
    account = told.account(job, pipe, frames, drops, timing_ms, findings, pictures=False)
    if place.local is not None:
        return write_whole(pipe, account, place.local, paper=paper)
    with tempfile.TemporaryDirectory(prefix="annulus-") as made:
        folder = Path(made)
        for name in place.names(f"{WINDOWS}/"):
            if name.endswith(("/summary.json", "/wall.npz")):
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).write_bytes(place.read(name) or b"")
        summary = write_whole(pipe, account, folder, paper=paper)
        upload(folder, place, leave_out=WINDOWS)
    return summary


def upload(folder: Path, place: Place, leave_out: str = "") -> None:
    """All files of a folder into a place, summary.json last."""
    files = [file for file in folder.rglob("*") if file.is_file()]
    for file in sorted(files, key=lambda file: (file.name == "summary.json", file)):
        name = file.relative_to(folder).as_posix()
        if not (leave_out and name.startswith(f"{leave_out}/")):
            place.write(name, file.read_bytes())
