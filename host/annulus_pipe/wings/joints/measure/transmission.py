"""Light through dogbones (Alzuhiri 2022, §9.8, §9.9.5): line scans aligned, thickness taken out, what is left compared.

By Beer-Lambert (Eq. 9.2) the logarithm of what arrives falls by alpha times the thickness. A dogbone's own plain wall
says its level; where its thickness along the line is known (CT), alpha follows from the levels of all dogbones, and the
thickness's share is taken out all along. What remains is absorbance of the joint over plain wall, base e. Beside it the
source's two measures, a smoothed gradient and a moving deviation, each with what plain wall alone shows of it.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError

SHIFT_MM = 5.0  # by which lines may lie apart
FINE = 0.2  # of a sample: the shifts that are tried
ROUNDS = 6
SMOOTH_MM = 0.75  # half of the source's laser spot
EDGE = 0.2  # of the dip: where the joint ends
BESIDE_MM = 2.0  # kept off the joint for plain wall
STANDS_OUT = 5.0  # sigma of plain wall's absorbance: less is no joint
PLAIN_MIN = 20  # samples
WINDOW_MM = 2.0  # of the moving deviation
KERNEL = 3  # samples on either side: [1 1 1 -1 -1 -1]
LEVELS_MIN = 4  # dogbones for alpha
TOLD = 2.0  # sigma of alpha
ANGLE_AGREES_DEG = 0.5  # a strength's dogbone is that of a line


@dataclass(frozen=True, slots=True)
class Transmission:
    """n dogbones, Z places. shift, shift_sigma (n,) mm: each line's own, their mean 0; joint (2,) mm: where the dip
    begins and ends in aligned lines. absorbance (n, Z): over plain wall, aligned, NaN where a line does not reach.
    gradient (n, Z): of the logarithm, 1/mm; deviation (n, Z): within WINDOW_MM. depth, depth_sigma (n,): mean
    absorbance over the joint. level (n,): ln(mV) of plain wall. alpha, alpha_sigma: 1/mm, NaN where not told.
    plain_gradient, plain_deviation: what a quarter in a hundred of plain wall's own exceed."""

    z_mm: FloatArray
    shift_mm: FloatArray
    shift_sigma_mm: FloatArray
    joint_mm: tuple[float, float]
    absorbance: FloatArray
    gradient: FloatArray
    deviation: FloatArray
    depth: FloatArray
    depth_sigma: FloatArray
    level: FloatArray
    alpha: float
    alpha_sigma: float
    plain_gradient: float
    plain_deviation: float

    @property
    def thickness_out(self) -> bool:
        """Whether thickness along the lines is taken out: alpha stands out of its sigma."""
        return bool(self.alpha > TOLD * self.alpha_sigma)

    @property
    def inside(self) -> BoolArray:
        """(Z,) places of the joint."""
        return np.asarray((self.z_mm >= self.joint_mm[0]) & (self.z_mm <= self.joint_mm[1]))

    def figures(self) -> dict[str, Any]:
        """What transmission.json says of it beside the curves; each dogbone's greatest within the joint."""
        return {
            "shift_mm": self.shift_mm,
            "shift_sigma_mm": self.shift_sigma_mm,
            "joint_mm": list(self.joint_mm),
            "depth": self.depth,
            "depth_sigma": self.depth_sigma,
            "gradient_per_mm": np.abs(self.gradient[:, self.inside]).max(axis=1),
            "plain_gradient_per_mm": self.plain_gradient,
            "deviation": self.deviation[:, self.inside].max(axis=1),
            "plain_deviation": self.plain_deviation,
            "alpha_per_mm": self.alpha,
            "alpha_sigma_per_mm": self.alpha_sigma,
            "thickness_taken_out": self.thickness_out,
        }

    def curves(self) -> dict[str, FloatArray]:
        return {
            "z_mm": self.z_mm,
            "absorbance": self.absorbance,
            "gradient": self.gradient,
            "deviation": self.deviation,
        }


