"""Figures 7.4 and 8.4, and resolution: what is lost between a source and its image when nothing is noisy.

Sound is made on a grid finer than the image's and off its cells, so that no image profits from its own grid.
"""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.special import j1

from annulus_pipe.wings.tai.measure.field import PML_CELLS, Medium, Solver, SoundGrid, receivers, rim, time_step_s
from annulus_pipe.wings.tai.measure.imaging import TAIL, AcousticImage, time_reversal
from annulus_pipe.wings.tai.measure.phantoms import Box, Disc, Part, draw, phantom
from annulus_pipe.wings.tai.measure.sweep import Sweep
from tools.study.figure import Figure, FloatArray, profile, show_map

SPEED = 1500.0
FINER, SHIFT_MM = 0.8, (0.031, 0.017)
SMOOTH = 1.2  # pixels: edges no sharper than a grid can carry
RADIUS_MM, PIXEL_MM, POSITIONS = 17.0, 0.25, 50


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """A rectangle of receivers' and sample's own, +-x, +-y mm, and the two grids that cover it."""

    x_mm: float
    y_mm: float
    pixel_mm: float

    @property
    def grid(self) -> SoundGrid:
        return self._grid(self.pixel_mm)

    @property
    def finer(self) -> SoundGrid:
        return self._grid(FINER * self.pixel_mm)

    def row(self, y_mm: float) -> NDArray[np.int64]:
        """The image's cells nearest to a line across at y, flat indices."""
        grid = self.grid
        columns = np.flatnonzero(np.abs(grid.x_mm) <= self.x_mm)
        return np.asarray(int(np.argmin(np.abs(grid.y_mm - y_mm))) * grid.shape[1] + columns)

    def column(self, x_mm: float) -> NDArray[np.int64]:
        grid = self.grid
        rows = np.flatnonzero(np.abs(grid.y_mm) <= self.y_mm)
        return np.asarray(rows * grid.shape[1] + int(np.argmin(np.abs(grid.x_mm - x_mm))))

    def points_mm(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        y, x = np.divmod(cells, self.grid.shape[1])
        return np.stack([self.grid.x_mm[x], self.grid.y_mm[y]], axis=1)

    def inside(self) -> tuple[slice, slice]:
        """The part of an image's array that lies in the frame."""
        kept = [
            np.flatnonzero(np.abs(at) <= size)
            for at, size in ((self.grid.y_mm, self.y_mm), (self.grid.x_mm, self.x_mm))
        ]
        return slice(kept[0][0], kept[0][-1] + 1), slice(kept[1][0], kept[1][-1] + 1)

    def _grid(self, dx: float) -> SoundGrid:
        ny, nx = (
            scipy.fft.next_fast_len(math.ceil(2 * size / dx) + 2 * PML_CELLS + 14, real=True)
            for size in (self.y_mm, self.x_mm)
        )
        return SoundGrid((ny, nx), dx)


def drawn(
    parts: tuple[Part, ...], grid: SoundGrid, pixel_mm: float, shift_mm: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.float64]:
    """The sample on a grid, its edges as smooth as an image of `pixel_mm` can show them."""
    return np.asarray(gaussian_filter(draw(parts, grid, shift_mm), SMOOTH * pixel_mm / grid.dx_mm))


def truth_of(parts: tuple[Part, ...], image: AcousticImage) -> NDArray[np.float64]:
    dx = float(image.x_mm[1] - image.x_mm[0])
    return drawn(parts, SoundGrid((len(image.y_mm), len(image.x_mm)), dx), dx)


def quality(found: AcousticImage, truth: NDArray[np.float64], within_mm: float) -> tuple[float, float]:
    """(PSNR in dB with the truth's maximum as M, Eq. 8.21; correlation) inside a circle."""
    y, x = np.meshgrid(found.y_mm, found.x_mm, indexing="ij")
    inside = (np.hypot(x, y) < within_mm) & np.isfinite(found.values)
    a, b = found.values[inside].astype(float), truth[inside]
    error = float(np.mean((a - b) ** 2))
    psnr = 10 * math.log10(float(b.max()) ** 2 / error) if error > 0 else math.inf
    return psnr, float(np.corrcoef(a, b)[0, 1])


def likeness(found: FloatArray, truth: FloatArray) -> float:
    return float(np.corrcoef(found.ravel(), truth.ravel())[0, 1])


# Fig. 7.4


def transducer_orientation(pixel_mm: float = 0.15) -> Figure:
    """A box and a disc heard from a line above, and from an L above and to the left."""
    parts: tuple[Part, ...] = (Box(-3.0, 0.5, 5.0, 4.0, 1.0), Disc(4.5, 0.5, 2.0, 1.0))
    frame = Frame(9.0, 7.0, pixel_mm)
    finer = frame.finer
    dt = time_step_s(finer, Medium(SPEED))
    steps = math.ceil(2e-3 * math.hypot(frame.x_mm, frame.y_mm) / SPEED / dt)
    above, left = frame.row(-frame.y_mm), frame.column(-frame.x_mm)
    cells = np.concatenate([above, left[~np.isin(left, above)]])
    ears = receivers(finer, frame.points_mm(cells) - np.array(SHIFT_MM))
    traces = Solver(finer, Medium(SPEED), dt).forward(drawn(parts, finer, pixel_mm, SHIFT_MM), ears, steps)
    back = Solver(frame.grid, Medium(SPEED), dt)
    window = frame.inside()
    truth = drawn(parts, frame.grid, pixel_mm)[window]
    x, y = frame.grid.x_mm[window[1]], frame.grid.y_mm[window[0]]
    # behind the mouths of the receivers nothing is imaged; "negative pressure is neglected"
    images = [
        np.maximum(back.reverse(traces[:count], cells[:count]), 0.0)[window] for count in (len(above), len(cells))
    ]
    away = (slice(8, -8), slice(8, -8))
    lines = [profile(one, y, 0.5, 0) for one in (truth, *images)]
    numbers = {
        "correlation_line": likeness(images[0][away], truth[away]),
        "correlation_l": likeness(images[1][away], truth[away]),
        "row_correlation_line": likeness(lines[1][8:-8], lines[0][8:-8]),
        "row_correlation_l": likeness(lines[2][8:-8], lines[0][8:-8]),
    }

    def paint(figure: Any) -> None:
        axes = figure.subplots(1, 4)
        names = ("a) sample", "b) heard from a line above", "c) heard from an L", "d) along the dotted line")
        for one, image, name in zip(axes, (truth, *images), names, strict=False):
            show_map(one, image / np.percentile(image, 99.5), x, y, name, (0, 1.05))
            one.axhline(0.5, color="tab:orange", lw=0.8, ls=":")
        for one in axes[1:3]:
            one.plot([x[0], x[-1]], [y[0], y[0]], color="tab:cyan", lw=3)
        axes[2].plot([x[0], x[0]], [y[0], y[-1]], color="tab:cyan", lw=3)
        for line, name in zip(lines, ("sample", "line", "L"), strict=True):
            axes[3].plot(x, line / np.percentile(line, 97), lw=1, label=name)
        axes[3].set(xlabel="x, mm", ylabel="of its maximum", ylim=(-0.1, 1.6))
        axes[3].set_title(names[3], fontsize=9)
        axes[3].legend(fontsize=8)

    return Figure(numbers, paint, (15, 3.4))


# Fig. 8.4


@cache
def fifty(finer: bool = True, pixel_mm: float = PIXEL_MM, radius_mm: float = RADIUS_MM) -> Sweep:
    """50 angles of the sample with three inclusions, every frequency heard, no noise."""
    dx, shift = (FINER * pixel_mm, SHIFT_MM) if finer else (pixel_mm, (0.0, 0.0))
    side = scipy.fft.next_fast_len(math.ceil(2 * radius_mm / dx) + 2 * PML_CELLS + 8, real=True)
    grid, medium = SoundGrid((side, side), dx), Medium(SPEED)
    solver = Solver(grid, medium)
    angles = np.arange(POSITIONS, dtype=np.float64) * (360.0 / POSITIONS)
    turn = np.radians(angles)
    points = radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1) - np.array(shift)
    steps = math.ceil(TAIL * 2e-3 * radius_mm / SPEED / solver.dt_s) + 1
    traces = solver.forward(drawn(phantom("inclusions"), grid, pixel_mm, shift), receivers(grid, points), steps)
    return Sweep(traces.astype(np.float64), angles, radius_mm, 1 / solver.dt_s, 0.0, SPEED)


