"""From a job to its profiles, what is wrong with its frames, and what a survey says of them."""

import contextlib
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.hooks import added
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.walk import DamagedError
from annulus_pipe.reprocess.executors import Executor, Failed, in_process
from annulus_pipe.reprocess.job import Job, Measured, look_at, stage_medians, turns_of
from annulus_pipe.reprocess.method import examined
from annulus_pipe.reprocess.optics import prior_of
from annulus_pipe.reprocess.places import doubled_findings, incomplete_findings, place_findings, running_back_findings
from annulus_pipe.reprocess.ranges import CHUNK
from annulus_pipe.rings.diagnosis import FrameLighting, diagnose, exposure_findings, lamp_findings, reference_findings
from annulus_pipe.stereo import CAMERA_MISSING, TWO_WALLS
from annulus_pipe.vocabulary import AnnulusError, Finding, Label, first_few
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.scale import find_scale
from annulus_pipe.wall.survey import Survey, survey
from annulus_pipe.wall.texture import LedFrame, shows

Progress = Callable[[str, int, int], None]  # stage, done, total

DAMAGED, MISSING, APART = "damaged", "camera-missing", "flashes-apart"  # kinds of finding
APART_MOST = 0.25  # of the flashes: where more are not of one, their frames are paired wrongly


@dataclass(frozen=True, slots=True, eq=False)
class Reprocessed:
    """A scan's profiles in the order of its frames, and their account.

    job : as it was done, a colour profile that is not this pipe's left out. findings : what is wrong with the frames.
    frames : how many by label. drops : what was lost, by kind. timing_ms : medians over the frames, by stage.
    """

    job: Job
    profiles: tuple[Profile, ...]
    findings: tuple[Finding, ...]
    frames: Mapping[str, int]
    drops: Mapping[str, int]
    timing_ms: Mapping[str, float]

    def survey(self, *, vibration: bool = False, fps: float | None = None, progress: Progress | None = None) -> Survey:
        """What profiles, LED frames and other sensors say of the pipe; see `wall.survey`, `hooks.added`."""
        leds = LedFrames(self.job, progress)
        turns, job = turns_of(self.job.scan), self.job
        scale = find_scale(self.profiles, job.calibration, job.sections, prior_of(job.scan))
        pipe = survey(self.profiles, job.calibration, leds, turns=turns, vibration=vibration, fps=fps, scale=scale)
        pipe = replace(pipe, disbelieved=(*pipe.disbelieved, *leds.findings()))
        return added(pipe, self.job.scan, self.profiles)


def reprocess(job: Job, executor: Executor = in_process, progress: Progress | None = None) -> Reprocessed:
    """Profiles of all projector frames.

    progress : called with (stage, done, total). Raises AnnulusError, one line, where nothing can be measured.
    """
    started = time.perf_counter()
    job, which, decided = decisions(job)
    measured = measure(job, which, executor, progress)
    profiles = tuple(profile for profile, _ in measured)
    seen = AccountBasis(
        [(profile.frame, light) for profile, light in measured],
        [profile.pose for profile in profiles if profile.pose is not None],
        [profile.frame for profile in profiles if TWO_WALLS in profile.rejected],
        sum(CAMERA_MISSING not in profile.rejected for profile in profiles),
    )
    findings, frames, drops = account(job, which, decided, seen)
    timing = {**stage_medians(profiles), "scan_to_profiles": (time.perf_counter() - started) * 1e3}
    return Reprocessed(job, profiles, findings, frames, drops, timing)


def decisions(job: Job) -> tuple[Job, list[int], tuple[Finding, ...]]:
    """What must be decided once for a scan, from a few of its frames: the job with it in it, the flashes to measure,
    and what is wrong with all of them. Raises AnnulusError as `look_at` does."""
    which, looked_at = look_at(job)
    colour, decided = examined(job.calibration, job.colour, looked_at)
    return replace(job, colour=colour), which, decided


@dataclass(frozen=True, slots=True)
class AccountBasis:
    """What of a scan's profiles its account is made of. lights : (frame, light) of every frame that was read; poses :
    of those that show a pipe; apart : frames whose cameras see two walls; pairs : flashes that all cameras saw;
    left_out : frames nobody could measure, and why stands in a finding."""

    lights: Sequence[tuple[int, FrameLighting]]
    poses: Sequence[Pose]
    apart: Sequence[int]
    pairs: int
    left_out: Sequence[int] = ()


def account(
    job: Job, which: Sequence[int], decided: Sequence[Finding], seen: AccountBasis
) -> tuple[tuple[Finding, ...], dict[str, int], dict[str, int]]:
    """What is wrong with a scan's frames, how many there are by label, and what was lost, by kind.

    Raises AnnulusError, one line, where nothing was measured and it is known why."""
    damaged = damaged_frames(job, which, {*(frame for frame, _ in seen.lights), *seen.left_out})
    findings = [*decided]
    if job.calibration.kind == "slits":  # a bright line is a small part of a dark picture, and has no colour to lose
        findings[:0] = exposure_findings(seen.lights)
        if of_hues(job):
            of_led = [frame for frame, light in seen.lights if light.of_led]
            findings += lamp_findings(of_led, len(seen.lights), Label.LED, Label.PROJECTOR)
    findings += damage_findings(job, damaged)
    if findings and not seen.poses:
        raise AnnulusError(f"{job.scan.path}: {findings[0].text}.")
    findings += missing_findings(job, which)
    findings += apart_findings(job, tuple(seen.apart), seen.pairs)
    findings += place_findings(job.scan.frames) + incomplete_findings(job.scan)
    findings += running_back_findings(job.scan.frames) + doubled_findings(job.scan.frames, seen.lights)
    if job.reference is not None:
        findings += reference_findings(job.reference, seen.poses)
    counted = Counter(frame.label for frame in job.scan.frames)
    drops = {
        **job.scan.lost(),
        "frames_unknown": counted[Label.UNKNOWN],
        "profiles_without_pose": len(seen.lights) - len(seen.poses),
    }
    if job.scan.recording is not None:
        drops["recording_torn"] = int(job.scan.recording.torn)
        drops["frames_damaged"] = len(damaged)
    return tuple(findings), {label.value: counted[label] for label in Label}, drops


