"""What light does between slide and sensor, each effect on its own. With none of them: a matt wall, one bounce, no
glass on the way, a lens that draws every colour alike."""

from dataclasses import dataclass

Colour = tuple[float, float, float]  # red, green, blue


@dataclass(frozen=True, slots=True)
class Tube:
    """A clear tube about the projector: inner radius and wall, mm; index; how far its axis leans from the slide's
    towards x and y. (One that is half a millimetre aside moves no ring by a thousandth.)"""

    inner_mm: float
    wall_mm: float
    index: float = 1.49  # PMMA
    lean_deg: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Effects:
    """
    bounces : of light on walls before it reaches the lens.
    alpha : roughness (Beckmann) of a dielectric skin over the wall, 0 for a matt wall without one; index : that skin's.
    scatter_mm : transport mean free path within the wall, 0 for light that leaves where it came in.
    curvature_px : sigma of the blur that a curved field adds at the picture's upper and lower edge; it grows with the
    square of the distance from the middle.
    lateral : by how much red and blue are magnified more than green, parts.
    dust : specks on the slide, each as large as a slit is wide or smaller.
    ghost : part of the light that comes back turned about the picture's middle; veil : part that is spread over all.
    """

    bounces: int = 1
    alpha: float = 0.0
    index: float = 1.5
    scatter_mm: float = 0.0
    tube: Tube | None = None
    curvature_px: float = 0.0
    lateral: tuple[float, float] = (0.0, 0.0)
    dust: int = 0
    ghost: float = 0.0
    veil: float = 0.0
