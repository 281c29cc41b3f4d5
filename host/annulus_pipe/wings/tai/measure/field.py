"""Sound in a plane: a k-space pseudospectral solver for thermoacoustic sources, forwards and reversed in time.

First-order equations on a staggered grid, split perfectly matched layer, speed and density that vary in space. The
temporal error of a homogeneous medium is taken out in wave-number space (Tabei, Mast and Waag, JASA 111, 2002), so
stability limits the step, accuracy does not.

Arrays are indexed [y, x]; the grid's centre is (0, 0) mm, x to the right, y down.
"""

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.late import fft, sparse
from annulus_pipe.vocabulary import AnnulusError

FloatArray = NDArray[np.floating]

PML_CELLS = 20  # Guard of the layer: test_what_leaves_does_not_come_back
PML_STRENGTH = 2.0  # nepers per cell at the rim
PML_POWER = 4
COURANT = 0.3  # c dt / dx: accuracy does not limit it. Guard: topic solver
TAPS = (
    20  # cells in a row that speak for a point between cells. Guard, with TAPER: test_a_gaussian_sounds_as_theory_says
)
TAPER = 12.0  # how their weight falls: Kaiser's beta


@dataclass(frozen=True, slots=True)
class SoundGrid:
    """`shape` cells (ny, nx) of `dx_mm`, the absorbing layer of PML_CELLS at every side included."""

    shape: tuple[int, int]
    dx_mm: float

    def __post_init__(self) -> None:
        if min(self.shape) < 2 * PML_CELLS + 8 or max(self.shape) > 4096:
            raise AnnulusError(f"a grid of {self.shape} cells, expected {2 * PML_CELLS + 8}..4096 each way")
        if not 1e-4 <= self.dx_mm <= 100:
            raise AnnulusError(f"cells of {self.dx_mm} mm, expected 0.0001..100")

    @property
    def x_mm(self) -> NDArray[np.float64]:
        return np.asarray((np.arange(self.shape[1]) - (self.shape[1] - 1) / 2) * self.dx_mm, np.float64)

    @property
    def y_mm(self) -> NDArray[np.float64]:
        return np.asarray((np.arange(self.shape[0]) - (self.shape[0] - 1) / 2) * self.dx_mm, np.float64)

    @property
    def reach_mm(self) -> tuple[float, float]:
        """Half-widths (y, x) of what the absorbing layer leaves free."""
        y, x = ((n - 1) / 2 - PML_CELLS for n in self.shape)
        return y * self.dx_mm, x * self.dx_mm


@dataclass(frozen=True, slots=True, eq=False)
class Medium:
    """Speed of sound, m/s, and density, kg/m^3: one number or one a cell."""

    sound_speed_m_s: float | FloatArray = 1500.0
    density_kg_m3: float | FloatArray = 1000.0

    def fastest(self) -> float:
        return float(np.max(self.sound_speed_m_s))


def time_step_s(grid: SoundGrid, medium: Medium, courant: float = COURANT) -> float:
    return courant * grid.dx_mm * 1e-3 / medium.fastest()


