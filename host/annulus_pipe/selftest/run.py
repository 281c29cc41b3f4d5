"""The whole self-test of one board, in the order in which wires have to be moved least."""

import datetime
import statistics
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import StrEnum

from annulus_pipe.link.client import Client
from annulus_pipe.link.messages import InfoReply, Measure, Ping, StateFlag
from annulus_pipe.link.operate import text_of
from annulus_pipe.selftest.lamps import lamp_rows
from annulus_pipe.selftest.microwave import (
    ARMING_ROW,
    gate_opens_interlock,
    interlock_closed,
    microwave_rows,
    open_row,
    reaction_row,
    unwired_rows,
)
from annulus_pipe.selftest.promise import BEYOND_A_BOARDS_OWN_REACH, PromiseVerdict, Row, not_wired
from annulus_pipe.selftest.scope import Scope
from annulus_pipe.vocabulary import AnnulusError

PINGS = 200
BEFORE_IT_BEGINS = (
    "This fires every output of the controller. Unplug the lamps, the microwave source, the turntable's driver,\n"
    "the camera and the interlock chain. Two jumpers: GP8 (pin 11) to GP2 (pin 4), GP7 (pin 10) to ground (pin 13)."
)


class WireGoes(StrEnum):
    """Where the interlock's wire goes next, as a person is told."""

    OFF = "Pull the wire of GP7 (pin 10) off ground and leave it hanging."
    TO_GATE = "Put that wire on GP5: GP7 (pin 10) to GP5 (pin 7)."


MoveWire = Callable[[WireGoes], bool]  # was it moved?


@dataclass(frozen=True, slots=True)
class SelfTest:
    """What one board keeps of what is promised."""

    board: str
    firmware: str
    serial_number: str
    port: str
    date: str  # ISO 8601, UTC
    rows: tuple[Row, ...]

    @property
    def broken(self) -> int:
        return sum(row.verdict is PromiseVerdict.BROKEN for row in self.rows)

    @property
    def kept(self) -> int:
        return sum(row.verdict is PromiseVerdict.KEPT for row in self.rows)

    def to_dict(self) -> dict[str, object]:
        return asdict(self) | {"kept": self.kept, "broken": self.broken}


def run_selftest(port: str, *, name: str, edges: int, move_wire: MoveWire) -> SelfTest:
    """Measure everything the wires allow; `name`: of the port, on the page.

    Fires every output: whoever calls has made sure that nothing hangs on them.

    `move_wire` is told what to do when a wire has to be moved, and says whether it was. AnnulusError when the head is
    at work, has a fault latched, or a firmware that cannot measure.
    """
    with Client(port) as client:
        scope = Scope(client, port)
        info = _check_idle(scope, port)
        rows: list[Row] = []
        try:
            rows += lamp_rows(scope, text_of(client.identity.board), edges)
            rows += _microwave(scope, move_wire)
        finally:
            scope.end()
        rows.append(_round_trip(client))
        return SelfTest(
            text_of(client.identity.board),
            f"{info.major}.{info.minor}.{info.patch} {text_of(client.identity.git)}",
            text_of(info.serial),
            name,
            datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            (*rows, *BEYOND_A_BOARDS_OWN_REACH),
        )


def _check_idle(scope: Scope, port: str) -> InfoReply:
    status = scope.status()
    busy = StateFlag.LAMPS_ARMED | StateFlag.MICROWAVE_ARMED | StateFlag.TURNTABLE_MOVING
    if status.state & busy:
        raise AnnulusError(f"{port}: the head is at work, expected one that is disarmed and stands still")
    if status.fault:
        raise AnnulusError(f"{port}: fault {status.fault.name.lower()} is latched. Clear it first.")
    info = scope.client.session.info
    if info is None or not (info.commands[Measure.ID // 8] >> Measure.ID % 8) & 1:
        raise AnnulusError(f"{port}: this firmware cannot measure itself, expected a newer one")
    return info


def _microwave(scope: Scope, move_wire: MoveWire) -> list[Row]:
    """As the wire is found; from ground it is moved on, if somebody moves it."""
    if not interlock_closed(scope):
        return [open_row(scope), *unwired_rows(gate=True), *unwired_rows(gate=False)]
    never_open = not_wired(*ARMING_ROW, "GP7 (pin 10) left open")
    if gate_opens_interlock(scope):
        return [never_open, *unwired_rows(gate=True), reaction_row(scope)]
    rows = microwave_rows(scope)
    rows.append(open_row(scope) if move_wire(WireGoes.OFF) and not interlock_closed(scope) else never_open)
    if move_wire(WireGoes.TO_GATE) and interlock_closed(scope) and gate_opens_interlock(scope):
        return [*rows, reaction_row(scope)]
    return rows + unwired_rows(gate=False)


def _round_trip(client: Client) -> Row:
    times = []
    for _ in range(PINGS):
        began = client.now_s()
        client.request(Ping())
        times.append(1000 * (client.now_s() - began))
    low, middle, high = min(times), statistics.median(times), max(times)
    text = f"{middle:.2f} ms; {low:.2f} .. {high:.2f} ms, {PINGS} times"
    return Row(
        "Question to answer", "-", text, PromiseVerdict.INFORMS, (low, middle, high), "ms", "median; lowest, highest"
    )
