"""Quasi-static potential on a grid round a pipe: capacitances between conductors, by finite elements.

    div(eps grad u) = 0,    eps = eps' + sigma / (j omega eps0)

u is 1 on one conductor, 0 on the others and on the far boundary, and nothing leaves through what is left of the
boundary. A conductor's charge is the residual of the weak form on its nodes, summed, which makes the matrix of
capacitances symmetric and its energies exact for the discrete field: only the field itself is approximate. Wavelength
in wet soil at 6.5 MHz is metres, the head centimetres: no wave is lost by leaving them out. Elements are bilinear, on
a grid of (rho, phi), (rho, z) or (rho, phi, z) whose seam at phi = 2 pi is sewn, so that a layer's edge is an edge of
elements and need not be resolved. Along an electrode's edge the charge is singular: grids are finer there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from annulus_pipe.extras import need
from annulus_pipe.numeric.arrays import BoolArray, ComplexArray, FloatArray, IntArray
from annulus_pipe.numeric.late import sparse
from annulus_pipe.vocabulary import AnnulusError

EPS0_PF_PER_M = 8.8541878128
EPS0_PF_PER_MM = EPS0_PF_PER_M / 1000
HERTZ = 6.5e6
DIRECT_MAX = 60_000  # nodes; beyond, fill-in of a direct solution costs more than iterations
ITERATIONS_MAX = 4000


def permittivity(eps: float, sigma_s_m: float = 0.0, hertz: float = HERTZ) -> complex:
    """Relative, exp(+j omega t): a conductor's is eps' - j eps''."""
    return complex(eps, -sigma_s_m / (2 * np.pi * hertz * EPS0_PF_PER_M * 1e-12))


@dataclass(frozen=True, slots=True)
class ElementMesh:
    """basis : of scikit-fem, mm. seam : (nodes,) which node each is. middle : (elements, dim) in (rho, phi, z) or what
    there is of it. axes : nodes' own rho, phi, z likewise (nodes, dim). around : True where z is the second axis and
    the field turns about it: the weight is 2 pi rho."""

    basis: Any
    seam: IntArray
    axes: FloatArray
    middle: FloatArray
    around: bool = False


def needed() -> Any:
    """scikit-fem. AnnulusError, one line, where it is not installed."""
    return need("skfem")


def grid_of(axes: list[FloatArray], kind: str, place: Callable[[FloatArray], FloatArray] | None = None) -> ElementMesh:
    """axes : rising, of `kind` 'rp' (rho mm, phi rad over one whole turn), 'rz' or 'rpz'. place moves nodes: (nodes,
    dim) of rho, phi, z to mm; polar if not given."""
    skfem = needed()
    tensor = (skfem.MeshHex if kind == "rpz" else skfem.MeshQuad).init_tensor(*axes)
    own = np.asarray(tensor.p.T, float)
    seam = np.arange(len(own))
    if "p" in kind:
        turn = axes[1][-1] - axes[1][0]
        if abs(turn - 2 * np.pi) > 1e-9:
            raise AnnulusError(f"angles over {np.degrees(turn):.6g} deg, expected 360")
        at = tuple(np.searchsorted(axis, column) for axis, column in zip(axes, own.T, strict=True))
        number = np.empty([len(axis) for axis in axes], int)
        number[at] = seam
        last = at[1] == len(axes[1]) - 1
        seam[last] = number[(at[0][last], 0, *(along[last] for along in at[2:]))]
    middle = np.asarray(own[tensor.t].mean(axis=0))
    moved = own if kind == "rz" else (place or polar)(own)
    mesh = type(tensor)(np.ascontiguousarray(moved.T), tensor.t)
    solid = kind == "rpz"
    element = skfem.ElementHex1() if solid else skfem.ElementQuad1()
    return ElementMesh(skfem.Basis(mesh, element, intorder=2 if solid else 6), seam, own, middle, kind == "rz")


def polar(own: FloatArray) -> FloatArray:
    out = own.copy()
    out[:, 0], out[:, 1] = own[:, 0] * np.cos(own[:, 1]), own[:, 0] * np.sin(own[:, 1])
    return out


@dataclass(frozen=True, slots=True)
class ElectrodeField:
    """volts : (ways, nodes), one conductor at 1 V in turn, or the drives asked for. pf : (ways, conductors) charge of
    each, pC at 1 V = pF (pC/mm and pF/mm across a pipe), complex: -imag is conductance / omega. Of one conductor in
    turn it is Maxwell's matrix, symmetric."""

    grid: ElementMesh
    volts: ComplexArray
    pf: ComplexArray
    eps: ComplexArray  # (elements, points)

    def share(self, one: FloatArray | list[float], other: FloatArray | list[float]) -> ComplexArray:
        """(elements,) eps dC/deps of C = sum over conductors of charge x voltage, between two mixtures of ways: they
        add up to C, for C is homogeneous in eps."""
        slopes = []
        for mixture in (one, other):
            u = np.asarray(mixture, float) @ self.volts
            real, imag = (
                np.asarray(self.grid.basis.interpolate(np.ascontiguousarray(w)).grad) for w in (u.real, u.imag)
            )
            slopes.append(real + 1j * imag)
        product = (slopes[0] * slopes[1]).sum(axis=0) * self.eps * _weight(self.grid) * self.grid.basis.dx
        return np.asarray(EPS0_PF_PER_MM * product.sum(axis=1))

    def strength(self, mixture: FloatArray | list[float]) -> FloatArray:
        """(elements,) |E| of a mixture of ways, V/mm, mean over each element."""
        u = np.asarray(mixture, float) @ self.volts
        squares = [
            (np.asarray(self.grid.basis.interpolate(np.ascontiguousarray(w)).grad) ** 2) for w in (u.real, u.imag)
        ]
        return np.asarray(np.sqrt((squares[0] + squares[1]).sum(axis=0)).mean(axis=1))


