"""A slide of stripes from single frames of a flat plate at known heights: where its light comes from, and its waveform.

A frame of a plain plate shows the whole wave at once: no motion is needed. First each frame by itself: the carrier is
the peak of its spectrum, the light taken down by it gives a rough phase, unwrapped outwards from where it is clearest.
It lacks a whole number of periods that differs from height to height; one projector explains all frames, and only with
the right numbers. Then tile by tile against that projector: level, swing, their slopes, what is left of the phase, and
the waveform's harmonics. Carried by: the plate is flat, stands across the first camera's axis at the heights told, and
is plain (its albedo changes little within a tile).

Seven numbers are all there is to know of stripes in space: the light's place along the stripes leaves no trace.
    across_mm, depth_mm   its place across the stripes (from x towards y as they are turned), and along z
    tilt_x, tilt_y        how its axis is turned about x and y, rad
    rate                  K = 2 pi / period: phase per unit of the tangent (the source's theta = K s / z)
    turn                  of the stripes, rad, from x towards y;  phase0
A lens that distorts (§6.6, barrel) bends the stripes, and bends say where its axis is along them: five numbers more.
    along_mm              its place along the stripes
    k1 k2 p1 p2           as a camera's
They are sought where seven leave the frames unexplained, and once more in the end; they stay where they stand out.
"""

import heapq
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray, IntArray
from annulus_pipe.numeric.late import ndimage, optimize
from annulus_pipe.numeric.robust import CAUCHY, cauchy, robust_sigma
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.projector import HARMONICS_MAX, FringeProjector

NAMES = ("across_mm", "depth_mm", "tilt_x", "tilt_y", "rate", "turn", "phase0")
LENS = ("along_mm", "k1", "k2", "p1", "p2")
LENS_SIGMA = np.array([20.0, 0.3, 0.3, 0.02, 0.02])  # what is believed of a lens: wide angle, glued by hand
SCALE = np.array([1, 10, 0.01, 0.01, 1, 0.01, 1, 10, 0.1, 0.1, 0.01, 0.01])  # of the numbers' steps
HEIGHTS_MIN = 2
PERIOD_MIN_PX = 5.0  # a finer wave has no harmonics left
CYCLES_MIN = 5.0  # across the image: a coarser wave has no carrier
WINDOW_PERIODS = 0.75  # sigma of the window of the rough phase: the carrier's other side is down to e^-11
MODULATION_MIN = 0.1  # rough: below it there is no slide's light
TILE_PERIODS = 2  # whole ones: slopes of the level and the wave do not mix
LIT = 0.2  # of the brightest: darker tiles say little of the waveform
TILES_MIN = 20  # of a frame
ROUNDS = 3
ACROSS_MAX_MM = 400.0  # a projector is looked for so far from the camera
ACROSS_STEP_MM = 1.0  # so finely: a step changes a frame's order by less than one half
ORDERS_TRIED = 12  # the likeliest, of one camera ..
ORDERS_JOINED = 4  # .. and of all cameras together
BEATEN = 4.0  # times the misfit: the next best orders must be worse by that
STILL_RAD = 0.3  # of the best orders' misfit: more is another wall than the one told
SIGNIFICANT = 4.0  # sigma below which a harmonic is none, and a lens
HELD_RAD = 0.03  # what LENS_SIGMA is weighed by: a tile's usual scatter
EDGE_PERCENT = 99.0  # of the lit tiles lie within what is called the edge of the light
BENT_RAD = 0.01  # of what a lens does to the phase, rms: less is the camera's own lens, not quite known


@dataclass(frozen=True, slots=True)
class ReferencePlate:
    """One frame of the plate: (H, W) linear in light, NaN where saturated; the camera; the plate's z in the head's
    frame, mm; words that name the frame."""

    light: Float32Array
    head: HeadCamera
    z_mm: float
    where: str


