"""What the order of a preamble's flashes is worth, over every state its register can have. The firmware's own tests
show that this is the order which the pins follow.
"""

import numpy as np
import pytest

from annulus_pipe.vocabulary import Lamp

LAMPS = np.array([Lamp.PROJECTOR, Lamp.LED, Lamp.DARK, Lamp.PROJECTOR], np.uint8)  # of two bits, as core/preamble.c
SLIP_MAX = 63  # frames


def sequence() -> np.ndarray:
    """The lamps of all edges until the register comes round."""
    bits, lamps = 1, []
    while not lamps or bits != 1:
        lamps.append(LAMPS[bits & 3])
        bits = ((bits << 2) | (((bits >> 13) ^ (bits >> 12)) & 3)) & 0x7FFF
    return np.array(lamps)


def contradictions(length: int, ratio: int) -> np.ndarray:
    """For every state in which a preamble can begin: frames of it that a slip contradicts, by the least seen slip."""
    order = sequence()
    preambles = np.stack([np.roll(order, -i) for i in range(length)], axis=1)
    cycle = [*[Lamp.PROJECTOR] * ratio, Lamp.LED]
    cycles = np.tile(np.array(cycle * (-(-SLIP_MAX // len(cycle)) + 1), np.uint8), (len(order), 1))
    frames = np.concatenate([cycles, preambles, cycles], axis=1)
    first = cycles.shape[1]
    least = np.full(len(order), length)
    for slip in [*range(-SLIP_MAX, 0), *range(1, SLIP_MAX + 1)]:
        least = np.minimum(least, (frames[:, first + slip : first + slip + length] != preambles).sum(1))
    return least


def test_the_order_does_not_repeat_before_32767_edges() -> None:
    assert len(sequence()) == 2**15 - 1


@pytest.mark.parametrize("ratio", [1, 4])
def test_a_slip_by_up_to_63_frames_contradicts_a_frame_of_every_preamble_of_15_and_mostly_three(ratio: int) -> None:
    least = contradictions(15, ratio)
    assert least.min() >= 1
    assert (least >= 3).mean() > 0.98
