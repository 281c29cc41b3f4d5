"""A video of a profiler head, or a folder of its pictures, as a scan folder: every frame a picture, its place from a
table or an even speed.

A frame is known by its number, counted from 0 as it is decoded, or in the order of the pictures' names, in which 10
comes after 9: the number a table of chainage means. All frames are taken to be lit by the projector: such heads have a
light that stays on.

What a decoder would hide is looked for: FFmpeg scales pictures of another size to that of the first, and ends a
truncated file as if it had been whole. The folder appears when all of it is written, or not at all.
"""

import csv
import io
import math
import os
import re
import shutil
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.capture.camera import SIDE_MAX
from annulus_pipe.capture.pictures import PIXELS_MAX, size_of
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.frames import Z_MAX_MM
from annulus_pipe.scans.fields import TWO_FIELDS, combed, two_fields
from annulus_pipe.scans.scan import COLUMNS, TABLE, read_image
from annulus_pipe.storage.numbers import require_cells
from annulus_pipe.untrusted import read_file, shown
from annulus_pipe.vocabulary import AnnulusError, Label

UNITS_MM = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "in": 25.4, "ft": 304.8}
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm")
CHAINAGE_MAX = 64 << 20  # bytes; a day at 25 fps has 40 MB
FRAME_NUMBER_MAX = 1 << 31
ASPECT_MOST = 4.0  # of a pixel; a DVD's are 16:15 to 64:45