@dataclass(frozen=True, slots=True)
class PlateCalibration:
    """What the frames say. values, covariance : of NAMES, and of LENS where that stands out. barrel, barrel_sigma : how
    much the lens takes of the tangent at the edge of the light, of 1, negative for a barrel; found or not, as far as
    these frames say. edge : the tangent there. harmonics_sigma : as the projector's harmonics. gamma: the
    exponent on the camera's light that would explain the even harmonic, and its sigma. rms_rad : of tiles about the
    projector's phase; camera_rad : by how much that differs from camera to camera, the mean over each."""

    projector: FringeProjector
    values: FloatArray
    covariance: FloatArray
    harmonics_sigma: tuple[float, ...]
    modulation: float
    gamma: float
    gamma_sigma: float
    rms_rad: float
    camera_rad: float
    tiles: int
    lit: FloatArray  # (F,) share of each frame's tiles that were used
    barrel: float
    barrel_sigma: float
    edge: float

    @property
    def sigma(self) -> FloatArray:
        """As `values`."""
        return np.sqrt(np.diag(self.covariance))


@dataclass(frozen=True, slots=True)
class _Tiles:
    """(T,) tiles of one frame: middle in the image, px; phase, rad; its weight."""

    u: FloatArray
    v: FloatArray
    phase: FloatArray
    weight: FloatArray


def calibrate_plate(
    plates: Sequence[ReferencePlate], progress: Callable[[int, int], None] | None = None
) -> PlateCalibration:
    """AnnulusError, one line, where the frames show no fringes, or fringes that no one projector explains."""
    heights_mm = sorted({one.z_mm for one in plates})
    if len(heights_mm) < HEIGHTS_MIN:
        raise AnnulusError(
            f"the reference frames are of {len(heights_mm)} height, expected a plate at {HEIGHTS_MIN} or more: one "
            "height does not tell the projector's distance"
        )
    report = progress or (lambda done, total: None)
    total = len(plates) * (1 + ROUNDS)
    rough, first = [], _carrier(plates[0])
    for done, one in enumerate(plates):
        rough.append(_rough(one, first))
        report(done + 1, total)
    try:
        values = _ordered(plates, rough, first)
    except AnnulusError:
        values = _ordered(plates, rough, first, bent=True)
    harmonics = np.zeros(2 * (HARMONICS_MAX - 1))
    fine: list[_Tiles] = []
    for turn in range(ROUNDS):
        slide = _projector(values, harmonics)
        told_by = []
        for done, one in enumerate(plates):
            told_by.append(_tiles(one, slide))
            report(len(plates) * (1 + turn) + done + 1, total)
        fine = [tiles for tiles, _ in told_by]
        values, covariance, left = _fit(plates, fine, values[: len(NAMES)])
        bent = _fit(plates, fine, np.concatenate([values, np.zeros(len(LENS))]))
        if _stands_out(left, bent):
            values, covariance, left = bent
        waves = np.concatenate([wave for _, wave in told_by])
        harmonics, spread = _waveform(waves)
    kept, kept_sigma = _significant(harmonics, spread)
    modulation, gamma, gamma_sigma = _gamma(waves, harmonics, spread)
    apart = [
        abs(float(np.mean(a)) - float(np.mean(b)))
        for (i, a), (j, b) in itertools.combinations(enumerate(left), 2)
        if plates[i].z_mm == plates[j].z_mm and plates[i].head.id != plates[j].head.id
    ]
    every = np.concatenate(left)
    barrel, barrel_sigma, edge = _barrel(plates, fine, bent)
    values[6] = math.remainder(values[6], 2 * math.pi)
    return PlateCalibration(
        _projector(values, kept),
        values,
        covariance,
        kept_sigma,
        modulation,
        gamma,
        gamma_sigma,
        robust_sigma(every),
        max(apart, default=0.0),
        len(every),
        np.array([len(one.u) for one in fine]),
        barrel,
        barrel_sigma,
        edge,
    )


def _projector(values: FloatArray, harmonics: FloatArray | tuple[float, ...] = ()) -> FringeProjector:
    across, depth, tilt_x, tilt_y, rate, turn, phase0 = (float(one) for one in values[:7])
    along, *lens = (float(one) for one in values[7:]) if len(values) > len(NAMES) else (0.0,)
    rotation = cv2.Rodrigues(np.array([tilt_x, tilt_y, 0.0]))[0]
    return FringeProjector(
        "stripes",
        (across * math.cos(turn) - along * math.sin(turn), across * math.sin(turn) + along * math.cos(turn), depth),
        tuple((float(a), float(b), float(c)) for a, b, c in rotation),
        2 * math.pi / rate,
        phase0,
        math.degrees(turn),
        harmonics=tuple(float(one) for one in harmonics),
        distortion=tuple(lens),
    )


