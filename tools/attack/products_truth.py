"""What must hold where subsystems meet: the first fault stays, an open interlock forbids, triggers are exact, an update
and a measurement forbid what they must and say what they cost.
"""

from bisect import bisect_left, bisect_right
from itertools import pairwise

from annulus_pipe.controller import PIN_CAMERA_TRIGGER
from annulus_pipe.link.messages import (
    Booted,
    Clear,
    Commit,
    Edge,
    Event,
    Fault,
    FaultCode,
    Identify,
    Measure,
    StatusReply,
)
from annulus_pipe.vocabulary import EdgeFlag
from tools.attack.boards import MS, insist
from tools.attack.kept import Asked, Kept, Told, accepted, triggers
from tools.attack.scenes import Scene

LATCHING = {
    FaultCode.INTERLOCK,
    FaultCode.HOST_TIMEOUT,
    FaultCode.WATCHDOG,
    FaultCode.LIMIT,
    FaultCode.INTERLOCK_DISAGREES,
}
TRIGGER_LATE = 60  # ticks that one may begin later than its delay after an edge
SETTLED = 40  # ticks by which an edge and a transition of the odometer may change places


def is_latching(event: Event) -> bool:
    return isinstance(event, Booted) or (isinstance(event, Fault) and event.fault in LATCHING)


# ---- faults ----


def latching(told: list[Told]) -> list[tuple[Told, FaultCode]]:
    return [(i, i.event.fault) for i in told if isinstance(i.event, Fault) and i.event.fault in LATCHING]


def first_fault_stays(kept: Kept, told: list[Told]) -> None:
    """Until a `clear` is taken, nothing else latches (inputs that disagree are told of) and every status names it."""
    clears = [asked for asked in kept.asked if isinstance(asked.command, Clear)]
    faults, behind = latching(told), list[int]()
    for (first, what), (second, other) in pairwise(faults):
        between = any(accepted(c) and c.answered >= first.tick and c.sent <= second.tick for c in clears)
        told_only = other == FaultCode.INTERLOCK_DISAGREES
        sure = between or told_only or any(c.reply is None for c in clears)
        insist(sure, f"{other!r} latched over {what!r}", second.tick)
        surely = any(accepted(c) and first.tick <= c.sent and c.answered <= second.tick for c in clears)
        if told_only and not surely:
            behind.append(second.index)
    faults = [(item, what) for item, what in faults if item.index not in behind]
    ends = [*(item.tick for item, _ in faults), 1 << 62][1:]
    for (first, what), end in zip(faults, ends, strict=True):
        cleared = min((c.sent for c in clears if c.answered >= first.tick), default=1 << 62)
        for asked in kept.asked:
            reply = asked.reply
            if isinstance(reply, StatusReply) and first.tick < asked.sent and asked.answered < min(cleared, end):
                insist(reply.fault == what, f"status says {reply.fault!r}, latched was {what!r}", asked.sent)


# ---- the cameras' clock ----


def camera_trigger(kept: Kept, edges: list[int] | None) -> None:
    """Exact width, and period or delay, but where a commit changed them. `edges`: ticks of those that counted."""
    before = kept.trigger
    changes, _ = triggers(kept, before)
    pulses = kept.pulses.get(PIN_CAMERA_TRIGGER, [])
    if kept.boots or any(asked.reply is None for asked in kept.asked if isinstance(asked.command, Commit)):
        return
    at, (period, width, delay) = 0, before or (0, 0, 0)
    known = before is not None
    for sent, answered, new in [*changes, (1 << 62, 1 << 62, (0, 0, 0))]:
        mine = pulses[at : bisect_left(pulses, (sent, 0))]
        mine = (mine[1:] if at else mine) if known else []  # the first one may last longer
        known = True
        insist(width > 0 or not mine, "a trigger, though there are none", mine[0][0] if mine else 0)
        for rise, fall in mine[: -1 if sent < 1 << 62 else None]:
            insist(fall - rise == width, f"a trigger of {fall - rise} ticks, {width} were in force", rise)
        if delay:
            _begun_by_edges(mine, edges, delay) if edges is not None else None
        else:
            for (first, _), (second, _) in pairwise(mine):
                insist(second - first == period, f"a trigger after {second - first} ticks, due {period}", second)
        at, (period, width, delay) = bisect_right(pulses, (answered, 0)), new


