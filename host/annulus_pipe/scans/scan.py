"""A scan to be reconstructed, whatever camera and program made it: a scan folder or a recording, behind one door.

A scan folder has `frames.csv` and the images it names. Its columns are index, file, light, z_mm and, where the head
has several cameras, camera (its id; rows of one index belong to one flash) and, where it has an inertial sensor,
roll_deg: how far the head was turned clockwise, looking forward, from image up at 12 o'clock. A field of these two may
be empty. Before a plate there is x_mm in place of z_mm: the stage along the head's motion; and height_mm in reference
frames: how far the plate stood towards the head. Other columns are passed over. `imu.csv` beside it, if there, says
how the head turned: `scans/imu.py`.
"""

import csv
import io
import math
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import TypeVar

from annulus_pipe import untrusted
from annulus_pipe.capture.pictures import decode
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.numeric.mosaic import Picture, bgr_of
from annulus_pipe.record.frames import CAMERA_ID_MAX, DROPS_TOPIC, Z_MAX_MM, frame_name
from annulus_pipe.record.missing import missing_told
from annulus_pipe.record.parts import first_names, first_paths
from annulus_pipe.record.recording import Recording, open_recording
from annulus_pipe.scans.imu import Motion, read_motion
from annulus_pipe.storage.numbers import number, require_cells, whole
from annulus_pipe.storage.place import Where, read_whole, where
from annulus_pipe.storage.remote import Url, found_below, listed
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError, Label

TABLE = "frames.csv"
COLUMNS = ("index", "file", "light", "z_mm")
ROLL, CAMERA, SLOT = "roll_deg", "camera", "slot"  # may be missing
PLACE, STAGE, HEIGHT = "z_mm", "x_mm", "height_mm"  # the first may be missing where the second is there
ASIDE = "tx_mm", "ty_mm"
TABLE_MAX = 256 << 20  # bytes; a day at 25 fps has 100 MB
FRAME_MAX = 256 << 20
KIND_MAX, LOST_MAX = 40, 1 << 40  # characters of a kind, and of how many
_Either = TypeVar("_Either", Path, Url)
ROLL_MAX_DEG = 36e3  # a sensor may count turns


@dataclass(frozen=True, slots=True)
class ScanFrame:
    """One frame of a scan: what lit it, where the head stood (NaN where not known), and the words that name it."""

    index: int
    label: Label
    z_mm: float
    where: str
    roll_deg: float | None = None  # clockwise, looking forward
    camera: int = 0  # id; frames of one index belong to one flash
    z_bound_mm: float = 0.0  # how far z may be off; 0: it was counted
    segment: int = 0  # of z: within one, differences of z were counted
    motion: Motion | None = None  # what an inertial sensor said
    x_mm: float | None = None  # of the stage, before a plate
    height_mm: float | None = None  # of the plate, in reference frames
    aside_mm: tuple[float, float] | None = None  # right and down: of the head in a clean pipe, in reference frames
    slot: int | None = None  # place in the lamp cycle, where told


@dataclass(frozen=True)
class Scan:
    """A scan opened for reading; plain data, so that worker processes can be handed one."""

    path: Where
    frames: tuple[ScanFrame, ...]
    calibration: Calibration | None  # what a recording carries; a folder carries none
    recording: Recording | None = None

    @property
    def cameras(self) -> tuple[int, ...]:
        """Ids of the cameras that have a frame here, rising."""
        return tuple(sorted({frame.camera for frame in self.frames}))

    def counts(self) -> dict[str, int]:
        """How many frames each label has."""
        counted = Counter(frame.label for frame in self.frames)
        return {label.value: counted[label] for label in Label}

    def lost(self) -> dict[str, int]:
        """What was lost, by kind: while the head recorded, and since, in how many places."""
        if self.recording is None:
            return {}
        places = len(missing_told(self.recording))
        return {**self._dropped(self.recording), **({"recording_incomplete": places} if places else {})}

    @staticmethod
    def _dropped(recording: Recording) -> dict[str, int]:
        """As the last sound `/drops` says; nothing where none is."""
        notes = list(recording.notes(DROPS_TOPIC))
        for note in reversed(notes):
            try:
                counts = untrusted.mapping(untrusted.mapping(note, DROPS_TOPIC).get("all"), DROPS_TOPIC)
                return {
                    untrusted.printable(untrusted.text(kind, DROPS_TOPIC, KIND_MAX)): untrusted.whole(
                        n, DROPS_TOPIC, 0, LOST_MAX
                    )
                    for kind, n in counts.items()
                }
            except ValueError:
                continue
        return {}

    def same_flash(self, i: int) -> list[int]:
        """Numbers of all frames of the flash of frames[i], in their order."""
        return self._by_flash[self.frames[i].index]

    @cached_property
    def _by_flash(self) -> dict[int, list[int]]:
        out: dict[int, list[int]] = {}
        for i, frame in enumerate(self.frames):
            out.setdefault(frame.index, []).append(i)
        return out

    def part(self, numbers: Sequence[int]) -> "Scan":
        """The same with some of its frames only, numbers into `frames`."""
        recording = self.recording
        if recording is not None:
            recording = replace(recording, frames=tuple(recording.frames[i] for i in numbers))
        return replace(self, frames=tuple(self.frames[i] for i in numbers), recording=recording)

    def only(self) -> "Scan":
        """Itself, for a method that knows one camera. Raises AnnulusError, one line, where there are more."""
        if len(self.cameras) > 1:
            raise AnnulusError(
                f"{self.path}: has frames of cameras {', '.join(map(str, self.cameras))}, expected one camera: this "
                "method does not join views."
            )
        return self

    def plan(self, which: Sequence[int]) -> None:
        """These frames will be read: of a recording in a store their chunks are fetched together, each once."""
        if self.recording is not None:
            self.recording.plan(self.recording.frames[i] for i in which)

    def picture(self, i: int) -> Picture:
        """The image of frames[i]: a recorded mosaic as it lies there, anything else (H, W, 3) uint8 BGR. Raises
        AnnulusError when missing, truncated or damaged."""
        if self.recording is not None:
            return self.recording.picture(self.recording.frames[i])
        return read_image(self.path / self.frames[i].where)

    def read(self, i: int) -> Image:
        """The same, always BGR."""
        return bgr_of(self.picture(i))