def _carrier(plate: ReferencePlate) -> FloatArray:
    """(2,) cycles per px along u, v: the strongest wave of the frame."""
    light = np.nan_to_num(plate.light, nan=float(np.nanmax(plate.light)))
    height, width = light.shape
    window = np.hanning(height)[:, None] * np.hanning(width)
    smooth = light - ndimage.gaussian_filter(light, min(height, width) / CYCLES_MIN)
    power = np.abs(np.fft.rfft2(smooth * window)) ** 2
    fv, fu = np.meshgrid(np.fft.fftfreq(height), np.fft.rfftfreq(width), indexing="ij")
    size = np.hypot(fu, fv)
    power[(size > 1 / PERIOD_MIN_PX) | (size < CYCLES_MIN / max(height, width))] = 0.0
    best = int(np.argmax(power))
    j, i = np.unravel_index(best, power.shape)
    if not power[j, i] > 0:
        raise AnnulusError(f"{plate.where}: shows no fringes, expected the slide's light on a plain plate")
    return np.array([fu[j, i], fv[j, i]])


def _rough(plate: ReferencePlate, carrier: FloatArray) -> _Tiles:
    """Phase to about a tenth of a radian, right but for one number of periods for the whole frame."""
    light = np.nan_to_num(plate.light, nan=float(np.nanmax(plate.light)))
    height, width = light.shape
    period = 1 / float(np.hypot(*carrier))
    u, v = np.arange(width), np.arange(height)
    wave = np.exp(-2j * np.pi * (carrier[0] * u + carrier[1] * v[:, None]))
    dc = ndimage.gaussian_filter(light, WINDOW_PERIODS * period)
    down = (light - dc) * wave
    lock = [ndimage.gaussian_filter(part, WINDOW_PERIODS * period) for part in (down.real, down.imag)]
    step = max(round(period / 2), 1)
    pick = np.ix_(v[step::step], u[step::step])
    signal = (lock[0] + 1j * lock[1])[pick]
    level = dc[pick]
    quality = np.where(level > LIT * level.max(), 2 * np.abs(signal) / np.maximum(level, 1e-6), 0.0)
    phase = _unwrapped(np.angle(signal), quality)
    tv, tu = np.meshgrid(v[step::step], u[step::step], indexing="ij")
    good = np.isfinite(phase)
    if good.sum() < TILES_MIN:
        raise AnnulusError(f"{plate.where}: shows no fringes, expected the slide's light on a plain plate")
    whole = phase + 2 * np.pi * (carrier[0] * tu + carrier[1] * tv)
    return _Tiles(tu[good].astype(float), tv[good].astype(float), whole[good], quality[good])


def _unwrapped(phase: FloatArray, quality: FloatArray) -> FloatArray:
    """(Y, X) rad, grown from the best place over its neighbours, the better ones first; NaN where there is no light."""
    out = np.full(phase.shape, np.nan)
    seed = tuple(int(one) for one in np.unravel_index(int(np.argmax(quality)), phase.shape))
    heap = [(-float(quality[seed]), seed, float(phase[seed]))]
    while heap:
        _, (j, i), near = heapq.heappop(heap)
        if np.isfinite(out[j, i]):
            continue
        out[j, i] = near + math.remainder(float(phase[j, i]) - near, 2 * math.pi)
        for b, a in ((j - 1, i), (j + 1, i), (j, i - 1), (j, i + 1)):
            inside = 0 <= b < phase.shape[0] and 0 <= a < phase.shape[1]
            if inside and quality[b, a] > MODULATION_MIN and not np.isfinite(out[b, a]):
                heapq.heappush(heap, (-float(quality[b, a]), (b, a), float(out[j, i])))
    return out


