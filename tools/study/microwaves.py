"""Figures 7.5 to 7.8: from the microwave's power to the image, and what conductivity and pulse do to it."""

import math
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.ndimage import gaussian_filter

from annulus_pipe.wings.tai.measure.electromagnetics import (
    AIR,
    EPS0,
    FREQUENCY_HZ,
    OIL,
    WR340_MM,
    Dielectric,
    MicrowaveField,
    half_space_loss,
    nodes,
    open_waveguide,
    plane_wave,
    slab_loss,
)
from annulus_pipe.wings.tai.measure.field import Medium, Solver, SoundGrid, receivers, time_step_s
from annulus_pipe.wings.tai.measure.phantoms import Box, Disc, Part, draw, phantom
from tools.study.figure import Figure, FloatArray, profile, show_map
from tools.study.images import SHIFT_MM, SMOOTH, Frame, likeness

OIL_SPEED, SAMPLE_SPEED = 1450.0, 1537.0  # m/s, safflower oil; the samples of §7.8.1
AHEAD_MM = 20.0  # the sample's middle in front of the guide's mouth
POWER_W = 1000.0
TABLE_7_1_S_M = (0.84, 0.95, 1.11, 1.33, 2.32)  # conductivities of Table 7.1
DEPTH_MM, THICK_MM = 10.0, 30.0  # §7.8.2: how deep the loss is summed, and the sample
PULSES_US = (0.3, 0.5, 0.7, 0.9)
SHAPES = phantom("shapes")
INCLUSIONS: tuple[Part, ...] = (Disc(0.0, -1.5, 0.5, 0.75), Disc(0.0, 1.5, 0.5, 0.75))
TISSUE: tuple[Part, ...] = (Box(0.0, 0.0, 7.0, 6.0, 0.4), *INCLUSIONS)  # §7.8.2: values are conductivities, S/m


# Microwaves


def in_front_of_guide(parts: tuple[Part, ...], eps_r: float, step_mm: float) -> MicrowaveField:
    """Of a sample in oil; `value` of its parts is S/m.

    The sample's y points back to the guide: what lies at y < 0 is farther away, beneath the receivers.
    """
    x, y, step = nodes(45.0, AHEAD_MM + 25.0, step_mm)
    size = (len(y), len(x))
    # the sample's own frame: drawn upside down on a grid as large, with its middle in front of the mouth
    middle = 0.5 * (float(y[0]) + float(y[-1])) - AHEAD_MM
    turned = tuple(_mirrored(part) for part in parts)
    sigma = draw(turned, SoundGrid(size, step), (0.0, middle))
    cover = draw(tuple(_valued(part) for part in turned), SoundGrid(size, step), (0.0, middle))
    lossy = 2 * math.pi * FREQUENCY_HZ * EPS0
    eps = OIL.eps_r * (1 - cover) + eps_r * cover - 1j * sigma / lossy
    return open_waveguide(eps, step, x, y, POWER_W)


def absorbed_w(field: MicrowaveField) -> float:
    """Power that stays in the sample, W, for a guide as high as it is."""
    step = float(field.x_mm[1] - field.x_mm[0]) * 1e-3
    return float(field.loss_w_m3.sum()) * step**2 * WR340_MM[1] * 1e-3


def loss_on(
    field: MicrowaveField, parts: tuple[Part, ...], grid: SoundGrid, pixel_mm: float, shift: tuple[float, float]
) -> FloatArray:
    """sigma |E|^2 on a grid of sound: |E|^2 is smooth across edges, the conductivity's edges are the sample's."""
    square = RegularGridInterpolator((field.y_mm, field.x_mm), np.abs(field.e_v_m) ** 2, method="cubic")
    y, x = np.meshgrid(AHEAD_MM - (grid.y_mm + shift[1]), grid.x_mm + shift[0], indexing="ij")
    here = (np.abs(x) < field.x_mm[-1]) & (y > 0) & (y < field.y_mm[-1])
    values = np.zeros(grid.shape)
    values[here] = square(np.stack([y[here], x[here]], axis=1))
    return np.asarray(gaussian_filter(draw(parts, grid, shift) * values, SMOOTH * pixel_mm / grid.dx_mm))


def _mirrored(part: Part) -> Part:
    if isinstance(part, Disc):
        return Disc(part.x_mm, -part.y_mm, part.radius_mm, part.value)
    return Box(part.x_mm, -part.y_mm, part.width_mm, part.height_mm, part.value)


