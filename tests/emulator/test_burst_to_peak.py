"""From pin to peak on the image a user flashes: its burst, chip for chip, and where the decoder finds the sound."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from annulus_pipe.controller import CODES, PIN_INTERLOCK, PIN_TRIGGER
from annulus_pipe.link.codes import Train, pattern
from annulus_pipe.link.messages import Arm, ArmFlag
from annulus_pipe.link.operate import train_messages
from annulus_pipe.twin.emulated import EmulatedBoard
from annulus_pipe.wings.tai.measure.phantoms import Disc
from annulus_pipe.wings.tai.measure.templates import decode, design
from annulus_pipe.wings.tai.simulated.phantom import RigSetup
from annulus_pipe.wings.tai.simulated.pins import fire, pulses_of
from annulus_pipe.wings.tai.simulated.receiver import Receiver

pytestmark = pytest.mark.skipif("ANNULUS_IMAGE" in os.environ, reason="another image is being judged, on its pins")


@pytest.fixture
def board(image: Path) -> Iterator[EmulatedBoard]:
    with EmulatedBoard(image) as board:
        board.input(board.tick + 1, PIN_INTERLOCK, 0)
        board.run_until(board.tick + 100_000)
        yield board


@pytest.mark.deep(but="mpsl25")
@pytest.mark.parametrize("code", CODES)
def test_the_burst_is_the_designed_pattern_and_its_peak_stands_at_the_time_of_flight(
    board: EmulatedBoard, code: str
) -> None:
    _, burst = train_messages(code, Train(pattern(code), 50, trigger_offset_ticks=-200))
    pins = fire(board, Arm(ArmFlag.MICROWAVE), burst, ticks=200_000)
    (trigger,) = [int(t) for t, pin, level in pins.tolist() if pin == PIN_TRIGGER and level]
    chip0 = trigger + 200
    chips, on = pattern(code), np.zeros(len(pattern(code)), int)
    for rise, fall in pulses_of(pins):
        assert (rise - chip0) % 50 == (fall - chip0) % 50 == 0
        on[(rise - chip0) // 50 : (fall - chip0) // 50] = 1
    assert on.tolist() == chips.tolist()

    receiver = Receiver(RigSetup((Disc(0.0, 0.0, 0.3, 1.0),), 9.0, 1480.0, (0.6e6, 0.7), pulse_v=1.0))
    relative = tuple((a - trigger, b - trigger) for a, b in pulses_of(pins))
    volts = receiver.hear(relative, 0, 2e-6, 10e6, 512)
    one = receiver.hear(((-25, 25),), 0, 0.0, 10e6, 512)  # a single pulse about time 0
    if code == "single":
        found = np.interp(np.arange(512) + 2.5, np.arange(512), volts)  # from chip 0 to the pulse's middle
    elif code.startswith("manchester"):
        return  # a pair's half has no peak of its own
    else:
        found = decode(volts, 10e6, design(chips, 3 * len(chips)), 0.5e-6)
    at = int(np.argmax(np.correlate(found, one, "full"))) - 511
    assert abs(at) <= 2  # samples of 0.1 us: the peak is where the time of flight puts it
    assert np.abs(found - one).max() < 0.1 * np.abs(one).max()