def open_scan(place: Where | str) -> Scan:
    """A scan folder, an .mcap recording (all parts of the scan when it is the first), or a folder with one recording.

    place : a path, or a URL of a store. Raises AnnulusError saying what is wrong, and in which line.
    """
    path = where(place)
    try:
        if isinstance(path, Url):
            if path.suffix.lower() != ".mcap":
                return _open_far_folder(path)
        elif path.is_dir():
            recordings = [] if (path / TABLE).exists() else first_paths(path)
            if not recordings:
                return Scan(path, read_table(path), None)
            path = _only(path, recordings)
        elif not path.exists():
            raise AnnulusError(f"{path}: no such scan. Expected a scan folder or an .mcap recording.")
    except PermissionError:
        raise AnnulusError(f"{path}: no permission to read it.") from None
    return _open_recorded(path)


def _open_far_folder(folder: Url) -> Scan:
    there = listed(folder)
    if TABLE in there:
        return Scan(folder, read_table(folder), None)
    names = first_names(there)
    if not names:
        raise AnnulusError(f"{folder}: no such scan. Expected a scan folder or an .mcap recording.")
    return _open_recorded(_only(folder, [folder / name for name in names]))


def _only(folder: Where, recordings: Sequence[_Either]) -> _Either:
    if len(recordings) > 1:
        names = ", ".join(one.name for one in recordings[:5]) + (", .." if len(recordings) > 5 else "")
        raise AnnulusError(f"{folder}: holds {len(recordings)} recordings, expected one. Name one: {names}.")
    return recordings[0]


def _open_recorded(path: Where) -> Scan:
    if path.suffix.lower() != ".mcap":
        raise AnnulusError(f"{path}: not a scan. Expected a folder with {TABLE} or an .mcap recording.")
    recording = open_recording(path)
    if not recording.frames:
        raise AnnulusError(f"{path}: the recording has no frames.")
    try:
        calibration = None if recording.calibration is None else Calibration.from_dict(recording.calibration)
    except ValueError as error:
        raise AnnulusError(f"{path}: the calibration in the recording is damaged: {error}.") from None
    frames = tuple(
        ScanFrame(
            f.index,
            f.label,
            f.z_mm,
            f"{path}: {frame_name(f.index, f.camera)}",
            f.roll_deg,
            f.camera,
            f.z_bound_mm,
            f.segment,
            slot=_slot(recording.label(f).get("slot")),
        )
        for f in recording.frames
    )
    return Scan(path, frames, calibration, recording)


def read_image(path: Where) -> Image:
    """A picture's file as (H, W, 3) uint8 BGR, whole or not at all; see `capture.pictures`. Raises AnnulusError."""
    try:
        return decode(read_whole(path, FRAME_MAX))
    except FileNotFoundError:
        raise AnnulusError(f"{path}: no such frame file, though {TABLE} lists it.") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}).") from None
    except ValueError as error:
        again = " Copy it again from the camera." if "truncated" in str(error) else ""
        raise AnnulusError(f"{path}: {error}.{again}") from None


