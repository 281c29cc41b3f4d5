"""How large a scan's lengths across the pipe are, and what anchors that.

Optics drift: a lens and a slide grow with warmth, a tube lengthens, light goes on inside a translucent wall. All radii
of a scan then err alike, and no ring alone shows it. Rings see one wall from different distances, so how far each lies
off the wall that they share (`offsets`) tells some of it (`geometry.drift`); a section of known diameter tells the
rest; what neither tells is what the prior leaves, and enters every absolute length. Depths are differences, and have
no part of it.

The drift is what explains the offsets best: Gaussian, but for two numbers that nobody knows beforehand and that are
summed over: how far edges are drawn whatever the optics do, and how translucent the wall is.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from annulus.geometry.calibration import Calibration
from annulus.geometry.drift import SMALL, Drift, drifted, seen_with
from annulus.numeric.arrays import FloatArray
from annulus.numeric.rounding import DISTANCE, MEASURE, off, said, span
from annulus.vocabulary import Finding
from annulus.wall.offsets import TERMS, Observations, Offsets, Section, observations, ring_offsets
from annulus.wall.optics import Prior
from annulus.wall.pose import fit_pose
from annulus.wall.profile import Profile
from annulus.wall.reference import ReferenceSection

FRAMES_MOST, OF_SECTION = 96, 24  # of a scan, whose offsets say what all say, and of a section: bounds the time
AHEAD_OF_RADIUS = 6.0  # how far ahead of its head a ring may land
STRETCHES, STRETCH_OF_RADIUS = 4, 3.0  # of a long scan: so many, each so long that all rings see its wall
# How far light goes on inside the wall, mm, and how likely each is beforehand: polyethylene 0.15 to 0.4 mm, pigmented
# walls none. The mean of the colours scatters about each by a part, and every colour about that mean.
TRANSLUCENT = ((0.0, 0.5), (0.1, 0.15), (0.2, 0.2), (0.4, 0.15))
WALL_ALIKE = 0.8  # of the variance of a wall that was measured, what its colours have in common
SHIFT_MEAN, SHIFT_LEAST_MM = 0.5, 0.005
GREY, YELLOW = 0.05, 0.3  # of the mean, how far a colour departs from it: as likely one as the other
# How far a ring's edges may be drawn evenly, and by two waves, each as likely beforehand: what colours and widths do to
# them is even, a lens and a mosaic draw them by waves.
EDGES_PX, EDGES_TWOFOLD_PX = (0.01, 0.02, 0.04, 0.08, 0.16, 0.32), (0.01, 0.03, 0.1)
WITHIN = 5e-5  # of the radius: half a kelvin of a plastic lens, while a scan lasts, where one section was looked at
DRIFT = "drift"  # kind of a finding
WILD = 3.0  # standard deviations of what optics drift by: a section that is farther off is not of that size
APART_MOST = (
    0.005  # of the diameter: no head drifts by more from one end of a scan to the other; 15 K of a plastic lens
)
LAWS = 2  # rounds of the linearised answer: the second one's change is below a hundredth of sigma at 0.3 %
SURE, CHANCE = (
    3.0,
    0.003,
)  # standard deviations, and a probability as small: from there on a drift is named and taken out
RING_POINTS, SECTION_OBSERVATIONS = 20, 60  # with fewer a ring, or a section, does not count as seen
NONE = np.zeros(7)


@dataclass(frozen=True, slots=True, eq=False)
class Before:
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
class AbsoluteScale:
    """The drift with the head at stations z_mm: one, or where it saw each reference section; evenly along the scan.

    covariance : (7, 7) of a drift, in the order of its fields. even (7,), twofold (2, 7) : what it does to the radius,
    parts of it, and to its two waves. edges_px : how far edges seem drawn. opaque : probability that no light goes on
    inside the wall. references : those that were seen, and the diameter each has with the calibration as it is, to
    observed_k2_mm (k = 2). left_mm (stations, K) : what each ring is off there all the same, which edges do that are
    drawn; none where no section was seen.
    refused : the same of those that no drift explains, and that anchor nothing. by : what else was known, in words.
    """

    z_mm: FloatArray
    drifts: tuple[Drift, ...]
    covariance: FloatArray
    even: FloatArray
    twofold: FloatArray
    edges_px: float
    opaque: float
    references: tuple[tuple[ReferenceSection, float], ...] = ()
    refused: tuple[tuple[ReferenceSection, float], ...] = ()
    observed_k2_mm: float = math.nan
    by: str = ""
    left_mm: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))

    def at(self, z_mm: float) -> Drift:
        return Drift.of(self._evenly(np.array([one.values for one in self.drifts]), z_mm))

    def left_at(self, z_mm: float) -> FloatArray:
        """(K,) mm."""
        return self._evenly(self.left_mm, z_mm)

    def _evenly(self, values: FloatArray, z_mm: float) -> FloatArray:
        """On the line through values (stations, N)."""
        mean, away = values.mean(axis=0), self.z_mm - self.z_mm.mean()
        slope = away @ values / max(float(away @ away), 1e-9)
        return np.asarray(mean + (z_mm - self.z_mm.mean()) * slope)

    @property
    def part(self) -> float:
        """Standard deviation of what all radii have in common, of the radius."""
        if not self.references:
            return math.sqrt(max(float(self.even @ self.covariance @ self.even), 0.0))
        section, _ = self.references[0]
        k2 = math.hypot(self.observed_k2_mm, section.diameter_k2_mm) / section.diameter_mm
        return math.hypot(k2 / 2.0, WITHIN if len(self.references) == 1 else 0.0)

    @property
    def oval_part(self) -> float:
        """Standard deviation of the long radius' excess over the mean, of the radius."""
        most = np.linalg.eigvalsh(self.twofold @ self.covariance @ self.twofold.T)[-1]
        return math.sqrt(max(float(most), 0.0))

    def of(self, *fields: str) -> tuple[float, float]:
        """A sum of the drift's fields, the mean over the stations, and its standard deviation."""
        which = np.array([float(name in fields) for name in Drift.__slots__])
        mean = float(np.mean([which @ one.values for one in self.drifts]))
        return mean, math.sqrt(max(float(which @ self.covariance @ which), 0.0))

    @property
    def is_sure(self) -> bool:
        """Whether rings alone show that something has drifted, or a wall that light enters."""
        shown = (self.of("focal", "slide"), self.of("anamorphic"))
        return self.opaque < CHANCE or any(abs(value) > SURE * sigma for value, sigma in shown)

    def as_calibrated(self) -> "AbsoluteScale":
        """The calibration left as it is: what it may be off then, seen from there."""
        mean = self.drifts[0].values
        return replace(self, drifts=(Drift(),), covariance=self.covariance + np.outer(mean, mean))


