"""Heights from fringes, in mm against a plate whose height is known."""

from dataclasses import replace

import numpy as np
import pytest
from plates import DISTANCE_MM, LEFT, RIGHT, SLIDE, drawn

from annulus_pipe.geometry.camera import Camera
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import FringeView, Points, heights, merged, noise_of, spline, untextured
from annulus_pipe.wings.fringe.measure.track import AMBIGUOUS, GOOD, TOO_FEW, UNDETERMINED, UNMODULATED

EVEN = np.arange(8) * 1.0
UNEVEN = np.array([0.0, 0.46, 1.16, 2.62, 3.79, 4.27, 5.23, 6.25])
GRID = Points.plate(np.arange(0.0, 30.0, 0.5), np.arange(-12.0, 12.0, 0.5), DISTANCE_MM)


def view(moved: FloatArray, head=LEFT) -> FringeView:  # type: ignore[no-untyped-def]
    return FringeView.of(head, SLIDE, moved[:, None] * [1.0, 0.0, 0.0])


@pytest.mark.parametrize("moved", [EVEN, UNEVEN, EVEN[:3], EVEN[:4]])
@pytest.mark.parametrize("height", [-3.0, 0.0, 4.0])
def test_a_plain_plate_is_where_it_is(moved: FloatArray, height: float) -> None:
    found = heights(view(moved), spline(drawn(moved, height)), GRID)
    assert (found.flag == GOOD).all()
    np.testing.assert_allclose(found.height_mm, height, atol=0.006)  # pixels average their square
    np.testing.assert_allclose(found.modulation, 0.8, rtol=0.02)


def test_samples_without_noise_are_exact() -> None:
    """On the projector's side: under the projector itself the phase does not change with height."""
    grid = GRID.some(np.flatnonzero(GRID.base[:, 0] < 12))
    h = np.linspace(-5, 5, len(grid.base))
    x = grid.at(h)
    samples = np.stack([100 + 70 * np.cos(SLIDE.phase(x - [s, 0, 0])) for s in UNEVEN])
    found = heights(view(UNEVEN), samples[..., None], grid, tolerance_mm=1e-9)
    np.testing.assert_allclose(found.height_mm, h, atol=1e-6)


def test_harmonics_are_followed_with_the_slope_that_they_have() -> None:
    grid = GRID.some(np.flatnonzero(GRID.base[:, 0] < 12)[::40])
    slide = replace(SLIDE, harmonics=(0.1, -0.05, 0.02, 0.03))
    own = FringeView.of(LEFT, slide, UNEVEN[:, None] * [1.0, 0.0, 0.0])
    h, step = np.linspace(-5, 5, len(grid.base)), 1e-4

    def wave(at: FloatArray) -> FloatArray:
        return np.stack([own.wave(own.phase(grid.at(at), n)) for n in range(len(UNEVEN))])

    found = heights(own, (100 + 70 * wave(h))[..., None], grid, noise=(1.0, 0.0, 0.0), tolerance_mm=1e-9)
    np.testing.assert_allclose(found.height_mm, h, atol=1e-6)
    tangent = 70 * (wave(h + step) - wave(h - step)) / (2 * step)
    design = np.stack([np.ones_like(tangent), wave(h), tangent], axis=-1)
    information = np.einsum("npi,npj->pij", design, design)
    np.testing.assert_allclose(found.sigma_mm, np.sqrt(np.linalg.inv(information)[:, 2, 2]), rtol=1e-4)


@pytest.mark.parametrize("moved", [EVEN, UNEVEN])
def test_sigma_is_the_scatter(moved: FloatArray) -> None:
    images = spline(drawn(moved, 1.5, noise=1.5, texture=0.3))
    first = heights(view(moved), images, GRID)
    found = heights(view(moved), images, GRID, noise=noise_of(first))
    inside = np.abs(found.height_mm - 1.5) < 2 * found.sigma_mm
    assert 0.92 <= inside.mean() <= 0.985
    assert found.sigma_mm.mean() < 0.06


def test_noise_is_found() -> None:
    images = spline(drawn(EVEN, noise=1.5, texture=0.3))
    a, b, c = noise_of(heights(view(EVEN), images, GRID))
    assert 0.8 * 1.5 < np.sqrt(a + b * 90 + c * 90**2) < 1.05 * 1.5  # of a sample: a spline between pixels averages


def test_what_texture_and_blur_do_to_the_phase_is_taken_out() -> None:
    images = spline(drawn(EVEN, texture=0.3, blur_px=1.2))
    found = heights(view(EVEN), images, GRID)
    better, blur = untextured(view(EVEN), GRID, found)
    assert blur == pytest.approx(1.2 * DISTANCE_MM / 300, rel=0.1)
    assert np.std(better.height_mm) < 0.35 * np.std(found.height_mm)


def test_two_cameras_agree_and_are_better_together() -> None:
    one, two = (
        heights(view(EVEN, head), spline(drawn(EVEN, 2.0, noise=1.5, head=head, seed=s)), GRID, noise=(2.25, 0.0, 0.0))
        for s, head in enumerate((LEFT, RIGHT))
    )
    both = merged([one, two])
    told = np.isfinite(one.height_mm) & np.isfinite(two.height_mm)
    assert told.mean() > 0.5
    assert np.std(both.height_mm[told]) < 0.8 * min(np.std(h.height_mm[told]) for h in (one, two))
    assert np.isfinite(both.height_mm).sum() >= max(np.isfinite(h.height_mm).sum() for h in (one, two))