def transmission(z_mm: FloatArray, mv: FloatArray, thickness_mm: FloatArray | None = None) -> Transmission:
    """z_mm (Z,) in even steps; mv (n, Z) positive. thickness_mm : (n, Z) along the aligned lines, where it is known.
    AnnulusError where the lines show no joint in common."""
    step = float(z_mm[1] - z_mm[0])
    if not np.allclose(np.diff(z_mm), step, rtol=0, atol=0.01 * abs(step)) or step <= 0:
        raise AnnulusError("z_mm goes in uneven steps, expected even ones")
    if not (mv > 0).all():
        raise AnnulusError("light of 0 mV or less, expected more: is the detector's dark level taken out twice?")
    level = np.log(np.median(mv, axis=1))
    y = np.log(mv) - level[:, None]
    shift, sigma = _aligned(z_mm, y)
    lines = np.stack(
        [np.interp(z_mm + s, z_mm, one, left=np.nan, right=np.nan) for s, one in zip(shift, y, strict=True)]
    )
    joint = _joint(z_mm, lines)
    plain = (z_mm < joint[0] - BESIDE_MM) | (z_mm > joint[1] + BESIDE_MM)
    if plain.sum() < PLAIN_MIN:
        raise AnnulusError(f"{plain.sum()} places of plain wall beside the joint, expected {PLAIN_MIN} or more")
    own = np.nanmean(np.where(plain, lines, np.nan), axis=1)
    alpha = alpha_sigma = np.nan
    absorbance = own[:, None] - lines
    if thickness_mm is not None:
        alpha, alpha_sigma = _alpha(level + own, np.nanmean(np.where(plain, thickness_mm, np.nan), axis=1))
        if alpha > TOLD * alpha_sigma:
            more = thickness_mm - np.nanmean(np.where(plain, thickness_mm, np.nan), axis=1)[:, None]
            absorbance = absorbance - alpha * np.nan_to_num(more)
    inside = (z_mm >= joint[0]) & (z_mm <= joint[1])
    width = int(inside.sum())
    depth = np.nanmean(absorbance[:, inside], axis=1)
    means = ndimage.uniform_filter1d(np.nan_to_num(absorbance), width, axis=1)
    depth_sigma = np.array([robust_sigma(one[plain] - np.median(one[plain])) for one in means])
    kernel = np.concatenate([np.full(KERNEL, 1.0), np.full(KERNEL, -1.0)]) / (KERNEL * KERNEL * step)
    filled = np.where(np.isfinite(lines), lines, own[:, None])
    gradient = np.stack([np.convolve(one, kernel, "same") for one in filled])
    window = max(round(WINDOW_MM / step), 2)
    mean = ndimage.uniform_filter1d(filled, window, axis=1)
    deviation = np.sqrt(np.maximum(ndimage.uniform_filter1d(filled**2, window, axis=1) - mean**2, 0.0))
    inner = plain & (z_mm > z_mm[0] + WINDOW_MM) & (z_mm < z_mm[-1] - WINDOW_MM)
    return Transmission(
        z_mm,
        shift,
        sigma,
        joint,
        absorbance,
        gradient,
        deviation,
        depth,
        depth_sigma,
        level + own,
        alpha,
        alpha_sigma,
        float(np.quantile(np.abs(gradient[:, inner]), 0.9975)),
        float(np.quantile(deviation[:, inner], 0.9975)),
    )


def thickness_along(
    z_ct: FloatArray,
    phi_deg: FloatArray,
    wall: FloatArray,
    fusion: FloatArray,
    angles_deg: FloatArray,
    z_mm: FloatArray,
    joint_mm: tuple[float, float],
) -> FloatArray:
    """(n, Z) mm of wall along lines at (n,) angles whose joint is there, by the CT's (Z, P) wall and (P,) fusion
    plane; NaN beyond the CT."""
    out = []
    for angle in angles_deg:
        column = int(np.argmin(np.abs((phi_deg - angle + 180) % 360 - 180)))
        at, of = z_mm - sum(joint_mm) / 2, z_ct - fusion[column]
        out.append(np.interp(at, of, wall[:, column], left=np.nan, right=np.nan))
    return np.stack(out)


