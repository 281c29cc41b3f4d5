"""Promises under every fault at once: no wrong lamp, no wrong place, little unknown, and back within a few frames."""

from dataclasses import replace

import pytest

from annulus_pipe.link.pins import pins_of
from annulus_pipe.twin.profiles import profile_of
from annulus_pipe.twin.soak import soak

pytestmark = pytest.mark.deep(
    gate="tests/unit/twin/test_soak.py::test_no_label_is_wrong_under_drops_lost_events_jitter_and_two_resets"
)
FRAMES = 50_000
ACTIVE_LOW = pins_of("sync,projector,led")


@pytest.mark.timeout(600)  # 13 s of two idle cores: what takes that long hangs
def test_no_lamp_and_no_place_is_wrong_under_every_fault_and_little_is_unknown() -> None:
    result = soak(FRAMES, seed=1, faults="all", jobs=None, world_frames=FRAMES // 2)
    assert (result["wrong_lamps"], result["wrong_places"]) == (0, 0), result["wrong_ones"]
    assert result["unknown"] <= 0.025 * FRAMES
    assert result["relock_frames_max"] <= 8, result["relock_worst"]
    assert result["untold"] == result["z_beyond_bound"] == 0
    assert 0 < result["z_assumed"] < 0.1 * FRAMES


@pytest.mark.timeout(600)
def test_no_label_is_wrong_on_a_head_of_active_low_lamps_and_a_sync_that_rises() -> None:
    result = soak(20_000, seed=1, faults="all", pins=ACTIVE_LOW)
    assert (result["wrong_lamps"], result["wrong_places"]) == (0, 0), result["wrong_ones"]
    assert result["unknown"] <= 0.025 * 20_000 and result["untold"] == 0


@pytest.mark.timeout(600)
@pytest.mark.parametrize("trigger", ["xtrig", "pulse_on_sync"])
def test_no_label_is_wrong_where_the_controller_triggers_the_camera(trigger: str) -> None:
    result = soak(20_000, seed=1, faults="all", trigger=trigger)
    assert (result["wrong_lamps"], result["wrong_places"]) == (0, 0), result["wrong_ones"]
    assert result["unknown"] <= 0.03 * 20_000 and result["untold"] == 0


@pytest.mark.timeout(600)
def test_no_label_is_wrong_where_an_interrupt_sets_the_sync_some_tens_of_us_late() -> None:
    """cam1_sync: each lit frame was lit evenly, so that no late flash left the window either."""
    faults = replace(profile_of("all").place(20_000, 1), sync_late_us=40.0)
    result = soak(20_000, seed=1, faults=faults)
    assert (result["wrong_lamps"], result["wrong_places"]) == (0, 0), result["wrong_ones"]
    assert result["unknown"] <= 0.03 * 20_000 and result["untold"] == 0
