"""The projector of a head from a clean pipe: its place, direction and phase law, with their sigma.

    told = calibrate_pipe(cameras, designed, shots, shift_mm, radius_mm)

The pipe's radius is known and its wall is smooth; the head stands aside by known amounts, a frame each. Rays of a
camera whose lens is known meet the wall at known places, so each frame shows the slide's phase over a surface, and a
few millimetres aside show it over another: together they say where the light comes from. How the head lies in the pipe
altogether (offset and lean, the same in all frames) is found with it, and so is the waveform: harmonics, which stand
for the slide's gamma too. First comes a search that knows no local minimum within SEARCH of the design: the tilt and
the period under which all light adds up in phase.

Wrong where the radius is: the projector's place scales with it. What one lens gets wrong, this makes the projector's.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.heights import Points
from annulus_pipe.wings.fringe.measure.pipe import lit_wall
from annulus_pipe.wings.fringe.measure.placement import (
    Eye,
    Freedom,
    PlacedHead,
    PointLooks,
    Shots,
    refined,
    shaded,
    shading_terms,
)
from annulus_pipe.wings.fringe.measure.projector import AXIAL, BENDS, LAW, FringeProjector, changed, reflected

CELLS = (30, 60)  # along and round: what is sampled of the wall
SEARCH_RAD = 0.02  # tilts tried first, either way ..
SEARCH_STEPS = 13  # .. in so many steps
SEARCH_PERIOD = 0.02  # of the logarithm of the period, tried either way ..
PERIOD_STEPS = 21  # .. in so many steps
ROUNDS = 16
STILL = 0.02  # sigma a number may change in a round that is the last
PLACE_SIGMA_MM = 20.0  # what is believed of a design: of its projector's place, ..
TILT_SIGMA = 0.05  # .. of its direction, rad, ..
PERIOD_SIGMA = 0.05  # .. and of the logarithm of its period
OFFSET_SIGMA_MM = 5.0  # what is believed of how the head lies in the pipe: aside ..
LEAN_SIGMA = 0.05  # .. and leaning, rad
LENS_SIGMA = np.array([0.3, 0.3, 0.02, 0.02])  # of k1 k2 p1 p2: as on a plate
MIRROR_SIGMA_MM = [2.0, 2.0, 2.0, 1.0]  # of its centre and radius: glued by hand, ground to a tenth
SIGNIFICANT = 5.0  # sigma below which there is no lens, ..
BENT_OF_MISFIT = 0.1  # .. and this share of the misfit, which it must explain
HARMONICS = 2  # pairs sought: blur leaves no more of a slide
COHERENT = 0.15  # of all light adding up, over what a slide of full modulation has: below it is another slide


@dataclass(frozen=True, slots=True)
class CleanPipeFit:
    """What a clean pipe says. projector, and sigma of its centre_mm (3), direction (2, rad about its x and y), phase0
    (rad), logarithm of the period, k1 k2 p1 p2 of the lens, the mirror's centre (3) and radius, harmonics, in this
    order; 0 of what was not sought; covariance of the same. pose : (6,) how the head lay. misfit : grey levels.
    reversed : the places were told the other way round, as those of the pipe before the head. barrel, barrel_sigma,
    edge : of the lens, as in `PlateCalibration`."""

    projector: FringeProjector
    sigma: FloatArray
    covariance: FloatArray
    pose: FloatArray
    misfit: float
    frames: int
    reversed: bool = False
    barrel: float = 0.0
    barrel_sigma: float = math.inf
    edge: float = math.nan


def calibrate_pipe(
    cameras: Sequence[HeadCamera],
    designed: FringeProjector,
    shots: Shots,
    shift_mm: FloatArray,
    radius_mm: float,
    *,
    shift_sigma_mm: float = 0.01,
) -> CleanPipeFit:
    """The projector of `designed`'s kind as the frames say it is.

    cameras : those that look at the slide's light, in a frame whose z lies along the pipe. shift_mm : (F, 3) where the
    head stood, pipe frame; z has no effect, for a clean pipe is alike all along. Shifts of the pipe before the head
    (the other sign) are recognised, and reported in `reversed`. shift_sigma_mm : how well they are known. designed :
    about where the projector is meant to be; its phase0 is not used. AnnulusError for fewer than three places, and
    where frames and design do not go together.
    """
    shift_mm = np.asarray(shift_mm, dtype=float)
    if len(shots.flash) and int(shots.flash.max()) >= len(shift_mm):
        raise AnnulusError(f"{int(shots.flash.max()) + 1} flashes for {len(shift_mm)} places")
    if designed.kind != "rings":
        raise AnnulusError(f"a slide of {designed.kind}: a clean pipe calibrates rings")
    if len(shift_mm) < 3 or np.linalg.matrix_rank(shift_mm[:, :2] - shift_mm[0, :2], tol=radius_mm * 1e-3) < 2:
        raise AnnulusError(
            f"{len(shift_mm)} frames whose places aside do not span a plane: at least three, not in a line"
        )
    head = PlacedHead.at([Eye(camera, designed) for camera in cameras], shots, shift_mm, radius_mm)
    head, coefficients, (near, far) = lit_wall(head, shots.images)
    z = np.linspace(near, far, CELLS[0]) + float(np.median(shift_mm[:, 2]))
    points = Points.pipe(np.arange(CELLS[1]) * 2 * np.pi / CELLS[1], z, radius_mm)
    other = replace(head, poses=head.poses * [1, 1, 1, -1, -1, 1])
    tried = [(*_found(one, coefficients, points), one, backwards) for backwards, one in enumerate((head, other))]
    coherent, slide, head, backwards = max(tried, key=lambda one: one[0])
    if coherent < COHERENT / 2:
        raise AnnulusError(
            f"the frames' light adds up to {coherent:.2f} under the designed slide, expected above {COHERENT / 2:.2f}: "
            "another slide, or a projector far from its design"
        )
    head = head.under(slide)
    straight, mirror = [0.0] * BENDS, MIRROR_SIGMA_MM if slide.mirror_mm else [0.0] * 4
    freedom = Freedom(
        head.poses,
        np.tile([0.0, 0.0, 0.0, shift_sigma_mm, shift_sigma_mm, 0.0], (len(shift_mm), 1)),
        np.array([LEAN_SIGMA, LEAN_SIGMA, 0.0, OFFSET_SIGMA_MM, OFFSET_SIGMA_MM, 0.0]),
        np.array([*[PLACE_SIGMA_MM] * 3, TILT_SIGMA, TILT_SIGMA, 10.0, PERIOD_SIGMA, *straight, *mirror]),
    )
    fit = _settled(head, coefficients, points, freedom)
    bent = replace(freedom, harmonics=HARMONICS, law=freedom.law + np.pad(LENS_SIGMA, (AXIAL, LAW - AXIAL - BENDS)))
    with_lens = _settled(fit.head, coefficients, points, bent)
    slide, lens = with_lens.head.projector, slice(AXIAL, AXIAL + BENDS)
    edge = _edge(with_lens.head, points)
    way = np.array([edge**2, edge**4])
    own, found = with_lens.block[lens, lens], np.resize([*slide.distortion, *[0.0] * BENDS], BENDS)
    better = fit.misfit**2 - with_lens.misfit**2 > (BENT_OF_MISFIT * fit.misfit) ** 2
    if better and float(found @ np.linalg.solve(own, found)) > SIGNIFICANT**2 * BENDS:
        fit = with_lens
    return CleanPipeFit(
        fit.head.projector,
        np.sqrt(np.diag(fit.block)),
        fit.block,
        fit.head.poses.mean(axis=0),
        fit.misfit,
        len(shots.images),
        bool(backwards),
        float(way @ found[:2]),
        float(np.sqrt(way @ own[:2, :2] @ way)),
        edge,
    )


@dataclass(frozen=True, slots=True)
class _Settled:
    """block : covariance of the law and the harmonics."""

    head: PlacedHead
    block: FloatArray
    misfit: float


def _settled(head: PlacedHead, images: Float32Array, points: Points, freedom: Freedom) -> _Settled:
    """Gauss-Newton steps until the projector stands still; the waveform is asked once its place is about right."""
    count = LAW + 2 * HARMONICS
    misfit, begun = _misfit(head, images, points), freedom.harmonics > 0
    noise, covariance = (max(misfit**2, 1 / 12), 0.0, 0.0), np.eye(1)
    for turn in range(ROUNDS):
        if turn == ROUNDS // 4:
            freedom = replace(freedom, harmonics=HARMONICS)
        before = head.projector
        head, covariance = refined(head, images, points, freedom, noise)
        misfit = _misfit(head, images, points)
        noise = (max(misfit**2, 1 / 12), 0.0, 0.0)
        moved = np.abs(np.array(head.projector.centre_mm) - np.array(before.centre_mm))
        asked = turn > (2 if begun else ROUNDS // 4)
        if asked and (moved < STILL * np.sqrt(np.diag(covariance)[-count : -count + 3])).all():
            break
    return _Settled(head, covariance[-count:, -count:], misfit)


def _edge(head: PlacedHead, points: Points) -> float:
    """The widest tangent at which the slide lights the wall."""
    slide = head.projector
    own = (points.base - head.poses[0, 3:] - np.array(slide.centre_mm)) @ np.array(slide.rotation).T
    if slide.mirror_mm:
        own = reflected(np.array(slide.mirror_mm[:3]), slide.mirror_mm[3], own)[0]
    return float((np.hypot(own[:, 0], own[:, 1]) / own[:, 2]).max())


def _found(head: PlacedHead, images: Float32Array, points: Points) -> tuple[float, FringeProjector]:
    """The design, turned and stretched until all light adds up in phase, and how much that is: half the modulation."""
    here = PointLooks.of(head, images, points.base, points.normal)
    good = np.isfinite(here.grey)
    if not good.any():
        raise AnnulusError("no wall is lit: are these frames of a clean pipe?")
    terms, swing = shading_terms(head, here.seen), np.zeros(good.shape)
    for eye in range(len(head.eyes)):
        mine = good & (head.eye == eye)[:, None]
        level = terms[mine] @ np.linalg.lstsq(terms[mine], here.grey[mine], rcond=None)[0]
        swing[mine] = here.grey[mine] / np.maximum(level, 1.0) - 1.0

    def sum_of(projector: FringeProjector) -> complex:
        view = head.under(projector).view
        phase = np.stack([view.phase(points.base, n) for n in range(len(images))])
        return complex((swing * np.exp(-1j * phase))[good].mean())

    best, height, quiet = np.zeros(LAW), 0.0, np.zeros(LAW - AXIAL)
    for _ in range(2):
        tilts = np.linspace(-SEARCH_RAD, SEARCH_RAD, SEARCH_STEPS) / _widened(head.projector)
        for a in tilts:
            for b in tilts:
                trial = np.array([0, 0, 0, a, b, 0, best[6], *quiet])
                found = abs(sum_of(changed(head.projector, trial)))
                if found > height:
                    best, height = trial, found
        for stretch in np.linspace(-SEARCH_PERIOD, SEARCH_PERIOD, PERIOD_STEPS):
            trial = np.array([*best[:6], stretch, *quiet])
            found = abs(sum_of(changed(head.projector, trial)))
            if found > height:
                best, height = trial, found
    nearly = changed(head.projector, best)
    return height, replace(nearly, phase0=nearly.phase0 + float(np.angle(sum_of(nearly))))


def _widened(slide: FringeProjector) -> float:
    """How many times a mirror widens the angles of the slide's light, near its axis: theta + 2 alpha over theta."""
    if not slide.mirror_mm:
        return 1.0
    radius = slide.mirror_mm[3]
    return 1 + 2 * (float(np.linalg.norm(slide.mirror_mm[:3])) - radius) / radius


def _misfit(head: PlacedHead, images: Float32Array, points: Points) -> float:
    """Grey levels that frames differ from the model, robustly."""
    here = PointLooks.of(head, images, points.base, points.normal)
    gain, depth = shaded(head, shading_terms(head, here.seen))
    unit = gain * (1 + depth * head.view.wave(here.phase))
    good = np.isfinite(here.grey)
    grey = np.where(good, here.grey, 0.0)
    below = np.where(good, unit**2, 0.0).sum(axis=0)
    level = np.where(good, grey * unit, 0.0).sum(axis=0) / np.maximum(below, 1e-9)
    several = good & (good.sum(axis=0) > 2)
    return robust_sigma((here.grey - level * unit)[several]) * math.sqrt(len(images) / (len(images) - 1))
