"""The field of a capacitive head in a buried pipe, across the pipe and along it, and the circuit that reads it.

Chapter 10 of the source: three sectors on a 2.4-inch head in a 3-inch pipe, read at 6.5 MHz. A sector is a pair of
electrodes, one behind the other along the pipe, driven against each other (+1/2 V, -1/2 V). The field goes from one
through gap, wall and soil to the other, so the reading rises from air to soil as in Figure 10.5. Driven alone and
sensed at the other, the pair's mutual capacitance has the other sign: soil is a third conductor that leads the charge
to earth. `CrossSection` cuts across one electrode, whose way back is earth; `Along` cuts along a head that is one
sector all round, and its reading is scaled to a sector's angle. A head off the axis and a bore that comes from the side
need both cuts at once: `bored`. What the source does not say (lengths of the electrodes, their carrier) was chosen to
meet what a prototype's field said; `HeadGeometry` says which.

    across = sectors(CrossSection(soil=permittivity(20)))
    pair = along(Along(inside=AIR, from_mm=-38, to_mm=38))
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, ComplexArray, FloatArray
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.crossbore.measure.elements import ElectrodeField, graded, grid_of, permittivity, polar, solve

AIR = complex(1.0)
PE = complex(2.25)
SOIL = permittivity(20.0)  # of the source; wet soil's sigma comes with its case
WATER = permittivity(80.0, 0.03)
FAR_MM = 160.0  # earth: from here on the field of a pair, which falls by e each 5 mm, is nothing
SECTORS = 3
EDGE_MM = 0.3  # beside an electrode's edge: halved, no reading moves by 1 % (tests/wings/crossbore)
ON_MM = 1e-6


@dataclass(frozen=True, slots=True)
class HeadGeometry:
    """radius, sector: the source's and the logs'. electrode (length) and apart (between the two of a pair): the source
    gives neither; of 18 pairs of lengths this one comes nearest to all that a prototype's field said (243 fF through a
    bore, half and beside it, depth, lift-off), which it therefore does not confirm. carrier: of glass epoxy, the shield
    behind it, which stands out past the electrode by overlap."""

    radius_mm: float = 30.5
    sector_deg: float = 110.0
    electrode_mm: float = 30.0
    apart_mm: float = 12.0
    carrier_mm: float = 1.6
    carrier_eps: float = 4.4
    overlap_mm: float = 1.0

    def __post_init__(self) -> None:
        if not 0 < self.sector_deg < 360 / SECTORS:
            raise AnnulusError(f"sectors of {self.sector_deg:g} deg, expected less than {360 // SECTORS}")
        if not 0 < self.carrier_mm < self.radius_mm:
            raise AnnulusError(f"carrier of {self.carrier_mm:g} mm on a radius of {self.radius_mm:g} mm, expected less")
        if self.electrode_mm <= 0 or self.apart_mm <= 0 or not 0 <= self.overlap_mm < self.apart_mm / 2:
            raise AnnulusError(
                f"electrodes of {self.electrode_mm:g} mm, {self.apart_mm:g} mm apart, shield {self.overlap_mm:g} mm "
                "past them: expected lengths above 0 and shields that do not touch"
            )


@dataclass(frozen=True, slots=True)
class Pipe:
    """3 inches, SDR 11."""

    inner_mm: float = 36.37
    outer_mm: float = 44.45
    eps: complex = PE


@dataclass(frozen=True, slots=True)
class StraightBore:
    """A straight bore that crosses the pipe at right angles. offset : from the pipe's axis to its own, towards phi
    (atan2(y, x), y down: 90 is the invert); along : place of its axis along the pipe, from the head's middle."""

    fill: complex = AIR
    radius_mm: float = 76.0
    offset_mm: float = 0.0
    phi_deg: float = 90.0
    along_mm: float = 0.0


@dataclass(frozen=True, slots=True)
class CrossSection:
    """soil : where no bore is. off : head's axis from the pipe's, mm. Sector k looks at 120 k + roll."""

    soil: complex = SOIL
    bore: StraightBore | None = None
    off_mm: tuple[float, float] = (0.0, 0.0)
    roll_deg: float = 0.0
    shield: bool = True
    head: HeadGeometry = field(default_factory=HeadGeometry)
    pipe: Pipe = field(default_factory=Pipe)
    fine: float = 1.0


@dataclass(frozen=True, slots=True)
class Readings:
    """Of each sector in turn, the others at earth. pf : its charge a volt, over the electrode's length; loss_ff :
    conductance / omega. mutual_pf : (3, 3) what the sectors sense of the one driven, 0 on the diagonal."""

    pf: FloatArray
    loss_ff: FloatArray
    mutual_pf: FloatArray
    pf_per_m: FloatArray
    field: ElectrodeField