def find_scale(
    profiles: Sequence[Profile],
    calibration: Calibration,
    references: Sequence[ReferenceSection] = (),
    prior: Prior | None = None,
) -> AbsoluteScale | None:
    """What a scan says of its scale; None of a head of which it is not known: several cameras, a mirror, no cones.

    profiles : as they were measured. references : those that nobody saw are left out.
    """
    if calibration.others or not calibration.camera.central or not calibration.rings:
        return None
    prior, wall_mm = prior or Prior(), calibration.translucency_sigma_mm
    calibration = calibration.in_wall()
    used = _chosen(profiles, calibration, references)
    seen = observations(used) if used else None
    if seen is None or not len(seen.head) or seen.ring.max() >= len(calibration.rings):
        return None
    along = seen.in_pipe(seen.points)[:, 2]
    references = [
        one
        for one in references
        if np.count_nonzero((along >= one.from_mm) & (along <= one.to_mm)) >= SECTION_OBSERVATIONS
    ]
    radius = float(np.median(np.hypot(*seen.in_pipe(seen.points)[:, :2].T)))
    sections = [Section(r.from_mm, r.to_mm, r.diameter_mm / 2, r.diameter_k2_mm / 4) for r in references]
    offsets = ring_offsets(seen, len(calibration.rings), radius, sections)
    effects = _Effects.of(seen, offsets.weight, calibration)
    tube_mm = float(np.linalg.norm(calibration.rings[0].vertex_mm))
    before = Before(
        np.array([prior.focal_mean, prior.slide_mean, prior.tube_mean * tube_mm, 0.0]),
        np.array([prior.focal, prior.slide, prior.tube * tube_mm, prior.anamorphic]),
        wall_mm,
    )
    stations = seen.z_mm[seen.head]
    places = [float(stations[(along >= one.from_mm) & (along <= one.to_mm)].mean()) for one in sections]
    places = places or [offsets.middle_mm]
    answers = [_answer(offsets, effects, before, z) for z in places]
    covariance = np.asarray(np.mean([one.covariance for one in answers], axis=0))
    edges = float(np.mean([one.edges_px for one in answers]))
    found = tuple(
        (one, one.diameter_mm + 2.0 * float(offsets.at(z)[:, 0].mean()))
        for one, z in zip(references, places, strict=False)
    )
    most = WILD * _drift_part(effects, before, radius)
    wild = [one for one in found if abs(one[1] / one[0].diameter_mm - 1.0) > most]
    if not wild and len(sections) > 1:
        apart = ring_offsets(seen, len(calibration.rings), radius, sections, held=False).sections_mm
        if np.ptp(apart - [one.radius_mm for one in sections]) > APART_MOST * radius:
            wild = [(one, 2.0 * float(mm)) for one, mm in zip(references, apart, strict=True)]
    if wild:
        rest = [one for one in references if all(one is not other for other, _ in wild)]
        without = find_scale(profiles, calibration, rest, prior)
        return without and replace(without, refused=(*without.refused, *wild))
    order = np.argsort(places)
    out = AbsoluteScale(
        np.array(places)[order],
        tuple(Drift.of(answers[i].mean) for i in order),
        covariance,
        effects.usual_even / radius,
        np.tensordot(effects.share, effects.twofold, 1) / radius,
        edges,
        min(one.opaque for one in answers),
        found,
        observed_k2_mm=_observed_k2_mm(offsets, sections),
        by=prior.by,
        left_mm=np.array([answers[i].left_mm for i in order]) if sections else np.zeros((0, 0)),
    )
    return out if found or out.is_sure or prior.by else out.as_calibrated()


