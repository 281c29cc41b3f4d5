"""One defect from close by: the line across the pipe at its deepest station, and the line along the pipe through it.

Both are cut from the field that its depth was measured from, so that the picture and the list say one number.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from annulus.numeric.arrays import BoolArray, FloatArray
from annulus.wall.defects import Defect, Kind
from annulus.wall.grid import smooth
from annulus.wall.survey import Survey

MOST = 20  # defects that are shown from close by: a page of 200 is read by nobody
AROUND_OF_RADIUS = 0.6  # of the radius: what is shown along the pipe either side of a defect
ALIKE = 0.05  # part of a depth, by which cells may differ from it and still be its floor; test_sections


@dataclass(frozen=True, slots=True, eq=False)
class Section:
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


def cut(survey: Survey, indices: Sequence[int]) -> tuple[Section, ...]:
    """Sections of some of the survey's defects; of one that was seen nowhere there is none."""
    if not indices:
        return ()
    wall = survey.wall
    field = smooth(wall.weighed_residual_mm()).astype(np.float64)  # as find_defects measures depths
    k2 = 2.0 * np.sqrt(
        wall.sigma_mm.astype(np.float64) ** 2 + wall.cell_noise_mm.astype(np.float64) ** 2
        + np.square(wall.shape_sigma_mm(), dtype=np.float64)
    )  # fmt: skip
    shape = wall.shape_radius_mm().astype(np.float64)
    turn = np.radians(wall.clock_deg)
    circle = np.stack([np.ones_like(turn), np.cos(turn), np.sin(turn)], axis=1)
    out = []
    for index in indices:
        defect = survey.defects[index]
        place = _crossing(survey, index, field)
        if place is None:
            continue
        row, column = place
        datum = shape[row] - circle @ wall.shape_mm[row, :3]
        rows = _around(survey, defect, row)
        along_datum = shape[rows, column] - wall.shape_mm[rows, :3] @ circle[column]
        mean = float(wall.shape_mm[row, 0])
        out.append(
            Section(
                index, float(wall.z_mm[row]), float(wall.clock_deg[column]), mean, field[row] + datum, k2[row], datum,
                wall.z_mm[rows], field[rows, column] + along_datum, k2[rows, column], along_datum,
                survey.nominal_diameter_mm / 2 - mean, float(field[row, column]),
            )
        )  # fmt: skip
    return tuple(out)


def _crossing(survey: Survey, index: int, field: FloatArray) -> tuple[int, int] | None:
    """Row and column of the cell that shows best how deep a defect is."""
    wall, defect = survey.wall, survey.defects[index]
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
    cells = (survey.detection.label == index + 1) & np.isfinite(height)
    if not cells.any():
        return None
    off = np.abs(height - defect.depth_mm)
    floor: BoolArray = cells & (off <= max(ALIKE * defect.depth_mm, float(off[cells].min())))
    rows, columns = np.nonzero(floor)
    aside = (wall.clock_deg[columns] - defect.clock_deg + 180.0) % 360.0 - 180.0
    z, s = wall.z_mm[rows], np.radians(aside) * wall.mean_radius_mm
    middle = int(np.argmin((z - np.median(z)) ** 2 + (s - np.median(s)) ** 2))
    return int(rows[middle]), int(columns[middle])


def _around(survey: Survey, defect: Defect, row: int) -> slice:
    wall = survey.wall
    reach = AROUND_OF_RADIUS * wall.mean_radius_mm
    low, high = defect.z_range_mm
    first, last = np.searchsorted(wall.z_mm, (low - reach, high + reach))
    return slice(min(int(first), row), max(int(last), row + 1))


def _depth(defect: Defect) -> float:
    return defect.depth_mm / (2.0 if defect.kind is Kind.OVALITY else 1.0)
