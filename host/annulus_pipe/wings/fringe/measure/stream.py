"""A scan as it comes: frames in, finished patches of the wall out, and no more kept than the patches in sight need.

    for patch, found in stream(frames, one, projector, patches): ...

A patch is finished when the head has carried it out of the picture, or at the end. Its frames are those that showed any
of it. What is kept is bounded by how long a patch stays in sight, and by `frames_max`, never by the scan's length.
"""

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.wings.fringe.measure.heights import FringeView, Heights, Points, heights, spline
from annulus_pipe.wings.fringe.measure.projector import FringeProjector
from annulus_pipe.wings.fringe.measure.track import TOO_FEW

FRAMES_MAX = 32


@dataclass(slots=True, eq=False)
class _Open:
    """A patch in sight, and the number of the frame that showed it first."""

    points: Points
    first: int


def stream(
    frames: Iterable[tuple[Float32Array, FloatArray]],
    one: HeadCamera,
    projector: FringeProjector,
    patches: Iterable[Points],
    *,
    noise: tuple[float, float, float] = (1.0, 0.0, 0.0),
    drift_sigma: float = 0.0,
    frames_max: int = FRAMES_MAX,
) -> Iterator[tuple[Points, Heights]]:
    """Each patch with its heights, in the order in which they leave the picture.

    frames : (H, W) linear in light, NaN where saturated, and (3,) mm where the head was. patches : in the order in
    which they come into the picture; drawn one ahead. frames_max : the last that a patch may use; older ones go.
    A patch that fewer than three frames showed comes back as TOO_FEW, one that none showed does not.
    """
    waiting = iter(patches)
    ahead = next(waiting, None)
    kept: deque[tuple[int, Float32Array, FloatArray]] = deque(maxlen=frames_max)
    opened: list[_Open] = []
    for number, (image, place) in enumerate(frames):
        kept.append((number, spline(image[None])[0], np.asarray(place, dtype=float)))
        while ahead is not None and _seen(one, image.shape, ahead, place):
            opened.append(_Open(ahead, number))
            ahead = next(waiting, None)
        gone = [each for each in opened if not _seen(one, image.shape, each.points, place)]
        opened = [each for each in opened if each not in gone]  # the very object: patches are not compared
        for each in gone:
            yield each.points, _finish(kept, each.first, number, one, projector, each.points, noise, drift_sigma)
        oldest = min((each.first for each in opened), default=number + 1)
        while kept and kept[0][0] < oldest:
            kept.popleft()
    for each in opened:
        yield each.points, _finish(kept, each.first, None, one, projector, each.points, noise, drift_sigma)


def _seen(one: HeadCamera, shape: tuple[int, ...], points: Points, place: FloatArray) -> bool:
    """Whether any point of a patch, at height 0, lies in the picture."""
    inside = (points.base - place) @ np.array(one.rotation).T + np.array(one.translation_mm)
    ahead = inside[inside[:, 2] > 0]
    u, v = one.camera.project(ahead).T
    return bool(((u >= 0) & (v >= 0) & (u <= shape[1] - 1) & (v <= shape[0] - 1)).any())


def _finish(
    kept: Iterable[tuple[int, Float32Array, FloatArray]],
    first: int,
    end: int | None,
    one: HeadCamera,
    projector: FringeProjector,
    points: Points,
    noise: tuple[float, float, float],
    drift_sigma: float,
) -> Heights:
    mine = [(image, place) for number, image, place in kept if number >= first and (end is None or number < end)]
    if len(mine) < 3:
        none = np.full(len(points.base), np.nan)
        used, flag = np.full_like(none, float(len(mine))), np.full_like(none, float(TOO_FEW))
        return Heights(none, none, none, none, none, used, flag, np.empty((0, 0), np.float32))
    view = FringeView.of(one, projector, np.array([place for _, place in mine]))
    return heights(view, np.stack([image for image, _ in mine]), points, noise=noise, drift_sigma=drift_sigma)
