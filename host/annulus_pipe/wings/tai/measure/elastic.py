"""Sound of a warmed laminate, step by step: velocity and stress on a staggered grid, ply by ply, and the air above it.

The truth that an inverse is held against, so it shares nothing with `layered`: second-order differences in time
(Virieux, Geophysics 51 (1986) 889; free faces by imaged stress, Levander, Geophysics 53 (1988) 1425), real plies
instead of their mean, losses by friction of the mass, cracks as rows that bear no traction, water as cells without
shear, and Rayleigh's integral for the air. Air does not load the plate: its impedance is 12 000 times less.

Rows go down from the near face, z = 0; x along the plate, 0 in its middle. Everything is a line across (2-D).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import fft, special
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.tai.measure.budget import (
    AIR_DENSITY,
    AIR_SPEED,
    WATER_DENSITY,
    WATER_SPEED,
    Laminate,
    SingleSidedRig,
    air_absorption_db_m,
)

CELL_MM = 0.25  # a tenth of the shortest shear wave (400 kHz, 2.5 mm). Guard: test_both_solvers_agree
HALF_MM = 90.0  # the plate that is computed, to each side; its outer SPONGE_MM swallow what runs away
SPONGE_MM = 25.0
PLY_MM = 1.0  # fibres along x and across in turn
STEP_PART = 0.9  # of the longest stable step
RATE_HZ = 2e6  # of what is recorded: five times the band's end
DURATION_S = 70e-6  # after the pulse: a laminate is still then (0.2 dB/mm, 2.7 mm/us: -38 dB)

Kind = Literal["delamination", "water"]


@dataclass(frozen=True, slots=True)
class PlateDefect:
    """`depth_mm` : of a delamination, or of the middle of a water pocket, whose thickness is `thick_mm`."""

    kind: Kind
    x_mm: float
    depth_mm: float
    wide_mm: float
    thick_mm: float = 1.0


@dataclass(frozen=True, slots=True)
class PlateSample:
    """A plate as it is: its laminate, what is wrong in it, and how the horn's beam lies on it (1/e half-width)."""

    laminate: Laminate = field(default_factory=Laminate)
    defects: tuple[PlateDefect, ...] = ()
    beam_x_mm: float = 0.0
    beam_half_mm: float = 60.0
    ply_contrast: float = 0.5  # of C11, a ply to the mean: 0.5 for 42 and 14 GPa

    def __post_init__(self) -> None:
        thickness = self.laminate.thickness_mm
        for one in self.defects:
            half = one.thick_mm / 2 if one.kind == "water" else 0.0
            if not (one.depth_mm - half >= 1.0 and one.depth_mm + half <= thickness - 1.0):
                raise AnnulusError(
                    f"{one.kind} {one.depth_mm:g} mm deep, expected 1 mm of a {thickness:g} mm plate around it"
                )
            if not (abs(one.x_mm) + one.wide_mm / 2 <= HALF_MM - SPONGE_MM and one.wide_mm >= 1.0):
                raise AnnulusError(
                    f"{one.kind} {one.wide_mm:g} mm wide at {one.x_mm:g} mm, expected 1 mm or more within "
                    f"+-{HALF_MM - SPONGE_MM:g}"
                )