def interpolation(pixel_mm: float = PIXEL_MM, radius_mm: float = RADIUS_MM) -> Figure:
    """The same 50 traces, sent back from 50 cells, and from the whole circle with what lies between interpolated."""
    parts = phantom("inclusions")
    sweep = fifty(True, pixel_mm, radius_mm)
    whole = time_reversal(sweep, pixel=pixel_mm)
    alone = _from_points(sweep, whole, pixel_mm)
    own = time_reversal(fifty(False, pixel_mm, radius_mm), pixel=pixel_mm)
    truth = truth_of(parts, whole)
    within = radius_mm - 2 * pixel_mm
    psnr, correlation = quality(whole, truth, within)
    psnr_own, correlation_own = quality(own, truth, within)
    inside = np.hypot(*np.meshgrid(whole.y_mm, whole.x_mm, indexing="ij")) < within
    scale = float((alone[inside] @ truth[inside]) / (alone[inside] @ alone[inside]))
    error = float(np.mean((scale * alone[inside] - truth[inside]) ** 2))
    numbers = {
        "psnr_db": psnr,
        "correlation": correlation,
        "psnr_same_grid_db": psnr_own,
        "correlation_same_grid": correlation_own,
        "psnr_points_db": 10 * math.log10(float(truth.max()) ** 2 / error),
        "correlation_points": likeness(alone[inside], truth[inside]),
    }

    def paint(figure: Any) -> None:
        axes = figure.subplots(1, 4)
        images: list[NDArray[np.floating]] = [truth, scale * alone, whole.values]
        names = (
            "a) sample and 50 positions",
            f"b) from 50 points: {numbers['psnr_points_db']:.1f} dB",
            f"c) interpolated: {psnr:.1f} dB",
            "d) along the dotted line",
        )
        for one, image, name in zip(axes, images, names, strict=False):
            show_map(one, np.where(inside, image, np.nan), whole.x_mm, whole.y_mm, name, (-0.1, 1.1))
            one.axhline(-1.0, color="tab:orange", lw=0.8, ls=":")
        axes[0].plot(*sweep.positions_mm.T, ".", color="tab:orange", ms=3)
        for image, name in zip(images, ("sample", "50 points", "interpolated"), strict=True):
            axes[3].plot(whole.x_mm, profile(image, whole.y_mm, -1.0, 0), lw=1, label=name)
        axes[3].set(xlabel="x, mm", ylabel="initial pressure, of the largest")
        axes[3].set_title(names[3], fontsize=9)
        axes[3].legend(fontsize=8)

    return Figure(numbers, paint, (16, 3.8))


