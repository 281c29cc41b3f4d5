"""Promises of what a camera's states are, in virtual time."""

from itertools import pairwise

from annulus_pipe.daemon.camera_state import (
    RETRY_FIRST_S,
    RETRY_LAST_S,
    TRANSITIONS,
    CameraEvent,
    CameraState,
    CameraWatch,
)


def test_every_state_can_be_come_to_and_closed() -> None:
    reached = set(TRANSITIONS.values())
    assert reached == set(CameraState)
    for state in set(CameraState) - {CameraState.CLOSED}:
        assert TRANSITIONS[state, CameraEvent.CLOSE] is CameraState.CLOSED


def waits(brings_frames: bool) -> list[float]:
    """Seconds from each loss to the next attempt, of a camera that opens eight times."""
    watch, now, found = CameraWatch(), 0.0, []
    watch.happened(CameraEvent.OPEN, now)
    for _ in range(8):
        watch.happened(CameraEvent.OPENED, now)
        if brings_frames:
            watch.happened(CameraEvent.FRAME, now)
        watch.happened(CameraEvent.LOST, now, "unplugged")
        assert watch.state is CameraState.GONE and watch.why == "unplugged"
        found.append(watch.retry_in_s(now))
        now += found[-1]
        assert watch.retry_in_s(now - 0.001) > 0.0 and watch.retry_in_s(now) == 0.0
        assert watch.happened(CameraEvent.RETRY, now) and watch.state is CameraState.OPENING
    assert watch.entered[CameraState.OPENING] == 9 and watch.entered[CameraState.GONE] == 8
    return found


def test_a_camera_that_stays_away_is_tried_less_and_less_often_but_within_a_second() -> None:
    found = waits(brings_frames=False)
    assert found[0] == RETRY_FIRST_S and found == sorted(found) and found[-1] == RETRY_LAST_S <= 1.0
    assert all(later <= 2 * before for before, later in pairwise(found))


def test_a_frame_makes_the_next_attempt_quick_again() -> None:
    assert set(waits(brings_frames=True)) == {RETRY_FIRST_S}


def test_silence_ends_with_a_frame_or_with_the_stream_begun_anew() -> None:
    watch = CameraWatch()
    for event in (CameraEvent.OPEN, CameraEvent.OPENED, CameraEvent.SILENCE):
        watch.happened(event, 1.0)
    assert watch.state is CameraState.SILENT and watch.retry_in_s(1.0) == RETRY_FIRST_S
    assert watch.happened(CameraEvent.FRAME, 1.1) and watch.state is CameraState.STREAMING
    watch.happened(CameraEvent.SILENCE, 2.0)
    assert watch.happened(CameraEvent.RETRY, 2.5) and watch.state is CameraState.OPENING


def test_what_the_table_has_not_changes_nothing() -> None:
    watch = CameraWatch()
    for event in set(CameraEvent) - {CameraEvent.OPEN}:
        assert not watch.happened(event, 0.0) and watch.state is CameraState.CLOSED
    assert watch.retry_in_s(0.0) == float("inf")
