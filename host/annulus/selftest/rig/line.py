"""Promises of the line and of a restart."""

import itertools

from annulus.controller import PIN_LED, PIN_MICROWAVE, PIN_PROJECTOR, PIN_SYNC, PIN_TRIGGER
from annulus.link.messages import (
    ArmFlag,
    BootCause,
    Burst,
    BurstCode,
    Edge,
    Ping,
    PingReply,
    Reset,
)
from annulus.selftest.rig.board import MS, Board, Scene, expect
from annulus.selftest.rig.promises import arm, camera, configure, frames, ok, promised

OUTPUTS = (PIN_PROJECTOR, PIN_LED, PIN_MICROWAVE, PIN_TRIGGER)
RESET_MAGIC = 0x7E5E7B00


@promised("Events while 60 edges come", "every one, in order", PIN_SYNC, unit="events")
def every_edge_is_told_once_and_in_order(board: Board) -> str:
    configure(board, period=200_000)
    edges = frames(60, 200_000)
    played = board.play(Scene(until=int(edges[-1]) + 5 * MS, edges=camera(edges), flood=True))
    reported = [edge.edge for edge in played.heard(Edge)]
    seen = f"{len(reported)} of {len(edges)}"
    expect(len(reported) == len(edges) and all(b == a + 1 for a, b in itertools.pairwise(reported)), seen)
    return seen


@promised("Question to answer", "its tick lies between", PIN_SYNC, unit="ms")
def a_ping_tells_a_time_between_question_and_answer(board: Board) -> str:
    configure(board, period=400_000)
    edges = frames(3, 4_000_000)
    played = board.play(Scene(until=int(edges[-1]) + 5 * MS, edges=camera(edges), orders=[(50 * MS, Ping())]))
    [reply] = played.replies
    assert isinstance(reply, PingReply)
    at = played.tick_of(reply.tick) / MS
    expect(50 - 0.1 <= at <= 50 + 1_000, f"at {at:.2f}, asked from 50 on")
    return f"at {at:.2f}, asked from 50 on"


@promised("Reset by the host while all is armed", "all low, and through the start", PIN_SYNC, *OUTPUTS, unit="")
def a_reset_leaves_every_output_low(board: Board) -> str:
    before = board.identify().boot
    arm(board, ArmFlag.LAMPS | ArmFlag.MICROWAVE, ratio=0, period=1_000_000, delay=100_000, width=300_000)
    ok(board, Burst(code=BurstCode.SINGLE, chip=100, repeat=60_000, period=10_000, trigger_offset=0))
    edges = frames(20, 1_000_000)
    watch = (PIN_LED, PIN_MICROWAVE, PIN_TRIGGER, PIN_PROJECTOR)
    scene = Scene(
        until=int(edges[-1]) + 5 * MS, edges=camera(edges), watch=watch, orders=[(50 * MS, Reset(RESET_MAGIC))]
    )
    played = board.play(scene)
    last = {pin: max((t for t, p, _ in played.transitions if p == pin), default=0.0) / MS for pin in watch}
    rises = {pin: played.rises(pin)[-1:] for pin in watch}
    seen = f"last change at {max(last.values()):.2f} of 205 ms"
    ended = last[PIN_MICROWAVE]
    expect(bool(rises[PIN_MICROWAVE]) and bool(rises[PIN_LED]), "nothing was lit before")
    expect(50 <= ended < 190, f"{seen}: the train did not end")
    expect(all(t <= ended + 0.5 for t in last.values()), f"{seen}: something moved after it")
    ends = {pin: [level for _, p, level in played.transitions if p == pin][-1:] for pin in watch}
    expect(all(level in ([], [0]) for level in ends.values()), f"{seen}: not all low")
    who = board.identify()
    expect(
        who.cause is BootCause.HOST_RESET and who.boot != before,
        f"{seen}; cause {who.cause.name}, boot {before} then {who.boot}",
    )
    return seen
