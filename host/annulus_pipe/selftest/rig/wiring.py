"""Which jumpers are there, and which go to the wrong pin: found out before anything is judged. A firmware that swaps
two outputs cannot be reported from two jumpers that are crossed.

Each of the controller's outputs is made to move in a way of its own, and the rig says which of its pins moved; each of
its inputs is moved by the rig, and the controller says what it noticed.
"""

from annulus_pipe.controller import (
    PIN_CAMERA_TRIGGER,
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_END_HIGH,
    PIN_END_LOW,
    PIN_INTERLOCK,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_LED,
    PIN_MICROWAVE,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_PROJECTOR,
    PIN_STEP,
    PIN_SYNC,
    PIN_TRIGGER,
    TURNTABLE_LAG_MS,
    TURNTABLE_LEAD_MS,
)
from annulus_pipe.link.messages import (
    Arm,
    ArmFlag,
    Burst,
    BurstCode,
    CameraTrigger,
    Commit,
    Edge,
    Hardware,
    HardwareReply,
    Interlock,
    InterlockFlag,
    Move,
    StateFlag,
    Status,
    StatusCode,
    StatusReply,
    StopCause,
    Turntable,
    TurntableFlag,
)
from annulus_pipe.selftest.rig.board import MS, Played, Scene
from annulus_pipe.selftest.rig.on_rig import RigBoard
from annulus_pipe.selftest.rig.promises import arm, camera, configuration, configure, ok
from annulus_pipe.vocabulary import AnnulusError

NEEDED = (PIN_SYNC, PIN_PROJECTOR, PIN_LED, PIN_MICROWAVE, PIN_TRIGGER, PIN_INTERLOCK, PIN_STEP)  # and ground: eight
OPTIONAL = (
    PIN_DIRECTION,
    PIN_ENABLE,
    PIN_END_LOW,
    PIN_END_HIGH,
    PIN_INTERLOCK_ANTIVALENT,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_CAMERA_TRIGGER,
)
NAMES = {
    PIN_SYNC: "frame sync",
    PIN_PROJECTOR: "projector gate",
    PIN_LED: "LED gate",
    PIN_MICROWAVE: "microwave gate",
    PIN_TRIGGER: "digitizer trigger",
    PIN_INTERLOCK: "interlock",
    PIN_STEP: "STEP",
    PIN_DIRECTION: "DIR",
    PIN_ENABLE: "ENABLE",
    PIN_END_LOW: "lower end switch",
    PIN_END_HIGH: "upper end switch",
    PIN_ODOMETER_A: "odometer A",
    PIN_ODOMETER_B: "odometer B",
    PIN_INTERLOCK_ANTIVALENT: "second interlock input",
    PIN_CAMERA_TRIGGER: "camera trigger",
}
OUTPUTS = (PIN_PROJECTOR, PIN_LED, PIN_MICROWAVE, PIN_TRIGGER, PIN_STEP, PIN_DIRECTION, PIN_ENABLE)
PULSE = 3_000  # ticks of the gate, 30 us; the trigger's last 1 us
STEPS = 7


def jumper(pin: int) -> str:
    """As it is called on both boards."""
    return f"GP{pin} (pin {pin + 1 + (pin + 2) // 4}, {NAMES[pin]})"


def missing_jumpers(board: RigBoard) -> frozenset[int]:
    """Optional jumpers that are not there. AnnulusError when a needed one is missing, or any is at a wrong pin."""
    wrong: list[str] = []
    missing: set[int] = set()
    board.slow_pins = OUTPUTS
    try:
        if not _edges_told(board):
            raise AnnulusError(
                f"wiring: the controller sees no edge of {jumper(PIN_SYNC)}."
                " Is that jumper there, and the one of ground?"
            )
        board.compare_clocks()
        _interlock(board, missing, wrong)
        _lamps(board, missing, wrong)
        if PIN_INTERLOCK not in missing:  # open, it lets nothing fire or move that could be looked for
            _gate(board, missing, wrong)
            _stage(board, missing, wrong)
            _ends(board, missing, wrong)
        _odometer(board, missing, wrong)
        if board.client.session.knows(Interlock):
            _second_input(board, missing)
            _camera_trigger(board, missing, wrong)
    finally:
        board.slow_pins = (PIN_DIRECTION, PIN_ENABLE)
    gone = [pin for pin in NEEDED if pin in missing]
    if gone:
        nothing = (
            "nothing comes of" if len(gone) < len(NEEDED) - 2 else "hardly anything comes: is ground joined? nothing of"
        )
        wrong.insert(0, f"{nothing} {', '.join(map(jumper, gone))}: a jumper is missing")
    if wrong:
        raise AnnulusError(f"wiring: {'; '.join(wrong)}")
    return frozenset(missing)


