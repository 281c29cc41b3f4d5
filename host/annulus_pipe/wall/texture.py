"""The wall's colour from LED frames, on the same grid as its radius."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import BoolArray, Float32Array, FloatArray
from annulus_pipe.numeric.native import door
from annulus_pipe.wall.centreline import Centreline
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.profile import Profile

# FARTHEST_OF_RADIUS is guarded downwards by test_texture_shows_a_stain_where_it_is; the others: unguarded.
NEAREST_OF_RADIUS = 0.4  # of the radius: the least distance ahead from which colour is taken
FARTHEST_OF_RADIUS = 2.2  # .. and the greatest
LIGHT_FRAMES = 8  # how many frames teach the fall-off of the LED light along the pipe
HIDDEN = 0.85  # of another camera's brightness: a cell seen darker is hidden by what is before it; test_texture
BLACK = 4.0  # grey levels of a dark pixel; a cell must be brighter than this to have a colour
NEAREST_MM = 1.0  # ahead of a camera: what is nearer is not before it

_colours_at = door("colours_at", "u1[h,w,3] image", "f8[n,2] pixels", "u1[n,3]! colour", "b1[n]! inside")
_add_colours = door(
    "add_colours",
    "u1[r,a,3] colour",
    "b1[r,a] inside",
    "f4[r] gain",
    "f4[r] near",
    "f8 black",
    "f4[r,a,3]! total",
    "f4[r,a]! weight",
)


_row_medians = door("row_medians", "f4[r,a] field", "f4[a]! line", "f4[r]! out")


def row_medians(field: Float32Array) -> Float32Array:
    """(R,) medians of rows, NaN passed over; NaN of a row of nothing."""
    out = np.empty(len(field), np.float32)
    _row_medians(field, np.empty(field.shape[1], np.float32), out)
    return out


@dataclass(frozen=True, slots=True)
class LedFrame:
    """One frame lit by the LED ring: its index and station, and the image, (H, W, 3) uint8 BGR."""

    index: int
    z_mm: float
    image_bgr: NDArray[np.uint8]
    camera: int = 0  # id; of a head with several


@dataclass(frozen=True, slots=True)
class _Patch:
    first_row: int
    colour: NDArray[np.uint8]  # (rows, A, 3) BGR
    inside: BoolArray  # (rows, A) of the image
    ahead: FloatArray  # (rows,) mm


def shows(z_mm: float, radius_mm: float, first_mm: float, last_mm: float) -> bool:
    """Whether a frame taken there shows colours of the wall between two stations."""
    return z_mm + FARTHEST_OF_RADIUS * radius_mm >= first_mm and z_mm + NEAREST_OF_RADIUS * radius_mm <= last_mm


class HeadPath:
    """Where the head was, between the poses of profiles."""

    def __init__(self, profiles: Sequence[Profile]) -> None:
        known = sorted(((p.z_mm, p.pose) for p in profiles if p.pose is not None), key=lambda known: known[0])
        self._z = np.array([z for z, _ in known])
        self._values = [np.array([getattr(pose, name) for _, pose in known]) for name in ("rx", "ry", "tx", "ty")]
        rolls = [pose.roll for _, pose in known if pose.roll is not None]
        if len(rolls) == len(known):
            self._values.append(np.unwrap(rolls))

    def at(self, z_mm: float) -> Pose | None:
        """The pose at a station, between those of the profiles before and after it; None without any pose."""
        if not len(self._z):
            return None
        return Pose(*(float(np.interp(z_mm, self._z, value)) for value in self._values))


def paint(
    wall: Wall,
    centreline: Centreline,
    calibration: Calibration,
    profiles: Sequence[Profile],
    frames: Iterable[LedFrame],
) -> NDArray[np.uint8] | None:
    """Colour of every cell, (Z, A, 4) uint8 RGBA, alpha 0 where no LED frame saw it; None without a usable frame.

    Each cell takes the mean of the frames that saw it, the near and therefore sharp ones counting most (weight falls
    with the fourth power of the distance ahead, as the area a pixel covers does). The fall-off of the LED light along
    the pipe is learned from the frames themselves: at each distance ahead, the median over the clock and the frames.
    """
    sums: dict[int, tuple[NDArray[np.float32], NDArray[np.float32]]] = {}  # by camera: weighted colours, weights
    waiting: dict[int, list[_Patch]] = {}  # by camera: each has its own light
    light: dict[int, FloatArray] = {}
    radius, path = wall.filled_mm().astype(np.float64), HeadPath(profiles)
    for frame in frames:
        pose = path.at(frame.z_mm)
        patch = _look(wall, radius, centreline, calibration, pose, frame) if pose is not None else None
        if patch is None:
            continue
        if frame.camera not in sums:
            shape = wall.radius_mm.shape
            sums[frame.camera] = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
        if frame.camera in light:
            _add(*sums[frame.camera], patch, light[frame.camera], wall)
            continue
        first = waiting.setdefault(frame.camera, [])
        first.append(patch)
        if len(first) == LIGHT_FRAMES:
            light[frame.camera] = _learn(*sums[frame.camera], first, wall)
    if not waiting:
        return None
    for camera, first in waiting.items():
        if camera not in light:
            light[camera] = _learn(*sums[camera], first, wall)
    total, weight = _unhidden(list(sums.values()))
    seen = weight > 0
    colour = total / np.maximum(weight, 1e-12)[..., None]
    bright = np.percentile(colour[seen].max(axis=1), 99) if seen.any() else 1.0
    out = np.zeros((*seen.shape, 4), dtype=np.uint8)
    out[..., :3] = np.clip(colour[..., ::-1] * (235.0 / max(float(bright), 1e-6)), 0, 255).astype(np.uint8)
    out[..., 3] = np.where(seen, 255, 0)
    return out


def _unhidden(
    sums: Sequence[tuple[NDArray[np.float32], NDArray[np.float32]]],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The sums of all cameras, without those that see a cell much darker than another does: something is before it."""
    if len(sums) == 1:
        return sums[0]
    bright = np.stack([total.max(axis=2) / np.maximum(weight, 1e-12) for total, weight in sums])
    clear = bright > HIDDEN * bright.max(axis=0)
    total = sum(np.where(ok[..., None], one, 0) for ok, (one, _) in zip(clear, sums, strict=True))
    weight = sum(np.where(ok, one, 0) for ok, (_, one) in zip(clear, sums, strict=True))
    return np.asarray(total, np.float32), np.asarray(weight, np.float32)


