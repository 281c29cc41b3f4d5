"""`annulus demo`: the whole main job on the simulated head, from sync edge to report, in real time."""

import json
import math
import os
import time
import webbrowser
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

from annulus_pipe.daemon.account import ScanReport
from annulus_pipe.daemon.config import HeadConfig, load_config
from annulus_pipe.daemon.interrupt import Interrupt
from annulus_pipe.daemon.observer import Observer
from annulus_pipe.daemon.pools import default_workers
from annulus_pipe.daemon.run import ending
from annulus_pipe.daemon.samples import open_sensors
from annulus_pipe.daemon.session import Session
from annulus_pipe.numeric.rounding import DISTANCE, MEASURE, PERCENT, quoted
from annulus_pipe.report import FILES, ScanAccount, prepare_folder, write
from annulus_pipe.reprocess.drawn import drawn_frame
from annulus_pipe.reprocess.engine import LedFrames, measure
from annulus_pipe.reprocess.executors import Processes
from annulus_pipe.reprocess.job import Job, open_job, stage_medians
from annulus_pipe.reprocess.method import method_for
from annulus_pipe.reprocess.photographs import photographs
from annulus_pipe.scans.origin import origin_of
from annulus_pipe.scans.scan import ScanFrame
from annulus_pipe.stereo import CAMERA_MISSING
from annulus_pipe.storage.calibration_file import save_calibration
from annulus_pipe.twin.head import HeadHandle, head_toml, start_head, sustainable_fps
from annulus_pipe.twin.score import score
from annulus_pipe.twin.worlds import World, demo_world, stereo_world
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.sections import worth_showing
from annulus_pipe.wall.survey import Survey, survey

FPS_MAX = 25.0
FPS_MIN = 2.0
SHARE = 0.75  # of the machine the scan may take; the rest is the desktop's, and for frames that take longer
OVERHEAD_MS = 12.0  # a frame of a camera: two copies, its label, the recorder
TRAVEL_MM = 330.0  # past every defect of the demo's pipe
HEADS: Mapping[str, Callable[[], World]] = {
    "ring": lambda: demo_world(travel_mm=TRAVEL_MM),
    "stereo": lambda: stereo_world(travel_mm=200.0),
}
SECONDS = 15.0
SECONDS_MAX = 60.0
MM_PER_FRAME = 3.0  # aimed at; a slow machine scans longer for it, when nobody says how long ..
MM_PER_FRAME_MAX = 6.0  # .. and less of the pipe, when somebody does
START_PATIENCE_S = 60.0  # from lamps armed to the first labelled frame
BAR_S = 0.1
REMARK = "annulus demo: head and pipe are simulated, nothing of this was measured"  # in the recording, on the report
SLOTS = 40  # a camera: frames are told apart late on a machine that draws them too
RESULTS = ("report.html", *(name for name in FILES if name != "report.html"))  # what people open comes first


@dataclass(frozen=True, slots=True)
class FrameRate:
    """The frame rate this machine holds, and why."""

    fps: float
    render_fps: float
    reconstruct_ms: float
    cores: int

    @property
    def why(self) -> str:
        limit = "the head's rate" if self.fps >= FPS_MAX else f"what {self.cores} cores hold"
        return (
            f"{self.fps:g} fps, {limit}: here the simulated camera renders {self.render_fps:.0f} frames/s alone, "
            f"and a frame takes {self.reconstruct_ms:.0f} ms to reconstruct"
        )


