"""From the firmware's pins to sound: the bench's twin hears what was really emitted, where and when it was."""

import functools

import numpy as np
import pytest

from annulus_pipe.controller import CODES, PIN_INTERLOCK, PIN_TRIGGER, TICK_S, TICKS_PER_US, TURNTABLE_LEAD_MS
from annulus_pipe.link.codes import Train, pattern, train_from_us
from annulus_pipe.link.messages import Arm, ArmFlag, Move
from annulus_pipe.link.operate import train_messages
from annulus_pipe.twin.native import NativeBoard
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.phantoms import Disc
from annulus_pipe.wings.tai.measure.templates import decode, design
from annulus_pipe.wings.tai.simulate import Setup, simulate
from annulus_pipe.wings.tai.simulated.phantom import RigSetup
from annulus_pipe.wings.tai.simulated.pins import fire, pulses_of
from annulus_pipe.wings.tai.simulated.receiver import Receiver
from annulus_pipe.wings.tai.simulated.rig import AcousticRig
from annulus_pipe.wings.tai.simulated.scope import SimulatedScope

SAMPLE = (Disc(0.0, 0.0, 5.0, 0.4), Disc(2.0, 1.0, 1.0, 1.0))
BAND = (0.6e6, 0.7)
RADIUS_MM, SPEED = 9.0, 1480.0
RATE = 10e6


@functools.cache
def receiver(sample: tuple[Disc, ...] = SAMPLE) -> Receiver:
    return Receiver(RigSetup(sample, RADIUS_MM, SPEED, BAND, pulse_v=1.0, noise_v=0.0))


@pytest.fixture
def board() -> NativeBoard:
    try:
        board = NativeBoard()
    except AnnulusError as error:
        pytest.skip(str(error))
    board.power_on(3)
    board.input(0, PIN_INTERLOCK, 0)
    return board


def emitted(board: NativeBoard, code: str, chip_us: float, offset_us: float = 0.0, repeat: int = 1):
    train = train_from_us(code, chip_us=chip_us, repeat=repeat, period_us=1000.0, trigger_offset_us=offset_us)
    own, burst = train_messages(code, train)
    pins = fire(board, *([own] if own else []), Arm(ArmFlag.MICROWAVE), burst, ticks=100_000 * repeat + 50_000)
    triggers = [int(t) for t, pin, level in pins.tolist() if pin == PIN_TRIGGER and level]
    return pulses_of(pins), triggers