def _valued(part: Part) -> Part:
    if isinstance(part, Disc):
        return Disc(part.x_mm, part.y_mm, part.radius_mm, 1.0)
    return Box(part.x_mm, part.y_mm, part.width_mm, part.height_mm, 1.0)


# A line of receivers above the sample


@dataclass(frozen=True, slots=True, eq=False)
class ArrayTraces:
    """Traces of an instant of heating, and what is needed to send them back."""

    frame: Frame
    cells: NDArray[np.int64]
    traces: FloatArray
    dt_s: float
    loss: FloatArray  # on the image's grid

    def back(self, traces: FloatArray) -> FloatArray:
        """Sent back in time into plain oil: nobody knows the sample before its image is made."""
        values = Solver(self.frame.grid, Medium(OIL_SPEED), self.dt_s).reverse(traces, self.cells)
        return np.asarray(values[self.frame.inside()])

    def axes_mm(self) -> tuple[FloatArray, FloatArray]:
        window, grid = self.frame.inside(), self.frame.grid
        return grid.x_mm[window[1]], grid.y_mm[window[0]]


@cache
def above(parts: tuple[Part, ...], eps_r: float, pixel_mm: float, em_step_mm: float) -> ArrayTraces:
    field = in_front_of_guide(parts, eps_r, em_step_mm)
    frame = Frame(9.0, 5.0, pixel_mm)
    finer = frame.finer
    cover = draw(tuple(_valued(part) for part in parts), finer, SHIFT_MM)
    medium = Medium(OIL_SPEED + (SAMPLE_SPEED - OIL_SPEED) * cover)
    dt = time_step_s(finer, medium)
    cells = frame.row(-frame.y_mm)
    steps = math.ceil(2.2e-3 * math.hypot(frame.x_mm, frame.y_mm) / OIL_SPEED / dt)
    rise = loss_on(field, parts, finer, pixel_mm, SHIFT_MM)
    ears = receivers(finer, frame.points_mm(cells) - np.array(SHIFT_MM))
    traces = Solver(finer, medium, dt).forward(rise, ears, steps).astype(float)
    loss = loss_on(field, parts, frame.grid, pixel_mm, (0.0, 0.0))[frame.inside()]
    return ArrayTraces(frame, cells, traces, dt, loss)


def under_gaussian(traces: FloatArray, dt_s: float, width_s: float) -> FloatArray:
    """Traces of an instant at time 0 -> of a Gaussian pulse about time 0, `width_s` at half maximum, of unit energy."""
    sigma = width_s / (2 * math.sqrt(2 * math.log(2)))
    length = scipy.fft.next_fast_len(traces.shape[1] + math.ceil(8 * sigma / dt_s), real=True)
    frequency = scipy.fft.rfftfreq(length, dt_s)
    spectrum = scipy.fft.rfft(traces, length, axis=1) * np.exp(-2 * (math.pi * frequency * sigma) ** 2)
    return np.asarray(scipy.fft.irfft(spectrum, length, axis=1)[:, : traces.shape[1]])


def three_shapes(pixel_mm: float = 0.1, em_step_mm: float = 0.5) -> Figure:
    """Fig. 7.5: disc, square and rectangle of 0.4 S/m in oil, a Gaussian pulse of 40 ns, a line of receivers above."""
    heard = above(_conducting(0.4), 9.0, pixel_mm, em_step_mm)
    image = heard.back(under_gaussian(heard.traces, heard.dt_s, 40e-9))
    x, y = heard.axes_mm()
    away = (y > -4.5)[:, None] & np.ones(len(x), bool)
    seen = np.maximum(image, 0.0)
    most = float(heard.loss.max())
    numbers = {"correlation": likeness(seen[away], heard.loss[away])}
    for part, name in zip(SHAPES, ("disc", "square", "rectangle"), strict=True):
        near = (np.abs(x - part.x_mm) < 1.9)[None, :] & (y > -4.0)[:, None]
        strong = near & (seen > 0.5 * seen[near].max())
        inner = draw((part,), heard.frame.grid)[heard.frame.inside()] > 0.99
        numbers[f"{name}_off_mm"] = math.hypot(
            float(np.mean(np.broadcast_to(x, seen.shape)[strong])) - part.x_mm,
            float(np.mean(np.broadcast_to(y[:, None], seen.shape)[strong])) - part.y_mm,
        )
        numbers[f"{name}_loss_uneven"] = float(heard.loss[inner].std() / heard.loss[inner].mean())

    def paint(figure: Any) -> None:
        axes = figure.subplots(1, 4)
        cover = draw(SHAPES, heard.frame.grid)[heard.frame.inside()]
        show_map(axes[0], cover, x, y, "a) samples of 0.4 S/m in oil; receivers above", (0, 1.05))
        shown = show_map(
            axes[1], 1e-6 * heard.loss, x, y, "b) microwave loss, MW/m3 (1 kW in)", (0, 1e-6 * most), "inferno"
        )
        figure.colorbar(shown, ax=axes[1], shrink=0.6)
        level = float(np.percentile(seen[away], 99.5))
        show_map(axes[2], image / level, x, y, "c) time reversal", (-1, 1), "RdBu_r")
        show_map(axes[3], seen / level, x, y, "d) negative values left out", (0, 1.05))
        for one in (axes[0], axes[2], axes[3]):
            one.plot([x[0], x[-1]], [y[0], y[0]], color="tab:cyan", lw=3)

    return Figure(numbers, paint, (17, 3.2))


