"""Timestamps that moved by whole frames kept the lamp, a 4:1 cycle being like itself five frames on, and put every
frame at another place along the pipe for ever; a count that disagreed once was the truth from then on. Fails when an
edge is believed that the frame was in hand before, or that another frame had."""

import pytest
from bench_of_faults import PERIOD, Bench, Faults

FRAME_MS = PERIOD / 1e6


@pytest.mark.parametrize("counted", [True, False])
@pytest.mark.parametrize("frames", [5, -5])
def test_stamps_that_step_by_a_lamp_cycle_put_no_frame_at_another_place(frames: int, counted: bool) -> None:
    count = (lambda k: k) if counted else (lambda k: None)
    score = Bench(Faults(count=count, stamp_ms=lambda k: frames * FRAME_MS * (k >= 200))).run(400)
    assert score.wrong == [] and score.share(210) == 0


def test_a_driver_that_always_stamps_three_frames_late_is_understood() -> None:
    score = Bench(Faults(), offset_ms=-28.0 + 3 * FRAME_MS).run(200)
    assert score.wrong == [] and score.unknown == [0]


def test_one_stamp_in_37_that_is_late_is_unknown() -> None:
    score = Bench(Faults(count=lambda k: None, stamp_ms=lambda k: FRAME_MS * (k % 37 == 20))).run(1000)
    assert score.wrong == [] and score.share(50) < 0.06


@pytest.mark.parametrize("ppm", [200, -200])
def test_stamps_that_drift_stay_with_their_frames(ppm: int) -> None:
    score = Bench(Faults(stamp_ms=lambda k: k * FRAME_MS * ppm * 1e-6)).run(4000)
    assert score.wrong == [] and score.unknown == [0]
