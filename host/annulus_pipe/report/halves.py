"""The wall in 3-D: both halves of the pipe, cut open lengthwise, with numbers, hours, distances and a colour bar."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray, Image
from annulus_pipe.numeric.native import door
from annulus_pipe.numeric.rounding import DISTANCE, clock_face, span
from annulus_pipe.report.marks import WallMark
from annulus_pipe.report.names import EXAGGERATION, INK, round_up
from annulus_pipe.report.paper import DEVIATION, DPI, badge, png
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.grid import Wall, smooth
from annulus_pipe.wall.survey import Survey

SIZE_PX = (960, 560)  # of the view; below it a strip for the colour bar
STRIP_PX = 84
LABEL_PT = 11.5
BACKGROUND = (222, 229, 235)
HALF_DEG = 90.0  # each side of the middle
VIEW_ROLL_DEG, VIEW_YAW_DEG = -14.0, 27.0  # from where one looks at a half: rolled about the pipe, turned along it
REACH_OF_RADIUS = 4.5  # of a long pipe: the stretch shown, to each side of its deepest defect
_half_view = door(
    "half_view",
    "f4[n,m] map",
    "u1[n,m,3] colour",
    "f8[r] row",
    "i4[c] left",
    "i4[c] beside",
    "i4[c] nearest",
    "f8[c] part",
    "f4[c] sine",
    "f4[c] cosine",
    "b1[c] facing",
    "f4[r] along",
    "f8 radius",
    "f8 exaggeration",
    "f8 turn",
    "f8 advance",
    "f8[3,3] axes",
    "f4[3] origin",
    "f8[3] lamp",
    "f8 scale",
    "f4[3,c]! room",
    "b1[3,c]! seen",
    "f8[h,w]! depth",
    "u1[h,w,3]! canvas",
)


@dataclass(frozen=True, slots=True)
class ShadedView:
    """A shaded picture, (H, W, 3) uint8 RGB, and how pipe-frame points fall into it (orthographic)."""

    image: Image
    right: FloatArray
    down: FloatArray
    origin: FloatArray  # the pipe-frame point in the middle of the picture, mm
    px_per_mm: float

    def project(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm in the pipe frame -> (N, 2) pixels."""
        height, width = self.image.shape[:2]
        flat = (points - self.origin) @ np.stack([self.right, self.down], axis=1)
        return np.asarray(flat * self.px_per_mm + [(width - 1) / 2, (height - 1) / 2])


def stretch_of(survey: Survey) -> slice:
    """Rows of the grid that are shown: all of a short pipe, of a long one those about the deepest local defect."""
    wall = survey.wall
    local = [defect for defect in survey.defects if defect.kind is not Kind.OVALITY]
    reach = REACH_OF_RADIUS * wall.mean_radius_mm
    if np.ptp(wall.z_mm) <= 2 * reach:
        return slice(0, len(wall.z_mm))
    middle = max(local, key=lambda d: d.depth_mm).z_mm if local else float(wall.z_mm.mean())
    middle = float(np.clip(middle, wall.z_mm[0] + reach, wall.z_mm[-1] - reach))
    return slice(*(int(k) for k in np.searchsorted(wall.z_mm, (middle - reach, middle + reach))))


def ends_of(wall: Wall, rows: slice) -> tuple[float, float]:
    """Where the stretch begins and ends, mm."""
    half = wall.z_step_mm / 2
    return float(wall.z_mm[rows][0]) - half, float(wall.z_mm[rows][-1]) + half


def draw_halves(
    survey: Survey, rows: slice, rgb: Image, marks: Sequence[WallMark], scale_mm: float
) -> tuple[tuple[str, bytes], ...]:
    """Caption and PNG of both halves.

    rows : the stretch. rgb : (Z, A, 3) uint8, the shape map's colour of every cell; scale_mm its ends.
    """
    local = [defect for defect in survey.defects if defect.kind is not Kind.OVALITY]
    out = []
    middle_deg = _best_cut(local)
    wall = survey.wall
    map_mm = smooth(wall.deviation_mm()[rows])
    for clock in (middle_deg, middle_deg + 180.0):
        begin, end = (clock_face(clock + offset) for offset in (-HALF_DEG, HALF_DEG))
        caption = f"the half around {clock_face(clock)}, from {begin} to {end}, {span(*ends_of(wall, rows), DISTANCE)}"
        out.append((caption, _half(wall, map_mm, rgb, rows, clock % 360, marks, scale_mm)))
    return tuple(out)


def _best_cut(local: Sequence[Defect]) -> float:
    """Middle of the first half (deg), a whole hour: the pipe is cut far from defects, at 3 and 9 where it may."""
    hours = [180.0, *(30.0 * hour for hour in range(12))]

    def room(middle: float) -> float:
        gaps = [
            abs((defect.clock_deg - cut + 180) % 360 - 180) - defect.arc_deg / 2
            for defect in local
            if defect.arc_deg < 180
            for cut in (middle - 90, middle + 90)
        ]
        return min(min(gaps, default=20.0), 20.0)

    return max(hours, key=room)