def _points(plate: ReferencePlate, u: FloatArray, v: FloatArray) -> FloatArray:
    """(T, 3) mm, head's frame: where the rays of pixels meet the plate."""
    turn, shift = np.array(plate.head.rotation), np.array(plate.head.translation_mm)
    rays = plate.head.camera.rays(np.stack([u, v], axis=1)) @ turn
    eye = -turn.T @ shift
    return np.asarray(eye + rays * ((plate.z_mm - eye[2]) / rays[:, 2])[:, None])


def _ordered(
    plates: Sequence[ReferencePlate], rough: list[_Tiles], carrier: FloatArray, bent: bool = False
) -> FloatArray:
    """NAMES, with LENS where `bent`, to a rough phase's accuracy: the projector whose orders explain every frame."""
    own = plates[0].head.id
    alone = [i for i, one in enumerate(plates) if one.head.id == own]
    points = [_points(one, tiles.u, tiles.v) for one, tiles in zip(plates, rough, strict=True)]
    lens = plates[0].head.camera
    gradient = 2 * np.pi * carrier * [lens.fx, lens.fy]
    start = np.array([0.0, 0.0, 0.0, 0.0, np.hypot(*gradient), math.atan2(gradient[1], gradient[0]), 0.0])
    start = np.concatenate([start, np.zeros(len(LENS))]) if bent else start
    scale = SCALE[: len(start)]

    def off(values: FloatArray, which: Sequence[int]) -> list[FloatArray]:
        slide = _projector(values)
        return [rough[i].phase - slide.phase(points[i]) for i in which]

    def shape(values: FloatArray) -> FloatArray:  # whatever the orders; its place across is not in it
        held = [50 * values[2:4], [0.02 * values[1]], values[7:] / LENS_SIGMA[: len(values) - 7]]
        return np.concatenate([one - np.mean(one) for one in off(np.array([0.0, *values[1:]]), alone)] + held)

    shaped = optimize.least_squares(shape, start, loss="soft_l1", x_scale=scale).x
    best: dict[tuple[int, ...], tuple[float, FloatArray]] = {}
    for across in np.arange(-ACROSS_MAX_MM, ACROSS_MAX_MM, ACROSS_STEP_MM):
        means = np.array(
            [float(np.mean(one)) for one in off(np.array([across, *shaped[1:6], 0.0, *shaped[7:]]), alone)]
        )
        steps = (means - means[0]) / (2 * np.pi)
        orders, apart = tuple(int(one) for one in np.round(steps)), float(np.std(steps - np.round(steps)))
        if orders not in best or apart < best[orders][0]:
            best[orders] = apart, np.array([across, *shaped[1:6], means[0], *shaped[7:]])
    likely = sorted(best.items(), key=lambda one: one[1][0])[:ORDERS_TRIED]
    ranked = sorted((_explained(off, alone, orders, start) for orders, (_, start) in likely), key=lambda one: one[0])
    every = range(len(plates))

    def joined(values: FloatArray) -> tuple[float, FloatArray]:
        orders = [round(float(np.median(one)) / (2 * np.pi)) for one in off(values, every)]
        return _explained(off, every, orders, values)

    doubtful = len(ranked) > 1 and ranked[1][0] < BEATEN * ranked[0][0]
    if doubtful and len(alone) < len(plates):  # other cameras look from elsewhere, and may decide
        ranked = sorted((joined(values) for _, values in ranked[:ORDERS_JOINED]), key=lambda one: one[0])
    misfit, values = ranked[0]
    if misfit > STILL_RAD:
        raise AnnulusError(
            f"no one slide of stripes explains the reference frames: the best is {misfit:.2f} rad off. Expected a "
            "flat plate across the camera's axis, at the heights and the distance told"
        )
    if len(ranked) > 1 and ranked[1][0] < BEATEN * misfit:
        raise AnnulusError(
            f"the reference frames leave the fringes' order open ({misfit:.3f} and {ranked[1][0]:.3f} rad off): add "
            "heights nearer to one another, or of uneven spacing"
        )
    misfit, values = joined(values)
    if misfit > STILL_RAD:
        raise AnnulusError(
            f"one camera's frames show a slide of stripes, all cameras' do not: {misfit:.2f} rad off. Expected the "
            "plate at the distance told, and the cameras as the calibration has them"
        )
    return values


