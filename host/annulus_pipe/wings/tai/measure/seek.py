"""What of a plate's sound is a defect: a regularised image, places with their sigma, and plain time reversal beside.

A sound plate sounds alike everywhere, but for the beam: that common part is taken from the data, not from a model. What
is left is explained place by place, strongest first, by boxes of one kind and depth; all are fitted anew together. A
place counts if noise would not show it (LEAST_SIGMA) and neither would the model's own error: REST of what is explained
already where it lies. What is neither is not listed; a place whose kind the data do not decide is of
unknown kind. What lies above or below a listed place is not looked for.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import fft
from annulus_pipe.wings.tai.measure.budget import AIR_SPEED
from annulus_pipe.wings.tai.measure.layered import KINDS, STEP_MM, ComplexArray, PlateModel

LEAST_SIGMA = 6.5  # of a place's amplitude: 1e4 places are tried a plate. Guard: false places, topic single_sided
REST = 0.12  # of explained energy that the model may have wrong there (correlation .97: 6 %). Guard: the same
REST_ALL = 0.06  # of the strongest place's energy, anywhere in the plate: what it sends sideways. Guard: the same
STRENGTH_MAX = (1.4, 10.0)  # of a delamination, of water: parted is parted, but for the rig's and laminate's tolerance
REST_SOUND = 0.05  # of the sound plate's own energy, which is the data's own. Guard: the same
DECIDED = 0.85  # of a place's energy: the other kind explains less, or the kind is unknown. Guard: the same
PLACES_MAX = 6
WIDTHS_MM = (6.0, 10.0, 14.0, 20.0, 28.0, 40.0)
STEPS = 150  # of FISTA at one strength of regularisation; three strengths a decade
MODEL_REST = 0.1  # of the data's norm: what the image need not explain, beside noise
FLOOR_MM = (0.5, 1.0, 2.0)  # model's own error of x, depth, width, in sigma beside noise's. Guard: topic single_sided


@dataclass(frozen=True, slots=True)
class FoundPlace:
    """`kind` None: both kinds explain it alike. `strength` : 1 is a whole delamination, or 1 mm of water under the
    rig's power. `sigmas` : the strength over its own noise."""

    kind: str | None
    x_mm: float
    depth_mm: float
    wide_mm: float
    strength: float
    sigmas: float
    x_sigma_mm: float
    depth_sigma_mm: float
    wide_sigma_mm: float


@dataclass(frozen=True, eq=False)
class PlateAnswer:
    """`image` (kinds, depths, receivers), strengths; `misfit` : rms of what it leaves, over noise."""

    image: FloatArray
    misfit: float
    places: tuple[FoundPlace, ...]
    time_reversed: FloatArray  # (depths, receivers), envelope


@dataclass(frozen=True, slots=True)
class _Box:
    kind: int
    depth_mm: float
    x_mm: float
    wide_mm: float


def sound_part(model: PlateModel, data: ComplexArray) -> ComplexArray:
    """(receivers, bins): what every receiver hears alike, by the beam: a median, which defects do not move.

    The beam's place and width are then taken from the data too, as a parabola of the logarithm.
    """
    beam = model.beam
    common = np.zeros(data.shape[1], complex)
    for _ in range(3):
        scaled = data / beam[:, None]
        common = np.median(scaled.real, axis=0) + 1j * np.median(scaled.imag, axis=0)
        own = (data @ common.conj()).real / float(np.vdot(common, common).real)
        ratio = own / beam
        x = np.linspace(-1, 1, len(beam))
        fit = np.ones(len(x))
        kept = np.ones(len(x), bool)
        for _ in range(4):
            fit = np.asarray(np.polyval(np.polyfit(x[kept], ratio[kept], 2), x), float)
            off = np.abs(ratio - fit)
            kept = off <= 2.5 * max(float(np.median(off)), 1e-9)
        beam = beam * np.clip(fit, 0.5, 2.0)
    return np.asarray(beam[:, None] * common)


def noise_shape(model: PlateModel) -> ComplexArray:
    """(bins, bins) covariance of one receiver's bins for white noise of rms 1 a sample: damping ties neighbours."""
    impulses = np.eye(model.samples)
    seen = model.damped(impulses)
    return np.asarray(seen.T @ seen.conj())