_HEADING = re.compile(r"chainage[\s_\[(]*(mm|cm|m|in|ft)?[\])]?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Chainage:
    """Where the head was at some frames; between two of them even."""

    frames: tuple[int, ...]  # rising
    z_mm: tuple[float, ...]

    def at(self, frame: int) -> float | None:
        """mm; None before the first frame of the table and after its last."""
        after = bisect_right(self.frames, frame)
        if after == 0 or (after == len(self.frames) and frame != self.frames[-1]):
            return None
        if frame == self.frames[after - 1]:
            return self.z_mm[after - 1]
        (f0, f1), (z0, z1) = self.frames[after - 1 : after + 1], self.z_mm[after - 1 : after + 1]
        return z0 + (z1 - z0) * (frame - f0) / (f1 - f0)


@dataclass(frozen=True, slots=True)
class Imported:
    """What became of a video."""

    frames: int
    z_mm: tuple[float, float]  # of the first frame and the last
    without_place: int  # frames the table of chainage does not reach; left out
    missing: int  # frames the file announces and does not have
    aspect: float = 1.0  # of the video's pixels, width to height; the pictures' are square


def read_chainage(path: Path, unit: str | None = None) -> Chainage:
    """A CSV with the columns `frame` and `chainage`, one row a frame that is known; others are passed over.

    unit : of UNITS_MM, where the heading (`chainage_m`, `chainage [ft]`) names none; where neither
    does it is asked for, since counters show metres or feet, and a guess would be wrong by 1000 in silence.
    Raises AnnulusError naming the line.
    """
    try:
        text = read_file(path, CHAINAGE_MAX).decode("utf-8-sig")
        table = csv.reader(io.StringIO(text, newline=""), strict=True)
        header = next(table, [])
        frame_at, place_at, factor = _columns(header, unit)
        frames: list[int] = []
        places: list[float] = []
        for row in table:
            if not any(field.strip() for field in row):
                continue
            try:
                require_cells(row, len(header))
            except ValueError as error:
                raise ValueError(f"line {table.line_num}: {error}") from None
            frame, place = row[frame_at].strip(), row[place_at].strip()
            if not (frame.isascii() and frame.isdigit()) or len(frame) > 18 or int(frame) >= FRAME_NUMBER_MAX:
                raise ValueError(f"line {table.line_num}: frame is {shown(frame)}, expected a whole number")
            if frames and int(frame) <= frames[-1]:
                raise ValueError(
                    f"line {table.line_num}: frame {int(frame)} after {frames[-1]}, expected a rising order"
                )
            z = _number(place) * factor
            if not abs(z) <= Z_MAX_MM:
                raise ValueError(f"line {table.line_num}: chainage is {shown(place)}, expected a number")
            frames.append(int(frame))
            places.append(z)
    except FileNotFoundError:
        raise AnnulusError(f"{path}: no such table of chainage.") from None
    except UnicodeDecodeError:
        raise AnnulusError(f"{path}: not a text file. Expected the columns frame,chainage.") from None
    except OSError as error:
        raise AnnulusError(f"{path}: cannot be read ({error.strerror}).") from None
    except csv.Error as error:
        raise AnnulusError(f"{path}: line {table.line_num}: {error}.") from None
    except ValueError as error:
        raise AnnulusError(f"{path}: {error}.") from None
    if not frames:
        raise AnnulusError(f"{path}: has no rows. Expected frame,chainage and a line for each frame that is known.")
    return Chainage(tuple(frames), tuple(places))


def _columns(header: list[str], unit: str | None) -> tuple[int, int, float]:
    """Where frame and chainage stand, and how many mm one of it is."""
    names = [name.strip() for name in header]
    places = [(i, found) for i, name in enumerate(names) if (found := _HEADING.fullmatch(name))]
    frames = [i for i, name in enumerate(names) if name.lower() == "frame"]
    if len(places) != 1 or len(frames) != 1:
        raise ValueError(f"line 1 is {shown(','.join(names))}, expected one column frame and one chainage")
    at, found = places[0]
    named = found[1].lower() if found[1] else None
    if unit and named and unit != named:
        raise ValueError(f"line 1: {names[at]} is in {named}, but {unit} was asked for")
    if not named and not unit:
        raise ValueError(
            f"line 1: {names[at]} has no unit, expected one of {', '.join(UNITS_MM)} in its heading, "
            "such as chainage_m, or told beside it"
        )
    return frames[0], at, UNITS_MM[named or unit or ""]


def _number(text: str) -> float:
    """NaN where it is none."""
    try:
        return float(text) if text.isascii() and "_" not in text else math.nan
    except ValueError:
        return math.nan


def import_video(
    video: Path,
    folder: Path,
    *,
    chainage: Chainage | None = None,
    speed_mm_s: float | None = None,
    fps: float | None = None,
    first: int = 0,
    last: int | None = None,
    every: int = 1,
    progress: Callable[[str, int, int], None] | None = None,
) -> Imported:
    """Write frames first, first + every, .. up to last of a video, or of a folder of pictures, into a new scan folder;
    index = frame number.

    Either `chainage` says where the frames were, or `speed_mm_s` at `fps` frames a second (the file's own if None).
    One frame is held at a time. Raises AnnulusError, one line, for a video that cannot be read, has no such frames, or
    changes its size, for a folder that holds something, and where it cannot be written.
    """
    if (chainage is None) == (speed_mm_s is None):
        raise AnnulusError(f"{video}: expected either a table of chainage or a speed, to know where frames were.")
    if speed_mm_s is not None and not math.isfinite(speed_mm_s):
        raise AnnulusError(f"{video}: a speed of {speed_mm_s} mm/s, expected a number.")
    if first < 0 or every < 1 or (last is not None and last < first):
        raise AnnulusError(f"{video}: frames {first} to {last} by {every}, expected a range that rises.")
    partial = folder.with_name(f".{folder.name}.{os.getpid()}.part")
    try:
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise AnnulusError(f"{folder}: is not empty, expected a new folder for the scan.")
        source = _Pictures(video) if video.is_dir() else _Video(video)
        rate = source.fps if fps is None else fps
        if chainage is None and not 0 < rate < math.inf:
            raise AnnulusError(f"{video}: names no frame rate. Say how many frames a second it has.")
        (partial / "frames").mkdir(parents=True)
        rows, without_place, combs = [], 0, 0
        for number in range(first, FRAME_NUMBER_MAX if last is None else last + 1, every):
            z = chainage.at(number) if chainage is not None else (speed_mm_s or 0.0) * number / rate
            image = source.frame(number, decoded=z is not None)
            if progress is not None:
                progress("frames", number, max(number, last or source.announced))
            if source.ended:
                break
            if image is None or z is None:
                without_place += 1
                continue
            combs += combed(image)
            name = f"frames/{number:06d}.png"
            data = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
            (partial / name).write_bytes(data.tobytes())
            rows.append((number, name, Label.PROJECTOR.value, f"{z:.4f}"))
        if source.missing and rows and rows[-1][0] == source.read - 1:
            (partial / rows.pop()[1]).unlink()  # the last picture before the file breaks off may be half of one
        if two_fields(combs, len(rows)):
            raise AnnulusError(f"{video}: {combs} of {len(rows)} pictures {TWO_FIELDS}")
        if not rows:
            if without_place:
                raise AnnulusError(f"{video}: the table of chainage reaches none of its {without_place} frames.")
            of = f"has {source.read} frames" if source.read else "has no frame that can be decoded"
            raise AnnulusError(f"{video}: {of}, expected some from frame {first} on.")
        with (partial / TABLE).open("w", newline="") as file:
            csv.writer(file).writerows([COLUMNS, *rows])
        partial.replace(folder)
    except OSError as error:
        raise AnnulusError(f"{folder}: cannot be written ({error.strerror}).") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return Imported(len(rows), (float(rows[0][3]), float(rows[-1][3])), without_place, source.missing, source.aspect)


class _Pictures:
    """A folder of pictures as a video, in the order of their names."""

    missing = 0
    fps = 0.0  # nobody knows
    aspect = 1.0

    def __init__(self, folder: Path) -> None:
        """Raises AnnulusError, one line, where it has none."""
        try:
            files = [path for path in folder.iterdir() if path.suffix.lower() in PICTURES and path.is_file()]
        except OSError as error:
            raise AnnulusError(f"{folder}: cannot be read ({error.strerror}).") from None
        if not files:
            raise AnnulusError(f"{folder}: holds no pictures. Expected some of {', '.join(PICTURES)}, or a video.")
        self._files = sorted(files, key=lambda path: _counted(path.name))
        self.announced = len(files)
        self.read, self.ended = 0, False
        self._size: tuple[int, ...] = ()

    def frame(self, number: int, decoded: bool = True) -> Image | None:
        """As of a video; all are of one size."""
        self.ended = number >= len(self._files)
        self.read = min(number + 1, len(self._files))
        if self.ended or not decoded:
            return None
        path = self._files[number]
        image = read_image(path)
        if self._size and image.shape != self._size:
            (height, width, _), (before, wide, _) = image.shape, self._size
            raise AnnulusError(f"{path}: a picture of {width}x{height}, those before are {wide}x{before}.")
        self._size = image.shape
        return np.ascontiguousarray(image[..., 0]) if (image == image[..., :1]).all() else image


def _counted(name: str) -> list[tuple[int, str]]:
    """To sort names by as people count: 9 before 10."""
    parts = re.split(r"([0-9]{1,18})", name)
    return [(int(part), "") if i % 2 else (-1, part) for i, part in enumerate(parts)]


class _Video:
    """A video read forwards, one frame at a time; frames are counted from 0 as they are decoded."""

    def __init__(self, path: Path) -> None:
        """Raises AnnulusError, one line, for what is no video, or none that can be measured in."""
        try:
            if not path.is_file():
                raise AnnulusError(f"{path}: {'not a file' if path.exists() else 'no such video'}.")
            path.open("rb").close()
        except OSError as error:
            raise AnnulusError(f"{path}: cannot be read ({error.strerror}).") from None
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # what FFmpeg prints of a damaged file is no line of ours
        self._path = path
        self._capture = _opened(path)
        if not self._capture.isOpened():
            raise AnnulusError(f"{path}: not a video, or cut short before its table of contents.")
        self._capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)  # a calibration is of the picture as the sensor gave it
        width, height = (self._capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))
        if not (0 < width <= SIDE_MAX and 0 < height <= SIDE_MAX and width * height <= PIXELS_MAX):
            raise AnnulusError(f"{path}: pictures of {width:.0f}x{height:.0f}, expected sides of at most {SIDE_MAX}.")
        wide, high = (self._capture.get(part) for part in (cv2.CAP_PROP_SAR_NUM, cv2.CAP_PROP_SAR_DEN))
        self.aspect = float(wide / high) if wide > 0 and high > 0 else 1.0  # of a pixel, width to height
        if not 1 / ASPECT_MOST <= self.aspect <= ASPECT_MOST:
            raise AnnulusError(f"{path}: pixels {wide:.0f}:{high:.0f} wide, expected 1:1 or near it.")
        self.fps = float(self._capture.get(cv2.CAP_PROP_FPS))  # 0 or NaN where the file does not say
        announced = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.announced = int(announced) if 0 < announced < FRAME_NUMBER_MAX else 0  # 0: it does not say
        self.read, self.ended, self.missing = 0, False, 0
        self._span_ms = [math.nan, math.nan]  # when the first frame is shown, and the last that was read
        _check_mjpeg(path)

    def frame(self, number: int, decoded: bool = True) -> Image | None:
        """That picture, uint8: (H, W, 3), or (H, W) where it is grey; None if not `decoded`, and at the end."""
        while self.read <= number and not self.ended:
            if not self._capture.grab():
                self._end()
                return None
            now = float(self._capture.get(cv2.CAP_PROP_POS_MSEC))
            self._span_ms = [now if self.read == 0 else self._span_ms[0], now]
            self.read += 1
        if self.ended or not decoded:
            return None
        whole, image = self._capture.retrieve()
        if not whole or image is None or image.dtype != np.uint8:
            raise AnnulusError(f"{self._path}: frame {number} cannot be decoded to 8 bits a colour.")
        if image.ndim == 3 and (image == image[..., :1]).all():
            image = np.ascontiguousarray(image[..., 0])
        return _square(np.asarray(image), self.aspect)

    def _end(self) -> None:
        """No more frames. Too few only where they end too early too: of an uneven rate the number is a guess."""
        self.ended = True
        if 0 < self.fps < math.inf and self.read < self.announced:
            period = 1000.0 / self.fps
            if self.read == 0 or not self._span_ms[1] - self._span_ms[0] > (self.announced - 1.5) * period:
                self.missing = self.announced - self.read


