"""From a scan on disk to its results, the projector frames spread over worker processes."""

import ctypes
import multiprocessing
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from annulus.geometry.calibration import Calibration
from annulus.numeric.arrays import Image
from annulus.record.calibration_file import load_calibration, load_part
from annulus.record.scan import Scan, open_scan
from annulus.report.results import Summary, prepare_folder, write_results
from annulus.rings.calibration.reference import Reference
from annulus.rings.colour import ColourProfile
from annulus.rings.diagnosis import Exposure, Trouble, diagnose, examine, exposure_findings, reference_findings
from annulus.rings.reconstructor import Reconstructor
from annulus.vocabulary import AnnulusError, Label
from annulus.wall.profile import Profile
from annulus.wall.texture import LedFrame

Progress = Callable[[str, int, int], None]  # stage, done, total

LOOKED_AT = 4  # frames examined for what may be wrong with all of them
CHUNK = 8  # consecutive frames one worker does in a row, each seeded by the one before; fixed, so that results
# do not depend on the number of workers


def reconstruct(
    scan: Path,
    calibration: Path | None,
    out: Path,
    *,
    colour: Path | None = None,
    reference: Path | None = None,
    vibration: bool = False,
    fps: float | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Summary:
    """Reconstruct a scan folder or recording and write every result file into `out`.

    Parameters
    ----------
    calibration : file; a recording's own is used when None. colour, reference : files of `annulus calibrate colour` and
        `reference`.
    vibration : take out what shakes periodically along the pipe. fps : frames a second, to say that in hertz.
    workers : processes, one a core when None; 1 works in this process.
    progress : called with (stage, done, total).

    Raises
    ------
    AnnulusError, one line, for any input that is missing, damaged or does not belong together.
    """
    started = time.perf_counter()
    opened = roll_filled(open_scan(scan).only())
    known = load_calibration(calibration) if calibration is not None else opened.calibration
    if known is None:
        raise AnnulusError(f"{scan}: carries no calibration. Give one with --calibration FILE.")
    pattern = None if reference is None else load_part(reference, Reference.from_dict, "annulus calibrate reference")
    if pattern is not None:
        try:
            known = pattern.applied(known)
        except ValueError as error:
            raise AnnulusError(f"{reference}: {error}. Make it with this calibration.") from None
    paint = None if colour is None else load_part(colour, ColourProfile.from_dict, "annulus calibrate colour")
    prepare_folder(out)
    report = progress or (lambda stage, done, total: None)
    projector = [i for i, frame in enumerate(opened.frames) if frame.label is Label.PROJECTOR]
    if not projector:
        raise AnnulusError(
            f"{scan}: none of its {len(opened.frames)} frames is labelled projector, nothing to measure."
        )
    read_checked(opened, projector[0], known)  # the usual mistakes, before any process starts
    reconstructor = Reconstructor(known, colour=paint)
    findings = list(examine(reconstructor, _some(opened, known, projector), paint))
    if any(finding.trouble is Trouble.PAINT for finding in findings):
        reconstructor = Reconstructor(known)
    profiles, exposures = _profiles(opened, reconstructor, projector, workers or os.cpu_count() or 1, report)
    findings = [*exposure_findings(exposures), *findings]
    if findings and all(profile.pose is None for profile in profiles):
        raise AnnulusError(f"{scan}: {findings[0].text}.")
    if pattern is not None:
        findings += reference_findings(pattern, [profile.pose for profile in profiles if profile.pose is not None])
    counted = Counter(str(frame.label) for frame in opened.frames)
    frames = {str(label): counted.get(str(label), 0) for label in Label}
    drops = {
        "frames_unknown": frames[str(Label.UNKNOWN)],
        "profiles_without_pose": sum(profile.pose is None for profile in profiles),
    }
    if opened.recording is not None:
        drops["recording_torn"] = int(opened.recording.torn)
    led = [i for i, frame in enumerate(opened.frames) if frame.label is Label.LED]
    timing = stage_medians(profiles)
    timing["scan_to_profiles"] = (time.perf_counter() - started) * 1e3
    return write_results(
        out, known, profiles, led_frames(opened, known, led, report), frames=frames, drops=drops, timing_ms=timing,
        source=str(scan), findings=findings, vibration=vibration, fps=fps,
    )  # fmt: skip


def _some(scan: Scan, calibration: Calibration, projector: Sequence[int]) -> list[tuple[int, Image]]:
    """A few frames spread over the scan, for a look at what may be wrong with all of them."""
    chosen = sorted({projector[k * (len(projector) - 1) // max(LOOKED_AT - 1, 1)] for k in range(LOOKED_AT)})
    return [(scan.frames[i].index, read_checked(scan, i, calibration)) for i in chosen]


def roll_filled(scan: Scan) -> Scan:
    """The same scan, frames between two whose roll is known given one between; all of them, or none."""
    known = [(i, frame.roll_deg) for i, frame in enumerate(scan.frames) if frame.roll_deg is not None]
    if not known or len(known) == len(scan.frames):
        return scan
    turned = np.unwrap([roll for _, roll in known], period=360.0)
    rolls = np.interp(np.arange(len(scan.frames)), [i for i, _ in known], turned)
    frames = tuple(replace(frame, roll_deg=float(r)) for frame, r in zip(scan.frames, rolls, strict=True))
    return replace(scan, frames=frames)


def led_frames(scan: Scan, calibration: Calibration, which: Sequence[int], report: Progress) -> Iterator[LedFrame]:
    """The scan's LED frames, read one at a time."""
    for done, i in enumerate(which):
        frame = scan.frames[i]
        yield LedFrame(frame.index, frame.z_mm, read_checked(scan, i, calibration))
        report("texture", done + 1, len(which))


def read_checked(scan: Scan, i: int, calibration: Calibration) -> Image:
    """frames[i] as BGR. Raises AnnulusError when it is damaged or of another size than the calibrated camera's."""
    image = scan.read(i)
    height, width = image.shape[:2]
    camera = calibration.camera
    if (width, height) != (camera.width, camera.height):
        raise AnnulusError(
            f"calibration: camera is {camera.width}x{camera.height} but {scan.frames[i].where} is {width}x{height}. "
            "Calibrate with the camera that took this scan."
        )
    return image


def stage_medians(profiles: Sequence[Profile]) -> dict[str, float]:
    """Median ms of every stage over the frames, and `frame`: of their sum."""
    stages = {name: None for profile in profiles for name in profile.timing_ms}
    out = {
        name: float(np.median([p.timing_ms[name] for p in profiles if name in p.timing_ms])) for name in stages
    }  # fmt: skip
    if "total" not in out:
        sums = [sum(p.timing_ms.values()) for p in profiles if p.timing_ms]
        out["total"] = float(np.median(sums)) if sums else 0.0
    return out


Lit = tuple[Profile, Exposure]


def _profiles(
    scan: Scan, reconstructor: Reconstructor, which: Sequence[int], workers: int, report: Progress
) -> tuple[list[Profile], list[tuple[int, Exposure]]]:
    chunks = [which[start : start + CHUNK] for start in range(0, len(which), CHUNK)]
    done: dict[int, list[Lit]] = {}
    finished = 0
    report("frames", 0, len(which))
    if workers == 1 or len(chunks) == 1:
        for number, chunk in enumerate(chunks):
            done[number] = _reconstruct(scan, reconstructor, chunk)
            finished += len(chunk)
            report("frames", finished, len(which))
        return _in_order(done)
    setup = scan, reconstructor.calibration, reconstructor.colour, os.getpid()
    pool = ProcessPoolExecutor(min(workers, len(chunks)), multiprocessing.get_context("spawn"), _start_worker, setup)
    try:
        futures = {pool.submit(_work, chunk): number for number, chunk in enumerate(chunks)}
        for future in as_completed(futures):
            number = futures[future]
            done[number] = [(Profile.from_dict(one), exposure) for one, exposure in future.result()]
            finished += len(chunks[number])
            report("frames", finished, len(which))
    except BrokenProcessPool:
        raise AnnulusError("a worker process died while reconstructing. Out of memory? Try --workers 1.") from None
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
    return _in_order(done)


def _in_order(done: Mapping[int, Sequence[Lit]]) -> tuple[list[Profile], list[tuple[int, Exposure]]]:
    lit = [one for number in sorted(done) for one in done[number]]
    return [profile for profile, _ in lit], [(profile.frame, exposure) for profile, exposure in lit]


def _reconstruct(scan: Scan, reconstructor: Reconstructor, which: Sequence[int]) -> list[Lit]:
    out: list[Lit] = []
    seed = None
    for i in which:
        frame = scan.frames[i]
        image = read_checked(scan, i, reconstructor.calibration)
        profile = reconstructor.profile(image, frame=frame.index, z_mm=frame.z_mm, seed=seed, roll_deg=frame.roll_deg)
        seed = profile.pose
        out.append((profile, diagnose(image)))
    return out


_worker: tuple[Scan, Reconstructor] | None = None  # one a worker process, set when it starts


def _start_worker(scan: Scan, calibration: Calibration, colour: ColourProfile | None, parent: int) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG: never outlive the command
    if os.getppid() != parent:
        os._exit(1)
    cv2.setNumThreads(1)
    _worker = scan, Reconstructor(calibration, colour=colour)


def _work(which: Sequence[int]) -> list[tuple[Mapping[str, object], Exposure]]:
    assert _worker is not None
    return [(profile.to_dict(), exposure) for profile, exposure in _reconstruct(*_worker, which)]
