"""What drift explains how far rings lie off the wall that they share, and how well.

Gaussian, but for numbers that nobody knows beforehand and that are summed over: how far edges are drawn whatever the
optics do, how translucent the wall is, how much its colours differ. Beside the drift stands what a calibration leaves
of each ring: its covariance where it states one, and a slide and a lens that are bent a little otherwise than it says.
"""

import math
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.drift import SMALL, Drift, drifted, seen_with
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import special
from annulus_pipe.wall.offsets import TERMS, Offsets, RingObservations

# How far light goes on inside the wall, mm, and how likely each is beforehand: polyethylene 0.15 to 0.4 mm, pigmented
# walls none. The mean of the colours scatters about each by a part, and every colour about that mean.
TRANSLUCENT = ((0.0, 0.5), (0.1, 0.15), (0.2, 0.2), (0.4, 0.15))
WALL_ALIKE = 0.8  # of the variance of a wall that was measured, what its colours have in common
SHIFT_MEAN = 0.5  # of what light in the wall moves edges by: how well the mean of the colours is known beforehand
SHIFT_LEAST_MM = 0.005  # .. and each colour beside it, at least
GREY = 0.05  # of the mean, how far a colour of a grey wall departs from it ..
YELLOW = 0.3  # .. and of a yellow one: as likely one as the other
# How far a ring's edges may be drawn evenly, and by two waves, each as likely beforehand: what colours and widths do to
# them is even, a lens and a mosaic draw them by waves.
EDGES_PX = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32)
EDGES_TWOFOLD_PX = (0.01, 0.03, 0.1)
# Of the outermost ring's angle, and of the focal length there: by how much slide and lens are bent otherwise than the
# calibration has it, growing as a square. Standard deviations; a calibration in a pipe reaches 1e-4.
SLIDE_BOW = 2e-4
LENS_BOW = 2e-4
LAWS = 2  # rounds of the linearised answer: the second one's change is below a hundredth of sigma at 0.3 %
NONE = np.zeros(7)


@dataclass(frozen=True, slots=True, eq=False)
class DriftPrior:
    """What is known beforehand: means and standard deviations (4,) of focal, slide, tube (mm), anamorphic; wall_mm (3,)
    how well the wall is known that the calibration says light goes on in, None where it says nothing."""

    mean: FloatArray
    sigma: FloatArray
    wall_mm: tuple[float, float, float] | None = None

    @property
    def walls(self) -> tuple[tuple[float, float, float], ...]:
        """How far light may go on, mm, what part of that colours depart by, and how likely each is."""
        if self.wall_mm is not None:
            return ((0.0, YELLOW, 1.0),)
        return tuple((mm, colour, chance / 2.0) for mm, chance in TRANSLUCENT for colour in (GREY, YELLOW))


@dataclass(frozen=True, slots=True, eq=False)
class Effects:
    """What a drift does to the rings' offsets: even (K, 7) and of two waves (K, 2, 7), mm; px_mm (K,) of a pixel."""

    seen: RingObservations
    weight: FloatArray
    calibration: Calibration
    even: FloatArray
    twofold: FloatArray
    px_mm: FloatArray
    calibrated: FloatArray  # (K, K) mm^2: covariance of even offsets that the calibration leaves

    @classmethod
    def of(cls, seen: RingObservations, weight: FloatArray, calibration: Calibration) -> "Effects":
        rings, values = len(calibration.rings), SMALL.values
        bare = cls(seen, weight, calibration, NONE, NONE, NONE, NONE)
        parts = [
            bare.moved(Drift.of(np.where(np.arange(len(values)) == i, step, 0.0))) / step
            for i, step in enumerate(values)
        ]
        terms = np.stack(parts, axis=-1)  # (K, TERMS, 7)
        camera = calibration.camera
        away = np.hypot(*(camera.project(seen.points) - [camera.cx, camera.cy]).T)
        far = np.array([np.mean(away[seen.ring == k]) if (seen.ring == k).any() else np.nan for k in range(rings)])
        px_mm = np.abs(terms[:, 0, 0]) / np.nan_to_num(far, nan=1.0)
        left = _left_by(calibration, terms[:, 0], np.nan_to_num(far))
        return replace(bare, even=terms[:, 0], twofold=terms[:, 3:5], px_mm=px_mm, calibrated=left)

    @property
    def share(self) -> FloatArray:
        """(K,) of the observations, of each ring."""
        count = np.bincount(self.seen.ring, minlength=len(self.calibration.rings))
        return np.asarray(count / count.sum())

    @property
    def usual_even(self) -> FloatArray:
        """(7,) mm, of the radius that all rings together say."""
        return np.asarray(self.share @ self.even)

    def moved(self, drift: Drift) -> FloatArray:
        """(K, TERMS) mm: how the rings' offsets change where the drift is taken out."""
        seen = self.seen
        there = seen_with(seen.points, seen.ring, self.calibration, drifted(self.calibration, drift))
        before, after = (np.hypot(*seen.in_pipe(points)[:, :2].T) for points in (seen.points, there))
        change, own = after - before, seen.round_head
        out = np.zeros((len(self.calibration.rings), TERMS))
        for k in range(len(out)):
            mine = (seen.ring == k) & np.isfinite(change)
            if np.count_nonzero(mine) <= TERMS:  # too few for waves; of none there is no share either
                out[k, 0] = np.mean(change[mine]) if mine.any() else 0.0
            else:
                root = np.sqrt(self.weight[mine])
                out[k] = np.linalg.lstsq(own[mine] * root[:, None], change[mine] * root, rcond=None)[0]
        return out