def _begun_by_edges(triggers: list[tuple[int, int]], edges: list[int], delay: int) -> None:
    """Each by one that counted, and by every one of those between them."""
    begun = set[int]()
    for rise, _ in triggers:
        at = bisect_right(edges, rise - delay) - 1
        late = rise - delay - edges[at] if at >= 0 else 1 << 62
        insist(late <= TRIGGER_LATE, f"a trigger {late} ticks after an edge and {delay}", rise)
        begun.add(at)
    missing = set(range(min(begun), max(begun))) - begun if begun else set[int]()
    insist(not missing, "an edge that counted and began no trigger", edges[min(missing)] if missing else 0)


# ---- a measurement ----


def measured(kept: Kept) -> list[tuple[int, int, int, int]]:
    """Begun at the earliest and latest, ended at the earliest and latest; each measurement that may have been."""
    spans: list[tuple[int, int, int, int]] = []
    begun: Asked | None = None
    ends = 1 << 62  # `begun` at the earliest: by an order of which nobody knows whether it was heard
    for asked in kept.asked:
        command = asked.command
        begins = isinstance(command, Measure) and command.looks > 0
        if not isinstance(command, Measure | Identify):
            continue
        if begins and asked.reply is None:
            spans.append((asked.sent, 1 << 62, asked.sent, 1 << 62))
        elif asked.reply is None:
            ends = min(ends, asked.sent)
        elif begun and (not begins or (accepted(asked) and ends < asked.sent)):
            spans.append((begun.sent, begun.answered, min(ends, asked.sent), asked.answered))
            begun, ends = asked if begins else None, 1 << 62
        elif begins and accepted(asked):
            begun, ends = begun or asked, ends if begun else 1 << 62
    if begun:
        spans.append((begun.sent, begun.answered, ends, 1 << 62))
    return spans


def is_frozen(event: Event) -> bool:
    return isinstance(event, Edge) and bool(event.flags & EdgeFlag.ODOMETER_FROZEN)


def frozen_odometer(kept: Kept, told: list[Told], scene: Scene, base: int, lost: int) -> None:
    """Edges in a measurement and the first after it say so, and no others; those others count on from one another."""
    spans = measured(kept)
    slow = 20 * MS + sum(end - begin for begin, end in kept.stalls)  # all edges of a round are flagged alike
    ticks, counts = [kept.began + tick for tick, _ in scene.steps], [0]
    for _, way in scene.steps:
        counts.append(counts[-1] + way)
    offsets: set[int] | None = {base}  # of what it says to where the cable is; None: any
    edges = [(item.tick, item.event) for item in told if isinstance(item.event, Edge)]
    for number, (tick, edge) in enumerate(edges):
        within = any(latest < tick < ends for _, latest, ends, _ in spans)
        before = edges[number - 1][0] if number else 0
        near = any(begins - slow <= tick and before - slow <= ended for begins, _, _, ended in spans)
        insist(is_frozen(edge) or not within, f"{edge}: unflagged, and a measurement was under way", tick)
        insist(near or not number or not is_frozen(edge), f"{edge}: flagged, and no measurement was near", tick)
        if is_frozen(edge):
            offsets = None
            continue
        low, high = bisect_left(ticks, tick - SETTLED), bisect_right(ticks, tick + SETTLED)
        here = {edge.odometer - count for count in counts[low : high + 1]}
        if any(begins - MS <= tick for begins, _, _, _ in spans) and offsets is not None and not offsets & here:
            offsets = None
        if any(begin <= tick for begin, _ in kept.stalls):
            continue
        insist(
            offsets is None or any(abs(a - b) <= lost for a in offsets for b in here),
            f"{edge}: the odometer is off by another {here} than before, {offsets}",
            tick,
        )
        offsets = here if offsets is None else offsets & here or here
