"""The conversation with one controller, sans-I/O: no port, no clock, no thread.

    session = LinkSession()
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

from annulus_pipe.link.codec import EVENTS_FROM, Corrupt, Decoder, Frame, Unknown, encode
from annulus_pipe.link.messages import (
    EVENT_RING,
    LEVEL,
    PROTOCOL_VERSION,
    SCHEMA_HASH,
    Booted,
    Command,
    Event,
    Garbled,
    Identify,
    IdentifyReply,
    Info,
    InfoReply,
    Reply,
    Reread,
    RereadReply,
    StatusCode,
)
from annulus_pipe.vocabulary import AnnulusError

WINDOW = 4  # commands on the line at once; the controller holds 8 replies
QUEUE_MAX = 64  # commands waiting for their turn
OTHERS_MAX = 6  # sendings while a non-query is unanswered: the controller knows a repeat only for 8 further commands
TRIES_MAX = 6
INFO_TRIES = 4  # a controller of level 1 says garbled to each
FIRST_REPEAT_NS = 50_000_000
LAST_REPEAT_NS = 400_000_000  # back-off doubles up to here: a stalled host must not meet a storm of its own making
GARBLED_REPEAT_NS = 5_000_000  # a frame older than this when the controller complains is the one it means
REREAD_WAIT_NS = 30_000_000
REREAD_TRIES = 5
ASKED_MAX = 8 * EVENT_RING  # sequences of rereads remembered: their events may come more than once
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
    """Another boot of the controller: sequences, ticks, configuration begin anew. `previous` None: the first met. The
    same byte as before: told by something else, `why`.
    """

    boot: int
    previous: int | None
    why: str = "another boot byte"


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
    reboots_unfounded: int = 0  # taken for one, but the nonce is the same
    unknown: int = 0  # messages of a newer controller, passed over
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


class LinkSession:
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
        self.informed = False  # the controller has said what it can do, or been found to know no such question
        self.info: InfoReply | None = None  # None: of level 1
        self._asking: int | None = None  # ticket of our own question
        self._nonce: int | None = None  # of the boot under way
        self._suspected = False
        self._asked: deque[int] = deque(maxlen=ASKED_MAX)

    def knows(self, command: type[Command]) -> bool:
        """Whether the controller at the other end has this command."""
        if command.SINCE == 1:
            return True
        return self.info is not None and bool(self.info.commands[command.ID // 8] >> command.ID % 8 & 1)

    def reopened(self) -> None:
        """The line was closed and opened again: what came in half will not be completed. Identify next."""
        self._decoder = Decoder()
        self._fresh = True

    def suspect(self, why: str) -> list[LinkEvent]:
        """Something was heard that the boot we know cannot have said: take it for another one. Identify next."""
        if self.boot is None:
            return []
        self._suspected = True
        return list(self._begin_anew(self.boot, None, why))

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
        if not data:
            return happenings
        for frame in self._decoder.feed(data):
            if isinstance(frame, Corrupt):
                self.counters.corrupt[frame.why] = self.counters.corrupt.get(frame.why, 0) + 1
                happenings.append(frame)
            elif isinstance(frame, Unknown):
                happenings += self._unknown(frame, now)
            elif isinstance(frame.message, Reply):
                happenings += self._reply(frame.message, frame.sequence, now)
            elif isinstance(frame.message, Event):
                happenings += self._event(frame.message, frame.sequence, frame.boot, now)
            elif isinstance(frame.message, Garbled):
                self.counters.garbled += 1
                for waiting in self._outstanding.values():
                    waiting.due_ns = min(waiting.due_ns, max(now, waiting.sent_ns + GARBLED_REPEAT_NS))
        return happenings

    def expire(self, now: int) -> list[LinkEvent]:
        """Commands and events given up by `now`. Call now and then; `pending` does not report."""
        happenings: list[LinkEvent] = []
        if not self._outstanding and not self._missing:
            return happenings
        for waiting in [w for w in self._outstanding.values() if w.due_ns <= now and w.tries >= _tries(w.command)]:
            del self._outstanding[waiting.sequence]
            happenings += self._give_up(waiting.ticket, waiting.command, f"no answer to {waiting.tries} tries")
        given_up = [s for s, m in self._missing.items() if m.due_ns <= now and m.tries >= REREAD_TRIES]
        happenings += self._lose(given_up)
        return happenings

    def pending(self, now: int) -> bytes:
        """The bytes that are due now: repeats first, then what the window lets through."""
        if self._missing:
            self._ask_again(now)
        if not (self._queue or self._outstanding or self._fresh):
            return b""
        out = bytearray()
        if self._fresh:
            out.append(0)  # ends whatever half a frame the line holds from before
            self._fresh = False
        for waiting in self._outstanding.values():
            if waiting.due_ns <= now and waiting.tries < _tries(waiting.command) and self._may_send(waiting):
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
            self._ask_info(reply)
        if waiting.ticket == self._asking:
            self._asking = None
            if isinstance(reply, InfoReply):
                yield from self._informed(reply)
            return
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
        if ticket == self._asking:
            self._asking = None
            self.informed = True
            return
        self.counters.unanswered += 1
        yield Unanswered(ticket, command, why)

    def _ask_info(self, who: IdentifyReply) -> None:
        """Behind every identify: it made the controller speak at level 1 again."""
        self.informed, self.info, self._asking = True, None, None
        if (who.protocol, who.schema) == (PROTOCOL_VERSION, SCHEMA_HASH) and len(self._queue) < QUEUE_MAX:
            self.informed = False
            self._asking = self.send(Info(LEVEL))
            self._queue.appendleft(self._queue.pop())

    def _informed(self, reply: InfoReply) -> Iterator[LinkEvent]:
        self.informed, self.info = True, reply
        before, self._nonce = self._nonce, reply.nonce
        if self._suspected:
            self._suspected = False
            self.counters.reboots_unfounded += before == reply.nonce
        elif before is not None and before != reply.nonce and self.boot is not None:
            yield from self._begin_anew(self.boot, None, "another nonce")

    def _unknown(self, unknown: Unknown, now: int) -> Iterator[LinkEvent]:
        """What a newer controller says: its place in the sequence counts, and whoever waits need not wait longer."""
        self.counters.unknown += 1
        if unknown.identity >= EVENTS_FROM:
            if unknown.sequence is not None:
                yield from self._event(None, unknown.sequence, unknown.boot, now)
            return
        waiting = self._outstanding.get(unknown.sequence or 0)
        if waiting is not None and unknown.identity == waiting.command.REPLY.ID:
            del self._outstanding[waiting.sequence]
            yield from self._give_up(waiting.ticket, waiting.command, "an answer that this host cannot read")

    # ---- events ----

    def _event(self, event: Event | None, sequence: int, boot: int, now: int) -> Iterator[LinkEvent]:
        """None: one this host does not know."""
        if boot != self.boot:
            yield from self._meet(boot)
        if sequence != self._next_event:
            yield from self._same_boot(event, sequence)
        expected = self._next_event if self._next_event is not None else sequence
        ahead = (sequence - expected) % _EVENT_MODULUS
        recovered = False
        if ahead < _EVENT_MODULUS // 2:
            self._next_event = (sequence + 1) % _EVENT_MODULUS
            if ahead:
                yield from self._miss(expected, ahead, now)
        elif sequence in self._missing:
            del self._missing[sequence]
            self.counters.events_recovered += 1
            recovered = True
        else:
            self.counters.events_repeated += 1
            return
        if event is None:
            return
        self.counters.events += 1
        yield EventReceived(event, sequence, boot, now, recovered)

    def _same_boot(self, event: Event | None, sequence: int) -> Iterator[LinkEvent]:
        """One loss of power in 256 leaves the boot byte as it was. Nobody hears an old event without asking for it, nor
        ever `booted` in the middle: then the sequence has begun anew.
        """
        if self._next_event is None or self.boot is None or sequence in self._missing or sequence in self._asked:
            return
        behind = (self._next_event - sequence) % _EVENT_MODULUS
        if 0 < behind <= _EVENT_MODULUS // 2 or (isinstance(event, Booted) and behind):
            self._suspected = True
            yield from self._begin_anew(self.boot, 0, "its events begin anew")

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
        self._asked.extend((first + ahead) % _EVENT_MODULUS for ahead in range(count))
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
        if self.boot is None:
            self.boot = boot
            yield Rebooted(boot, None)
        else:
            yield from self._begin_anew(boot, 0, "another boot byte")

    def _begin_anew(self, boot: int, next_event: int | None, why: str) -> Iterator[LinkEvent]:
        """Of the boot that ended nothing is carried over. `next_event`: a boot's first is number 0; None: the next."""
        self.counters.reboots += 1
        yield from self._lose(list(self._missing))
        self._nonce = self._nonce if self._suspected else None
        self._next_event = next_event
        self._asked.clear()
        # Sent now or again, these would be carried out by a boot they were not meant for.
        gone = [(w.ticket, w.command) for w in self._outstanding.values()] + list(self._queue)
        self._outstanding.clear()
        self._queue.clear()
        for ticket, command in gone:
            yield from self._give_up(ticket, command, "the controller restarted")
        previous, self.boot = self.boot, boot
        self.informed, self.info, self._asking = False, None, None
        yield Rebooted(boot, previous, why)


def identify() -> Identify:
    """The first command of every session."""
    return Identify(PROTOCOL_VERSION, SCHEMA_HASH)


def _ordered(command: Command) -> bool:
    """Carried out in the order sent, one at a time. Identify too: after it the controller knows no repeats."""
    return not command.QUERY or isinstance(command, Identify)


def _tries(command: Command) -> int:
    return INFO_TRIES if isinstance(command, Info) else TRIES_MAX


def _patience(tries: int) -> int:
    return min(LAST_REPEAT_NS, FIRST_REPEAT_NS << (tries - 1))
