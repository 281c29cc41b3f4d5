"""The flash window against the source's Eq. 4.1, and what is refused."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.vocabulary import AnnulusError


def test_the_window_at_25_fps_is_2_to_12_ms() -> None:
    timing = FrameTiming(25, 38_000, 28_000)
    assert (timing.opens_us, timing.closes_us) == (2_000, 12_000)
    timing.check_flash(2_000, 10_000)


def test_a_flash_outside_is_refused_with_both_intervals() -> None:
    with pytest.raises(AnnulusError, match=r"flash 100\.\.20100 us leaves the window 2000\.\.12000 us .*25 fps"):
        FrameTiming(25, 38_000, 28_000).check_flash(100, 20_000)


@given(
    fps=st.floats(5, 60),
    exposure=st.floats(0.1, 1),
    readout=st.floats(0, 1),
    start=st.floats(0, 1),
    width=st.floats(1e-4, 1),
)
def test_an_accepted_flash_lies_inside_every_rows_exposure(
    fps: float, exposure: float, readout: float, start: float, width: float
) -> None:
    period = 1e6 / fps
    timing = FrameTiming(fps, max(exposure * period, 1), readout * period)
    try:
        timing.check_flash(start * period, width * period)
    except AnnulusError:
        return
    for row in (0.0, 0.25, 0.5, 1.0):  # first to last; the frame's readout ends one period after the edge
        closes = period - timing.readout_us * (1 - row)
        assert closes - timing.exposure_us <= start * period + 0.01
        assert (start + width) * period <= closes + 0.01


@pytest.mark.parametrize(
    ("fps", "exposure", "readout"), [(0, 1, 1), (25, 41_000, 1), (25, 100, 50_000), (float("nan"), 1, 1)]
)
def test_an_impossible_mode_is_refused(fps: float, exposure: float, readout: float) -> None:
    with pytest.raises(AnnulusError):
        FrameTiming(fps, exposure, readout)


def test_no_window_is_said_so() -> None:
    with pytest.raises(AnnulusError, match="longer than the readout"):
        FrameTiming(25, 20_000, 28_000).check_flash(20_000, 10)
