"""Where microwaves leave their power: a plane wave on a layer in closed form, an open waveguide in front of anything by
finite differences.

Fields are phasors e^{+j omega t} of rms size, permittivity is eps' - j (eps'' + sigma / omega eps0). In the plane of
the solver the electric field stands upright (E_z): the H-plane of a rectangular guide, through its broad side.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.late import sparse
from annulus_pipe.vocabulary import AnnulusError

EPS0 = 8.8541878128e-12  # F/m
MU0 = 4e-7 * math.pi  # H/m
LIGHT_M_S = 1 / math.sqrt(EPS0 * MU0)
FREQUENCY_HZ = 2.45e9
WR340_MM = (86.36, 43.18)  # inside, broad and narrow
PML_MM = 14.0  # Guard, with PML_DEPTH: topic microwaves (closed forms within 1 %), test_electromagnetics.py
PML_DEPTH = 9.0  # nepers of a wave that crosses the layer and comes back
UNKNOWNS_MAX = 2_000_000  # nodes. Unguarded: a matter of memory (about 4 GB)


@dataclass(frozen=True, slots=True)
class Dielectric:
    eps_r: float
    sigma_s_m: float = 0.0  # S/m, conduction and eps'' together at the frequency of use

    def permittivity(self, frequency_hz: float) -> complex:
        """Relative, complex."""
        return complex(self.eps_r, -self.sigma_s_m / (2 * math.pi * frequency_hz * EPS0))


OIL = Dielectric(2.3)
AIR = Dielectric(1.0)


def attenuation(medium: Dielectric, frequency_hz: float = FREQUENCY_HZ) -> float:
    """alpha of a plane wave's amplitude, 1/m (Eq. 7.22)."""
    omega, eps = 2 * math.pi * frequency_hz, medium.eps_r * EPS0
    loss = medium.sigma_s_m / (omega * eps)
    return omega * math.sqrt(MU0 * eps / 2) * math.sqrt(math.sqrt(1 + loss * loss) - 1)


def half_space_loss(medium: Dielectric, depth_mm: float, frequency_hz: float = FREQUENCY_HZ) -> float:
    """Power that the first `depth_mm` take from a plane wave of 1 V/m in air, W/m^2 (Eq. 7.21-7.23).

    With the complex impedance of the lossy medium: with that of a lossless one, as Eq. 7.23 reads literally, the loss
    would have no maximum over the conductivity at all.
    """
    index = np.sqrt(medium.permittivity(frequency_hz))
    transmitted = abs(2 / (1 + index)) ** 2  # T^2, Eq. 7.23
    twice = 2 * attenuation(medium, frequency_hz)
    depth = depth_mm * 1e-3
    through = -math.expm1(-twice * depth) / twice if twice > 0 else depth
    return float(medium.sigma_s_m * transmitted * through)  # Eq. 7.21


def slab_loss(
    medium: Dielectric,
    thickness_mm: float,
    depth_mm: float,
    outside: Dielectric = AIR,
    frequency_hz: float = FREQUENCY_HZ,
) -> float:
    """The same for a slab with `outside` on both sides, every reflection counted. 1 V/m in `outside`."""
    k0 = 2 * math.pi * frequency_hz / LIGHT_M_S
    inner, outer = np.sqrt(medium.permittivity(frequency_hz)), np.sqrt(outside.permittivity(frequency_hz))
    front, back = (outer - inner) / (outer + inner), (inner - outer) / (inner + outer)
    thickness, z = thickness_mm * 1e-3, np.linspace(0.0, depth_mm * 1e-3, 4001)
    k = k0 * inner
    round_trip = np.exp(-2j * k * thickness)
    field = (1 + front) * (np.exp(-1j * k * z) + back * np.exp(-1j * k * (2 * thickness - z)))
    field /= 1 + front * back * round_trip
    return float(medium.sigma_s_m * np.trapezoid(np.abs(field) ** 2, z))


@dataclass(frozen=True, slots=True, eq=False)
class MicrowaveField:
    """E_z, V/m rms, on nodes [y, x]; the wave travels towards +y, the guide's mouth lies at y = 0."""

    e_v_m: NDArray[np.complex128]
    loss_w_m3: NDArray[np.float64]  # sigma |E|^2 (Eq. 7.4)
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    reflection: complex  # of the guide's fundamental mode at the mouth (S11)


