"""What the sensor head is made of, besides its camera: slide projector, LEDs, optics, rods."""

import math
from dataclasses import dataclass
from typing import ClassVar

from annulus_pipe.geometry.cone import Cone
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.measure import FringeProjector

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


@dataclass(frozen=True, slots=True)
class Fringe:
    """One slide of a sinusoid, in the head's frame. field_deg : of rings the half-angles where they begin and end, of
    stripes half the field across them and along. cameras : numbers of those that look at its light, slots : of the lamp
    cycle at which it is lit; none: all."""

    slide: FringeProjector
    field_deg: tuple[float, float]
    cameras: tuple[int, ...] = ()
    slots: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Fringes:
    """A projector, or several, of static sinusoids. reach_mm : from the light straight to a wall that gets the peak."""

    slides: tuple[Fringe, ...]
    reach_mm: float
    modulation: float = 0.85  # of the light on the wall, where the lens is sharp
    peak: float = 190.0  # grey levels above black on that wall, lit for its nominal time
    colour: tuple[float, float, float] = (0.95, 1.0, 0.9)
    nominal_us: float = 5000.0
    rings: ClassVar[int] = 0

    @property
    def innermost(self) -> float:
        """Half-angle to the pipe at which light begins, rad; of stripes, which look across it, a right angle's half."""
        rings = [one.field_deg[0] for one in self.slides if one.slide.kind == "rings"]
        return math.radians(min(rings, default=45.0))

    def lit(self, slot: int | None) -> int:
        """Number of the slide that is lit at a slot of the lamp cycle."""
        return next((k for k, one in enumerate(self.slides) if not one.slots or slot in one.slots), 0)


@dataclass(frozen=True, slots=True)
class Led:
    """White LEDs round the lens, seen as one point just behind it."""

    behind_mm: float = 4.0
    peak: float = 150.0  # grey levels above black on a white wall 45 mm ahead
    colour: tuple[float, float, float] = (0.96, 1.0, 0.97)
    nominal_us: float = 2500.0
    aside_mm: tuple[float, float] = (0.0, 0.0)  # of the lens: they stand about another middle, where cameras share them


@dataclass(frozen=True, slots=True)
class Optics:
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