def _half(
    wall: Wall,
    map_mm: NDArray[np.float32],
    rgb: Image,
    rows: slice,
    clock_deg: float,
    marks: Sequence[WallMark],
    scale_mm: float,
) -> bytes:
    view = half_view(wall, map_mm, rgb, rows, clock_deg, width=SIZE_PX[0], height=SIZE_PX[1])
    height, width = view.image.shape[:2]
    total = height + STRIP_PX
    figure = Figure(figsize=(width / DPI, total / DPI), dpi=DPI)
    axes = figure.add_axes((0, STRIP_PX / total, 1, height / total))
    axes.imshow(view.image, interpolation="antialiased")
    axes.set_axis_off()
    axes.set_xlim(0, width)
    axes.set_ylim(height, 0)
    labels = _Labels(axes, width, height)
    at = _WallToPicture(view, wall.mean_radius_mm)
    first, last = float(wall.z_mm[rows][0]), float(wall.z_mm[rows][-1])
    _number(axes, labels, at, marks, (first, last), clock_deg)
    for offset in (0, -90, 90, -45, 45):  # the middle first: where there is no room for all, it has a label
        clock = (clock_deg + offset) % 360
        for z, shift in ((first, -1), (last, 1)):
            x, y = at(clock, z, 1.0)
            labels.put(x + 12 * shift, y, clock_face(clock), "right" if shift < 0 else "left")
    step = round_up((last - first) / 1000 / 5)
    rim = clock_deg + HALF_DEG  # the nearer of the two rims
    for z in 1000 * np.arange(np.ceil(first / 1000 / step) * step, last / 1000 + 1e-9, step):
        (x0, y0), (x1, y1), (x, y) = (at(rim, z, out) for out in (1.0, 1.06, 1.14))
        if labels.put(x, y, f"{z / 1000:.3f}".rstrip("0").rstrip(".") + " m", "center"):
            axes.plot([x0, x1], [y0, y1], color=INK, lw=0.7)
    bar = figure.add_axes((0.2, 46 / total, 0.6, 14 / total))
    shown = ScalarMappable(Normalize(-scale_mm, scale_mm), DEVIATION)
    figure.colorbar(shown, cax=bar, orientation="horizontal")
    bar.tick_params(labelsize=LABEL_PT - 1)
    for x, text, side in ((0.19, "inwards", "right"), (0.81, "outwards, mm", "left")):
        figure.text(x, 53 / total, text, ha=side, va="center", fontsize=LABEL_PT - 1)
    return png(figure)


class _WallToPicture:
    """Where a place on the wall lies in the picture: clock (deg), distance (mm), radius over the pipe's -> pixels."""

    def __init__(self, view: ShadedView, radius_mm: float) -> None:
        self.view, self.radius_mm = view, radius_mm

    def __call__(self, clock: float, z: float, out: float) -> tuple[float, float]:
        t, r = np.radians(clock), self.radius_mm * out
        x, y = self.view.project(np.array([[r * np.sin(t), -r * np.cos(t), z]]))[0]
        return float(x), float(y)


class _Labels:
    """Text that is left out where it would run into other text, or out of the picture."""

    def __init__(self, axes: Any, width: int, height: int) -> None:
        self.axes, self.width, self.height = axes, width, height
        self.taken: list[tuple[float, float, float, float]] = []

    def put(self, x: float, y: float, text: str, side: str) -> bool:
        wide, half = 0.62 * len(text) * LABEL_PT * DPI / 72, 0.55 * LABEL_PT * DPI / 72
        left = x - {"left": 0.0, "center": wide / 2, "right": wide}[side]
        left = min(max(left, 2.0), self.width - wide - 2.0)
        if not self.claim(left, y - half, left + wide, y + half):
            return False
        self.axes.text(left, y, text, ha="left", va="center", fontsize=LABEL_PT, color=INK)
        return True

    def claim(self, left: float, top: float, right: float, bottom: float) -> bool:
        if top < 0 or bottom > self.height or left < 0 or right > self.width:
            return False
        if any(left < x1 + 3 and right > x0 - 3 and top < y1 + 1 and bottom > y0 - 1 for x0, y0, x1, y1 in self.taken):
            return False
        self.taken.append((left, top, right, bottom))
        return True


