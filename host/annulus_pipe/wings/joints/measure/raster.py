"""A probe's raster laid on the CT's maps: a near-field microwave scan of the outside of a joint, ch. 9 of the source.

What a near-field probe reads is its distance from the wall first, and what the wall is made of second. Both are known
from the CT but for their gains, so the raster's place is where the CT's maps, blurred by the aperture, explain it:

    raster(a, z) = line of plain wall(a) + blur[(g + k lift(a)) bead + d (density - 1)](phi = sense a + shift, z)

The line is that of plain wall along z at each angle (the source's mean over all z has the joint in it), taken out of
both sides alike; lift(a) is its height at the joint, by which a probe further off sees a bead less. Shift, place along
the pipe and both widths of the blur are found together, g, k and d of each channel by least squares within. All senses
are tried, and one is named only where the next best is a hundred times less likely.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.late import interpolate, optimize
from annulus_pipe.vocabulary import AnnulusError

ODDS = math.log(100.0)  # of likelihood, between what is decided and what is not
BLUR_MM = 3.0  # standard deviation that the search begins with: an aperture of about 7 mm
BLUR_RANGE_MM = (0.5, 8.0)
OBLONG = 2.0  # an aperture at most, either way: as an open waveguide is
BEAD_SEEN = 0.04  # of the highest bead: where it is lower there is plain wall
CLEAR = 2.0  # standard deviations of the blur, beside a bead: so far off is its trace gone
ROWS_MIN = 4  # of plain wall on either side of the joint
ANGLES_MIN = 24
SURROGATES = 199
P_MOST = 0.01  # accepted: so seldom do rasters of the same waviness fit as well
EXPLAINED = 0.6  # accepted: of what varies with the angle at the joint, the part that the CT explains
AWAY_DEG = 25.0  # from the best angle, is another
Z_STEP_MM = 1.0  # of the coarse search along the pipe
SENSE_NAMES = {1: "same", -1: "mirrored", 0: "undecided"}


@dataclass(frozen=True, slots=True, eq=False)
class Raster:
    """angle (n,) rad, even over one turn; z (Z,) mm, rising; values (channels, Z, n) mV, finite."""

    angle: FloatArray
    z_mm: FloatArray
    values: FloatArray

    def __post_init__(self) -> None:
        n, expected = len(self.angle), (len(self.z_mm), len(self.angle))
        if self.values.ndim != 3 or self.values.shape[1:] != expected:
            raise AnnulusError(f"a raster of {self.values.shape}, expected (channels, {expected[0]}, {expected[1]})")
        if n < ANGLES_MIN:
            raise AnnulusError(f"{n} angles, expected {ANGLES_MIN} or more")
        even = self.angle[0] + np.arange(n) * (2 * math.pi / n)
        if np.max(np.abs(self.angle - even)) > 0.1 * 2 * math.pi / n:
            span = math.degrees(self.angle[-1] - self.angle[0])
            raise AnnulusError(f"{n} angles over {span:.1f} degrees, expected even steps over one whole turn, rising")
        if len(self.z_mm) < 2 * ROWS_MIN or not (np.diff(self.z_mm) > 0).all():
            raise AnnulusError(f"{len(self.z_mm)} places along z, expected {2 * ROWS_MIN} or more, rising")
        if not np.isfinite(self.values).all():
            raise AnnulusError("a raster with holes in it, expected a number at every angle and z")


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """What of a joint a probe outside sees. phi even from 0 over one turn, z rising; maps (Z, P) without NaN."""

    z_mm: FloatArray
    bead_mm: FloatArray  # outside, over the plain wall
    density: FloatArray  # relative to plain wall
    radius_mm: float
    joint_mm: float  # z of the fusion plane, mean over the angle


@dataclass(frozen=True, slots=True, eq=False)
class PlacedRaster:
    """Where a raster lies: phi = sense angle + shift; z = joint + along (z of raster - raster_joint_mm).

    sense, along : 1, -1, or 0 where geometry does not decide (shift and maps are then those of the best). accepted :
    that this raster is of this joint; `why` says what speaks against it. Maps are (channels, Z, P) on the CT's grid,
    NaN where the raster does not reach: `joint_mv` over plain wall, `material_mv` with the share of the measured shape
    taken out. gains : (channels, 3) of bead, mV/mm; of density, mV per unit; of bead and lift-off, per mm.
    """

    accepted: bool
    why: str
    shift: float  # rad, 0 to 2 pi
    shift_sigma: float
    sense: int
    along: int
    best_sense: int
    best_along: int
    raster_joint_mm: float
    raster_joint_sigma_mm: float
    blur_mm: tuple[float, float]  # standard deviation round the pipe and along it
    others: tuple[tuple[int, int, float], ...]  # (sense, along, shift) nearly as likely
    odds: float  # log of the likelihood of the best angle over that of the next one apart
    explained: float  # of what varies with the angle at the joint
    p: float
    gains: FloatArray
    joint_mv: FloatArray
    material_mv: FloatArray

    def figures(self, channels: Sequence[str]) -> dict[str, Any]:
        """All but the maps, by name, angles in degrees."""
        return {
            "accepted": self.accepted,
            "why_not": self.why,
            "shift_deg": float(np.degrees(self.shift)),
            "shift_sigma_deg": float(np.degrees(self.shift_sigma)),
            "sense": SENSE_NAMES[self.sense],
            "sense_along": SENSE_NAMES[self.along],
            "best_sense": SENSE_NAMES[self.best_sense],
            "best_sense_along": SENSE_NAMES[self.best_along],
            "as_likely": [
                {"sense": SENSE_NAMES[sense], "sense_along": SENSE_NAMES[along], "shift_deg": float(np.degrees(shift))}
                for sense, along, shift in self.others
            ],
            "joint_at_raster_z_mm": self.raster_joint_mm,
            "joint_at_raster_z_sigma_mm": self.raster_joint_sigma_mm,
            "blur_sigma_mm": {"round": self.blur_mm[0], "along": self.blur_mm[1]},
            "explained": self.explained,
            "p": self.p,
            "log_odds_of_angle": self.odds,
            "gains": {
                name: dict(zip(("bead_mv_per_mm", "density_mv", "bead_and_lift_per_mm"), gains.tolist(), strict=True))
                for name, gains in zip(channels, self.gains, strict=True)
            },
        }

    def maps(self, channels: Sequence[str]) -> dict[str, FloatArray]:
        """(Z, P) by name: `joint_` and `material_` of each channel."""
        return {
            f"{part}_{name}": one
            for part, both in (("joint", self.joint_mv), ("material", self.material_mv))
            for name, one in zip(channels, both, strict=True)
        }


@dataclass(frozen=True, slots=True)
class _RasterPlace:
    shift: float  # of the raster's first angle
    z: float  # of the raster, where the joint lies
    round_mm: float
    along_mm: float


class _RasterFit:
    """A raster, turned to one sense of angle and of z, against the CT's maps."""

    def __init__(self, raster: Raster, surface: Surface, sense: int, along: int) -> None:
        self.n = len(raster.angle)
        turned = -np.arange(self.n) % self.n if sense < 0 else np.arange(self.n)
        self.values = raster.values[:, :, turned]
        self.z, self.along, self.radius = raster.z_mm, along, surface.radius_mm
        self.height = surface.z_mm - surface.joint_mm
        maps = np.stack([surface.bead_mm, surface.density - 1])
        orders = min(self.n, maps.shape[2]) // 2
        self.waves = np.fft.rfft(maps, axis=2)[:, :, :orders] * (self.n / maps.shape[2])
        high = surface.bead_mm.max(axis=1)
        bead = self.height[high > BEAD_SEEN * high.max()]
        self.feet = float(bead.min()), float(bead.max())

    def rows(self, z: float, blur: float) -> tuple[BoolArray, BoolArray] | None:
        """(Z,) which rows the CT sees, and which of these are plain wall; None where a side has none."""
        height = self.along * (self.z - z)
        seen = (height >= self.height[0]) & (height <= self.height[-1])
        below, above = height < self.feet[0] - CLEAR * blur, height > self.feet[1] + CLEAR * blur
        if min((below & seen).sum(), (above & seen).sum()) < ROWS_MIN:
            return None
        return seen, below | above

    def at(self, place: _RasterPlace, rows: tuple[BoolArray, BoolArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(2, R, n) blurred bead and density less plain wall, (c, R, n) the raster so, (c, n) plain wall's lift."""
        seen, straight = rows[0], rows[1][rows[0]]
        t = (self.along * (self.z - place.z))[seen]
        weight = np.exp(-0.5 * ((t[:, None] - self.height[None]) / place.along_mm) ** 2)
        weight /= np.maximum(weight.sum(axis=1, keepdims=True), 1e-30)
        line = np.stack([np.ones(len(t)), t], axis=1)
        fit = np.linalg.pinv(line[straight])
        level = np.eye(len(t))
        level[:, straight] -= line @ fit
        order = np.arange(self.waves.shape[2])
        blur = np.exp(-0.5 * (order * place.round_mm / self.radius) ** 2 + 1j * order * place.shift)
        waves = (level @ weight) @ self.waves * blur
        values = level @ self.values[:, seen]
        lift = (fit @ self.values[:, seen][:, straight])[:, 0]
        return np.fft.irfft(waves, self.n, axis=2), values, lift - lift.mean(axis=1, keepdims=True)

    def left(self, place: _RasterPlace, rows: tuple[BoolArray, BoolArray]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(c, R, n) what the CT does not explain, (c, 3) gains, (c, R, n) the raster."""
        maps, values, lift = self.at(place, rows)
        gains = np.empty((len(values), 3))
        residual = np.empty_like(values)
        for c, (data, over) in enumerate(zip(values, lift, strict=True)):
            columns = np.stack([maps[0], maps[1], maps[0] * over]).reshape(3, -1)
            gains[c] = np.linalg.lstsq(columns @ columns.T, columns @ data.ravel(), rcond=1e-12)[0]
            residual[c] = data - (gains[c] @ columns).reshape(data.shape)
        return residual, gains, values

    def cost(self, place: _RasterPlace, rows: tuple[BoolArray, BoolArray]) -> float:
        """Log of the mean square left, a channel."""
        return float(np.mean(np.log(np.mean(self.left(place, rows)[0] ** 2, axis=(1, 2)) + 1e-12)))


def _all_round(maps: FloatArray, values: FloatArray, lift: FloatArray) -> FloatArray:
    """(.., n) of (2, R, n), (.., R, n), (n,): mean square left of one channel when the maps turn by each whole step."""
    n = maps.shape[2]
    pick = (0, 1, 0)  # the map of each column
    factor = (np.ones(n), np.ones(n), lift)
    waves = np.fft.rfft(maps)
    normal = np.empty((n, 3, 3))
    right = np.empty((*values.shape[:-2], n, 3))
    for j in range(3):
        data = np.fft.rfft(values * factor[j])
        right[..., j] = np.fft.irfft((data.conj() * waves[pick[j]]).sum(axis=-2), n)
        for k in range(3):
            pair = np.fft.rfft((maps[pick[j]] * maps[pick[k]]).sum(axis=0))
            normal[:, j, k] = np.fft.irfft(np.fft.rfft(factor[j] * factor[k]).conj() * pair, n)
    scale = np.sqrt(np.maximum(np.einsum("sjj->sj", normal), 1e-30))
    normal /= scale[:, :, None] * scale[:, None, :]
    right /= scale
    explained = np.einsum(
        "...j,...j->...", right, (np.linalg.inv(normal + 1e-9 * np.eye(3)) @ right[..., None])[..., 0]
    )
    total = np.sum(values**2, axis=(-2, -1))[..., None]
    return np.asarray(np.maximum(total - explained, 1e-12 * total) / (values.shape[-1] * values.shape[-2]))


def place(raster: Raster, surface: Surface, seed: int = 0) -> PlacedRaster:
    """Where the raster lies on the CT's maps, whether it may be believed, and what is left of it there.

    Raises AnnulusError where there is not plain wall on both sides of a joint as wide as the CT's.
    """
    best: dict[tuple[int, int], tuple[float, _RasterPlace, _RasterFit, tuple[BoolArray, BoolArray]]] = {}
    for sense, along in product((1, -1), (1, -1)):
        fit = _RasterFit(raster, surface, sense, along)
        best[sense, along] = _refined(fit, _begin(fit))
    (sense, along), (cost, found, fit, rows) = min(best.items(), key=lambda item: item[1][0])
    residual, gains, values = fit.left(found, rows)
    samples = _independent(residual)
    covariance = _covariance(fit, found, rows, samples)
    worse = {key: 0.5 * samples * (one[0] - cost) for key, one in best.items()}
    maps, _, lift = fit.at(found, rows)
    elsewhere = np.log(np.stack([_all_round(maps, v, o) for v, o in zip(values, lift, strict=True)])).mean(axis=0)
    step = np.arange(fit.n)
    apart = np.minimum(step, fit.n - step) * (2 * math.pi / fit.n)
    own = max(math.radians(AWAY_DEG), 4 * math.sqrt(covariance[0, 0]))
    far = elsewhere[apart > own]
    odds = 0.5 * samples * float(far.min() - cost) if len(far) else 0.0
    explained, p = _believed(maps, values, lift, np.random.default_rng(seed))
    sides = {word: min(worse[k] for k in worse if k[i] != (sense, along)[i]) for i, word in enumerate(("s", "a"))}
    why = []
    if not p <= P_MOST:
        why.append(f"a raster of the same waviness fits as well by chance with p {p:.3f}, expected {P_MOST:g} or less")
    if explained < EXPLAINED:
        share, expected = 100 * explained, 100 * EXPLAINED
        why.append(f"the CT explains {share:.0f} % of what varies with the angle, expected {expected:.0f} %")
    if odds < ODDS:
        why.append("another angle explains it nearly as well")
    shift = (found.shift - sense * raster.angle[0]) % (2 * math.pi)
    joint, material = _laid(raster, surface, fit, found, rows, gains, sense, along, shift)
    others = tuple(
        (*key, (one[1].shift - key[0] * raster.angle[0]) % (2 * math.pi))
        for key, one in best.items()
        if 0 < worse[key] < ODDS
    )
    return PlacedRaster(
        accepted=not why,
        why="; ".join(why),
        shift=shift,
        shift_sigma=math.sqrt(covariance[0, 0]),
        sense=sense if sides["s"] > ODDS else 0,
        along=along if sides["a"] > ODDS else 0,
        best_sense=sense,
        best_along=along,
        others=others,
        raster_joint_mm=found.z,
        raster_joint_sigma_mm=math.sqrt(covariance[1, 1]),
        blur_mm=(found.round_mm, found.along_mm),
        odds=odds,
        explained=explained,
        p=p,
        gains=gains,
        joint_mv=joint,
        material_mv=material,
    )


def at_joint(values: FloatArray, z_mm: FloatArray, fusion_mm: FloatArray, half_mm: float = 3.0) -> FloatArray:
    """(P,) mean of a map (Z, P) within `half_mm` of the fusion plane (P,); NaN where it is not seen there."""
    near = (np.abs(z_mm[:, None] - fusion_mm) <= half_mm) & np.isfinite(values)
    total = np.where(near, values, 0.0).sum(axis=0)
    return np.asarray(np.where(near.any(axis=0), total / np.maximum(near.sum(axis=0), 1), np.nan))


def _begin(fit: _RasterFit) -> _RasterPlace:
    """The best of all whole steps of angle, and of places a millimetre apart along the pipe."""
    best, place = math.inf, None
    for z in np.arange(fit.z[0], fit.z[-1], Z_STEP_MM):
        one = _RasterPlace(0.0, float(z), BLUR_MM, BLUR_MM)
        rows = fit.rows(one.z, BLUR_MM)
        if rows is None:
            continue
        maps, values, lift = fit.at(one, rows)
        total = np.mean(values**2, axis=(1, 2)) + 1e-12
        left = np.stack([_all_round(maps, v, o) for v, o in zip(values, lift, strict=True)])
        cost = np.log(left / total[:, None]).mean(axis=0)
        if (least := float(cost.min())) < best:
            best, place = least, _RasterPlace(float(np.argmin(cost)) * 2 * math.pi / fit.n, one.z, BLUR_MM, BLUR_MM)
    if place is None:
        wide, blur = fit.feet[1] - fit.feet[0], 2 * CLEAR * BLUR_MM
        raise AnnulusError(
            f"a raster from z {fit.z[0]:g} to {fit.z[-1]:g} mm, expected the joint's bead ({wide:.1f} mm, {blur:g} mm "
            f"of blur) with {ROWS_MIN} rows of plain wall on both sides, where the CT (from {fit.height[0]:+.1f} to "
            f"{fit.height[-1]:+.1f} mm of its joint) sees them too"
        )
    return place


def _vector(place: _RasterPlace) -> FloatArray:
    return np.array([place.shift, place.z, math.log(place.round_mm), math.log(place.along_mm)])


def _place(x: FloatArray) -> _RasterPlace:
    low, high = np.log(BLUR_RANGE_MM)
    along = np.clip(x[3], low, high)
    around = np.clip(x[2], along - math.log(OBLONG), along + math.log(OBLONG))
    return _RasterPlace(float(x[0]), float(x[1]), math.exp(around), math.exp(along))


def _refined(
    fit: _RasterFit, begin: _RasterPlace
) -> tuple[float, _RasterPlace, _RasterFit, tuple[BoolArray, BoolArray]]:
    """Rows stay as they are while the place moves, so that what is compared is the same."""
    rows = fit.rows(begin.z, BLUR_MM)
    assert rows is not None
    x = _vector(begin)
    spread = np.diag([2 * math.pi / fit.n, 0.5, 0.3, 0.3])
    found = optimize.minimize(
        lambda v: fit.cost(_place(v), rows),
        x,
        method="Nelder-Mead",
        options={"initial_simplex": np.vstack([x, x + spread]), "xatol": 1e-3, "fatol": 1e-6, "maxfev": 300},
    )
    return float(found.fun), _place(found.x), fit, rows


def _independent(residual: FloatArray) -> float:
    """How many independent samples (c, R, n) of what is left are, by how alike neighbours and channels are."""
    area = 1.0
    for axis in (1, 2):
        size = residual.shape[axis]
        power = np.abs(np.fft.rfft(residual, 2 * size if axis == 1 else size, axis=axis)) ** 2
        alike = np.fft.irfft(power, axis=axis).sum(axis=(0, 3 - axis))
        alike = alike[: size // 2] / max(alike[0], 1e-30)
        ends = int(np.argmax(alike <= 0)) if (alike <= 0).any() else len(alike)
        area *= 2 * float(alike[:ends].sum()) - 1
    count = residual[0].size / max(area, 1.0)
    if len(residual) > 1:
        between = np.abs(np.corrcoef(residual.reshape(len(residual), -1)))
        count *= len(residual) ** 2 / float(np.nan_to_num(between, nan=1.0).sum())
    return max(float(count), 4.0)


def _covariance(fit: _RasterFit, place: _RasterPlace, rows: tuple[BoolArray, BoolArray], samples: float) -> FloatArray:
    """(4, 4) of shift, z and the logs of both blurs, from how the cost bends. Where it does not, the free range."""
    x = _vector(place)
    step = np.array([math.pi / fit.n, 0.2, 0.1, 0.1])
    bend = np.empty((4, 4))
    for i in range(4):
        for j in range(i, 4):
            a, b = step[i] * np.eye(4)[i], step[j] * np.eye(4)[j]
            four = [fit.cost(_place(x + s * a + t * b), rows) for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            bend[i, j] = bend[j, i] = (four[0] - four[1] - four[2] + four[3]) / (4 * step[i] * step[j])
    prior = np.diag(1 / np.array([math.pi / math.sqrt(3), 5.0, 1.0, 1.0]) ** 2)
    values, vectors = np.linalg.eigh(0.5 * samples * bend)
    information = (vectors * np.maximum(values, 0)) @ vectors.T + prior
    return np.asarray(np.linalg.inv(information))


def _believed(maps: FloatArray, values: FloatArray, lift: FloatArray, rng: np.random.Generator) -> tuple[float, float]:
    """The part of what varies with the angle, beyond a joint alike all round and noise, that the CT explains; and p.

    p : how often chance does as well. Chance is what varies with each order of the angle turned at random, all rows of
    it alike, sought as the raster was, at all angles and in both senses. Both ways along the pipe were tried: p counts
    twice. What it does not cover: another joint with one cold sector like this one's.
    """
    n = values.shape[2]
    ring = maps.mean(axis=2, keepdims=True) * np.ones(n)
    turns = np.exp(1j * rng.uniform(0, 2 * math.pi, (SURROGATES, n // 2 + 1)))
    turns[:, 0] = 1
    part, chance = np.zeros((2, n)), np.zeros((2, SURROGATES, n))
    explained = varied = 0.0
    flip = -np.arange(n) % n
    for data, over in zip(values, lift, strict=True):
        columns = np.stack([ring[0], ring[1], ring[0] * over]).reshape(3, -1)
        gains = np.linalg.lstsq(columns @ columns.T, columns @ data.ravel(), rcond=1e-9)[0]
        alike = (gains @ columns).reshape(data.shape)
        varies = data - alike
        noise = _noise(data) ** 2
        explained += (np.mean(varies**2) - _all_round(maps, data, over)[0]) / noise
        varied += np.mean(varies**2) / noise - 1
        drawn = np.fft.irfft(np.fft.rfft(varies)[None] * turns[:, None], n)
        for i, order in enumerate((np.arange(n), flip)):
            for out, one in ((part[i], varies), (chance[i], drawn)):
                total = np.mean(one**2, axis=(-2, -1))[..., None] + 1e-12
                out += np.log(_all_round(maps, (one + alike)[..., order], over[order]) / total) / len(values)
    seen, by_chance = part.min(), chance.min(axis=(0, 2))
    p = (1 + int((by_chance <= seen).sum())) / (1 + SURROGATES)
    return float(np.clip(explained / max(varied, 1e-12), 0.0, 1.0)), min(1.0, 2 * p)


def _noise(values: FloatArray) -> float:
    """Of one sample of (R, n): from second differences along z, which nothing as wide as an aperture has."""
    rough = float(np.median(np.abs(np.diff(values, 2, axis=0))))
    return 1.4826 * rough / math.sqrt(6) + 1e-9


def _laid(
    raster: Raster,
    surface: Surface,
    fit: _RasterFit,
    place: _RasterPlace,
    rows: tuple[BoolArray, BoolArray],
    gains: FloatArray,
    sense: int,
    along: int,
    shift: float,
) -> tuple[FloatArray, FloatArray]:
    """(c, Z, P) on the CT's grid: the raster over plain wall, and the same with the share of the bead taken out."""
    maps, values, lift = fit.at(place, rows)
    material = values - (gains[:, :1] + gains[:, 2:] * lift)[:, None] * maps[0]
    height = along * (raster.z_mm[rows[0]] - place.z)
    phi = np.arange(surface.bead_mm.shape[1]) * (2 * math.pi / surface.bead_mm.shape[1])
    step = ((phi - place.shift) * (fit.n / (2 * math.pi))) % fit.n
    left = step.astype(int) % fit.n
    part = step - np.floor(step)
    order = np.argsort(height)
    z = surface.z_mm - surface.joint_mm
    laid = []
    for one in (values, material):
        turned = one[:, order][:, :, left] * (1 - part) + one[:, order][:, :, (left + 1) % fit.n] * part
        along_z = interpolate.interp1d(
            height[order], turned, axis=1, bounds_error=False, fill_value=np.nan, assume_sorted=True
        )
        laid.append(np.asarray(along_z(z)))
    return laid[0], laid[1]
