"""Where stretches of the second map lie on the first, and how turned: found from nothing, to a bin.

Every stretch of a metre is laid over all of the first at every roll at once (by FFT). What agrees by chance says how
much chance makes agree, and a place counts by how far it stands out of that. A chain of stretches then believes those
that go with each other: a cable's scale is a percent off, a slip is short, a head turns slowly or as its sensor says.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from annulus_pipe.archive.detail import Detail
from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.numeric.arrays import ComplexArray, Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import fft, ndimage
from annulus_pipe.numeric.robust import robust_sigma

BIN_MM = 8.0  # a third of what texture is alike over
STRETCH_MM = 1000.0  # length of a stretch: of less, chance agrees as well somewhere
EVERY_MM = 500.0  # from one stretch to the next: they overlap by half, so that a slip spoils two at most
CANDIDATES = 6  # of a stretch
CUT_SIGMA = 3.0  # of a cell: one defect must not outvote the texture
CHANCE = 16.0  # log-likelihood that the best of a million places by chance does not reach (5.7 sigma)
MOST = 80.0  # that one stretch may say
OVAL_MM = 0.1  # by which ovality may differ between years
OVAL_MOST = 40.0  # log-likelihood: what it may say against a place
# Between two stretches of one chain:
SCALE = 0.015  # of their distance: odometers differ by 1 %
SLACK_MM = 12.0  # .. and a place is known to a bin or so: what is off by less is no slip
SLIP_MM = 500.0  # what is off by more is no slip either, but another place
TURNED_DEG = 4.0  # what a head's roll sensor may be off by ..
TURNED_FREE_DEG = 40.0  # .. and a head may turn by, where no sensor said
SLIP_COST = 8.0  # log-likelihood, of a slip and of a leap of the roll ..
SLIP_USUAL_MM = 8.0  # .. and one more for each so many: a slip is the less likely the longer
LOOK_BACK = 30  # stretches
SEEDS = 60  # stretches that are looked for everywhere; of a longer scan the others near the line through them
NEAR_MM = 3000.0


@dataclass(frozen=True, slots=True)
class MatchedStretch:
    """Of the second, middle at z_mm of its own: it lies at first_mm on the first, turned by roll_deg over what the
    sensors say. gain: log-likelihood over chance."""

    z_mm: float
    first_mm: float
    roll_deg: float
    gain: float


@dataclass(frozen=True, slots=True)
class _Binned:
    cells: Float32Array  # in sigma, 0 where not seen, turned back by the sensor's roll
    oval: ComplexArray  # the same way turned back
    seen: FloatArray


def find(
    first: WallMap, second: WallMap, details: tuple[Detail, Detail], progress: Callable[[int, int], None]
) -> list[MatchedStretch]:
    """Stretches of the second that belong together on the first, in order; few or none where it is another pipe."""
    size = max(BIN_MM, first.step_mm, second.step_mm)
    with_sensor = details[0].roll_deg is not None and details[1].roll_deg is not None
    one, other = (_binned(wall, part, size, with_sensor) for wall, part in zip((first, second), details, strict=True))
    rows = min(max(round(STRETCH_MM / size), 8), len(other.cells), len(one.cells))
    starts = list(range(0, len(other.cells) - rows + 1, max(round(EVERY_MM / size), 1)))
    seeds = starts if len(starts) <= SEEDS else starts[:: -(-len(starts) // SEEDS)]
    candidates: dict[int, list[MatchedStretch]] = {}

    def look(which: Sequence[int], near: Callable[[float], tuple[float, float]] | None) -> list[MatchedStretch]:
        for start in which:
            if start not in candidates:
                progress(len(candidates), len(starts))
                candidates[start] = _candidates(first, second, one, other, start, rows, size, near)
        return _chain([candidates[start] for start in sorted(candidates)], with_sensor)

    chain = look(seeds, None)
    if len(seeds) < len(starts) and len(chain) > 2:
        z, at = np.array([[s.z_mm, s.first_mm] for s in chain]).T

        def near(place: float) -> tuple[float, float]:
            k = int(np.clip(np.searchsorted(z, place), 1, len(z) - 1))
            k -= int(place - z[k - 1] < z[k] - place)
            allowed = NEAR_MM + SCALE * abs(place - z[k])
            middle = at[k] + place - z[k]
            return middle - allowed, middle + allowed

        chain = look(starts, near)
    progress(len(starts), len(starts))
    return chain


def _binned(wall: WallMap, part: Detail, size: float, with_sensor: bool) -> _Binned:
    field, columns = part.plain, part.plain.shape[1]
    seen = np.isfinite(field)
    usual = robust_sigma(field[seen].astype(np.float64)) if seen.any() else 1.0
    value = np.where(seen, field, np.float32(0))
    oval = part.oval
    if with_sensor:
        roll = np.asarray(part.roll_deg)
        shift = np.rint(roll * columns / 360.0).astype(np.int64)
        take = (np.arange(columns)[None] - shift[:, None]) % columns
        value, seen = np.take_along_axis(value, take, axis=1), np.take_along_axis(seen, take, axis=1)
        oval = oval * np.exp(-2j * np.radians(roll))
    bins = np.floor(np.arange(len(field)) * wall.step_mm / size + 1e-9).astype(np.int64)
    begins = np.flatnonzero(np.diff(bins, prepend=-1))
    weight = np.add.reduceat(seen.astype(np.float32), begins, axis=0)
    total = np.add.reduceat(value, begins, axis=0)
    count = np.diff(np.append(begins, len(field)))
    cells = total / np.maximum(weight, 1) / max(usual, 1e-6) * np.sqrt(np.median(count))
    cells = np.clip(cells, -CUT_SIGMA, CUT_SIGMA).astype(np.float32)
    mean = np.add.reduceat(oval, begins) / count
    return _Binned(cells, np.asarray(mean, np.complex128), (weight > 0).mean(axis=1))


def _candidates(
    first: WallMap,
    second: WallMap,
    one: _Binned,
    other: _Binned,
    start: int,
    rows: int,
    size: float,
    near: Callable[[float], tuple[float, float]] | None,
) -> list[MatchedStretch]:
    middle = second.first_mm + (start + rows / 2) * size
    low, high = 0, len(one.cells)
    if near is not None:
        low, high = (int((place - first.first_mm) / size) for place in near(middle))
        low, high = max(low - rows, 0), min(high + rows, len(one.cells))
        if high - low < rows:
            return []
    cells, piece = one.cells[low:high], other.cells[start : start + rows]
    energy = float((piece * piece).sum())
    if energy == 0 or other.seen[start : start + rows].mean() < 0.2:
        return []
    columns = cells.shape[1]
    size_fft = fft.next_fast_len(len(cells) + rows, real=True)
    # sum over i, c of first[i + lag, c + turn] second[i, c]; lags from 1 - rows on
    product = fft.irfft2(
        fft.rfft2(cells, (size_fft, columns)) * np.conj(fft.rfft2(piece, (size_fft, columns))), (size_fft, columns)
    )
    overhang = rows // 2  # half a stretch may lie beyond the first's ends
    lags = np.arange(-overhang, len(cells) - rows + overhang + 1)
    product = product[lags % size_fft]
    sums = np.concatenate([[0.0], np.cumsum((cells * cells).sum(axis=1))])
    inside = np.clip(lags + rows, 0, len(cells)), np.clip(lags, 0, len(cells))
    there = sums[inside[0]] - sums[inside[1]]
    share = (inside[0] - inside[1]) / rows
    usual = max(float(np.median(there)), 1e-6)
    alike = product / np.sqrt(energy * np.maximum(there, 0.3 * usual))[:, None]
    chance = max(robust_sigma(alike.ravel()), 1e-6)
    evidence = np.minimum(0.5 * (alike / chance) * np.abs(alike / chance), MOST)
    evidence -= _against(one.oval[low:high], other.oval[start : start + rows], lags, columns) * share[:, None]
    out = []
    peak = (evidence == ndimage.maximum_filter(evidence, (5, 9), mode=("nearest", "wrap"))) & (evidence > 0)
    where = np.argwhere(peak)
    for lag, turn in where[np.argsort(-evidence[tuple(where.T)])][:CANDIDATES]:
        roll = (turn * 360.0 / columns + 180.0) % 360.0 - 180.0
        place = first.first_mm + (low + lags[lag] + rows / 2) * size
        out.append(MatchedStretch(middle, place, roll, float(evidence[lag, turn]) - CHANCE))
    return out


def _against(one: ComplexArray, other: ComplexArray, lags: IntArray, columns: int) -> FloatArray:
    """(lags, turns) what ovality has against each place; second's waves are the first's times exp(2i roll)."""
    rows = len(other)
    size = fft.next_fast_len(len(one) + rows)
    cross = fft.ifft(fft.fft(np.conj(one), size) * np.conj(fft.fft(np.conj(other), size)))[lags % size]
    sums = np.concatenate([[0.0], np.cumsum(np.abs(one) ** 2)])
    high, low = np.clip(lags + rows, 0, len(one)), np.clip(lags, 0, len(one))
    begin, end = np.clip(-lags, 0, rows), np.clip(len(one) - lags, 0, rows)
    own = np.concatenate([[0.0], np.cumsum(np.abs(other) ** 2)])
    squares = sums[high] - sums[low] + own[end] - own[begin]
    turn = np.exp(-2j * np.radians(np.arange(columns) * 360.0 / columns))
    off = squares[:, None] - 2 * (cross[:, None] * turn[None]).real
    return np.asarray(np.clip(off / np.maximum(high - low, 1)[:, None] / OVAL_MM**2, 0.0, OVAL_MOST))


def _chain(candidates: Sequence[Sequence[MatchedStretch]], with_sensor: bool) -> list[MatchedStretch]:
    """The chain of stretches that says most, at most one of each candidates' list."""
    every = [(k, one) for k, some in enumerate(candidates) for one in some]
    if not every:
        return []
    order = np.array([k for k, _ in every])
    z, place, roll, gain = np.array([[s.z_mm, s.first_mm, s.roll_deg, s.gain] for _, s in every]).T
    total, came = gain.copy(), np.full(len(every), -1)
    turned = TURNED_DEG if with_sensor else TURNED_FREE_DEG
    for i in range(len(every)):
        before = np.flatnonzero((order[:i] < order[i]) & (order[:i] >= order[i] - LOOK_BACK))
        if not len(before):
            continue
        gap = z[i] - z[before]
        off = np.abs(place[i] - place[before] - gap)
        turn = np.abs((roll[i] - roll[before] + 180) % 360 - 180)
        free = SCALE * gap + SLACK_MM
        cost = np.where(off > free, SLIP_COST + (off - free) / SLIP_USUAL_MM, 0.0) + np.where(
            turn > turned, SLIP_COST, 0.0
        )
        cost[(off > free + SLIP_MM) | (turn > 45.0)] = np.inf
        best = int(np.argmax(total[before] - cost))
        joined = total[before[best]] - cost[best]
        if joined > 0:
            total[i], came[i] = gain[i] + joined, before[best]
    at, chain = int(np.argmax(total)), []
    while at >= 0:
        chain.append(every[at][1])
        at = came[at]
    return chain[::-1]
