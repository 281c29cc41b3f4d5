"""A bench for near-field scans in real time: a controller's port, a GRBL stage's and a voltmeter's socket.

The pipe stands at the steps that came out on GP8 in the direction of GP9, the probe where the stage went at its feed:
what the meter says follows from both. `field` is what stands there in the probe's way, mV.
"""

import math
import threading
import time
from collections.abc import Callable

import numpy as np

from annulus_pipe.controller import PIN_DIRECTION, PIN_INTERLOCK, PIN_STEP
from annulus_pipe.twin.emulated import VirtualBoard, open_board
from annulus_pipe.twin.line import Line, PtyLine, TcpLine
from annulus_pipe.twin.real_time import rounds

TRAVEL_MM = (-10.0, 300.0)  # of the stage: beyond it goes into alarm
NOISE_MV = 0.4

QUERIES = {"MEAS:VOLT:DC? (@101)": "amplitude_mv", "MEAS:VOLT:DC? (@102)": "phase_mv"}

Field = Callable[[float, float], dict[str, float]]


def joint_field(angle_deg: float, z_mm: float) -> dict[str, float]:
    """A joint at z = 20 mm: a bead that is higher on one side, a colder sector in its zone, lift-off that drifts."""
    phi = math.radians(angle_deg)
    at = z_mm - 20.0 - 0.3 * math.cos(phi - 0.4)
    bead = math.exp(-((at / 3.2) ** 2)) * (2.0 + 0.5 * math.cos(phi - 1.0))
    cold = math.exp(-((at / 5.0) ** 2)) / (1.0 + math.exp(12.0 * (abs(math.remainder(phi - 2.2, 2 * math.pi)) - 0.5)))
    lift = 0.1 * math.cos(phi) + 0.05 * z_mm / 40.0
    return {"amplitude_mv": 320.0 - 18.0 * bead + 6.0 * cold + 25.0 * lift, "phase_mv": 90.0 + 7.0 * bead - 4.0 * cold}


class GrblStage:
    """As much of GRBL 1.1 as `sensors.linear_stage` speaks, in a clock that the rig tells it."""

    def __init__(self, *, stuck_at: float | None = None) -> None:
        self.stuck_at = stuck_at  # mm: something stands in its way
        self._at, self._to, self._feed, self._when = 0.0, 0.0, 10.0, 0.0
        self._alarm = False
        self._text = b""

    def place(self, now_s: float) -> float:
        """Mm, where it counts from its power-on or its homing."""
        way, gone = self._to - self._at, self._feed * (now_s - self._when)
        at = self._to if abs(way) <= gone else self._at + math.copysign(gone, way)
        return at if self.stuck_at is None else min(at, self.stuck_at)

    def receive(self, data: bytes, now_s: float) -> bytes:
        """Its answers to what came over the line."""
        out = b""
        for byte in data:
            one = bytes([byte])
            if one == b"?":
                at = self.place(now_s)
                state = "Alarm" if self._alarm else "Idle" if at == self._to else "Run"
                out += f"<{state}|MPos:{at:.3f},0.000,0.000|FS:0,0>\r\n".encode()
            elif one == b"!":
                self._stop(now_s)
            elif one == b"\n":
                out += self._line(self._text.decode("ascii", "replace").strip(), now_s)
                self._text = b""
            else:
                self._text = (self._text + one)[-80:]
        return out

    def _line(self, text: str, now_s: float) -> bytes:
        if text == "$H":
            self._alarm, self._at, self._to, self._when = False, 0.0, 0.0, now_s
            return b"ok\r\n"
        if self._alarm:
            return b"error:9\r\n"
        if text.startswith("G53 G1 X"):
            to, feed = text[8:].split(" F")
            if not TRAVEL_MM[0] <= float(to) <= TRAVEL_MM[1]:
                self._alarm = True
                return b"ALARM:2\r\n"
            self._stop(now_s)
            self._to, self._feed = float(to), float(feed) / 60.0
            return b"ok\r\n"
        return b"ok\r\n" if text in ("G21 G90", "") else b"error:20\r\n"

    def _stop(self, now_s: float) -> None:
        self._at = self._to = self.place(now_s)
        self._when = now_s


class NearFieldRig:
    """Board, stage and meter; `run` keeps them up with the clock. For `real_time.serving`."""

    def __init__(
        self,
        board: VirtualBoard,
        field: Field = joint_field,
        *,
        steps_per_turn: int = 400,
        boot: int = 1,
        stage: GrblStage | None = None,
        seed: int = 1,
    ) -> None:
        self.board, self.field, self.steps_per_turn = board, field, steps_per_turn
        self.stage = stage or GrblStage()
        self.steps = 0
        self.deaf = 0  # queries that the meter leaves without an answer
        self.readings = 0
        self._random = np.random.default_rng(seed)
        self._forward = True
        board.power_on(boot)
        board.input(board.tick, PIN_INTERLOCK, 0)
        self._serial: Line = PtyLine()
        self._stage_line: Line = PtyLine()
        self._lan = TcpLine()
        self._asked = b""
        self.port_url, self.stage_url = self._serial.url, self._stage_line.url
        self.probe_name = self._lan.url.replace("socket://", "TCPIP::").replace("1:", "1::") + "::SOCKET"

    def advance(self, tick: int) -> None:
        """Let the board go on to this tick."""
        self.board.run_until(tick)
        for _, pin, level in self.board.pins().tolist():
            if pin == PIN_DIRECTION:
                self._forward = bool(level)
            elif pin == PIN_STEP and level:
                self.steps += 1 if self._forward else -1

    def run(self, over: threading.Event) -> None:
        """Serve port, stage and meter until `over`."""
        for _ in rounds(self.board, self._serial, (self._stage_line, self._lan), self.advance, over):
            if data := self._stage_line.read():
                self._stage_line.write(self.stage.receive(data, time.monotonic()))
            self._asked = (self._asked + self._lan.read())[-4096:]
            while b"\n" in self._asked:
                query, _, self._asked = self._asked.partition(b"\n")
                self._lan.write(self._measured(query.decode("ascii", "replace").strip()))

    def _measured(self, query: str) -> bytes:
        if query not in QUERIES:
            return b""
        if self.deaf > 0:
            self.deaf -= 1
            return b""
        self.readings += 1
        detected = self.field(360.0 * self.steps / self.steps_per_turn, self.stage.place(time.monotonic()))
        return f"{(detected[QUERIES[query]] + self._random.normal(0, NOISE_MV)) / 1000:.7E}\n".encode()

    def close(self) -> None:
        self._serial.close()
        self._stage_line.close()
        self._lan.close()
        self.board.close()


def bench(steps_per_turn: int = 400) -> NearFieldRig:
    """One about a joint, with the controller's own code."""
    return NearFieldRig(open_board("native"), steps_per_turn=steps_per_turn)