def _learn(
    total: NDArray[np.float32], weight: NDArray[np.float32], patches: Sequence[_Patch], wall: Wall
) -> FloatArray:
    """The fall-off of a camera's light from its first frames, which are added with it."""
    light = _light(patches, wall)
    for patch in patches:
        _add(total, weight, patch, light, wall)
    return light


def pixels_of(
    points: FloatArray, centreline: Centreline, calibration: Calibration, pose: Pose, z_mm: float, camera: int
) -> FloatArray:
    """Where points of the wall, (N, 3) mm in the pipe frame, lie in a frame that was taken with this pose at z_mm by
    this camera (its id): (N, 2) pixels, NaN of what is not before it."""
    own, turn, shift = _camera(centreline, calibration, pose, z_mm, camera)
    return own.project(centreline.to_space(points), turn, shift, NEAREST_MM)


def pixels_round(
    z: FloatArray,
    radius: FloatArray,
    clock_deg: FloatArray,
    centreline: Centreline,
    calibration: Calibration,
    pose: Pose,
    frame: LedFrame,
) -> FloatArray:
    """The same of all the wall between two stations, (R A, 2): radius (R, A) mm at stations z (R,) round the clock."""
    own, turn, shift = _camera(centreline, calibration, pose, frame.z_mm, frame.camera)
    stands, ahead = centreline.frames_at(z)
    t = np.radians(clock_deg)
    rows = np.concatenate([turn @ ahead[:, :, :2], (stands @ turn.T + shift)[:, :, None]], axis=2)
    return own.project_rows(radius, np.stack([np.sin(t), -np.cos(t)]), rows, NEAREST_MM)


def _camera(
    centreline: Centreline, calibration: Calibration, pose: Pose, z_mm: float, camera: int
) -> tuple[Camera, FloatArray, FloatArray]:
    """The camera of that id, and how what lies in space is turned and shifted in its frame."""
    (stands,), (ahead,) = centreline.frames_at(np.array([z_mm]))
    turn = pose.rotation @ ahead.T
    shift = pose.translation - turn @ stands
    own = next((one for one in calibration.cameras if one.id == camera), calibration.cameras[0])
    if calibration.others:
        turn, shift = np.array(own.rotation) @ turn, np.array(own.rotation) @ shift + own.translation_mm
    return own.camera, turn, shift


def _look(
    wall: Wall, radius_mm: FloatArray, centreline: Centreline, calibration: Calibration, pose: Pose, frame: LedFrame
) -> _Patch | None:
    """What one frame shows of the grid's cells within reach; None when it shows nothing of it. radius_mm (Z, A) : of
    the cells, known or not."""
    radius, columns = wall.mean_radius_mm, len(wall.clock_deg)
    reach = (frame.z_mm + NEAREST_OF_RADIUS * radius, frame.z_mm + FARTHEST_OF_RADIUS * radius)
    first, last = np.searchsorted(wall.z_mm, reach)
    if first == last:
        return None
    z = wall.z_mm[first:last]
    pixels = pixels_round(z, radius_mm[first:last], wall.clock_deg, centreline, calibration, pose, frame)
    colour, inside = np.empty((len(pixels), 3), np.uint8), np.empty(len(pixels), np.bool_)
    _colours_at(np.ascontiguousarray(frame.image_bgr), pixels, colour, inside)
    if not inside.any():
        return None
    shape = last - first, columns
    return _Patch(int(first), colour.reshape(*shape, 3), inside.reshape(shape), wall.z_mm[first:last] - frame.z_mm)


def _light(patches: Sequence[_Patch], wall: Wall) -> FloatArray:
    """(B,) median brightness per grid step of distance ahead, from 0 to the farthest; NaN where nothing was seen."""
    bins: dict[int, list[float]] = {}
    for patch in patches:
        b, g, r = np.moveaxis(patch.colour, 2, 0)
        brightness = np.where(patch.inside, np.maximum(np.maximum(b, g), r), 0)
        seen = np.where(brightness > BLACK, brightness, np.nan).astype(np.float32)
        for distance, middle in zip(patch.ahead, row_medians(seen), strict=True):
            if np.isfinite(middle):
                bins.setdefault(round(distance / wall.z_step_mm), []).append(float(middle))
    out = np.full(round(FARTHEST_OF_RADIUS * wall.mean_radius_mm / wall.z_step_mm) + 2, np.nan)
    for i, values in bins.items():
        out[min(i, len(out) - 1)] = np.median(values)
    return out


def _add(total: NDArray[np.float32], weight: NDArray[np.float32], patch: _Patch, light: FloatArray, wall: Wall) -> None:
    gain = light[np.clip(np.rint(patch.ahead / wall.z_step_mm).astype(int), 0, len(light) - 1)]
    near = (wall.mean_radius_mm / patch.ahead) ** 4
    rows = slice(patch.first_row, patch.first_row + len(patch.ahead))
    light_of = gain.astype(np.float32), near.astype(np.float32)
    _add_colours(patch.colour, patch.inside, *light_of, BLACK, total[rows], weight[rows])