def _weight(grid: ElementMesh) -> FloatArray | float:
    return 2 * np.pi * np.asarray(grid.basis.global_coordinates()[0]) if grid.around else 1.0


def solve(
    grid: ElementMesh,
    eps: Callable[[FloatArray, FloatArray], ComplexArray],
    conductors: list[BoolArray],
    far: BoolArray,
    drives: list[list[float]] | None = None,
) -> ElectrodeField:
    """eps : (elements,) centres in rho.. and (dim, elements, points) mm -> (elements, points), relative. conductors,
    far : (nodes,) what belongs to which. drives : (ways, conductors) voltages to solve for in place of one
    conductor at a time. AnnulusError where a conductor
    has no node or two share one, or where iterations do not converge."""
    skfem = needed()
    basis, solid = grid.basis, grid.axes.shape[1] == 3
    points = np.asarray(basis.global_coordinates())
    value = np.broadcast_to(eps(grid.middle, points), points.shape[1:]).astype(complex)
    weight = _weight(grid)
    lossless = not value.imag.any()
    kind = float if lossless else complex

    @skfem.BilinearForm(dtype=kind)  # type: ignore[untyped-decorator, unused-ignore]
    def form(u: Any, v: Any, w: Any) -> Any:
        return w.eps * sum(u.grad[k] * v.grad[k] for k in range(len(u.grad)))

    factor = EPS0_PF_PER_MM * weight * (value.real if lossless else value)
    raw = form.assemble(basis, eps=skfem.DiscreteField(factor))
    nodes = len(grid.axes)
    sewn = sparse.csr_matrix((np.ones(nodes), (np.arange(nodes), grid.seam)), shape=(nodes, nodes))
    whole = sparse.csr_matrix(sewn.T @ raw @ sewn)
    owner = np.full(nodes, -1)
    owner[far[grid.seam]] = len(conductors)
    for k, one in enumerate(conductors):
        held = one[grid.seam]
        if not held.any():
            raise AnnulusError(f"conductor {k} has no node, expected a grid with its edges on it")
        if (owner[held] >= 0).any():
            raise AnnulusError(f"conductor {k} touches another or the far boundary")
        owner[held] = k
    free = np.flatnonzero((owner < 0) & (grid.seam == np.arange(nodes)))
    fixed = np.flatnonzero(owner >= 0)
    ways = np.eye(len(conductors)) if drives is None else np.asarray(drives, float)
    volts = np.zeros((len(ways), nodes), kind)
    padded = np.concatenate([ways, np.zeros((len(ways), 1))], axis=1)
    volts[:, fixed] = padded[:, owner[fixed]]
    inner = whole[free][:, free]
    outer = -(whole[free][:, fixed] @ volts[:, fixed].T)
    if len(free) < DIRECT_MAX and not solid:
        volts[:, free] = (
            sparse.linalg.splu(inner.tocsc(), permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
            .solve(outer)
            .T
        )
    else:
        volts[:, free] = np.stack([_conjugate(inner, column) for column in outer.T])
    own = grid.seam == np.arange(nodes)
    flux = (whole @ volts.T).T * own
    charge = np.stack([flux[:, (owner == k) & own].sum(axis=1) for k in range(len(conductors))], axis=1)
    return ElectrodeField(grid, volts[:, grid.seam].astype(complex), charge.astype(complex), value)


def _conjugate(matrix: Any, right: ComplexArray, tolerance: float = 1e-7) -> ComplexArray:
    """COCG with a diagonal preconditioner: conjugate gradients of a complex symmetric matrix, without conjugates."""
    scale = 1 / matrix.diagonal()
    x = np.zeros_like(right)
    rest = right.copy()
    way = scale * rest
    slope = rest @ way
    enough = tolerance * np.linalg.norm(right)
    for _ in range(ITERATIONS_MAX):
        image = matrix @ way
        step = slope / (way @ image)
        x += step * way
        rest -= step * image
        if np.linalg.norm(rest) < enough:
            return np.asarray(x)
        scaled = scale * rest
        new = rest @ scaled
        way = scaled + new / slope * way
        slope = new
    raise AnnulusError(f"the field did not converge in {ITERATIONS_MAX} iterations")


def graded(marks: list[float], steps: list[float], smallest: float, growth: float = 1.6) -> FloatArray:
    """Nodes from the first mark to the last, all marks among them. steps : longest of each piece between two marks;
    steps are `smallest` on both sides of an inner mark and grow from there."""
    out = [marks[0]]
    for k, (low, high, step) in enumerate(zip(marks[:-1], marks[1:], steps, strict=True)):
        fine_low, fine_high = k > 0, k < len(steps) - 1
        if fine_low and fine_high:
            half = _growing((high - low) / 2, smallest, step, growth)
            nodes = np.concatenate([low + half, (high - half)[-2::-1], [high]])
        elif fine_low or fine_high:
            side = _growing(high - low, smallest, step, growth)
            nodes = low + side if fine_low else np.append((high - side)[-2::-1], high)
        else:
            nodes = np.linspace(low, high, max(int(np.ceil((high - low) / step)), 1) + 1)[1:]
        out.extend(nodes.tolist())
    return np.asarray(out)


def _growing(length: float, first: float, step: float, growth: float) -> FloatArray:
    """Sums of steps that grow from `first` to `step`, shrunk alike to end at `length`."""
    sums: list[float] = []
    size = first
    while not sums or sums[-1] < length - 1e-9:
        sums.append((sums[-1] if sums else 0.0) + min(size, step))
        size *= growth
    return np.asarray(sums) * (length / sums[-1])
