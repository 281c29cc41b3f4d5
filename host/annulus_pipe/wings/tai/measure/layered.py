"""A plate's sound in wave numbers: the linear model of what defects in it sound like in air, its adjoint, its inverse.

The model is the elastic, orthotropic plate with free faces, exact for every wave number along it. By reciprocity one
problem a frequency is enough: what opens by b at depth z moves the face by b times the stress that a unit force on the
face makes there. A delamination is linear in where it is, in Kirchhoff's way: every part opens as an endless crack of
its depth would. Water is a thin soft layer that swells. What breaks that is width: a crack as narrow as it is deep.

Everything is damped: data times exp(-t / DAMPING_S) are a spectrum at the complex frequency omega - i / DAMPING_S. The
plate's late ringing, which no model of a real laminate follows for long, thereby counts little, and nothing wraps.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import fft
from annulus_pipe.wings.tai.measure.budget import (
    AIR_DENSITY,
    AIR_SPEED,
    WATER_DENSITY,
    WATER_SPEED,
    Laminate,
    SingleSidedRig,
    air_absorption_db_m,
    emptying_s,
)

ComplexArray = NDArray[np.complex128]

KINDS = ("delamination", "water")
DAMPING_S = 15e-6  # two ways through 20 mm. Guard: topic single_sided
STEP_MM = 1.0  # between depths of the image; a wave is 9 mm
WATER_MM = 1.0  # the image's water is the pressure of a layer so thick
PADDED = 2  # of the receivers' length: what the transform along the plate must not wrap into


@dataclass(frozen=True, eq=False)
class PlateModel:
    """Receivers in a row above a plate: from an image (kinds, depths, receivers) to damped spectra (receivers, bins).

    The image's delamination is 1 where a plate that was warmed by the rig's own pressure is parted; its water is the
    pressure of a layer WATER_MM thick over the rig's pressure of water. `beam` : (receivers,) how strongly the place
    under each is lit. `frequency_hz` : (bins,) of the band, of a record of `samples`.
    """

    laminate: Laminate
    rig: SingleSidedRig
    pitch_mm: float
    beam: FloatArray
    rate_hz: float
    samples: int
    depths_mm: FloatArray = field(init=False)
    bins: NDArray[np.int64] = field(init=False)
    kernel: ComplexArray = field(init=False)  # (kinds, depths, bins, wave numbers)

    def __post_init__(self) -> None:
        f = fft.rfftfreq(self.samples, 1 / self.rate_hz)
        low, high = self.rig.band_hz
        put = object.__setattr__
        put(self, "bins", np.flatnonzero((f >= low) & (f <= high)))
        put(self, "depths_mm", np.arange(2.0, self.laminate.thickness_mm - 1.5, STEP_MM))
        put(self, "kernel", self._kernel())

    @property
    def count(self) -> int:
        return len(self.beam)

    @property
    def padded(self) -> int:
        return int(fft.next_fast_len(PADDED * self.count))

    @property
    def omega(self) -> ComplexArray:
        """Of the bins, rad/s, damped."""
        return np.asarray(2 * math.pi * self.bins * self.rate_hz / self.samples - 1j / DAMPING_S)

    @property
    def wave_numbers(self) -> FloatArray:
        """Along the plate, rad/m. Not quite 0: there the two waves of the plate no longer know of each other."""
        k = 2 * math.pi * fft.fftfreq(self.padded, 1e-3 * self.pitch_mm)
        return np.where(np.abs(k) < 1.0, 1.0, k)

    def forward(self, image: FloatArray) -> ComplexArray:
        """(kinds, depths, receivers) -> (receivers, bins)."""
        spectrum = fft.fft(image * self.beam, self.padded, axis=2)
        return np.asarray(fft.ifft(np.einsum("czfk,czk->kf", self.kernel, spectrum), axis=0)[: self.count])

    def adjoint(self, data: ComplexArray) -> FloatArray:
        """(receivers, bins) -> (kinds, depths, receivers): <forward(m), d> = <m, adjoint(d)>, real parts."""
        spectrum = fft.fft(data, self.padded, axis=0)
        back = np.einsum("czfk,kf->czk", self.kernel.conj(), spectrum)
        return np.asarray(fft.ifft(back, axis=2).real[:, :, : self.count] * self.beam)

    def damped(self, traces: FloatArray) -> ComplexArray:
        """Traces from the chip's start (receivers, samples) -> damped spectra in the band, from the air's way on."""
        times = np.arange(self.samples) / self.rate_hz - self.flight_s
        weight = np.where(times > -self.rig.pulse_s, np.exp(-np.maximum(times, -1e-5) / DAMPING_S), 0.0)
        return np.asarray(fft.rfft(traces * weight, axis=1)[:, self.bins])

    @property
    def flight_s(self) -> float:
        return 1e-3 * self.rig.standoff_mm / AIR_SPEED

    def sound_plate(self) -> ComplexArray:
        """(bins,) what a plate without defects sounds like where the beam is 1."""
        c33, speed = self._through()
        k = self.omega / speed
        h = 1e-3 * self.laminate.thickness_mm
        own_pa, _ = self.rig.pressures_pa(self.laminate)
        return np.asarray(-own_pa / (c33 * k) * np.tan(k * h / 2) * self._received(np.array([1.0]))[:, 0])

    def _through(self) -> tuple[complex, ComplexArray]:
        """Stiffness and speed through the thickness, with the loss of the band's middle at every frequency."""
        c33 = 1e9 * self.laminate.c33_gpa * (1 + 1j * self._loss())
        return c33, np.sqrt(c33 / self.laminate.density)

    def _loss(self) -> float:
        neper_m = 1e3 * self.laminate.attenuation_db_mm / 8.686
        return 2 * neper_m * self.laminate.speed / (2 * math.pi * self.rig.middle_hz)

    def _received(self, k: FloatArray) -> ComplexArray:
        """(bins, k): from the face's movement, m, to a receiver's pressure, Pa, for one chip's heat."""
        omega = self.omega[:, None]
        chip = self.rig.pulse_s
        lost = np.array([air_absorption_db_m(float(w.real) / (2 * math.pi)) / 8.686 for w in self.omega])[:, None]
        air = omega / AIR_SPEED - 1j * lost
        up = np.sqrt(air**2 - k**2)
        up = np.where(up.imag > 0, -up, up)
        way = np.exp(-1j * up * 1e-3 * self.rig.standoff_mm + self.flight_s / DAMPING_S)
        face = np.sinc(k * 1e-3 * self.rig.face_mm[0] / (2 * math.pi))
        # the heat's step: its 1 / (i omega) takes the velocity's i omega away
        heat = (1 - np.exp(-1j * omega * chip)) / (1j * omega * chip)
        # `damped` counts damping from the air's way on, a record its time from the chip: both are in `way`
        return np.asarray(-AIR_DENSITY * omega / up * heat * way * face * self.rate_hz)

    def _kernel(self) -> ComplexArray:
        k = self.wave_numbers
        stress = self._loaded(k)
        own_pa, water_pa = self.rig.pressures_pa(self.laminate)
        c33, speed = self._through()
        along = self.omega / speed
        h, z = 1e-3 * self.laminate.thickness_mm, 1e-3 * self.depths_mm[:, None]
        opened = -own_pa / (c33 * along) * (np.tan(along * (h - z) / 2) + np.tan(along * z / 2))  # (depths, bins)
        # water: a soft layer, which gives way to its own pressure within `empty` (seconds)
        soft = 1e-3 * WATER_MM / (WATER_DENSITY * WATER_SPEED**2)
        empty = emptying_s(self.laminate, WATER_MM)
        swollen = water_pa * soft / (1 + 1j * self.omega * empty)
        kernel = np.stack([stress * opened[:, :, None], stress * swollen[:, None]])
        return np.asarray(kernel * self._received(k))

    def _loaded(self, k: FloatArray) -> ComplexArray:
        """Stress through the thickness (depths, bins, k) where a unit force pushes the near face.

        Partial waves of an orthotropic plate (Nayfeh, Wave Propagation in Layered Anisotropic Media, 1995, ch. 5), each
        counted from the face it leaves, so that nothing grows.
        """
        lam, w = self.laminate, self.omega[:, None]
        turn = 1e9 * (1 + 1j * self._loss())
        c11, c13, c33, c55 = (turn * c for c in (lam.c11_gpa, lam.c13_gpa, lam.c33_gpa, lam.c55_gpa))
        kx = np.broadcast_to(k, (len(w), len(k))).astype(complex)
        inert = lam.density * w**2
        b = c33 * (c11 * kx**2 - inert) + c55 * (c55 * kx**2 - inert) - (c13 + c55) ** 2 * kx**2
        root = np.sqrt(b**2 - 4 * c33 * c55 * (c11 * kx**2 - inert) * (c55 * kx**2 - inert))
        h, z = 1e-3 * lam.thickness_mm, 1e-3 * self.depths_mm[:, None, None]
        columns, fields = [], []
        for sign in (1, -1):
            kz = np.sqrt((-b + sign * root) / (2 * c33 * c55))
            kz = np.where(kz.imag > 0, -kz, kz)
            ux, uz = (c13 + c55) * kx * kz, -(c11 * kx**2 + c55 * kz**2 - inert)
            size = np.sqrt(np.abs(ux) ** 2 + np.abs(uz) ** 2)
            ux, uz = ux / size, uz / size
            for down in (1, -1):  # what leaves the near face, what leaves the far one
                kd, ud = down * kz, down * uz
                normal = -1j * (c13 * kx * ux + c33 * kd * ud)
                shear = -1j * c55 * (kd * ux + kx * ud)
                across = np.exp(-1j * kz * h)
                near, far = (1.0, across) if down == 1 else (across, 1.0)
                columns.append(np.stack([normal * near, shear * near, normal * far, shear * far], axis=-1))
                phase = np.exp(-1j * kz * (z if down == 1 else h - z))
                fields.append(normal * phase)
        matrix = np.stack(columns, axis=-1)
        scale = np.abs(matrix).max(axis=(-2, -1), keepdims=True)
        right = np.zeros((*matrix.shape[:2], 4, 1), complex)
        right[..., 0, 0] = -1.0  # a unit force into the plate
        parts = np.linalg.solve(matrix / scale, right / scale)[..., 0]
        return np.asarray(sum(parts[..., n] * fields[n] for n in range(4)))
