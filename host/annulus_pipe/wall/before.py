"""What stands between the head and the wall: a cable across the bore, a hose along it. Told by the light it takes.

Light that came back went free from the projector to the wall, and from there to the camera: nothing stands on either
way. Light that did not was stopped somewhere on one of them. A hole, a stain or a step stops it at the wall, where it
stays as the head goes on; a rod stops it beside the head, and goes along. What stands in the bore stops it at one place
of the bore, and its shadow runs along the wall ahead of the head.

Assumed: looks know where every ring's light passes (`looks`), and the wall's own openings, levels and joints are known.
What carries it: a place of the bore where nearly all light that would pass was stopped, that of several rings and in
several frames. When it breaks: an object that stands nearer to the wall than OUTERMOST, or that few frames look at, is
unseen wall; what is before the head all along the scan is a rod.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import BoolArray, FloatArray, LabelArray, arc_of
from annulus_pipe.numeric.rounding import DISTANCE, clock_face, span
from annulus_pipe.vocabulary import Finding
from annulus_pipe.wall.grid import Wall
from annulus_pipe.wall.looks import COLUMNS, Looks, dark_columns
from annulus_pipe.wall.lost import OBJECT
from annulus_pipe.wall.patches import label_around
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.shape import harmonics
from annulus_pipe.wall.unjudged import Unjudged

# Held both ways by tests/regression/cable_across_the_bore_unsaid.
SECTORS = 60  # round the clock
INNERMOST = 0.34  # of the radius: where shells begin that are asked for an object: farther inside is the head
OUTERMOST = 0.84  # of the radius, where they end: nearer to the wall are beads, rims and bumps
SHELL = 0.04  # of the radius, from one shell to the next
CELL_OF_RADIUS = 0.05  # along the pipe: half of a thin cable's thickness
STOPPED = 0.8  # part of the light through a cell that was stopped ..
LEAST = 2.0  # .. of so many looks: a stray one is a misread stripe
INSIDE = 0.1  # of the radius: what came back from farther inside did not come from the wall
# of an object: cables and hoses take up 250 to 600; a tee that reaches far in has 100, misread stripes leave 30
CELLS_LEAST = 160
RINGS_LEAST = 4  # a ring that fails is no object ..
FRAMES_LEAST = 5  # .. nor is one that is lost for a few frames
BEYOND = 0.25  # of the radius: so far from its places that were seen a ring's line is believed
SPENT = 0.1  # of a sector's light that must be gone before a look counts for the object's frames


@dataclass(frozen=True, slots=True)
class Standing:
    """One object: it stands somewhere between two places along the pipe, mm, the latter the last of the wall that it
    hides; the clock it takes up, degrees; the frames whose light it stops."""

    z_from_mm: float
    z_to_mm: float
    clock_deg: float
    arc_deg: float
    frames: tuple[int, ...]

    @property
    def finding(self) -> Finding:
        where = span(self.z_from_mm, self.z_to_mm, DISTANCE)
        clock = " to ".join(clock_face(self.clock_deg + side * self.arc_deg / 2) for side in (-1, 1))
        text = (
            f"something stands in the bore before the wall, somewhere in {where}, clock {clock}: a cable, a hose or "
            f"the like. It stops the light of {len(self.frames)} frames, and the wall behind it is not judged"
        )
        return Finding(OBJECT, text, self.frames)

    @property
    def place(self) -> Unjudged:
        """What of the wall it leaves open."""
        return Unjudged(
            ("loss", "bump", "deposit", "bore"),
            "something stands before the wall there: not established",
            self.z_from_mm,
            self.z_to_mm,
            self.clock_deg,
            self.arc_deg,
        )


def find_objects(
    wall: Wall, profiles: Sequence[Profile], calibration: Calibration, looks: Looks, explained: BoolArray
) -> tuple[Standing, ...]:
    """Every object, in order of distance.

    Parameters
    ----------
    profiles, looks : aligned profiles and their `looks_of`. explained : (Z, A) cells of joints, openings and levels:
        light is lost there for reasons of their own.
    """
    if calibration.kind == "line":
        return ()  # a bright line breaks off at an object, and its frames report that themselves (rings/objects.py)
    used = [p for p in profiles if p.pose is not None and len(p.points_mm)]
    rings = len(calibration.rings)
    free, gone = _light(wall, used, looks, explained, rings)
    if gone.sum() < LEAST:
        return ()
    cells = _Cells.of(wall, used, calibration, looks)
    stopped, passed = cells.count(gone), cells.count(free)
    taken = (stopped >= LEAST) & (stopped >= STOPPED * (stopped + passed))
    label, n = label_around(np.asarray(taken.any(axis=0)))
    found = (_object(label, i, taken, gone, cells, used, looks) for i in range(1, n + 1))
    return tuple(sorted((one for one in found if one is not None), key=lambda one: one.z_from_mm))


def _light(
    wall: Wall, used: Sequence[Profile], looks: Looks, explained: BoolArray, rings: int
) -> tuple[FloatArray, FloatArray]:
    """(L, SECTORS) part of a sector in which a look's light came back from the wall, and in which it did not, though
    that ring's usually does there."""
    turned = np.array([math.degrees(p.pose.roll or 0.0) if p.pose is not None else 0.0 for p in used])
    came = np.isfinite(looks.departure_mm)
    lit = looks.lit.copy()
    for k in range(rings):  # a ring that is too dim on one side all along the scan is not stopped there
        mine = slice(k, None, rings)
        lit[mine] &= ~dark_columns(came[mine], np.asarray(looks.lit[mine].any(axis=1)), turned)
    back = lit & came & (looks.departure_mm > -INSIDE * wall.mean_radius_mm)
    low, high = (f(np.where(back, looks.z_mm, empty), axis=1) for f, empty in ((np.min, np.inf), (np.max, -np.inf)))
    beyond = BEYOND * wall.mean_radius_mm  # farther from where it was seen a ring's line is a guess
    lit &= (looks.z_mm > (low - beyond)[:, None]) & (looks.z_mm < (high + beyond)[:, None])
    row = np.clip(np.floor((looks.z_mm - wall.extent[0]) / wall.z_step_mm), 0, len(wall.z_mm) - 1).astype(np.intp)
    lit &= ~explained[row, np.broadcast_to(np.arange(COLUMNS) * explained.shape[1] // COLUMNS, row.shape)]
    parts = (len(row), SECTORS, COLUMNS // SECTORS)
    return (lit & back).reshape(parts).mean(axis=2), (lit & ~back).reshape(parts).mean(axis=2)


@dataclass(frozen=True, slots=True)
class _Cells:
    """Cells of the bore, (shell, along, sector): which of them each look's light goes through. at : for the camera,
    where it is one point, and the projector, for every shell, (L, SECTORS) the cell's number in its shell, -1 outside.
    """

    first_mm: float
    step_mm: float
    rows: int
    at: tuple[tuple[NDArray[np.int32], ...], ...]

    @classmethod
    def of(cls, wall: Wall, used: Sequence[Profile], calibration: Calibration, looks: Looks) -> "_Cells":
        size, rings = wall.mean_radius_mm, len(calibration.rings)
        vertex = np.array([cone.vertex_mm for cone in calibration.rings])
        ways = (0, 1) if len(calibration.cameras) == 1 and calibration.camera.central else (1,)  # else rays start apart
        starts = [
            (p.pose.to_pipe(np.zeros((rings, 3)), p.z_mm), p.pose.to_pipe(vertex, p.z_mm))
            for p in used
            if p.pose is not None
        ]
        middle = (np.arange(SECTORS) + 0.5) * 360.0 / SECTORS
        z = looks.z_mm.reshape(len(looks.z_mm), SECTORS, -1).mean(axis=2)
        shape = np.stack([np.interp(z, wall.z_mm, column) for column in wall.shape_mm.T], axis=-1)
        radius = (shape * harmonics(middle)).sum(axis=-1)
        x, y = np.sin(np.radians(middle)), -np.cos(np.radians(middle))
        met = np.stack([radius * x, radius * y, z], axis=-1)
        first, step = wall.extent[0] - size, CELL_OF_RADIUS * size
        rows = math.ceil((wall.extent[1] - first) / step)
        at = []
        for which in ways:
            start = np.concatenate([one[which] for one in starts])[:, None, :]
            aside = start[..., 0] * x + start[..., 1] * y
            mine = []
            for shell in size * np.arange(INNERMOST, OUTERMOST, SHELL):
                part = (shell - aside) / (radius - aside)
                place = start + part[..., None] * (met - start)
                turn = np.degrees(np.arctan2(place[..., 0], -place[..., 1])) % 360.0
                row = np.floor((place[..., 2] - first) / step)
                inside = (part > 0) & (row >= 0) & (row < rows)
                cell = row * SECTORS + np.floor(turn * SECTORS / 360.0) % SECTORS
                mine.append(np.where(inside, cell, -1).astype(np.int32))
            at.append(tuple(mine))
        return cls(first, step, rows, tuple(at))

    def count(self, weight: FloatArray) -> FloatArray:
        """(shell, along, sector) looks whose light goes through each cell, by weight."""
        out = np.zeros((len(self.at[0]), self.rows * SECTORS))
        for mine in self.at:
            for cell, shell in zip(mine, out, strict=True):
                inside = cell >= 0
                shell += np.bincount(cell[inside], weight[inside], len(shell))
        return out.reshape(len(out), self.rows, SECTORS)

    def through(self, some: BoolArray) -> BoolArray:
        """(L, SECTORS) whether a look's light goes through one of some cells."""
        found = np.zeros(self.at[0][0].shape, bool)
        for mine in self.at:
            for cell, shell in zip(mine, some.reshape(len(some), -1), strict=True):
                found |= (cell >= 0) & shell[cell]
        return found


def _object(
    label: LabelArray,
    number: int,
    taken: BoolArray,
    gone: FloatArray,
    cells: _Cells,
    used: Sequence[Profile],
    looks: Looks,
) -> Standing | None:
    """What one part of the bore holds; None where too little light tells of it."""
    mine = taken & (label == number)
    if np.count_nonzero(mine) < CELLS_LEAST:
        return None
    rings = len(gone) // len(used)
    lost = cells.through(mine) & (gone >= SPENT)
    look = np.flatnonzero(lost.sum(axis=1) > 0)
    frames = np.unique(look // rings)
    if len(np.unique(look % rings)) < RINGS_LEAST or len(frames) < FRAMES_LEAST:
        return None
    first = cells.first_mm + int(np.flatnonzero(mine.any(axis=(0, 2)))[0]) * cells.step_mm
    start, arc = arc_of(mine.any(axis=(0, 1)), 360.0 / SECTORS)
    z = looks.z_mm.reshape(*lost.shape, -1).mean(axis=2)[lost]
    last = min(float(z.max()), cells.first_mm + cells.rows * cells.step_mm)
    return Standing(first, last, (start + arc / 2) % 360.0, arc, tuple(used[i].frame for i in frames))
