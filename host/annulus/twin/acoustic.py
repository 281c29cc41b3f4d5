"""The thermoacoustic bench: the controller's pins heat the sample, turn the stage and trigger a scope that speaks SCPI.

    bench = AcousticBench(open_board("native"), Ear(Tank(phantom("wires"))))
    with serving(bench):                                 # real time, on a thread of its own
        client, scope = Client(bench.port_url), ScopeDigitizer(bench.scope_name)

Nothing is taken from what the host says it sent: the envelope is what GP5 did, exact in ticks; time 0 is GP6's edge;
the angle is the steps on GP8 in the direction of GP9. Sound is linear, so a phantom is propagated once, as its response
to an instant of heat at receivers all round; a record is that response convolved with the envelope.

Differs from a real bench: a plane, not a room; no reverberation; the receiver's face is a point; the scope is armed the
moment it is told; a scope that waits for a trigger gives up when its connection is lost.
"""

import contextlib
import functools
import math
import re
import select
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.fft
from numpy.typing import NDArray

from annulus.controller import (
    PIN_DIRECTION,
    PIN_INTERLOCK,
    PIN_MICROWAVE,
    PIN_ODOMETER_A,
    PIN_ODOMETER_B,
    PIN_STEP,
    PIN_TRIGGER,
    TICK_S,
)
from annulus.link.messages import Command, StatusCode
from annulus.link.session import Answer, Session, identify
from annulus.thermoacoustic.field import PML_CELLS, Grid, Medium, Solver, receivers
from annulus.thermoacoustic.phantoms import Part, draw, phantom, reach_mm
from annulus.twin.emulated import Board, open_board
from annulus.twin.line import Line, PtyLine, TcpLine
from annulus.vocabulary import AnnulusError

SHIFT_MM = (0.0313, 0.0171)  # the sample lies off the cells, so that no image is made on the grid of its own truth
PULSE_S = 0.5e-6  # the pulse that `pulse_v` speaks of
FADE = 0.1  # of a response, at its end
TAIL_S = 20e-6  # of the receiver and its amplifier, generously
RECOVERY_S = 0.4e-6  # of the amplifier after the coupled radio frequency
ANSWER_TICKS = 50_000_000
KEEP_TICKS = 1_000_000  # pulses longer ago than this are heard no more, nor in any record still to come
SLIP_TICKS = 2_000_000  # a machine that falls further behind than this has its world slowed down
PATIENCE_S = 1e-3
VOLTS_TRIGGER = 3.3
ENCODER_TICKS = 100
POINTS_AVERAGED = 1000
FAULTS = ("deaf", "hang", "drop", "short", "huge", "hole", "clip", "nonsense")


@dataclass(frozen=True, slots=True, eq=False)
class Tank:
    """What stands on the bench. One pulse of 0.5 us on a part of value 1 makes `pulse_v` there and then."""

    sample: tuple[Part, ...]
    radius_mm: float = 25.0
    sound_speed_m_s: float = 1480.0
    transducer: tuple[float, float] | None = (2.25e6, 0.7)  # centre, width at -6 dB
    pulse_v: float = 0.01
    noise_v: float = 0.0003  # rms of one shot
    spike_v: float = 0.0  # coupling of the microwave into the receiver
    steps_per_turn: int = 400
    stuck_after: int | None = None  # the stage ignores every step after so many
    seed: int = 1

    def angle_deg(self, steps: int) -> float:
        return 360.0 * steps / self.steps_per_turn