def measure(
    job: Job, which: Sequence[int], executor: Executor = in_process, progress: Progress | None = None
) -> list[Measured]:
    """Profile and light of some of the scan's frames (numbers into `scan.frames`), in the order asked for."""
    chunks = [which[start : start + CHUNK] for start in range(0, len(which), CHUNK)]
    report = progress or (lambda stage, done, total: None)
    report("frames", 0, len(which))
    done: dict[int, list[Measured]] = {}
    for number, measured in executor(job, chunks):
        if isinstance(measured, Failed):
            raise measured.raised()
        done[number] = measured
        report("frames", sum(map(len, done.values())), len(which))
    return [one for number in sorted(done) for one in done[number]]


def of_hues(job: Job) -> bool:
    """Whether the light of the projector is known by its colours."""
    return job.calibration.kind == "slits" and len(set(job.calibration.colours)) > 1


class LedFrames:
    """The scan's LED frames, of those that show the wall between two stations, read one at a time; then, what is said
    of those that show another lamp's light."""

    def __init__(
        self, job: Job, progress: Progress | None = None, first_mm: float = -math.inf, last_mm: float = math.inf
    ) -> None:
        self._job, self._progress = job, progress
        frames, radius = job.scan.frames, job.calibration.pipe_radius_mm
        self._which = [i for i in job.which(Label.LED) if shows(frames[i].z_mm, radius, first_mm, last_mm)]
        self._others: list[int] = []

    def __iter__(self) -> Iterator[LedFrame]:
        self._others.clear()
        several = of_hues(self._job)
        for done, (i, image) in enumerate(_intact(self._job, self._which)):
            frame = self._job.scan.frames[i]
            if several and diagnose(image).of_projector:
                self._others.append(frame.index)
            else:
                yield LedFrame(frame.index, frame.z_mm, image, frame.camera)
            if self._progress is not None:
                self._progress("texture", done + 1, len(self._which))

    def findings(self) -> tuple[Finding, ...]:
        return lamp_findings(self._others, len(self._which), Label.PROJECTOR, Label.LED)


def _intact(job: Job, which: Sequence[int]) -> Iterator[tuple[int, Image]]:
    """Those of the frames that are what was written, with their image."""
    for i in which:
        with contextlib.suppress(DamagedError):
            yield i, job.read(i)


def damaged_frames(job: Job, which: Sequence[int], read: Set[int]) -> tuple[int, ...]:
    """Indices of the frames of a recording that are not what was written: projector frames that were not read, and LED
    frames whose checksum is wrong."""
    recording = job.scan.recording
    if recording is None:
        return ()
    lost = {job.scan.frames[i].index for i in which} - read
    led = (i for i in job.which(Label.LED) if not recording.is_sound(recording.frames[i]))
    return tuple(sorted({*lost, *(job.scan.frames[i].index for i in led)}))


def missing_findings(job: Job, which: Sequence[int]) -> list[Finding]:
    """What is told of flashes that a camera has no frame of."""
    out: list[Finding] = []
    for one in job.calibration.cameras if job.calibration.others else ():
        seen = {frame.index for frame in job.scan.frames if frame.camera == one.id}
        lost = tuple(job.scan.frames[i].index for i in which if job.scan.frames[i].index not in seen)
        if lost:
            text = f"camera {one.id} has no frame of {len(lost)} of {len(which)} flashes: measured without it"
            text += f" ({first_few(lost)})"
            out.append(Finding(MISSING, text, lost))
    return out


def apart_findings(job: Job, apart: tuple[int, ...], pairs: int) -> list[Finding]:
    """What is told of flashes left out because their cameras see two walls. Raises AnnulusError where most are."""
    if not apart:
        return []
    text = (
        f"in {len(apart)} of {pairs} flashes ({first_few(apart)}) the cameras contradict each other all round: their "
        "frames are not of one flash, or the cameras do not stand as they were calibrated"
    )
    if len(apart) > APART_MOST * pairs:
        raise AnnulusError(f"{job.scan.path}: {text}.")
    return [Finding(APART, f"{text}; left out", apart)]


def damage_findings(job: Job, damaged: Sequence[int]) -> list[Finding]:
    """What is told of a recording that is not as it was written."""
    out: list[Finding] = []
    recording = job.scan.recording
    if recording is None:
        return out
    if damaged:
        text = f"{len(damaged)} frames are damaged and left out (checksum; {first_few(damaged)})"
        out.append(Finding(DAMAGED, text, tuple(damaged)))
    if recording.damage:
        first = recording.damage[0]
        more = f", and {len(recording.damage) - 1} more" if len(recording.damage) > 1 else ""
        out.append(Finding(DAMAGED, f"the recording is damaged: at byte {first.offset} {first.text}{more}"))
    return out
