"""Why a part of the wall was not seen: a rod's shadow, a step's, an end of the scan, no ring, or light that was lost.

Where every ring's light passed is known (`looks`), whether or not it came back. Columns in which hardly a ring of the
whole scan comes back are the head's own: a rod hides so much, and every scan has it. A wider one is no rod: something
covers the camera there, or the picture is over-exposed.
"""

import math
from collections.abc import Iterator

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray, arc_of
from annulus_pipe.numeric.late import ndimage
from annulus_pipe.wall.extent import as_large
from annulus_pipe.wall.grid import BRIDGE_OF_RADIUS, Wall
from annulus_pipe.wall.indications import Scale
from annulus_pipe.wall.looks import COLUMNS, Looks
from annulus_pipe.wall.patches import label_around, runs
from annulus_pipe.wall.stations import GAP_MAX_DEG

# Held by tests/regression/hole_in_the_map_that_nobody_mentions and test_never_flattered.py.
END_OF_RADIUS = 0.3  # of the radius: how far from an end of the scan rings may end raggedly
SWALLOWED = 0.5  # part of a hole's cells where light should have come back: no rod's shadow but a hole or a steep place
MOSTLY = 0.5  # of the looks that pass a place, or of a hole's cells: what tells its cause
SHADOW_PART = 0.8  # part of a hole that a step's shadow explains
# A hole is named by the box about it. Where dirt or a wet wall loses light all about, holes hang together as a web, and
# its box is the pipe: one that fills less of a larger box is halved. Held by regression web_of_holes_named_as_one.
FILLED = 0.75  # part of its box that a hole fills
ONE_LOOK_OF_RADIUS = 0.5, 1.0  # of the radius, along and round the pipe: a box so small is looked at as a whole
RODS = "not seen: a strip as a rod hides one"
BAND = (
    "not seen: hardly a ring's light comes back from this strip all along the scan, and it is wider than a rod's: "
    "over-exposed, too dark, or something stands before it"
)
LOST = "light that should have come back from there did not: a hole, a steep place, dirt, glare"
JOINT = "not seen: in a joint, or in its shadow"
STEP = "not seen: behind a step"
END = "not seen: at an end of the scan"
NONE = "not seen: no ring's light passed there; frames are missing, or lie too far apart"
DOUBTED = "not seen: what came back from there was not believed"
UNKNOWN = "not seen"


def find_holes(
    wall: Wall,
    unseen: BoolArray,
    shadowed: BoolArray,
    looks: Looks | None,
    known: BoolArray,
    joints: BoolArray,
    scale: Scale,
) -> Iterator[tuple[slice, BoolArray, str, bool]]:
    """Each hole as large as the smallest defect: rows, its cells (R, A) in them, why, and whether every scan has such.

    known : (Z, A) what is listed or explained; a hole in the shadow of a step beside it is usual. joints : (Z,) rows of
    joints; a hole there is usual where most of the circle is hidden, as behind every joint.
    """
    near = scale.mm(scale.limits.join_of_radius)
    everywhere = slice(0, len(unseen))
    holes = as_large(unseen, scale)
    if looks is None:
        band = holes & (runs(holes) * wall.clock_step_deg <= GAP_MAX_DEG)
        passed = lost = None
    else:
        passed, band, lost = _passed(wall, looks, scale)
    width = runs(band) * wall.clock_step_deg
    label, n = label_around(scale.around(band, near))
    for i in range(1, n + 1):
        part = band & (label == i)
        if (part & holes).any():
            usual = bool(np.median(width[part]) <= GAP_MAX_DEG)
            yield everywhere, part & holes, RODS if usual else BAND, usual
    round_it = joints & (unseen.mean(axis=1) > MOSTLY)
    if (common := unseen & ~band & round_it[:, None]).any():
        label, n = ndimage.label(round_it)
        for i in range(1, n + 1):
            if (part := common & (label == i)[:, None]).any():
                yield everywhere, part, JOINT, True
    rest = as_large(unseen & ~band & ~round_it[:, None], scale)
    first, last = wall.extent[:2]
    end = scale.mm(END_OF_RADIUS)
    label, _n = label_around(scale.around(rest, near))  # ragged pieces of one hole are one place
    for i, found in enumerate(ndimage.find_objects(label), 1):
        rows = found[0]
        hole = rest[rows] & (label[rows] == i)
        is_beside: bool | None = None
        for own, part in _compact(hole, scale):
            at = slice(rows.start + own.start, rows.start + own.stop)
            of = np.count_nonzero(part)
            if lost is not None and (part & lost[at]).sum() > SWALLOWED * of:
                yield at, part, LOST, False
            elif (part & shadowed[at]).sum() > SHADOW_PART * of:
                # behind a joint or a bump; a loss that only its own rim's shadow shows is none that every scan has
                if is_beside is None:
                    is_beside = _touches(hole, rows, known, near, scale)
                yield at, part, STEP, is_beside
            elif wall.z_mm[at][-1] <= first + end or wall.z_mm[at][0] >= last - end:
                yield at, part, END, True
            elif passed is None:
                yield at, part, UNKNOWN, False
            else:
                yield at, part, NONE if (passed[at][part] == 0).mean() > MOSTLY else DOUBTED, False


