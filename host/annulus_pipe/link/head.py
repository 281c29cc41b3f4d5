"""Brings a controller into service and keeps it there, sans-I/O: identify, stage, commit, arm, keep alive, and again
after a reset or a fault. The daemon drives it through a port, the soak in virtual time.

    head = HeadControl(configuration)              # a Stage; its generation is chosen here
    while True:
        for news in head.receive(port.read(), now):
            match news:
                case EdgeSeen(): history.edge(news.flash, news.host_ns, news.boot_epoch)
        port.write(head.pending(now))              # at least every few ms
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

from annulus_pipe.controller import TICK_NS
from annulus_pipe.link.boots import BootWatch, flash_from
from annulus_pipe.link.clock import ClockMap
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    CameraTrigger,
    Clear,
    Command,
    Commit,
    Configuration,
    ConfigurationReply,
    Edge,
    Fault,
    IdentifyReply,
    Interlock,
    Ping,
    PingReply,
    Polarity,
    Preamble,
    Slides,
    SlidesLit,
    SlidesLitReply,
    Stage,
    StateFlag,
    Status,
    StatusCode,
    StatusReply,
    Wiring,
    WiringReply,
)
from annulus_pipe.link.phase import Phase
from annulus_pipe.link.pins import AS_WIRED, Pins
from annulus_pipe.link.preamble import PreambleOrders
from annulus_pipe.link.problems import (
    LATCHING,
    STOPPED,
    TAKEN_OVER,
    configuration_problem,
    is_stopped,
    refusal,
    schema_problem,
    too_old,
)
from annulus_pipe.link.session import Answer, EventReceived, LinkEvent, LinkSession, Rebooted, Unanswered, identify
from annulus_pipe.vocabulary import EdgeFlag, Flash

PING_NS = 97_300_000  # no multiple of a frame period, so samples fall everywhere in the frame; far inside host_timeout
QUICK_PING_NS = 4_000_000  # until the clock is locked
STATUS_NS = 1_013_000_000
RETRY_NS = 150_000_000  # after a refusal or a silence that may pass
PERIOD_TICKS = 4_000_000  # while nothing is configured: 25 fps
MISMATCH_NS = 1_000_000_000  # between two looks whether the controller has been flashed anew
EDGES_WAITING_MAX = 64  # for the clock to lock
# Which a controller of level 1 does not have.
ADDED = (Configuration, Preamble, Polarity, CameraTrigger, Wiring, Slides, SlidesLit, Interlock)
WIRED_NEXT = {Phase.WIRING: Phase.TRIGGERING, Phase.TRIGGERING: Phase.SHARING, Phase.SHARING: Phase.COMMITTING}
MENDABLE = (StatusCode.BAD_STATE, StatusCode.UNSAFE)  # may pass by itself: tried again


@dataclass(frozen=True, slots=True)
class EdgeSeen:
    """An edge, placed in host time. `boot_epoch` counts the boots of the controller this host has met."""

    flash: Flash
    host_ns: int
    error_ns: int
    boot_epoch: int
    nonce: int | None = None  # what that boot drew; None: the controller has not told it (yet)


@dataclass(frozen=True, slots=True)
class LampsCut:
    """Somewhere in this span a lamp may have gone dark before its time, or come on after it should have: a fault, or
    arming changed. A flash in it is not to be trusted, whatever its edge says.
    """

    from_ns: int
    to_ns: int
    why: str


@dataclass(frozen=True, slots=True)
class PhaseChanged:
    phase: Phase
    why: str  # one line for the user, empty when all goes well


HeadEvent = LinkEvent | EdgeSeen | LampsCut | PhaseChanged


class HeadControl:
    """Drives one LinkSession. What it armed it arms again after a reset or a fault; not after a stop that somebody else
    ordered, over this line or another.
    """

    def __init__(
        self,
        configuration: Stage | None = None,
        *,
        armed: bool = True,
        preamble: Preamble | None = None,
        pins: Pins = AS_WIRED,
        interlock: Interlock | None = None,
    ) -> None:
        """`configuration` None: identify and keep alive only. `preamble`: what optical preambles are to be like, where
        the controller has them. `pins`: what the wiring wants of them; where that is anything, a controller that does
        not know of it is not armed. `interlock`: its inputs, likewise; None leaves them as they are.
        """
        self.session = LinkSession()
        self.clock = ClockMap()
        self.phase = Phase.SEARCHING
        self.problem = ""  # why the phase is REFUSED or MISMATCH, or what is being waited for
        self.identity: IdentifyReply | None = None
        self.status: StatusReply | None = None  # the last one heard
        self.boot_epoch = 0
        self.rearms = 0  # times the lamps were armed again after a reset or fault
        self.edges_unplaced = 0  # heard, but there was no clock map, or too coarse a one, to place them with
        self._configuration = configuration
        self._interlock = interlock
        self._pins = pins
        self._armed = armed
        self.preambles = PreambleOrders(preamble, configuration.frame_period if configuration else PERIOD_TICKS)
        self._lit = False  # armed, by all we know
        self._contradicted = False  # by one status; a second one settles it
        self._fresh = armed  # told to arm, and not armed since: whoever was there before has to give way
        self._generation = 0
        self._waiting: int | None = None  # ticket of the step under way
        self._next_step_ns = self._next_ping_ns = self._next_status_ns = 0
        self._boots = BootWatch()
        self._early: deque[tuple[Edge, int, int]] = deque(maxlen=EDGES_WAITING_MAX)  # edge, boot, received
        self._has_run = False
        self._committed = False  # our configuration is in force in this boot
        self._cleared = False  # a fault was cleared and the lamps have not been armed since
        self._step_sent_ns = 0
        self._news: list[HeadEvent] = []

    def configure(self, configuration: Stage | None) -> None:
        """Another configuration, put in force as soon as the controller lets it (dark in between)."""
        self._configuration = configuration
        self._committed = False
        if self.phase not in (Phase.SEARCHING, Phase.MISMATCH):
            self._restart_steps(Phase.DISARMING)

    def arm(self) -> None:
        self._armed = self._fresh = True
        if self.phase is Phase.IDLE:
            self._restart_steps(Phase.DISARMING)
        elif self.phase is Phase.STOPPED:
            self._restart_steps(Phase.SEARCHING)

    def disarm(self) -> None:
        """Lamps off, and kept off. Sent with the next `pending`."""
        self._armed = False
        self.preambles.forget()
        if self.phase not in (Phase.SEARCHING, Phase.MISMATCH, Phase.STOPPED):
            self._restart_steps(Phase.DISARMING)

    def order_preamble(self) -> None:
        """An optical preamble soon, where the controller has them."""
        self.preambles.ask()

    @property
    def lacks_preamble(self) -> bool:
        """Optical preambles are wanted, and this controller is too old for them."""
        return self.preambles.wanted is not None and self.session.informed and not self.session.knows(Preamble)

    def reopened(self) -> None:
        """The port was opened again: who is there now is asked before anything else."""
        self.session.reopened()
        self._restart_steps(Phase.SEARCHING, "the line was opened again")

    @property
    def generation(self) -> int:
        """Of the configuration last staged; 0 before the first."""
        return self._generation

    # ---- bytes in, bytes out ----

    def receive(self, data: bytes, now: int) -> list[HeadEvent]:
        """What these bytes and the passing of time bring. Happenings of the session are among it, for who logs them."""
        happenings = self.session.receive(data, now) + self.session.expire(now)
        for happening in happenings:
            self._news_of(happening, now)
        news, self._news = self._news, []
        return news

    def pending(self, now: int) -> bytes:
        """The bytes due now."""
        if self.phase is not Phase.RUNNING and self._waiting is None and now >= self._next_step_ns:
            step = self._step()
            if step is not None and self._may_be_asked(step):
                self._waiting = self.session.send(step)
                self._step_sent_ns = now
                self._lit &= not isinstance(step, Arm)
        if self.phase is not Phase.SEARCHING and not self.session.backlog:  # a line that is stuck is not fed further
            if now >= self._next_ping_ns:
                self._next_ping_ns = now + (PING_NS if self.clock.locked else QUICK_PING_NS)
                self.session.send(Ping())
            if now >= self._next_status_ns:
                self._next_status_ns = now + STATUS_NS
                self.session.send(Status())
            order = self.preambles.due(now)
            if order is not None and self.phase is Phase.RUNNING and self.session.knows(Preamble):
                self.preambles.sent(self.session.send(order), now)
        return self.session.pending(now)

    def _step(self) -> Command | None:
        """The command that the present phase waits for."""
        match self.phase:
            case Phase.SEARCHING | Phase.MISMATCH:
                return identify()
            case Phase.LOOKING:
                return Status()
            case Phase.DISARMING:
                return Arm(ArmFlag(0))
            case Phase.GUARDING:
                return self._interlock
            case Phase.STAGING if self._configuration is not None:
                return replace(self._configuration, generation=self._generation)
            case Phase.WIRING:
                return self._pins.polarity(self._generation)
            case Phase.TRIGGERING:
                return self._pins.trigger(self._generation)
            case Phase.SHARING:
                return self._pins.shared(self._generation)
            case Phase.COMMITTING:
                return Commit(self._generation)
            case Phase.VERIFYING:
                return Configuration()
            case Phase.CONFIRMING:
                return Wiring()
            case Phase.SHARED:
                return SlidesLit()
            case Phase.PREPARING:
                return self.preambles.wanted
            case Phase.CLEARING:
                return Clear()
            case Phase.ARMING:
                return Arm(ArmFlag.LAMPS)
        return None

    def _may_be_asked(self, step: Command) -> bool:
        """Whether the controller knows a command of later firmware, which is settled once `info` is answered. One that
        lacks what the wiring needs is refused.
        """
        if not isinstance(step, ADDED) or self.session.knows(type(step)):
            return True
        wired = isinstance(step, Polarity) and self._pins != AS_WIRED
        wired |= isinstance(step, Slides) and self._pins.slides > 1
        if self.session.informed and (wired or isinstance(step, Interlock)):  # an input that nobody would look at
            self._enter(Phase.REFUSED, too_old(type(step)))
        elif self.session.informed:
            self._go_on_from(self.phase)
        return False

    def _go_on_from(self, phase: Phase) -> None:
        """With what is in force: preambles, then the lamps."""
        if phase in WIRED_NEXT:
            self._enter(WIRED_NEXT[phase])
        elif phase is Phase.VERIFYING and self.session.knows(Wiring):
            self._enter(Phase.CONFIRMING)
        elif phase is Phase.CONFIRMING and self._pins.slides > 1:
            self._enter(Phase.SHARED)
        elif phase in (Phase.VERIFYING, Phase.CONFIRMING, Phase.SHARED) and self.preambles.wanted is not None:
            self._enter(Phase.PREPARING)
        else:
            self._enter(Phase.ARMING if self._armed else Phase.IDLE)

    def _enter(self, phase: Phase, why: str = "") -> None:
        if (phase, why) != (self.phase, self.problem):
            self.phase, self.problem = phase, why
            self._news.append(PhaseChanged(phase, why))

    def _restart_steps(self, phase: Phase, why: str = "") -> None:
        """Go on from `phase`; an answer still to come for an earlier step no longer counts."""
        self._waiting = None
        self._next_step_ns = 0
        self._enter(phase, why)

    def _advance(self, answer: Answer, now: int) -> None:
        self._waiting = None
        self._next_step_ns = 0
        if isinstance(answer.command, Arm):
            self._news.append(LampsCut(self._step_sent_ns, now, "arming changed"))
        if isinstance(answer.reply, IdentifyReply):
            self._identified(answer.reply, now)
            return
        if answer.reply.status is not StatusCode.OK:
            self._refused(answer, now)
            return
        match answer.command:
            case Arm(outputs) if ArmFlag.LAMPS in outputs:
                self.rearms += self._has_run
                self._has_run = self._lit = True
                self._cleared = self._contradicted = self._fresh = False
                self._enter(Phase.RUNNING)
            case Arm() if self._interlock is not None:
                self._enter(Phase.GUARDING)
            case Arm() | Interlock() if self._configuration is None:
                self._enter(Phase.IDLE)
            case Arm() | Interlock():
                self._generation = self._generation % 255 + 1
                self._enter(Phase.STAGING)
            case Stage():
                self._enter(Phase.WIRING)
            case Polarity() | CameraTrigger() | Slides():
                self._go_on_from(self.phase)
            case Commit():
                self._committed = True
                self._enter(Phase.VERIFYING)
            case Configuration() if isinstance(answer.reply, ConfigurationReply):
                self._verified(answer.reply)
            case Wiring() if isinstance(answer.reply, WiringReply):
                self._settle(self._pins.problem(answer.reply, self._generation))
            case SlidesLit() if isinstance(answer.reply, SlidesLitReply):
                self._settle(self._pins.slides_problem(answer.reply, self._generation))
            case Preamble():
                self._go_on_from(Phase.PREPARING)
            case Status() if isinstance(answer.reply, StatusReply):
                self._looked(answer.reply)
            case Clear():
                self._cleared = True
                self._enter(Phase.ARMING if self._armed and self._committed else Phase.DISARMING)

    def _identified(self, reply: IdentifyReply, now: int) -> None:
        self.identity = reply
        self._next_ping_ns = self._next_status_ns = now
        problem = schema_problem(reply)
        if problem:
            self._next_step_ns = now + MISMATCH_NS
            self._enter(Phase.MISMATCH, problem)
        elif reply.status is StatusCode.BAD_STATE:
            self._next_step_ns = now + RETRY_NS
            self._enter(Phase.SEARCHING, "another host is at work over the controller's other line")
        else:
            self._enter(Phase.LOOKING if self._lit and self._armed else Phase.DISARMING)

    def _looked(self, status: StatusReply) -> None:
        """Met again without a restart, with the lamps armed when it was last heard of."""
        if is_stopped(status):
            self._stop(STOPPED)
        else:
            self._enter(Phase.DISARMING)

    def _verified(self, reply: ConfigurationReply) -> None:
        asked = replace(self._configuration, generation=self._generation) if self._configuration is not None else None
        self._settle(configuration_problem(reply, asked) if asked is not None else "")

    def _settle(self, problem: str) -> None:
        """What is in force was read back: is it what was asked for?"""
        if problem:
            self._committed = False
            self._enter(Phase.REFUSED, problem)
        else:
            self._go_on_from(self.phase)

    def _refused(self, answer: Answer, now: int) -> None:
        status = answer.reply.status
        if status is StatusCode.UNSAFE and isinstance(answer.command, Arm):
            self._next_step_ns = now + RETRY_NS if self._cleared else 0  # it has been cleared in vain
            self._enter(Phase.CLEARING, "a fault is latched")
        elif status in MENDABLE:
            self._next_step_ns = now + RETRY_NS
            self._enter(Phase.CLEARING if isinstance(answer.command, Clear) else Phase.DISARMING, refusal(answer))
        elif status is StatusCode.SCHEMA and self._fresh:  # ours is the same: the line is not the one that commands
            self._next_step_ns = now + RETRY_NS
            self._enter(Phase.SEARCHING, TAKEN_OVER)
        elif status is StatusCode.SCHEMA:
            self._stop(TAKEN_OVER)
        else:
            self._enter(Phase.REFUSED, refusal(answer))

    def _stop(self, why: str) -> None:
        """Somebody wants it dark: so it stays, until `arm`."""
        self._armed = self._lit = self._contradicted = False
        self.preambles.forget()
        self._restart_steps(Phase.STOPPED, why)

    def _news_of(self, happening: LinkEvent, now: int) -> None:
        if isinstance(happening, Rebooted):
            self._rebooted(happening)
        self._news.append(happening)
        if isinstance(happening, Answer | Unanswered):
            self.preambles.ended(happening.ticket)
        match happening:
            case Answer() if isinstance(happening.reply, PingReply):
                self._sampled(happening.reply, happening, now)
            case Answer() if happening.ticket == self._waiting:
                self._advance(happening, now)
            case Answer() if isinstance(happening.reply, StatusReply):
                self._check(happening.reply, now)
            case Unanswered() if self.phase is Phase.MISMATCH and happening.ticket != self._waiting:
                pass  # its layout may differ from ours
            case Unanswered() if self.phase is not Phase.SEARCHING or happening.ticket == self._waiting:
                self._restart_steps(Phase.SEARCHING, f"no answer to {type(happening.command).__name__.lower()}")
            case EventReceived(event, _, boot, received_ns, recovered) if isinstance(event, Edge):
                self._suspect(self._boots.edge(event.edge, recovered), now)
                self._suspect(self._boots.moment(self.clock, event.tick, received_ns), now)
                self.edges_unplaced += len(self._early) == EDGES_WAITING_MAX  # the oldest gives way
                self._early.append((event, boot, received_ns))
                if self.phase is Phase.RUNNING and EdgeFlag.DISARMED in event.flags:
                    self._next_status_ns = 0  # stale, or a fault we did not hear of
            case EventReceived(event) if isinstance(event, Fault) and event.fault in LATCHING:
                self._faulted(event, now)
        if self._early and self.clock.locked:
            self._news.extend(self._placed())

    def _sampled(self, reply: PingReply, answer: Answer, now: int) -> None:
        if answer.tries > 1 or reply.status is not StatusCode.OK:
            return
        if self._suspect(self._boots.ping(self.clock, reply.tick, answer.sent_ns, answer.received_ns), now):
            return
        was_locked = self.clock.locked
        self.clock.sample(reply.tick, answer.sent_ns, answer.received_ns)
        if was_locked and not self.clock.locked:  # these are another boot's ticks: ask who is there
            self._forget_edges()
            self._restart_steps(Phase.SEARCHING, "the controller's clock jumped")

    def _suspect(self, why: str, now: int) -> bool:
        """Taken for another boot, whatever its byte says: its events are never placed by the old one's clock."""
        for happening in self.session.suspect(why) if why else ():
            self._news_of(happening, now)
        return bool(why)

    def _check(self, status: StatusReply, now: int) -> None:
        self.status = status
        if self._suspect(self._boots.status(status.edges), now):
            return
        if self.phase is not Phase.RUNNING or StateFlag.LAMPS_ARMED in status.state:
            self._contradicted = False
        elif not is_stopped(status):
            self._lit = False
            self._restart_steps(Phase.CLEARING, f"disarmed by the controller: {status.fault.name.lower()}")
        elif self._contradicted:
            self._stop(STOPPED)
        else:
            self._contradicted = True
            self._next_status_ns = now

    @property
    def _error_max_ns(self) -> int:
        """Half the window in which a frame looks for its edge: on a line slower than that no edge is placed."""
        period = self._configuration.frame_period if self._configuration is not None else PERIOD_TICKS
        return period * TICK_NS // 8

    def _placed(self) -> Iterator[EdgeSeen]:
        while self._early:
            edge, boot, received_ns = self._early.popleft()
            tick = self.clock.extend(edge.tick, received_ns)
            host_ns = self.clock.to_host(tick)
            error_ns = self.clock.error_ns(host_ns) if host_ns is not None else None
            if host_ns is not None and error_ns is not None and error_ns <= self._error_max_ns:
                info = self.session.info
                nonce = info.nonce if info is not None else None
                yield EdgeSeen(flash_from(edge, tick, boot, self.boot_epoch), host_ns, error_ns, self.boot_epoch, nonce)
            else:
                self.edges_unplaced += 1

    def _faulted(self, event: Fault, now: int) -> None:
        moment = self.clock.to_host(self.clock.extend(event.tick, now))
        moment = now if moment is None else moment
        self._news.append(LampsCut(moment, moment, event.fault.name.lower()))
        self._lit = False
        if self.phase in (Phase.RUNNING, Phase.ARMING):
            self._restart_steps(Phase.CLEARING, f"fault: {event.fault.name.lower()}")

    def _rebooted(self, happening: Rebooted) -> None:
        self.boot_epoch += 1
        self._boots.restart()
        self._forget_edges()
        self.clock.restart()
        self._committed = self._lit = False
        self.preambles.forget()
        if happening.previous is not None:
            same = "" if happening.boot != happening.previous else f": {happening.why}"
            self._restart_steps(Phase.SEARCHING, f"the controller restarted{same}")

    def _forget_edges(self) -> None:
        self.edges_unplaced += len(self._early)
        self._early.clear()
