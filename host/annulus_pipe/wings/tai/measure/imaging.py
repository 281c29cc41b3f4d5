"""From the pressure on a circle to the source inside it: time reversal and back-projection."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.late import fft, interpolate
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.field import PML_CELLS, Medium, Solver, SoundGrid, receivers, rim, time_step_s
from annulus_pipe.wings.tai.measure.sweep import Sweep, gaps_deg

# Guards: topic imaging, and of tests/wings/tai/test_imaging.py what is named.
GRID_MAX = 1024  # cells a side; a finer pixel is refused, it would take an hour. Guard: test_bad_input_is_one_line
GRID_USUAL = 400  # cells across the circle if nobody asks for more: a minute. Unguarded: patience
# The next three make the pixel of a sweep. Guarded loosely, by test_bad_input_is_one_line (0.1 to 0.6 mm).
CELLS_PER_WAVE = 2.4  # of the highest frequency that matters
ENERGY = 0.99  # of the sound lies below that frequency
ABOVE_NOISE = 4.0  # times the power per frequency at the upper end of the record
# Of the last misfit: a refinement comes below it or is not kept. Guard: test_refinement_that_does_not_help_is_not_kept.
WORTH = 0.98
OUTSIDE = "the region lies outside the circle of receivers, or is narrower than two pixels"
TAIL = 1.15  # times the way across: sound in a plane has a tail. Topic imaging

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class AcousticImage:
    """`values` [y, x] in the unit of the signals; NaN outside the circle of receivers."""

    values: NDArray[np.float32]
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    method: str
    sound_speed_m_s: float
    misfit: tuple[float, ...] = ()  # relative, of the data after each refinement


@dataclass(frozen=True, slots=True)
class Region:
    """What of the plane is looked at: x0..x1, y0..y1, mm."""

    x0_mm: float
    x1_mm: float
    y0_mm: float
    y1_mm: float

    def __post_init__(self) -> None:
        if not (-1e4 < self.x0_mm < self.x1_mm < 1e4 and -1e4 < self.y0_mm < self.y1_mm < 1e4):
            raise AnnulusError(
                f"a region of x {self.x0_mm:g}..{self.x1_mm:g}, y {self.y0_mm:g}..{self.y1_mm:g} mm: expected to rise"
            )

    @classmethod
    def about_axis(cls, half_mm: float) -> "Region":
        return cls(-half_mm, half_mm, -half_mm, half_mm)

    def axes_mm(self, dx_mm: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(x, y) of its pixels, which stand at whole numbers of dx from the axis."""
        x, y = (
            np.arange(math.ceil(low / dx_mm - 1e-9), math.floor(high / dx_mm + 1e-9) + 1) * dx_mm
            for low, high in ((self.x0_mm, self.x1_mm), (self.y0_mm, self.y1_mm))
        )
        return np.asarray(x, np.float64), np.asarray(y, np.float64)

    def grid_mm(self, dx_mm: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(ny, nx) x and y of every pixel."""
        x, y = self.axes_mm(dx_mm)
        return np.broadcast_to(x, (len(y), len(x))), np.broadcast_to(y[:, None], (len(y), len(x)))


def pixel_mm(sweep: Sweep) -> float:
    """The pixel that the sweep's band asks for, but no more than GRID_USUAL of them across the circle.

    The band ends where the smoothed spectrum sinks into the noise of the recorder, or holds ENERGY of the sound.
    """
    rest = sweep.signals - sweep.signals.mean(axis=1, keepdims=True)
    spectrum = (np.abs(fft.rfft(rest, axis=1)) ** 2).mean(axis=0)
    width = max(len(spectrum) // 64, 1)
    smooth = np.convolve(spectrum, np.full(width, 1 / width), mode="same")
    sound = np.where(smooth > ABOVE_NOISE * float(np.median(smooth[3 * len(smooth) // 4 :])), spectrum, 0.0)
    below = np.cumsum(sound)
    highest = int(np.searchsorted(below, ENERGY * below[-1])) if below[-1] > 0 else len(spectrum) // 4
    frequency = max(highest, 1) * sweep.sampling_rate_hz / sweep.signals.shape[1]
    wanted = 1e3 * sweep.sound_speed_m_s / (CELLS_PER_WAVE * frequency)
    return float(np.clip(wanted, 2 * sweep.radius_mm / GRID_USUAL, sweep.radius_mm / 40))


def time_reversal(
    sweep: Sweep,
    *,
    pixel: float | None = None,
    region: Region | None = None,
    refinements: int = 0,
    nonnegative: bool = False,
    progress: Progress | None = None,
) -> AcousticImage:
    """Initial pressure by re-emission from the full circle, missing positions interpolated (Alzuhiri 2022, §8.3).

    Parameters
    ----------
    pixel : mm, default `pixel_mm(sweep)`.
    region : what is kept of the image; it is the same image, cut out. Default the whole circle.
    refinements : Neumann iterations, at most: what the image would have sounded like at the measured positions is
        compared with what was heard, and the difference reversed in turn. Makes up for holes in the circle; one that
        does not bring the data nearer is not kept.
    nonnegative : during refinement; absorbed power cannot be negative. Not for band-limited data.

    Nothing is interpolated across a hole of the circle (`sweep.gaps_deg`): there nothing is emitted.
    """
    if len(sweep.signals) < 3:
        raise AnnulusError(f"{len(sweep.signals)} usable positions, expected at least 3 for an image")
    dx = pixel_mm(sweep) if pixel is None else pixel
    if dx < _least_pixel(sweep):
        raise AnnulusError(
            f"a pixel of {dx:g} mm makes more than {GRID_MAX} cells across {2 * sweep.radius_mm:g} mm, "
            f"expected at least {_least_pixel(sweep):.3g} mm"
        )
    side = fft.next_fast_len(math.ceil(2 * sweep.radius_mm / dx) + 2 * PML_CELLS + 8, real=True)
    grid, medium = SoundGrid((side, side), dx), Medium(sweep.sound_speed_m_s)
    solver = Solver(grid, medium, time_step_s(grid, medium))
    steps = math.ceil(TAIL * 2 * sweep.radius_mm * 1e-3 / sweep.sound_speed_m_s / solver.dt_s) + 1
    heard = _resampled(sweep, solver.dt_s, steps)
    cells, angles = rim(grid, sweep.radius_mm)
    order = np.argsort(np.mod(sweep.angles_deg, 360.0), kind="stable")
    turn = np.mod(sweep.angles_deg, 360.0)[order]
    spoken = ~_in_hole(np.degrees(angles), gaps_deg(turn))
    cells, angles = cells[spoken], angles[spoken]
    ears = receivers(grid, sweep.positions_mm)
    inside = np.hypot(*np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")) < sweep.radius_mm - dx
    total = 2 * refinements + 1

    def counted(n: int) -> Callable[[int, int], None]:
        return lambda done, of: progress("imaging", n * of + done, total * of) if progress else None

    def emitted(traces: NDArray[np.float64], n: int) -> NDArray[np.floating]:
        return solver.reverse(_onto_rim(traces[order], turn, np.degrees(angles)), cells, counted(n))

    estimate = np.where(inside, emitted(heard, 0), 0.0)  # Eq. 7.19
    misfit: list[float] = []
    last = estimate
    for n in range(refinements):
        rest = heard - solver.forward(estimate, ears, steps, progress=counted(2 * n + 1))
        misfit.append(float(np.linalg.norm(rest) / max(float(np.linalg.norm(heard)), 1e-300)))
        if n and misfit[-1] > WORTH * misfit[-2]:
            estimate = last  # what is left does not come from inside: more would only draw noise
            break
        last = estimate
        estimate = np.where(inside, estimate + emitted(rest, 2 * n + 2), 0.0)
        if nonnegative:
            estimate = np.maximum(estimate, 0.0)
    if progress:
        progress("imaging", 1, 1)
    name = "time reversal" + (f", {len(misfit)} refinements" if misfit else "")
    part = Region.about_axis(sweep.radius_mm) if region is None else region
    return _cropped(
        AcousticImage(
            np.where(inside, estimate, np.nan), grid.x_mm, grid.y_mm, name, sweep.sound_speed_m_s, tuple(misfit)
        ),
        part,
    )


def back_projection(sweep: Sweep, *, pixel: float | None = None, region: Region | None = None) -> AcousticImage:
    """A quick look: universal back-projection, b = 2 (p - t dp/dt) (Xu and Wang, Phys. Rev. E 71, 2005).

    Each position counts with the arc that it stands for. Only `region` is worked out; default the whole circle.
    """
    dx = pixel_mm(sweep) if pixel is None else pixel
    part = Region.about_axis(sweep.radius_mm) if region is None else region
    x, y = part.grid_mm(dx)
    inside = np.hypot(x, y) < sweep.radius_mm
    if not inside.any():
        raise AnnulusError(OUTSIDE)
    times, weights = sweep.times_s, arcs(sweep.angles_deg)
    total = np.zeros(np.count_nonzero(inside))
    for (px, py), trace, arc in zip(sweep.positions_mm, source_term(sweep), weights, strict=True):
        way = np.hypot(x[inside] - px, y[inside] - py) * 1e-3 / sweep.sound_speed_m_s
        total += arc * np.interp(way, times, trace, left=0.0, right=0.0)
    values = np.full(x.shape, np.nan, np.float32)
    values[inside] = total / weights.sum()
    return AcousticImage(values, *part.axes_mm(dx), "universal back-projection", sweep.sound_speed_m_s)


def source_term(sweep: Sweep) -> NDArray[np.float64]:
    """(positions, samples) what back-projection lays onto the arcs: 2 (p - t dp/dt)."""
    slope = np.gradient(sweep.signals, 1.0 / sweep.sampling_rate_hz, axis=1)
    return np.asarray(2.0 * (sweep.signals - sweep.times_s * slope))


def _least_pixel(sweep: Sweep) -> float:
    return 2 * sweep.radius_mm / (GRID_MAX - 2 * PML_CELLS - 8)


def _resampled(sweep: Sweep, dt_s: float, steps: int) -> NDArray[np.float64]:
    """Traces on the solver's clock from time 0; zero where nothing was recorded. No wave shorter than two cells."""
    signals = sweep.signals
    if dt_s * sweep.sampling_rate_hz > 1.0:  # fewer samples than there are: what lies above must not fold back
        spectrum = fft.rfft(signals, axis=1)
        frequency = fft.rfftfreq(signals.shape[1], 1 / sweep.sampling_rate_hz)
        spectrum *= 0.5 - 0.5 * np.cos(math.pi * np.clip((0.5 / dt_s - frequency) / (0.1 / dt_s), 0.0, 1.0))
        signals = fft.irfft(spectrum, n=signals.shape[1], axis=1)
    at = np.arange(steps) * dt_s
    times = sweep.times_s
    out = np.zeros((len(signals), steps))
    held = (at >= times[0]) & (at <= times[-1])
    if np.count_nonzero(held) < 16:
        raise AnnulusError(
            f"the record covers {1e6 * times[0]:.2f}..{1e6 * times[-1]:.2f} us, none of the {1e6 * at[-1]:.1f} us "
            "in which sound from inside the circle arrives: check t0, sampling rate and radius"
        )
    out[:, held] = interpolate.CubicSpline(times, signals, axis=1)(at[held])
    return out


def _onto_rim(
    traces: NDArray[np.float64], turn_deg: NDArray[np.float64], rim_deg: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Between positions by a periodic cubic spline over the angle; equal angles are averaged."""
    angles, first, count = np.unique(turn_deg, return_index=True, return_counts=True)
    values = np.add.reduceat(traces, first, axis=0) / count[:, None]
    around = np.append(angles, angles[0] + 360.0)
    spline = interpolate.CubicSpline(around, np.vstack([values, values[:1]]), axis=0, bc_type="periodic")
    return np.asarray(spline(np.mod(rim_deg - angles[0], 360.0) + angles[0]))


def _in_hole(angles_deg: NDArray[np.float64], holes: list[tuple[float, float]]) -> NDArray[np.bool_]:
    inside = np.zeros(len(angles_deg), bool)
    for start, stop in holes:
        inside |= (np.mod(angles_deg - start, 360.0) > 0) & (np.mod(angles_deg - start, 360.0) < stop - start)
    return inside


def arcs(angles_deg: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half the way to both neighbours, radians; a hole counts as the usual spacing."""
    turn = np.radians(np.mod(angles_deg, 360.0))
    order = np.argsort(turn, kind="stable")
    step = np.diff(np.append(turn[order], turn[order[0]] + 2 * math.pi))
    step = np.minimum(step, 2.5 * np.median(step)) if len(step) > 2 else step
    arcs = np.empty(len(turn))
    arcs[order] = 0.5 * (step + np.roll(step, 1))
    return arcs


def _cropped(image: AcousticImage, part: Region) -> AcousticImage:
    columns = np.flatnonzero((image.x_mm >= part.x0_mm) & (image.x_mm <= part.x1_mm))
    rows = np.flatnonzero((image.y_mm >= part.y0_mm) & (image.y_mm <= part.y1_mm))
    values = image.values[np.ix_(rows, columns)].astype(np.float32)
    if len(rows) < 2 or len(columns) < 2 or not np.isfinite(values).any():
        raise AnnulusError(OUTSIDE)
    return replace(image, values=values, x_mm=image.x_mm[columns], y_mm=image.y_mm[rows])
