"""Where a map of the wall, or of what it grew by, stands out of its noise, and the floor that stands out there.

A bank of bells, 20 to 130 mm wide along and round, each weighs cells by their variance; what it finds is measured in
sigma of what the same bell finds all over the map, so that texture and misfits raise the bar by themselves. The best
is fitted with a floor that may be a bowl or a pan, taken out, and the rest is looked at again.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import robust_sigma

BELLS_MM = (5.0, 12.0, 25.0)  # sigma
PART_MIN = 0.35  # of a floor that must have been seen
SEEN_MIN = 0.5  # of a bell's weight that must lie on what was seen
BAR_SIGMA = 6.0  # a map of 100 m has 1e7 places and 9 bells: chance passes once in 10 such maps at 5.8
MOST = 400  # floors of one map
LENGTH_MM = (6.0, 400.0)  # least and greatest of a floor along the pipe; bounds its fit
ARC_MM = (6.0, 200.0)  # .. and round it
EXPONENT = (1.5, 8.0)  # 2: a bowl, large: a pan
SHAPE = 3.0  # .. the exponent that is expected, between the two ..
SHAPE_WIDE = 0.5  # .. and its standard deviation, in its logarithm
WILD = 3.0  # sigma from which on a cell weighs less
STEPS_MAX = 20
PART_OF = 0.4  # of a floor's depth: less beside or in it is what the floor's shape misses


@dataclass(frozen=True, slots=True)
class Floor:
    """height_mm exp(-|2 dz / length|^p - |2 dclock / arc|^p); sigma_mm of the height; stands: in sigma."""

    z_mm: float
    clock_deg: float
    length_mm: float
    arc_deg: float
    height_mm: float
    exponent: float
    sigma_mm: float
    stands: float

    def shape(self, z: FloatArray, clock: FloatArray) -> FloatArray:
        """(rows, columns), 1 at its deepest."""
        along = np.abs(2 * (z - self.z_mm) / self.length_mm) ** self.exponent
        off = (clock - self.clock_deg + 180.0) % 360.0 - 180.0
        return np.asarray(np.exp(-along[:, None] - np.abs(2 * off / self.arc_deg)[None] ** self.exponent))

    def holds(self, z_mm: float, clock_deg: float, more: float = 1.0) -> bool:
        """Whether a place lies on it, or so many times its size."""
        along, round_it = more * self.length_mm / 2, more * self.arc_deg / 2
        return abs(z_mm - self.z_mm) <= along and self.off_deg(clock_deg) <= round_it

    def off_deg(self, clock_deg: float) -> float:
        """How far round its middle is from there, whichever way is shorter."""
        return abs((clock_deg - self.clock_deg + 180.0) % 360.0 - 180.0)


class FloorSearch:
    """One map (Z, A) mm with the sigma of its cells, from which floors are taken."""

    def __init__(
        self,
        field: Float32Array,
        sigma: Float32Array,
        z_mm: FloatArray,
        column_mm: float,
        bells_mm: tuple[float, ...] = BELLS_MM,
    ) -> None:
        self.seen = np.isfinite(field) & np.isfinite(sigma)
        self.left = np.where(self.seen, field, 0.0).astype(np.float32)
        self.weight = np.where(self.seen, 1.0 / np.square(np.where(self.seen, sigma, 1.0)), 0.0).astype(np.float32)
        self.z_mm, self.step_mm, self.column_mm = z_mm, float(z_mm[1] - z_mm[0]), column_mm
        self.column_deg = 360.0 / field.shape[1]
        self.clock = self.column_deg * np.arange(field.shape[1])
        self.bells = [(max(a / self.step_mm, 0.7), max(b / column_mm, 0.7)) for a in bells_mm for b in bells_mm]
        self.wide = 4 * max(bells_mm)
        self.usual: list[float] = []
        # every place's furthest bell: how far it stands out, how high it is, which bell
        self.stands, self.height, self.which, self.least_mm = self._looked(slice(None))

    def _looked(self, rows: slice) -> tuple[Float32Array, Float32Array, NDArray[np.int8], Float32Array]:
        weight, seen = self.weight[rows], self.seen[rows].astype(np.float32)
        product = weight * self.left[rows]
        most = np.zeros_like(product), np.zeros_like(product), np.zeros(product.shape, np.int8)
        least = np.full_like(product, np.inf)
        measured = not self.usual
        before: float = 0.0
        narrow = math.sqrt(0.5)
        for k, (along, round_) in enumerate(self.bells):
            if along != before:
                down = _blur(product, along, 0), _blur(weight, along * narrow, 0), _blur(seen, along, 0)
                before = along
            top, square, share = (
                _blur(down[0], round_, 1),
                _blur(down[1], round_ * narrow, 1),
                _blur(down[2], round_, 1),
            )
            square /= np.float32(4 * np.pi * along * round_)  # blurs have sums of 1: the bell itself, and its square
            ok = (share > SEEN_MIN) & (square > 0)
            sigma = 1.0 / np.sqrt(np.where(ok, square, np.float32(1)))
            stands = np.where(ok, top * sigma, np.float32(0))
            if measured:
                there = stands[ok]
                self.usual.append(max(robust_sigma(there.astype(np.float64)), 1.0) if there.size else 1.0)
            sigma /= np.float32(2 * np.pi * along * round_)
            height = stands * sigma
            stands /= np.float32(self.usual[k])
            better = np.abs(stands) > np.abs(most[0])
            np.copyto(most[0], stands, where=better)
            np.copyto(most[1], height, where=better)
            most[2][better] = k
            if k == len(self.bells) // 2:
                least = np.where(ok, np.float32(BAR_SIGMA * self.usual[k]) * sigma, np.float32(np.inf))
        return *most, least

    def _again(self, floor: Floor) -> None:
        """Measure anew where a floor was taken out."""
        inner = np.flatnonzero(np.abs(self.z_mm - floor.z_mm) < floor.length_mm + self.wide)
        edge = int(self.wide / self.step_mm) + 1
        rows = slice(max(int(inner[0]) - edge, 0), int(inner[-1]) + 1 + edge)
        keep = slice(int(inner[0]) - rows.start, int(inner[-1]) + 1 - rows.start)
        anew = self._looked(rows)
        self.stands[inner], self.height[inner], self.which[inner] = (new[keep] for new in anew[:3])

    def floors(self, least_mm: float) -> list[Floor]:
        """All that stand out by BAR_SIGMA and are `least_mm` deep, the surest first."""
        found: list[Floor] = []
        barred = np.zeros(self.left.shape, bool)
        for _ in range(2 * MOST):
            size = np.where(barred | (np.abs(self.height) < least_mm / 2), np.float32(0), np.abs(self.stands))
            i, c = np.unravel_index(int(np.argmax(size)), size.shape)
            if size[i, c] < BAR_SIGMA or len(found) >= MOST:
                break
            one = self._fitted(int(i), int(c))
            near = [o for o in found if o.holds(self.z_mm[i], float(self.clock[c]), 1.6)]
            part = [o for o in near if abs(one.height_mm) < PART_OF * abs(o.height_mm)] if one is not None else near
            if one is None or part or abs(one.height_mm) < least_mm or self._seen(one) < PART_MIN:
                along, round_ = self.bells[int(self.which[i, c])]
                rows = np.flatnonzero(np.abs(np.arange(len(size)) - i) <= 1.5 * along)
                off = np.abs((self.clock - self.clock[c] + 180) % 360 - 180)
                barred[np.ix_(rows, np.flatnonzero(off <= 1.5 * round_ * self.column_deg))] = True
                continue
            found.append(one)
            self._take(one, -1)
            self._again(one)
        for k, one in enumerate(found):  # each once more, without its neighbours
            self._take(one, 1)
            again = self._refitted(one)
            if again is not None and again.holds(one.z_mm, one.clock_deg):
                found[k] = again
            self._take(found[k], -1)
        return found

    def _box(self, one: Floor, more: float) -> tuple[IntArray, IntArray]:
        half = more * one.length_mm / 2 + 3 * self.step_mm
        arc = min(more * one.arc_deg / 2 + 3 * self.column_deg, 180.0)
        rows = np.flatnonzero(np.abs(self.z_mm - one.z_mm) <= half)
        columns = np.flatnonzero(np.abs((self.clock - one.clock_deg + 180) % 360 - 180) <= arc)
        return rows, columns

    def _take(self, one: Floor, sign: int) -> None:
        rows, columns = self._box(one, 3.0)
        at = np.ix_(rows, columns)
        self.left[at] += (sign * one.height_mm * one.shape(self.z_mm[rows], self.clock[columns])).astype(np.float32)

    def _seen(self, one: Floor) -> float:
        """The share of a floor that was seen."""
        rows, columns = self._box(one, 1.5)
        shape = one.shape(self.z_mm[rows], self.clock[columns])
        return float((shape * self.seen[np.ix_(rows, columns)]).sum() / max(shape.sum(), 1e-9))

    def _fitted(self, i: int, c: int) -> Floor | None:
        along, round_ = self.bells[int(self.which[i, c])]
        length, arc = 2.6 * along * self.step_mm, 2.6 * round_ * self.column_deg
        height = 1.3 * float(self.height[i, c])  # a bell is wider than what it finds
        start = Floor(
            float(self.z_mm[i]), float(self.clock[c]), length, arc, height, SHAPE, np.nan, float(abs(self.stands[i, c]))
        )
        first = self._refitted(start)
        return first if first is None or not self._outgrew(start, first) else self._refitted(first)

    @staticmethod
    def _outgrew(start: Floor, fitted: Floor) -> bool:
        """Whether it needs a larger box, or was fitted in one that is too large."""
        return any(
            not 0.6 < one / other < 1.5
            for one, other in ((fitted.length_mm, start.length_mm), (fitted.arc_deg, start.arc_deg))
        )

    def _refitted(self, start: Floor) -> Floor | None:
        rows, columns = self._box(start, 2.2)
        at = np.ix_(rows, columns)
        seen = self.seen[at]
        if seen.sum() < 12:
            return None
        z, clock = self.z_mm[rows], self.clock[columns]
        value, root = self.left[at][seen].astype(np.float64), np.sqrt(self.weight[at][seen].astype(np.float64))
        degrees = self.column_deg / self.column_mm
        usual = float(np.median(self.usual))

        def floor(x: FloatArray) -> Floor:
            return replace(
                start,
                height_mm=float(x[0]),
                z_mm=float(x[1]),
                clock_deg=float(start.clock_deg + degrees * x[2]),
                length_mm=float(np.exp(x[3])),
                arc_deg=float(degrees * np.exp(x[4])),
                exponent=float(np.exp(x[5])),
            )

        def off(x: FloatArray) -> FloatArray:
            shape = floor(x).shape(z, clock)[seen]
            misfit = (x[0] * shape + x[6] - value) * root / usual
            return np.concatenate([misfit, [(x[5] - np.log(SHAPE)) / SHAPE_WIDE, x[6] / 0.03]])

        x = np.array(
            [
                start.height_mm,
                start.z_mm,
                0.0,
                np.log(start.length_mm),
                np.log(start.arc_deg / degrees),
                np.log(start.exponent),
                0.0,
            ]
        )
        reach = start.length_mm / 2 + 2 * self.step_mm, start.arc_deg / degrees / 2 + 2 * self.column_mm
        low = np.array(
            [-50.0, x[1] - reach[0], -reach[1], np.log(LENGTH_MM[0]), np.log(ARC_MM[0]), np.log(EXPONENT[0]), -1.0]
        )
        high = np.array(
            [50.0, x[1] + reach[0], reach[1], np.log(LENGTH_MM[1]), np.log(ARC_MM[1]), np.log(EXPONENT[1]), 1.0]
        )
        x = np.clip(x, low + 1e-6, high - 1e-6)
        scale = np.array([0.1, 4.0, 4.0, 0.2, 0.2, 0.3, 0.02])
        found, normal, cost = _least_squares(off, x, low, high, scale)
        spread = max(cost / max(len(value) - len(x), 1), 1.0)
        variance = float(np.linalg.inv(normal + 1e-9 * np.diag(1 / scale**2))[0, 0]) * spread
        fitted = floor(found)
        return replace(fitted, clock_deg=fitted.clock_deg % 360.0, sigma_mm=float(np.sqrt(max(variance, 0.0))))


def _least_squares(
    off: Callable[[FloatArray], FloatArray], x: FloatArray, low: FloatArray, high: FloatArray, scale: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Levenberg and Marquardt's steps within bounds, wild cells weighing less: x, its normal matrix, sum of squares.

    Written out: a box has thousands of cells and seven unknowns, and the general solver takes most of its time for an
    SVD of all of them.
    """

    def lost(rest: FloatArray) -> float:
        return float((2 * WILD**2 * (np.sqrt(1 + (rest / WILD) ** 2) - 1)).sum())

    rest, damping = off(x), 1e-3
    cost, normal = lost(rest), np.eye(len(x))
    for _ in range(STEPS_MAX):
        bent = np.stack([(off(x + step) - rest) / step[k] for k, step in enumerate(np.diag(1e-3 * scale))], axis=1)
        weight = 1 / np.sqrt(1 + (rest / WILD) ** 2)
        normal, pull = bent.T @ (weight[:, None] * bent), bent.T @ (weight * rest)
        for _ in range(8):
            held = normal + damping * np.diag(np.diag(normal) + 1e-6 / scale**2)
            there = np.clip(x - np.linalg.solve(held, pull), low, high)
            ahead = off(there)
            better = lost(ahead)
            if better < cost:
                break
            damping *= 6
        else:
            break
        gain, x, rest, cost, damping = cost - better, there, ahead, better, damping / 6
        if gain < 1e-3 + 1e-4 * cost:
            break
    return x, normal, cost


def _blur(field: Float32Array, sigma: float, axis: int) -> Float32Array:
    return np.asarray(
        ndimage.gaussian_filter1d(field, sigma, axis=axis, mode="wrap" if axis else "constant", truncate=3.0)
    )