def _explained(
    off: Callable[[FloatArray, Sequence[int]], list[FloatArray]],
    which: Sequence[int],
    orders: Sequence[int],
    start: FloatArray,
) -> tuple[float, FloatArray]:
    """The rms misfit, rad, and the numbers of `start` with these orders."""

    def rest(values: FloatArray) -> FloatArray:
        frames = zip(off(values, which), orders, strict=True)
        held = np.concatenate([5 * values[2:4], values[7:] / LENS_SIGMA[: len(values) - 7]])
        return np.concatenate([one[::7] - 2 * np.pi * k for one, k in frames] + [held])

    found = optimize.least_squares(rest, start, loss="soft_l1", x_scale=SCALE[: len(start)], max_nfev=40)
    return float(np.sqrt(np.mean(rest(found.x)[: 5 - len(start)] ** 2))), found.x


def _tiles(plate: ReferencePlate, slide: FringeProjector) -> tuple[_Tiles, FloatArray]:
    """Tiles of a frame against a projector: their phase, and (T, 2 + 2 (HARMONICS_MAX - 1)) level, swing, and the
    harmonics over the swing."""
    height, width = plate.light.shape
    v, u = np.mgrid[0:height, 0:width]
    whole = slide.phase(_points(plate, u.ravel().astype(float), v.ravel().astype(float))).reshape(height, width)
    rate = np.hypot(np.gradient(whole, axis=0), np.gradient(whole, axis=1))
    size = max(math.ceil(TILE_PERIODS * 2 * np.pi / float(np.median(rate[np.isfinite(rate)]))), 8)
    y, x = np.mgrid[0:size, 0:size] / size - 0.5
    x, y = x.ravel(), y.ravel()
    rows: list[list[float]] = []
    waves: list[FloatArray] = []
    brightest = float(np.nanpercentile(plate.light, 99))
    for top, left in itertools.product(range(0, height - size + 1, size), range(0, width - size + 1, size)):
        light = plate.light[top : top + size, left : left + size].ravel().astype(float)
        phase = whole[top : top + size, left : left + size].ravel()
        if not np.isfinite(light + phase).all() or light.mean() < LIT * brightest:
            continue
        c, s = np.cos(phase), np.sin(phase)
        higher = [f(k * phase) for k in range(2, HARMONICS_MAX + 1) for f in (np.cos, np.sin)]
        matrix = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y, c, x * c, y * c, s, x * s, y * s, *higher], 1)
        inverse = np.linalg.pinv(matrix.T @ matrix)
        k = inverse @ (matrix.T @ light)
        swing = math.hypot(k[6], k[9])
        rest = light - matrix @ k
        sigma = math.sqrt(float(rest @ rest) / (len(light) - len(k)) * inverse[9, 9]) / max(swing, 1e-9)
        if swing < MODULATION_MIN * k[0]:
            continue
        ahead = math.atan2(-k[9], k[6])  # the light is at phase + ahead; turned back, its harmonics are the wave's own
        turned = [
            part
            for n, (even, odd) in enumerate(zip(k[12::2], k[13::2], strict=True), start=2)
            for part in (
                even * math.cos(n * ahead) - odd * math.sin(n * ahead),
                even * math.sin(n * ahead) + odd * math.cos(n * ahead),
            )
        ]
        middle = (left + (size - 1) / 2, top + (size - 1) / 2)
        rows.append([*middle, ahead, 1 / max(sigma, 1e-4) ** 2])
        waves.append(np.array([k[0], swing, *(np.array(turned) / swing)]))
    if len(rows) < TILES_MIN:
        raise AnnulusError(
            f"{plate.where}: {len(rows)} tiles of {size} px show fringes that fit, expected {TILES_MIN}: a plain plate "
            "lit by the slide, not saturated"
        )
    cu, cv, ahead_rad, weight = np.array(rows).T
    phase = slide.phase(_points(plate, cu, cv)) + ahead_rad
    return _Tiles(cu, cv, phase, weight), np.array(waves)


