"""The conversation with one controller, sans-I/O: no port, no clock, no thread.

    session = Session()
    ticket = session.send(Ping())
    while True:
        for event in session.receive(port.read(), now):  # Answer, EventReceived, EventsLost, Corrupt, Rebooted, ..
            handle(event)
        port.write(session.pending(now))                        # what is due: first sendings, repeats, re-reads

`now` is any monotonic time in ns, from the same clock as the camera's timestamps. What is promised: a command is
carried out at most once, and is either answered or reported as Unanswered; an event is heard exactly once, or reported
as EventsLost. Events come as they arrive: one that had to be read again comes after its followers, marked `recovered`.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, fields

from annulus.link.codec import Corrupt, Decoder, Frame, encode
from annulus.link.messages import (
    EVENT_RING,
    PROTOCOL_VERSION,
    SCHEMA_HASH,
    Command,
    Event,
    Garbled,
    Identify,
    IdentifyReply,
    Reply,
    Reread,
    RereadReply,
    StatusCode,
)
from annulus.vocabulary import AnnulusError

WINDOW = 4  # commands on the line at once; the controller holds 8 replies
QUEUE_MAX = 64  # commands waiting for their turn
OTHERS_MAX = 6  # sendings while a non-query is unanswered: the controller knows a repeat only for 8 further commands
TRIES_MAX = 6
FIRST_REPEAT_NS = 50_000_000
LAST_REPEAT_NS = 400_000_000  # back-off doubles up to here: a stalled host must not meet a storm of its own making
GARBLED_REPEAT_NS = 5_000_000  # a frame older than this when the controller complains is the one it means
REREAD_WAIT_NS = 30_000_000
REREAD_TRIES = 5
_EVENT_MODULUS = 1 << 16


@dataclass(frozen=True, slots=True)
class Answer:
    """A command was carried out or refused (see `reply.status`)."""

    ticket: int
    command: Command
    reply: Reply
    sent_ns: int  # of the last try
    received_ns: int
    tries: int  # more than one: nobody knows which of them was answered, so the round trip is not to be timed


@dataclass(frozen=True, slots=True)
class Unanswered:
    """A command got no answer. Whether it was carried out is not known."""

    ticket: int
    command: Command
    why: str


@dataclass(frozen=True, slots=True)
class EventReceived:
    """An event, exactly once."""

    event: Event
    sequence: int
    boot: int
    received_ns: int
    recovered: bool  # read again after it had been lost


@dataclass(frozen=True, slots=True)
class EventsLost:
    """Events that will never be heard: they had left the controller's ring, or it restarted."""

    first: int
    count: int
    boot: int


@dataclass(frozen=True, slots=True)
class Rebooted:
    """Another boot of the controller: sequences, ticks, configuration begin anew. `previous` None: the first met."""

    boot: int
    previous: int | None


LinkEvent = Answer | Unanswered | EventReceived | EventsLost | Corrupt | Rebooted


@dataclass(slots=True)
class Counters:
    """Everything that went otherwise than hoped, since the session began."""

    sent: int = 0  # frames, repeats included
    repeats: int = 0
    unanswered: int = 0
    stray_replies: int = 0  # to nothing outstanding: usually the second answer to a repeated command
    events: int = 0
    events_missed: int = 0
    events_recovered: int = 0
    events_lost: int = 0
    events_repeated: int = 0  # heard already
    rereads: int = 0
    reboots: int = 0
    garbled: int = 0  # our frames, as the controller complains
    corrupt: dict[str, int] = field(default_factory=dict)  # by reason

    def as_dict(self) -> dict[str, int]:
        flat = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "corrupt"}
        return flat | {f"corrupt_{why}": count for why, count in sorted(self.corrupt.items())}


@dataclass(slots=True)
class _Outstanding:
    ticket: int
    command: Command
    sequence: int
    sent_ns: int
    due_ns: int  # of the next try
    tries: int = 1
    others: int = 0  # sendings of other commands since the first try


@dataclass(slots=True)
class _Missing:
    due_ns: int
    tries: int = 0