@dataclass(frozen=True, slots=True)
class Along:
    """inside : what lies from from_mm to to_mm along the pipe and up to depth_mm from its wall; outside : the rest.
    z from the middle of the pair."""

    inside: complex = SOIL
    outside: complex = SOIL
    from_mm: float = -np.inf
    to_mm: float = np.inf
    depth_mm: float = np.inf
    shield: bool = True
    head: HeadGeometry = field(default_factory=HeadGeometry)
    pipe: Pipe = field(default_factory=Pipe)
    fine: float = 1.0


@dataclass(frozen=True, slots=True)
class Pair:
    """A pair all round, scaled to one sector's angle. differential : charge of one at +1/2 V, the other at -1/2 V;
    mutual : charge sensed at the second, held at 0, of the first at 1 V; single : of the first itself."""

    differential_pf: float
    loss_ff: float
    mutual_pf: float
    single_pf: float
    field: ElectrodeField


def check(case: CrossSection | Along) -> None:
    """AnnulusError where the head is not inside the pipe or the shape is none."""
    head, pipe = case.head, case.pipe
    if not case.fine > 0:
        raise AnnulusError(f"fineness {case.fine:g}, expected above 0")
    off = float(np.hypot(*case.off_mm)) if isinstance(case, CrossSection) else 0.0
    if isinstance(case, Along) and not (case.depth_mm > 0 and case.from_mm < case.to_mm):
        raise AnnulusError(
            f"medium from {case.from_mm:g} to {case.to_mm:g} mm, {case.depth_mm:g} mm deep: expected lengths above 0"
        )
    if not head.radius_mm + off < pipe.inner_mm < pipe.outer_mm < FAR_MM:
        raise AnnulusError(
            f"head of {head.radius_mm:g} mm, {off:g} mm off the axis, pipe of {pipe.inner_mm:g}..{pipe.outer_mm:g} mm: "
            f"expected the head inside the pipe and the pipe inside {FAR_MM:g} mm"
        )


def rings(head: HeadGeometry, pipe: Pipe, fine: float, depth_mm: float = np.inf) -> FloatArray:
    """rho of nodes: shield, electrodes, wall, a layer of that depth if there is one, soil."""
    marks = [head.radius_mm - head.carrier_mm, head.radius_mm, pipe.inner_mm, pipe.outer_mm, FAR_MM]
    steps = [0.8 / fine, 1.5 / fine, 2.0 / fine, 12.0 / fine]
    if 0 < depth_mm < (FAR_MM - pipe.outer_mm) / 2:
        marks.insert(4, pipe.outer_mm + depth_mm)
        steps.insert(3, 2.0 / fine)
    return graded(marks, steps, EDGE_MM / fine)


def turn(head: HeadGeometry, roll_deg: float, step_deg: float, smallest_deg: float) -> FloatArray:
    """phi of nodes, rad, over one turn, with every edge of a sector among them."""
    edges = [120 * k + side * head.sector_deg / 2 for k in range(SECTORS) for side in (-1, 1)]
    marks = [0.0, *sorted(edge % 360 for edge in edges), 360.0]
    return np.radians(roll_deg + graded(marks, [step_deg] * (len(marks) - 1), smallest_deg))


def moved(head: HeadGeometry, pipe: Pipe, off_mm: tuple[float, float]) -> Callable[[FloatArray], FloatArray]:
    """Nodes of a head off the axis: the head moves as a whole, the pipe stays, and the gap's nodes move the more the
    nearer they are to the head."""

    def place(own: FloatArray) -> FloatArray:
        out = polar(own)
        gap = pipe.inner_mm - head.radius_mm
        out[:, :2] += np.clip((pipe.inner_mm - own[:, :1]) / gap, 0, 1) * np.asarray(off_mm)
        return out

    return place


def layers(
    head: HeadGeometry, pipe: Pipe, outside: Callable[[FloatArray], ComplexArray]
) -> Callable[[FloatArray, FloatArray], ComplexArray]:
    def eps(middle: FloatArray, points: FloatArray) -> ComplexArray:
        rho = middle[:, :1]
        soil = outside(points)
        return np.select(
            [rho < head.radius_mm, rho < pipe.inner_mm, rho < pipe.outer_mm],
            [complex(head.carrier_eps), AIR, pipe.eps],
            soil,
        )

    return eps


def facing(own: FloatArray, head: HeadGeometry, roll_deg: float) -> list[BoolArray]:
    """(nodes,) of each sector's angles, edges among them."""
    phi = np.degrees(own[:, 1]) - roll_deg
    return [np.abs((phi - 120 * k + 180) % 360 - 180) <= head.sector_deg / 2 + ON_MM for k in range(SECTORS)]