class Solver:
    """One medium on one grid with one time step; runs as many shots as wanted.

    >>> solver = Solver(grid, medium)
    >>> traces = solver.forward(rise, receivers(grid, points_mm), steps=859)   # initial pressure
    >>> traces = solver.forward(rise, receivers(grid, points_mm), steps=859, envelope=burst)  # any I(t)
    >>> image = solver.reverse(traces_on_rim, rim, steps=859)

    `dtype` float32 is right for images (relative error about 1e-6), float64 for convergence studies.
    """

    def __init__(
        self, grid: SoundGrid, medium: Medium, dt_s: float | None = None, dtype: type[np.floating] = np.float32
    ) -> None:
        self.grid, self.medium = grid, medium
        self.dt_s = time_step_s(grid, medium) if dt_s is None else dt_s
        ny, nx = grid.shape
        dx, dt = grid.dx_mm * 1e-3, self.dt_s
        speed = np.broadcast_to(np.asarray(medium.sound_speed_m_s, float), grid.shape)
        density = np.broadcast_to(np.asarray(medium.density_kg_m3, float), grid.shape)
        if not (np.isfinite(speed).all() and (speed > 0).all() and np.isfinite(density).all() and (density > 0).all()):
            raise AnnulusError("speed of sound and density must be positive numbers everywhere")
        reference = float(speed.max())  # the scheme is stable with the fastest speed as reference
        if dt * reference / dx > 2 / (math.pi * math.sqrt(2)):
            raise AnnulusError(
                f"a step of {1e9 * dt:.3g} ns is too long for cells of {grid.dx_mm} mm at {reference:.0f} m/s, "
                f"expected at most {1e9 * 0.45 * dx / reference:.3g} ns"
            )
        self._dtype = np.dtype(dtype)
        complex_type = np.result_type(self._dtype, np.complex64)
        kx = 2 * math.pi * np.fft.rfftfreq(nx, dx)
        ky = 2 * math.pi * np.fft.fftfreq(ny, dx)
        k = np.hypot(ky[:, None], kx)
        half = reference * k * dt / 2
        # The correction of both derivatives, applied once: with the gradient of the pressure.
        kappa2 = np.sinc(half / math.pi) ** 2
        ahead_x, ahead_y = 1j * kx * np.exp(0.5j * kx * dx), 1j * ky * np.exp(0.5j * ky * dx)
        # The highest wave number of an even grid has no sign; half a cell's shift leaves it no derivative's worth.
        if ny % 2 == 0:
            ahead_y[ny // 2] = -abs(ky[ny // 2])  # i k e^{ik dx/2} = -k there, for both signs
        self._gradient = (
            (ahead_y[:, None] * kappa2).astype(complex_type),
            (ahead_x[None, :] * kappa2).astype(complex_type),
        )
        ky_real = 2 * math.pi * np.fft.rfftfreq(ny, dx)
        self._divergence = (
            (1j * ky_real * np.exp(-0.5j * ky_real * dx))[:, None].astype(complex_type),
            (1j * kx * np.exp(-0.5j * kx * dx))[None, :].astype(complex_type),
        )
        self._source_filter = np.cos(half)
        layer = [_layer(n, reference * dt / dx, at) for n in (ny, nx) for at in (0.0, 0.5)]
        absorbing = (layer[0][:, None], layer[2][None, :])  # at the pressure's points
        staggered = (layer[1][:, None], layer[3][None, :])
        between_y = 0.5 * (density + np.roll(density, -1, axis=0))
        between_x = 0.5 * (density + np.roll(density, -1, axis=1))
        kind = self._dtype
        self._pushed = tuple((-dt / b * p).astype(kind) for b, p in zip((between_y, between_x), staggered, strict=True))
        self._squeezed = tuple((-dt * density * speed**2 * p).astype(kind) for p in absorbing)
        self._flow_kept = tuple((p**2).astype(kind) for p in staggered)
        self._part_kept = tuple((p**2).astype(kind) for p in absorbing)

    def forward(
        self,
        rise: FloatArray,
        receivers: sparse.csr_array,
        steps: int,
        envelope: FloatArray | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> NDArray[np.floating]:
        """Pressure at the receivers, (receivers, steps), at times 0, dt, 2 dt ..

        Parameters
        ----------
        rise : (ny, nx). Without an envelope the initial pressure p0, Pa (Eq. 8.6, stress confinement). With one, the
            rate beta c^2 A / C_p, Pa/s, that the envelope scales (Eq. 8.3 integrated once over time).
        envelope : (n,) mean of I(t) over step 0, 1, ..; zero after its end.
        """
        rise = np.asarray(rise, float)
        if rise.shape != self.grid.shape or not np.isfinite(rise).all():
            raise AnnulusError(f"the source must be finite numbers on the grid's {self.grid.shape} cells")
        run = _Run(self)
        with run:
            if envelope is None:
                run.start(rise)
                push = None
            else:
                # Exact in a homogeneous medium: what is added half a step before it is seen.
                spectrum = fft.rfft2(rise) * self._source_filter
                push = (0.5 * self.dt_s * fft.irfft2(spectrum, s=rise.shape)).astype(self._dtype)
            traces = np.empty((receivers.shape[0], steps), self._dtype)
            listen = receivers.astype(self._dtype)
            for n in range(steps):
                traces[:, n] = listen @ run.pressure.ravel()
                if n == steps - 1:
                    break
                run.step()
                if push is not None and envelope is not None and n < len(envelope) and envelope[n] != 0:
                    run.add(push, float(envelope[n]))
                if progress and n % 50 == 0:
                    progress(n, steps)
        return traces

    def reverse(
        self, traces: FloatArray, cells: NDArray[np.int64], progress: Callable[[int, int], None] | None = None
    ) -> NDArray[np.floating]:
        """Re-emits traces backwards in time from the cells that heard them; the pressure at time 0, (ny, nx).

        traces : (cells, steps), sampled at this solver's step from time 0. cells : (n,) flat indices, a closed rim for
        a faithful image (Alzuhiri 2022, §8.3).
        """
        if traces.shape[0] != len(cells):
            raise AnnulusError(f"{traces.shape[0]} traces for {len(cells)} cells, expected one each")
        if not np.isfinite(traces).all():
            raise AnnulusError("traces hold values that are no numbers")
        run = _Run(self)
        half = (0.5 * np.asarray(traces)).astype(self._dtype)
        with run:
            steps = half.shape[1]
            for n in range(steps - 1, -1, -1):
                run.hold(cells, half[:, n])
                if n:
                    run.step()
                if progress and n % 50 == 0:
                    progress(steps - n, steps)
            return run.pressure.copy()


class _Run:
    """The state of one shot. Both directions are stepped at once on two threads: they meet only in the pressure."""

    def __init__(self, solver: Solver) -> None:
        self._solver = solver
        shape, kind = solver.grid.shape, solver._dtype
        self._part = (np.zeros(shape, kind), np.zeros(shape, kind))  # pressure built up by the flow along y, along x
        self._flow = (np.zeros(shape, kind), np.zeros(shape, kind))
        self.pressure = np.zeros(shape, kind)
        self._pool = ThreadPoolExecutor(1)

    def __enter__(self) -> "_Run":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown()

    def start(self, pressure: FloatArray) -> None:
        """The initial value problem: at rest at time 0, so half of the first push."""
        for part in self._part:
            part[...] = 0.5 * pressure
        np.add(*self._part, out=self.pressure)
        spectrum = fft.rfft2(self.pressure)
        for axis in (0, 1):
            slope = fft.irfft2(self._solver._gradient[axis] * spectrum, s=pressure.shape)
            # step() will push once; half of that is taken back here
            self._flow[axis][...] = -0.5 * self._solver._pushed[axis] * slope / self._solver._flow_kept[axis]

    def add(self, push: FloatArray, amount: float) -> None:
        for part in self._part:
            part += amount * push
        np.add(*self._part, out=self.pressure)

    def hold(self, cells: NDArray[np.int64], half: FloatArray) -> None:
        for part in self._part:
            part.reshape(-1)[cells] = half
        self.pressure.reshape(-1)[cells] = 2 * half

    def step(self) -> None:
        spectrum = fft.rfft2(self.pressure, overwrite_x=False)
        other = self._pool.submit(self._along, 0, spectrum)
        self._along(1, spectrum)
        other.result()
        np.add(*self._part, out=self.pressure)

    def _along(self, axis: int, spectrum: NDArray[np.complexfloating]) -> None:
        """Half of the absorbing before what is added and half after: once squared and once in what is added."""
        s, flow, part = self._solver, self._flow[axis], self._part[axis]
        shape = flow.shape
        slope = fft.irfft2(s._gradient[axis] * spectrum, s=shape, overwrite_x=True)
        slope *= s._pushed[axis]
        flow *= s._flow_kept[axis]
        flow += slope
        waves = fft.rfft(flow, axis=axis)
        waves *= s._divergence[axis]
        spread = fft.irfft(waves, n=shape[axis], axis=axis, overwrite_x=True)
        spread *= s._squeezed[axis]
        part *= s._part_kept[axis]
        part += spread


def receivers(grid: SoundGrid, points_mm: FloatArray) -> sparse.csr_array:
    """Point receivers anywhere between the cells -> (receivers, cells) weights.

    points_mm : (R, 2) x, y; or (R, Q, 2): a face, as Q points whose mean it hears (Eq. 7.20).

    A point between cells is read with a windowed band-limited kernel of TAPS cells: good to 3e-6 for waves longer
    than four cells, to 5e-4 for three.
    """
    points = np.asarray(points_mm, float)
    faces = points[:, None, :] if points.ndim == 2 else points
    reach_y, reach_x = grid.reach_mm
    outside = (np.abs(faces[..., 0]) > reach_x) | (np.abs(faces[..., 1]) > reach_y)
    if outside.any():
        x, y = faces[outside][0]
        raise AnnulusError(
            f"receiver at ({x:.2f}, {y:.2f}) mm is outside the grid, free to +-{reach_x:.2f}, +-{reach_y:.2f} mm"
        )
    columns, weights = [], []
    for (count, at_mm), size in zip(((0, grid.y_mm), (1, grid.x_mm)), grid.shape, strict=True):
        place = (faces[..., 1 - count] - at_mm[0]) / grid.dx_mm
        first = np.floor(place).astype(np.int64) - TAPS // 2 + 1
        cell = np.clip(first[..., None] + np.arange(TAPS), 0, size - 1)
        off = place[..., None] - (first[..., None] + np.arange(TAPS))
        window = np.i0(TAPER * np.sqrt(np.clip(1 - (off / (TAPS / 2)) ** 2, 0, 1))) / np.i0(TAPER)
        kernel = np.sinc(off) * window
        columns.append(cell)
        weights.append(kernel / kernel.sum(axis=-1, keepdims=True))
    cell = columns[0][..., :, None] * grid.shape[1] + columns[1][..., None, :]
    weight = weights[0][..., :, None] * weights[1][..., None, :] / faces.shape[1]
    rows = np.broadcast_to(np.arange(len(faces))[:, None, None, None], cell.shape)
    size = grid.shape[0] * grid.shape[1]
    return sparse.csr_array((weight.ravel(), (rows.ravel(), cell.ravel())), shape=(len(faces), size))


def rim(grid: SoundGrid, radius_mm: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The closed ring of cells at `radius_mm` about the centre: flat indices and angles (radians, from +x to +y)."""
    y, x = np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")
    if radius_mm > min(grid.reach_mm):
        raise AnnulusError(f"a ring of {radius_mm:g} mm does not fit the grid, free to {min(grid.reach_mm):.2f} mm")
    cells = np.flatnonzero(np.abs(np.hypot(x, y) - radius_mm).ravel() <= grid.dx_mm / 2 * math.sqrt(2))
    return cells, np.arctan2(y.ravel()[cells], x.ravel()[cells])


def _layer(cells: int, courant: float, stagger: float) -> NDArray[np.float64]:
    """(cells,) factor of half a step: 1 inside, falling into the absorbing layer."""
    at = np.arange(cells) + stagger
    deep = np.maximum(np.maximum(PML_CELLS - at, at - (cells - 1 - PML_CELLS)), 0) / PML_CELLS
    return np.asarray(np.exp(-0.5 * PML_STRENGTH * courant * deep**PML_POWER))
