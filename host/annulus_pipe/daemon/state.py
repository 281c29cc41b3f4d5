"""What the head is doing, as a table: (state, event) -> state. What is not in the table is refused.

    off -power-> powering -ready-> idle -start-> armed -labelled-> scanning
                                     ^            |  ^               |
                                     +----stop----+--|------stop-----+
    armed, scanning, fault -pause-> paused -resume-> armed;  paused -stop-> idle
    any of idle, armed, scanning -fault-> fault -running-> armed, when a scan is under way
                                                -cleared-> idle, when none is
    anything but off and ending -end-> ending -ended-> off

Frames are taken and recorded in armed, scanning and in a fault that came to a scan; a fault is mended where it can be
(a line is opened again, a controller armed again), and the scan goes on.
"""

from collections.abc import Mapping
from enum import StrEnum

from annulus_pipe.vocabulary import AnnulusError


class State(StrEnum):
    OFF = "off"  # nothing is open
    POWERING = "powering"  # controller, shared memory and workers are being brought up
    IDLE = "idle"  # all is up, lamps dark, nothing is recorded
    ARMED = "armed"  # a scan is under way: recorder, camera and lamps come on; no frame has a label yet
    SCANNING = "scanning"  # frames have labels
    PAUSED = "paused"  # a scan is under way: lamps dark, no frames, its recording open
    FAULT = "fault"  # the controller, its line or a camera is not as it should be
    ENDING = "ending"  # lamps off, what is in hand goes where it belongs


class StateEvent(StrEnum):
    POWER = "power"
    READY = "ready"
    START = "start"
    LABELLED = "labelled"  # the first frame since armed whose label is known
    FAULT = "fault"
    RUNNING = "running"  # all is well again, and a scan is under way
    CLEARED = "cleared"  # all is well again, and none is
    PAUSE = "pause"
    RESUME = "resume"
    STOP = "stop"  # the scan ends, the session does not
    END = "end"
    ENDED = "ended"


TRANSITIONS: Mapping[tuple[State, StateEvent], State] = {
    (State.OFF, StateEvent.POWER): State.POWERING,
    (State.POWERING, StateEvent.READY): State.IDLE,
    (State.POWERING, StateEvent.END): State.ENDING,
    (State.IDLE, StateEvent.START): State.ARMED,
    (State.IDLE, StateEvent.FAULT): State.FAULT,
    (State.IDLE, StateEvent.END): State.ENDING,
    (State.ARMED, StateEvent.LABELLED): State.SCANNING,
    (State.ARMED, StateEvent.FAULT): State.FAULT,
    (State.ARMED, StateEvent.STOP): State.IDLE,
    (State.ARMED, StateEvent.END): State.ENDING,
    (State.SCANNING, StateEvent.FAULT): State.FAULT,
    (State.SCANNING, StateEvent.STOP): State.IDLE,
    (State.SCANNING, StateEvent.END): State.ENDING,
    (State.ARMED, StateEvent.PAUSE): State.PAUSED,
    (State.SCANNING, StateEvent.PAUSE): State.PAUSED,
    (State.FAULT, StateEvent.PAUSE): State.PAUSED,
    (State.PAUSED, StateEvent.RESUME): State.ARMED,
    (State.PAUSED, StateEvent.STOP): State.IDLE,
    (State.PAUSED, StateEvent.END): State.ENDING,
    (State.FAULT, StateEvent.RUNNING): State.ARMED,
    (State.FAULT, StateEvent.CLEARED): State.IDLE,
    (State.FAULT, StateEvent.STOP): State.IDLE,
    (State.FAULT, StateEvent.END): State.ENDING,
    (State.ENDING, StateEvent.ENDED): State.OFF,
}


def next_state(state: State, event: StateEvent) -> State:
    """Raises AnnulusError, one line that says when the event is possible, where the table has nothing."""
    to = TRANSITIONS.get((state, event))
    if to is None:
        when = " or ".join(known for known, other in TRANSITIONS if other is event)
        raise AnnulusError(f"{event} is not possible while the head is {state}, only while it is {when}")
    return to