def read_table(folder: Where) -> tuple[ScanFrame, ...]:
    """What the frames.csv of a scan folder lists, in its order. Raises AnnulusError naming the line."""
    table = folder / TABLE
    try:
        data = read_whole(table, TABLE_MAX)
    except FileNotFoundError:
        try:
            empty = isinstance(folder, Path) and not any(folder.iterdir())
        except OSError as error:
            raise AnnulusError(f"{folder}: cannot be read ({error.strerror}).") from None
        what = "the folder is empty" if empty else f"not a scan, there is no {TABLE}"
        raise AnnulusError(f"{folder}: {what}. Expected {TABLE} ({','.join(COLUMNS)}) and the images.") from None
    except OSError as error:
        raise AnnulusError(f"{table}: cannot be read ({error.strerror}).") from None
    except ValueError as error:
        raise AnnulusError(f"{table}: {error}.") from None
    try:
        inside: dict[PurePosixPath, bool] = {}
        there = None if isinstance(folder, Path) else set(found_below(folder))
        rows = csv.DictReader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
        columns = [name.strip() for name in rows.fieldnames or ()]
        if len(set(columns)) < len(columns):
            raise AnnulusError(f"{table}: line 1: a column is there twice. Expected {','.join(COLUMNS)}.")
        missing = [name for name in COLUMNS if name not in columns and not (name == PLACE and STAGE in columns)]
        if missing:
            stage = f" ({STAGE} in place of {PLACE} before a plate)" if PLACE in missing else ""
            raise AnnulusError(f"{table}: line 1: no column {', '.join(missing)}. Expected {','.join(COLUMNS)}{stage}.")
        rows.fieldnames = columns
        frames: list[ScanFrame] = []
        known: set[tuple[int, int]] = set()
        for row in rows:
            try:
                require_cells(row, len(columns))
                frame = _frame(row, folder, inside, there)
                if (frame.index, frame.camera) in known:
                    of = f" of camera {frame.camera}" if frame.camera else ""
                    raise ValueError(f"index {frame.index}{of} was there before")
            except ValueError as error:
                raise AnnulusError(f"{table}: line {rows.line_num}: {error}.") from None
            known.add((frame.index, frame.camera))
            frames.append(frame)
    except UnicodeDecodeError:
        raise AnnulusError(f"{table}: not a text file. Expected {','.join(COLUMNS)}.") from None
    except csv.Error as error:
        raise AnnulusError(f"{table}: line {rows.reader.line_num}: {error}.") from None
    if not frames:
        raise AnnulusError(f"{table}: lists no frames. Expected at least one line below {','.join(COLUMNS)}.")
    motions = read_motion(folder, (frame.index for frame in frames))
    return tuple(replace(f, motion=motions[f.index]) if f.index in motions else f for f in frames)


def _frame(
    row: dict[str, str | None], folder: Where, inside: dict[PurePosixPath, bool], there: Collection[str] | None
) -> ScanFrame:
    """`inside`: of folders of images, whether they are in the scan's own; filled here. `there`: names in a store."""
    index, file, light, z_text = ((row.get(name) or "").strip() for name in COLUMNS)
    if light not in {label.value for label in Label}:
        raise ValueError(f'light is "{light[:40]}", expected projector, led or unknown')
    z = number(z_text) if PLACE in row else math.nan
    if PLACE in row and not abs(z) <= Z_MAX_MM:
        raise ValueError(f'z_mm is "{z_text[:40]}", expected a number of mm')
    place = PurePosixPath(file)
    if not file or len(file) > 1024 or place.is_absolute() or ".." in place.parts or "\\" in file or "\0" in file:
        raise ValueError(f"file is {shown(file)}, expected the path of an image inside the scan folder")
    if not isinstance(folder, Path):
        if there is not None and str(place) not in there:
            raise ValueError(f"{file} is not there")
    elif not (folder / file).is_file():
        raise ValueError(f"{file} is not there")
    elif place.parent not in inside:
        inside[place.parent] = (folder / place.parent).resolve().is_relative_to(folder.resolve())
    if isinstance(folder, Path) and (not inside[place.parent] or (folder / file).is_symlink()):
        raise ValueError(f"file {shown(file)} is or lies behind a link, expected an image inside the scan folder")
    camera = whole((row.get(CAMERA) or "").strip() or "0", CAMERA)
    if camera > CAMERA_ID_MAX:
        raise ValueError(f"{CAMERA} is {camera}, expected an id in 0..{CAMERA_ID_MAX}")
    x, height, right, down = (_length(row.get(name), name) for name in (STAGE, HEIGHT, *ASIDE))
    return ScanFrame(
        whole(index, "index"),
        Label(light),
        z,
        file,
        _roll(row.get(ROLL)),
        camera,
        x_mm=x,
        height_mm=height,
        aside_mm=None if right is None or down is None else (right, down),
        slot=whole((row.get(SLOT) or "").strip(), SLOT) if (row.get(SLOT) or "").strip() else None,
    )


def _slot(value: object) -> int | None:
    """Of a label, as it was written."""
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def _length(text: str | None, name: str) -> float | None:
    if text is None or not text.strip():
        return None
    value = number(text)
    if not abs(value) <= Z_MAX_MM:
        raise ValueError(f'{name} is "{text[:40]}", expected a number of mm')
    return value


def _roll(text: str | None) -> float | None:
    if text is None or not text.strip():
        return None
    roll = number(text)
    if not abs(roll) <= ROLL_MAX_DEG:
        raise ValueError(f'{ROLL} is "{text[:40]}", expected degrees, or nothing where not known')
    return roll