def _number(
    axes: Any,
    labels: _Labels,
    at: _WallToPicture,
    marks: Sequence[WallMark],
    ends: tuple[float, float],
    clock_deg: float,
) -> None:
    """A badge beside everything that lies on this half, with a line to its middle."""
    for mark in marks:
        z = sum(mark.z_range_mm) / 2
        turned = (mark.clock_deg - clock_deg + 180) % 360 - 180
        all_round = mark.arc_deg >= 345
        if not ends[0] <= z <= ends[1] or (abs(turned) > HALF_DEG and not all_round):
            continue
        clock = clock_deg if all_round else mark.clock_deg
        x, y = at(clock, z, 1.0)
        half = 15 + 6 * (len(mark.name) - 1)
        for dx, dy in ((0, -58), (0, 58), (58, -30), (-58, -30), (58, 30), (-58, 30), (0, -100), (0, 100)):
            if labels.claim(x + dx - half - 2, y + dy - 17, x + dx + half + 2, y + dy + 17):
                axes.plot([x, x + dx], [y, y + dy], color=INK, lw=0.9)
                axes.plot(x, y, "o", color=INK, ms=2.5)
                badge(axes, x + dx, y + dy, mark.name, **mark.badge)
                labels.taken.append((min(x, x + dx), min(y, y + dy), max(x, x + dx), max(y, y + dy)))
                break


def half_view(
    wall: Wall,
    map_mm: NDArray[np.float32],
    colour: Image,
    rows: slice,
    clock_deg: float,
    *,
    width: int = 840,
    height: int = 540,
) -> ShadedView:
    """The half of the pipe around a clock angle, from inside and a little ahead; distance runs to the right.

    Parameters
    ----------
    map_mm : the deviation on the stretch, calmed; unseen cells are drawn as holes.
    colour : (Z, A, 3) uint8 RGB of every cell. rows : the stretch to show.

    Notes
    -----
    The grid is resampled finer than the picture and splatted, far first, at twice the size, then averaged down. Shaded
    by the slope of the wall; deviations are drawn `EXAGGERATION` times their size.
    """
    radius = wall.mean_radius_mm
    z = wall.z_mm[rows]
    look = np.radians(clock_deg + VIEW_ROLL_DEG)
    outward = np.array([np.sin(look), -np.cos(look), 0.0])
    along = np.array([0.0, 0.0, 1.0])
    yaw = np.radians(VIEW_YAW_DEG)
    forward = np.cos(yaw) * outward + np.sin(yaw) * along
    right = np.cos(yaw) * along - np.sin(yaw) * outward
    down = np.cross(forward, right)
    # What will be in the picture, to fit it: the rims of the half, both ends.
    rim = np.radians(np.arange(clock_deg - HALF_DEG, clock_deg + HALF_DEG + 1, 5.0))
    ring = np.stack([radius * np.sin(rim), -radius * np.cos(rim), np.zeros_like(rim)], axis=1)
    corners = np.concatenate([ring + along * z[0], ring + along * z[-1]]) @ np.stack([right, down, forward], axis=1)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = np.array([0.84, 1.0 - 90.0 / height])
    fine = 2
    height = int(min(height, width * (high - low)[1] / (high - low)[0] + 110))  # no empty paper under a long stretch
    size = np.array([width, height]) * fine
    scale = float((size * margin / (high - low)[:2]).min())
    origin = (low + high) / 2 @ np.stack([right, down, forward])

    steps = max(int(np.pi * radius * scale * 1.2), 180)
    j = (clock_deg - HALF_DEG + (np.arange(steps) + 0.5) / steps * 2 * HALF_DEG) / wall.clock_step_deg - 0.5
    n_rows = int(np.clip((z[-1] - z[0]) * scale * 1.2, 2, 4000))
    i = np.linspace(0, len(z) - 1, n_rows)
    left = np.floor(j)
    t = np.radians((j + 0.5) * wall.clock_step_deg).astype(np.float32)
    sine, cosine = np.sin(t), np.cos(t)
    lamp = -(0.75 * forward - 0.5 * down - 0.45 * right)
    canvas = np.full((size[1], size[0], 3), BACKGROUND, dtype=np.uint8)
    _half_view(
        map_mm,
        np.ascontiguousarray(colour[rows]),
        i,
        *((places % colour.shape[1]).astype(np.int32) for places in (left, left + 1, np.rint(j))),
        j - left,
        sine,
        cosine,
        -sine * forward[0] + cosine * forward[1] < 0.0,  # what turns its back is the outside of the near rim
        (z[0] + i * wall.z_step_mm).astype(np.float32),
        radius,
        EXAGGERATION,
        math.radians(2 * HALF_DEG / steps),
        (z[-1] - z[0]) / (n_rows - 1),
        np.stack([right, down, forward]),
        origin.astype(np.float32),
        lamp / np.linalg.norm(lamp),
        scale,
        np.empty((3, steps), np.float32),
        np.empty((3, steps), np.bool_),
        np.empty((size[1], size[0])),
        canvas,
    )
    parts = [canvas[a::fine, b::fine].astype(np.uint16) for a in range(fine) for b in range(fine)]
    image = sum(parts[1:], start=parts[0]) // fine**2
    return ShadedView(image.astype(np.uint8), right, down, origin, scale / fine)
