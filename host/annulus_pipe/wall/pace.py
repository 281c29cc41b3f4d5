"""How far the head went from one LED frame to the next, as marks on the wall say, beside what the odometer says.

Each frame is unrolled onto the wall, as it lies if the head stood where the odometer has it. Two frames overlap; where
the odometer counts too much by a part e over a distance D, all that the second one shows lies e D farther on than in
the first. So the shift along the pipe under which both look most alike, over D, is the odometer's error. A wall without
marks looks alike under every shift, and says nothing.

Assumed: the focal length and the pipe's radius are right to better than the error that is reported.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.robust import SIGMA_OF_MAD
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.texture import HeadPath, LedFrame, pixels_round, row_medians

# Set on the drawn pipes of the blind bench, even seeds, by physics; guarded by test_pace.py as a whole.
ROW = 0.004  # of the radius: a strip's rows, finer than what a pixel shows of a near wall
NEAREST = 0.7  # of the radius ahead of the camera: where the strip begins ..
FARTHEST = 2.0  # .. and ends: farther a pixel is too long
COLUMNS = 360  # of the strip, round the clock
SECTORS = 12  # .. each with its shift: a head's lean moves marks one way on one side, the other way on the other
REACH = 0.07  # of the radius: shifts that are tried, 0.16 of the usual distance between two LED frames
SHARP = (1.5, 0.7)  # rows, columns: what is finer is noise
SMOOTH = (10.0, 4.0)  # .. and what is coarser is light
CUT = 4.0  # standard deviations: of a bell that averages
DARK = 4.0  # grey levels: beneath is no light
FAR_LEAST = 0.15  # of the radius: frames nearer to one another tell no distance
ALIKE = 0.35  # correlation: less is chance
SECTORS_LEAST = 8  # of a pair of frames, that agree on a shift: two thirds of the round
PAIRS_LEAST = 4  # of a scan: fewer have no scatter to be judged by
PIXELS_LEAST = 500  # of a sector's overlap
PAIRS_MOST = 60  # the first ones; bounds what a long scan costs
SCATTER_LEAST = 0.004  # part of the distance: fewer pairs than tell a scatter may agree by chance
OFF_LEAST = 0.02  # part of the distance: off by more, the odometer is contradicted, if that is ..
SURE = 4.0  # .. so many standard deviations

ODOMETER = "odometer"  # kind of a finding

_light_at = door("light_at", "u1[h,w,3] image", "f8[n,2] pixels", "f4[n]! light", "b1[n]! inside")
_bell_averaged = door(
    "bell_averaged",
    "f4[r,a] field",
    "f4[k] half",
    "f4[m] beside",
    "f4[b]! line",
    "f4[r,a]! middle_field",
    "f4[r,a]! out",
)
_size_median = door("size_median", "f4[n] field", "f4[n]! line", returns="f8")
_strip_sums = door(
    "strip_sums", "f4[r,a]! one", "f4[q,a]! other", "f4[r,a]! seen_one", "f4[q,a]! seen_other", "f8[d,6,a]! sums"
)


class Pace:
    """Watches the LED frames on their way to the wall's picture."""

    def __init__(
        self, wall: Wall, centreline: Centreline, calibration: Calibration, profiles: Sequence[Profile]
    ) -> None:
        self._wall, self._centreline, self._calibration = wall, centreline, calibration
        self._path = HeadPath(profiles)
        self._radius_mm = wall.mean_radius_mm
        self._wide_mm = np.nan_to_num(wall.filled_mm().astype(np.float64), nan=self._radius_mm)
        self._before: dict[int, tuple[int, Float32Array, float]] = {}  # by camera: first row, strip, station
        self._errors: list[float] = []

    def watched(self, frames: Iterable[LedFrame]) -> Iterator[LedFrame]:
        """The same frames; each is compared with the one before it."""
        for frame in frames:
            if len(self._errors) < PAIRS_MOST:
                self._look(frame)
            yield frame

    def error(self) -> tuple[float, float] | None:
        """The part of a distance by which the odometer counts too much, and its standard deviation; None where the
        wall's marks do not tell."""
        if len(self._errors) < PAIRS_LEAST:
            return None
        errors = np.array(self._errors)
        middle = float(np.median(errors))
        scatter = SIGMA_OF_MAD * float(np.median(np.abs(errors - middle)))
        return middle, max(scatter, SCATTER_LEAST) * float(np.sqrt(np.pi / 2 / len(errors)))

    def findings(self) -> tuple[Finding, ...]:
        measured = self.error()
        if measured is None or abs(measured[0]) < max(OFF_LEAST, SURE * measured[1]):
            return ()
        off, sigma = measured
        which = "more" if off > 0 else "less"
        return (
            Finding(
                ODOMETER,
                f"marks on the wall contradict the odometer: it counts {100 * abs(off):.1f} % {which} than the head "
                f"went (k = 2: {200 * sigma:.1f} %, from {len(self._errors)} pairs of LED frames). Places and lengths "
                "along the pipe are off by as much",
            ),
        )

    def _look(self, frame: LedFrame) -> None:
        before = self._before.get(frame.camera)
        if before is not None and abs(frame.z_mm - before[2]) < FAR_LEAST * self._radius_mm:
            return
        strip = self._strip(frame)
        if strip is None:
            self._before.pop(frame.camera, None)
            return
        self._before[frame.camera] = (*strip, frame.z_mm)
        if before is not None:
            shift = _shift(before[0], before[1], *strip)
            if shift is not None:
                self._errors.append(shift * ROW * self._radius_mm / (frame.z_mm - before[2]))

    def _strip(self, frame: LedFrame) -> tuple[int, Float32Array] | None:
        """Number of the first row, from the scan's beginning, and (rows, COLUMNS) what is marked; NaN: not seen."""
        pose, step = self._path.at(frame.z_mm), ROW * self._radius_mm
        if pose is None:
            return None
        first = int(np.ceil((frame.z_mm + NEAREST * self._radius_mm) / step))
        z = step * np.arange(first, int((frame.z_mm + FARTHEST * self._radius_mm) / step), dtype=np.float64)
        wall = self._wall
        row = np.clip(np.searchsorted(wall.z_mm, z), 0, len(wall.z_mm) - 1)
        clock = (np.arange(COLUMNS) + 0.5) * 360.0 / COLUMNS
        radius = self._wide_mm[row][:, (clock / 360.0 * len(wall.clock_deg)).astype(np.intp)]
        pixels = pixels_round(z, radius, clock, self._centreline, self._calibration, pose, frame)
        light, inside = np.empty(len(pixels), np.float32), np.empty(len(pixels), np.bool_)
        _light_at(np.ascontiguousarray(frame.image_bgr), pixels, light, inside)
        seen = inside.reshape(radius.shape) & ((z >= wall.z_mm[0]) & (z <= wall.z_mm[-1]))[:, None]
        return (first, _marks(np.log(np.maximum(light, DARK)).reshape(seen.shape), seen)) if seen.any() else None


