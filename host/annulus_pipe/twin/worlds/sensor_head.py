"""What the sensor head is made of, besides its camera: slide projector, LEDs, optics, rods."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.vocabulary import AnnulusError

Response = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True, slots=True)
class Projector:
    """The slide: cones of the slits (camera frame), their half-widths and the stripes' colours, inside to outside.

    `margin_deg`: how far the innermost and outermost stripe reach beyond the outer slits. `response`[c] is what the
    red, green and blue pixels see of stripe colour c: filters of slide and sensor overlap. With a `line` it is turned
    about: the slits are lit, in that one colour, and the stripes dark, as a laser's rings or planes are.
    """

    cones: tuple[Cone, ...]
    slit_half_deg: tuple[float, ...]
    colours: str = "RRGBGR"
    margin_deg: tuple[float, float] = (2.25, 2.25)
    peak: float = 225.0  # grey levels above black on the outermost stripe, lit for its nominal time
    leak: float = 0.006  # of a stripe's light through a slit
    response: Response = ((1.0, 0.05, 0.04), (0.045, 1.0, 0.05), (0.03, 0.055, 0.75))
    nominal_us: float = 5000.0  # on-time that gives `peak`
    line: tuple[float, float, float] | None = None  # what red, green and blue pixels see of bright rings: see below

    def __post_init__(self) -> None:
        slits = len(self.cones)
        if len(self.slit_half_deg) != slits or len(self.colours) != slits + 1:
            raise AnnulusError(f"world: {slits} cones need {slits} slit widths and {slits + 1} stripe colours")

    @property
    def rings(self) -> int:
        """How many a profile may have."""
        return len(self.cones)

    @property
    def innermost(self) -> float:
        """Half-angle at which light begins, rad."""
        return self.cones[0].half_angle - math.radians(self.margin_deg[0])


class WingLight(Protocol):
    """A projector that a wing brings (`lights` of hooks.py), in place of a slide of slits: a dataclass.
    peak : grey levels above black, lit for nominal_us."""

    rings: ClassVar[int]

    @property
    def nominal_us(self) -> float: ...
    @property
    def peak(self) -> float: ...
    @property
    def innermost(self) -> float:
        """Half-angle to the pipe at which light begins, rad."""

    @property
    def turns(self) -> int:
        """Slides that are lit in turn: at slot s of the lamp cycle slide s modulo so many. 1: all, by every flash."""

    def lit(self, slot: int | None) -> int:
        """Number of the slide that is lit at a slot."""

    def looking(self, slot: int) -> tuple[int, ...]:
        """Numbers of the cameras that see its light at a slot; none: all."""

    def drawn(self) -> tuple[Any, ...]:
        """Its slides, as twin.lights.slide wants them."""

    def calibration(self, world: Any) -> Calibration:
        """What a perfect calibration of a head with it would hold."""


@dataclass(frozen=True, slots=True)
class Led:
    """White LEDs round the lens, seen as one point just behind it."""

    behind_mm: float = 4.0
    peak: float = 150.0  # grey levels above black on a white wall 45 mm ahead
    colour: tuple[float, float, float] = (0.96, 1.0, 0.97)
    nominal_us: float = 2500.0
    aside_mm: tuple[float, float] = (0.0, 0.0)  # of the lens: they stand about another middle, where cameras share them


@dataclass(frozen=True, slots=True)
class CameraOptics:
    """Lens blur (sigma, pixels of the full-size camera) and the sensor's noise, in 8-bit grey levels.

    `balance`: white-balance gains red, green, blue, applied to light and noise before the black level is added and
    the pixel is cut off at full scale.
    """

    blur_px: float = 1.1
    black: float = 2.0
    read: float = 1.5
    shot: float = 0.03  # variance per grey level
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0)
    half_field_deg: float = 90.0  # the lens lets nothing by from further off its axis


@dataclass(frozen=True, slots=True)
class Rod:
    """A bar that holds the projector behind the camera, parallel to the optical axis; it shadows what lies past it."""

    x_mm: float
    y_mm: float
    radius_mm: float = 1.0
    z0_mm: float = -56.0
    z1_mm: float = 0.0
