"""A round top recorded in few bits is flat for several samples and was called cut off at the digitizer's range
(5c243d4). Fails without GENTLE in the look for a rail."""

import numpy as np

from annulus_pipe.wings.tai.measure.sweep import Sweep, examine


def clipped(signals: np.ndarray) -> list[tuple[int, ...]]:
    sweep = Sweep(signals, np.arange(len(signals)) * 30.0, 12.0, 20e6)
    return [fault.positions for fault in examine(sweep) if fault.kind == "clipped"]


def test_flat_for_want_of_bits_is_not_clipped() -> None:
    t = np.arange(400) - 9 * np.arange(12)[:, None]
    sound = np.sin(2 * np.pi * t / 60.0) * np.exp(-(((t - 200) / 60) ** 2))
    few_bits = np.round(sound * 15) / 15
    assert clipped(few_bits) == []
    few_bits[4] = np.clip(few_bits[4], -0.5, 0.5)
    assert clipped(few_bits) == [(4,)]
