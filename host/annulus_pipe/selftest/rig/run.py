"""Every promise asked of the board at the other end of the jumpers, one after the other, and the table of it."""

import datetime
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass

from annulus_pipe.link.messages import StateFlag, Status, StatusReply
from annulus_pipe.link.operate import text_of
from annulus_pipe.selftest.promise import PromiseVerdict, Row
from annulus_pipe.selftest.rig import lamps, line, microwave, motion, variants
from annulus_pipe.selftest.rig.board import NotKeptError
from annulus_pipe.selftest.rig.on_rig import RigBoard
from annulus_pipe.selftest.rig.promises import Promise, entered
from annulus_pipe.selftest.rig.wiring import jumper, missing_jumpers
from annulus_pipe.vocabulary import AnnulusError

MODULES = (lamps, microwave, motion, variants, line)  # their promises, in this order
BEFORE_IT_BEGINS = (
    "This fires every output of the controller. Unplug the lamps, the microwave source, the turntable's driver, the\n"
    "camera and the interlock chain: nothing may hang on the controller but the rig's jumpers and USB."
)
STANDS = "its processor has to stand still at a chosen instruction"
NOT_CHECKED = (
    ("Flash and hold-off, when an edge meets the core at work on it", STANDS),
    ("Processor stands still: microwave and trigger low in 4 ms, a dark frame and never a wrong one", STANDS),
    ("Main loop late by more than its credit: fault `watchdog`, bursts counted", STANDS),
    ("Watchdog reset after 100 ms, outputs low through it; what a crash leaves behind", STANDS),
    ("Count of bursts and triggers when a train is disarmed at any tick", STANDS),
    ("No step without power however close to the cut", STANDS),
    ("Odometer beyond what its ring keeps, and after 2^31 transitions", "its memory has to be set, or its loop held"),
    ("First flash after a pause of 22 seconds", "takes as long"),
    ("USB unplugged, suspended, reset, hung; requests abandoned", "the host at the plug is a kernel's, not ours"),
    ("Updates over a line, power lost in them, images that rot", "power and flash have to be cut and spoilt at will"),
    ("Boot loader entered, start with a damaged second stage", "the board would be gone"),
    ("Glitches of 1 to 3 ticks", "the rig plays no level shorter than 4"),
    ("Looks of the controller at its own pins", "`annulus head selftest` does it"),
)


@dataclass(frozen=True, slots=True)
class RigTest:
    """What one board keeps of what is promised, seen by a second one."""

    board: str
    firmware: str
    serial_number: str
    rig: str
    clock_ppm: float  # by which the rig's is faster
    date: str  # ISO 8601, UTC
    seconds: float
    rows: tuple[Row, ...]

    def count(self, verdict: PromiseVerdict) -> int:
        return sum(row.verdict is verdict for row in self.rows)

    @property
    def broken(self) -> int:
        return self.count(PromiseVerdict.BROKEN)

    def to_dict(self) -> dict[str, object]:
        return asdict(self) | {"kept": self.count(PromiseVerdict.KEPT), "broken": self.broken}


def chosen(only: str | None) -> tuple[Promise, ...]:
    """Promises whose name or text holds these words. AnnulusError when none does."""
    words = (only or "").lower()
    found = tuple(p for p in entered() if words in p.name.lower() or words in p.what.lower())
    if not found:
        raise AnnulusError(
            f"no promise is called {only!r}, expected words of one: {', '.join(p.name for p in entered())}"
        )
    return found


def run_rig(device: str, rig: str, *, only: str | None = None, tell: Callable[[str], None] = lambda _: None) -> RigTest:
    """Wiring first, then every promise. Fires every output: whoever calls has made sure that nothing hangs on them."""
    promises = chosen(only)
    began = time.monotonic()
    board = RigBoard(device, rig)
    try:
        _check_idle(board)
        tell("wiring")
        try:
            board.fresh()
            missing = missing_jumpers(board)
        except NotKeptError as why:
            raise AnnulusError(f"{device}: nothing was judged, since to find the jumpers {why}") from None
        rows = []
        for promise in promises:
            tell(promise.what)
            rows.append(_judged(board, promise, missing))
        board.fresh()  # nothing stays turned over or triggered
        rows += [Row(what, "", "-", PromiseVerdict.NOT_TESTED, why=why) for what, why in NOT_CHECKED]
        who = board.client.identity
        info = board.client.session.info
        version = f"{info.major}.{info.minor}.{info.patch} " if info else ""
        return RigTest(
            text_of(who.board),
            f"{version}{text_of(who.git)}",
            text_of(info.serial) if info else "",
            f"{board.rig.serial} {board.rig.version}",
            board.ppm,
            datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            time.monotonic() - began,
            tuple(rows),
        )
    finally:
        board.close()


def _check_idle(board: RigBoard) -> None:
    reply = board.request(Status())
    assert isinstance(reply, StatusReply)
    if reply.state & (StateFlag.LAMPS_ARMED | StateFlag.MICROWAVE_ARMED | StateFlag.TURNTABLE_MOVING):
        raise AnnulusError(f"{board.device}: the head is at work, expected one that is disarmed and stands still")


def _judged(board: RigBoard, promise: Promise, missing: frozenset[int]) -> Row:
    gone = [jumper(pin) for pin in promise.pins if pin in missing]
    if gone:
        return Row(
            promise.what,
            promise.expected,
            "-",
            PromiseVerdict.NOT_WIRED,
            unit=promise.unit,
            why=f"needs {', '.join(gone)}",
        )
    board.fresh()
    try:
        return Row(promise.what, promise.expected, promise.check(board), PromiseVerdict.KEPT, unit=promise.unit)
    except NotKeptError as observed:
        return Row(promise.what, promise.expected, str(observed), PromiseVerdict.BROKEN, unit=promise.unit)


SHOWN = {
    PromiseVerdict.KEPT: "kept",
    PromiseVerdict.BROKEN: "BROKEN",
    PromiseVerdict.NOT_WIRED: "not wired",
    PromiseVerdict.NOT_TESTED: "not checked",
    PromiseVerdict.INFORMS: "",
}


def verdict_line(test: RigTest) -> str:
    """The result in a sentence."""
    broken = f"{test.broken} BROKEN" if test.broken else "none broken"
    unwired, beyond = test.count(PromiseVerdict.NOT_WIRED), test.count(PromiseVerdict.NOT_TESTED)
    return (
        f"{test.count(PromiseVerdict.KEPT)} promises kept, {broken}, {unwired} not wired,"
        f" {beyond} that a rig cannot check; {test.seconds:.0f} s"
    )


def render_table(test: RigTest) -> str:
    """For a terminal: what was judged, then what was not and why."""
    judged = [row for row in test.rows if row.verdict is not PromiseVerdict.NOT_TESTED]
    lines = [("promise", "expected", "observed", "verdict", "unit")]
    lines += [(row.what, row.promise, row.why or row.measured, SHOWN[row.verdict], row.unit) for row in judged]
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    text = "\n".join("  ".join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)).rstrip() for line in lines)
    beyond = [f"  {row.what}: {row.why}" for row in test.rows if row.verdict is PromiseVerdict.NOT_TESTED]
    return text + "\n\nnot checked, because a rig cannot (all of it is on the emulator):\n" + "\n".join(beyond)