def _drift_part(effects: "_Effects", before: Before, radius_mm: float) -> float:
    """Of the radius: the standard deviation of what optics, and the most translucent wall, put it off by."""
    mean, spread = _prior(before, before.walls[-1][0])
    even = effects.usual_even / radius_mm
    return math.sqrt(even @ (spread + np.outer(mean, mean)) @ even)


def _observed_k2_mm(offsets: Offsets, sections: Sequence[Section]) -> float:
    """Of a section's diameter, as all rings together saw it, beside what is not known of the section itself; NaN
    without one."""
    if not sections:
        return math.nan
    rows = np.arange(0, len(offsets.covariance), TERMS)
    variance = float(offsets.covariance[np.ix_(rows, rows)].mean()) - float(np.mean([s.sigma_mm**2 for s in sections]))
    return 4.0 * math.sqrt(max(variance, 0.0))


def with_drift(
    profiles: Sequence[Profile], calibration: Calibration, scale: AbsoluteScale | None
) -> tuple[Profile, ...]:
    """The profiles as the drifted head took them: points on the cones as they are now, heads where those see them."""
    if scale is None or not any(one != Drift() for one in scale.drifts):
        return tuple(profiles)
    calibration = calibration.in_wall()
    return tuple(_taken_with(profile, calibration, scale) for profile in profiles)