def regularised(model: PlateModel, data: ComplexArray, sigma: float) -> tuple[FloatArray, float]:
    """FISTA (Beck and Teboulle, SIAM J. Imaging Sci. 2 (2009) 183): least squares plus the sum of |strength| times its
    column's norm, none negative; weakened until the rest is that of the noise (discrepancy principle).

    sigma : of one bin. Returns the image, and the rest's rms over sigma.
    """
    weight = np.sqrt(np.einsum("czfk->cz", np.abs(model.kernel) ** 2) / model.padded)[:, :, None]
    scaled = model.beam.mean() * weight
    image = np.zeros((len(KINDS), len(model.depths_mm), model.count))
    probe = np.random.default_rng(1).normal(size=image.shape)
    largest = 1.0
    for _ in range(12):
        probe = model.adjoint(model.forward(probe / scaled)) / scaled
        largest = float(np.linalg.norm(probe))
        probe /= largest
    step = 1 / (1.05 * largest)
    allowed = data.size * sigma**2 + (MODEL_REST * float(np.linalg.norm(data))) ** 2
    strongest = float((model.adjoint(data) / scaled).max())
    strength = 0.5 * strongest
    left = data
    while strength > 0.003 * strongest:
        ahead, turn = image.copy(), 1.0
        for _ in range(STEPS):
            slope = model.adjoint(model.forward(ahead / scaled) - data) / scaled
            moved = np.maximum(ahead - step * (slope + strength), 0.0)
            later = (1 + math.sqrt(1 + 4 * turn**2)) / 2
            ahead = moved + (turn - 1) / later * (moved - image)
            image, turn = moved, later
        left = data - model.forward(image / scaled)
        if float(np.vdot(left, left).real) <= allowed:
            break
        strength *= 0.46
    return image / scaled, float(np.linalg.norm(left)) / (sigma * math.sqrt(left.size))


def places(model: PlateModel, data: ComplexArray, common: ComplexArray, sample_rms: float) -> tuple[FoundPlace, ...]:
    """The defects in what `sound_part` left, strongest first.

    sample_rms : of a decoded trace's noise, a sample.
    """
    covariance = sample_rms**2 * noise_shape(model)
    norms = np.stack(
        [[_norms(model, c, z, w) for w in WIDTHS_MM] for c in range(2) for z in range(len(model.depths_mm))]
    )
    norms = norms.reshape(len(KINDS), len(model.depths_mm), len(WIDTHS_MM))
    boxes: list[_Box] = []
    strengths = np.zeros(0)
    shut: list[tuple[float, float]] = []
    strongest = 0.0
    while len(boxes) < PLACES_MAX:
        left = data - _predicted(model, boxes, strengths)
        box = _strongest(model, left, norms, boxes, shut)
        if box is None:
            break
        box = _refined(model, left, box)
        own = model.forward(_drawn(model, box))
        energy, sigmas = _explained(own, left, covariance)
        there = np.abs(_x(model) - box.x_mm) <= box.wide_mm / 2 + 4.0
        already = _predicted(model, boxes, strengths)[there]
        doubt = REST * float(np.sum(np.abs(already) ** 2)) + REST_SOUND * float(np.sum(np.abs(common[there]) ** 2))
        if sigmas < LEAST_SIGMA:
            break
        if boxes:
            doubt = max(doubt, REST_ALL * strongest)
        strongest = max(strongest, energy)
        if energy < doubt or _behind(box, boxes):
            shut.append((box.x_mm, box.wide_mm / 2 + 4.0))
            if len(shut) > PLACES_MAX:
                break
            continue
        boxes.append(box)
        boxes, strengths = _together(model, data, boxes)
    return tuple(
        _place(model, data, boxes, strengths, n, covariance)
        for n in np.argsort(
            [-s * np.linalg.norm(model.forward(_drawn(model, b))) for s, b in zip(strengths, boxes, strict=True)]
        )
    )