def _square(image: Image, aspect: float) -> Image:
    """The same with pixels as wide as high: the shorter side is stretched, so that no row or column is lost."""
    if aspect == 1.0:
        return image
    height, width = image.shape[:2]
    size = (round(width * aspect), height) if aspect > 1 else (width, round(height / aspect))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC))


def _opened(path: Path, *parameters: int) -> cv2.VideoCapture:
    """With FFmpeg, whatever the file is called; OpenCV's own complaints are not printed."""
    before = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        return cv2.VideoCapture(str(path.resolve()), cv2.CAP_FFMPEG, list(parameters))
    finally:
        cv2.utils.logging.setLogLevel(before)


def _check_mjpeg(path: Path) -> None:
    """Raises AnnulusError where a video of JPEGs changes its size: the decoder would scale it in silence.

    In other forms the size is the file's, not the picture's.
    """
    packets = _opened(path, cv2.CAP_PROP_FORMAT, -1)  # undecoded
    sizes: dict[tuple[int, int], int] = {}
    for number in range(FRAME_NUMBER_MAX):
        read, packet = packets.read()
        if not read or bytes(packet.ravel()[:2]) != b"\xff\xd8":
            return
        size = size_of(packet.tobytes())
        if size is not None:
            sizes.setdefault(size, number)
        if len(sizes) > 1:
            (old, _), (new, at) = sizes.items()
            raise AnnulusError(
                f"{path}: frame {at} is {new[0]}x{new[1]}, those before {old[0]}x{old[1]}. "
                "Expected one size: cut the video there."
            )
