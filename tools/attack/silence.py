"""A host that says nothing: what is live ends within the timeout and not before, says so, and stays latched."""

from annulus_pipe.controller import PIN_CAMERA_TRIGGER, PIN_STEP
from annulus_pipe.link.messages import Arm, Clear, Fault, FaultCode, Move, Stage, StatusCode
from tools.attack.boards import MS, USB, Board, insist
from tools.attack.kept import Kept, Told

DEFAULT_MS = 500
USB_FRAME = MS


def silence(kept: Kept, told: list[Told], line: int, configs: list[Stage], latched: list[int], board: Board) -> None:
    """`latched`: ticks at which anything latched. Where the main loop was held, `configs` are the widest."""
    if line in kept.noise:
        return  # may have eaten a word
    heard = sorted(asked.through for asked in kept.asked if asked.line == line)
    timeouts = [(config.host_timeout or DEFAULT_MS) * MS for config in configs]
    slow = sum(end - begin for begin, end in kept.stalls)
    late = 2 * board.round_max + (2 * USB_FRAME if line == USB else 0) + slow
    flash = max(max(c.projector_width, c.led_width) for c in configs)
    for pin, pulses in kept.pulses.items():
        if pin == PIN_CAMERA_TRIGGER:
            continue  # armed or not
        last = kept.began
        words = iter([*heard, 1 << 62])
        following = next(words)
        for rise, fall in pulses:
            while following <= rise:
                last, following = following, next(words)
            for what, tick, most in (("rose", rise, 0), ("fell only", fall, flash)):
                insist(
                    tick - last <= max(timeouts) + late + most or tick > following,
                    f"GP{pin} {what} {(tick - last) / MS:.1f} ms after the host's last word",
                    tick,
                )
    for said, following in zip(heard, [*heard[1:], board.now], strict=True):
        due = said + max(timeouts) + late
        if due < following and _armed(kept, said, latched):
            insist(
                any(said - MS <= tick <= due for tick in latched),
                f"the host was silent for {(following - said) / MS:.0f} ms, which latched nothing",
                said,
            )
    if not kept.unplugged:  # what came while the main loop stood still may have been lost
        heard = sorted(asked.through for asked in kept.asked if asked.line == line and asked.reply)
        _never_early(told, heard, min(timeouts), late)
    _stays(kept, told)


def _armed(kept: Kept, tick: int, latched: list[int]) -> bool:
    """By the last order before, and surely."""
    orders = [a for a in kept.asked if isinstance(a.command, Arm) and a.sent <= tick]
    if not orders or any(a.reply is None for a in orders):
        return False
    order = orders[-1]
    assert isinstance(order.command, Arm)
    assert order.reply
    accepted = order.reply.status == StatusCode.OK and bool(order.command.outputs)
    return accepted and not any(order.sent <= when <= tick for when in latched)


def _never_early(told: list[Told], heard: list[int], timeout: int, late: int) -> None:
    for item in told:
        if isinstance(item.event, Fault) and item.event.fault == FaultCode.HOST_TIMEOUT:
            # A word that came in the very round came too late.
            last = max((tick for tick in heard if tick <= item.tick - late), default=0)
            insist(
                item.tick - last >= timeout - late,
                f"fault host_timeout {(item.tick - last) / MS:.1f} ms after the host's last word",
                item.tick,
            )


def _stays(kept: Kept, told: list[Told]) -> None:
    assert kept.last
    faults = [i for i in told if isinstance(i.event, Fault) and i.event.fault == FaultCode.HOST_TIMEOUT]
    if faults and not any(isinstance(a.command, Clear) and a.answered >= faults[-1].tick for a in kept.asked):
        insist(kept.last.fault == FaultCode.HOST_TIMEOUT, f"host_timeout told, state says {kept.last.fault!r}")


def unplugged(kept: Kept, line: int, board: Board) -> None:
    """Without its plug or its 5 V the line of who commands is lost at once: dark, and no step, until one orders it."""
    late = 2 * board.round_max + sum(end - begin for begin, end in kept.stalls)
    for pulled in kept.unplugged if line == USB else ():
        dark = pulled + late
        later = [asked for asked in kept.asked if asked.sent > pulled]
        arms = [asked.sent for asked in later if isinstance(asked.command, Arm) and asked.command.outputs]
        moves = [asked.sent for asked in later if isinstance(asked.command, Move)]
        for pin, pulses in kept.pulses.items():
            until = min([1 << 62, *(moves if pin == PIN_STEP else arms)])
            for rise, fall in pulses if pin != PIN_CAMERA_TRIGGER else ():
                if pulled <= fall and rise < until:
                    insist(fall <= dark, f"GP{pin} high {(fall - pulled) / MS:.2f} ms after the plug was pulled", rise)
