"""Promises of the plateau: found where it is, whatever head.toml says, and no flash proposed that bands."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.capture.plateau import Reading, confirmed, deviations, find, shares
from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.vocabulary import AnnulusError

HEIGHT, BANDS = 1232, 64
TOLD = FrameTiming(25.0, 38_000.0, 25_000.0)


def seen(true: FrameTiming, delays: list[float], width: float, seed: int, noise: float = 0.005) -> list[Reading]:
    """What a rolling shutter shows of a wall with texture, with noise."""
    rng = np.random.default_rng(seed)
    texture = 100.0 * (0.2 + np.random.default_rng(seed // 2).random(BANDS))
    dark = [Reading(at, width, np.zeros(BANDS)) for at in delays]
    share = shares(dark, true.opens_us, true.closes_us, true.readout_us, true.period_us, HEIGHT)
    light = 2.0 + texture * share * (1.0 + noise * rng.standard_normal(share.shape))
    return [Reading(one.delay_us, width, row) for one, row in zip(dark, light, strict=True)]


def stepped(width: float) -> list[float]:
    return [float(at) for at in np.linspace(0.0, TOLD.closes_us + 8000.0 - width, 14)]


@settings(deadline=None, max_examples=5)
@given(
    st.floats(21_000.0, 29_000.0),
    st.floats(36_000.0, 39_000.0),
    st.floats(500.0, 4000.0),
    st.integers(0, 99),
    st.floats(0.0, 16_000.0),
)
def test_edges_are_found_and_what_is_proposed_does_not_band(
    readout: float, exposure: float, width: float, seed: int, delay: float
) -> None:
    true = FrameTiming(25.0, exposure, readout)
    found = find(seen(true, stepped(width), width, seed), TOLD, delay, width, HEIGHT)
    if found.opens_k2_us is not None:  # 1 ms of dead time is 3 % of the rows
        assert abs(found.opens_us - true.opens_us) < 60.0
    assert found.closes_k2_us is not None and abs(found.closes_us - true.closes_us) < 60.0
    true.check_flash(found.delay_us, found.width_us)
    (tried,) = seen(true, [found.delay_us], found.width_us, seed, noise=0.0)
    assert deviations(tried.light - 2.0, found.full).max() < 0.02
    assert confirmed(found, tried).banding is not None


def test_a_flash_that_fits_is_kept_and_one_that_is_too_long_shortened() -> None:
    readings = seen(TOLD, stepped(2000.0), 2000.0, 1)
    kept = find(readings, TOLD, 4000.0, 2000.0, HEIGHT)
    assert (kept.delay_us, kept.width_us) == (4000.0, 2000.0) and "fits" in kept.why
    assert find(readings, TOLD, 4000.0, 50_000.0, HEIGHT).width_us == pytest.approx(13_000.0, abs=150.0)


def test_what_says_nothing_is_refused_in_a_line() -> None:
    delays = stepped(2000.0)
    good = seen(TOLD, delays, 2000.0, 1)
    dark = [Reading(at, 2000.0, np.full(BANDS, 2.0)) for at in delays]
    bright = [Reading(one.delay_us, one.width_us, one.light, 0.3) for one in good]
    moved = [*good, Reading(good[5].delay_us, 2000.0, good[5].light * 0.8)]
    flicker = [Reading(one.delay_us, 2000.0, one.light * (0.5 + n % 2)) for n, one in enumerate(good)]
    for readings, why in (
        (dark, "dark whatever the delay"),
        (bright, "saturated"),
        (moved, "the scene changed"),
        (flicker, "does not follow the delay"),
        (good[:3], "at least 6"),
    ):
        with pytest.raises(AnnulusError, match=why) as told:
            find(readings, TOLD, 4000.0, 2000.0, HEIGHT)
        assert "\n" not in str(told.value)
    closed = FrameTiming(25.0, 30_000.0, 35_000.0)
    with pytest.raises(AnnulusError, match="no delay lights all rows"):
        find(seen(closed, stepped(2000.0), 2000.0, 3), TOLD, 4000.0, 2000.0, HEIGHT)


def test_a_proposed_flash_that_bands_when_it_is_tried_is_not_proposed() -> None:
    found = find(seen(TOLD, stepped(2000.0), 2000.0, 1), TOLD, 4000.0, 2000.0, HEIGHT)
    (tried,) = seen(TOLD, [found.delay_us], 2000.0, 1)
    light = tried.light.copy()
    light[:4] *= 0.8
    with pytest.raises(AnnulusError, match="bands of"):
        confirmed(found, Reading(found.delay_us, 2000.0, light))
