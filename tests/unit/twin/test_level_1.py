"""A host of level 1, as it spoke before levels were told, finds today's controller as it was."""

import json
from pathlib import Path
from typing import Any

from annulus_pipe.controller import TURNTABLE_LEAD_MS
from annulus_pipe.link.codec import Decoder, Frame
from annulus_pipe.link.fields import Message
from annulus_pipe.link.messages import (
    COMMANDS,
    EVENTS,
    Booted,
    Event,
    Fault,
    FaultCode,
    Garbled,
    MoveReply,
    Reply,
    StatusCode,
    TurntableDone,
)
from annulus_pipe.twin.native import NativeBoard

BEFORE = Path(__file__).parents[2] / "data/before/level-1.json"
MS = 100_000
LEAD = TURNTABLE_LEAD_MS * MS  # a move of a motor without power begins so much later than then
READ_WHEN_ASKED = {"tick", "start", "done", "git"}  # of the round that looked, or stopped the train; the commit


def played(log: list[dict[str, Any]]) -> tuple[list[Frame], list[Frame], int]:
    """What the controller said then, what it says now, and how much of that was damaged."""
    board = NativeBoard()
    then, now = Decoder(), Decoder()
    said_then: list[object] = []
    said_now: list[object] = []
    for step in log:
        match step:
            case {"power": boot}:
                board.power_on(boot)
            case {"input": [tick, pin, level]}:
                board.input(tick, pin, level)
            case {"write": data}:
                board.serial_write(bytes.fromhex(data))
            case {"until": tick, "said": data}:
                board.run_until(tick)
                said_then += then.feed(bytes.fromhex(data))
                said_now += now.feed(board.serial_read())
    frames_then, frames_now = ([f for f in said if isinstance(f, Frame)] for said in (said_then, said_now))
    return frames_then, frames_now, len(said_now) - len(frames_now)


def told(message: Message) -> tuple[object, ...]:
    """A message without what depends on when the main loop came round."""
    fields = {name: getattr(message, name) for name in message.FIELDS}
    if isinstance(message, Fault) and message.fault is FaultCode.HOST_TIMEOUT:
        del fields["detail"]  # ticks of silence
    if isinstance(message, MoveReply) and message.status is StatusCode.BAD_STATE:
        del fields["position"]  # on its way, which begins later today
    return (type(message).__name__, *(value for name, value in fields.items() if name not in READ_WHEN_ASKED))


def test_a_host_of_level_1_gets_the_same_answers_and_events_as_it_did() -> None:
    log = json.loads(BEFORE.read_text())["log"]
    then, now, unreadable = played(log)
    assert unreadable == 0
    for kind in (Reply, Event, Garbled):
        expected = [(f.sequence, f.boot, told(f.message)) for f in then if isinstance(f.message, kind)]
        found = [(f.sequence, f.boot, told(f.message)) for f in now if isinstance(f.message, kind)]
        assert found == expected
    ticks = [
        abs(a.message.tick - b.message.tick) - (LEAD if isinstance(a.message, TurntableDone) else 0)
        for kind in (Reply, Event)
        for a, b in zip(*([f for f in frames if isinstance(f.message, kind)] for frames in (then, now)), strict=True)
        if hasattr(a.message, "tick") and not isinstance(a.message, Booted)
    ]
    assert len(ticks) > 20 and max(ticks) < MS  # nothing came a millisecond earlier or later, but for a move from rest


def test_the_conversation_has_every_command_and_event_of_level_1() -> None:
    log = json.loads(BEFORE.read_text())["log"]
    heard = {type(frame.message) for frame in played(log)[0]}
    assert heard >= {kind.REPLY for kind in COMMANDS.values() if kind.SINCE == 1}
    assert heard >= {kind for kind in EVENTS.values() if kind.SINCE == 1}