def time_reversal(model: PlateModel, traces: FloatArray) -> FloatArray:
    """Plain time reversal: (depths, receivers), the envelope at the instant of the pulse.

    What was heard runs back through air and a laminate without faces, by its two speeds, and what it makes at time 0 is
    shown (chapter 7's way, with the model that a single-sided reader of it would take).
    """
    lam = model.laminate
    spectrum = fft.fft(fft.rfft(traces, axis=1)[:, model.bins], model.padded, axis=0)
    omega = 2 * math.pi * model.bins * model.rate_hz / model.samples
    k = model.wave_numbers[:, None]
    ratio = math.sqrt(lam.c11_gpa / lam.c33_gpa)
    air = np.sqrt(np.maximum((omega / AIR_SPEED) ** 2 - k**2, 0))
    inside = np.sqrt(np.maximum((omega / lam.speed) ** 2 - (ratio * k) ** 2, 0))
    travels = inside > 0
    back = np.exp(1j * air * 1e-3 * model.rig.standoff_mm) * travels * spectrum
    depth = 1e-3 * model.depths_mm
    focused = np.stack([(back * np.exp(1j * inside * z)).sum(axis=1) for z in depth])
    return np.asarray(np.abs(fft.ifft(focused, axis=1)[:, : model.count]))


def _x(model: PlateModel) -> FloatArray:
    return np.asarray((np.arange(model.count) - (model.count - 1) / 2) * model.pitch_mm)


def _drawn(model: PlateModel, box: _Box) -> FloatArray:
    """The image of a box: parts of cells at its ends, and of two depths where it lies between."""
    image = np.zeros((len(KINDS), len(model.depths_mm), model.count))
    row = np.clip((1.0 - np.abs(model.depths_mm - box.depth_mm) / STEP_MM), 0, 1)
    pitch = model.pitch_mm
    across = np.clip((box.wide_mm / 2 + pitch / 2 - np.abs(_x(model) - box.x_mm)) / pitch, 0, 1)
    across *= min(1.0, box.wide_mm / pitch)
    image[box.kind] = row[:, None] * across
    return image


def _norms(model: PlateModel, kind: int, depth: int, wide_mm: float) -> float:
    """Energy of a box's sound where the beam is 1."""
    k = model.wave_numbers
    cells = wide_mm / model.pitch_mm
    box = cells * np.sinc(k * 1e-3 * wide_mm / (2 * math.pi))
    return float(np.sum(np.abs(model.kernel[kind, depth] * box) ** 2)) / model.padded


def _strongest(
    model: PlateModel, left: ComplexArray, norms: FloatArray, taken: Sequence[_Box], shut: Sequence[tuple[float, float]]
) -> _Box | None:
    """The box that alone explains most of what is left, away from what is shut."""
    back = model.adjoint(left)
    x = _x(model)
    open_ = np.ones(model.count, bool)
    for at, half in shut:
        open_ &= np.abs(x - at) > half
    for box in taken:
        open_ &= np.abs(x - box.x_mm) > box.wide_mm / 2
    best: float = 0.0
    found: _Box | None = None
    for n, wide in enumerate(WIDTHS_MM):
        pitch = model.pitch_mm
        reach = math.ceil(wide / pitch / 2)
        window = np.clip((wide / 2 + pitch / 2 - np.abs(np.arange(-reach, reach + 1) * pitch)) / pitch, 0, 1)
        inside = np.abs(x) + wide / 2 <= x[-1] + pitch
        sums = np.apply_along_axis(np.convolve, 2, back, window, "same")
        beam = np.convolve(model.beam**2, window / window.sum(), "same")
        sizes = norms[:, :, n, None] * beam
        strength = np.clip(sums / sizes, 0.0, np.array(STRENGTH_MAX)[:, None, None])
        gain = (2 * strength * sums - strength**2 * sizes) * (inside & open_)
        most = float(gain.max())
        if most > best:
            row = np.unravel_index(int(gain.argmax()), gain.shape)
            best, found = most, _Box(int(row[0]), float(model.depths_mm[row[1]]), float(x[row[2]]), wide)
    return found


def _gain(model: PlateModel, left: ComplexArray, box: _Box) -> float:
    own = model.forward(_drawn(model, box))
    size = float(np.vdot(own, own).real)
    if size <= 0:
        return 0.0
    along = float(np.vdot(own, left).real)
    strength = min(max(along / size, 0.0), STRENGTH_MAX[box.kind])
    return 2 * strength * along - strength**2 * size


STEPS_MM = ((2.0, 1.0, 4.0), (0.7, 0.4, 1.5))  # of x, depth, width: coarse, then fine


def _refined(model: PlateModel, left: ComplexArray, box: _Box) -> _Box:
    """Place, depth and width moved one after the other while that explains more."""
    best = _gain(model, left, box)
    for steps in STEPS_MM:
        for _ in range(6):
            before = best
            for name, step in zip(("x_mm", "depth_mm", "wide_mm"), steps, strict=True):
                for sign in (1, -1):
                    moved = replace(box, **{name: getattr(box, name) + sign * step})
                    if not _possible(model, moved):
                        continue
                    gain = _gain(model, left, moved)
                    if gain > best * (1 + 1e-6):
                        box, best = moved, gain
                        break
            if best <= before * (1 + 1e-6):
                break
    return box


