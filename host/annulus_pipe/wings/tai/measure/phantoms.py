"""Samples with known truth, as parts with edges, drawn on any grid to a fraction of a cell."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.field import SoundGrid

FINE = 4  # sub-cells each way where an edge crosses. Unguarded by itself; topic imaging draws its truth with it


@dataclass(frozen=True, slots=True)
class Disc:
    x_mm: float
    y_mm: float
    radius_mm: float
    value: float  # absorbed power density relative to the sample's strongest; replaces what lies below

    def inside(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        return np.asarray(np.hypot(x - self.x_mm, y - self.y_mm) < self.radius_mm)


@dataclass(frozen=True, slots=True)
class Box:
    x_mm: float
    y_mm: float
    width_mm: float
    height_mm: float
    value: float

    def inside(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.bool_]:
        across, along = np.abs(x - self.x_mm) < self.width_mm / 2, np.abs(y - self.y_mm) < self.height_mm / 2
        return np.asarray(across & along)


Part = Disc | Box

PHANTOMS: Mapping[str, tuple[Part, ...]] = {
    # cheese with three agar cores (§8.4); agar holds more water and takes more power
    "inclusions": (
        Disc(0.0, 0.0, 14.0, 0.35),
        Disc(-4.5, -3.5, 3.0, 1.0),
        Disc(5.5, -1.0, 2.0, 1.0),
        Disc(0.5, 6.5, 1.5, 0.8),
    ),
    "core": (Disc(0.0, 0.0, 14.0, 0.35), Disc(1.0, 0.0, 5.0, 1.0)),  # one agar core of 10 mm (Fig. 8.7)
    "wires": (Disc(0.0, 0.0, 13.65, 0.25), Disc(-5.0, 0.0, 0.3, 1.0), Disc(5.0, 0.0, 0.3, 1.0)),  # Fig. 8.13
    "shapes": (Disc(-4.0, 0.0, 1.0, 1.0), Box(0.0, 0.0, 2.0, 2.0, 1.0), Box(4.5, 0.0, 1.5, 3.0, 1.0)),  # Fig. 7.5
}


def phantom(name: str) -> tuple[Part, ...]:
    if name not in PHANTOMS:
        raise AnnulusError(f"phantom {name!r}: expected one of {', '.join(PHANTOMS)}")
    return PHANTOMS[name]


def draw(parts: tuple[Part, ...], grid: SoundGrid, shift_mm: tuple[float, float] = (0.0, 0.0)) -> NDArray[np.float64]:
    """(ny, nx) mean of each cell; the grid's centre stands at `shift_mm` of the sample."""
    sub = ((np.arange(FINE) + 0.5) / FINE - 0.5) * grid.dx_mm
    total = np.zeros(grid.shape)
    for dy in sub:
        for dx in sub:
            y, x = np.meshgrid(grid.y_mm + shift_mm[1] + dy, grid.x_mm + shift_mm[0] + dx, indexing="ij")
            layer = np.zeros(grid.shape)
            for part in parts:
                layer[part.inside(x, y)] = part.value
            total += layer
    return total / FINE**2


def reach_mm(parts: tuple[Part, ...]) -> float:
    """Radius of the circle about the origin that holds the sample."""
    return max(
        float(np.hypot(part.x_mm, part.y_mm))
        + (part.radius_mm if isinstance(part, Disc) else float(np.hypot(part.width_mm, part.height_mm)) / 2)
        for part in parts
    )


def smallest_mm(parts: tuple[Part, ...]) -> float:
    """The narrowest part's width: what stress must not leave during a pulse."""
    return min(2 * p.radius_mm if isinstance(p, Disc) else min(p.width_mm, p.height_mm) for p in parts)
