"""One defect from close by: the line across the pipe at its deepest station, and the line along the pipe through it.

Both are cut from the field that its depth was measured from, so that the picture and the list say one number.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.wall.defects import Defect, Kind
from annulus_pipe.wall.grid import Wall, WallObservations, smooth
from annulus_pipe.wall.survey import Survey

MOST = 20  # defects that are shown from close by: a page of 200 is read by nobody
AROUND_OF_RADIUS = 0.6  # of the radius: what is shown along the pipe either side of a defect
ALIKE = 0.05  # part of a depth, by which cells may differ from it and still be its floor; test_sections


@dataclass(frozen=True, slots=True, eq=False)
class DefectSection:
    """Of one defect, departures in mm from the mean circle about the pipe's own centre, outwards positive.

    index : of the survey's defects. z_mm, clock_deg : where both lines cross, the middle of the deepest that is sure.
    across (A,) over clock_deg of the wall, across_k2 (A,) its expanded uncertainty, datum (A,) the pipe's own shape,
    which depths are measured from; along (M,), along_k2, along_datum over along_z (M,) mm. NaN where not seen.
    nominal : the calibrated radius less the mean one. departs : the departure from the datum where the lines cross.
    """

    index: int
    z_mm: float
    clock_deg: float
    mean_radius_mm: float
    across: FloatArray
    across_k2: FloatArray
    datum: FloatArray
    along_z: FloatArray
    along: FloatArray
    along_k2: FloatArray
    along_datum: FloatArray
    nominal: float
    departs: float


def worth_showing(defects: Sequence[Defect], most: int = MOST, first: Sequence[int] = ()) -> tuple[int, ...]:
    """Indices of the defects that are shown from close by, rising: those named first, then the deepest."""
    deepest = sorted(range(len(defects)), key=lambda i: -_depth(defects[i]))
    return tuple(sorted(list(dict.fromkeys([*first, *deepest]))[:most]))


def cut(survey: Survey, indices: Sequence[int]) -> tuple[DefectSection, ...]:
    """Sections of some of the survey's defects; of one that was seen nowhere there is none."""
    out = []
    for index in indices:
        defect = survey.defects[index]
        rows = _around(survey, defect, index)
        wall = _stretch(survey.wall, rows)
        field = smooth(wall.weighed_residual_mm()).astype(np.float64)  # as find_defects measures depths
        place = _crossing(wall, defect, survey.detection.label[rows] == index + 1, field)
        if place is None:
            continue
        row, column = place
        turn = np.radians(wall.clock_deg)
        circle = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)
        shape = wall.shape_radius_mm().astype(np.float64)
        parts = (wall.sigma_mm, wall.cell_noise_mm, wall.shape_sigma_mm())
        k2 = 2.0 * np.linalg.norm([part.astype(np.float64) for part in parts], axis=0)
        datum = shape[row] - circle @ wall.shape_mm[row, :3]
        along_datum = shape[:, column] - wall.shape_mm[:, :3] @ circle[column]
        mean = float(wall.shape_mm[row, 0])
        out.append(
            DefectSection(
                index,
                float(wall.z_mm[row]),
                float(wall.clock_deg[column]),
                mean,
                field[row] + datum,
                k2[row],
                datum,
                wall.z_mm,
                field[:, column] + along_datum,
                k2[:, column],
                along_datum,
                survey.nominal_diameter_mm / 2 - mean,
                float(field[row, column]),
            )
        )
    return tuple(out)


def _stretch(wall: Wall, rows: slice) -> Wall:
    """A part of the wall's rows, with its observations: a long pipe has twenty defects shown, and is not gone through
    for them."""
    seen, columns = wall.observations, len(wall.clock_deg)
    mine = (seen.cell >= rows.start * columns) & (seen.cell < rows.stop * columns)
    return Wall(
        wall.z_mm[rows],
        wall.clock_deg,
        wall.radius_mm[rows],
        wall.count[rows],
        wall.shape_mm[rows],
        wall.shape_covariance[rows],
        wall.noise_mm[rows],
        wall.cell_noise_mm[rows],
        WallObservations(
            seen.cell[mine] - rows.start * columns,
            seen.number[mine],
            seen.radius_mm[mine],
            seen.sigma_mm[mine],
            seen.seen_by[mine],
        ),
        wall.sigma_mm[rows],
    )


def _crossing(wall: Wall, defect: Defect, mine: BoolArray, field: FloatArray) -> tuple[int, int] | None:
    """Row and column of the cell that shows best how deep a defect is; `mine` are its cells."""
    if defect.kind is Kind.OVALITY:
        inside = np.flatnonzero((wall.z_mm >= defect.z_range_mm[0]) & (wall.z_mm <= defect.z_range_mm[1]))
        if not len(inside):
            return None
        swing = 2.0 * np.hypot(wall.shape_mm[inside, 3], wall.shape_mm[inside, 4])
        row = int(inside[np.argmin(np.abs(swing - defect.depth_mm))])
        away = np.abs((wall.clock_deg - defect.clock_deg + 90.0) % 180.0 - 90.0)
        seen = np.isfinite(field[row])
        return (row, int(np.argmin(np.where(seen, away, np.inf)))) if seen.any() else None
    height = (1.0 if defect.kind is Kind.LOSS else -1.0) * field
    cells = mine & np.isfinite(height)
    if not cells.any():
        return None
    off = np.abs(height - defect.depth_mm)
    floor: BoolArray = cells & (off <= max(ALIKE * defect.depth_mm, float(off[cells].min())))
    rows, columns = np.nonzero(floor)
    aside = (wall.clock_deg[columns] - defect.clock_deg + 180.0) % 360.0 - 180.0
    z, s = wall.z_mm[rows], np.radians(aside) * wall.mean_radius_mm
    middle = int(np.argmin((z - np.median(z)) ** 2 + (s - np.median(s)) ** 2))
    return int(rows[middle]), int(columns[middle])


def _around(survey: Survey, defect: Defect, index: int) -> slice:
    """Rows of a defect, its cells' at least, and of as much before and behind it as is shown."""
    wall = survey.wall
    reach = AROUND_OF_RADIUS * wall.mean_radius_mm
    low, high = defect.z_range_mm
    first, last = np.searchsorted(wall.z_mm, (low - reach, high + reach))
    mine = np.flatnonzero((survey.detection.label == index + 1).any(axis=1))
    if len(mine):
        first, last = min(first, mine[0]), max(last, mine[-1] + 1)
    first = min(max(int(first), 0), len(wall.z_mm) - 2)
    return slice(first, min(max(int(last), first + 2), len(wall.z_mm)))


def _depth(defect: Defect) -> float:
    return defect.depth_mm / (2.0 if defect.kind is Kind.OVALITY else 1.0)
