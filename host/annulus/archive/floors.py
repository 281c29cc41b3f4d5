"""Where a map of the wall, or of what it grew by, stands out of its noise, and the floor that stands out there.

A bank of bells, 20 to 130 mm wide along and round, each weighs cells by their variance; what it finds is measured in
sigma of what the same bell finds all over the map, so that texture and misfits raise the bar by themselves. The best
is fitted with a floor that may be a bowl or a pan, taken out, and the rest is looked at again.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import least_squares

from annulus.numeric.arrays import Float32Array, FloatArray
from annulus.numeric.robust import robust_sigma

BELLS_MM = (5.0, 12.0, 25.0)  # sigma
SEEN_MIN = 0.5  # of a bell's weight that must lie on what was seen
BAR_SIGMA = 6.0  # a map of 100 m has 1e7 places and 9 bells: chance passes once in 10 such maps at 5.8
MOST = 400  # floors of one map
LENGTH_MM, ARC_MM = (6.0, 400.0), (6.0, 200.0)
EXPONENT = (1.5, 8.0)  # 2: a bowl, large: a pan
SHAPE, SHAPE_WIDE = 3.0, 0.5  # .. what is expected, in its logarithm
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
        off = abs((clock_deg - self.clock_deg + 180.0) % 360.0 - 180.0)
        return abs(z_mm - self.z_mm) <= more * self.length_mm / 2 and off <= more * self.arc_deg / 2


class Search:
    """One map (Z, A) mm with the sigma of its cells, from which floors are taken."""

    def __init__(self, field: Float32Array, sigma: Float32Array, z_mm: FloatArray, column_mm: float) -> None:
        self.seen = np.isfinite(field) & np.isfinite(sigma)
        self.left = np.where(self.seen, field, 0.0).astype(np.float32)
        self.weight = np.where(self.seen, 1.0 / np.square(np.where(self.seen, sigma, 1.0)), 0.0).astype(np.float32)
        self.z_mm, self.step_mm, self.column_mm = z_mm, float(z_mm[1] - z_mm[0]), column_mm
        self.column_deg = 360.0 / field.shape[1]
        self.clock = self.column_deg * np.arange(field.shape[1])
        self.bells = [(max(a / self.step_mm, 0.7), max(b / column_mm, 0.7)) for a in BELLS_MM for b in BELLS_MM]
        self.usual = np.ones(len(self.bells))
        self.least_mm: Float32Array = np.full(field.shape, np.inf, np.float32)
        self._measure()

    def _measure(self) -> None:
        self.stands = np.zeros_like(self.left)
        self.which = np.zeros(self.left.shape, np.int8)
        for k in range(len(self.bells)):
            stands, sigma = self._bell(k, slice(None))
            there = stands[stands != 0]
            self.usual[k] = max(robust_sigma(there.astype(np.float64)), 1.0) if there.size else 1.0
            stands /= self.usual[k]
            better = np.abs(stands) > np.abs(self.stands)
            self.stands[better], self.which[better] = stands[better], k
            if k == len(self.bells) // 2:
                self.least_mm = BAR_SIGMA * sigma * self.usual[k]

    def _bell(self, k: int, rows: slice) -> tuple[Float32Array, Float32Array]:
        """How far each place stands out, and sigma of a floor like the bell there, mm (infinite where too little was
        seen)."""
        along, round_ = self.bells[k]

        def blur(part: Float32Array, by: float) -> Float32Array:
            out = gaussian_filter1d(part, along * by, axis=0, mode="constant", truncate=3.5)
            return np.asarray(gaussian_filter1d(out, round_ * by, axis=1, mode="wrap", truncate=3.5))

        weight = self.weight[rows]
        top = blur(weight * self.left[rows], 1.0)
        narrow = np.sqrt(0.5)
        per = 4 * np.pi * along * round_  # the blurs have sums of 1: of the bell itself, and of its square
        square = blur(weight, narrow) / per
        share = blur(self.seen[rows].astype(np.float32), 1.0)
        ok = (share > SEEN_MIN) & (square > 0)
        stands = np.where(ok, top / np.sqrt(np.where(ok, square, 1.0)), 0.0)
        sigma = np.where(ok, 1.0 / np.sqrt(np.where(ok, square, 1.0)) / (2 * np.pi * along * round_), np.inf)
        return stands.astype(np.float32), sigma.astype(np.float32)

    def _again(self, floor: Floor) -> None:
        """Measure anew where a floor was taken out."""
        reach = floor.length_mm + 8 * max(BELLS_MM)
        inner = np.flatnonzero(np.abs(self.z_mm - floor.z_mm) < reach)
        edge = int(4 * max(BELLS_MM) / self.step_mm) + 1
        rows = slice(max(int(inner[0]) - edge, 0), int(inner[-1]) + 1 + edge)
        keep = slice(int(inner[0]) - rows.start, int(inner[-1]) + 1 - rows.start)
        part, kind = np.zeros_like(self.left[inner]), np.zeros(self.left[inner].shape, np.int8)
        for k in range(len(self.bells)):
            stands = self._bell(k, rows)[0][keep] / self.usual[k]
            better = np.abs(stands) > np.abs(part)
            part[better], kind[better] = stands[better], k
        self.stands[inner], self.which[inner] = part, kind

    def floors(self, least_mm: float) -> list[Floor]:
        """All that stand out by BAR_SIGMA and are `least_mm` deep, the surest first."""
        found: list[Floor] = []
        barred = np.zeros(self.left.shape, bool)
        for _ in range(2 * MOST):
            size = np.where(barred, 0.0, np.abs(self.stands))
            i, c = np.unravel_index(int(np.argmax(size)), size.shape)
            if size[i, c] < BAR_SIGMA or len(found) >= MOST:
                break
            one = self._fitted(int(i), int(c))
            near = [o for o in found if o.holds(self.z_mm[i], float(self.clock[c]), 1.6)]
            part = [o for o in near if abs(one.height_mm) < PART_OF * abs(o.height_mm)] if one is not None else near
            if one is None or part or abs(one.height_mm) < least_mm or self._seen(one) < SEEN_MIN:
                rows = np.abs(self.z_mm - self.z_mm[i]) < 1.5 * max(BELLS_MM[0], self.step_mm)
                off = np.abs((self.clock - self.clock[c] + 180) % 360 - 180)
                barred |= rows[:, None] & (off < 4 * self.column_deg)[None]
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

    def _box(self, one: Floor, more: float) -> tuple[FloatArray, FloatArray]:
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
        rows = slice(max(i - 1, 0), i + 2)
        columns = np.arange(c - 1, c + 2) % len(self.clock)
        weight = self.weight[rows][:, columns]
        height = float((weight * self.left[rows][:, columns]).sum() / max(float(weight.sum()), 1e-9))
        if height * self.stands[i, c] <= 0:
            height = float(np.sign(self.stands[i, c])) * 0.05
        start = Floor(
            float(self.z_mm[i]), float(self.clock[c]), length, arc, height, SHAPE, np.nan, float(abs(self.stands[i, c]))
        )
        first = self._refitted(start)
        return first if first is None else self._refitted(first)

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
                start, height_mm=float(x[0]), z_mm=float(x[1]), clock_deg=float(start.clock_deg + degrees * x[2]),
                length_mm=float(np.exp(x[3])), arc_deg=float(degrees * np.exp(x[4])), exponent=float(np.exp(x[5])),
            )  # fmt: skip

        def off(x: FloatArray) -> FloatArray:
            shape = floor(x).shape(z, clock)[seen]
            misfit = (x[0] * shape + x[6] - value) * root / usual
            return np.concatenate([misfit, [(x[5] - np.log(SHAPE)) / SHAPE_WIDE, x[6] / 0.03]])

        x = np.array(
            [start.height_mm, start.z_mm, 0.0, np.log(start.length_mm), np.log(start.arc_deg / degrees),
             np.log(start.exponent), 0.0]
        )  # fmt: skip
        reach = start.length_mm / 2 + 2 * self.step_mm, start.arc_deg / degrees / 2 + 2 * self.column_mm
        low = np.array(
            [-50.0, x[1] - reach[0], -reach[1], np.log(LENGTH_MM[0]), np.log(ARC_MM[0]), np.log(EXPONENT[0]), -1.0]
        )
        high = np.array(
            [50.0, x[1] + reach[0], reach[1], np.log(LENGTH_MM[1]), np.log(ARC_MM[1]), np.log(EXPONENT[1]), 1.0]
        )
        x = np.clip(x, low + 1e-6, high - 1e-6)
        scale = np.array([0.1, 4.0, 4.0, 0.2, 0.2, 0.3, 0.02])
        done = least_squares(off, x, bounds=(low, high), x_scale=scale, loss="soft_l1", f_scale=3.0, max_nfev=40)
        normal = done.jac.T @ done.jac + 1e-9 * np.eye(len(x)) / scale**2
        spread = max(2 * float(done.cost) / max(len(value) - len(x), 1), 1.0)
        variance = float(np.linalg.inv(normal)[0, 0]) * spread
        fitted = floor(done.x)
        return replace(fitted, clock_deg=fitted.clock_deg % 360.0, sigma_mm=float(np.sqrt(max(variance, 0.0))))