def with_scale(profiles: Sequence[Profile], scale: AbsoluteScale | None) -> tuple[Profile, ...]:
    """The same profiles, sigma with what all radii of the scan have in common."""
    if scale is None:
        return tuple(profiles)
    return tuple(
        replace(one, sigma_mm=np.hypot(one.sigma_mm, scale.part * np.hypot(*one.points_mm[:, :2].T)).astype(np.float32))
        for one in profiles
    )


def scale_findings(scale: AbsoluteScale | None) -> tuple[Finding, ...]:
    """What has drifted for sure, in words; what was said of a section's size that cannot be."""
    return () if scale is None else tuple(Finding(DRIFT, text) for text in (*_drifted(scale), *_refused(scale)))


def anchor(scale: AbsoluteScale | None, diameter_mm: float) -> str:
    """What diameters rest on, in words, and what all of them may be off alike. diameter_mm : the pipe's."""
    if scale is None:
        return "diameters rest on the calibration; what this kind of head may have drifted by is in none of the numbers"
    k2 = f"all diameters may be off alike by {off(2.0 * scale.part * diameter_mm, MEASURE)} (k = 2)"
    if not scale.references:
        return (
            f"not checked: no section of known diameter was named. Diameters rest on the calibration, {k2}, as much as "
            f"optics drift by and rings do not show{scale.by and f'; {scale.by}'}"
        )
    checks = [
        f"{span(one.from_mm, one.to_mm, DISTANCE)}, {said(one.diameter_mm, MEASURE, one.diameter_k2_mm)}: "
        f"{mm - one.diameter_mm:+.2f} mm off with the calibration as it is"
        for one, mm in scale.references
    ]
    return f"{'; '.join(checks)}. Diameters rest on it, {k2}"


def drift_lines(scale: AbsoluteScale, sections: Sequence[ReferenceSection]) -> tuple[list[str], bool]:
    """What a check says of each section and of the optics, and whether something is wrong for sure."""
    out, wrong = [], False
    read = dict((*scale.references, *scale.refused))
    refused = {one for one, _ in scale.refused}
    for one in sections:
        where = f"{span(one.from_mm, one.to_mm, DISTANCE)}  {said(one.diameter_mm, MEASURE, one.diameter_k2_mm)}"
        if one not in read:
            out.append(f"{where}  not seen")
            wrong = True
            continue
        away, k2 = read[one] - one.diameter_mm, math.hypot(one.diameter_k2_mm, scale.observed_k2_mm)
        bad = one in refused or abs(away) > k2
        words = "no drift explains that" if one in refused else "off for sure" if bad else "right, as far as is known"
        out.append(f"{where}  reads {said(read[one], MEASURE)}, {away:+.2f} ± {k2:.2f} mm (k = 2): {words}")
        wrong = wrong or bad
    for what, names in (("focal x slide", ("focal", "slide")), ("fy over fx", ("anamorphic",))):
        value, sigma = scale.of(*names)
        sure = "drifted" if abs(value) > SURE * sigma else "no drift that is sure"
        out.append(f"{what:<14} {_percent(value, sigma)}: {sure}")
    return out, wrong


