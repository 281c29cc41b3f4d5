"""The head in three dimensions: three sectors, each a pair of electrodes, in a pipe that a bore crosses.

The circuit is `field`'s, each sector's pair driven at +1/2 V and -1/2 V while the others are held at earth. What a
sector loses to a bore is told as the change from the same head on the same grid in the same soil, so that what the grid
does not resolve falls out. Where the bore's wall cuts elements, these take its share of their points.
"""

from dataclasses import dataclass, replace

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.wings.crossbore.measure.elements import ElementMesh, grid_of, solve
from annulus_pipe.wings.crossbore.measure.field import (
    AIR,
    FAR_MM,
    ON_MM,
    SECTORS,
    CrossSection,
    StraightBore,
    check,
    electrodes,
    facing,
    filled,
    layers,
    moved,
    rings,
    stations,
    turn,
)

HALF_MM = 110.0  # of the pipe that is modelled, either way


@dataclass(frozen=True, slots=True)
class Bored:
    """(3,) of the sectors: differential readings, pF, and conductance / omega, fF. nodes : of the grid."""

    pf: FloatArray
    loss_ff: FloatArray
    nodes: int


def bored(case: CrossSection) -> Bored:
    """Differential readings of all sectors, the bore's place along the pipe being its own. `fine` 1 takes some seconds.
    AnnulusError of a head outside its pipe, or where iterations do not converge."""
    check(case)
    return _read(case, *_head(case))


def changes(case: CrossSection, bores: list[StraightBore | None]) -> tuple[FloatArray, FloatArray]:
    """(bores, 3) fF and fF of loss that each changes the sectors by, from the same head with no bore."""
    check(case)
    head = _head(case)
    plain, *found = [_read(replace(case, bore=bore), *head) for bore in (None, *bores)]
    return (
        np.array([1000 * (one.pf - plain.pf) for one in found]),
        np.array([one.loss_ff - plain.loss_ff for one in found]),
    )


def _read(case: CrossSection, grid: ElementMesh, conductors: list[BoolArray], far: BoolArray) -> Bored:
    drives = np.zeros((SECTORS, len(conductors)))
    for k in range(SECTORS):
        drives[k, 4 * k : 4 * k + 2] = 0.5, -0.5
        drives[k, 4 * k + 2 : 4 * k + 4] = 0.5 * case.shield, -0.5 * case.shield
    eps = layers(case.head, case.pipe, filled(case.bore, case.soil))
    found = solve(grid, eps, conductors, far, drives.tolist())
    both = np.array([(found.pf[k, 4 * k] - found.pf[k, 4 * k + 1]) / 2 for k in range(SECTORS)])
    return Bored(both.real, -1000 * both.imag, len(grid.axes))


def _head(case: CrossSection) -> tuple[ElementMesh, list[BoolArray], BoolArray]:
    head, pipe = case.head, case.pipe
    axes = [
        rings(head, pipe, 0.6 * case.fine),
        turn(head, case.roll_deg, 12.0 / case.fine, 2.5 / case.fine),
        stations(head, HALF_MM, 4.0, 0.5 * case.fine),
    ]
    grid = grid_of(axes, "rpz", moved(head, pipe, case.off_mm))
    rho, _, z = grid.axes.T
    front, back = np.abs(rho - head.radius_mm) < ON_MM, rho < rho.min() + ON_MM
    plates, shields = electrodes(z, head)
    conductors = [
        face & side & one
        for side in facing(grid.axes, head, case.roll_deg)
        for face, ends in ((front, plates), (back, shields))
        for one in ends
    ]
    body = back & (np.abs(z) > head.apart_mm / 2 + head.electrode_mm + head.overlap_mm + ON_MM)
    return grid, conductors, (rho > FAR_MM - ON_MM) | (np.abs(z) > HALF_MM - ON_MM) | body


def source_cases(radius_mm: float, outer_mm: float, fill: complex = AIR) -> dict[str, StraightBore]:
    """The source's three: the pipe through a bore's middle, half in it, and 10 and 50 mm clear of it."""
    return {
        "through": StraightBore(fill, radius_mm, 0.0),
        "half": StraightBore(fill, radius_mm, radius_mm),
        "10 mm clear": StraightBore(fill, radius_mm, radius_mm + outer_mm + 10),
        "50 mm clear": StraightBore(fill, radius_mm, radius_mm + outer_mm + 50),
    }