def _from_points(sweep: Sweep, like: AcousticImage, pixel_mm: float) -> FloatArray:
    """Time reversal from nothing but the cells nearest to the receivers, on the pixels of `like`."""
    side = scipy.fft.next_fast_len(math.ceil(2 * sweep.radius_mm / pixel_mm) + 2 * PML_CELLS + 8, real=True)
    grid = SoundGrid((side, side), pixel_mm)
    cells, angles = rim(grid, sweep.radius_mm)
    nearest = [int(np.argmax(np.cos(angles - turn))) for turn in np.radians(sweep.angles_deg)]
    solver = Solver(grid, Medium(sweep.sound_speed_m_s), 1 / sweep.sampling_rate_hz)
    values = solver.reverse(sweep.signals, cells[nearest])
    off = (side - len(like.x_mm)) // 2
    return np.asarray(values[off : off + len(like.y_mm), off : off + len(like.x_mm)], float)


# Resolution


@dataclass(frozen=True, slots=True)
class Resolution:
    """Full width at half maximum of a wire's image, mm, for each pulse width, us; and what theory says."""

    pulses_us: tuple[float, ...]
    widths_mm: tuple[float, ...]
    theory_mm: tuple[float, ...]


@cache
def resolution(
    pulses_us: tuple[float, ...] = (0.25, 0.5, 1.0, 1.5, 2.0), wire_mm: float = 0.6, pixel_mm: float = 0.1
) -> Resolution:
    """One wire off the axis, every frequency heard, rectangular pulses.

    Theory: a source that is switched on for T is imaged as it was at the middle of the pulse, p0(k) sinc(c k T / 2) in
    wave numbers. In a plane that is a bright rim of diameter c T.
    """
    radius = 7.0
    at = (1.5, 0.9)
    dx = FINER * pixel_mm
    side = scipy.fft.next_fast_len(math.ceil(2 * radius / dx) + 2 * PML_CELLS + 8, real=True)
    grid = SoundGrid((side, side), dx)
    solver = Solver(grid, Medium(SPEED))
    angles = np.arange(90, dtype=np.float64) * 4.0
    turn = np.radians(angles)
    points = radius * np.stack([np.cos(turn), np.sin(turn)], axis=1) - np.array(SHIFT_MM)
    steps = math.ceil((TAIL * 2e-3 * radius / SPEED + 1e-6 * max(pulses_us)) / solver.dt_s)
    rise = drawn((Disc(*at, wire_mm / 2, 1.0),), grid, pixel_mm, SHIFT_MM)
    instant = solver.forward(rise, receivers(grid, points), steps).astype(float)
    widths, theory = [], []
    for pulse in pulses_us:
        traces = switched_on(instant, 1e-6 * pulse, solver.dt_s)
        sweep = Sweep(traces, angles, radius, 1 / solver.dt_s, -0.5e-6 * pulse, SPEED)
        image = time_reversal(sweep, pixel=pixel_mm)
        widths.append(full_width(image.x_mm, profile(image.values, image.y_mm, at[1], 0), at[0]))
        theory.append(_width_in_theory(wire_mm / 2, SPEED * pulse * 1e-3, SMOOTH * pixel_mm))
    return Resolution(pulses_us, tuple(widths), tuple(theory))