def _left_by(calibration: Calibration, even: FloatArray, away_px: FloatArray) -> FloatArray:
    """(K, K) mm^2 of even offsets: what the calibration states of its rings' angles and places along the axis, and what
    a bend of slide and lens does that it does not have. even (K, 7); away_px (K,) from the image's middle."""
    angles = np.array([ring.half_angle for ring in calibration.rings])
    bent = [
        SLIDE_BOW * even[:, 1] * (np.tan(angles) / np.tan(angles).max()) ** 2,
        LENS_BOW * even[:, 0] * (away_px / max(away_px.max(), 1e-9)) ** 2,
    ]
    out = np.asarray(sum(np.outer(one, one) for one in bent))
    if calibration.covariance is not None:
        rows = 6 * np.arange(len(angles))
        stated = np.array(calibration.covariance)
        by = np.stack([even[:, 1] * 2.0 / np.sin(2.0 * angles), -even[:, 2]])  # mm a radian, mm a mm
        for i, first in enumerate((0, 5)):
            for j, second in enumerate((0, 5)):
                out += np.outer(by[i], by[j]) * stated[np.ix_(rows + first, rows + second)]
    return out


@dataclass(frozen=True, slots=True, eq=False)
class DriftEstimate:
    mean: FloatArray
    covariance: FloatArray
    left_mm: FloatArray  # (K,) of the even offsets
    edges_px: float
    opaque: float  # probability


def answer_at(offsets: Offsets, effects: Effects, before: DriftPrior, z_mm: float) -> DriftEstimate:
    """The drift at a place."""
    terms = [k * TERMS + i for k in range(len(offsets.mm)) for i in (0, 3, 4)]
    noise = offsets.covariance[np.ix_(terms, terms)] + np.kron(effects.calibrated, np.diag([1.0, 0.0, 0.0]))
    # In a bend a ring's circle is wider and drawn out, by the square of how far the wall winds: each ring by its own.
    noise += (offsets.bent_mm**2 / effects.calibration.pipe_radius_mm) ** 2 * np.eye(len(terms))
    design = np.concatenate([effects.even[:, None], effects.twofold], axis=1).reshape(len(terms), -1)
    even, twofold = (np.kron(effects.px_mm**2, which) for which in ([1.0, 0.0, 0.0], [0.0, 1.0, 1.0]))
    observed = -offsets.at(z_mm)[:, (0, 3, 4)].ravel()
    at, many = NONE, [(tau, px) for tau in before.walls for px in product(EDGES_PX, EDGES_TWOFOLD_PX)]
    for _ in range(LAWS):
        # beyond what is linear: the change that this drift really makes, and the rest along the tangent
        law = effects.moved(Drift.of(at))[:, (0, 3, 4)].ravel()
        value = observed - law + design @ at
        log, means, covariances = [], [], []
        for (shift, colour, chance), px in many:
            mean, spread = drift_before(before, shift, colour)
            total = noise + np.diag(px[0] ** 2 * even + px[1] ** 2 * twofold) + design @ spread @ design.T
            gain = np.linalg.solve(total, design @ spread).T
            left = value - design @ mean
            log.append(math.log(chance) - 0.5 * (np.linalg.slogdet(total)[1] + left @ np.linalg.solve(total, left)))
            means.append(mean + gain @ left)
            covariances.append(spread - gain @ design @ spread)
        weight = np.exp(np.array(log) - special.logsumexp(log))
        at = weight @ np.array(means)
    apart = np.array(means) - at
    covariance = np.einsum("n,nij->ij", weight, np.array(covariances)) + (apart.T * weight) @ apart
    opaque = float(sum(p for p, ((shift, *_), _) in zip(weight, many, strict=True) if shift == 0.0))
    left = offsets.at(z_mm)[:, 0] + effects.moved(Drift.of(at))[:, 0]
    return DriftEstimate(at, covariance, left, float(weight @ np.array([px for _, (px, _) in many])), opaque)


def drift_before(before: DriftPrior, shift_mm: float, colour: float = YELLOW) -> tuple[FloatArray, FloatArray]:
    """Mean (7,) and covariance (7, 7) of a drift, where light goes on in the wall by about so much, and each colour by
    a part more or less."""
    mean = np.concatenate([before.mean, np.full(3, shift_mm)])
    spread = np.zeros((7, 7))
    spread[:4, :4] = np.diag(before.sigma**2)
    own = (colour * shift_mm) ** 2 + SHIFT_LEAST_MM**2
    spread[4:, 4:] = (SHIFT_MEAN * shift_mm) ** 2 + own * np.eye(3)
    if before.wall_mm is not None:  # what is off in one colour is so in all, mostly: the calibration of its day
        sigma = np.array(before.wall_mm)
        spread[4:, 4:] += WALL_ALIKE * np.outer(sigma, sigma) + (1.0 - WALL_ALIKE) * np.diag(sigma**2)
    return mean, spread
