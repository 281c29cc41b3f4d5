"""Commands are carried out at most once and always accounted for; events are heard exactly once or reported lost."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from annulus_pipe.link.messages import EVENT_RING, Identify, Move, Ping, Reread, Status, StatusCode, TurntableDone
from annulus_pipe.link.session import (
    WINDOW,
    Answer,
    EventReceived,
    EventsLost,
    LinkEvent,
    LinkSession,
    Rebooted,
    Unanswered,
    identify,
)
from annulus_pipe.testing.scripted import BadLine, ScriptedController
from annulus_pipe.vocabulary import AnnulusError

MS = 1_000_000


class Conversation:
    """A session and a controller with a line between them, in virtual time, one millisecond a step."""

    def __init__(self, seed: int = 0, rate: float = 0.0, controller: ScriptedController | None = None) -> None:
        self.session = LinkSession()
        self.controller = controller or ScriptedController()
        self.line = BadLine(seed, rate)
        self.random = random.Random(seed)
        self.now = 10**15
        self.happenings: list[LinkEvent] = []

    def step(self) -> None:
        self.now += MS
        self.controller.receive(self.line.carry(self.session.pending(self.now)), self.now)
        data = self.line.carry(self.controller.take())
        at = self.random.randrange(len(data) + 1)
        for chunk in (data[:at], data[at:]):
            self.happenings += self.session.receive(chunk, self.now)
        self.happenings += self.session.expire(self.now)

    def run(self, steps: int) -> None:
        for _ in range(steps):
            self.step()

    def all(self, kind: type) -> list:
        return [happening for happening in self.happenings if isinstance(happening, kind)]


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.002, 0.01, 0.03]))
@settings(max_examples=16, derandomize=True, deadline=None)
def test_on_a_bad_line_every_command_runs_at_most_once_and_every_event_is_accounted_for(seed: int, rate: float) -> None:
    talk = Conversation(seed, rate)
    talk.session.send(identify())
    moves = [Move(position, 10_000, 0) for position in range(12)]
    tickets = {talk.session.send(move): move for move in moves}
    emitted = 0
    for _ in range(60):
        for _ in range(talk.random.randrange(3)):
            talk.controller.emit(TurntableDone(0, emitted))
            emitted += 1
        if talk.random.random() < 0.5 and talk.session.backlog < 30:
            talk.session.send(Ping())
        talk.run(talk.random.randrange(30))
    talk.line.rate = 0.0
    for _ in range(3):  # clean, so that a gap at the very end shows
        talk.controller.emit(TurntableDone(0, emitted))
        emitted += 1
        talk.run(2500)

    executed = [command for command in talk.controller.executed if isinstance(command, Move)]
    assert sorted(m.position for m in executed) == sorted({m.position for m in executed})
    answered = [a.command for a in talk.all(Answer) if a.ticket in tickets]
    given_up = [u.command for u in talk.all(Unanswered) if u.ticket in tickets]
    assert sorted(m.position for m in answered + given_up) == list(range(12))
    assert set(answered) <= set(executed)
    assert [m.position for m in executed] == sorted(m.position for m in executed)

    heard = [h.event.position for h in talk.all(EventReceived)]
    lost = [lost.first + i for lost in talk.all(EventsLost) for i in range(lost.count)]
    first = min(heard)
    assert sorted(heard + lost) == list(range(first, emitted))
    assert first <= 3 or rate > 0
    assert talk.session.idle and not talk.session._missing
    if rate == 0.0:
        assert not given_up and not lost and talk.session.counters.repeats == 0


def test_a_lost_event_is_read_again_and_says_so() -> None:
    talk = Conversation()
    talk.session.send(identify())
    talk.run(3)
    for number in range(10):
        talk.controller.emit(TurntableDone(0, number), reach_the_line=number not in (4, 5, 8))
        talk.run(1)
    talk.run(10)
    heard = talk.all(EventReceived)
    assert sorted(h.event.position for h in heard) == list(range(10))
    assert {h.event.position for h in heard if h.recovered} == {4, 5, 8}
    assert talk.session.counters.events_lost == 0


def test_events_that_left_the_ring_are_reported_lost() -> None:
    talk = Conversation()
    talk.session.send(identify())
    talk.controller.emit(TurntableDone(0, 0))
    talk.run(3)
    for number in range(1, 101):
        talk.controller.emit(TurntableDone(0, number), reach_the_line=number == 100)
    talk.run(20)
    lost = [lost.first + i for lost in talk.all(EventsLost) for i in range(lost.count)]
    heard = [h.event.position for h in talk.all(EventReceived)]
    assert sorted(heard + lost) == list(range(101))
    assert len(heard) == 1 + EVENT_RING


def test_a_reset_ends_what_was_under_way_and_is_never_carried_over() -> None:
    talk = Conversation()
    talk.session.send(identify())
    talk.run(3)
    talk.session.send(Move(1, 10_000, 0))
    talk.session.pending(talk.now)  # the command goes out and is swallowed by the reset
    talk.session.send(Move(2, 10_000, 0))
    talk.controller.reset()
    talk.run(2000)
    assert [u.command for u in talk.all(Unanswered)] == [Move(1, 10_000, 0), Move(2, 10_000, 0)]
    assert not any(isinstance(command, Move) for command in talk.controller.executed)
    assert [(r.boot, r.previous) for r in talk.all(Rebooted)] == [(7, None), (8, 7)]


def test_a_reset_whose_first_events_were_lost_is_noticed_and_they_are_read_again() -> None:
    talk = Conversation()
    talk.session.send(identify())
    talk.controller.emit(TurntableDone(0, 0))
    talk.run(3)
    talk.controller.reset()
    talk.controller.take()
    talk.controller.emit(TurntableDone(0, 1), reach_the_line=False)
    talk.controller.emit(TurntableDone(0, 2))
    talk.run(10)
    assert [h.sequence for h in talk.all(EventReceived) if h.boot == 8] == [2, 0, 1]


def test_a_silent_line_ends_in_unanswered_not_in_a_storm() -> None:
    session = LinkSession()
    ticket = session.send(identify())
    sent = b""
    happenings: list[LinkEvent] = []
    for now in range(0, 3_000 * MS, MS):
        sent += session.pending(now)
        happenings += session.expire(now)
    (gone,) = happenings
    assert isinstance(gone, Unanswered) and gone.ticket == ticket
    assert session.counters.sent == 6 and len(sent) < 100


def test_no_more_commands_are_under_way_than_the_controller_can_remember() -> None:
    """While a move is unanswered, at most six other sendings: the controller knows a repeat for eight commands."""
    session = LinkSession()
    session.send(Move(1, 10_000, 0))
    controller = ScriptedController()
    now = 0
    for _ in range(3000):
        now += MS
        if session.backlog < 10:
            session.send(Ping())
        controller.receive(session.pending(now), now)
        answers = controller.take().split(b"\0")  # every answer to a move is swallowed
        kept = [a for a in answers if a and a[1] != 0x4C]
        session.receive(b"".join(a + b"\0" for a in kept), now)
        assert len(session._outstanding) <= WINDOW
        session.expire(now)
    assert controller.executed.count(Move(1, 10_000, 0)) == 1


def test_a_controller_that_complains_is_answered_soon_but_not_at_once() -> None:
    talk = Conversation()
    talk.session.send(identify())
    talk.run(3)
    talk.session.send(Move(1, 10_000, 0))
    wire = bytearray(talk.session.pending(talk.now))
    wire[3] ^= 0x10
    start = talk.now
    talk.controller.receive(bytes(wire), talk.now)
    while Move(1, 10_000, 0) not in talk.controller.executed:
        talk.step()
    assert 4 * MS <= talk.now - start <= 8 * MS
    assert talk.session.counters.garbled == 1


def test_a_full_queue_refuses_instead_of_growing() -> None:
    session = LinkSession()
    with pytest.raises(AnnulusError, match="Is the line stuck"):
        for _ in range(1000):
            session.send(Status())


def test_identify_goes_alone_since_the_controller_then_forgets_repeats() -> None:
    session = LinkSession()
    session.send(Move(1, 10_000, 0))
    session.send(identify())
    session.send(Ping())
    session.pending(0)
    assert [type(w.command) for w in session._outstanding.values()] == [Move]
    assert Identify in {type(command) for _, command in session._queue}


def test_a_reread_put_off_is_asked_again_and_loses_nothing() -> None:
    """A controller that has as many promises open as it can keep says bad_state: the events are still there."""
    talk = Conversation()
    talk.session.send(identify())
    talk.controller.emit(TurntableDone(0, 0))
    talk.run(10)
    talk.controller.refuse[Reread] = (StatusCode.BAD_STATE, 0)
    talk.controller.emit(TurntableDone(0, 1), reach_the_line=False)
    talk.controller.emit(TurntableDone(0, 2))
    talk.run(40)
    del talk.controller.refuse[Reread]
    talk.run(200)
    assert [happening.event.position for happening in talk.all(EventReceived)] == [0, 2, 1]
    assert not talk.all(EventsLost)