@pytest.mark.parametrize("code", [*CODES, "1101000100"])
def test_the_burst_on_the_pin_is_the_designed_pattern_chip_for_chip(board: NativeBoard, code: str) -> None:
    pulses, triggers = emitted(board, code, 0.5, offset_us=-3.0)
    assert len(triggers) == 1
    chip0 = triggers[0] + 300
    on = np.zeros(len(pattern(code)), int)
    for rise, fall in pulses:
        assert (rise - chip0) % 50 == (fall - chip0) % 50 == 0
        on[(rise - chip0) // 50 : (fall - chip0) // 50] = 1
    assert on.tolist() == pattern(code).tolist()


@pytest.mark.parametrize("offset_us", [0.0, -4.37, 2.2])
def test_from_pin_to_peak(board: NativeBoard, offset_us: float) -> None:
    """GP5 as the firmware drives it, a small source in the middle, the decoder's own template: the time of flight."""
    small = receiver((Disc(0.0, 0.0, 0.3, 1.0),))
    pulses, (trigger,) = emitted(board, "mpsl25-stuffed", 0.5, offset_us)
    relative = tuple((a - trigger, b - trigger) for a, b in pulses)
    volts = small.hear(relative, 0, -1e-6 * offset_us, RATE, 512)
    template = design(pattern("mpsl25-stuffed"), 150)
    found = decode(volts, RATE, template, 0.5e-6)
    one = small.hear(((-25, 25),), 0, 0.0, RATE, 512)  # a single pulse about time 0, for the receiver's own shape
    assert np.abs(found - one).max() < 0.05 * np.abs(one).max()  # sidelobes of 1/59, both signs
    peak = np.argmax(np.abs(_envelope(found))) / RATE
    assert abs(peak - RADIUS_MM * 1e-3 / SPEED) < 0.05e-6  # half a chip
    wrong = decode(volts, RATE, design(pattern("barker13"), 39), 0.5e-6)
    assert np.linalg.norm(wrong - one) > np.linalg.norm(one)


def _envelope(trace: np.ndarray) -> np.ndarray:
    from scipy.signal import hilbert

    return hilbert(trace)


def test_it_hears_what_the_simulation_computes_by_another_way() -> None:
    """Impulse responses and exact edges here; the solver driven by the envelope there."""
    chips = pattern("mpsl25-stuffed")
    pulses = tuple((50 * i, 50 * i + 50) for i in np.flatnonzero(chips).tolist())
    bench = Setup("mpsl25-stuffed", 0.5e-6, RADIUS_MM, 8, RATE, SPEED, 1.0, transducer=BAND)
    theirs = simulate(SAMPLE, bench).signals.astype(float)
    ours = np.stack([receiver().hear(pulses, 50 * i, 0.0, RATE, theirs.shape[1]) for i in range(8)])
    kept = slice(None, -30)  # theirs is filtered after it was cut off
    assert np.linalg.norm((ours - theirs)[:, kept]) < 0.055 * np.linalg.norm(theirs[:, kept])


def test_angles_between_the_receivers_are_as_exact_as_those_on_them() -> None:
    """A part that absorbs nothing, far out, has the same sound taken at almost twice as many receivers."""
    finer = receiver((*SAMPLE, Disc(8.0, 0.0, 0.3, 0.0)))
    assert len(finer.responses.at(0.0)) == len(receiver().responses.at(0.0))
    for steps in (1, 31, 50, 213):
        here, there = (e.hear(((0, 50),), steps, 0.0, RATE, 200) for e in (receiver(), finer))
        assert np.linalg.norm(here - there) < 1e-3 * np.linalg.norm(here)


def test_the_stage_the_trigger_and_the_scope_meet_in_the_boards_time(board: NativeBoard) -> None:
    """Told by SCPI and by the wire alone: two bursts averaged at step 37, at the trigger's edge."""
    bench = AcousticRig(board, receiver(), SimulatedScope(), boot=3)
    try:
        bench.scope.receive(
            b":TIM:RANG 4E-5;:TIMebase:POSition 2E-5\n:chan1:rang 4;:TRIG:EDGE:SOUR EXT;:TRIG:EDGE:LEV 1.5\n"
            b":ACQ:TYPE AVER;:ACQ:COUN 2;:WAV:FORM WORD;:WAV:BYT LSBF;:WAV:POIN 500;:DIG CHAN1;*OPC?\n"
        )
        _, burst = train_messages("single", Train(pattern("single"), 50, repeat=2, period_ticks=50_000))
        session = _Wire(bench)
        session.tell(Move(37, 10_000, 1), wait=40 * 10_000 + TURNTABLE_LEAD_MS * 1000 * TICKS_PER_US)
        assert bench.steps == 37
        assert bench.scope.receive(b"") == b""  # it waits
        session.tell(Arm(ArmFlag.MICROWAVE))
        session.tell(burst, wait=200_000)
        assert bench.bursts == bench.scope.triggers_seen == 2
        assert bench.scope.receive(b"") == b"1\n"
        fields = bench.scope.receive(b":WAVeform:PREamble?\n").decode().split(",")
        data = bench.scope.receive(b":WAV:DATA?\n")
        assert data[:10] == b"#800001000" and len(data) == 1011
        volts = (np.frombuffer(data[10:-1], "<u2").astype(float) - float(fields[9])) * float(fields[7])
        expected = receiver().hear(((0, 50),), 37, 0.0, 500 / 4e-5, 500)
        assert np.abs(volts - expected).max() <= 0.51 * 4 / 256  # half a step of eight bits
    finally:
        bench.close()


class _Wire:
    """A host that only tells, and goes on when time has passed."""

    def __init__(self, bench: AcousticRig) -> None:
        from annulus_pipe.link.session import LinkSession, identify

        self.bench, self.session = bench, LinkSession()
        self.tell(identify())

    def tell(self, command, wait: int = 200_000) -> None:
        self.session.send(command)
        end = self.bench.board.tick + wait
        while self.bench.board.tick < end:
            self.bench.board.serial_write(self.session.pending(self.bench.board.tick * 10))
            self.bench.advance(self.bench.board.tick + 10_000)
            self.session.receive(self.bench.board.serial_read(), self.bench.board.tick * 10)


def test_a_trigger_the_scope_was_not_set_to_see_is_not_seen() -> None:
    scope = SimulatedScope()
    scope.receive(b":TRIG:EDGE:SOUR EXT;:TRIG:EDGE:LEV 1.5;:DIG CHAN1\n")
    assert scope.triggered_by(1) and not scope.triggered_by(0)
    for setting in (b":TRIG:EDGE:LEV 5", b":TRIG:EDGE:SOUR CHAN1", b":TRIG:EDGE:SLOP NEG"):
        scope = SimulatedScope()
        scope.receive(b":TRIG:EDGE:SOUR EXT;:TRIG:EDGE:LEV 1.5;" + setting + b";:DIG CHAN1\n")
        assert not scope.triggered_by(1)
    assert scope.triggered_by(0)


def test_the_scope_says_what_it_does_not_understand() -> None:
    scope = SimulatedScope()
    assert scope.receive(b":CHAN1:RANG 1000;:FOO:BAR 3;:ACQ:COUN many;*IDN?\n").startswith(b"KEYSIGHT")
    answers = scope.receive(b":SYST:ERR?;:SYST:ERR?;:SYSTem:ERRor?;:SYST:ERR?\n").decode().split("\n")
    assert [int(a.split(",")[0]) for a in answers[:4]] == [-222, -113, -104, 0]


def test_envelope_edges_count_in_single_ticks() -> None:
    """A pulse of 51 ticks carries 2 percent more than one of 50, and ends 10 ns later."""
    e = receiver()
    a, b, rest = (e.hear(p, 5, 0.0, RATE, 256) for p in (((0, 50),), ((0, 51),), ((50, 51),)))
    assert np.allclose(b - a, rest, rtol=0, atol=1e-9 * np.abs(b).max())
    assert np.abs(rest).max() > 0.01 * np.abs(b).max() and TICK_S == 1e-8
