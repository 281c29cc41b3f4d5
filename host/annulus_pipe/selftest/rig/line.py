"""Promises of the line and of a restart."""

import itertools

from annulus_pipe.controller import (
    INTERLOCK_DISAGREE_MS,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_PROJECTOR,
    PIN_SYNC,
    PIN_TRIGGER,
)
from annulus_pipe.link.messages import (
    RESET_MAGIC,
    Arm,
    ArmFlag,
    BootCause,
    Burst,
    BurstCode,
    Edge,
    Fault,
    FaultCode,
    Hardware,
    HardwareReply,
    IdentifyReply,
    Image,
    ImageFlash,
    ImageReply,
    InterlockFlag,
    Ping,
    PingReply,
    Reset,
    Wiring,
    WiringReply,
)
from annulus_pipe.selftest.rig.board import MS, Board, Scene, expect
from annulus_pipe.selftest.rig.promises import arm, camera, configure, frames, ok, promised
from annulus_pipe.selftest.rig.variants import TURNED_BURST, TURNED_LAMPS, use_both, wired

OUTPUTS = (PIN_PROJECTOR, PIN_LED, PIN_MICROWAVE, PIN_TRIGGER)
CHECKED = 40  # scenes of 80 ms in which a copy in flash is looked through


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


def _restarted(board: Board) -> IdentifyReply:
    """.. and what a lamp owes after a start, because nobody knows what it did before, is paid."""
    board.play(Scene(until=100 * MS, orders=[(MS, Reset(RESET_MAGIC))]))
    return board.identify()


@promised("A fault after a restart, no burst sent yet", "edges go on", PIN_SYNC, PIN_LED, unit="edges")
def edges_go_on_after_a_fault_where_no_burst_ran(board: Board) -> str:
    _restarted(board)
    configure(board, ratio=0, period=400_000, delay=100_000, width=100_000, host_timeout=50)
    edges = [MS + i * 400_000 for i in range(40)]
    armed = [(10 * MS, Arm(ArmFlag.LAMPS))]
    scene = Scene(until=edges[-1] + 3 * MS, edges=camera(edges), watch=(PIN_LED,), orders=armed, silent=True)
    played = board.play(scene)
    expect([f.fault for f in played.heard(Fault)] == [FaultCode.HOST_TIMEOUT], "no fault host_timeout")
    seen = f"{len(played.heard(Edge))} of {len(edges)}"
    expect(len(played.heard(Edge)) == len(edges) and len(played.rises(PIN_LED)) < len(edges), seen)
    return seen


@promised("A restart forgets the wiring", "inputs, polarity, trigger", PIN_INTERLOCK, PIN_INTERLOCK_ANTIVALENT, unit="")
def a_restart_forgets_the_wiring(board: Board) -> str:
    wired(board, TURNED_LAMPS, trigger=100_000)
    use_both(board)
    _restarted(board)
    opens = (MS, PIN_INTERLOCK_ANTIVALENT, 0)
    played = board.play(Scene(until=(INTERLOCK_DISAGREE_MS + 3) * MS, edges=[opens]))
    expect(not played.heard(Fault), "the second input is looked at")
    hardware, wiring = board.request(Hardware()), _wiring(board)
    assert isinstance(hardware, HardwareReply)
    expect(InterlockFlag.ANTIVALENT not in hardware.interlock, "the second input is configured")
    kept = (wiring.inverted, wiring.driven, wiring.camera_trigger)
    expect(not any(kept), f"inverted {kept[0]!r}, driven {kept[1]!r}, trigger {kept[2]}")
    ok(board, Arm(ArmFlag.MICROWAVE))
    board.play(Scene(until=MS))
    driven = _wiring(board).driven
    expect(driven == TURNED_BURST, f"armed for the microwave alone, driven are {driven!r}")
    return "all three; the microwave alone drives no lamp"


def _wiring(board: Board) -> WiringReply:
    reply = ok(board, Wiring())
    assert isinstance(reply, WiringReply)
    return reply


def _image(board: Board) -> ImageReply:
    reply = ok(board, Image())
    assert isinstance(reply, ImageReply)
    return reply


@promised("The image after a restart", "the same, confirmed, whole in flash", unit="")
def the_image_is_confirmed_and_whole(board: Board) -> str:
    before = _image(board)
    _restarted(board)
    for _ in range(CHECKED):
        now = _image(board)
        seen = f"slot {now.slot}, {now.starts} starts on trial, {now.flash.name.lower()}"
        expect((now.slot, now.crc, now.starts) == (before.slot, before.crc, 0), seen)
        if now.flash is not ImageFlash.UNCHECKED:
            break
        board.play(Scene(until=80 * MS))
    expect(now.flash is ImageFlash.WHOLE, seen)
    return seen
