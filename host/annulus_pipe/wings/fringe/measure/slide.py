"""The slide of rings for a stated pipe: how dark it is at every radius (Alzuhiri 2022, §6.8.2.1, Figure 6.12 b).

Light at the half-angle a meets the wall of radius R at R / tan a ahead of the projector, so a wave of one period along
the wall is drawn at r = f tan a with phase 2 pi R f / (r period): finer towards the middle. The slide is printed as a
grey wedge; what the lens then blurs (`defocus`, the disc's diameter on the slide) lowers the finest rings' modulation
first and leaves their phase: said, not mended. A printer that knows black and clear only gets `is_dark`: bars, whose
harmonics the defocus takes out.
"""

import math
from dataclasses import dataclass

import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, FloatArray
from annulus_pipe.numeric.late import special
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure.projector import FringeProjector

STILL = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
FULL_MODULATION_LEAST = 0.2  # below it phase is noise in most pipes


@dataclass(frozen=True, slots=True)
class RingSlide:
    """projector : as calibration.json states it. inner_mm, outer_mm : of the slide. focal_mm : of its lens.
    defocus_mm : diameter of its blur's disc on the slide. wall_mm : where along the wall it begins and ends, ahead of
    the camera."""

    projector: FringeProjector
    focal_mm: float
    inner_mm: float
    outer_mm: float
    defocus_mm: float
    wall_mm: tuple[float, float]

    def phase(self, radius_mm: FloatArray) -> FloatArray:
        """(...) mm on the slide -> rad."""
        slide = self.projector
        rate = 2 * math.pi / slide.period * slide.nominal_radius_mm
        return np.asarray(rate * self.focal_mm / radius_mm + slide.phase0)

    def transmission(self, radius_mm: FloatArray) -> FloatArray:
        """(...) mm on the slide -> 0 .. 1, half a wave's mean; 0 outside the rings."""
        inside = (radius_mm >= self.inner_mm) & (radius_mm <= self.outer_mm)
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(inside, 0.5 + 0.5 * np.cos(self.phase(radius_mm)), 0.0)

    def is_dark(self, radius_mm: FloatArray) -> BoolArray:
        """(...) the same as bars."""
        return np.asarray(self.transmission(radius_mm) < 0.5)

    def modulation(self, radius_mm: FloatArray) -> FloatArray:
        """(...) what the defocus leaves of a ring's modulation, 0 .. 1: 2 J1(x) / x of a disc."""
        rate = np.abs(self.phase(radius_mm + 1e-6) - self.phase(radius_mm - 1e-6)) / 2e-6
        x = np.maximum(rate * self.defocus_mm / 2, 1e-9)
        return np.asarray(np.abs(2 * special.j1(x) / x))

    @property
    def rings(self) -> int:
        """Whole periods on the slide."""
        inner, outer = self.phase(np.array([self.inner_mm, self.outer_mm]))
        return int(abs(inner - outer) / (2 * math.pi))

    @property
    def finest_mm(self) -> float:
        """The least period on the slide."""
        slide = self.projector
        return self.inner_mm**2 * slide.period / (slide.nominal_radius_mm * self.focal_mm)


def ring_slide(
    pipe_radius_mm: float,
    period_mm: float,
    distance_mm: float,
    field_deg: tuple[float, float],
    focal_mm: float,
    defocus_mm: float = 0.0,
) -> RingSlide:
    """Rings whose phase is linear along the wall of a pipe of that radius.

    period_mm : of a fringe on the wall. distance_mm : of the projector behind the camera, on one axis. field_deg : half
    angles where the rings begin and end. focal_mm : of the slide's lens. AnnulusError for a field that is none, and
    where the defocus leaves nothing of the finest rings.
    """
    inner, outer = field_deg
    if not 0 < inner < outer < 90:
        raise AnnulusError(f"rings from {inner:g} to {outer:g} deg: expected two half-angles, rising, within 0 to 90")
    for value, what in (
        (pipe_radius_mm, "radius of the pipe"),
        (period_mm, "period on the wall"),
        (distance_mm, "distance of the projector"),
        (focal_mm, "focal length"),
    ):
        if not (math.isfinite(value) and value > 0):
            raise AnnulusError(f"the {what} is {value:g} mm, expected more than 0")
    slide = RingSlide(
        FringeProjector("rings", (0.0, 0.0, -distance_mm), STILL, period_mm, nominal_radius_mm=pipe_radius_mm),
        focal_mm,
        focal_mm * math.tan(math.radians(inner)),
        focal_mm * math.tan(math.radians(outer)),
        defocus_mm,
        (
            pipe_radius_mm / math.tan(math.radians(outer)) - distance_mm,
            pipe_radius_mm / math.tan(math.radians(inner)) - distance_mm,
        ),
    )
    if slide.rings < 2:
        raise AnnulusError(f"a period of {period_mm:g} mm leaves {slide.rings} rings in that field: expected 2 or more")
    left = float(slide.modulation(np.array([slide.inner_mm]))[0])
    if left < FULL_MODULATION_LEAST:
        raise AnnulusError(
            f"a defocus of {defocus_mm:g} mm leaves {100 * left:.0f} % of the innermost rings' modulation, expected "
            f"{100 * FULL_MODULATION_LEAST:.0f} % or more: a longer period, a wider inner angle, or sharper"
        )
    return slide
