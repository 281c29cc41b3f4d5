"""Images of a source that the solver never saw on its own grid, and what is refused before one is made."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.agreement import disagreeing, search_sound_speed
from annulus_pipe.wings.tai.measure.field import Medium, Solver, SoundGrid, receivers
from annulus_pipe.wings.tai.measure.imaging import Region, back_projection, pixel_mm, time_reversal
from annulus_pipe.wings.tai.measure.sweep import Sweep, examine, gaps_deg, usable, without_coupling

C, RADIUS = 1500.0, 12.0
DISCS = ((0.0, 0.0, 8.0, 0.4), (-3.0, -2.0, 1.8, 0.6), (3.5, 1.5, 1.1, 0.6), (0.0, 4.5, 0.9, 0.4))


def body(x, y, dx):
    return sum(value * np.clip((size - np.hypot(x - cx, y - cy)) / dx + 0.5, 0, 1) for cx, cy, size, value in DISCS)


@pytest.fixture(scope="module")
def sweep():
    """50 positions; a finer grid than any image's, and off its cells."""
    grid = SoundGrid((224, 224), 0.15)
    shift = np.array([0.031, 0.017])
    y, x = np.meshgrid(grid.y_mm + shift[1], grid.x_mm + shift[0], indexing="ij")
    angles = np.arange(50) * 7.2
    points = RADIUS * np.stack([np.cos(np.radians(angles)), np.sin(np.radians(angles))], axis=1) - shift
    solver = Solver(grid, Medium(C))
    steps = int(2.3e-3 * RADIUS / C / solver.dt_s)
    source = gaussian_filter(body(x, y, 0.15), 0.2 / 0.15)
    traces = solver.forward(source, receivers(grid, points), steps)
    return Sweep(traces, angles, RADIUS, 1 / solver.dt_s, 0.0, C)


def quality(image):
    """(PSNR in dB, correlation) inside the circle, against the source at the image's own pixels."""
    dx = image.x_mm[1] - image.x_mm[0]
    y, x = np.meshgrid(image.y_mm, image.x_mm, indexing="ij")
    inside = np.hypot(x, y) < RADIUS - 0.6
    truth = gaussian_filter(body(x, y, dx), 0.2 / dx)[inside]
    found = image.values[inside]
    return 10 * np.log10(truth.max() ** 2 / np.mean((found - truth) ** 2)), np.corrcoef(found, truth)[0, 1]


@pytest.mark.deep(gate="tests/wings/tai/test_imaging.py::test_a_region_of_the_image_is_the_image_there")
def test_fifty_positions_make_a_faithful_image(sweep):
    psnr, correlation = quality(time_reversal(sweep, pixel=0.2))
    assert psnr >= 31
    assert correlation >= 0.997


@pytest.mark.deep(gate="tests/wings/tai/test_imaging.py::test_the_speed_of_sound_is_found_in_noise")
def test_refinement_fills_in_for_a_missing_half(sweep):
    half = sweep.only(sweep.angles_deg <= 180)
    assert gaps_deg(half.angles_deg) == [(180.0, 360.0)]
    plain = quality(time_reversal(half, pixel=0.25))[0]
    refined = time_reversal(half, pixel=0.25, refinements=3, nonnegative=True)
    assert quality(refined)[0] > plain + 6
    assert refined.misfit[-1] < 0.5 * refined.misfit[0]


@pytest.mark.deep(gate="tests/wings/tai/test_imaging.py::test_the_pulse_that_couples_in_is_not_sound")
def test_refinement_that_does_not_help_is_not_kept(sweep):
    once, more = (time_reversal(sweep, pixel=0.3, refinements=n) for n in (0, 3))
    assert quality(more)[0] >= quality(once)[0] - 0.1


def test_the_quick_look_shows_the_same_things(sweep):
    quick = back_projection(sweep, pixel=0.3)
    y, x = np.meshgrid(quick.y_mm, quick.x_mm, indexing="ij")
    inside = np.hypot(x, y) < RADIUS - 1
    assert np.corrcoef(quick.values[inside], body(x, y, 0.3)[inside])[0, 1] > 0.75


