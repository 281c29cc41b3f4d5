"""An offset from another day, wrong by whole frames, was believed until six pictures contradicted it (e342f02).
Fails when an offset counts as good before a picture of the LED proved it."""

import pytest

from annulus_pipe.capture.pairing import Pairing
from annulus_pipe.capture.photometry import Photometry
from annulus_pipe.capture.seen import FrameSeen
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

MS = 1_000_000
PERIOD = 40 * MS


@pytest.mark.parametrize("shift", [-2, -1, 1, 2])
def test_an_offset_wrong_by_whole_frames_never_gives_a_label(shift: int) -> None:
    pairing = Pairing(PERIOD)
    pairing.recalibrate(PERIOD, -28 * MS + shift * PERIOD, proved=False)
    lamp = [Lamp.LED if edge % 5 == 4 else Lamp.PROJECTOR for edge in range(130)]
    for edge in range(130):
        flash = Flash(
            EdgeIndex(edge),
            Tick(edge * 4_000_000),
            Slot(edge % 5),
            lamp[edge],
            3,
            5,
            edge,
            1,
            1,
            EdgeFlag(0),  # type: ignore[arg-type]
        )
        pairing.edge(flash, 10**12 + edge * PERIOD, 1)
    for number in range(5, 100):
        shown = Photometry(200.0, 0.4, 0.001 if lamp[number - 1] is Lamp.LED else 0.38)
        stamp = 10**12 + number * PERIOD - 28 * MS
        labelled = pairing.label(FrameSeen(CameraSequence(number), stamp, stamp + 34 * MS, shown, {}))
        assert labelled.label is Label.UNKNOWN
    assert pairing.doubtful
