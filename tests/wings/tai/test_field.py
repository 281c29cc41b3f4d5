"""The solver against what is known in closed form."""

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.special import j0

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.field import Medium, Solver, SoundGrid, receivers, rim, time_step_s

C = 1500.0


def gaussian(grid, width_mm):
    y, x = np.meshgrid(grid.y_mm, grid.x_mm, indexing="ij")
    return np.exp(-(x**2 + y**2) / (2 * width_mm**2))


def gaussian_heard(width_mm, at_mm, times_s):
    """Pressure of a Gaussian at rest at time 0 in a plane: the integral over wave numbers, mm."""
    k = np.linspace(0.0, 12.0 / width_mm, 20001)
    spectrum = width_mm**2 * np.exp(-((k * width_mm) ** 2) / 2) * k
    return np.array([simpson(spectrum * np.cos(1e3 * C * t * k) * j0(k * at_mm), x=k) for t in times_s])


def error(found, truth):
    return np.linalg.norm(found - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize(("dtype", "bound"), [(np.float32, 5e-6), (np.float64, 3e-6)])
def test_a_gaussian_sounds_as_theory_says(dtype, bound):
    """Through the absorbing layer and to the end of the record; on a cell and between cells."""
    grid = SoundGrid((160, 144), 0.1)
    solver = Solver(grid, Medium(C), dtype=dtype)
    points = np.array([[grid.x_mm[100], grid.y_mm[80]], [2.317, -1.773]])
    traces = solver.forward(gaussian(grid, 0.4), receivers(grid, points), steps=420)
    times = np.arange(0, 420, 7) * solver.dt_s
    for point, trace in zip(points, traces, strict=True):
        assert error(trace[::7], gaussian_heard(0.4, np.hypot(*point), times)) < bound


def test_a_pulse_of_any_shape_is_the_same_as_its_convolution():
    """p with I(t) is the integral over I of the initial value problem, half a step apart."""
    grid = SoundGrid((128, 128), 0.1)
    solver = Solver(grid, Medium(C), dtype=np.float64)
    ears = receivers(grid, np.array([[3.0, 1.0]]))
    envelope = np.zeros(60)
    envelope[:25], envelope[40:50] = 1.0, 1.0
    rise = gaussian(grid, 0.4)
    heard = solver.forward(rise, ears, 260, envelope=envelope)[0]
    # the response to an instant, half a step late, at a quarter of the step
    fine = Solver(grid, Medium(C), solver.dt_s / 2, dtype=np.float64)
    instant = fine.forward(rise, ears, 520)[0]
    expected = np.zeros(260)
    for n, amount in enumerate(envelope):
        late = 2 * np.arange(260) - (2 * n + 1)
        expected += solver.dt_s * amount * np.where(late >= 0, instant[np.clip(late, 0, 519)], 0.0)
    assert error(heard, expected) < 1e-10


@pytest.mark.deep(gate="tests/wings/tai/test_field.py::test_a_gaussian_sounds_as_theory_says")
def test_a_denser_slower_layer_reflects_as_impedances_say():
    """Plane pulse on a step of rho c: (Z2 - Z1) / (Z2 + Z1)."""
    grid = SoundGrid((48, 640), 0.1)
    x = np.broadcast_to(grid.x_mm, grid.shape)
    medium = Medium(np.where(x > 5.0, 2000.0, C), np.where(x > 5.0, 1200.0, 1000.0))
    solver = Solver(grid, medium, dtype=np.float64)
    for kept, added in (("_flow_kept", "_pushed"), ("_part_kept", "_squeezed")):  # a plane wave has no rim across
        across, along = getattr(solver, kept)
        whole, other = getattr(solver, added)
        setattr(solver, kept, (np.ones_like(across), along))
        setattr(solver, added, (whole / np.sqrt(across), other))
    traces = solver.forward(np.exp(-((x + 10.0) ** 2) / 2.0), receivers(grid, np.array([[0.0, 0.0]])), steps=1100)[0]
    times = np.arange(1100) * solver.dt_s * 1e6
    direct, echo = traces[np.abs(times - 6.667) < 2.5].max(), traces[np.abs(times - 13.33) < 2.5].max()
    z1, z2 = 1000 * C, 1200 * 2000
    assert direct == pytest.approx(0.5, abs=1e-4)
    assert echo / direct == pytest.approx((z2 - z1) / (z2 + z1), abs=4e-4)


def test_what_leaves_does_not_come_back():
    grid = SoundGrid((96, 96), 0.1)
    solver = Solver(grid, Medium(C), dtype=np.float64)
    steps = 900
    trace = solver.forward(gaussian(grid, 0.5), receivers(grid, np.array([[2.0, 0.0]])), steps)[0]
    times = np.arange(steps) * solver.dt_s
    tail = times > 12e-6
    assert np.abs(trace[tail] - gaussian_heard(0.5, 2.0, times[tail])).max() < 1e-9 * np.abs(trace).max()


def test_reversed_time_brings_the_source_back():
    grid = SoundGrid((120, 120), 0.12)
    solver = Solver(grid, Medium(C))
    source = gaussian(grid, 0.6)
    cells, angles = rim(grid, 4.5)
    points = np.stack([np.tile(grid.x_mm, 120)[cells], np.repeat(grid.y_mm, 120)[cells]], axis=1)
    assert np.allclose(np.arctan2(points[:, 1], points[:, 0]), angles)
    traces = solver.forward(source, receivers(grid, points), steps=340)
    back = solver.reverse(traces, cells)
    assert error(back[40:80, 40:80], source[40:80, 40:80]) < 0.03


def test_a_face_hears_the_mean_of_its_points():
    grid = SoundGrid((80, 80), 0.1)
    field = np.random.default_rng(1).random(grid.shape)
    face = np.array([[[0.11, 0.2], [0.5, -0.3]]])
    apart = receivers(grid, face[0]) @ field.ravel()
    assert (receivers(grid, face) @ field.ravel())[0] == pytest.approx(apart.mean())


def test_bad_input_is_one_line():
    grid = SoundGrid((80, 80), 0.1)
    with pytest.raises(AnnulusError, match="outside the grid"):
        receivers(grid, np.array([[9.0, 0.0]]))
    with pytest.raises(AnnulusError, match="too long"):
        Solver(grid, Medium(C), 3 * time_step_s(grid, Medium(C)))
    with pytest.raises(AnnulusError, match="positive"):
        Solver(grid, Medium(np.full(grid.shape, np.nan)))
    with pytest.raises(AnnulusError, match="does not fit"):
        rim(grid, 5.0)
    with pytest.raises(AnnulusError, match="cells"):
        SoundGrid((20, 20), 0.1)
    solver = Solver(grid, Medium(C))
    with pytest.raises(AnnulusError, match="source"):
        solver.forward(np.zeros((3, 3)), receivers(grid, np.zeros((1, 2))), 5)
    with pytest.raises(AnnulusError, match="one each"):
        solver.reverse(np.zeros((3, 9)), np.arange(4))
