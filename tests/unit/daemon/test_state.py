"""The table of the head's states, written out a second time: what is not here is refused."""

import pytest

from annulus_pipe.daemon.state import TRANSITIONS, State, StateEvent, next_state
from annulus_pipe.vocabulary import AnnulusError

# For every state, what each event leads to; an event that is not named is illegal there.
TABLE = {
    "off": {"power": "powering"},
    "powering": {"ready": "idle", "end": "ending"},
    "idle": {"start": "armed", "fault": "fault", "end": "ending"},
    "armed": {"labelled": "scanning", "fault": "fault", "pause": "paused", "stop": "idle", "end": "ending"},
    "scanning": {"fault": "fault", "pause": "paused", "stop": "idle", "end": "ending"},
    "paused": {"resume": "armed", "stop": "idle", "end": "ending"},
    "fault": {"running": "armed", "cleared": "idle", "pause": "paused", "stop": "idle", "end": "ending"},
    "ending": {"ended": "off"},
}


@pytest.mark.parametrize("state", State)
@pytest.mark.parametrize("event", StateEvent)
def test_every_state_answers_every_event(state: State, event: StateEvent) -> None:
    wanted = TABLE[state].get(event)
    if wanted is not None:
        assert next_state(state, event) is State(wanted)
        return
    with pytest.raises(AnnulusError) as caught:
        next_state(state, event)
    line = str(caught.value)
    assert "\n" not in line and str(event) in line and str(state) in line
    assert all(other in line for other, events in TABLE.items() if event in events), "and says when it is possible"


def test_every_state_is_left_and_every_state_but_ending_leads_to_off() -> None:
    assert set(TRANSITIONS.values()) == set(State)
    for state in State:
        seen, here = set(), {state}
        while here - seen:
            seen |= here
            here = {to for (at, _), to in TRANSITIONS.items() if at in here}
        assert State.OFF in seen