def _status(board: RigBoard) -> StatusReply:
    reply = board.request(Status())
    assert isinstance(reply, StatusReply)
    return reply


def _edges_told(board: RigBoard) -> bool:
    configure(board, period=200_000)
    edges = [MS + i * 200_000 for i in range(3)]
    return len(board.play(Scene(until=edges[-1] + 5 * MS, edges=camera(edges))).heard(Edge)) == len(edges)


def _moved(played: Played) -> set[int]:
    return {pin for _, pin, _ in played.transitions}


def _found(board: RigBoard, pin: int, seen: set[int], own: set[int], missing: set[int], wrong: list[str]) -> None:
    """`seen`: the rig's pins that moved as this output alone should have."""
    if pin in seen:
        return
    elsewhere = sorted(seen - own)
    if elsewhere:
        wrong.append(f"the controller's {jumper(pin)} arrives at the rig's GP{elsewhere[0]}")
    else:
        missing.add(pin)


def _interlock(board: RigBoard, missing: set[int], wrong: list[str]) -> None:
    if StateFlag.INTERLOCK_OPEN in _status(board).state:
        missing.add(PIN_INTERLOCK)


def _lamps(board: RigBoard, missing: set[int], wrong: list[str]) -> None:
    """Two flashes of the projector, then one of the LED."""
    arm(board, ratio=2, period=200_000, delay=10_000, width=20_000)
    edges = [MS + i * 200_000 for i in range(3)]
    played = board.play(Scene(until=edges[-1] + 2 * MS, edges=camera(edges)))
    board.request(Arm(ArmFlag(0)))
    pulses = {pin: len(played.rises(pin)) for pin in OUTPUTS}
    _found(board, PIN_PROJECTOR, {p for p, n in pulses.items() if n == 2}, set(), missing, wrong)
    _found(board, PIN_LED, {p for p, n in pulses.items() if n == 1}, set(), missing, wrong)