def plane_wave(
    medium: Dielectric, thickness_mm: float, depth_mm: float, step_mm: float, frequency_hz: float = FREQUENCY_HZ
) -> float:
    """`slab_loss` by finite differences in air, W/m^2; thickness inf is the half-space. Checks the solver."""
    ahead = 30.0
    behind = 60.0 if math.isinf(thickness_mm) else 30.0 + thickness_mm
    count = round((ahead + behind + 2 * PML_MM) / step_mm) + 1
    y = np.asarray(-PML_MM - ahead + np.arange(count) * step_mm, np.float64)
    eps = np.full((count, 1), AIR.permittivity(frequency_hz))
    inside = _covered(y[:, None], 0.0, min(thickness_mm, 1e6), step_mm)
    eps = eps * (1 - inside) + inside * medium.permittivity(frequency_hz)
    omega = 2 * math.pi * frequency_hz
    source = np.zeros((count, 1), complex)
    row = round((PML_MM + 5.0) / step_mm)
    # a sheet of current sends E = -omega mu J / 2k both ways
    source[row] = -2 * (omega / LIGHT_M_S) / (omega * MU0) / (step_mm * 1e-3)
    field = _solve(eps, step_mm, omega, source, (True, False), None)
    inside_depth = _covered(y[:, None], 0.0, depth_mm, step_mm)
    return float((medium.sigma_s_m * inside_depth * np.abs(field) ** 2).sum() * step_mm * 1e-3)


def open_waveguide(
    permittivity: NDArray[np.complex128],
    step_mm: float,
    x_mm: NDArray[np.float64],
    y_mm: NDArray[np.float64],
    power_w: float,
    frequency_hz: float = FREQUENCY_HZ,
    guide_mm: tuple[float, float] = WR340_MM,
    fill: Dielectric = AIR,
) -> MicrowaveField:
    """Field of an open-ended rectangular guide in front of `permittivity`, the fundamental mode bringing `power_w`.

    Parameters
    ----------
    permittivity : (ny, nx) relative, complex, at the nodes; average it over the cell at edges (`disc`). The rim of
        PML_MM absorbs. Rows with y < 0 lie in the guide and its walls, whatever is given there; it holds `fill`.
    """
    a, b = guide_mm[0] * 1e-3, guide_mm[1] * 1e-3
    omega = 2 * math.pi * frequency_hz
    behind = np.flatnonzero(y_mm < 0)
    if len(behind) < 2 or y_mm[0] > -PML_MM - 25.0:
        raise AnnulusError(
            f"the grid must begin {PML_MM + 25:g} mm behind the mouth of the guide, it does at {y_mm[0]:g} mm"
        )
    beta2 = (omega / LIGHT_M_S) ** 2 * fill.eps_r - (math.pi / a) ** 2
    if beta2 <= 0:
        raise AnnulusError(f"a guide {guide_mm[0]:g} mm broad carries no wave of {frequency_hz / 1e9:g} GHz")
    beta = math.sqrt(beta2)
    permittivity = permittivity.copy()
    permittivity[behind] = fill.permittivity(frequency_hz)
    mouth = np.abs(y_mm) < 1e-6 * step_mm  # nodes on the boundary belong to both sides
    permittivity[mouth] = 0.5 * (permittivity[mouth] + fill.permittivity(frequency_hz))
    wall = np.zeros(permittivity.shape, bool)
    wall[np.ix_(behind, np.abs(x_mm) >= guide_mm[0] / 2 - 1e-6)] = True
    mode = np.where(np.abs(x_mm) < guide_mm[0] / 2, np.cos(math.pi * x_mm / guide_mm[0]), 0.0)
    strength = math.sqrt(2 * power_w * omega * MU0 / (beta * a * b))  # rms of the mode's middle
    row = int(np.argmin(np.abs(y_mm + 20.0)))
    source = np.zeros(permittivity.shape, complex)
    source[row] = -2 * beta / (omega * MU0) * strength * mode / (step_mm * 1e-3)
    field = _solve(permittivity, step_mm, omega, source, (True, True), wall)
    look = int(np.argmin(np.abs(y_mm + 10.0)))
    amplitude = field[look] @ mode / (mode @ mode)
    came = strength * np.exp(-1j * beta * (y_mm[look] - y_mm[row]) * 1e-3)
    back = (amplitude - came) * np.exp(-1j * beta * (0.0 - y_mm[look]) * 1e-3)
    arrived = strength * np.exp(-1j * beta * (0.0 - y_mm[row]) * 1e-3)
    loss = -omega * EPS0 * permittivity.imag * np.abs(field) ** 2
    return MicrowaveField(field, loss, x_mm, y_mm, complex(back / arrived))


