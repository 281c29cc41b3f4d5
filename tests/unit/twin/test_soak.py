"""The soak counts wrong labels honestly: none where the pairing is sound, all of them where it was sabotaged."""

import pytest

from annulus.twin.faults import Faults
from annulus.twin.soak import _relocks, soak
from annulus.vocabulary import AnnulusError

PERIOD_NS = 40_000_000


def test_no_label_is_wrong_under_drops_lost_events_jitter_and_two_resets() -> None:
    result = soak(300, seed=5)
    assert result["wrong"] == 0 and result["timing_only"]["wrong"] == 0
    assert result["relock_frames_max"] <= 5
    assert result["unknown"] <= 20 and result["led"] >= 45 and result["projector"] >= 200
    counted = ("projector", "led", "unknown", "dropped", "overflow")
    assert sum(result[key] for key in counted) == 300
    assert result["disturbances"]["resets"] == 2 and result["link"]["reboots"] == 2
    assert not any(result["board_lost"].values())


def test_no_label_is_wrong_on_a_rough_line_with_missing_and_doubled_sync_edges() -> None:
    faults = Faults(0.03, 0.03, 3e-4, 3000.0, 0.01, 0.01, resets=(150,))
    result = soak(250, seed=6, faults=faults)
    assert result["wrong"] == 0 and result["timing_only"]["wrong"] == 0
    assert result["projector"] > 120


@pytest.mark.parametrize("frames_off", [-1, 1])
def test_an_offset_wrong_by_a_frame_is_found_wrong_when_the_picture_is_not_looked_at(frames_off: int) -> None:
    result = soak(150, seed=7, faults="none", photometry=False, offset_error_ns=frames_off * PERIOD_NS)
    assert result["wrong"] > 120


def test_the_picture_keeps_a_wrong_offset_from_becoming_a_wrong_label() -> None:
    result = soak(150, seed=7, faults="none", offset_error_ns=PERIOD_NS)
    assert result["wrong"] == 0 and result["unknown"] == 150


def test_a_relock_counts_from_the_end_of_the_disturbance_to_the_next_right_label() -> None:
    assert _relocks([10, 20], right=[9, 10, 23, 24], frames=30) == [1, 4]
    assert _relocks([100], right=[9], frames=200) == [100]  # never: everything that was left


def test_too_short_a_soak_is_refused() -> None:
    with pytest.raises(AnnulusError, match="expected 100 or more"):
        soak(50)
