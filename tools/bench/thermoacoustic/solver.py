"""The k-space solver against the Gaussian in closed form, and against the clock."""

import importlib.util
import os
import sys
import time
import types
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import simpson
from scipy.special import j0

from annulus_pipe.wings.tai.measure.field import Medium, Solver, SoundGrid, receivers, rim
from tools.bench.table import Row
from tools.bench.thermoacoustic import keep
from tools.study.figure import Figure

SPEED, WIDTH_MM, AT_MM = 1500.0, 0.4, 3.2


def heard(times_s: np.ndarray[Any, Any], at_mm: float) -> np.ndarray[Any, Any]:
    """A Gaussian at rest at time 0 in a plane: the integral over its wave numbers."""
    k = np.linspace(0.0, 12.0 / WIDTH_MM, 8001)
    spectrum = WIDTH_MM**2 * np.exp(-((k * WIDTH_MM) ** 2) / 2) * k * j0(k * at_mm)
    return np.array([simpson(spectrum * np.cos(1e3 * SPEED * t * k), x=k) for t in times_s])


def error(dx_mm: float, kind: type[np.floating], courant: float = 0.3) -> float:
    side = 2 * round(4.0 / dx_mm) + 40
    grid = SoundGrid((side, side), dx_mm)
    solver = Solver(grid, Medium(SPEED), courant * dx_mm * 1e-3 / SPEED, dtype=kind)
    y, x = np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")
    point = np.array([[AT_MM * np.cos(0.7), AT_MM * np.sin(0.7)]])
    steps = round(6.0e-6 / solver.dt_s)
    trace = solver.forward(np.exp(-(x**2 + y**2) / (2 * WIDTH_MM**2)), receivers(grid, point), steps)[0]
    every = max(1, steps // 120)
    truth = heard(np.arange(0, steps, every) * solver.dt_s, AT_MM)
    return float(np.linalg.norm(trace[::every] - truth) / np.linalg.norm(truth))


def timed(run: Callable[[], object]) -> tuple[float, float]:
    """(wall, CPU of the busier of the two threads), the better of two runs."""
    best = []
    for _ in range(2):
        wall, own, both = time.perf_counter(), time.thread_time(), time.process_time()
        run()
        own, both = time.thread_time() - own, time.process_time() - both
        best.append((time.perf_counter() - wall, max(own, both - own)))
    return min(best)


def convergence() -> Figure:
    cells = (0.4, 0.32, 0.25, 0.2, 0.16, 0.125, 0.1)
    single, double = ([error(dx, kind) for dx in cells] for kind in (np.float32, np.float64))
    courants = (0.05, 0.1, 0.2, 0.3, 0.4)
    times = [error(0.125, np.float64, courant) for courant in courants]

    def draw(figure: Any) -> None:
        left, right = figure.subplots(1, 2)
        per_width = WIDTH_MM / np.array(cells)
        left.loglog(per_width, single, "o-", label="float32")
        left.loglog(per_width, double, "s--", label="float64")
        left.axhline(5e-6, color="0.5", lw=0.8, ls=":", label="asked")
        left.set(xlabel="cells per standard deviation of the Gaussian", ylabel="relative L2 error of a trace")
        left.set_title("how many cells it takes", fontsize=10)
        left.set_xticks([1, 1.5, 2, 3, 4], ["1", "1.5", "2", "3", "4"], minor=False)
        left.minorticks_off()
        left.legend()
        right.semilogy(courants, times, "o-")
        right.axhline(5e-6, color="0.5", lw=0.8, ls=":")
        right.set(xlabel="c dt / dx", ylabel="relative L2 error of a trace", ylim=(1e-7, 1e-4))
        right.set_title("step of time: stability limits it, accuracy does not", fontsize=10)

    return Figure({"float32": single[-1], "float64": double[-1], "coarsest": double[0]}, draw, (10, 3.8))


def rows() -> list[Row]:
    exact = keep("solver_convergence", convergence())
    grid = SoundGrid((300, 300), 0.1)
    solver = Solver(grid, Medium(SPEED))
    y, x = np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")
    source = np.exp(-(x**2 + y**2) / (2 * 0.5**2))
    cells, angles = rim(grid, 12.0)
    ears = receivers(grid, 12.0 * np.stack([np.cos(angles[::16]), np.sin(angles[::16])], axis=1))
    traces = np.zeros((len(cells), 859))
    busy = os.getloadavg()[0]
    forward, reverse = (timed(lambda: solver.forward(source, ears, 859)), timed(lambda: solver.reverse(traces, cells)))
    free = busy < 1.0
    note = "" if free else f"; other work at the time, load {busy:.1f}: judged by CPU"

    def clock(what: str, asked: float, taken: tuple[float, float], known: str) -> Row:
        judged = taken[0] if free else taken[1]
        return Row(
            what,
            known,
            f"<= {asked:g} s on 2 cores",
            f"{taken[0]:.1f} s, {taken[1]:.1f} s CPU of the busier thread{note}",
            judged <= asked,
        )

    return [
        Row(
            "a Gaussian's sound, float32: relative L2 error",
            "-",
            "<= 5e-6",
            f"{exact['float32']:.1e}",
            exact["float32"] <= 5e-6,
            theory="0",
        ),
        Row("the same in float64", "-", "<= 5e-6", f"{exact['float64']:.1e}", exact["float64"] <= 5e-6, theory="0"),
        clock("300 x 300 cells, 859 steps, forward", 3.0, forward, "-"),
        clock("300 x 300 cells, 859 steps, time reversal", 2.0, reverse, "-"),
        beside_kwave(lambda: solver.forward(source, ears, 859)),
    ]


def beside_kwave(own: Callable[[], object]) -> Row:
    """The NumPy solver of k-wave-python on the same 300 x 300 cells, 20 at each edge a layer that absorbs, float32, in
    turn with ours, by processor. It is no dependency (it asks for an older NumPy, and another OpenCV): where it is
    installed, and without its `__init__`, which fetches binaries that this solver does not use."""
    what = "k-wave-python's NumPy solver, the same run, in turn"
    try:
        if (spec := importlib.util.find_spec("kwave")) is not None and "kwave" not in sys.modules:
            sys.modules["kwave"] = module = types.ModuleType("kwave")
            module.__path__, module.__version__ = list(spec.submodule_search_locations or []), ""
        from kwave.kgrid import kWaveGrid
        from kwave.kmedium import kWaveMedium
        from kwave.ksensor import kSensor
        from kwave.ksource import kSource
        from kwave.kspaceFirstOrder import kspaceFirstOrder
    except Exception as reason:  # whatever the import of a stranger may end in
        return Row(what, "-", "3 times slower", f"not installed here ({type(reason).__name__}): not compared")
    grid = kWaveGrid([260, 260], [1e-4, 1e-4])
    grid.setTime(859, 0.3e-4 / SPEED)
    source, sensor = kSource(), kSensor()
    source.p0 = np.exp(-(grid.x**2 + grid.y**2) / (2 * (0.5e-3) ** 2))
    sensor.mask = np.hypot(grid.x, grid.y) > 11.9e-3

    def theirs() -> object:
        medium = kWaveMedium(sound_speed=SPEED)
        return kspaceFirstOrder(grid, medium, source, sensor, smooth_p0=False, dtype=np.float32, quiet=True)

    taken: dict[Callable[[], object], list[float]] = {own: [], theirs: []}
    for _ in range(3):
        for run, seconds in taken.items():
            began = time.process_time()
            run()
            seconds.append(time.process_time() - began)
    ours, other = min(taken[own]), min(taken[theirs])
    return Row(
        what, "-", "3 times slower", f"{other:.1f} s CPU to {ours:.1f}, {other / ours:.1f} times", other >= 3 * ours
    )