def _aligned(z: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) shifts that lay the lines on their median, their mean 0, and their sigma."""
    step = float(z[1] - z[0])
    smooth = ndimage.gaussian_filter1d(y, SMOOTH_MM / step, axis=1)
    tried = np.arange(-SHIFT_MM, SHIFT_MM + step, FINE * step)
    shift, noise = np.zeros(len(y)), robust_sigma(np.diff(y, axis=1)) / np.sqrt(2)
    inner = (z > z[0] + SHIFT_MM) & (z < z[-1] - SHIFT_MM)
    if inner.sum() < PLAIN_MIN:
        raise AnnulusError(f"lines of {z[-1] - z[0]:g} mm, expected {2 * SHIFT_MM + PLAIN_MIN * step:g} or more")
    for _ in range(ROUNDS):
        moved = np.stack([np.interp(z + s, z, one) for s, one in zip(shift, smooth, strict=True)])
        model = np.median(moved, axis=0)[inner]
        model = model - model.mean()
        for i, one in enumerate(smooth):
            costs = []
            for s in tried:
                line = np.interp(z[inner] + s, z, one)
                line = line - line.mean()
                gain = max(float(line @ model) / max(float(model @ model), 1e-12), 0.0)
                costs.append(float(((line - gain * model) ** 2).sum()))
            shift[i] = tried[int(np.argmin(costs))]
        shift -= shift.mean()
    slope = np.gradient(model, step)
    correlated = 2 * np.sqrt(np.pi) * SMOOTH_MM / step  # samples that share their noise
    sigma = noise * np.sqrt(1.0 / max(float(slope @ slope), 1e-12)) if len(y) > 1 else 0.0
    return shift, np.full(len(y), np.hypot(sigma, FINE * step / np.sqrt(12)) * max(1.0, np.sqrt(correlated) / 2))


def _joint(z: FloatArray, lines: FloatArray) -> tuple[float, float]:
    """Where the dip of the aligned lines' median begins and ends."""
    whole = np.isfinite(lines).all(axis=0)
    mean = np.median(np.nan_to_num(lines), axis=0)
    smooth = ndimage.gaussian_filter1d(np.where(whole, mean, np.median(mean[whole])), SMOOTH_MM / float(z[1] - z[0]))
    base = float(np.median(smooth))
    scatter = robust_sigma(smooth - base)
    lowest = int(np.argmin(np.where(whole, smooth, np.inf)))
    dip = base - smooth[lowest]
    if not dip > STANDS_OUT * scatter:
        raise AnnulusError(
            f"the lines' median dips by {dip:.3f} at most, {dip / scatter:.1f} sigma of plain wall: no joint"
        )
    deep = smooth < base - EDGE * dip
    first = lowest - int(np.argmin(deep[: lowest + 1][::-1])) + 1 if not deep[: lowest + 1].all() else 0
    last = lowest + int(np.argmin(deep[lowest:])) - 1 if not deep[lowest:].all() else len(z) - 1
    return float(z[first]), float(z[last])


def _alpha(level: FloatArray, thickness: FloatArray) -> tuple[float, float]:
    """Alpha and its sigma by the plain wall of all dogbones; NaN where fewer than LEVELS_MIN have a thickness."""
    known = np.isfinite(thickness)
    if known.sum() < LEVELS_MIN or np.ptp(thickness[known]) <= 0:
        return np.nan, np.nan
    x, y = thickness[known] - thickness[known].mean(), level[known] - level[known].mean()
    slope = float(x @ y) / float(x @ x)
    rest = float(((y - slope * x) ** 2).sum()) / (known.sum() - 2)
    return -slope, float(np.sqrt(rest / float(x @ x)))


def paired(at_deg: FloatArray, angles_deg: FloatArray) -> IntArray | None:
    """(n,) which of the strengths at (m,) angles is each dogbone's; None where one has none."""
    same = np.abs((at_deg[None, :] - angles_deg[:, None] + 180) % 360 - 180) < ANGLE_AGREES_DEG
    return np.asarray(np.argmax(same, axis=1)) if same.any(axis=1).all() else None


def against_strengths(depth: FloatArray, energy: FloatArray) -> tuple[float, float, float]:
    """Pearson's r over (n,) dogbones evenly round a pipe, and how many of the ways to turn and mirror the strengths do
    as well, and the least that could come out: neighbours are alike, so nothing finer is told."""
    if len(depth) < 3 or not np.ptp(depth) > 0 or not np.ptp(energy) > 0:
        raise AnnulusError(f"{len(depth)} dogbones or ones all alike, expected three or more that differ")
    r = float(np.corrcoef(depth, energy)[0, 1])
    ways = [np.roll(one, k) for one in (energy, energy[::-1]) for k in range(len(energy))]
    as_good = np.mean([abs(np.corrcoef(depth, way)[0, 1]) >= abs(r) - 1e-9 for way in ways])
    return r, float(as_good), 1.0 / len(ways)