def in_bore(bore: StraightBore, points: FloatArray) -> BoolArray:
    """points (2 or 3, ..) mm; across the pipe z is the bore's own."""
    phi = np.radians(bore.phi_deg)
    beside = points[0] * np.cos(phi) + points[1] * np.sin(phi) - bore.offset_mm
    along_mm = points[2] - bore.along_mm if len(points) == 3 else 0.0
    return np.asarray(beside**2 + along_mm**2 <= bore.radius_mm**2)


def filled(bore: StraightBore | None, soil: complex) -> Callable[[FloatArray], ComplexArray]:
    def outside(points: FloatArray) -> ComplexArray:
        if bore is None:
            return np.full(points.shape[1:], complex(soil))
        return np.where(in_bore(bore, points), complex(bore.fill), complex(soil))

    return outside


def sectors(case: CrossSection) -> Readings:
    """Each sector in turn, across the pipe. AnnulusError of a head outside its pipe."""
    check(case)
    head, pipe = case.head, case.pipe
    axes = [rings(head, pipe, case.fine), turn(head, case.roll_deg, 6.0 / case.fine, 0.5 / case.fine)]
    grid = grid_of(axes, "rp", moved(head, pipe, case.off_mm))
    rho = grid.axes[:, 0]
    front, back = np.abs(rho - head.radius_mm) < ON_MM, rho < rho.min() + ON_MM
    sides = facing(grid.axes, head, case.roll_deg)
    conductors = [front & side for side in sides] + [back & side for side in sides]
    drives = np.concatenate([np.eye(SECTORS), np.eye(SECTORS) * case.shield], axis=1)
    found = solve(
        grid, layers(head, pipe, filled(case.bore, case.soil)), conductors, rho > FAR_MM - ON_MM, drives.tolist()
    )
    charge = found.pf[:, :SECTORS] * head.electrode_mm
    own = np.diag(charge)
    mutual = -(charge - np.diag(own)).real
    return Readings(own.real, -1000 * own.imag, mutual, own.real * 1000 / head.electrode_mm, found)


def stations(head: HeadGeometry, half_mm: float, step_mm: float, fine: float) -> FloatArray:
    """z of nodes: edges of electrodes and shields, fine beside the electrodes'."""
    inner, outer = head.apart_mm / 2, head.apart_mm / 2 + head.electrode_mm
    side = [inner, outer, outer + head.overlap_mm]
    marks = [-half_mm, *(-z for z in reversed(side)), *side, half_mm]
    steps = [4 * step_mm, step_mm, step_mm, step_mm, step_mm, step_mm, 4 * step_mm]
    return graded(marks, [step / fine for step in steps], EDGE_MM / fine)


def electrodes(z: FloatArray, head: HeadGeometry) -> tuple[list[BoolArray], list[BoolArray]]:
    """(nodes,) along the pipe: of the two electrodes, the first at z > 0, and of the shields behind them."""
    inner, outer = head.apart_mm / 2 - ON_MM, head.apart_mm / 2 + head.electrode_mm + ON_MM
    plates = [(side * z >= inner) & (side * z <= outer) for side in (1, -1)]
    over = head.overlap_mm
    return plates, [(side * z >= inner) & (side * z <= outer + over) for side in (1, -1)]


def along(case: Along) -> Pair:
    """The pair, along the pipe. AnnulusError of a head outside its pipe."""
    check(case)
    head, pipe = case.head, case.pipe
    grid = grid_of([rings(head, pipe, case.fine, case.depth_mm), stations(head, FAR_MM, 1.5, case.fine)], "rz")
    rho, z = grid.axes.T
    front, back = np.abs(rho - head.radius_mm) < ON_MM, rho < rho.min() + ON_MM
    plates, shields = electrodes(z, head)
    body = back & (np.abs(z) > head.apart_mm / 2 + head.electrode_mm + head.overlap_mm + ON_MM)
    conductors = [front & one for one in plates] + [back & one for one in shields]
    far = (rho > FAR_MM - ON_MM) | (np.abs(z) > FAR_MM - ON_MM) | body

    def outside(points: FloatArray) -> ComplexArray:
        here = (points[1] >= case.from_mm) & (points[1] <= case.to_mm) & (points[0] < pipe.outer_mm + case.depth_mm)
        return np.where(here, complex(case.inside), complex(case.outside))

    on = float(case.shield)
    drives = [[0.5, -0.5, 0.5 * on, -0.5 * on], [1.0, 0.0, on, 0.0]]
    found = solve(grid, layers(head, pipe, outside), conductors, far, drives)
    both = (found.pf[0, 0] - found.pf[0, 1]) / 2 * head.sector_deg / 360
    alone = found.pf[1] * head.sector_deg / 360
    return Pair(both.real, -1000 * both.imag, -alone[1].real, alone[0].real, found)