def _gate(board: RigBoard, missing: set[int], wrong: list[str]) -> None:
    """Long pulses of the gate, each with a short one of the trigger."""
    ok(board, Arm(ArmFlag.MICROWAVE))
    burst = Burst(code=BurstCode.SINGLE, chip=PULSE, repeat=5, period=20 * PULSE, trigger_offset=0)
    scene = Scene(until=MS, watch=(PIN_MICROWAVE, PIN_TRIGGER), orders=[(MS // 2, burst)], after=10 * MS)
    played = board.play(scene)
    board.request(Arm(ArmFlag(0)))
    long = {pin for pin in (PIN_MICROWAVE, PIN_TRIGGER) if any(w > PULSE / 2 for w in played.widths(pin))}
    short = {pin for pin in (PIN_MICROWAVE, PIN_TRIGGER) if any(w < PULSE / 2 for w in played.widths(pin))}
    others = _moved(played) - {PIN_MICROWAVE, PIN_TRIGGER}
    _found(board, PIN_MICROWAVE, long or others, short, missing, wrong)
    _found(board, PIN_TRIGGER, short or others, long, missing, wrong)


def _stage(board: RigBoard, missing: set[int], wrong: list[str]) -> None:
    ok(board, Turntable(-400_000_000, 400_000_000, 0, 0, TurntableFlag(0)))
    at = _status(board).turntable
    powered = (TURNTABLE_LEAD_MS + TURNTABLE_LAG_MS) * MS  # of a move, beside its steps: ENABLE goes twice
    second = 5 * MS + powered
    orders = [(MS // 2, Move(at - 1, 20_000, 0)), (second, Move(at - 1 + STEPS, 20_000, 0))]
    played = board.play(Scene(until=second, orders=orders, after=10 * MS + powered))
    rises = {pin: len(played.rises(pin)) for pin in OUTPUTS}
    _found(board, PIN_STEP, {p for p, n in rises.items() if n == STEPS + 1}, set(), missing, wrong)
    moved = _moved(played)
    _found(board, PIN_ENABLE, {p for p, n in rises.items() if n == 2}, set(), missing, wrong)
    if PIN_DIRECTION not in moved:
        missing.add(PIN_DIRECTION)


def _ends(board: RigBoard, missing: set[int], wrong: list[str]) -> None:
    """Closed, a move away from either is allowed; opened, it is refused and says which."""
    both = TurntableFlag.END_LOW | TurntableFlag.END_HIGH
    ok(board, Turntable(-400_000_000, 400_000_000, 0, 0, both))
    sides = ((PIN_END_HIGH, 1, StopCause.END_HIGH), (PIN_END_LOW, -1, StopCause.END_LOW))
    for pin, sign, cause in sides:
        refused = board.request(Move(_status(board).turntable + sign, 20_000, 0))
        board.play(Scene(until=3 * MS))
        if refused.status is StatusCode.UNSAFE and refused.detail == cause:
            missing.add(pin)
    if missing & {PIN_END_LOW, PIN_END_HIGH}:
        return
    board.play(Scene(until=2 * MS, edges=[(MS, PIN_END_HIGH, 1)]))
    refused = board.request(Move(_status(board).turntable + 1, 20_000, 0))
    board.play(Scene(until=3 * MS, edges=[(MS, PIN_END_HIGH, 0)]))
    if refused.status is StatusCode.OK:
        wrong.append(f"{jumper(PIN_END_HIGH)} and {jumper(PIN_END_LOW)} are crossed")


def _odometer(board: RigBoard, missing: set[int], wrong: list[str]) -> None:
    """A falls, then B: one count up each."""
    counts = [_status(board).odometer]
    for pin in (PIN_ODOMETER_A, PIN_ODOMETER_B):
        board.play(Scene(until=2 * MS, edges=[(MS, pin, 0)]))
        counts.append(_status(board).odometer)
    for pin in (PIN_ODOMETER_B, PIN_ODOMETER_A):
        board.play(Scene(until=2 * MS, edges=[(MS, pin, 1)]))
    by_a, by_b = counts[1] - counts[0], counts[2] - counts[1]
    if by_a == -1 and by_b == -1:
        wrong.append(f"{jumper(PIN_ODOMETER_A)} and {jumper(PIN_ODOMETER_B)} are crossed")
        return
    missing |= {pin for pin, by in ((PIN_ODOMETER_A, by_a), (PIN_ODOMETER_B, by_b)) if by == 0}


def _second_input(board: RigBoard, missing: set[int]) -> None:
    """Moved while nobody is armed: it says so, once configured."""
    ok(board, Interlock(InterlockFlag.ANTIVALENT))
    reported = []
    for level in (0, 1):
        board.play(Scene(until=2 * MS, edges=[(MS, PIN_INTERLOCK_ANTIVALENT, level)]))
        reply = board.request(Hardware())
        assert isinstance(reply, HardwareReply)
        reported.append(InterlockFlag.ANTIVALENT_OPEN in reply.interlock)
    ok(board, Interlock(InterlockFlag(0)))
    if reported != [True, False]:
        missing.add(PIN_INTERLOCK_ANTIVALENT)


def _camera_trigger(board: RigBoard, missing: set[int], wrong: list[str]) -> None:
    """Five of them, and nothing else."""
    ok(board, configuration(period=200_000), CameraTrigger(1, 50_000, 0), Commit(1))
    played = board.play(Scene(until=10 * MS, watch=(PIN_CAMERA_TRIGGER,)))
    ok(board, configuration(period=200_000), CameraTrigger(1, 0, 0), Commit(1))
    _found(board, PIN_CAMERA_TRIGGER, _moved(played), set(), missing, wrong)