def switched_on(instant: FloatArray, pulse_s: float, dt_s: float) -> NDArray[np.float64]:
    """Traces of a source on from time 0 for `pulse_s`, of unit energy, from those of one instant at time 0."""
    total = np.concatenate([np.zeros((len(instant), 1)), np.cumsum(instant, axis=1)], axis=1) * dt_s
    times = (np.arange(instant.shape[1]) + 0.5) * dt_s
    at = np.arange(instant.shape[1] + 1) * dt_s
    ends = [
        np.stack([np.interp(times + dt_s / 2 - off, at, line) for line in total])
        for off in (dt_s / 2, dt_s / 2 + pulse_s)
    ]
    return np.asarray((ends[0] - ends[1]) / pulse_s)


def full_width(x_mm: FloatArray, values: FloatArray, near_mm: float, reach_mm: float = 3.5) -> float:
    """Between the outermost half maxima near a place."""
    near = np.abs(x_mm - near_mm) < reach_mm
    x, line = x_mm[near], np.nan_to_num(values[near])
    above = np.flatnonzero(line >= 0.5 * line.max())
    first, last = int(above[0]), int(above[-1])

    def crossing(i: int, j: int) -> float:
        if not 0 <= j < len(line):
            return float(x[i])
        return float(x[i] + (x[j] - x[i]) * (line[i] - 0.5 * line.max()) / (line[i] - line[j]))

    return crossing(last, last + 1) - crossing(first, first - 1)


def _width_in_theory(wire_mm: float, path_mm: float, smooth_mm: float) -> float:
    """The same width for a disc of radius `wire_mm`, smoothed, under a pulse that lasts for `path_mm` of sound."""
    from scipy.special import j0

    k = np.linspace(1e-6, 12.0 / smooth_mm, 6000)
    spectrum = wire_mm * j1(k * wire_mm) / k * np.exp(-((k * smooth_mm) ** 2) / 2) * np.sinc(k * path_mm / 2 / math.pi)
    r = np.linspace(-3.5, 3.5, 1401)
    line = np.array([np.trapezoid(spectrum * k * j0(k * abs(at)), k) for at in r[700:]])
    return full_width(r, np.concatenate([line[:0:-1], line]), 0.0)
