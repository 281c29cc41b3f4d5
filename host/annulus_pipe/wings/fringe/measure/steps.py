"""Where the frames were taken, by the frames themselves, with the odometer as one witness of many.

A head that is not where it was said to be shows each point's texture off its track, and its light at another phase than
the fit of all frames expects. A frame's residuals along that derivative, over all points, are one normal equation in
its position. What a point's own DC, AC, height and drift of light can explain is projected out first (variable
projection): few frames then claim no more than they know, and texture that leans to the drift by chance says nothing.
The first frame is the origin. Carried by: the wall does not move between frames, its residuals are independent. On a
flat wall without texture the fringes stand still in the image and say nothing: the odometer's own sigma then stays.
Where light may drift along the track the fit does not know the motion's whole stretch: that is then the odometer's,
unless the texture's way through the pictures (`stretch`) contradicts it beyond chance.
"""

from dataclasses import dataclass

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.numeric.robust import CAUCHY, cauchy
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.heights import FringeView, Heights, Points, heights
from annulus_pipe.wings.fringe.measure.noise import noise_of
from annulus_pipe.wings.fringe.measure.projector import FringeProjector
from annulus_pipe.wings.fringe.measure.stretch import stretch
from annulus_pipe.wings.fringe.measure.track import GOOD

ROUNDS = 6
POINTS_MAX = 6000  # more say no more than the positions need: a micrometre at fringe-a
STILL_SIGMA = 0.1  # of its sigma a position may change in a round that is the last
MISFIT_MAX = 3.0  # per degree of freedom: points at edges have residuals of their own
STIFF = 1e8  # times the odometer's weight: no freedom
SAID = 4.0  # sigma by which frames and odometer must differ before it is said
CHANCE = 4.0  # sigma by which a texture must stand out of noise
NUISANCES_FROM = 6  # frames
EPSILON = 1e-3  # of a step, and rad of the height's phase: differences in place of derivatives


@dataclass(frozen=True, slots=True)
class Steps:
    """(N,) mm along the motion, from the first frame on: found, their sigma, and what the odometer said. `scale`:
    found positions over the odometer's, with its sigma, infinite where the frames do not tell it.
    `slipped`: frames at which the two disagree beyond chance."""

    place_mm: FloatArray
    sigma_mm: FloatArray
    odometer_mm: FloatArray
    scale: float
    scale_sigma: float
    slipped: BoolArray

    @property
    def wrong(self) -> bool:
        """Whether the odometer's scale or one of its steps is wrong beyond chance."""
        return bool(self.slipped.any()) or self.stretched

    @property
    def stretched(self) -> bool:
        """Whether the odometer's scale is wrong beyond chance."""
        return bool(abs(self.scale - 1) > SAID * self.scale_sigma)


def find_steps(
    one: HeadCamera,
    projector: FringeProjector,
    odometer_mm: FloatArray,
    direction: FloatArray,
    images: Float32Array,
    points: Points,
    *,
    odometer_sigma_mm: float,
    start_mm: FloatArray | float = 0.0,
    drift_sigma: float = 0.0,
) -> Steps:
    """The positions of one camera's frames. direction : (3,) unit; the rest as `heights` takes it.

    odometer_sigma_mm : how far a position may be off. AnnulusError where no point is seen well enough in all frames.
    """
    reported = odometer_mm - odometer_mm[0]
    every = np.unique(np.linspace(0, len(points.base) - 1, min(len(points.base), POINTS_MAX)).astype(int))
    some = points.some(every)
    samples = np.asarray(images)[:, every] if images.shape[2] == 1 else images
    h: FloatArray | float = start_mm if np.ndim(start_mm) == 0 else np.asarray(start_mm)[every]
    trust = np.full(len(reported), odometer_sigma_mm**-2.0)
    trust[0] = 1e12
    prior = np.diag(trust)
    if drift_sigma > 0:  # a stretched motion looks like light that drifts along the track: the stretch stays as told
        prior += STIFF * trust[1] * np.outer(reported, reported) / float(reported @ reported)
    place, noise = reported.copy(), (1.0, 0.0, 0.0)
    covariance = np.zeros((len(reported), len(reported)))
    ahead = EPSILON * float(np.ptp(reported)) / (len(reported) - 1)
    for turn in range(ROUNDS):
        view = FringeView.of(one, projector, place[:, None] * direction)
        found = heights(view, samples, some, h, noise=noise, drift_sigma=drift_sigma)
        if turn == 0:
            noise = noise_of(found)
            found = heights(view, samples, some, h, noise=noise, drift_sigma=drift_sigma)
        beyond = FringeView.of(one, projector, (place + ahead)[:, None] * direction)
        matrix, pull = _equations(view, beyond, ahead, samples, some, found, noise, drift_sigma > 0)
        covariance = np.asarray(np.linalg.inv(matrix + prior))
        step = covariance @ (pull + prior @ (reported - place))
        place = place + step
        if (np.abs(step) < STILL_SIGMA * np.sqrt(np.diag(covariance))).all():
            break
    place = place - place[0]
    sigma = np.sqrt(np.diag(covariance))
    both = np.hypot(sigma, odometer_sigma_mm)
    scale, weight = 1.0, np.ones(len(reported))
    for _ in range(ROUNDS):  # a slip must not pass for a scale
        below = float((weight * (reported / both) ** 2).sum())
        scale = float((weight * reported * place / both**2).sum()) / below
        weight = cauchy((place - scale * reported) / (CAUCHY * both))
    slipped = np.abs(place - scale * reported) > SAID * both
    if drift_sigma > 0:
        place = place / scale
        view = FringeView.of(one, projector, place[:, None] * direction)
        scale, own = stretch(view, samples, some, found.height_mm, place, direction)
        if abs(scale - 1) > SAID * own:
            place, sigma = place * scale, np.hypot(sigma, place * own)
        else:  # as long as the odometer says, and no better known than that
            sigma = np.hypot(sigma, place * odometer_sigma_mm / np.linalg.norm(reported))
        return Steps(place, sigma, reported, scale, own, slipped)
    return Steps(place, sigma, reported, scale, below**-0.5, slipped)


