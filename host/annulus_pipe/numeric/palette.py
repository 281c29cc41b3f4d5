"""Colours that say a number, the same wherever it is shown: in the report's pictures and on the console."""

import numpy as np
from numpy.typing import NDArray

# Outwards red, sound wall near white, inwards blue; readable in every common colour vision, and grey means not seen.
DEVIATION = ("#0b3c7d", "#2f79c4", "#a9cdea", "#f7f7f5", "#f6c3a4", "#d9583b", "#86101b")
DEVIATION_LIVE_MM = 1.0  # ends of the scale while nobody knows how deep the deepest defect is


def deviation_table(steps: int = 256) -> NDArray[np.uint8]:
    """(steps, 3) RGB, from the farthest inwards to the farthest outwards."""
    stops = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in DEVIATION], float)
    at = np.linspace(0.0, len(stops) - 1.0, steps)
    mixed = [np.interp(at, np.arange(len(stops)), channel) for channel in stops.T]
    return np.asarray(np.rint(np.stack(mixed, axis=1)), np.uint8)