def test_the_speed_of_sound_is_found_in_noise(sweep):
    noise = np.random.default_rng(3).standard_normal(sweep.signals.shape) * 0.2 * sweep.signals.std()
    noisy = replace(sweep, signals=sweep.signals + noise)
    best, other = search_sound_speed(noisy, 1380.0, 1620.0)
    assert best.arrival == "plane"
    assert abs(best.sound_speed_m_s / C - 1) < 0.002
    assert other.sound_speed_m_s / C - 1 < -0.005  # what taking it for sound in space would have cost
    assert disagreeing(noisy, "plane") == []
    noisy.signals[21] = -noisy.signals[21]
    assert [one[0] for one in disagreeing(noisy, "plane")] == [21]
    with pytest.raises(AnnulusError, match="widen the range"):
        search_sound_speed(sweep, 1515.0, 1600.0)


def test_a_region_of_the_image_is_the_image_there(sweep):
    whole = time_reversal(sweep, pixel=0.4)
    part = time_reversal(sweep, pixel=0.4, region=Region(-5.0, 0.5, -4.0, 3.0))
    rows, columns = (np.isin(a, b) for a, b in ((whole.y_mm, part.y_mm), (whole.x_mm, part.x_mm)))
    assert np.array_equal(part.values, whole.values[np.ix_(rows, columns)])
    assert (part.x_mm >= -5.0).all() and (part.x_mm <= 0.5).all() and len(part.x_mm) == 14


def test_a_late_start_and_a_high_rate_change_nothing(sweep):
    """The same sound, twice as many samples, the first tenth never recorded."""
    plain = quality(time_reversal(sweep, pixel=0.3))[0]
    times = sweep.times_s
    late = times[len(times) // 10]
    rate = 2 * sweep.sampling_rate_hz
    again = np.arange(late, times[-1], 1 / rate)
    signals = np.stack([np.interp(again, times, trace) for trace in sweep.signals])
    moved = Sweep(signals, sweep.angles_deg + 360, RADIUS, rate, late, C)
    assert quality(time_reversal(moved, pixel=0.3))[0] > plain - 1.5


def test_bad_traces_are_named_and_left_out(sweep):
    signals = sweep.signals.copy()
    signals[3, 40] = np.nan
    signals[7] = np.clip(signals[7], -0.4 * np.abs(signals[7]).max(), 0.4 * np.abs(signals[7]).max())
    signals[11] *= 0.01
    signals[20] = signals[19]
    faults = examine(replace(sweep, signals=signals))
    named = {fault.kind: fault.positions for fault in faults}
    assert named == {"not a number": (3,), "clipped": (7,), "silent": (11,), "same place": (20,)}
    kept = usable(sweep, faults)
    assert list(np.flatnonzero(~kept)) == [3, 7, 11, 20]
    assert quality(time_reversal(sweep.only(kept), pixel=0.3))[0] > 28
    assert examine(sweep) == []


def test_a_round_object_is_not_a_stage_that_stands_still():
    times = np.arange(600) / 25e6
    trace = np.exp(-(((times - 8e-6) / 4e-7) ** 2))
    noise = np.random.default_rng(5).standard_normal((24, 600))
    assert examine(Sweep(trace + 0.01 * noise, np.arange(24) * 15.0, RADIUS, 25e6)) == []


def test_a_wrong_sampling_rate_is_noticed(sweep):
    for wrong in (0.4, 6.0):
        kinds = [f.kind for f in examine(replace(sweep, sampling_rate_hz=wrong * sweep.sampling_rate_hz))]
        assert "timing" in kinds


def test_the_pulse_that_couples_in_is_not_sound(sweep):
    """A spike forty times the sound at time 0, with a tail that reaches into the record."""
    spike = 40 * np.abs(sweep.signals).max() * np.exp(-sweep.times_s / 6e-7)
    loud = replace(sweep, signals=sweep.signals + spike)
    clean = quality(time_reversal(sweep, pixel=0.3))[0]
    assert quality(time_reversal(without_coupling(loud, 9.0), pixel=0.3))[0] > clean - 2
    assert quality(time_reversal(loud, pixel=0.3))[0] < 15


def test_bad_input_is_one_line(sweep):
    with pytest.raises(AnnulusError, match="angles_deg"):
        Sweep(sweep.signals, sweep.angles_deg[:-1], RADIUS, 1e7)
    with pytest.raises(AnnulusError, match="sampling_rate_hz"):
        replace(sweep, sampling_rate_hz=float("nan"))
    with pytest.raises(AnnulusError, match="at least 3"):
        time_reversal(sweep.only([0, 1]))
    with pytest.raises(AnnulusError, match="a pixel of"):
        time_reversal(sweep, pixel=0.001)
    with pytest.raises(AnnulusError, match="none of the"):
        time_reversal(replace(sweep, t0_s=0.5), pixel=0.5)
    assert 0.1 < pixel_mm(sweep) < 0.6
