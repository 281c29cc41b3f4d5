"""What must hold of the odometer: it is right, or it says of how many counts it may be off."""

from bisect import bisect_left, bisect_right

from annulus_pipe.link.messages import Edge, Event, Fault, FaultCode
from tools.attack.boards import MS, insist
from tools.attack.kept import Kept, Told
from tools.attack.scenes import Scene

HELD = 448  # transitions in one round that are followed, at the least
SETTLED = 40  # ticks by which an edge and a transition may change places
HUSH = 100 * MS  # between two reports


def is_odometer(event: Event) -> bool:
    """As a host of either level is told."""
    if not isinstance(event, Fault):
        return False
    stands_in = event.fault == FaultCode.NONE and event.detail == FaultCode.ODOMETER
    return stands_in or event.fault == FaultCode.ODOMETER


def odometer(kept: Kept, told: list[Told], scene: Scene, whole: bool) -> None:
    """Off by no more than was counted, counted only when the main loop stood still, and said in time."""
    assert kept.first
    assert kept.last
    lost = kept.lost
    ticks = [kept.began + tick for tick, _ in scene.steps]
    held_up = [bisect_right(ticks, end + MS) - bisect_left(ticks, begin - MS) for begin, end in kept.stalls]
    insist(
        0 <= lost <= sum(max(0, steps - HELD) for steps in held_up),
        f"{lost} transitions counted as missed, while {held_up} came with the main loop held up",
    )
    if lost and whole:
        reports = [item for item in told if is_odometer(item.event)]
        begin = min(begin for begin, _ in kept.stalls)
        end = max(end for _, end in kept.stalls) + HUSH + MS
        insist(
            any(begin <= item.tick <= end for item in reports), f"{lost} transitions missed, and no event says so", end
        )
        newest = reports[-1].event
        insist(
            isinstance(newest, Fault) and newest.detail in (kept.missed, FaultCode.ODOMETER),
            f"{kept.missed} transitions missed, the newest report says {newest}",
        )
    base, counts = kept.first.odometer, [0]
    for _, way in scene.steps:
        counts.append(counts[-1] + way)
    for item in told:
        if isinstance(item.event, Edge):
            low, high = bisect_left(ticks, item.tick - SETTLED), bisect_right(ticks, item.tick + SETTLED)
            true = [base + count for count in counts[low : high + 1]]
            off = min(abs(item.event.odometer - place) for place in true)
            most = lost if any(begin - MS <= item.tick for begin, _ in kept.stalls) else 0
            insist(off <= most, f"{item.event}: the odometer stands at {true}, {most} counts missed", item.tick)
    insist(
        abs(kept.last.odometer - base - counts[-1]) <= lost,
        f"odometer says {kept.last.odometer - base}, it moved by {counts[-1]} in {len(ticks)} steps, {lost} missed",
    )
