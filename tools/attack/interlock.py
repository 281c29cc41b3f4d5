"""The interlock and its one or two inputs: what is dark while it is open, what it forbids, when the two disagree."""

from bisect import bisect_right

from annulus_pipe.controller import (
    INTERLOCK_DISAGREE_MS,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_MICROWAVE,
    PIN_TRIGGER,
)
from annulus_pipe.link.messages import Clear, Fault, FaultCode, StateFlag, StatusCode, StatusReply
from tools.attack.boards import MS, Board, insist
from tools.attack.kept import OPENS, Kept, Told, accepted
from tools.attack.products_truth import latching
from tools.attack.scenes import Scene

# Of each input: ticks that it must be open for hardware to see it, shorter and the core cuts within a round; ticks from
# then to the gate low. A chip is at least as long.
ONE = {PIN_INTERLOCK: (4, 10)}
BOTH = {PIN_INTERLOCK: (8, 10), PIN_INTERLOCK_ANTIVALENT: (20, 20)}
DISAGREE = INTERLOCK_DISAGREE_MS * MS
Span = tuple[int, int]  # from when to when, in ticks of the world


def inputs_of(scene: Scene) -> dict[int, tuple[int, int]]:
    return BOTH if scene.antivalent else ONE


def open_spans(kept: Kept, scene: Scene, which: int) -> list[Span]:
    """In which this input was open."""
    spans, since = list[Span](), None
    for tick, pin, level in scene.inputs:
        if pin == which and level == OPENS[which] and since is None:
            since = kept.began + tick
        elif pin == which and level != OPENS[which] and since is not None:
            spans.append((since, kept.began + tick))
            since = None
    return spans


def all_spans(kept: Kept, scene: Scene) -> list[Span]:
    return sorted(span for pin in inputs_of(scene) for span in open_spans(kept, scene, pin))


def is_open(kept: Kept, scene: Scene, low: int, high: int) -> bool:
    """Surely, by one and the same input, from one tick to another."""
    return any(opened < low and high < shut for opened, shut in all_spans(kept, scene))


def cuts(kept: Kept, scene: Scene, slow: int) -> None:
    """No pulse begins while it is open, and none outlasts its opening. `slow`: ticks a round takes, and stalls."""
    for which, (seen, cut) in inputs_of(scene).items():
        for opened, shut in open_spans(kept, scene, which):
            most = cut + (slow if shut - opened <= seen else 0)
            for pin in (PIN_MICROWAVE, PIN_TRIGGER):
                pulses = kept.pulses.get(pin, [])
                for rise, fall in pulses[max(0, bisect_right(pulses, (opened, 0)) - 1) :]:
                    if rise >= max(shut, opened + most):
                        break
                    within = rise < min(shut, opened + most) or rise < opened
                    late = rise > opened + most and rise < shut
                    insist(not late, f"GP{pin} rose with the interlock open", rise)
                    lasts = within and fall > opened + most
                    insist(not lasts, f"GP{pin} high {fall - opened} ticks after GP{which} opened", rise)


def says(kept: Kept, told: list[Told], scene: Scene) -> None:
    """Every status says whether it is open; no `clear` is taken while it is, where that is why anything latched."""
    spans, faults = all_spans(kept, scene), latching(told)
    clears = [asked for asked in kept.asked if isinstance(asked.command, Clear)]
    for asked in kept.asked:
        if isinstance(asked.reply, StatusReply) and asked.sent >= kept.began:
            says_open = bool(asked.reply.state & StateFlag.INTERLOCK_OPEN)
            may_be = any(opened <= asked.answered and asked.sent <= shut for opened, shut in spans)
            insist(may_be or not says_open, "status says that the interlock is open", asked.sent)
            insist(says_open or not is_open(kept, scene, asked.sent, asked.answered), "status says closed", asked.sent)
    for clear in clears:
        before = [what for item, what in faults if item.tick < clear.sent - MS]
        taken = any(
            accepted(c) and before and c.answered > faults[len(before) - 1][0].tick and c.sent < clear.sent
            for c in clears
        )
        is_why = bool(before) and before[-1] in (FaultCode.INTERLOCK, FaultCode.INTERLOCK_DISAGREES)
        if is_why and not taken and is_open(kept, scene, clear.sent, clear.answered) and clear.reply:
            insist(clear.reply.status == StatusCode.UNSAFE, "clear taken with the interlock open", clear.sent)


def contradictions(kept: Kept, scene: Scene) -> list[Span]:
    """In which one input said open and the other one closed."""
    if not scene.antivalent:
        return []
    says, spans = {PIN_INTERLOCK: False, PIN_INTERLOCK_ANTIVALENT: False}, list[Span]()
    since: int | None = None
    for tick, pin, level in scene.inputs:
        if pin in says:
            says[pin] = level == OPENS[pin]
            disagree = len({*says.values()}) > 1
            if disagree and since is None:
                since = kept.began + tick
            elif not disagree and since is not None:
                spans.append((since, kept.began + tick))
                since = None
    return [span for span in spans if span[0] < span[1]]


def disagrees(kept: Kept, told: list[Told], scene: Scene, board: Board) -> None:
    """Told when two inputs contradict each other for longer than a relay's contacts take, and never otherwise."""
    late = 2 * board.round_max + sum(end - begin for begin, end in kept.stalls)
    spans = contradictions(kept, scene)
    seen: list[Span] = []  # as one that looks once a round may see them
    for begin, end in spans:
        if seen and begin - seen[-1][1] <= late:
            seen[-1] = (seen[-1][0], end)
        else:
            seen.append((begin, end))
    ticks = [i.tick for i in told if isinstance(i.event, Fault) and i.event.fault == FaultCode.INTERLOCK_DISAGREES]
    for tick in ticks:
        fits = any(begin + DISAGREE <= tick + board.stamp and tick <= end + late for begin, end in seen)
        insist(fits, "fault interlock_disagrees, and they did not for so long", tick)
    clears = [asked for asked in kept.asked if isinstance(asked.command, Clear)]
    if any(clear.reply is None for clear in clears) or kept.unplugged:
        return
    taken = sorted((clear.sent, clear.answered) for clear in clears if accepted(clear))
    for begin, end in spans:
        marks = [begin, *(done for sent, done in taken if begin <= done and sent <= end)]
        for mark, until in zip(
            marks, [*(sent for sent, done in taken if begin <= done and sent <= end), end], strict=True
        ):
            if until - mark <= DISAGREE + late:
                continue
            since = max((sent for sent, done in taken if done <= mark), default=0)  # said once, until it is cleared
            insist(
                any(since <= tick <= mark + DISAGREE + late for tick in ticks),
                f"two inputs contradicted each other for {(end - begin) / MS:.1f} ms, and nothing told it",
                begin,
            )