def _conducting(sigma: float) -> tuple[Part, ...]:
    return tuple(
        Disc(p.x_mm, p.y_mm, p.radius_mm, sigma)
        if isinstance(p, Disc)
        else Box(p.x_mm, p.y_mm, p.width_mm, p.height_mm, sigma)
        for p in SHAPES
    )


def conductivity(pixel_mm: float = 0.1, em_step_mm: float = 0.5) -> Figure:
    """Fig. 7.6: the signal of a disc of 12 mm against its conductivity; two small discs in tissue, and their image."""
    coarse = 2.5 * pixel_mm
    frame = Frame(13.0, 13.0, coarse)
    dt = time_step_s(frame.grid, Medium(OIL_SPEED))
    solver, ear = Solver(frame.grid, Medium(OIL_SPEED), dt), receivers(frame.grid, np.array([[0.0, -12.0]]))
    steps = math.ceil(26e-3 / OIL_SPEED / dt)
    signals, losses = [], []
    for sigma in TABLE_7_1_S_M:
        part: tuple[Part, ...] = (Disc(0.0, 0.0, 6.0, sigma),)
        field = in_front_of_guide(part, 14.03, 2 * em_step_mm)
        rise = loss_on(field, part, frame.grid, coarse, (0.0, 0.0))
        signals.append(under_gaussian(solver.forward(rise, ear, steps).astype(float), dt, 0.5e-6)[0])
        losses.append(absorbed_w(field))
    swing = [float(np.ptp(signal)) for signal in signals]
    heard = above(TISSUE, 9.0, pixel_mm, em_step_mm)
    image = heard.back(under_gaussian(heard.traces, heard.dt_s, 40e-9))
    x, y = heard.axes_mm()
    loss_line, image_line = (profile(one, x, 0.0, 1) for one in (heard.loss, image))
    inner = np.abs(y) < 3.8
    numbers = {f"swing_{sigma:g}_s_m": one / swing[0] for sigma, one in zip(TABLE_7_1_S_M, swing, strict=True)}
    numbers |= {f"absorbed_{sigma:g}_s_m": one / losses[0] for sigma, one in zip(TABLE_7_1_S_M, losses, strict=True)}
    numbers |= {
        "loss_contrast": float(loss_line[np.abs(y - 1.5) < 0.2].max() / loss_line[np.abs(y) < 0.3].mean()),
        "line_correlation": likeness(image_line[inner], loss_line[inner]),
    }

    def paint(figure: Any) -> None:
        axes = figure.subplots(1, 4)
        times = 1e6 * dt * np.arange(steps)
        for sigma, signal in zip(TABLE_7_1_S_M, signals, strict=True):
            axes[0].plot(times, signal / swing[0], lw=0.9, label=f"{sigma:g} S/m")
        axes[0].set(
            xlabel="time, us", ylabel=f"pressure, of the swing at {TABLE_7_1_S_M[0]:g} S/m", xlim=(2, times[-1])
        )
        axes[0].set_title("a) disc of 12 mm", fontsize=9)
        axes[0].legend(fontsize=7)
        most = float(heard.loss.max())
        show_map(axes[1], heard.loss / most, x, y, "b) microwave loss, of the largest", (0, 1), "inferno")
        level = float(np.percentile(np.abs(image[y > -4.0]), 99.7))
        show_map(axes[2], image / level, x, y, "c) time reversal, receivers above", (-1, 1), "RdBu_r")
        axes[3].plot(y, loss_line / loss_line.max(), label="loss")
        axes[3].plot(y[inner], image_line[inner] / image_line[inner].max(), label="image")
        axes[3].set(xlabel="y, mm", ylabel="of the maximum")
        axes[3].set_title("d) line at x = 0", fontsize=9)
        axes[3].legend(fontsize=7)

    return Figure(numbers, paint, (17, 3.4))