def run_demo(
    seconds: float | None,
    out: Path,
    open_report: bool = True,
    console: Console | None = None,
    *,
    head: str = "ring",
    world: World | None = None,
) -> None:
    """Scan a simulated pipe, write all results into `out`, and score them against the truth.

    seconds : of scanning; None: 15, or as many as this machine needs for a frame every 3 mm, 60 at most. head : one of
    HEADS, in its pipe, where no world is given.

    Ctrl-C or SIGTERM at any moment: lamps off, recording closed and readable, no process left; KeyboardInterrupt.
    Raises AnnulusError when something is missing or `out` cannot be written.
    """
    if head not in HEADS:
        raise AnnulusError(f"head {head!r}: expected one of {', '.join(HEADS)}")
    console = console or Console(stderr=True)
    with Interrupt() as interrupt, _bars(console) as bars:
        try:
            _demo(seconds, out, world or HEADS[head](), interrupt, bars, console)
        except AnnulusError:
            if interrupt.requested:  # what failed was cut off
                raise KeyboardInterrupt from None
            raise
    if open_report and (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        webbrowser.open((out / "report.html").absolute().as_uri())


def _demo(wish_s: float | None, out: Path, world: World, interrupt: Interrupt, bars: "_Bars", console: Console) -> None:
    begun = time.monotonic()
    prepare_folder(out)
    with interrupt.allowed():
        with bars.spinning("measuring this machine"):
            pace = measure_pace(world)
        console.print(pace.why)
    seconds = wish_s or min(max(SECONDS, world.travel_mm / (MM_PER_FRAME * pace.fps)), SECONDS_MAX)
    travel = min(world.travel_mm, MM_PER_FRAME_MAX * pace.fps * seconds)
    console.print(f"scanning {travel:.0f} mm in {seconds:.0f} s, a frame every {travel / seconds / pace.fps:.1f} mm")
    profiles: list[Profile] = []
    for old in out.glob("scan*.mcap"):
        old.unlink()
    (out / "truth.json").write_text(json.dumps(world.truth(), indent=1) + "\n")
    with ExitStack() as stack:
        with bars.spinning("powering the simulated head up"):
            head = start_head(world, pace.fps, speed_mm_s=0.0)
        stack.callback(head.close)
        config = demo_config(head, world, out)
        watcher, sensors = _Watcher(profiles, bars), open_sensors(config.sensors)
        session = Session(config, observer=watcher, sensors=sensors, name="scan")
        report = session.run(_Course(session, head, travel, seconds, interrupt, bars))
    recording = out / "scan.mcap"
    if interrupt.requested:
        console.print(f"interrupted: {recording} holds what was scanned, `annulus reconstruct` reads it")
        raise KeyboardInterrupt
    with interrupt.allowed():
        for line in ending(report):
            console.print(line)
        job = open_job(recording)
        late = _late(job, profiles, bars)
        again = {profile.frame for profile in late}
        profiles = [profile for profile in profiles if profile.frame not in again] + late
        with bars.spinning("building the wall, drawing the report"):
            pipe = survey(sorted(profiles, key=lambda one: one.frame), job.calibration, LedFrames(job))
            truth = _truth(world, pipe)
            write(pipe, _account(job, pipe, report, pace, late, truth), out)
    for line in _closing_lines(out, pipe, truth, time.monotonic() - begun):
        print(line)


def measure_pace(world: World) -> FrameRate:
    """How many frames a second this machine renders, labels, records and reconstructs at the same time."""
    cores = len(os.sched_getaffinity(0))
    render_fps = sustainable_fps(world)
    calibration = world.calibration()
    method = method_for(calibration)
    pictures = {one.id: drawn_frame(calibration, one) for one in calibration.cameras}
    drawn = ScanFrame(0, Label.PROJECTOR, 0.0, "drawn frame")
    reconstruct_ms = median(method(drawn, pictures, None).timing_ms["total"] for _ in range(6))
    render_ms = min(2, cores) * 1e3 / render_fps  # of one core
    together = SHARE * cores * 1e3 / (render_ms + 0.8 * reconstruct_ms + OVERHEAD_MS * len(world.cameras))
    workers = SHARE * default_workers() * 1e3 / (0.8 * reconstruct_ms)
    fps = min(FPS_MAX, SHARE * render_fps, together, workers)
    return FrameRate(max(FPS_MIN, math.floor(2 * fps) / 2), render_fps, reconstruct_ms, cores)


def demo_config(head: HeadHandle, world: World, out: Path) -> HeadConfig:
    """For the simulated head, by way of the files a real one has: head.toml and calibration.json, left in `out`."""
    save_calibration(out / "calibration.json", world.calibration())
    job = f'\n[job]\npipe = "simulated"\nremarks = "{REMARK}"\n'
    here = f'{job}\n[record]\nfolder = "."\n\n[workers]\nslots = {SLOTS * len(world.cameras)}\n'
    (out / "head.toml").write_text(head_toml(head, world, Path("calibration.json")) + here, encoding="utf-8")
    return load_config(out / "head.toml")


class _Course:
    """The operator: pulls the cable once frames are labelled, stops the scan after so many seconds. A `stop()`."""

    def __init__(
        self, session: Session, head: HeadHandle, travel_mm: float, seconds: float, interrupt: Interrupt, bars: "_Bars"
    ) -> None:
        self._session, self._head, self._interrupt, self._bars = session, head, interrupt, bars
        self._travel_mm, self._seconds = travel_mm, seconds
        self._pulled_at: float | None = None
        self._next_look = 0.0
        self._bar = bars.bar("starting recorder and workers", seconds)

    def __call__(self) -> bool:
        if self._interrupt.requested:
            return True
        now = time.monotonic()
        if now < self._next_look:
            return False
        self._next_look = now + BAR_S
        labelled = self._session.labelled
        if self._pulled_at is None:
            if labelled:
                self._head.pull(self._travel_mm / self._seconds)
                self._pulled_at = now
            elif self._session.seconds > START_PATIENCE_S:
                raise AnnulusError(
                    f"no frame could be labelled within {START_PATIENCE_S:g} s: {self._session.why_unknown}"
                )
            return False
        passed = now - self._pulled_at
        self._bars.update(self._bar, f"scanning, {labelled} frames labelled", min(passed, self._seconds))
        return passed > self._seconds


class _Watcher(Observer):
    """Keeps the profiles, shows the events."""

    def __init__(self, profiles: list[Profile], bars: "_Bars") -> None:
        self._profiles, self._bars = profiles, bars

    def profile(self, profile: Profile) -> None:
        self._profiles.append(profile)

    def event(self, kind: str, text: str) -> None:
        self._bars.say(text)


def _late(job: Job, done: Sequence[Profile], bars: "_Bars") -> list[Profile]:
    """Profiles of the recorded projector flashes that no worker had time for, or had without a camera's frame that came
    later.
    """
    alone = {profile.frame for profile in done if CAMERA_MISSING in profile.rejected}
    have = {profile.frame for profile in done} - {index for index in alone if _is_whole(job, index)}
    missing = [i for i in job.flashes(Label.PROJECTOR) if job.scan.frames[i].index not in have]
    if not missing:
        return []
    bar = bars.bar("flashes the workers had no time for", len(missing))
    return [one for one, _ in measure(job, missing, Processes(), lambda _, n, total: bars.update(bar, None, n))]


def _is_whole(job: Job, index: int) -> bool:
    """Whether the recording has a frame of that flash from every camera."""
    return sum(frame.index == index for frame in job.scan.frames) == len(job.calibration.cameras)


def _account(
    job: Job, pipe: Survey, report: ScanReport, pace: FrameRate, late: Sequence[Profile], truth: Mapping[str, Any]
) -> ScanAccount:
    frames = {label.value: report.frames.get(label.value, 0) for label in Label}
    drops = {**report.drops, "reconstructed_after_the_scan": len(late)}
    timing = {**stage_medians(pipe.profiles), "frame_to_profile": report.latency_ms, "frame_period": 1e3 / pace.fps}
    return ScanAccount(
        f"annulus demo, simulated head, {pace.fps:g} fps",
        frames,
        drops,
        timing,
        truth=truth,
        origin=origin_of(job.scan),
        photographs=photographs(job, pipe, worth_showing(pipe.defects)),
        covariance_stated=job.calibration.covariance is not None,
    )


def _truth(world: World, pipe: Survey) -> dict[str, Any]:
    """The score against the simulated pipe, the numbers for the report first."""
    points = np.concatenate([profile.points_mm for profile in pipe.profiles])
    rings = np.concatenate([profile.ring for profile in pipe.profiles])
    scored = score(world, points, rings, [asdict(defect) for defect in pipe.defects])
    cloud, defects = scored["cloud"], scored["defects"]
    numbers = {
        "rms_mm": round(cloud["rms_mm"], 4),
        "gross_percent": round(cloud["gross_over_2mm_percent"], 4),
        "defects_true": defects["true"],
        "defects_found": defects["found"],
        "defects_false": defects["false"],
    }
    return {**numbers, **scored}


def _closing_lines(out: Path, pipe: Survey, truth: Mapping[str, Any], seconds: float) -> list[str]:
    """The end of the demo, for people: what was found, and where it is."""
    first, last = pipe.scanned_mm
    lines = [
        f"wall       {pipe.points} points over {quoted(last - first, DISTANCE)}, "
        f"rms {quoted(truth['rms_mm'], MEASURE)} against the truth, "
        f"{quoted(truth['gross_percent'], PERCENT)} off by more than 2 mm",
        f"defects    {truth['defects_found']} of {truth['defects_true']} found, {truth['defects_false']} false",
    ]
    lines += [
        f"           {d.kind:<8} {quoted(d.depth_mm, MEASURE, d.depth_k2_mm, at_least=not d.floor_seen)} at "
        f"{quoted(d.z_mm, DISTANCE)}, clock {d.clock}"
        for d in pipe.defects
    ]
    lines += [f"{'results' if i == 0 else '':<10} {out / name}" for i, name in enumerate(RESULTS)]
    lines.append(f"recording  {out / 'scan.mcap'}")
    lines.append(f"took       {seconds:.0f} s")
    return lines


class _Bars:
    """Progress on the console; quiet lines between bars where there is no terminal."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def say(self, line: str) -> None:
        self._progress.console.print(f"  {line}", highlight=False, markup=False)

    def bar(self, what: str, total: float) -> TaskID:
        return self._progress.add_task(what, total=total)

    def update(self, bar: TaskID, what: str | None, done: float) -> None:
        if what is None:
            self._progress.update(bar, completed=done)
        else:
            self._progress.update(bar, completed=done, description=what)

    @contextmanager
    def spinning(self, what: str) -> Iterator[None]:
        """For work whose end is not known."""
        bar = self._progress.add_task(what, total=None)
        if not self._progress.console.is_terminal:
            self.say(what)
        yield
        self._progress.update(bar, total=1, completed=1)


@contextmanager
def _bars(console: Console) -> Iterator[_Bars]:
    columns = (TextColumn("{task.description:<48}"), BarColumn(), TimeElapsedColumn())
    with Progress(*columns, console=console) as progress:
        yield _Bars(progress)