class Responses:
    """What receivers all round hear of an instant of heat in the phantom: one run of the solver.

    Sound from within `reach` is limited in angle as it is in frequency; as many receivers as that takes make every
    angle between them exact.
    """

    def __init__(self, tank: Tank, progress: Callable[[str, int, int], None] | None = None) -> None:
        reach = reach_mm(tank.sample)
        if reach > 0.95 * tank.radius_mm:
            raise AnnulusError(f"a sample of {reach:.1f} mm does not fit receivers at {tank.radius_mm:g} mm")
        centre, width = tank.transducer or (1.5e6, 1.0)
        highest = self.highest_hz = centre * (1 + width)
        dx = max(tank.sound_speed_m_s * 1e3 / (2.4 * highest), tank.radius_mm / 400)
        side = scipy.fft.next_fast_len(math.ceil(2 * tank.radius_mm / dx) + 2 * PML_CELLS + 12, real=True)
        grid = Grid((side, side), dx)
        solver = Solver(grid, Medium(tank.sound_speed_m_s))
        across_s = 2e-3 * tank.radius_mm / tank.sound_speed_m_s
        steps = math.ceil(1.15 * across_s / solver.dt_s)
        count = 2 * math.ceil(2 * math.pi * highest / (tank.sound_speed_m_s * 1e3) * reach) + 24
        turn = np.arange(count) * (2 * math.pi / count)
        points = tank.radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=1) - np.array(SHIFT_MM)
        heard = solver.forward(
            draw(tank.sample, grid, SHIFT_MM), receivers(grid, points), steps,
            progress=(lambda done, of: progress("twin's sound", done, of)) if progress else None,
        )  # fmt: skip
        if progress:
            progress("twin's sound", 1, 1)
        self.dt_s, self.length_s = solver.dt_s, steps * solver.dt_s
        fade = math.ceil(FADE * steps)  # a wave in a plane has a wake without end: it fades out rather than stops
        heard[:, -fade:] *= 0.5 + 0.5 * np.cos(math.pi * np.arange(1, fade + 1) / fade)
        self._round = scipy.fft.rfft(np.asarray(heard, float), axis=0)
        self._count = count

    def at(self, angle_deg: float) -> NDArray[np.float64]:
        """(steps,) pressure at an angle, from the instant of heat on, dt_s apart."""
        order = np.arange(len(self._round))
        weight = np.where((order == 0) | (2 * order == self._count), 1.0, 2.0) / self._count
        return np.asarray((weight * np.exp(1j * order * math.radians(angle_deg)) @ self._round).real)


def pulses_of(pins: npt.NDArray[np.void]) -> list[tuple[int, int]]:
    """(rise, fall) in ticks of every whole microwave pulse among transitions."""
    pulses, rise = [], -1
    for tick, pin, level in pins.tolist():
        if pin == PIN_MICROWAVE and level:
            rise = tick
        elif pin == PIN_MICROWAVE and rise >= 0:
            pulses.append((rise, tick))
            rise = -1
    return pulses