class Session:
    """The host's side of the wire. Begin with `send(identify())`: it makes the controller forget older sessions too."""

    def __init__(self) -> None:
        self.counters = Counters()
        self.boot: int | None = None
        self._decoder = Decoder()
        self._queue: deque[tuple[int, Command]] = deque()
        self._outstanding: dict[int, _Outstanding] = {}  # by sequence, oldest first
        self._next_sequence = 0
        self._next_ticket = 1
        self._next_event: int | None = None
        self._missing: dict[int, _Missing] = {}  # by event sequence, oldest first; never more than EVENT_RING
        self._rereading: int | None = None  # ticket: the controller keeps one re-read at a time
        self._fresh = True

    def send(self, command: Command) -> int:
        """Queue a command; the ticket comes back in its Answer or Unanswered. AnnulusError when the queue is full."""
        if len(self._queue) >= QUEUE_MAX:
            raise AnnulusError(f"link: {QUEUE_MAX} commands wait already, expected answers first. Is the line stuck?")
        ticket = self._next_ticket
        self._next_ticket += 1
        self._queue.append((ticket, command))
        return ticket

    @property
    def idle(self) -> bool:
        """Nothing queued and nothing unanswered."""
        return not self._queue and not self._outstanding

    @property
    def backlog(self) -> int:
        """Commands that wait for their turn to be sent."""
        return len(self._queue)

    def receive(self, data: bytes, now: int) -> list[LinkEvent]:
        """What these bytes, cut anywhere, bring to an end."""
        happenings: list[LinkEvent] = []
        for frame in self._decoder.feed(data):
            if isinstance(frame, Corrupt):
                self.counters.corrupt[frame.why] = self.counters.corrupt.get(frame.why, 0) + 1
                happenings.append(frame)
            elif isinstance(frame.message, Reply):
                happenings += self._reply(frame.message, frame.sequence, now)
            elif isinstance(frame.message, Event):
                happenings += self._event(frame.message, frame, now)
            elif isinstance(frame.message, Garbled):
                self.counters.garbled += 1
                for waiting in self._outstanding.values():
                    waiting.due_ns = min(waiting.due_ns, max(now, waiting.sent_ns + GARBLED_REPEAT_NS))
        return happenings

    def expire(self, now: int) -> list[LinkEvent]:
        """Commands and events given up by `now`. Call now and then; `pending` does not report."""
        happenings: list[LinkEvent] = []
        for waiting in [w for w in self._outstanding.values() if w.due_ns <= now and w.tries >= TRIES_MAX]:
            del self._outstanding[waiting.sequence]
            happenings += self._give_up(waiting.ticket, waiting.command, f"no answer to {waiting.tries} tries")
        given_up = [s for s, m in self._missing.items() if m.due_ns <= now and m.tries >= REREAD_TRIES]
        happenings += self._lose(given_up)
        return happenings

    def pending(self, now: int) -> bytes:
        """The bytes that are due now: repeats first, then what the window lets through."""
        self._ask_again(now)
        out = bytearray()
        if self._fresh:
            out.append(0)  # ends whatever half a frame the line holds from before
            self._fresh = False
        for waiting in self._outstanding.values():
            if waiting.due_ns <= now and waiting.tries < TRIES_MAX and self._may_send(waiting):
                waiting.tries += 1
                waiting.due_ns = now + _patience(waiting.tries)
                waiting.sent_ns = now
                self.counters.repeats += 1
                out += self._wire(waiting)
        while self._queue and len(self._outstanding) < WINDOW and self._may_start(self._queue[0][1]):
            ticket, command = self._queue.popleft()
            fresh = _Outstanding(ticket, command, self._free_sequence(), now, now + _patience(1))
            self._outstanding[fresh.sequence] = fresh
            out += self._wire(fresh)
        return bytes(out)

    def next_due(self) -> int | None:
        """When `pending` or `expire` will next have something to do, if nothing arrives before."""
        dues = [w.due_ns for w in self._outstanding.values()] + [m.due_ns for m in self._missing.values()]
        return min(dues, default=None)

    # ---- commands ----

    def _wire(self, sending: _Outstanding) -> bytes:
        self.counters.sent += 1
        for other in self._outstanding.values():
            if other is not sending:
                other.others += 1
        return encode(Frame(sending.command, sending.sequence))

    def _may_start(self, command: Command) -> bool:
        """Ordered commands go one at a time; queries beside them, as long as the controller still knows the former."""
        ordered = [w for w in self._outstanding.values() if _ordered(w.command)]
        if _ordered(command):
            return not ordered and (not isinstance(command, Identify) or not self._outstanding)
        return all(w.others < OTHERS_MAX and not isinstance(w.command, Identify) for w in ordered)

    def _may_send(self, sending: _Outstanding) -> bool:
        return all(w is sending or not _ordered(w.command) or w.others < OTHERS_MAX for w in self._outstanding.values())

    def _free_sequence(self) -> int:
        while self._next_sequence in self._outstanding:
            self._next_sequence = (self._next_sequence + 1) % 256
        sequence = self._next_sequence
        self._next_sequence = (sequence + 1) % 256
        return sequence

    def _reply(self, reply: Reply, sequence: int, now: int) -> Iterator[LinkEvent]:
        waiting = self._outstanding.get(sequence)
        if waiting is None or waiting.command.REPLY is not type(reply):
            self.counters.stray_replies += 1
            return
        del self._outstanding[sequence]
        if isinstance(reply, IdentifyReply):
            yield from self._meet(reply.boot)
        if waiting.ticket == self._rereading:
            self._rereading = None
            if isinstance(reply, RereadReply) and isinstance(waiting.command, Reread):
                yield from self._reread_answered(waiting.command, reply, now)
            return
        yield Answer(waiting.ticket, waiting.command, reply, waiting.sent_ns, now, waiting.tries)

    def _give_up(self, ticket: int, command: Command, why: str) -> Iterator[LinkEvent]:
        if ticket == self._rereading:
            self._rereading = None
            return
        self.counters.unanswered += 1
        yield Unanswered(ticket, command, why)

    # ---- events ----

    def _event(self, event: Event, frame: Frame, now: int) -> Iterator[LinkEvent]:
        yield from self._meet(frame.boot)
        expected = self._next_event if self._next_event is not None else frame.sequence
        ahead = (frame.sequence - expected) % _EVENT_MODULUS
        recovered = False
        if ahead < _EVENT_MODULUS // 2:
            self._next_event = (frame.sequence + 1) % _EVENT_MODULUS
            yield from self._miss(expected, ahead, now)
        elif frame.sequence in self._missing:
            del self._missing[frame.sequence]
            self.counters.events_recovered += 1
            recovered = True
        else:
            self.counters.events_repeated += 1
            return
        self.counters.events += 1
        yield EventReceived(event, frame.sequence, frame.boot, now, recovered)

    def _miss(self, first: int, count: int, now: int) -> Iterator[LinkEvent]:
        """Note a gap. What cannot be in the controller's ring any more is lost at once."""
        self.counters.events_missed += count
        beyond = max(0, count - EVENT_RING)
        if beyond:
            self.counters.events_lost += beyond
            yield EventsLost(first, beyond, self._known_boot())
        for ahead in range(beyond, count):
            self._missing[(first + ahead) % _EVENT_MODULUS] = _Missing(now)
        overflow = len(self._missing) - EVENT_RING
        if overflow > 0:
            yield from self._lose(list(self._missing)[:overflow])

    def _ask_again(self, now: int) -> None:
        """Queue the re-read of the oldest run of missing events, one at a time."""
        if self._rereading is not None or len(self._queue) >= QUEUE_MAX:
            return
        first = next((s for s, m in self._missing.items() if m.due_ns <= now and m.tries < REREAD_TRIES), None)
        if first is None:
            return
        count = 0
        while count < EVENT_RING and (missing := self._missing.get((first + count) % _EVENT_MODULUS)) is not None:
            missing.tries += 1
            missing.due_ns = now + REREAD_WAIT_NS
            count += 1
        self.counters.rereads += 1
        self._rereading = self.send(Reread(first, count))
        self._queue.appendleft(self._queue.pop())  # events are waited for; commands behind it wait a moment

    def _reread_answered(self, asked: Reread, reply: RereadReply, now: int) -> Iterator[LinkEvent]:
        """The controller says which of the events asked for will follow: the others are gone."""
        follow = {(reply.first + i) % _EVENT_MODULUS for i in range(reply.count)}
        asked_for = [(asked.first + i) % _EVENT_MODULUS for i in range(asked.count)]
        for sequence in asked_for:
            if sequence in self._missing:
                self._missing[sequence].due_ns = now + REREAD_WAIT_NS
        if reply.status is StatusCode.BAD_STATE:  # it has as much to send again as it can keep in mind: asked later
            return
        yield from self._lose([s for s in asked_for if s not in follow and s in self._missing])

    def _lose(self, sequences: list[int]) -> Iterator[LinkEvent]:
        """Give these missing events up, reported as runs."""
        run: list[int] = []
        for sequence in sequences:
            del self._missing[sequence]
            self.counters.events_lost += 1
            if run and sequence != (run[-1] + 1) % _EVENT_MODULUS:
                yield EventsLost(run[0], len(run), self._known_boot())
                run = []
            run.append(sequence)
        if run:
            yield EventsLost(run[0], len(run), self._known_boot())

    # ---- boots of the controller ----

    def _known_boot(self) -> int:
        return -1 if self.boot is None else self.boot

    def _meet(self, boot: int) -> Iterator[LinkEvent]:
        """Note who is speaking. A new boot byte ends everything that was under way with the former boot."""
        if boot == self.boot:
            return
        previous = self.boot
        if previous is not None:
            self.counters.reboots += 1
            yield from self._lose(list(self._missing))
            self._next_event = 0  # a boot's first event is number 0
            # Sent now or again, these would be carried out by a boot they were not meant for.
            gone = [(w.ticket, w.command) for w in self._outstanding.values()] + list(self._queue)
            self._outstanding.clear()
            self._queue.clear()
            for ticket, command in gone:
                yield from self._give_up(ticket, command, "the controller restarted")
        self.boot = boot
        yield Rebooted(boot, previous)


def identify() -> Identify:
    """The first command of every session."""
    return Identify(PROTOCOL_VERSION, SCHEMA_HASH)


def _ordered(command: Command) -> bool:
    """Carried out in the order sent, one at a time. Identify too: after it the controller knows no repeats."""
    return not command.QUERY or isinstance(command, Identify)


def _patience(tries: int) -> int:
    return min(LAST_REPEAT_NS, FIRST_REPEAT_NS << (tries - 1))
