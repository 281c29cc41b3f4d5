"""A scan in ranges of its flashes, each measured where its bytes are, and kept as one file of profiles.

Ranges lie on the grid of chunks: a chunk's first frame has no seed and its others have the one before, so profiles are
the same whether a scan is taken whole or in ranges. What must be decided once for a scan is decided before, and goes
with the work. A range carries the rows of its own frames and where their bytes lie: no worker walks a recording.

A file's name is the address of all that its profiles follow from (bytes, rows, calibration, decisions, code). What is
there and sound is not made again; what is not is made anew. A file with damaged frames is not believed either: the
address has the checksums that were written, and the bytes may have come back. Profiles stay in the place; what a worker
says of a range (`Facts`) is small.
"""

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.record.frames import RecordedFrame
from annulus_pipe.record.recording import Recording
from annulus_pipe.record.walk import DamagedError
from annulus_pipe.reprocess.executors import Executor, Failed
from annulus_pipe.reprocess.job import Job, measured, stage_medians
from annulus_pipe.reprocess.method import method_for
from annulus_pipe.reprocess.profile_file import packed, unpacked
from annulus_pipe.reprocess.versions import address, measured_with, processor
from annulus_pipe.rings.diagnosis import FrameLighting
from annulus_pipe.scans.scan import FRAME_MAX, Scan
from annulus_pipe.stereo import CAMERA_MISSING, TWO_WALLS
from annulus_pipe.storage.place import StoragePath, Where, read_whole
from annulus_pipe.vocabulary import AnnulusError, Label
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.windows import Reach

CHUNK = 8  # consecutive frames one worker does in a row, each seeded by the one before; fixed, so that results
# do not depend on the number of workers
CHUNKS = 16  # of a range: 128 frames are 10 s of work and 10 MB of profiles
FOLDER = "ranges"


@dataclass(frozen=True, slots=True)
class Range:
    """Some flashes of a scan, by its grid. part : the scan's frames of those flashes, and nothing else of it; which :
    the flashes, numbers into the part's frames."""

    number: int
    part: Scan
    which: tuple[int, ...]

    @property
    def indices(self) -> tuple[int, ...]:
        return tuple(self.part.frames[i].index for i in self.which)


@dataclass(frozen=True, slots=True)
class Facts:
    """What is known of a range without its profiles. Frames are told by their index.

    name : its file in the place. lights : of every frame that was read. damaged : frames that could not be. poses : of
    the frames that show a pipe, in their order; without_pose : those that do not. apart : whose cameras see two walls;
    pairs : flashes that all cameras saw. rejected : slits seen and not used, by reason. z_mm : of its points, the least
    and the largest; of its frames where there are none. made : it was measured now, not found. timing_ms : of every
    stage the median over its frames, and of their sum. processor : that it was measured on. reaches : of every frame
    that was read, where its points lie.
    """

    number: int
    name: str
    first: int
    last: int
    lights: tuple[tuple[int, FrameLighting], ...]
    damaged: tuple[int, ...]
    poses: tuple[Pose, ...]
    without_pose: tuple[int, ...]
    apart: tuple[int, ...]
    pairs: int
    points: int
    rejected: Mapping[str, int]
    z_mm: tuple[float, float]
    timing_ms: Mapping[str, float]
    made: bool
    processor: str
    reaches: tuple[Reach | None, ...]

    @property
    def frames(self) -> tuple[int, ...]:
        """That have a profile."""
        return tuple(frame for frame, _ in self.lights)