def test_where_the_cameras_disagree_the_better_fit_stays_and_sigma_says_so() -> None:
    one = heights(view(EVEN), spline(drawn(EVEN, 2.0)), GRID)
    wrong = replace(one, height_mm=one.height_mm + 1.0, misfit=one.misfit + 50)
    both = merged([wrong, one])
    np.testing.assert_allclose(both.height_mm, one.height_mm)
    assert (both.sigma_mm >= 0.5).all()


def test_parallax_decides_the_order() -> None:
    """The start is a period (19 mm) off, the bounds admit three: the texture moves as one of them says."""
    images = spline(drawn(EVEN, 2.0, noise=1.0, texture=0.3))
    found = heights(view(EVEN), images, GRID, 21.0, bounds_mm=(-30.0, 30.0))
    assert np.isfinite(found.height_mm).mean() > 0.9
    assert (np.abs(found.height_mm[np.isfinite(found.height_mm)] - 2.0) < 0.25).mean() > 0.99


def test_a_flat_wall_without_texture_looks_alike_in_every_order() -> None:
    """Fringes stand still in the image of such a wall, however the head moves."""
    found = heights(view(EVEN), spline(drawn(EVEN, 2.0, noise=1.0)), GRID, bounds_mm=(-30.0, 30.0))
    assert (found.flag == AMBIGUOUS).mean() > 0.99


def test_an_order_that_nothing_decides_is_ambiguous() -> None:
    """Three frames 0.6 mm apart of a plain plate: no parallax, and no neighbour knows better."""
    moved = np.array([0.0, 0.6, 1.2])
    found = heights(view(moved), spline(drawn(moved, 2.0, noise=1.0)), GRID, bounds_mm=(-30.0, 30.0))
    assert (found.flag == AMBIGUOUS).all()
    assert np.isnan(found.height_mm).all()


def test_a_coarse_height_decides_what_parallax_cannot() -> None:
    moved = np.array([0.0, 0.6, 1.2])
    found = heights(view(moved), spline(drawn(moved, 2.0, noise=1.0)), GRID, bounds_mm=(-6.0, 6.0))
    assert np.isfinite(found.height_mm).mean() > 0.99
    assert np.median(found.height_mm) == pytest.approx(2.0, abs=0.1)


def test_neighbours_decide_what_parallax_cannot() -> None:
    """Half of the plate is known within 6 mm, the other half not at all."""
    moved = np.array([0.0, 0.6, 1.2])
    low = np.where(GRID.base[:, 0] < 15, -6.0, -30.0)
    found = heights(view(moved), spline(drawn(moved, 2.0, noise=0.5)), GRID, bounds_mm=(low, -low))
    assert np.isfinite(found.height_mm).mean() > 0.98
    assert np.nanmax(np.abs(found.height_mm - 2.0)) < 1.0


def test_saturated_pixels_are_left_out() -> None:
    images = drawn(EVEN, 1.0, texture=0.3)
    images[images > 200] = np.nan
    found = heights(view(EVEN), spline(images), GRID)
    assert 3 <= found.used[found.flag == GOOD].min() < 8
    assert np.nanmedian(np.abs(found.height_mm - 1.0)) < 0.02
    assert found.used[found.flag == TOO_FEW].size == 0 or found.used[found.flag == TOO_FEW].max() < 3


def test_a_motion_of_whole_periods_determines_nothing() -> None:
    found = heights(view(np.arange(4) * 4.0), spline(drawn(np.arange(4) * 4.0)), GRID)
    sure = found.flag == GOOD
    assert not (sure & (found.sigma_mm < 0.2)).any()
    assert (found.flag[~sure] >= UNMODULATED).all() or (found.flag[~sure] == UNDETERMINED).any()


def test_a_wall_without_fringes_has_no_height() -> None:
    flat = np.random.default_rng(0).normal(90, 1, (8, 120, 320)).astype(np.float32)
    found = heights(view(EVEN), spline(flat), GRID, noise=(1.0, 0.0, 0.0))
    assert np.isfinite(found.height_mm).mean() < 0.01


def test_what_cannot_be_measured_is_refused_in_one_line() -> None:
    with pytest.raises(AnnulusError, match="2 frames"):
        view(EVEN[:2])
    with pytest.raises(AnnulusError, match="did not move"):
        view(np.zeros(4))
    with pytest.raises(AnnulusError, match="8 images for 4 positions"):
        heights(view(EVEN[:4]), spline(drawn(EVEN)), GRID)
    lens = Camera("pinhole", 320, 120, 300.0, 300.0, 159.5, 59.5, (0.0,) * 7 + (0.1,))
    with pytest.raises(AnnulusError, match="8 coefficients"):
        view(EVEN, replace(LEFT, camera=lens))


def test_a_point_whose_samples_led_nowhere_is_begun_again_from_its_neighbours_with_its_own_samples() -> None:
    grid = Points.plate(np.arange(0.0, 12.0, 0.5), np.arange(-12.0, 12.0, 0.5), DISTANCE_MM)
    h = np.linspace(-2.0, 2.0, len(grid.base))
    samples = np.stack([100 + 70 * np.cos(SLIDE.phase(grid.at(h) - [s, 0, 0])) for s in UNEVEN])
    start, lost = np.zeros(len(h)), [300, 700]
    start[lost] = DISTANCE_MM - 1.0  # a mm before the head
    found = heights(view(UNEVEN), samples[..., None], grid, start, tolerance_mm=1e-9)
    np.testing.assert_allclose(found.height_mm, h, atol=1e-6)
