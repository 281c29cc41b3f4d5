"""Frames that wandered away from their edges were doubted, until they came near the next edge and were believed again,
one frame off (cfd2ab4). Fails when nothing but the nearest edge is asked."""

from annulus_pipe.capture.pairing import Pairing
from annulus_pipe.capture.photometry import Photometry
from annulus_pipe.capture.proof import Witness
from annulus_pipe.capture.seen import FrameSeen
from annulus_pipe.vocabulary import CameraSequence, EdgeFlag, EdgeIndex, Flash, Label, Lamp, Slot, Tick

MS = 1_000_000
PERIOD = 40 * MS


def lamp_of(edge: int) -> Lamp:
    return Lamp.LED if edge % 5 == 4 else Lamp.PROJECTOR


def test_an_offset_that_wanders_is_noticed_before_it_reaches_the_next_frame() -> None:
    pairing = Pairing(PERIOD, without=frozenset({Witness.LAMP}))
    pairing.recalibrate(PERIOD, -28 * MS)
    labels = []
    for edge in range(1, 500):
        flash = Flash(
            EdgeIndex(edge),
            Tick(edge * 4_000_000),
            Slot(edge % 5),
            lamp_of(edge),
            3,
            5,
            edge,
            1,
            1,
            EdgeFlag(0),  # type: ignore[arg-type]
        )
        pairing.edge(flash, 10**12 + edge * PERIOD, 1)
        number = edge - 2
        if number > 1:
            stamp = 10**12 + number * PERIOD - 28 * MS + round(number * PERIOD / 300)
            seen = FrameSeen(
                CameraSequence(number), stamp, 10**12 + number * PERIOD + 6 * MS, Photometry(200.0, 0.4, 0.38), {}
            )
            labels.append((number, pairing.label(seen)))
    assert labels[0][1].label is not Label.UNKNOWN
    for number, said in labels:
        assert said.label is Label.UNKNOWN or (said.flash is not None and said.flash.edge == number - 1)