class Ranges(Sequence[Range]):
    """A scan's ranges, cut as they are asked for: of a long scan not all are there at once."""

    def __init__(self, job: Job, which: Sequence[int] | None = None, chunks: int = CHUNKS) -> None:
        """`which`: numbers of flashes; all of the projector's where None. `chunks`: of a range."""
        self._scan = job.scan
        self._which = tuple(job.flashes(Label.PROJECTOR) if which is None else which)
        self._of = chunks * CHUNK
        self._alone = len(job.scan.cameras) == 1

    def __len__(self) -> int:
        return -(-len(self._which) // self._of)

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return [self[one] for one in range(*number.indices(len(self)))]
        if not 0 <= number < len(self):
            raise IndexError(number)
        which = self._which[number * self._of : (number + 1) * self._of]
        kept = which if self._alone else sorted({j for i in which for j in self._scan.same_flash(i)})
        where = {i: k for k, i in enumerate(kept)}
        return Range(number, part_of(self._scan, kept), tuple(where[i] for i in which))


def part_of(scan: Scan, kept: Sequence[int]) -> Scan:
    """Those frames of a scan, with what it takes to read them."""
    recording = scan.recording
    if recording is not None:
        frames = tuple(recording.frames[i] for i in kept)
        needed = {frame.part for frame in frames}
        parts = tuple(
            _bare(replace(part, path=_found(part.path)))
            if n in needed
            else replace(_bare(part), path=_found(recording.path), index=None)
            for n, part in enumerate(recording.parts)
        )
        recording = replace(_bare(recording), path=_found(recording.path), frames=frames, parts=parts)
    return Scan(_found(scan.path), tuple(scan.frames[i] for i in kept), None, recording)


def _found(path: Where) -> Where:
    """From wherever a worker begins; URLs are whole."""
    return path.absolute() if isinstance(path, Path) else path


def _bare(recording: Recording) -> Recording:
    """Its path, and what a frame of it is read by."""
    return replace(
        recording,
        frames=(),
        calibration=None,
        configuration=None,
        _labels={},
        _notes={},
        damage=(),
        _chunks=(),
        _data_crc=None,
        _sound={},
        part=None,
        parts=(),
        index=None if recording.index is None else recording.index.bare(),
    )


@dataclass(frozen=True, slots=True)
class Measuring:
    """Work: a range to its file in the place. job : with all decisions in it, its scan's frames left out. given : the
    address of what all ranges follow from; of whoever hands out the work, and a worker that measures otherwise is given
    none (`cluster`)."""

    job: Job
    place: StoragePath
    given: str

    def ready(self) -> Callable[[Range], Facts]:
        method = method_for(self.job.calibration, self.job.colour)

        def do(one: Range) -> Facts:
            name = f"{FOLDER}/{one.number:06d}-{address(self.given, one.which, identity(one.part))[:32]}.parquet"
            there = self.place.read(name)
            if there is not None:
                try:
                    profiles, about = unpacked(there, name)
                    facts = facts_of(one, name, profiles, about, False)
                    if not facts.damaged:
                        return facts
                except AnnulusError:  # half of it, or another's: made anew
                    pass
            job = replace(self.job, scan=one.part)
            chunks = [one.which[k : k + CHUNK] for k in range(0, len(one.which), CHUNK)]
            done = [each for chunk in chunks for each in measured(job, method, chunk)]
            profiles = tuple(profile for profile, _ in done)
            lights = [
                [light.bright, light.clipped, light.lost, light.hues, light.glare, light.picture] for _, light in done
            ]
            about = {"lights": lights, "processor": processor()}
            self.place.write(name, packed(profiles, about))
            return facts_of(one, name, profiles, about, True)

        return do


def measuring(job: Job, place: StoragePath) -> Measuring:
    """`job`: its colour decided."""
    return Measuring(without_frames(job), place, address(measured_with(), job.calibration, job.colour))


def without_frames(job: Job) -> Job:
    """What goes with the work once; frames go with each item."""
    return replace(job, scan=replace(job.scan, frames=(), calibration=None, recording=None))


def facts_of(one: Range, name: str, profiles: Sequence[Profile], about: Mapping[str, Any], made: bool) -> Facts:
    """Raises AnnulusError where the profiles are not those of the range."""
    frames, lights = [profile.frame for profile in profiles], about.get("lights")
    made_on = about.get("processor")
    sound = isinstance(lights, list) and len(lights) == len(frames) and isinstance(made_on, str)
    if not sound or not all(_is_light(light) for light in lights or ()) or not set(frames) <= set(one.indices):
        raise AnnulusError(f"{name}: not the profiles of range {one.number}.")
    rejected: Counter[str] = Counter()
    for profile in profiles:
        rejected.update(profile.rejected)
    ends = [(float(p.points_mm[:, 2].min()), float(p.points_mm[:, 2].max())) for p in profiles if len(p.points_mm)]
    ends = ends or [(one.part.frames[i].z_mm,) * 2 for i in one.which]
    return Facts(
        one.number,
        name,
        one.indices[0],
        one.indices[-1],
        tuple((frame, FrameLighting(*light)) for frame, light in zip(frames, lights or (), strict=True)),
        tuple(frame for frame in one.indices if frame not in set(frames)),
        tuple(p.pose for p in profiles if p.pose is not None),
        tuple(p.frame for p in profiles if p.pose is None),
        tuple(p.frame for p in profiles if TWO_WALLS in p.rejected),
        sum(CAMERA_MISSING not in p.rejected for p in profiles),
        sum(len(p.points_mm) for p in profiles),
        dict(rejected),
        (min(low for low, _ in ends), max(high for _, high in ends)),
        stage_medians(profiles),
        made,
        str(made_on),
        tuple(map(Reach.of, profiles)),
    )


def _is_light(value: object) -> bool:
    return isinstance(value, list) and [type(one) for one in value] == [float] * 4 + [int] * 2


def identity(part: Scan) -> tuple[Any, ...]:
    """What says which bytes a part's frames are: the checksums their chunks were written with, or, where there is none,
    a SHA-256 of the bytes. Raises AnnulusError where they cannot be read."""
    rows = tuple(replace(frame, where="") for frame in part.frames)
    if part.recording is None:
        return rows, tuple(_of_file(part, frame.where) for frame in part.frames)
    return rows, tuple(_of_message(part.recording, frame) for frame in part.recording.frames)


def _of_file(part: Scan, name: str) -> str:
    path = part.path / name
    try:
        return hashlib.sha256(read_whole(path, FRAME_MAX)).hexdigest()
    except (OSError, ValueError):
        return "unread"  # what is wrong with it is said when it is measured, and no file is written then


def _of_message(recording: Recording, frame: RecordedFrame) -> tuple[Any, ...]:
    chunk = frame.chunk
    if chunk is not None and chunk.crc is not None:
        return frame.offset - chunk.offset, frame.length, frame.jpeg, chunk.length, chunk.size, chunk.crc
    try:
        pixels = recording.read_jpeg(frame) if frame.jpeg else recording.read_raw(frame)[0].tobytes()
        return frame.length, frame.jpeg, hashlib.sha256(pixels).hexdigest()
    except DamagedError:
        return frame.length, frame.jpeg, "damaged"


def profiles_of(place: StoragePath, facts: Facts) -> tuple[Profile, ...]:
    """Of a range that was measured. Raises AnnulusError where its file is not what was written."""
    data = place.read(facts.name)
    if data is None:
        raise AnnulusError(f"{place}: {facts.name} is no longer there. Expected what was measured a moment ago.")
    return unpacked(data, f"{place}: {facts.name}")[0]


def measure_ranges(
    job: Job,
    place: StoragePath,
    executor: Executor,
    report: Callable[[int, int], None] = lambda done, total: None,
    chunks: int = CHUNKS,
) -> Iterator[tuple[Range, Facts | Failed]]:
    """Every range with what became of it, in any order. report : (frames done, frames in all)."""
    ranges = Ranges(job, chunks=chunks)
    total = len(job.flashes(Label.PROJECTOR))
    done = 0
    report(done, total)
    for number, outcome in executor(measuring(job, place), ranges):
        one = ranges[number]
        done += len(one.which)
        report(done, total)
        yield one, outcome


def clear(place: StoragePath, facts: Sequence[Facts]) -> None:
    """Take away what earlier code or calibrations left among the ranges."""
    kept = {one.name for one in facts}
    for name in place.names(f"{FOLDER}/"):
        if name not in kept:
            place.remove(name)
