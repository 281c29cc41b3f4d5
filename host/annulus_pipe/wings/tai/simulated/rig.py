"""The rig in the board's time, or in real time: a controller's port and a scope's socket, for `annulus tai acquire`.

Nothing is taken from what the host says it sent: the envelope is what GP5 did, exact in ticks; time 0 is GP6's edge;
the angle is the steps on GP8 in the direction of GP9.
"""

import threading
import time
from collections import deque
from collections.abc import Callable

from annulus_pipe.controller import (
    PIN_DIRECTION,
    PIN_INTERLOCK,
    PIN_MICROWAVE,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_STEP,
    PIN_TRIGGER,
    TICK_S,
)
from annulus_pipe.twin.emulated import VirtualBoard, open_board
from annulus_pipe.twin.line import Line, PtyLine, TcpLine
from annulus_pipe.twin.real_time import rounds
from annulus_pipe.wings.tai.measure.phantoms import phantom
from annulus_pipe.wings.tai.simulated.phantom import RigSetup
from annulus_pipe.wings.tai.simulated.receiver import Receiver
from annulus_pipe.wings.tai.simulated.scope import SimulatedScope

KEEP_TICKS = 1_000_000  # pulses longer ago than this are heard no more, nor in any record still to come
ENCODER_TICKS = 100
_QUADRATURE = ((1, 1), (0, 1), (0, 0), (1, 0))  # of the turntable's encoder, a count a step; A first counts up


class AcousticRig:
    """Board, receiver and scope in the board's time. `advance` moves it; `serving` does so in real time."""

    def __init__(
        self, board: VirtualBoard, receiver: Receiver, scope: SimulatedScope | None = None, *, boot: int = 1
    ) -> None:
        self.board, self.receiver = board, receiver
        self.scope = SimulatedScope(seed=receiver.setup.seed) if scope is None else scope
        self.steps = 0  # where the turntable stands
        self.bursts = 0  # triggers the controller gave
        self._forward = True
        self._rise: int | None = None
        self._pulses: deque[tuple[int, int]] = deque()
        self._taken: deque[tuple[int, int]] = deque()  # trigger tick, steps: records under way
        self._busy_until = 0
        self._unplugged = False
        self._wanted: deque[tuple[int, int]] = deque()  # pin, level: the encoder, somebody's hand on the door
        board.power_on(boot)
        board.input(board.tick, PIN_INTERLOCK, 0)
        self._serial: Line = PtyLine()
        self._lan = TcpLine()
        self.port_url = self._serial.url
        self.scope_name = self._lan.url.replace("socket://", "TCPIP::").replace("1:", "1::") + "::SOCKET"

    def interlock(self, *, closed: bool) -> None:
        """Somebody's hand on the door, from any thread; takes effect with the next advance."""
        self._wanted.append((PIN_INTERLOCK, 0 if closed else 1))

    def unplug_scope(self) -> None:
        """Somebody's hand on its network cable, from any thread: nobody can connect to it any more."""
        self._unplugged = True

    def advance(self, tick: int) -> None:
        """Let the world go on to this tick of the board."""
        at = self.board.tick
        while self._wanted:  # encoder edges one after the other, however many steps the last look saw
            self.board.input(at, *self._wanted.popleft())
            at += ENCODER_TICKS
        self.board.run_until(tick)
        for at, pin, level in self.board.pins().tolist():
            self._changed(at, pin, level)
        start, rate, points = self.scope.window()
        while self._taken and self._taken[0][0] + round((start + points / rate) / TICK_S) < tick:
            self._finish(*self._taken.popleft())
        oldest = min(tick, self._taken[0][0] if self._taken else tick) - KEEP_TICKS
        while self._pulses and self._pulses[0][1] < oldest:
            self._pulses.popleft()

    def _changed(self, tick: int, pin: int, level: int) -> None:
        if pin == PIN_MICROWAVE:
            if level:
                self._rise = tick
            elif self._rise is not None:
                self._pulses.append((self._rise, tick))
                self._rise = None
        elif pin == PIN_DIRECTION:
            self._forward = bool(level)
        elif pin == PIN_STEP and level:
            stuck = self.receiver.setup.stuck_after
            if stuck is None or abs(self.steps) < stuck:
                self.steps += 1 if self._forward else -1
                a, b = _QUADRATURE[self.steps % 4]
                self._wanted += [(PIN_ODOMETER_A, a), (PIN_ODOMETER_B, b)]
        elif pin == PIN_TRIGGER:
            self.bursts += level
            if tick >= self._busy_until and len(self._taken) < 1000 and self.scope.triggered_by(level):
                start, rate, points = self.scope.window()
                self._busy_until = tick + round((start + points / rate + 5e-6) / TICK_S)
                self._taken.append((tick, self.steps))

    def _finish(self, tick: int, steps: int) -> None:
        start, rate, points = self.scope.window()
        now = tick + round((start + points / rate) / TICK_S)
        pulses = [*self._pulses, *([(self._rise, now)] if self._rise is not None else [])]
        relative = tuple((a - tick, b - tick) for a, b in pulses)
        volts = self.receiver.hear(relative, steps, start, rate, points)
        self.scope.record(volts + self.scope.noise(self.receiver.setup.noise_v, points))

    # ---- real time ----

    def run(self, over: threading.Event) -> None:
        """Serve port and scope until `over`: the world keeps up with the clock, or is slowed down."""
        arrivals = 0
        for _ in rounds(self.board, self._serial, (self._lan,), self.advance, over):
            data = self._lan.read()
            if self._lan.arrivals != arrivals:
                arrivals = self._lan.arrivals
                self.scope.connect()
            if answer := self.scope.receive(data):
                self._send(answer)
            if self._unplugged:
                self._lan.close()
            elif self.scope.hang_up:
                self._lan.hang_up()

    def _send(self, answer: bytes) -> None:
        end = time.monotonic() + 1.0
        while answer and time.monotonic() < end:
            answer = answer[self._lan.write(answer) :]

    def close(self) -> None:
        self._serial.close()
        self._lan.close()
        self.board.close()


def rig_named(
    phantom_name: str,
    radius_mm: float,
    sound_speed_m_s: float,
    steps_per_turn: int,
    board: str = "native",
    progress: Callable[[str, int, int], None] | None = None,
) -> AcousticRig:
    """A rig about one of the named phantoms."""
    setup = RigSetup(phantom(phantom_name), radius_mm, sound_speed_m_s, steps_per_turn=steps_per_turn)
    return AcousticRig(open_board(board), Receiver(setup, progress))