def _drifted(scale: AbsoluteScale) -> Iterator[str]:
    shown = (
        (("focal", "slide"), "focal length times the slide's scale", "the rings' disagreement"),
        (("anamorphic",), "fy more than fx", "how far rings are out of round"),
    )
    for names, what, by in shown:
        value, sigma = scale.of(*names)
        if abs(value) > SURE * sigma:
            yield f"drifted: {what} {_percent(value, sigma)} since the calibration, by {by}; taken out"
    for section, mm in scale.references:
        away, k2 = mm - section.diameter_mm, math.hypot(section.diameter_k2_mm, scale.observed_k2_mm)
        if abs(away) > SURE / 2.0 * k2:
            yield (
                f"drifted: diameters with the calibration as it is are {away:+.2f} ± {k2:.2f} mm off (k = 2) at the "
                f"reference section from {span(section.from_mm, section.to_mm, DISTANCE)}; taken out"
            )
    if scale.opaque < CHANCE:
        red, green, blue = (scale.of(f"{name}_mm") for name in ("red", "green", "blue"))
        yield (
            "light goes on inside this wall farther than in the calibration's: "
            + ", ".join(
                f"{name} {value:+.2f} ± {2.0 * sigma:.2f} mm"
                for name, (value, sigma) in (("red", red), ("green", green), ("blue", blue))
            )
            + " (k = 2); taken out"
        )


def _refused(scale: AbsoluteScale) -> Iterator[str]:
    for section, mm in scale.refused:
        yield (
            f"the section from {span(section.from_mm, section.to_mm, DISTANCE)} is no reference: it reads {mm:.2f} mm, "
            f"{section.diameter_mm:.2f} mm was stated, and no optics drift by as much"
            + (", or from one section to the other" if len(scale.refused) > 1 else "")
            + ". Its size or its place is wrong"
        )


def _percent(value: float, sigma: float) -> str:
    return f"{100.0 * value:+.3f} ± {200.0 * sigma:.3f} % (k = 2)"


def _taken_with(profile: Profile, calibration: Calibration, scale: AbsoluteScale) -> Profile:
    if profile.pose is None or not len(profile.ring):
        return profile
    now = drifted(calibration, scale.at(profile.z_mm))
    points = profile.pose.to_camera(profile.points_mm.astype(np.float64), profile.z_mm)
    points = seen_with(points, profile.ring, calibration, now)
    lost = np.asarray(~np.isfinite(points).all(axis=1))
    if lost.any():
        profile, points = profile.without(lost, "drift"), points[~lost]
    assert profile.pose is not None
    rings = np.count_nonzero(np.bincount(profile.ring) > RING_POINTS)
    sigma = np.nan_to_num(profile.sigma_mm.astype(np.float64), nan=1.0)
    fit = fit_pose(points, calibration.pipe_radius_mm, sigma, profile.pose, bool(rings < 2))
    pose = profile.pose if fit is None else replace(fit.pose, roll=profile.pose.roll)
    points = pose.to_pipe(points, profile.z_mm)
    if len(scale.left_mm):
        left = scale.left_at(profile.z_mm)[profile.ring]
        points[:, :2] *= (1.0 - left / np.hypot(points[:, 0], points[:, 1]))[:, None]
    return replace(profile, pose=pose, points_mm=points.astype(np.float32))


