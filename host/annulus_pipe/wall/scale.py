"""How large a scan's lengths across the pipe are, and what anchors that.

Optics drift: a lens and a slide grow with warmth, a tube lengthens, light goes on inside a translucent wall. All radii
of a scan then err alike, and no ring alone shows it. Rings see one wall from different distances, so how far each lies
off the wall that they share (`offsets`) tells some of it (`geometry.drift`); a section of known diameter tells the
rest; what neither tells is what the prior leaves, and enters every absolute length. Depths are differences, and have
no part of it.

The drift is what explains the offsets best (`explained`).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.drift import Drift, drifted, seen_with
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.rounding import DISTANCE, MEASURE, off, quoted, span
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.explained import DriftPrior, Effects, answer_at
from annulus_pipe.wall.offsets import TERMS, KnownSection, Offsets, observations, ring_offsets
from annulus_pipe.wall.optics import Prior
from annulus_pipe.wall.pose import fit_pose
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.reference import ReferenceSection

FRAMES_MOST = 72  # of a scan, whose offsets say what all say: bounds the time
OF_SECTION = 24  # .. and of each reference section
AHEAD_OF_RADIUS = 6.0  # how far ahead of its head a ring may land
STRETCHES = 3  # of a long scan, that frames are taken from ..
STRETCH_OF_RADIUS = 3.0  # .. each so long that all rings see its wall
# What half a kelvin does to lens, slide and tube (of its length) while a scan lasts: where no section is, none is seen.
WITHIN = (5e-5, 1e-5, 3.5e-5)
UNEVENLY = 1.0 / 6.0  # of what a scan drifted by from section to section: warming is fast first, and no line
CABLE = 0.001  # of a length: what a cable on its wheel is off by, standard deviation
EVEN_MOST = 7e-4  # of the radius: standard deviation of a section's rows, 0.05 mm of a 6-inch pipe; more is no sleeve
DRIFT = "drift"  # kind of a finding
LEAST_K2_MM = 0.01  # of a section's reading, before a drift is named: no gauge of a head's own day is better
WILD = 3.0  # standard deviations of what the scan says of itself: a section that is farther off is not of that size
# Of the radius: no head drifts by more from one end of a scan to the other, 4 K of a plastic lens, acrylic and film.
APART_MOST = 0.0025
UNSEEN_WHY = "too little of its wall was seen"
SURE = 3.0  # standard deviations: from there on a drift is named and taken out ..
CHANCE = 0.003  # .. and the same as a probability: that the wall is opaque after all
RING_POINTS = 20  # with fewer a ring does not count as seen
SECTION_OBSERVATIONS = 60  # .. nor does a section


@dataclass(frozen=True, slots=True, eq=False)
class AbsoluteScale:
    """The drift with the head at stations z_mm: one, or where it saw each reference section; evenly along the scan.

    covariance : (7, 7) of a drift, in the order of its fields. even (7,), twofold (2, 7) : what it does to the radius,
    parts of it, and to its two waves. edges_px : how far edges seem drawn. opaque : probability that no light goes on
    inside the wall. references : those that were seen, and the diameter each has with the calibration as it is, to
    observed_k2_mm (k = 2). left_mm (stations, K) : what each ring is off there all the same, which edges do that are
    drawn; none where no section was seen.
    refused : the same of those that anchor nothing, and why. by : what else was known, in words.
    tube_mm : how far the projector stands behind the camera. beyond : of the radius (k = 1), what an even drift leaves
    where the head was beyond its sections. marks : by what part f R is larger than measured, and its standard
    deviation, as marks on the wall say over a known length of cable; None where there are none. astray : of the radius,
    what they say that it is off, which is not taken out.
    """

    z_mm: FloatArray
    drifts: tuple[Drift, ...]
    covariance: FloatArray
    even: FloatArray
    twofold: FloatArray
    edges_px: float
    opaque: float
    references: tuple[tuple[ReferenceSection, float], ...] = ()
    refused: tuple[tuple[ReferenceSection, float, str], ...] = ()
    observed_k2_mm: float = math.nan
    by: str = ""
    tube_mm: float = 0.0
    beyond: float = 0.0
    marks: tuple[float, float] | None = None
    astray: float = 0.0
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
            return math.hypot(math.sqrt(max(float(self.even @ self.covariance @ self.even), 0.0)), self.astray)
        section, _ = self.references[0]
        k2 = math.hypot(self.observed_k2_mm, section.diameter_k2_mm) / section.diameter_mm
        lens, slide, tube = self.even[:3] * WITHIN * [1.0, 1.0, self.tube_mm]
        between = np.ptp([self.even @ one.values for one in self.drifts])
        return math.hypot(k2 / 2.0, lens, slide, tube, self.beyond, UNEVENLY * float(between))

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
    named = references
    references = [
        one for one in named if np.count_nonzero((along >= one.from_mm) & (along <= one.to_mm)) >= SECTION_OBSERVATIONS
    ]
    unseen = tuple((one, math.nan, UNSEEN_WHY) for one in named if one not in references)
    radius = float(np.median(np.hypot(*seen.in_pipe(seen.points)[:, :2].T)))
    plain = ring_offsets(seen, len(calibration.rings), radius, _sections(references), held=False)
    effects = Effects.of(seen, plain.weight, calibration)
    tube_mm = float(np.linalg.norm(calibration.rings[0].vertex_mm))
    before = DriftPrior(
        np.array([prior.focal_mean, prior.slide_mean, prior.tube_mean * tube_mm, 0.0]),
        np.array([prior.focal, prior.slide, prior.tube * tube_mm, prior.anamorphic]),
        wall_mm,
    )
    refused = _refused_sections(plain, effects, before, references, radius)
    references = [one for one in references if all(one is not other for other, _, _ in refused)]
    sections = _sections(references)
    offsets = ring_offsets(seen, len(calibration.rings), radius, sections) if sections else plain
    stations = seen.z_mm[seen.head]
    places = [float(stations[(along >= one.from_mm) & (along <= one.to_mm)].mean()) for one in sections]
    places = places or [offsets.middle_mm]
    answers = [answer_at(offsets, effects, before, z) for z in places]
    covariance = np.asarray(np.mean([one.covariance for one in answers], axis=0))
    edges = float(np.mean([one.edges_px for one in answers]))
    observed = tuple(
        (one, one.diameter_mm + 2.0 * float(offsets.at(z)[:, 0].mean()))
        for one, z in zip(references, places, strict=False)
    )
    beyond = max(min(places) - float(seen.z_mm.min()), float(seen.z_mm.max()) - max(places), 0.0)
    order = np.argsort(places)
    out = AbsoluteScale(
        np.array(places)[order],
        tuple(Drift.of(answers[i].mean) for i in order),
        covariance,
        effects.usual_even / radius,
        np.tensordot(effects.share, effects.twofold, 1) / radius,
        edges,
        min(one.opaque for one in answers),
        observed,
        (*refused, *unseen),
        observed_k2_mm=_observed_k2_mm(offsets, sections),
        by=prior.by,
        tube_mm=tube_mm,
        beyond=offsets.per_mm_sigma * beyond / radius if len(sections) > 1 else 0.0,
        left_mm=np.array([answers[i].left_mm for i in order]) if sections else np.zeros((0, 0)),
    )
    return out if observed or out.is_sure or any(before.mean) else out.as_calibrated()


def with_marks(scale: AbsoluteScale | None, marks: tuple[float, float] | None) -> AbsoluteScale | None:
    """The same scale, knowing what marks on the wall say of f R. marks : by what part a known cable went less far than
    they say, and its standard deviation (`Pace.error`). What they narrow is what all radii have in common; they come
    after the wall is built, so what they say that it is off stays in it, and in `part`."""
    if scale is None or marks is None or scale.references:
        return scale
    effect = scale.even + np.eye(len(scale.even))[0]
    sigma = math.hypot(marks[1], CABLE)
    expected = scale.drifts[0].focal
    spread = float(effect @ scale.covariance @ effect) + sigma**2
    gain = scale.covariance @ effect / spread
    off = marks[0] - expected
    if abs(off) > SURE * math.sqrt(spread):  # the cable is wrong, or a mark: `Pace` has its own words for it
        return replace(scale, marks=(marks[0], sigma))
    covariance = scale.covariance - np.outer(gain, effect @ scale.covariance)
    return replace(scale, covariance=covariance, marks=(marks[0], sigma), astray=abs(float(scale.even @ gain * off)))


def _sections(references: Sequence[ReferenceSection]) -> list[KnownSection]:
    return [KnownSection(one.from_mm, one.to_mm, one.diameter_mm / 2, one.diameter_k2_mm / 4) for one in references]


def _refused_sections(
    plain: Offsets, effects: Effects, before: DriftPrior, references: Sequence[ReferenceSection], radius_mm: float
) -> list[tuple[ReferenceSection, float, str]]:
    """Those that are no reference: uneven, of another size than the scan without them allows, or at odds.

    plain : offsets that hold to none of them."""
    if not references:
        return []
    free = answer_at(plain, effects, before, plain.middle_mm)
    even = effects.usual_even / radius_mm
    part = math.sqrt(max(float(even @ free.covariance @ even), 0.0))
    drifted_by = float(even @ free.mean)
    out, off, good = [], [], []
    for one, mm, uneven in zip(references, plain.sections_mm, plain.uneven_mm, strict=True):
        away = 2.0 * float(mm) * (1.0 + drifted_by) / one.diameter_mm - 1.0
        if uneven > EVEN_MOST * radius_mm:
            why = f"its rows differ by {uneven:.2f} mm (standard deviation): a step, a taper or a defect lies in it"
            out.append((one, 2.0 * float(mm), why))
        elif abs(away) > WILD * math.hypot(part, one.diameter_k2_mm / 2.0 / one.diameter_mm):
            why = f"{one.diameter_mm:.2f} mm was stated, and no optics drift by as much. Its size or its place is wrong"
            out.append((one, 2.0 * float(mm), why))
        else:
            good.append((one, 2.0 * float(mm)))
            off.append(away)
    if len(off) > 1 and float(np.ptp(off)) > APART_MOST:
        why = "the sections contradict each other by more than a head drifts by in one scan"
        out += [(*one, why) for one in good]
    return out


def _observed_k2_mm(offsets: Offsets, sections: Sequence[KnownSection]) -> float:
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
        nothing = "no section of known diameter was named"
        if scale.refused:
            nothing = "no section that was named could be used"
        return (
            f"not checked: {nothing}. Diameters rest on the calibration, {k2}, as much as "
            f"optics drift by and rings do not show{scale.by and f'; {scale.by}'}{_by_marks(scale)}"
        )
    checks = [
        f"{span(one.from_mm, one.to_mm, DISTANCE)}, {quoted(one.diameter_mm, MEASURE, one.diameter_k2_mm)}: "
        f"{mm - one.diameter_mm:+.2f} mm off with the calibration as it is"
        for one, mm in scale.references
    ]
    return f"{'; '.join(checks)}. Diameters rest on it, {k2}, in walls that take in light as that section's does"


def _by_marks(scale: AbsoluteScale) -> str:
    if scale.marks is None:
        return ""
    return f"; marks on the wall over the cable's length say {100 * scale.marks[0]:+.2f} ± {200 * scale.marks[1]:.2f} %"


def drift_lines(scale: AbsoluteScale, sections: Sequence[ReferenceSection]) -> tuple[list[str], bool]:
    """What a check says of each section and of the optics, and whether something is wrong for sure."""
    out, wrong = [], False
    refused = {one: why for one, _, why in scale.refused}
    read = dict((*scale.references, *((one, mm) for one, mm, _ in scale.refused)))
    for one in sections:
        where = f"{span(one.from_mm, one.to_mm, DISTANCE)}  {quoted(one.diameter_mm, MEASURE, one.diameter_k2_mm)}"
        if math.isnan(read.get(one, math.nan)):
            out.append(f"{where}  not seen")
            wrong = True
            continue
        away, k2 = read[one] - one.diameter_mm, math.hypot(one.diameter_k2_mm, scale.observed_k2_mm)
        bad = one in refused or abs(away) > k2
        words = refused.get(one, "off for sure" if bad else "right, as far as is known")
        out.append(f"{where}  reads {quoted(read[one], MEASURE)}, {away:+.2f} ± {k2:.2f} mm (k = 2): {words}")
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
        away = mm - section.diameter_mm
        k2 = math.hypot(section.diameter_k2_mm, scale.observed_k2_mm, LEAST_K2_MM)
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
    for section, mm, why in scale.refused:
        read = "" if math.isnan(mm) else f"it reads {mm:.2f} mm with the calibration as it is; "
        yield (f"the section from {span(section.from_mm, section.to_mm, DISTANCE)} is no reference: {read}{why}")


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