def _fit(
    plates: Sequence[ReferencePlate], tiles: list[_Tiles], start: FloatArray
) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """The numbers of `start`, their covariance as the tiles' scatter says, and what is left of each frame's tiles,
    rad."""
    points = [_points(one, part.u, part.v) for one, part in zip(plates, tiles, strict=True)]
    every, phase = np.concatenate(points), np.concatenate([one.phase for one in tiles])
    weight = np.ones(len(phase))

    def rest(values: FloatArray) -> FloatArray:
        off = phase - _projector(values).phase(every)
        off -= 2 * np.pi * np.round(np.median(off) / (2 * np.pi))  # phase0 is written within one turn
        held = values[7:] / LENS_SIGMA[: len(values) - 7] * HELD_RAD
        return np.concatenate([np.sqrt(weight) * off, held])

    values, jacobian = start, np.empty((0, 0))
    for _ in range(ROUNDS):
        found = optimize.least_squares(rest, values, x_scale=SCALE[: len(start)], xtol=1e-14, ftol=1e-14)
        values, jacobian = found.x, found.jac
        off = rest(values)[: len(phase)] / np.sqrt(weight)
        weight = cauchy(off / max(CAUCHY * robust_sigma(off), 1e-9))
    off = rest(values)[: len(phase)] / np.sqrt(weight)
    scatter = float((weight * off**2).sum() / (weight.sum() - len(start)))
    ends: IntArray = np.cumsum([len(one.u) for one in tiles])
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * scatter
    return values, np.asarray(covariance, dtype=np.float64), np.split(off, ends[:-1])


_Fit = tuple[FloatArray, FloatArray, list[FloatArray]]  # as `_fit` gives it


def _stands_out(straight: list[FloatArray], bent: _Fit) -> bool:
    """Whether the frames show a lens: they are explained better with it, and by more than its noise."""
    values, covariance, left = bent
    lens, own = values[8:], covariance[8:, 8:]
    gain = robust_sigma(np.concatenate(straight)) ** 2 - robust_sigma(np.concatenate(left)) ** 2
    return gain > BENT_RAD**2 and float(lens @ np.linalg.solve(own, lens)) > SIGNIFICANT**2 * len(lens)


def _barrel(plates: Sequence[ReferencePlate], tiles: list[_Tiles], bent: _Fit) -> tuple[float, float, float]:
    """What the lens takes of the tangent at the edge of the light, its sigma, and the tangent there."""
    slide = _projector(bent[0])
    points = np.concatenate([_points(one, part.u, part.v) for one, part in zip(plates, tiles, strict=True)])
    own = (points - np.array(slide.centre_mm)) @ np.array(slide.rotation).T
    edge = float(np.percentile(np.hypot(own[:, 0], own[:, 1]) / own[:, 2], EDGE_PERCENT))
    way = np.array([edge**2, edge**4])
    return float(way @ bent[0][8:10]), float(np.sqrt(way @ bent[1][8:10, 8:10] @ way)), edge


def _waveform(waves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(2k,) harmonics over the first's amplitude, and the sigma of their mean over the tiles."""
    middle = np.median(waves[:, 2:], axis=0)
    sigma = np.array([robust_sigma(column - at) for column, at in zip(waves[:, 2:].T, middle, strict=True)])
    return middle, np.sqrt(np.pi / 2 / len(waves)) * sigma


def _significant(harmonics: FloatArray, sigma: FloatArray) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Harmonics up to the last that stands out of its noise; weaker ones before it stay as they were found."""
    pairs = (np.abs(harmonics) > SIGNIFICANT * np.maximum(sigma, 1e-4)).reshape(-1, 2).any(axis=1)
    last = 2 * (int(np.flatnonzero(pairs)[-1]) + 1) if pairs.any() else 0
    return tuple(float(one) for one in harmonics[:last]), tuple(float(one) for one in sigma[:last])


def _gamma(waves: FloatArray, harmonics: FloatArray, sigma: FloatArray) -> tuple[float, float, float]:
    """The modulation, and the gamma g for which (1 + m cos)^g has this even second harmonic, with its sigma: to the
    second order of m, c2 = (g - 1) m / 4, where g m is the modulation seen."""
    seen = float(np.median(waves[:, 1] / waves[:, 0]))
    c2 = float(harmonics[0])
    per = 4 / seen  # g - 1 = 4 c2 / m, m = seen / g
    return seen, 1 / (1 - per * c2) if abs(per * c2) < 0.8 else math.nan, per * float(sigma[0])
