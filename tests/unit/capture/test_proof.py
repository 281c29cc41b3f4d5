"""The table of proofs: whatever contradicts takes labels away, and nothing gives them but what proves."""

import pytest

from annulus_pipe.capture.pairing import Pairing
from annulus_pipe.capture.proof import CONTRADICTIONS, SUSPICIONS, TRANSITIONS, News, ProofState, Reason, next_state


@pytest.mark.parametrize("news", sorted(CONTRADICTIONS | SUSPICIONS))
@pytest.mark.parametrize("state", ProofState)
def test_after_a_contradiction_no_label_is_given(state: ProofState, news: News) -> None:
    assert next_state(state, news) is not ProofState.PROVED
    assert state is ProofState.SEARCHING or (state, news) in TRANSITIONS
    assert news.value in {reason.value for reason in Reason}


def test_only_a_search_or_a_run_of_frames_proves() -> None:
    leading = {
        news for (state, news), to in TRANSITIONS.items() if to is ProofState.PROVED and state is not ProofState.PROVED
    }
    assert leading == {News.FOUND, News.AGREED}
    assert next_state(ProofState.SEARCHING, News.AGREED) is ProofState.SEARCHING, (
        "frames cannot agree on an offset nobody has"
    )


def test_every_state_can_be_left_and_every_change_is_told() -> None:
    assert {state for state, _ in TRANSITIONS} == set(ProofState)
    told: list[str] = []
    pairing = Pairing(40_000_000, tell=told.append)
    pairing.recalibrate(40_000_000, 0, proved=False)
    pairing.recalibrate(40_000_000, 0)
    assert pairing.state is ProofState.PROVED and len(told) == 2
    assert told[0].startswith("labels were searching, now tentative")