def _marks(light: Float32Array, seen: BoolArray) -> Float32Array:
    """What is darker or brighter than about it, the lamp's fall-off along the pipe taken out; NaN where not seen."""
    field = np.where(seen, light, np.float32(0.0))
    part = None if seen.all() else seen.astype(np.float32)  # of the bells: of all of them, where all was seen

    def even(size: tuple[float, float]) -> Float32Array:
        total = _averaged(field, size)
        return total if part is None else np.asarray(total / np.maximum(_averaged(part, size), np.float32(0.3)))

    marks = np.where(seen, even(SHARP) - even(SMOOTH), np.float32(np.nan))
    marks -= row_medians(marks)[:, None]
    most = 4.0 * SIGMA_OF_MAD * _size_median(marks.ravel(), np.empty(marks.size, np.float32))
    return np.clip(marks, -most, most)


def _averaged(field: Float32Array, size: tuple[float, float]) -> Float32Array:
    """By a normal bell of so many rows and columns, cut off at four of them, the field reflected at its ends."""
    bells = []
    for sigma in size:
        bell = np.exp(-0.5 * (np.arange(int(CUT * sigma + 0.5) + 1) / sigma) ** 2)
        bells.append((bell / (2.0 * bell.sum() - 1.0)).astype(np.float32))
    out = np.empty_like(field)
    line = np.empty(field.shape[1] + 2 * len(bells[1]), np.float32)
    _bell_averaged(field, *bells, line, np.empty_like(field), out)
    return out


def _shift(first_a: int, a: Float32Array, first_b: int, b: Float32Array) -> float | None:
    """Rows by which b shows the same farther on than a, the mean round the clock; None where they are not alike."""
    reach = int(REACH / ROW)
    start = max(first_a, first_b) + reach
    rows = min(first_a + len(a), first_b + len(b)) - reach - start
    if rows <= reach:
        return None
    part = a[start - first_a :][:rows].copy()
    other = b[start - first_b - reach :][: rows + 2 * reach].copy()
    alike = _correlations(part, other, 2 * reach + 1)
    shifts, turns = [], []
    for sector, best in enumerate(alike.argmax(axis=0)):
        if alike[best, sector] < ALIKE or not 0 < best < 2 * reach:
            continue
        low, top, high = alike[best - 1 : best + 2, sector]
        shifts.append(best - reach + 0.5 * (low - high) / (low - 2 * top + high))
        turns.append((sector + 0.5) * 2 * np.pi / SECTORS)
    if len(shifts) < SECTORS_LEAST:
        return None
    return _even_part(np.array(shifts), np.array(turns))


def _correlations(a: Float32Array, b: Float32Array, shifts: int) -> FloatArray:
    """(shifts, SECTORS) of a strip with one that is longer by as many rows, sector by sector; -1 where too little of
    one was seen. Changes both."""
    sums = np.empty((shifts, 6, COLUMNS))
    _strip_sums(a, b, np.empty_like(a), np.empty_like(b), sums)
    n, x, y, xx, yy, xy = np.moveaxis(sums.reshape(shifts, 6, SECTORS, -1).sum(axis=3), 1, 0)
    each = np.maximum(n, 1.0)
    across = xy - x * y / each
    size = (xx - x**2 / each) * (yy - y**2 / each)
    return np.where(n < PIXELS_LEAST, -1.0, across / np.sqrt(np.maximum(size, 1e-12)))


def _even_part(shifts: FloatArray, turns: FloatArray) -> float:
    """Of shifts round the clock: a lean's cosine taken out, wild ones weighed down."""
    design = np.stack([np.ones(len(turns)), np.cos(turns), np.sin(turns)], axis=1)
    weight = np.ones(len(turns))
    answer: FloatArray = np.zeros(3)
    for _ in range(8):
        answer = np.asarray(np.linalg.lstsq(design * weight[:, None], shifts * weight, rcond=None)[0])
        weight = 1.0 / np.sqrt(1.0 + (shifts - design @ answer) ** 2)  # a row is what a good one scatters by
    return float(answer[0])