def face_velocity(
    sample: PlateSample,
    rig: SingleSidedRig,
    cell_mm: float = CELL_MM,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Outward velocity of the near face after one chip, (x, samples) m/s at RATE_HZ from the chip's start; x, mm."""
    lam = sample.laminate
    own_pa, water_pa = rig.pressures_pa(lam)
    h = 1e-3 * cell_mm
    rows = round(lam.thickness_mm / cell_mm)
    x_mm = np.arange(-round(HALF_MM / cell_mm), round(HALF_MM / cell_mm) + 1) * cell_mm
    z_mm = np.arange(rows + 1) * cell_mm
    shape = (rows + 1, len(x_mm))
    turn = np.where((z_mm // PLY_MM).astype(int) % 2 == 0, 1 + sample.ply_contrast, 1 - sample.ply_contrast)
    c11 = np.broadcast_to(1e9 * lam.c11_gpa * turn[:, None], shape).copy()
    c13, c33 = np.full(shape, 1e9 * lam.c13_gpa), np.full(shape, 1e9 * lam.c33_gpa)
    c55, density = np.full(shape, 1e9 * lam.c55_gpa), np.full(shape, lam.density)
    source = np.full(shape, own_pa)
    cracks = []
    for one in sample.defects:
        across = np.abs(x_mm - one.x_mm) <= one.wide_mm / 2
        if one.kind == "delamination":
            cracks.append((round(one.depth_mm / cell_mm), across))
            continue
        wet = ((z_mm >= one.depth_mm - one.thick_mm / 2) & (z_mm < one.depth_mm + one.thick_mm / 2 - 1e-9))[
            :, None
        ] & across
        for stiff in (c11, c13, c33):
            stiff[wet] = WATER_DENSITY * WATER_SPEED**2
        c55[wet], density[wet], source[wet] = 0.0, WATER_DENSITY, water_pa
    source *= np.exp(-(((x_mm - sample.beam_x_mm) / sample.beam_half_mm) ** 2))
    with np.errstate(divide="ignore"):
        corners = [1 / c55[a : rows + a, b : len(x_mm) - 1 + b] for a in (0, 1) for b in (0, 1)]
        shear = np.asarray(4 / np.sum(corners, axis=0))
    free = np.zeros(shape, bool)  # rows that bear no traction: both faces, and cracks
    free[[0, -1]] = True
    for row, across in cracks:
        free[row, across] = True
        shear[row - 1 : row + 1, across[1:] & across[:-1]] = 0.0
    along = np.where(free, c11 - c13**2 / c33, c11)  # plane stress where nothing holds
    warm_x, warm_z = np.where(free, source * (1 - c13 / c33), source), np.where(free, 0.0, source)
    cross, through = np.where(free, 0.0, c13), np.where(free, 0.0, c33)
    dt = STEP_PART * h / (math.sqrt(2) * float(np.sqrt(c11 / density).max()))
    every = max(1, math.floor(1 / (RATE_HZ * dt)))
    dt = 1 / (RATE_HZ * every)
    # Friction of the mass: alpha = 1 / (2 c T) at every frequency, as much as the laminate has at the band's middle.
    loss = 2 * lam.speed * lam.attenuation_db_mm * 1e3 / 8.686
    deep = np.maximum(np.abs(x_mm) - (HALF_MM - SPONGE_MM), 0) / SPONGE_MM
    kept = (np.exp(-dt * (loss + 2.5e6 * deep**3))).astype(np.float32)
    kept_half = 0.5 * (kept[1:] + kept[:-1])
    f32 = np.float32
    push_x = (dt / h / (0.5 * (density[:, 1:] + density[:, :-1]))).astype(f32)
    push_z = (dt / h / (0.5 * (density[1:] + density[:-1]))).astype(f32)
    stiff_x, stiff_xz, stiff_z, stiff_s = ((dt / h * part).astype(f32) for part in (along, cross, through, shear))
    rise_x, rise_z = ((dt / rig.pulse_s * part).astype(f32) for part in (warm_x, warm_z))
    vx, vz = np.zeros((rows + 1, len(x_mm) - 1), f32), np.zeros((rows, len(x_mm)), f32)
    sxx, szz, sxz = np.zeros(shape, f32), np.zeros(shape, f32), np.zeros((rows, len(x_mm) - 1), f32)
    exx, ezz, turned = np.zeros(shape, f32), np.zeros(shape, f32), np.zeros((rows + 1, len(x_mm) - 1), f32)
    half_face = f32(0.5 * lam.c13_gpa / lam.c33_gpa)
    samples = round(DURATION_S * RATE_HZ)
    out = np.zeros((len(x_mm), samples), f32)
    for n in range(samples * every):
        if n % every == 0:
            out[:, n // every] = -(vz[0] + half_face * exx[0])
            if progress and n % (20 * every) == 0:
                progress(n // every, samples)
        turned[1:-1] = sxz[1:] - sxz[:-1]
        turned[0], turned[-1] = 2 * sxz[0], -2 * sxz[-1]
        turned += sxx[:, 1:] - sxx[:, :-1]
        vx += push_x * turned
        vx *= kept_half
        pulled = szz[1:] - szz[:-1]
        pulled[:, 1:-1] += sxz[:, 1:] - sxz[:, :-1]
        vz += push_z * pulled
        vz *= kept
        exx[:, 1:-1] = vx[:, 1:] - vx[:, :-1]
        ezz[1:-1] = vz[1:] - vz[:-1]
        sxx += stiff_x * exx
        sxx += stiff_xz * ezz
        szz += stiff_xz * exx
        szz += stiff_z * ezz
        shift = vx[1:] - vx[:-1]
        shift += vz[:, 1:] - vz[:, :-1]
        sxz += stiff_s * shift
        part = min(1.0, rig.pulse_s / dt - n)  # of this step that the microwave is on
        if part > 0:
            sxx -= f32(part) * rise_x
            szz -= f32(part) * rise_z
    return out.astype(float), np.asarray(x_mm, float)


def sound_in_air(
    velocity: FloatArray, x_mm: FloatArray, rig: SingleSidedRig, receivers_mm: FloatArray, samples: int
) -> FloatArray:
    """Pressure at receivers' faces above a moving face, (receivers, samples) Pa at RATE_HZ from the chip's start.

    Rayleigh's integral of a line of sources in a baffle, p = omega rho / 2 int u H0(k r) dx (Williams, Fourier
    Acoustics, 2.10), with absorption of ISO 9613-1 at each frequency; a face hears its mean.
    """
    length = fft.next_fast_len(samples + velocity.shape[1], real=True)
    spectrum = fft.rfft(velocity, length, axis=1)
    f = fft.rfftfreq(length, 1 / RATE_HZ)
    step = float(x_mm[1] - x_mm[0])
    lag = (np.arange(2 * len(x_mm)) - len(x_mm)) * step
    distance = 1e-3 * np.hypot(lag, rig.standoff_mm)
    face = (np.abs(lag) <= rig.face_mm[0] / 2).astype(float)
    face = fft.fft(fft.ifftshift(face / face.sum()))
    at = np.searchsorted(x_mm, receivers_mm - step / 2)
    received = np.zeros((len(receivers_mm), len(f)), complex)
    for n in range(len(f)):
        response = _response(float(f[n]), rig)
        if response == 0.0:
            continue
        lost = air_absorption_db_m(float(f[n]), rig.temperature_c, rig.humidity_percent) / 8.686
        wave = 2 * math.pi * f[n] / AIR_SPEED
        kernel = math.pi * f[n] * AIR_DENSITY * 1e-3 * step * special.hankel2(0, (wave - 1j * lost) * distance)
        spread = fft.ifft(fft.fft(spectrum[:, n], len(lag)) * fft.fft(fft.ifftshift(kernel)) * face)
        received[:, n] = response * spread[at]
    return np.asarray(fft.irfft(received, length, axis=1)[:, :samples])


def _response(frequency_hz: float, rig: SingleSidedRig) -> float:
    """Of a receiver: 1 in the rig's band, falling to nothing within a quarter of it to both sides."""
    low, high = rig.band_hz
    off = max(0.75 * low - frequency_hz, frequency_hz - 1.25 * high, 0.0) / (
        0.5 * low if frequency_hz < low else 0.5 * high
    )
    return 0.5 + 0.5 * math.cos(math.pi * off) if off < 1 else 0.0
