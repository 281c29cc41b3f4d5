"""Where the wall that a head saw looking back lies on the wall that one saw looking forward.

Two heads back to back on one carrier have one odometer: what they are apart and how turned to each other are two
numbers for all of the scan, found together, and near what the mounting says. Two scans, there and back, have two cables
and two rolls: their rows are laid together one by one, as those of two years are (`alignment`).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.archive.alignment import align
from annulus_pipe.archive.detail import COLUMNS, detail_of, smoothed
from annulus_pipe.archive.wall_map import WallMap
from annulus_pipe.numeric.arrays import BoolArray, ComplexArray, Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import fft, ndimage
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.opposite import Placed
from annulus_pipe.wall.survey import Survey

# Guarded by tests/unit/archive/test_there_and_back.py, both ways.
NEAR_MM = 20.0  # as far as the heads may stand from what the mounting says, along the pipe: it was measured with a rule
SIGMA_MOUNT_MM, SIGMA_MOUNT_DEG = 2.0, 1.0  # k = 1, of the mounting's values: cameras' pupils are not marked on them
FAR = 3.0  # .. times which the wall may contradict the mounting
ALIKE_LEAST = 0.6  # of 1: correlation of two views of one wall; of two walls a defect or two may agree by chance
ALONE = 0.85  # of the best: another place that agrees as well makes it no match
CALM = (1.5, 1.5)  # sigma of the smoothing, rows and columns: what lies between two rows is then no calmer than they
ALIKE_CELLS = 4 * math.pi * CALM[0] * CALM[1]  # .. after which so many say one thing
CUT_MM = 3.0  # that a cell may say: one deep floor does not outvote the rest
STANDS_OUT = 4.0  # sigma from which on a cell is something that a wall can be known by
CELLS_LEAST = 100  # of two degrees, that both saw and that stand out in one; fewer are no wall to go by
ROUNDS = 4  # of the refinement: it has then settled
EDGE_MM = 0.25  # of a radius from a row to the next: a steeper place says nothing of where it lies, see `_refine`
MISFIT = 3.0  # by which places err more than the differences say: beside edges every view errs its own way
STEP_LEAST = 0.1  # rows and columns, k = 1: better than a tenth of a cell nothing is placed


@dataclass(frozen=True, slots=True)
class Mount:
    """Two heads on one carrier: the backward one stands so far behind the forward one, and so turned, clockwise looking
    forward; NaN where nobody measured how."""

    apart_mm: float
    turned_deg: float = math.nan


def placed(
    fore: Survey,
    aft: Survey,
    mount: Mount | None,
    names: tuple[str, str],
    progress: Callable[[str, int, int], None] = lambda what, done, total: None,
) -> Placed:
    """The backward view's rows on the forward one's wall.

    Parameters
    ----------
    fore, aft : each as its head saw it; with a mount, z of both counts on one odometer, the backward one's negated.
    mount : of two heads on one carrier; None of two scans. names : of both, for messages.

    Raises
    ------
    AnnulusError, one line, where nothing of the wall says where it lies and the mounting does not either, where it is
    another pipe, or where both look the same way.
    """
    first, second = _map_of(fore, names[0]), _map_of(aft, names[1])
    if mount is not None:
        return _mounted(first, second, mount, aft)
    found = align(first, second, progress)
    if not found.reversed:
        raise AnnulusError(
            f"{names[1]}: looks the same way as {names[0]}, with the same shadows. Expected a scan from the other end."
        )
    return Placed(found.z_mm, found.roll_deg, found.sigma_z_mm, found.sigma_roll_deg, found.slips)


def _map_of(survey: Survey, name: str) -> WallMap:
    wall = survey.wall
    nominal = survey.nominal_diameter_mm / 2
    rolled = np.full(len(wall.z_mm), np.nan if survey.roll_range_deg is None else 0.0)
    return WallMap(
        name,
        (wall.radius_mm - np.float32(nominal)).astype(np.float32),
        float(wall.z_mm[0]),
        wall.z_step_mm,
        nominal,
        rolled,
        float(wall.clock_deg[0]),
    )


def _mounted(first: WallMap, second: WallMap, mount: Mount, aft: Survey) -> Placed:
    turned = second.turned_about()
    match = _Match(first, turned, -mount.apart_mm)
    rows = len(aft.wall.z_mm)

    def everywhere(moved: float, roll: float, sigma: tuple[float, float], matched: bool) -> Placed:
        one = np.ones(rows)
        return Placed(moved - aft.wall.z_mm, roll * one, sigma[0] * one, sigma[1] * one, matched=matched)

    if match.why:
        if math.isfinite(mount.turned_deg) and match.featureless:
            return everywhere(-mount.apart_mm, mount.turned_deg, (SIGMA_MOUNT_MM, SIGMA_MOUNT_DEG), False)
        hope = (
            "Give how the heads are turned to each other beside how far they are apart."
            if match.featureless
            else "Expected a forward and a backward view of one pipe, their distance measured to 20 mm."
        )
        raise AnnulusError(f"{second.name}: {match.why} {first.name}. {hope}")
    aside = abs((match.roll_deg - mount.turned_deg + 180.0) % 360.0 - 180.0)
    if aside > FAR * math.hypot(match.sigma[1], SIGMA_MOUNT_DEG):  # never of NaN
        raise AnnulusError(
            f"{second.name}: its wall lies turned by {match.roll_deg:.1f} degrees on that of {first.name}, and the "
            f"mounting says {mount.turned_deg:.1f}. One of the two is wrong."
        )
    return everywhere(match.moved_mm, match.roll_deg, match.sigma, True)


class _Match:
    """One distance and one turn for all rows: by correlation over every turn and all distances near the mounting's,
    then by least squares. `why` says why there is none, `featureless` whether there was nothing to go by."""

    def __init__(self, first: WallMap, second: WallMap, expected_mm: float) -> None:
        self.why, self.featureless = "", False
        columns = min(COLUMNS, first.deviation_mm.shape[1], second.deviation_mm.shape[1])
        self._step, self._column = first.step_mm, 360.0 / columns
        one = detail_of(first, columns).plain
        other = detail_of(second, columns).plain
        if abs(first.step_mm - second.step_mm) > 1e-6:
            other = _stretched(other, second.step_mm, first.step_mm)
        self._one, self._other = (
            np.where(np.isfinite(field), np.clip(smoothed(field, CALM), -CUT_MM, CUT_MM), np.float32(np.nan))
            for field in (one, other)
        )
        self._sigma = max(
            robust_sigma(field[np.isfinite(field)].astype(np.float64)) for field in (self._one, self._other)
        )
        self._base = second.first_mm - first.first_mm
        lag = (self._base + expected_mm) / self._step
        reach = round(NEAR_MM / self._step)
        lags = np.asarray(np.arange(round(lag) - reach, round(lag) + reach + 1), np.int64)
        alike, standing = self._alike(lags)
        at = np.unravel_index(int(np.argmax(alike)), alike.shape)
        best = float(alike[at])
        if standing[at] < CELLS_LEAST:
            self.featureless = bool(standing.max() < CELLS_LEAST)
            self.why = (
                "nothing stands out of its wall that would say how it lies on that of"
                if self.featureless
                else "its wall is not that of"
            )
            return
        if best < ALIKE_LEAST or at[0] in (0, len(lags) - 1):
            self.why = "its wall is not found on that of"
            return
        rows, turns = np.ogrid[: alike.shape[0], : alike.shape[1]]
        away = np.hypot(
            (rows - at[0]) * self._step, np.abs((turns - at[1] + columns // 2) % columns - columns // 2) * self._column
        )
        if float(alike[away > NEAR_MM].max(initial=0.0)) > ALONE * best:
            self.why = "its wall fits in more than one way on that of"
            return
        moved = float(lags[at[0]]) * self._step - self._base
        if abs(moved - expected_mm) > FAR * SIGMA_MOUNT_MM + self._step:
            self.why = f"lies {-moved:.0f} mm away by its wall, not {-expected_mm:.0f} mm, from"
            return
        self._refine(lag, float(at[1]))
        self.moved_mm = self._lag * self._step - self._base
        self.roll_deg = (self._turn * self._column) % 360.0

    def _alike(self, lags: IntArray) -> tuple[FloatArray, FloatArray]:
        """(lags, turns) correlation of both over what both saw there, and how many cells of it stand out in either."""
        sigma = self._sigma
        rows = fft.next_fast_len(len(self._one) + len(self._other), real=True)
        shape = (rows, self._one.shape[1])

        def spectrum(field: NDArray[Any]) -> ComplexArray:
            return np.asarray(fft.rfft2(field.astype(np.float64), shape))

        def crossed(a: NDArray[Any], b: NDArray[Any]) -> FloatArray:
            product = fft.irfft2(spectrum(a) * np.conj(spectrum(b)), shape)
            return np.asarray(product[lags % rows])

        seen = np.isfinite(self._one), np.isfinite(self._other)
        with np.errstate(invalid="ignore"):
            out = [np.abs(field) > STANDS_OUT * sigma for field in (self._one, self._other)]
        value = np.nan_to_num(self._one), np.nan_to_num(self._other)
        energy = crossed(value[0] ** 2, seen[1]), crossed(seen[0], value[1] ** 2)
        alike = crossed(*value) / np.sqrt(np.maximum(energy[0] * energy[1], 1e-6))
        return alike, np.minimum(crossed(out[0], seen[1]), crossed(seen[0], out[1]))

    def _refine(self, lag: float, turn: float) -> None:
        """Least squares of the differences, from the mounting's values on, which weigh as they are known.

        Of a rim one view sees the upper edge and the other what is below it, each where the other has its shadow: as
        far as that is long the two may be moved and still fit. So steep places have no say here, and where there are
        no others (texture, domes, ovality) the distance is the mounting's.
        """
        expected = lag
        prior = np.array([(self._step / SIGMA_MOUNT_MM) ** 2, 0.0])
        for _ in range(ROUNDS):
            other, (along, aside) = self._moved(lag, turn)
            left = self._one - other
            flat = ~(_steep(self._one) | _steep(other))
            with np.errstate(invalid="ignore"):  # noise has slopes, too, and says nothing
                flat &= np.abs(self._one) + np.abs(other) > 2 * STANDS_OUT * self._sigma
            known = flat & np.isfinite(left) & np.isfinite(along) & np.isfinite(aside)
            slopes = np.stack([along[known], aside[known]], axis=1).astype(np.float64)
            away = left[known].astype(np.float64)
            sigma = max(robust_sigma(away), 1e-4)
            weight = 1.0 / np.maximum(np.abs(away) / (2.0 * sigma), 1.0)  # Huber's
            one = float(np.mean(weight * away**2)) * ALIKE_CELLS * MISFIT**2
            normal = slopes.T @ (weight[:, None] * slopes) / one + np.diag(prior + 1e-6)
            pull = slopes.T @ (weight * away) / one + prior * (lag - expected)
            step = np.linalg.solve(normal, pull)
            lag, turn = lag - float(np.clip(step[0], -1, 1)), turn - float(np.clip(step[1], -1, 1))
        spread = np.linalg.inv(normal)
        self._lag, self._turn = lag, turn
        rows, columns = np.sqrt(np.diag(spread))
        self.sigma = (self._step * max(float(rows), STEP_LEAST), self._column * max(float(columns), STEP_LEAST))

    def _moved(self, lag: float, turn: float) -> tuple[Float32Array, tuple[Float32Array, Float32Array]]:
        """The second on the first's cells, and its slopes, mm a row and a column; NaN where it did not see."""
        rows = np.arange(len(self._one)) - lag
        low = np.floor(rows).astype(np.int64)
        along = (rows - low)[:, None].astype(np.float32)
        inside = (low >= 0) & (low < len(self._other) - 1)
        low = np.where(inside, low, 0)
        columns = np.arange(self._one.shape[1]) - turn
        left = np.floor(columns).astype(np.int64)
        aside = (columns - left)[None].astype(np.float32)
        count = self._one.shape[1]
        four = [[self._other[low + i][:, (left + j) % count] for j in (0, 1)] for i in (0, 1)]
        before, behind = ((1 - aside) * one[0] + aside * one[1] for one in four)
        value = (1 - along) * before + along * behind
        value[~inside] = np.nan
        around = (1 - along) * (four[0][1] - four[0][0]) + along * (four[1][1] - four[1][0])
        return value, (behind - before, around)


def _steep(field: Float32Array) -> BoolArray:
    """(Z, A) cells beside which the radius changes as at an edge."""
    with np.errstate(invalid="ignore"):
        step = np.abs(np.diff(field, axis=0, append=np.nan)) > EDGE_MM
    return np.asarray(ndimage.binary_dilation(step, np.ones((5, 3), bool)))


def _stretched(field: Float32Array, step_mm: float, to_mm: float) -> Float32Array:
    """Its rows `to_mm` apart; between an unseen cell and another nothing is seen."""
    at = np.arange(0.0, (len(field) - 1) * step_mm + 1e-6, to_mm) / step_mm
    low = np.minimum(at.astype(np.int64), len(field) - 2)
    part = (at - low)[:, None].astype(np.float32)
    return np.asarray((1 - part) * field[low] + part * field[low + 1], np.float32)