def frames_for_scale(
    z_mm: FloatArray, radius_mm: float, references: Sequence[ReferenceSection] = ()
) -> NDArray[np.intp]:
    """Numbers of the frames that say enough of a scan's scale, of all that were taken at stations z_mm (N,): all over
    the scan, and densely where they see a reference section. radius_mm : of the pipe, roughly."""
    if not len(z_mm):
        return np.zeros(0, np.intp)
    order = np.argsort(z_mm, kind="stable")
    z, long = z_mm[order], STRETCH_OF_RADIUS * radius_mm
    starts = np.linspace(z[0], max(z[-1] - long, z[0]), STRETCHES)
    parts = [(z >= start) & (z <= start + long) for start in starts]
    if z[-1] - z[0] <= STRETCHES * long:
        parts = [np.ones(len(z), np.bool_)]
    chosen = [_thinned(np.flatnonzero(part), FRAMES_MOST // len(parts)) for part in parts]
    for one in references:
        near = (z >= one.from_mm - AHEAD_OF_RADIUS * radius_mm) & (z <= one.to_mm)
        chosen.append(_thinned(np.flatnonzero(near), OF_SECTION))
    return np.asarray(order[np.unique(np.concatenate(chosen))])


def _chosen(
    profiles: Sequence[Profile], calibration: Calibration, references: Sequence[ReferenceSection]
) -> list[Profile]:
    """Frames enough."""
    used = [one for one in profiles if one.pose is not None and len(one.ring)]
    numbers = frames_for_scale(np.array([one.z_mm for one in used]), calibration.pipe_radius_mm, references)
    return [used[i] for i in numbers]


def _thinned(numbers: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    return numbers[np.unique(np.linspace(0, len(numbers) - 1, min(most, len(numbers))).round().astype(np.intp))]


@dataclass(frozen=True, slots=True, eq=False)
class _Effects:
    """What a drift does to the rings' offsets: even (K, 7) and of two waves (K, 2, 7), mm; px_mm (K,) of a pixel."""

    seen: Observations
    weight: FloatArray
    calibration: Calibration
    even: FloatArray
    twofold: FloatArray
    px_mm: FloatArray

    @classmethod
    def of(cls, seen: Observations, weight: FloatArray, calibration: Calibration) -> "_Effects":
        rings, values = len(calibration.rings), SMALL.values
        bare = cls(seen, weight, calibration, NONE, NONE, NONE)
        parts = [bare.moved(Drift.of(np.where(np.arange(len(values)) == i, step, 0.0))) / step
                 for i, step in enumerate(values)]  # fmt: skip
        terms = np.stack(parts, axis=-1)  # (K, TERMS, 7)
        camera = calibration.camera
        away = np.hypot(*(camera.project(seen.points) - [camera.cx, camera.cy]).T)
        far = np.array([np.mean(away[seen.ring == k]) if (seen.ring == k).any() else np.nan for k in range(rings)])
        px_mm = np.abs(terms[:, 0, 0]) / np.nan_to_num(far, nan=1.0)
        return replace(bare, even=terms[:, 0], twofold=terms[:, 3:5], px_mm=px_mm)

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
            if np.count_nonzero(mine) > TERMS:
                root = np.sqrt(self.weight[mine])
                out[k] = np.linalg.lstsq(own[mine] * root[:, None], change[mine] * root, rcond=None)[0]
        return out


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    mean: FloatArray
    covariance: FloatArray
    left_mm: FloatArray  # (K,) of the even offsets
    edges_px: float
    opaque: float  # probability


def _answer(offsets: Offsets, effects: _Effects, before: Before, z_mm: float) -> _Answer:
    """The drift at a place."""
    terms = [k * TERMS + i for k in range(len(offsets.mm)) for i in (0, 3, 4)]
    noise = offsets.covariance[np.ix_(terms, terms)]
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
            mean, spread = _prior(before, shift, colour)
            total = noise + np.diag(px[0] ** 2 * even + px[1] ** 2 * twofold) + design @ spread @ design.T
            gain = np.linalg.solve(total, design @ spread).T
            left = value - design @ mean
            log.append(math.log(chance) - 0.5 * (np.linalg.slogdet(total)[1] + left @ np.linalg.solve(total, left)))
            means.append(mean + gain @ left)
            covariances.append(spread - gain @ design @ spread)
        weight = np.exp(np.array(log) - logsumexp(log))
        at = weight @ np.array(means)
    apart = np.array(means) - at
    covariance = np.einsum("n,nij->ij", weight, np.array(covariances)) + (apart.T * weight) @ apart
    opaque = float(sum(p for p, ((shift, *_), _) in zip(weight, many, strict=True) if shift == 0.0))
    left = offsets.at(z_mm)[:, 0] + effects.moved(Drift.of(at))[:, 0]
    return _Answer(at, covariance, left, float(weight @ np.array([px for _, (px, _) in many])), opaque)


def _prior(before: Before, shift_mm: float, colour: float = YELLOW) -> tuple[FloatArray, FloatArray]:
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