def nodes(
    half_width_mm: float, ahead_mm: float, step_mm: float, guide_mm: float = WR340_MM[0]
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Nodes (x, y) for `open_waveguide` and the step really used: the guide's walls lie on nodes."""
    step = guide_mm / 2 / max(round(guide_mm / 2 / step_mm), 4)
    right = math.ceil((half_width_mm + PML_MM) / step)
    back, front = math.ceil((PML_MM + 26.0) / step), math.ceil((ahead_mm + PML_MM) / step)
    if (2 * right + 1) * (back + front + 1) > UNKNOWNS_MAX:
        raise AnnulusError(f"a step of {step:.3g} mm makes more than {UNKNOWNS_MAX} unknowns: take a longer one")
    x, y = (np.asarray(np.arange(*ends) * step, np.float64) for ends in ((-right, right + 1), (-back, front + 1)))
    return x, y, step


def disc(
    x_mm: NDArray[np.float64], y_mm: NDArray[np.float64], centre_mm: tuple[float, float], radius_mm: float
) -> NDArray[np.float64]:
    """(ny, nx) part of each node's cell that the disc covers."""
    step = x_mm[1] - x_mm[0]
    sub = (np.arange(8) - 3.5) / 8 * step
    x = x_mm[None, :, None, None] + sub[None, None, None, :] - centre_mm[0]
    y = y_mm[:, None, None, None] + sub[None, None, :, None] - centre_mm[1]
    near = np.abs(np.hypot(x_mm[None, :] - centre_mm[0], y_mm[:, None] - centre_mm[1]) - radius_mm) < step
    part = (np.hypot(x_mm[None, :] - centre_mm[0], y_mm[:, None] - centre_mm[1]) < radius_mm).astype(float)
    rows, columns = np.nonzero(near)
    part[rows, columns] = (np.hypot(x[0, columns], y[rows, 0]) < radius_mm).mean(axis=(1, 2))
    return part


def _covered(y: NDArray[np.float64], start: float, stop: float, step: float) -> NDArray[np.float64]:
    """Part of each node's cell between start and stop."""
    return np.clip((np.minimum(y + step / 2, stop) - np.maximum(y - step / 2, start)) / step, 0.0, 1.0)


def _solve(
    permittivity: NDArray[np.complex128],
    step_mm: float,
    omega: float,
    current: NDArray[np.complex128],
    absorbing: tuple[bool, bool],
    wall: NDArray[np.bool_] | None,
) -> NDArray[np.complex128]:
    """E of (d2/dx2 + d2/dy2 + k^2) E = j omega mu J, five points, stretched coordinates in the rim.

    A direction that is not absorbing ends in mirrors on which E may stand (dE/dn = 0): right for a plane wave.
    """
    ny, nx = permittivity.shape
    h = step_mm * 1e-3
    operator = sparse.diags_array((omega**2 * MU0 * EPS0 * permittivity).ravel(), format="csr")
    for axis, (size, other) in enumerate(((ny, nx), (nx, ny))):
        rim = round(PML_MM / step_mm) if absorbing[axis] else 0
        edges = (permittivity[[0, -1], :] if axis == 0 else permittivity[:, [0, -1]]).real
        k = omega / LIGHT_M_S * math.sqrt(float(np.median(edges)))
        node = _stretch(np.arange(size, dtype=float), size, rim, k * step_mm * 1e-3)
        between = _stretch(np.arange(size - 1) + 0.5, size, rim, k * step_mm * 1e-3)
        slope = sparse.diags_array(1 / between) @ (
            sparse.eye_array(size - 1, size, k=1) - sparse.eye_array(size - 1, size)
        )
        second = (
            -sparse.diags_array(1 / node)
            @ (sparse.eye_array(size - 1, size, k=1) - sparse.eye_array(size - 1, size)).T
            @ slope
            / h**2
        )
        eye = sparse.eye_array(other)
        operator = operator + (sparse.kron(second, eye) if axis == 0 else sparse.kron(eye, second))
    right = (1j * omega * MU0 * current).ravel()
    free = np.ones(ny * nx, bool) if wall is None else ~wall.ravel()
    out = np.zeros(ny * nx, complex)
    matrix = sparse.csc_array(operator)[free][:, free]
    out[free] = sparse.linalg.splu(matrix, permc_spec="MMD_AT_PLUS_A").solve(right[free])
    return out.reshape(ny, nx)


def _stretch(at: NDArray[np.float64], size: int, rim: int, k_step: float) -> NDArray[np.complex128]:
    """Coordinate stretch at nodes or between: 1 inside, complex in the rim, cubic."""
    if not rim:
        return np.ones(len(at), complex)
    deep = np.maximum(np.maximum(rim - at, at - (size - 1 - rim)), 0.0) / rim
    return np.asarray(1.0 - 1j * (PML_DEPTH / 2 * 4 / (rim * k_step)) * deep**3, np.complex128)
