"""What was said and heard in one scene, and which falling edges were the controller's."""

from dataclasses import dataclass, field

from annulus_pipe.controller import (
    CAMERA_TRIGGER_MIN_TICKS,
    PIN_CAMERA_TRIGGER,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
)
from annulus_pipe.link.messages import (
    CameraTrigger,
    Command,
    Commit,
    Configured,
    Event,
    HealthReply,
    Reply,
    Stage,
    StatusCode,
    StatusReply,
)

OPENS = {PIN_INTERLOCK: 1, PIN_INTERLOCK_ANTIVALENT: 0}  # level at which an input of the interlock says open

A_ROUND = 50_000  # ticks: from the tick an event of the main loop bears until what it tells of is surely done
UNPLUGGED = 500_000  # and from when a plug was pulled until nothing that came before is taken

Trigger = tuple[int, int, int]  # of cameras: period, width, and delay after an edge of the sync input


@dataclass(slots=True)
class Asked:
    """One command, when it was on its way, and what came back."""

    command: Command
    line: int
    sequence: int
    sent: int
    through: int  # its last byte has arrived, if nothing holds it up
    reply: Reply | None = None
    answered: int = 1 << 62  # the look at which its answer was there
    start: int = 0  # of a train


@dataclass(slots=True)
class Told:
    """One event, at its tick of the world."""

    index: int  # since boot
    event: Event
    tick: int


@dataclass(slots=True)
class Kept:
    """Of one scene, in ticks of the world."""

    began: int = 0
    asked: list[Asked] = field(default_factory=list)
    told: dict[int, Told] = field(default_factory=dict)
    times_told: dict[int, list[int]] = field(default_factory=dict)  # index of an event: when it came
    pulses: dict[int, list[tuple[int, int]]] = field(default_factory=dict)
    stalls: list[tuple[int, int]] = field(default_factory=list)
    opened: list[int] = field(default_factory=list)
    unplugged: list[int] = field(default_factory=list)
    noise: list[int] = field(default_factory=list)
    falls: list[int] = field(default_factory=list)
    doubtful: set[int] = field(default_factory=set)  # of these, those that may count or not: the clock just changed
    trigger: Trigger | None = (0, 0, 0)  # of cameras, in force before; None where that is not known
    restarts: list[tuple[int, int]] = field(default_factory=list)  # from when to when the edges' clock may have changed
    boots: int = 0  # the controller began anew
    first: StatusReply | None = None
    last: StatusReply | None = None
    health_before: HealthReply | None = None  # where the controller can tell
    health: HealthReply | None = None
    before: list[Told] = field(default_factory=list)  # told by the boots that ended in the scene

    @property
    def missed(self) -> int:
        """Transitions the controller counted as lost or impossible, since boot."""
        return missed(self.health)

    @property
    def lost(self) -> int:
        """And in this scene."""
        return missed(self.health) - missed(self.health_before)

    @property
    def dropped(self) -> int:
        """Edges that it had no room for."""
        return self.health.edges_dropped - self.health_before.edges_dropped if self.health and self.health_before else 0


def missed(health: HealthReply | None) -> int:
    return health.odometer_lost + health.odometer_impossible if health else 0


def accepted(asked: Asked) -> bool:
    return asked.reply is not None and asked.reply.status == StatusCode.OK


def carried_out(kept: Kept, asked: Asked) -> int | None:
    """By when at the latest; None: not, or nobody can tell. Where the answers went with a plug, a configuration that
    came into force was committed, and what the host had sent for it before was taken.
    """
    if accepted(asked):
        return asked.answered
    command = asked.command
    pulled = next((tick for tick in kept.unplugged if tick >= asked.sent), None)
    if pulled is None or not isinstance(command, Stage | CameraTrigger | Commit):
        return None
    if any(a.reply for a in kept.asked if a.line == asked.line and asked.sent <= a.sent <= pulled):
        return None  # itself, or one that came after it: only it was lost
    events = [(item.tick, item.event) for item in kept.told.values() if item.tick >= asked.sent]
    shown = [t for t, event in events if isinstance(event, Configured) and event.generation == command.generation]
    if shown:
        return max(shown) + A_ROUND
    commits = [a.command for a in kept.asked if a.sent < asked.sent and accepted(a) and isinstance(a.command, Commit)]
    before = any(commit.generation == command.generation for commit in commits)  # another, with the same number
    if before or kept.last is None or kept.last.generation != command.generation:
        return None
    return pulled + sum(end - begin for begin, end in kept.stalls) + UNPLUGGED


def edges_of(kept: Kept) -> Trigger | None:
    """Finds the falls that are the controller's edges: of the sync input, or of the cameras' triggers while it makes
    them. What of these is in force in the end.
    """
    since = next(asked.sent for asked in kept.asked if asked.reply is kept.first)
    clocks = {False: kept.falls, True: [fall for _, fall in kept.pulses.get(PIN_CAMERA_TRIGGER, ()) if fall > since]}
    kept.falls, begin, makes = [], 0, kept.trigger is not None and leads(kept.trigger)
    changes, force = triggers(kept, kept.trigger)
    for sent, done, trigger in changes:
        kept.restarts.append((sent, done))
        kept.falls += [fall for fall in clocks[makes] if begin <= fall < sent]
        either = sorted(fall for falls in clocks.values() for fall in falls if max(sent, begin) <= fall <= done)
        makes, begin = leads(trigger), max(begin, done + 1)
        kept.falls += either
        kept.doubtful.update(either, [fall for fall in clocks[makes] if fall > done][:1])  # which ends no hold-off
    kept.falls += [fall for fall in clocks[makes] if begin <= fall]
    unsure = kept.boots or any(asked.reply is None for asked in kept.asked if isinstance(asked.command, Commit))
    return None if unsure else force


def leads(trigger: Trigger) -> bool:
    """Are their ends the edges?"""
    return trigger[1] > 0 and trigger[2] == 0


def triggers(kept: Kept, before: Trigger | None) -> tuple[list[tuple[int, int, Trigger]], Trigger]:
    """When what is in force of them may have changed, and to what; and what is in force in the end. `before`: in force
    at first, where that is known.
    """
    force = staged = before or (0, 0, 0)
    changes: list[tuple[int, int, Trigger]] = []
    for asked in kept.asked:
        command, done = asked.command, carried_out(kept, asked)
        if done is None:
            continue
        if isinstance(command, Stage):
            _, width, delay = force
            holdoff = command.frame_period - command.frame_period * command.tolerance // 1000
            room = delay + width + CAMERA_TRIGGER_MIN_TICKS <= (holdoff if delay else command.frame_period)
            staged = (command.frame_period, width, delay) if room else (command.frame_period, 0, 0)
        elif isinstance(command, CameraTrigger):
            staged = (staged[0], command.width, command.delay)
        elif isinstance(command, Commit):
            same_pace = staged[1:] == force[1:] and (staged[0] == force[0] or not leads(staged))
            if (before is None and not changes) or not same_pace:
                changes.append((asked.sent, done, staged))
            force = staged
    return changes, force
