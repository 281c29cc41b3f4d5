"""Promises of the simulated driver: each fault does what its name says, and to no other frame."""

from typing import Any

import numpy as np
import pytest

from annulus_pipe.capture.timing import FrameTiming
from annulus_pipe.twin.driver import BUFFERS, LAG_US, Delivered, Driver
from annulus_pipe.twin.faults import Faults
from annulus_pipe.twin.image_sensor import HostClock, ImageSensor
from annulus_pipe.twin.profiles import FIRST, PROFILES, load_faults
from annulus_pipe.twin.worlds import clean_world

TIMING = FrameTiming(25.0, 38_000.0, 28_000.0)
WORLD = clean_world().scaled(16)
PERIOD, PERIOD_NS = 4_000_000, 40_000_000
START_NS = 10**9
SOUND = -28_000_000  # V4L2's stamp: the start of the readout


def run(frames: int, seed: int = 1, **faults: Any) -> tuple[list[Delivered], Driver]:
    chosen, clock = Faults(**faults), HostClock(START_NS)
    sensor = ImageSensor(WORLD, TIMING, chosen, seed=seed, clock=clock)
    driver = Driver(chosen, TIMING, seed)
    came = [driver.take(exposure) for exposure in sensor.exposures(sensor.edge(frames - 1))]
    return [frame for frame in came if frame is not None], driver


def late_ns(frame: Delivered) -> int:
    """Its stamp, against that of a sound driver."""
    return frame.timestamp_ns - (START_NS + (frame.number + 1) * PERIOD_NS + SOUND)


def shown(frame: Delivered) -> list[int]:
    return [int(part.exposure.sequence) for part in frame.parts]


def test_a_sound_driver_hands_over_each_picture_once_with_its_own_stamp_and_count() -> None:
    came, driver = run(200)
    assert [(f.sequence, shown(f), late_ns(f)) for f in came] == [(i, [i], 0) for i in range(200)]
    lags = [(f.due_tick - (f.number + 1) * PERIOD) / 100 for f in came]
    assert min(lags) >= LAG_US and max(lags) < 10_000
    assert driver.disturbed == [] and not driver.counts


def test_stamps_step_from_the_named_frame_on_and_stay_there() -> None:
    came, driver = run(40, stamp_steps=((10, 5), (20, -0.5)), stamp_offset_frames=1)
    frames = [late_ns(f) / PERIOD_NS for f in came]
    assert frames == [1.0] * 10 + [6.0] * 10 + [5.5] * 20
    assert driver.disturbed == [("stamp_step", 10), ("stamp_step", 20)]


def test_a_drift_accumulates_and_takes_it_back_when_it_turns() -> None:
    came, _ = run(1000, stamp_drift_ppm=200.0)
    assert late_ns(came[-1]) == pytest.approx(40.0 * 200e-6 * 1e9, rel=1e-6)
    came, _ = run(1000, stamp_drift_ppm=200.0, stamp_drift_turn_s=10.0)
    assert max(map(late_ns, came)) == pytest.approx(2e6, rel=1e-6) and abs(late_ns(came[-1])) < 1e4


def test_single_stamps_are_late_by_whole_frames_or_parts_and_the_next_is_on_time() -> None:
    came, driver = run(2000, stamps_late=0.05)
    late = [late_ns(f) / PERIOD_NS for f in came if late_ns(f)]
    assert 70 <= len(late) <= 130 and 0.1 <= min(late) <= max(late) <= 3.0
    assert {1.0, 2.0, 3.0} < set(late) and driver.counts["stamp_late"] == len(late)


def test_a_repeated_picture_is_the_one_before_under_a_new_stamp_and_count() -> None:
    came, driver = run(1000, frames_repeated=0.05)
    again = [i for i in range(1, 1000) if shown(came[i]) != [i]]
    assert len(again) == driver.counts["repeated"] > 25
    assert all(shown(came[i]) == shown(came[i - 1]) and came[i].sequence == i for i in again)


def test_a_torn_picture_has_the_picture_before_below_this_one() -> None:
    came, _ = run(1000, frames_torn=0.05, frames_repeated=0.02)
    torn = [f for f in came if len(f.parts) > 1]
    assert len(torn) > 25
    for frame in torn:
        assert frame.parts[0].exposure.sequence == frame.number and frame.parts[0].top == 0.0
        assert 0.05 <= frame.parts[0].bottom <= 0.95 and frame.parts[-1].bottom == 1.0
        assert all(a.bottom == b.top for a, b in zip(frame.parts, frame.parts[1:], strict=False))
        assert shown(frame)[1] < frame.number


def test_late_frames_hold_up_those_behind_them_and_none_overtakes() -> None:
    came, driver = run(1000, frames_late=0.02)
    due = np.diff([f.due_tick for f in came])
    assert driver.counts["late"] > 10 and due.min() > 0 and due.max() < 0.55 * 1e8
    assert all(late_ns(f) == 0 for f in came)


def test_a_camera_that_was_away_counts_from_zero_and_shows_nothing_meanwhile() -> None:
    came, driver = run(100, unplugged=((40, 25),))
    assert [f.number for f in came] == [*range(40), *range(65, 100)]
    assert [f.sequence for f in came[40:]] == list(range(35)) and driver.disturbed == [("unplug", 65)]


def test_a_frozen_picture_stays_what_it_was_while_stamps_go_on() -> None:
    came, _ = run(60, frozen=((20, 10),))
    assert [shown(f)[0] for f in came] == [*range(20), *[19] * 10, *range(30, 60)]
    assert all(late_ns(f) == 0 for f in came)


def test_the_count_jumps_and_begins_anew() -> None:
    came, _ = run(60, count_jumps=((20, 3),), count_resets=(40,))
    assert [f.sequence for f in came] == [*range(20), *range(23, 43), *range(20)]


def test_after_a_stall_the_oldest_frames_come_first_and_the_rest_is_lost() -> None:
    came, driver = run(100, stalls=((30, 1.0),))
    numbers = [f.number for f in came]
    assert numbers[30 : 30 + BUFFERS] == [*range(30, 38)] and numbers[38] == 55
    ends = driver.stall_ends((30, 1.0))
    assert all(f.due_tick >= ends for f in came[30:]) and driver.counts["dropped_in_stall"] == 25 - BUFFERS


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("frames", [3000, 50_000])
def test_a_profile_has_each_of_its_disturbances_at_least_once_and_leaves_the_start_alone(
    name: str, frames: int
) -> None:
    profile = PROFILES[name]
    placed = profile.place(frames, 3)
    assert placed == profile.place(frames, 3)
    if profile.thirds or not profile.per_million:
        return
    where = [
        at if isinstance(at, int) else at[0]
        for field in (
            "resets",
            "power_losses",
            "disconnects",
            "stamp_steps",
            "unplugged",
            "frozen",
            "count_jumps",
            "count_resets",
            "stalls",
            "queue_steps",
            "pictures_behind",
            "hiccups",
        )
        for at in getattr(placed, field)
    ]
    times = {kind: max(1, round(often * frames / 1e6)) for kind, often in profile.per_million.items()}
    moments = sum(times.values()) + times.get("unheard restarts", 0)  # the outage begins before
    moments += times.get("deeper restarts", 0)  # .. and the camera comes back after
    assert len(where) == moments + times.get("reckoned jumps", 0)  # of stamps and of the count, at once
    assert min(where) >= FIRST and max(where) < frames and len(set(where)) == moments


def test_a_profile_by_name_is_a_fault_set() -> None:
    assert load_faults("torn") == Faults(frames_torn=0.02)
    assert len(load_faults("all", 1_000_000).resets) == 20