def fire(board: Board, *commands: Command, ticks: int = 1_000_000) -> npt.NDArray[np.void]:
    """What the pins of a powered board do when it is told these, in virtual time: TRANSITIONs until `ticks` after the
    last answer. AnnulusError for a command that is refused or not answered.
    """
    session, seen = Session(), []
    for command in (identify(), *commands):
        ticket, end = session.send(command), board.tick + ANSWER_TICKS
        answer: Answer | None = None
        while answer is None and board.tick < end:
            board.serial_write(session.pending(board.tick * 10))
            board.run_until(board.tick + 10_000)
            for happening in session.receive(board.serial_read(), board.tick * 10):
                if isinstance(happening, Answer) and happening.ticket == ticket:
                    answer = happening
            seen.append(board.pins())
        if answer is None or answer.reply.status is not StatusCode.OK:
            why = "no answer" if answer is None else answer.reply.status.name.lower()
            raise AnnulusError(f"{type(command).__name__.lower()}: {why}, expected the board to carry it out")
    for _ in range(max(1, ticks // 10_000)):  # the processor is to be heard now and then, or it darkens
        board.serial_write(session.pending(board.tick * 10))
        board.run_until(board.tick + 10_000)
        session.receive(board.serial_read(), board.tick * 10)
        seen.append(board.pins())
    return np.concatenate(seen)


class Ear:
    """The receiver at the rim: envelope and angle in, volts out."""

    def __init__(self, tank: Tank, progress: Callable[[str, int, int], None] | None = None) -> None:
        self.tank = tank
        self.responses = Responses(tank, progress)
        self._heard = functools.lru_cache(maxsize=16)(self._record)
        self._spectrum = functools.lru_cache(maxsize=4)(self._kernel)
        self._at = functools.lru_cache(maxsize=64)(self._turned)

    def hear(
        self, pulses_ticks: tuple[tuple[int, int], ...], steps: int, t0_s: float, rate_hz: float, samples: int
    ) -> NDArray[np.float64]:
        """(samples,) volts without noise, from t0_s after tick 0 on. pulses_ticks : on and off, from the same tick."""
        heard_from = t0_s - self.responses.length_s - TAIL_S
        near = tuple(p for p in pulses_ticks if heard_from < p[1] * TICK_S and p[0] * TICK_S < t0_s + samples / rate_hz)
        return self._heard(near, steps % self.tank.steps_per_turn, t0_s, rate_hz, samples)

    def _record(
        self, pulses: tuple[tuple[int, int], ...], steps: int, t0_s: float, rate_hz: float, samples: int
    ) -> NDArray[np.float64]:
        if not pulses:
            return np.zeros(samples)
        first_s = min(t0_s, pulses[0][0] * TICK_S)
        lasting_s = t0_s + samples / rate_hz - first_s + self.responses.length_s + TAIL_S  # until all has faded
        whole = scipy.fft.next_fast_len(math.ceil(lasting_s * rate_hz), real=True)
        frequency = scipy.fft.rfftfreq(whole, 1 / rate_hz)
        frequency = frequency[frequency < self.responses.highest_hz]
        turning = 2j * math.pi * frequency
        edges = np.array(pulses, float) * TICK_S
        burst = np.exp(-np.outer(turning, edges[:, 0])).sum(axis=1) - np.exp(-np.outer(turning, edges[:, 1])).sum(
            axis=1
        )
        burst[1:] /= turning[1:]
        burst[0] = np.diff(edges, axis=1).sum()
        sound = self._spectrum(len(frequency), rate_hz / whole) @ self._at(steps)
        tank = self.tank
        volts = tank.pulse_v / PULSE_S * sound + tank.spike_v / PULSE_S / (1 + turning * RECOVERY_S)
        if tank.transducer is not None:
            volts = volts * _band(frequency, *tank.transducer)
        heard = np.zeros(whole // 2 + 1, complex)
        heard[: len(frequency)] = volts * burst * np.exp(turning * t0_s)
        return np.asarray(scipy.fft.irfft(heard, whole)[:samples] * rate_hz)

    def _kernel(self, count: int, spacing_hz: float) -> NDArray[np.complex64]:
        """(frequencies, steps): Fourier's integral over the response, at the record's own frequencies."""
        frequency = np.arange(count) * spacing_hz
        times = np.arange(round(self.responses.length_s / self.responses.dt_s)) * self.responses.dt_s
        weight = np.full(len(times), self.responses.dt_s)
        weight[0] /= 2
        return np.asarray(np.exp(-2j * math.pi * np.outer(frequency, times)) * weight, np.complex64)

    def _turned(self, steps: int) -> NDArray[np.float64]:
        return self.responses.at(self.tank.angle_deg(steps))


def _band(frequency: NDArray[np.float64], centre_hz: float, bandwidth: float) -> NDArray[np.float64]:
    """Of a Gaussian pulse: -6 dB at +-bandwidth/2 of the centre."""
    edge = bandwidth * centre_hz / 2
    away = np.stack([frequency - centre_hz, frequency + centre_hz]) / edge
    return np.asarray(np.exp(math.log(10 ** (-6 / 20)) * away**2).sum(axis=0))


# ---- the scope ---------------------------------------------------------------------------------------------------
@dataclass
class Scope:
    """An InfiniiVision scope's remote half, sans-I/O: bytes in, bytes out, triggers and volts from the bench.

    `faults` : which `:DIGitize`, counted from 0, goes wrong and how: deaf (sees no trigger), hang (says nothing more),
    drop (hangs up instead of its data), short (hangs up in the middle of them), huge (says it sends a gigabyte), hole
    (a stretch without data), clip (a range too small), nonsense (a preamble that is none).
    """

    faults: Mapping[int, str] = field(default_factory=dict)
    name: str = "KEYSIGHT TECHNOLOGIES,DSO-X 4052A,MY00000001,07.30"
    seed: int = 1

    def __post_init__(self) -> None:
        if unknown := set(self.faults.values()) - set(FAULTS):
            raise AnnulusError(f"fault {unknown.pop()!r}: expected one of {', '.join(FAULTS)}")
        self.digitizes = 0
        self.triggers_seen = 0
        self.hang_up = False  # the line is to be closed when what was answered has been sent
        self._heard = bytearray()
        self._commands: deque[str] = deque()
        self._errors: deque[str] = deque()
        self._set: dict[str, str] = {
            ":TIMEBASE:RANGE": "1E-3", ":TIMEBASE:POSITION": "0", ":CHANNEL1:RANGE": "4", ":CHANNEL1:OFFSET": "0",
            ":TRIGGER:EDGE:SOURCE": "CHANNEL1", ":TRIGGER:EDGE:SLOPE": "POSITIVE", ":TRIGGER:EDGE:LEVEL": "0",
            ":ACQUIRE:TYPE": "NORMAL", ":ACQUIRE:COUNT": "8", ":WAVEFORM:POINTS": "1000", ":WAVEFORM:FORMAT": "BYTE",
            ":WAVEFORM:BYTEORDER": "MSBFIRST", ":WAVEFORM:UNSIGNED": "1",
        }  # fmt: skip
        self._rng = np.random.default_rng([self.seed, 17])
        self._wanted = 0  # triggers a :DIGitize still waits for
        self._count = 0
        self._sum: NDArray[np.float64] = np.zeros(0)
        self._silent = False
        self._fault = ""

    # ---- the bench's side ----

    @property
    def waits(self) -> bool:
        return self._wanted > 0 and self._fault != "deaf" and not self._silent

    def triggered_by(self, level: int) -> bool:
        """Would this edge on the external input trigger it?"""
        source, slope = self._set[":TRIGGER:EDGE:SOURCE"], self._set[":TRIGGER:EDGE:SLOPE"]
        return (
            self.waits
            and source.startswith("EXT")
            and slope.startswith("POS") == bool(level)
            and 0 < self._number(":TRIGGER:EDGE:LEVEL") < VOLTS_TRIGGER
        )

    def window(self) -> tuple[float, float, int]:
        """(first sample after the trigger in s, samples a second, samples)."""
        span, points = self._number(":TIMEBASE:RANGE"), int(self._number(":WAVEFORM:POINTS"))
        if self._averages() > 1:
            points = min(points, POINTS_AVERAGED)
        return self._number(":TIMEBASE:POSITION") - span / 2, points / span, points

    def record(self, volts: NDArray[np.float64]) -> None:
        """One triggered acquisition: eight bits each, averaged in sixteen."""
        if self._wanted <= 0:
            return
        full = self._number(":CHANNEL1:RANGE") * (0.02 if self._fault == "clip" else 1.0)
        codes = np.clip(np.round((volts - self._number(":CHANNEL1:OFFSET")) / full * 256) + 128, 1, 255)
        self._sum = codes if self._count == 0 else self._sum + codes
        self._count += 1
        self._wanted -= 1
        self.triggers_seen += 1

    # ---- the line's side ----

    def connect(self) -> None:
        self._commands.clear()
        self._heard.clear()
        self._wanted, self._silent, self.hang_up = 0, False, False

    def receive(self, data: bytes) -> bytes:
        """What it answers now; call it again when time has passed, with or without bytes."""
        self._heard += data
        if len(self._heard) > 1 << 16:
            self._heard.clear()
        *lines, rest = bytes(self._heard).split(b"\n")
        self._heard[:] = rest
        for line in lines:
            self._commands += [part.strip() for part in line.decode("ascii", "replace").split(";") if part.strip()]
        answers = bytearray()
        while self._commands and not self._wanted and not self._silent and not self.hang_up:
            answers += self._obey(self._commands.popleft())
        return bytes(answers)

    def _obey(self, command: str) -> bytes:
        head, _, argument = command.partition(" ")
        query, name = head.endswith("?"), _long(head.rstrip("?"))
        if query:
            return self._answer(name)
        match name:
            case "*CLS":
                self._errors.clear()
            case "*RST" | ":STOP":
                pass
            case ":DIGITIZE":
                self._fault = self.faults.get(self.digitizes, "")
                self.digitizes += 1
                self._silent = self._fault == "hang"
                self._wanted, self._count = self._averages(), 0
            case _ if name in self._set or name in _ACCEPTED:
                self._accept(name, argument)
            case _:
                self._errors.append('-113,"Undefined header"')
        return b""

    def _accept(self, name: str, argument: str) -> None:
        if name in self._set and re.fullmatch(r"[-+.\dE]+", self._set[name], re.I) and name != ":WAVEFORM:UNSIGNED":
            try:
                value = float(argument)
            except ValueError:
                self._errors.append('-104,"Data type error"')
                return
            low, high = _LIMITS.get(name, (-1e9, 1e9))
            if not low <= value <= high:
                self._errors.append('-222,"Data out of range"')
                return
        self._set[name] = argument.upper()

    def _answer(self, name: str) -> bytes:
        start, rate, points = self.window()
        full = self._number(":CHANNEL1:RANGE") * (0.02 if self._fault == "clip" else 1.0)
        match name:
            case "*IDN":
                return self.name.encode() + b"\n"
            case "*OPC":
                return b"1\n"
            case ":SYSTEM:ERROR":
                return (self._errors.popleft() if self._errors else '+0,"No error"').encode() + b"\n"
            case ":WAVEFORM:COUNT":
                return b"%d\n" % max(self._count, 1)
            case ":WAVEFORM:PREAMBLE" if self._fault == "nonsense":
                return b"+1,+2,many,0,nan,1E400,+0,,,\n"
            case ":WAVEFORM:PREAMBLE":
                kind = 2 if self._averages() > 1 else 0
                offset = self._number(":CHANNEL1:OFFSET")
                return (
                    f"+1,+{kind},+{points},+{max(self._count, 1)},{1 / rate:+.9E},{start:+.9E},+0,"
                    f"{full / 65536:+.7E},{offset:+.7E},+32768\n"
                ).encode()
            case ":WAVEFORM:DATA":
                return self._data(points)
            case _ if name in self._set:
                return self._set[name].encode() + b"\n"
        self._errors.append('-113,"Undefined header"')
        return b""

    def _data(self, points: int) -> bytes:
        if not self._count:
            self._errors.append('-230,"Data corrupt or stale"')
            return b"#10\n"
        words = np.round(self._sum / self._count * 256).astype(np.uint16)
        if self._fault == "hole":
            words[points // 2 : points // 2 + 20] = 0
        order = "<u2" if self._set[":WAVEFORM:BYTEORDER"].startswith("LSB") else ">u2"
        body = words.astype(order).tobytes()
        block = b"#8%08d" % len(body) + body + b"\n"
        self.hang_up = self._fault in ("drop", "short")
        if self._fault == "huge":
            return b"#9999999999" + body
        return {"drop": b"", "short": block[: len(block) // 2]}.get(self._fault, block)

    def noise(self, rms: float, samples: int) -> NDArray[np.float64]:
        return rms * self._rng.standard_normal(samples)

    def _averages(self) -> int:
        return int(self._number(":ACQUIRE:COUNT")) if self._set[":ACQUIRE:TYPE"].startswith("AVER") else 1

    def _number(self, name: str) -> float:
        return float(self._set[name])


_LONG = (
    "TIMEBASE", "MODE", "REFERENCE", "RANGE", "POSITION", "CHANNEL1", "DISPLAY", "OFFSET", "TRIGGER", "EDGE", "SOURCE",
    "SLOPE", "LEVEL", "SWEEP", "ACQUIRE", "TYPE", "COUNT", "COMPLETE", "WAVEFORM", "FORMAT", "BYTEORDER", "UNSIGNED",
    "POINTS", "DIGITIZE", "STOP", "SYSTEM", "ERROR", "PREAMBLE", "DATA",
)  # fmt: skip
_SHORT = {
    "TIM": "TIMEBASE", "REF": "REFERENCE", "RANG": "RANGE", "POS": "POSITION", "CHAN1": "CHANNEL1", "DISP": "DISPLAY",
    "OFFS": "OFFSET", "TRIG": "TRIGGER", "SOUR": "SOURCE", "SLOP": "SLOPE", "LEV": "LEVEL", "SWE": "SWEEP",
    "ACQ": "ACQUIRE", "COUN": "COUNT", "COMP": "COMPLETE", "WAV": "WAVEFORM", "FORM": "FORMAT", "BYT": "BYTEORDER",
    "UNS": "UNSIGNED", "POIN": "POINTS", "DIG": "DIGITIZE", "SYST": "SYSTEM", "ERR": "ERROR", "PRE": "PREAMBLE",
}  # fmt: skip
_ACCEPTED = (
    ":TIMEBASE:MODE", ":TIMEBASE:REFERENCE", ":CHANNEL1:DISPLAY", ":TRIGGER:MODE", ":TRIGGER:SWEEP",
    ":ACQUIRE:COMPLETE", ":WAVEFORM:SOURCE", ":WAVEFORM:POINTS:MODE",
)  # fmt: skip
_LIMITS = {
    ":TIMEBASE:RANGE": (2e-8, 500.0), ":CHANNEL1:RANGE": (8e-3, 40.0), ":ACQUIRE:COUNT": (2, 65536),
    ":WAVEFORM:POINTS": (100, 4e6),
}  # fmt: skip


def _long(header: str) -> str:
    """Every mnemonic in its long form, capitals; unknown ones as they are."""
    if header.startswith("*"):
        return header.upper()
    parts = [part.upper() for part in header.lstrip(":").split(":")]
    return ":" + ":".join(_SHORT.get(part, part) for part in parts)


_QUADRATURE = ((1, 1), (0, 1), (0, 0), (1, 0))  # of the stage's encoder, a count a step; A first counts up


# ---- the bench ---------------------------------------------------------------------------------------------------
class AcousticBench:
    """Board, tank and scope in the board's time. `advance` moves it; `serving` does so in real time."""

    def __init__(self, board: Board, ear: Ear, scope: Scope | None = None, *, boot: int = 1) -> None:
        self.board, self.ear = board, ear
        self.scope = Scope(seed=ear.tank.seed) if scope is None else scope
        self.steps = 0  # where the stage stands
        self.bursts = 0  # triggers the controller gave
        self._forward = True
        self._rise: int | None = None
        self._pulses: deque[tuple[int, int]] = deque()
        self._taken: deque[tuple[int, int]] = deque()  # trigger tick, steps: records under way
        self._busy_until = 0
        self._unplugged = False
        self._wanted: deque[tuple[int, int]] = deque()  # pin, level: the stage's encoder, somebody's hand on the door
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
            stuck = self.ear.tank.stuck_after
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
        volts = self.ear.hear(relative, steps, start, rate, points)
        self.scope.record(volts + self.scope.noise(self.ear.tank.noise_v, points))

    # ---- real time ----

    def run(self, over: threading.Event) -> None:
        """Serve port and scope until `over`: the world keeps up with the clock, or is slowed down."""
        origin = time.monotonic_ns() - self.board.tick * 10
        to_host = bytearray()
        arrivals = 0
        while not over.is_set():
            with contextlib.suppress(OSError, ValueError):  # a line that was just closed
                select.select([*self._serial.waitables(), *self._lan.waitables()], [], [], PATIENCE_S)
            now = (time.monotonic_ns() - origin) // 10
            if now > self.board.tick + SLIP_TICKS:
                origin += (now - self.board.tick - SLIP_TICKS) * 10
                now = self.board.tick + SLIP_TICKS
            self.advance(now)
            if heard := self._serial.read():
                self.board.serial_write(heard)
            to_host += self.board.serial_read()
            del to_host[: self._serial.write(bytes(to_host)) if to_host else 0]
            if len(to_host) > 65536:
                to_host.clear()
            told = self._lan.read()
            if self._lan.arrivals != arrivals:
                arrivals = self._lan.arrivals
                self.scope.connect()
            if answer := self.scope.receive(told):
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


@contextlib.contextmanager
def serving(bench: AcousticBench) -> Iterator[AcousticBench]:
    """The bench in real time on a thread of this process; closed at the end."""
    over = threading.Event()
    failed: list[BaseException] = []

    def run() -> None:
        try:
            bench.run(over)
        except BaseException as error:  # told to whoever waits, not to a thread's stderr
            failed.append(error)

    thread = threading.Thread(target=run, name="acoustic bench", daemon=True)
    thread.start()
    try:
        yield bench
    finally:
        over.set()
        thread.join(5.0)
        bench.close()
    if failed:
        raise AnnulusError(f"twin bench: ended by itself ({failed[0]})")


def bench_named(
    phantom_name: str,
    radius_mm: float,
    sound_speed_m_s: float,
    steps_per_turn: int,
    board: str = "native",
    progress: Callable[[str, int, int], None] | None = None,
) -> AcousticBench:
    """A bench about one of the named phantoms."""
    tank = Tank(phantom(phantom_name), radius_mm, sound_speed_m_s, steps_per_turn=steps_per_turn)
    return AcousticBench(open_board(board), Ear(tank, progress))
