"""Whether pictures are of two fields: an interlaced camera's, whose odd rows were taken 1/50 s after the even ones.

What moved between the two stands twice, one row in the one place, the next in the other: a comb. Told by the pictures,
since containers and folders often say nothing, or the wrong thing. A bright line that lies along the rows goes up and
down once; noise is below the step that counts.
"""

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Image

STEP = 16  # of 255 from a row to the next: four times a dim camera's noise
TEETH = 5  # rows after each other that go up and down in turn; a line of one row has two
PIXELS_LEAST = 24  # of such runs in a picture
PART_LEAST = 0.1  # of the pixels where rows differ at all
# A head that stands has no comb: so many pictures, and such a part of those looked at, have one.
PICTURES_LEAST, PICTURES_PART = 2, 0.1

TWO_FIELDS = (
    "are of two fields (interlaced): what moves stands in two places. Expected a picture a field, half as high, at its "
    "own time, made a whole one again by a deinterlacer."
)


def combed(image: Image) -> bool:
    """Whether this picture, (H, W) or (H, W, 3) uint8, shows a comb."""
    grey = (image if image.ndim == 2 else image.max(axis=2)).astype(np.int16)
    step = np.diff(grey, axis=0)
    if len(step) < TEETH:
        return False
    up, down = step > STEP, step < -STEP
    turns = len(step) - TEETH + 1
    first_up: BoolArray = np.ones((turns, grey.shape[1]), bool)
    first_down = first_up.copy()
    for k in range(TEETH):
        first_up &= (up if k % 2 == 0 else down)[k : k + turns]
        first_down &= (down if k % 2 == 0 else up)[k : k + turns]
    teeth = int(np.count_nonzero(first_up | first_down))
    return teeth >= max(PIXELS_LEAST, PART_LEAST * np.count_nonzero(up | down))


def two_fields(combs: int, looked_at: int) -> bool:
    """Whether so many pictures with a comb, of those that were looked at, are a camera of two fields."""
    return combs >= max(PICTURES_LEAST, PICTURES_PART * looked_at)