def _possible(model: PlateModel, box: _Box) -> bool:
    x = _x(model)
    return (
        model.depths_mm[0] <= box.depth_mm <= model.depths_mm[-1]
        and 3.0 <= box.wide_mm <= WIDTHS_MM[-1]
        and x[0] <= box.x_mm <= x[-1]
    )


def _behind(box: _Box, others: Sequence[_Box]) -> bool:
    return any(abs(box.x_mm - other.x_mm) < (box.wide_mm + other.wide_mm) / 2 for other in others)


def _predicted(model: PlateModel, boxes: Sequence[_Box], strengths: FloatArray) -> ComplexArray:
    total = np.zeros((len(KINDS), len(model.depths_mm), model.count))
    for box, strength in zip(boxes, strengths, strict=True):
        total += strength * _drawn(model, box)
    return model.forward(total)


def _together(model: PlateModel, data: ComplexArray, boxes: list[_Box]) -> tuple[list[_Box], FloatArray]:
    """All strengths anew at once; then each box against what the others leave, once more."""
    strengths = _strengths(model, data, boxes)
    if len(boxes) > 1:
        for n in range(len(boxes)):
            others = [box for m, box in enumerate(boxes) if m != n]
            left = data - _predicted(model, others, np.delete(strengths, n))
            moved = _refined(model, left, boxes[n])
            boxes[n] = boxes[n] if _behind(moved, others) else moved
            strengths = _strengths(model, data, boxes)
    return boxes, strengths


def _strengths(model: PlateModel, data: ComplexArray, boxes: Sequence[_Box]) -> FloatArray:
    columns = np.stack([model.forward(_drawn(model, box)).ravel() for box in boxes], axis=1)
    gram, right = (columns.conj().T @ columns).real, (columns.conj().T @ data.ravel()).real
    return np.asarray(np.linalg.lstsq(gram, right, rcond=1e-9)[0])


def _explained(own: ComplexArray, left: ComplexArray, covariance: ComplexArray) -> tuple[float, float]:
    """Energy that a box takes away, and its strength over the strength's noise."""
    along = float(np.vdot(own, left).real)
    spread = math.sqrt(max(0.5 * float(np.einsum("rf,fg,rg->", own.conj(), covariance, own).real), 1e-300))
    return max(along, 0.0) ** 2 / float(np.vdot(own, own).real), along / spread


def _place(
    model: PlateModel,
    data: ComplexArray,
    boxes: Sequence[_Box],
    strengths: FloatArray,
    n: int,
    covariance: ComplexArray,
) -> FoundPlace:
    box = boxes[n]
    left = data - _predicted(model, [b for m, b in enumerate(boxes) if m != n], np.delete(strengths, n))
    own = model.forward(_drawn(model, box))
    energy, sigmas = _explained(own, left, covariance)
    rival = max(
        _gain(model, left, _refined(model, left, replace(box, kind=1 - box.kind, depth_mm=float(depth))))
        for depth in np.clip(box.depth_mm + np.array([-2.0, 0.0, 2.0]), model.depths_mm[0], model.depths_mm[-1])
    )
    sigma = []
    for name, step, floor in zip(("x_mm", "depth_mm", "wide_mm"), (1.0, 0.5, 2.0), FLOOR_MM, strict=True):
        sides = [
            model.forward(_drawn(model, replace(box, **{name: getattr(box, name) + sign * step}))) for sign in (1, -1)
        ]
        slope = strengths[n] * (sides[0] - sides[1]) / (2 * step)
        size = float(np.vdot(own, own).real)
        slope = slope - own * (np.vdot(own, slope).real / size)
        noise = 0.5 * float(np.einsum("rf,fg,rg->", slope.conj(), covariance, slope).real)
        sigma.append(math.hypot(math.sqrt(noise) / max(float(np.vdot(slope, slope).real), 1e-300), floor))
    kind = KINDS[box.kind] if rival < DECIDED * energy else None
    return FoundPlace(
        kind, box.x_mm, box.depth_mm, box.wide_mm, float(strengths[n]), sigmas, sigma[0], sigma[1], sigma[2]
    )
