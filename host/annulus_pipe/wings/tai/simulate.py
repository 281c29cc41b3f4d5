"""A sweep that nobody had to shoot: a phantom, the code as the controller sends it, sound, receiver, noise."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.link.codes import pattern, text
from annulus_pipe.numeric.late import fft, interpolate
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.acoustic_file import AcousticRecord
from annulus_pipe.wings.tai.measure.field import PML_CELLS, Medium, Solver, SoundGrid, receivers
from annulus_pipe.wings.tai.measure.imaging import TAIL
from annulus_pipe.wings.tai.measure.phantoms import Part, draw, reach_mm

SHIFT_MM = (0.0313, 0.0171)  # the sample lies off the cells, so that no image is made on the grid of its own truth


@dataclass(frozen=True, slots=True)
class Setup:
    """What a simulated shot takes. Amplitudes: one chip on a part of value 1 raises its pressure by `pulse_pa`."""

    code: str = "single"
    chip_s: float = 0.5e-6
    radius_mm: float = 25.0
    positions: int = 50
    sampling_rate_hz: float = 25e6
    sound_speed_m_s: float = 1480.0
    pulse_pa: float = 1.0
    noise_pa: float = 0.0  # rms of one shot
    averages: int = 1
    transducer: tuple[float, float] | None = (2.25e6, 0.7)  # centre, width at -6 dB; None hears everything
    aperture_mm: float = 0.0  # width of the receiver's face
    spike_pa: float = 0.0  # coupling of the microwave pulse into the receiver
    seed: int = 1


def simulate(
    parts: tuple[Part, ...], setup: Setup, progress: Callable[[str, int, int], None] | None = None
) -> AcousticRecord:
    """One turn of the turntable about `parts`. Sample 0 is taken at the start of chip 0."""
    chips = pattern(setup.code)
    if reach_mm(parts) > 0.95 * setup.radius_mm:
        raise AnnulusError(f"a sample of {reach_mm(parts):.1f} mm does not fit receivers at {setup.radius_mm:g} mm")
    if not 3 <= setup.positions <= 1024:
        raise AnnulusError(f"{setup.positions} positions, expected 3..1024")
    highest = min(setup.sampling_rate_hz / 2, 3.2 / setup.chip_s)
    if setup.transducer:
        highest = min(highest, setup.transducer[0] * (1 + setup.transducer[1]))
    dx = max(setup.sound_speed_m_s * 1e3 / (2.4 * highest), setup.radius_mm / 400)
    side = fft.next_fast_len(math.ceil(2 * setup.radius_mm / dx) + 2 * PML_CELLS + 12, real=True)
    grid = SoundGrid((side, side), dx)
    solver = Solver(grid, Medium(setup.sound_speed_m_s))
    sent = len(chips) * setup.chip_s
    steps = math.ceil((TAIL * 2e-3 * setup.radius_mm / setup.sound_speed_m_s + sent) / solver.dt_s)
    ears = receivers(grid, _faces(setup) - np.array(SHIFT_MM))
    rise = draw(parts, grid, SHIFT_MM) * setup.pulse_pa / setup.chip_s
    heard = solver.forward(
        rise,
        ears,
        steps,
        _envelope(chips, setup.chip_s, solver.dt_s),
        (lambda done, of: progress("sound", done, of)) if progress else None,
    )
    if progress:
        progress("sound", 1, 1)
    samples = math.floor((steps - 1) * solver.dt_s * setup.sampling_rate_hz)
    signals = _sampled(heard, solver.dt_s, setup.sampling_rate_hz, samples)
    signals += coupling(setup, chips, samples)
    signals = through(signals, setup)
    rng = np.random.default_rng(setup.seed)
    signals += setup.noise_pa / math.sqrt(setup.averages) * rng.standard_normal(signals.shape)
    angles = np.arange(setup.positions, dtype=np.float64) * (360.0 / setup.positions)
    return AcousticRecord(
        signals.astype(np.float32),
        angles,
        setup.radius_mm,
        setup.sampling_rate_hz,
        0.0,
        setup.sound_speed_m_s,
        text(chips),
        setup.chip_s,
        setup.averages,
        {"source": "annulus tai simulate", "seed": float(setup.seed), "sound": "plane"},
    )


def _faces(setup: Setup) -> NDArray[np.float64]:
    """(positions, points, 2) mm: each face a chord that looks at the centre."""
    turn = np.arange(setup.positions) * (2 * math.pi / setup.positions)
    out = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    along = np.stack([-np.sin(turn), np.cos(turn)], axis=1)
    points = 1 if setup.aperture_mm == 0 else 15
    offset = (np.arange(points) - (points - 1) / 2) / max(points, 1) * setup.aperture_mm
    return np.asarray(setup.radius_mm * out[:, None, :] + offset[None, :, None] * along[:, None, :])


def _envelope(chips: NDArray[np.uint8], chip_s: float, dt_s: float) -> NDArray[np.float64]:
    """Mean of the on/off power over each step of the solver."""
    edges = np.arange(math.ceil(len(chips) * chip_s / dt_s) + 1) * dt_s
    energy = np.interp(edges, np.arange(len(chips) + 1) * chip_s, np.concatenate([[0.0], np.cumsum(chips)]) * chip_s)
    return np.asarray(np.diff(energy) / dt_s)


def _sampled(heard: NDArray[np.floating], dt_s: float, rate_hz: float, samples: int) -> NDArray[np.float64]:

    times = np.arange(heard.shape[1]) * dt_s
    return np.asarray(interpolate.CubicSpline(times, heard, axis=1)(np.arange(samples) / rate_hz), np.float64)


def coupling(setup: Setup, chips: NDArray[np.uint8], samples: int) -> NDArray[np.float64]:
    """Follows every chip at once, and leaves the amplifier to recover within a microsecond."""
    times = np.arange(samples) / setup.sampling_rate_hz
    on = np.interp(times, (np.arange(len(chips)) + 0.5) * setup.chip_s, chips, left=0.0, right=0.0)
    recovery = np.exp(-times / 0.4e-6)
    out = np.convolve(on, recovery)[:samples] / max(float(recovery.sum()), 1e-12)
    return np.asarray(setup.spike_pa * out)


def through(signals: NDArray[np.float64], setup: Setup) -> NDArray[np.float64]:
    """The transducer's band, without delay."""
    if setup.transducer is None:
        return signals
    from annulus_pipe.wings.tai.measure.templates import Transducer

    receiver = Transducer.band(*setup.transducer, setup.sampling_rate_hz)
    length = fft.next_fast_len(signals.shape[1] + len(receiver.response), real=True)
    spectrum = np.abs(fft.rfft(receiver.response, length))
    return np.asarray(fft.irfft(fft.rfft(signals, length, axis=1) * (spectrum / spectrum.max()), length, axis=1))[
        :, : signals.shape[1]
    ]
