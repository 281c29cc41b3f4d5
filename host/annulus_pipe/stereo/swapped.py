"""Whether frames are those of the cameras that the scan says they are of."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.stereo.reconstructor import StereoReconstructor
from annulus_pipe.vocabulary import Finding

SWAPPED = "cameras-swapped"  # kind of finding
BETTER = 2.0  # times as many points with the cameras exchanged; test_stereo


def swapped(
    head: StereoReconstructor, some: Sequence[tuple[int, Mapping[int, NDArray[np.uint8]]]]
) -> Iterator[Finding]:
    """A finding where every one of some flashes, (frame, images), makes a better wall with two cameras exchanged."""
    pairs = [(index, images) for index, images in some if len(images) == 2]
    for index, images in pairs:
        (a, first), (b, second) = images.items()
        if first.shape != second.shape:
            return
        points = [len(head.profile(tried, frame=index, z_mm=0.0).ring) for tried in (images, {a: second, b: first})]
        if points[1] <= BETTER * points[0]:
            return
    if pairs:
        yield Finding(
            SWAPPED,
            f"the cameras look exchanged: frames of camera {a} make a wall as camera {b}'s, and the other way round",
            tuple(index for index, _ in pairs),
        )