# Fig. 7.7


@dataclass(frozen=True, slots=True, eq=False)
class Losses:
    """Loss in the first 10 mm against conductivity, W/m^2 for 1 V/m, of a plane wave."""

    sigma_s_m: FloatArray
    half_space: FloatArray  # closed form, Eq. 7.21 to 7.23
    slab: FloatArray  # closed form, 30 mm, every reflection counted
    half_space_solved: FloatArray
    slab_solved: FloatArray


@cache
def losses(eps_r: float, step_mm: float = 0.5, count: int = 41) -> Losses:
    sigma = np.geomspace(0.05, 20.0, count)
    media = [Dielectric(eps_r, float(one)) for one in sigma]
    return Losses(
        sigma,
        np.array([half_space_loss(one, DEPTH_MM) for one in media]),
        np.array([slab_loss(one, THICK_MM, DEPTH_MM) for one in media]),
        np.array([plane_wave(one, math.inf, DEPTH_MM, step_mm) for one in media]),
        np.array([plane_wave(one, THICK_MM, DEPTH_MM, step_mm) for one in media]),
    )


@cache
def losses_at_guide(eps_r: float, step_mm: float = 2.0, count: int = 13) -> tuple[FloatArray, FloatArray]:
    """(S/m, W/m per kW) in the first 10 mm along the axis of a block of 120 x 30 mm before the open guide, in air."""
    sigma = np.geomspace(0.1, 20.0, count)
    x, y, step = nodes(75.0, 45.0, step_mm)
    gap = 5.0
    inside = (np.abs(x) <= 60.0)[None, :] & (
        np.clip((y - gap) / step + 0.5, 0, 1) * np.clip((gap + THICK_MM - y) / step + 0.5, 0, 1) > 0
    )[:, None]
    deep = (y >= gap) & (y <= gap + DEPTH_MM)
    middle = int(np.argmin(np.abs(x)))
    found = []
    for one in sigma:
        eps = np.where(inside, Dielectric(eps_r, float(one)).permittivity(FREQUENCY_HZ), 1.0 + 0j)
        field = open_waveguide(eps, step, x, y, POWER_W)
        found.append(float(np.trapezoid(field.loss_w_m3[deep, middle], 1e-3 * y[deep])))
    return sigma, np.array(found)


def peak(sigma: FloatArray, loss: FloatArray) -> tuple[float, float]:
    """(conductivity, loss) of the maximum, by a parabola over the logarithm."""
    i = int(np.clip(np.argmax(loss), 1, len(loss) - 2))
    a, b, c = np.polyfit(np.log(sigma[i - 1 : i + 2]), loss[i - 1 : i + 2], 2)
    return float(np.exp(-b / (2 * a))), float(c - b * b / (4 * a))