def _equations(
    view: FringeView,
    beyond: FringeView,
    ahead: float,
    images: Float32Array,
    points: Points,
    found: Heights,
    noise: tuple[float, float, float],
    drift: bool,
) -> tuple[FloatArray, FloatArray]:
    """(N, N) and (N,): normal equations of the positions over the points that all frames see."""
    frames = len(view.cameras)
    free = max(frames - 3, 1)
    good = (found.flag == GOOD) & (found.used == frames) & (found.misfit < MISFIT_MAX * free)
    if good.sum() < frames:
        raise AnnulusError(f"{int(good.sum())} points are seen in all {frames} frames: too few to place the frames by")
    seen = points.some(np.flatnonzero(good))
    h, dc, ac = found.height_mm[good], found.dc[good], found.ac[good]
    samples = images[:, good] if images.shape[2] == 1 else images
    rest, wave = _residual(view, samples, seen, h, dc, ac)
    up = EPSILON / float(np.median(np.abs(view.radians_per_mm(seen, h))))
    rest_on, wave_on = _residual(beyond, samples, seen, h, dc, ac)
    change, turned = (rest_on - rest) / ahead, (wave_on - wave) / ahead
    rate = (_residual(view, samples, seen, h + up, dc, ac)[0] - rest) / up
    whole = np.isfinite(rest + change + rate).all(axis=0)
    level = np.maximum(dc + ac * wave, 0.0)
    root = 1 / np.sqrt(noise[0] + level * (noise[1] + level * noise[2]))
    shapes = [np.ones_like(wave), wave, rate]
    share = 1.0
    if images.shape[2] > 1:
        change, share = _texture(change, dc + ac * wave, [wave, turned])
    if drift:
        shapes.append((dc + ac * wave) * view.drift[:, None])
    # robust: an undersampled speck has a steep slope and a residual of its own
    for _ in range(2):
        columns = np.stack([root * one for one in shapes], axis=-1).transpose(1, 0, 2)[whole]  # (P, N, 3 or 4)
        q = np.linalg.qr(columns)[0]
        d, r = (root * change).T[whole], (root * rest).T[whole]
        left = r - np.einsum("pni,pi->pn", q, np.einsum("pni,pn->pi", q, r))
        root[:, whole] *= np.sqrt(cauchy(left.T / CAUCHY))
    inner = np.einsum("pni,pmi->pnm", q * d[:, :, None], q * d[:, :, None])
    return share * (np.diag((d * d).sum(axis=0)) - inner.sum(axis=0)), -share * (d * left).sum(axis=0)


def _texture(change: FloatArray, lit: FloatArray, nuisances: list[FloatArray]) -> tuple[FloatArray, float]:
    """(N, P) slopes of the frames along the motion -> the wall's own, lit as each frame is, and which share of their
    square is texture and not noise. A frame's own noise would find its own slope and vouch for any position: each gets
    the slope that the others show. nuisances : (N, P) each, what an error of AC or phase leaves in the slopes of all
    frames: it vouched for the odometer of a plain wall, 2.6 times too well. Few frames cannot tell it from texture.
    """
    shapes = [lit, *(nuisances if len(change) >= NUISANCES_FROM else [])]
    fine = np.isfinite(change + lit)
    x = np.where(fine[:, None], np.stack([np.where(fine, one, 0.0) for one in shapes], axis=1), 0.0)  # (N, K, P)
    y = np.where(fine, change, 0.0)
    inverse = np.linalg.inv(np.einsum("nip,njp->pij", x, x) + 1e-9 * np.eye(len(shapes)))
    solution = np.einsum("pij,njp,np->ip", inverse, x, y)
    rest = y - np.einsum("nip,ip->np", x, solution)
    lever = np.einsum("pij,njp->nip", inverse, x)
    left = np.maximum(1 - np.einsum("nip,nip->np", lever, x), 1e-3)
    others = solution[0] - lever[:, 0] * rest / left
    free = np.maximum(fine.sum(axis=0) - len(shapes), 1)
    chance_of = (inverse[:, 0, 0] + lever[:, 0] ** 2 / left) * (rest**2).sum(axis=0) / free
    whole, scatter = float(((others * lit) ** 2)[fine].sum()), float((chance_of * lit**2)[fine].sum())
    chance = 1 + CHANCE * np.sqrt(2 / lit.shape[1])  # noise alone may show that much
    return np.where(fine, others * lit, np.nan), max(0.0, 1.0 - chance * scatter / max(whole, 1e-300))


def _residual(
    view: FringeView, images: Float32Array, points: Points, h: FloatArray, dc: FloatArray, ac: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, P) grey levels less the fit, the wave's value."""
    x = points.at(h)
    phase = np.stack([view.phase(x, n) for n in range(len(view.cameras))])
    wave = view.wave(phase)
    if images.shape[2] == 1:
        return np.asarray(images[..., 0] - dc - ac * wave), wave
    grey = np.empty(phase.shape)
    for n, image in enumerate(images):
        u, v = view.pixels(x, n)
        grey[n] = ndimage.map_coordinates(image, [v, u], order=3, prefilter=False, cval=np.nan, output=float)
    return grey - dc - ac * wave, wave