def _touches(hole: BoolArray, rows: slice, known: BoolArray, near_mm: float, scale: Scale) -> bool:
    """Whether a hole in some rows of the wall lies so near to what is known (Z, A)."""
    far = math.ceil(near_mm / scale.cell_mm[0])
    first = max(rows.start - far, 0)
    beside = known[first : rows.stop + far]
    placed = np.zeros_like(beside)
    placed[rows.start - first : rows.stop - first] = hole
    return bool((scale.around(placed, near_mm) & beside).any())


def _compact(hole: BoolArray, scale: Scale) -> Iterator[tuple[slice, BoolArray]]:
    """The parts of a hole (Z, A), halved until each fills most of its box or is small: its rows, and in them (R, A)."""
    start = round(arc_of(np.asarray(hole.any(axis=0)), 1.0)[0])
    turned = np.roll(hole, -start, axis=1)
    look = [scale.mm(most) / size for most, size in zip(ONE_LOOK_OF_RADIUS, scale.cell_mm, strict=True)]  # cells
    left = [(slice(0, turned.shape[0]), slice(0, turned.shape[1]))]
    while left:
        box = left.pop()
        if not turned[box].any():
            continue
        ((rows, columns),) = ndimage.find_objects(turned[box].astype(np.int8))
        rows, columns = (
            slice(was.start + now.start, was.start + now.stop) for was, now in zip(box, (rows, columns), strict=True)
        )
        lengths = [(one.stop - one.start) / most for one, most in zip((rows, columns), look, strict=True)]
        if max(lengths) <= 1.0 or turned[rows, columns].mean() >= FILLED:
            part = np.zeros((rows.stop - rows.start, turned.shape[1]), bool)
            part[:, columns] = turned[rows, columns]
            yield rows, np.roll(part, start, axis=1)
        elif lengths[0] > lengths[1]:
            middle = (rows.start + rows.stop) // 2
            left += [(slice(rows.start, middle), columns), (slice(middle, rows.stop), columns)]
        else:
            middle = (columns.start + columns.stop) // 2
            left += [(rows, slice(columns.start, middle)), (rows, slice(middle, columns.stop))]


def _passed(wall: Wall, looks: Looks, scale: Scale) -> tuple[FloatArray, BoolArray, BoolArray]:
    """(Z, A) how many looks pass there; whether most that pass no farther away than the map is bridged over are in
    columns that are dark all along the scan; whether a ring's light reached it in any other, and did not come back."""
    shape = wall.radius_mm.shape
    row = np.floor((looks.z_mm - wall.extent[0]) / wall.z_step_mm)
    inside = (row >= 0) & (row < shape[0])
    sure = np.asarray(looks.lit.any(axis=1))[:, None]  # of the others it is not known where they ran
    column = np.broadcast_to(np.arange(COLUMNS) * shape[1] // COLUMNS, row.shape)

    def count(which: BoolArray) -> FloatArray:
        at = row[which].astype(np.intp) * shape[1] + column[which]
        return np.bincount(at, minlength=shape[0] * shape[1]).reshape(shape).astype(np.float64)

    rows = 2 * round(scale.mm(BRIDGE_OF_RADIUS) / wall.z_step_mm) + 1
    every, hidden = count(inside & sure), count(inside & sure & ~looks.lit)
    near, dark = (ndimage.uniform_filter1d(one, rows, axis=0, mode="constant") for one in (every, hidden))
    return (
        every,
        dark > MOSTLY * np.maximum(near, 1e-9),
        count(inside & looks.lit & ~np.isfinite(looks.departure_mm)) > 0,
    )