def optimal_conductivity(step_mm: float = 0.5, count: int = 41) -> Figure:
    """Fig. 7.7: which conductivity takes most."""
    numbers: dict[str, float] = {}
    for eps_r in (1.0, 3.0):
        found = losses(eps_r, step_mm, count)
        for name in ("half_space", "slab"):
            exact, solved = (peak(found.sigma_s_m, getattr(found, name + end)) for end in ("", "_solved"))
            numbers[f"{name}_{eps_r:g}_at_s_m"] = exact[0]
            numbers[f"{name}_{eps_r:g}_solved_at_s_m"] = solved[0]
            numbers[f"{name}_{eps_r:g}_off"] = solved[1] / exact[1] - 1
        numbers[f"guide_{eps_r:g}_at_s_m"] = peak(*losses_at_guide(eps_r))[0]

    def paint(figure: Any) -> None:
        axes = figure.subplots(1, 3)
        for eps_r, colour in ((1.0, "tab:blue"), (3.0, "tab:red")):
            found = losses(eps_r, step_mm, count)
            for one, name in zip(axes, ("half_space", "slab"), strict=False):
                one.semilogx(
                    found.sigma_s_m, 1e3 * getattr(found, name), color=colour, label=f"eps_r {eps_r:g}, closed form"
                )
                one.semilogx(found.sigma_s_m, 1e3 * getattr(found, f"{name}_solved"), ".", color=colour, label="solver")
            axes[2].semilogx(
                *losses_at_guide(eps_r), "o-", ms=3, lw=0.9, color=colour, label=f"eps_r {eps_r:g}, solver"
            )
        titles = ("a) half-space (Eq. 7.21)", "b) slab of 30 mm, every reflection", "c) 120 x 30 mm, 5 mm before WR340")
        for one, title in zip(axes, titles, strict=True):
            one.set(xlabel="conductivity, S/m", ylabel="loss in 10 mm, mW/m2 for 1 V/m", ylim=(0, None))
            one.set_title(title, fontsize=9)
            one.legend(fontsize=7)
        axes[2].set(ylabel="loss on the axis, in 10 mm, W/m2 for 1 kW")

    return Figure(numbers, paint, (14, 3.8))


# Fig. 7.8


def pulse_width(pixel_mm: float = 0.1, em_step_mm: float = 0.5) -> Figure:
    """Fig. 7.8: longer pulses, longer waves; the three shapes under a pulse of 4 us."""
    heard = above(_conducting(0.4), 9.0, pixel_mm, em_step_mm)
    x, y = heard.axes_mm()
    over = int(np.argmin(np.abs(x - SHAPES[0].x_mm)))
    lines = {pulse: under_gaussian(heard.traces[over : over + 1], heard.dt_s, 1e-6 * pulse)[0] for pulse in PULSES_US}
    numbers = {}
    for pulse, line in lines.items():
        spectrum = np.abs(scipy.fft.rfft(line, 16 * len(line))) ** 2
        frequency = scipy.fft.rfftfreq(16 * len(line), heard.dt_s)
        numbers[f"wavelength_{pulse:g}_us_mm"] = 1e3 * OIL_SPEED / float((frequency * spectrum).sum() / spectrum.sum())
    short, long = (heard.back(under_gaussian(heard.traces, heard.dt_s, width)) for width in (40e-9, 4e-6))
    away = (y > -4.5)[:, None] & np.ones(len(x), bool)
    for name, image in (("40_ns", short), ("4_us", long)):
        numbers[f"correlation_{name}"] = likeness(np.maximum(image, 0.0)[away], heard.loss[away])

    def paint(figure: Any) -> None:
        left, middle, right = figure.subplots(1, 3)
        times = 1e6 * heard.dt_s * np.arange(heard.traces.shape[1])
        for pulse, line in lines.items():
            left.plot(times, line / np.abs(lines[PULSES_US[0]]).max(), lw=0.9, label=f"{pulse:g} us")
        left.set(xlabel="time, us", ylabel="pressure", xlim=(1, 12))
        left.set_title("a) heard above the disc, Gaussian pulses of one energy", fontsize=9)
        left.legend(fontsize=7)
        for axes, image, title in ((middle, short, "b) pulse of 40 ns"), (right, long, "c) pulse of 4 us")):
            seen = np.maximum(image, 0.0)
            show_map(axes, seen / np.percentile(seen[away], 99.5), x, y, title, (0, 1.05))

    return Figure(numbers, paint, (15, 3.4))


def convergence(steps_mm: tuple[float, ...] = (2.0, 1.0, 0.5)) -> dict[float, tuple[float, float]]:
    """step -> (power absorbed by a disc of 20 mm in oil, W of 1 kW; |S11|)."""
    found = {}
    for step in steps_mm:
        field = in_front_of_guide((Disc(0.0, 0.0, 10.0, 1.0),), 20.0, step)
        found[step] = (absorbed_w(field), abs(field.reflection))
    return found


def reflection_into_air(step_mm: float = 1.0) -> float:
    """|S11| of the guide with nothing in front of it, in the plane of the solver."""
    x, y, step = nodes(60.0, 60.0, step_mm)
    empty = np.full((len(y), len(x)), AIR.permittivity(FREQUENCY_HZ))
    return abs(open_waveguide(empty, step, x, y, POWER_W).reflection)
