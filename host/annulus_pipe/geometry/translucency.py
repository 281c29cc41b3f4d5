"""Where light that entered a wall leaves it: how far along the pipe, by angle of incidence and colour.

Light of a ring meets the wall aslant. A share of what comes back left at the surface, where it came in. The rest was
bent into the wall (Snell), went on for some way before it was first scattered, and then wandered with no way preferred:
seen from outside it comes from about the place below which it was scattered first, farther down the pipe.

- First scattering: the way is exponential with mean `mean_free_mm`, and of it sin t = sin i / n lies along the pipe.
  That diffuse light is centred there is oblique-incidence reflectometry's relation (Wang and Jacques, Appl. Opt. 34
  (1995) 2362: shift = sin t / (mu_s' + 0.35 mu_a)); `mean_free_mm` is the reduced one, 1 / (mu_s' + 0.35 mu_a).
- Wandering: normal, with a sigma of `wander` mean free paths either way along the pipe.

So the kernel is a line of weight `surface_share` at 0, and an exponential blurred by a normal. Its mean is what a wide
blur shows of it; an edge seen sharply is steepest nearer to where light came in (`edge_shift_mm`).

When it breaks: a wall thinner than a few mean free paths (light is lost at its back), a stripe narrower than that
(both edges' light mixes), an edge of the wall itself (light leaves through a pocket's side).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import special

INDEX = 1.5  # of refraction: PE 1.51 to 1.54, PVC 1.53; 3 % of the shift
SHIFT_MAX_MM = 2.0  # of a wall in a file: five times that of PE without pigment; beyond it a wall is no surface
GRID = 1001  # places an edge's steepest slope is looked for at; a parabola between: 1e-6 of the exponential's mean
PARTS = 8  # normals an exponential is drawn as: 2 % off its density where blurred by its mean, as light wanders
BLUR_LEAST_MM = 1e-4  # of an edge: sharper than any light makes one


Triple = tuple[float, float, float]  # red, green, blue


@dataclass(frozen=True, slots=True)
class Translucency:
    """A wall that scatters. mean_free_mm : red, green, blue; 0 is opaque. surface_share : of the light that comes back,
    what left where it came in, 0..1. wander : see above, in mean free paths."""

    mean_free_mm: Triple
    surface_share: float = 0.0
    wander: float = 0.5
    index: float = INDEX

    def __post_init__(self) -> None:
        lengths = all(0.0 <= value < math.inf for value in (*self.mean_free_mm, self.wander))
        if not (lengths and 0.0 <= self.surface_share <= 1.0 <= self.index):
            raise ValueError("a share is 0..1, lengths are 0 or more, an index of refraction is 1 or more")


def incidence_rad(half_angle: float) -> float:
    """From the wall's normal, of a ring's light where projector and pipe have one axis."""
    return math.pi / 2 - half_angle


def along(wall: Translucency, incidence: float) -> FloatArray:
    """(3,) mm along the pipe that red, green and blue light goes on before it is scattered, in the mean.

    incidence : rad from the wall's normal."""
    return np.asarray(math.sin(incidence) / wall.index * np.array(wall.mean_free_mm))


def mean_shift_mm(wall: Translucency, incidence: float) -> FloatArray:
    """(3,) mm that the middle of what leaves the wall lies downstream of where it came in."""
    return np.asarray((1.0 - wall.surface_share) * along(wall, incidence))


def spread_mm(wall: Translucency, incidence: float) -> FloatArray:
    """(3,) mm, standard deviation along the pipe of where light leaves."""
    inside = 1.0 - wall.surface_share
    second = inside * (2.0 * along(wall, incidence) ** 2 + (wall.wander * np.array(wall.mean_free_mm)) ** 2)
    return np.asarray(np.sqrt(second - mean_shift_mm(wall, incidence) ** 2))


def edge_shift_mm(wall: Translucency, incidence: float, blur_mm: float) -> FloatArray:
    """(3,) mm that an edge's steepest slope moves downstream, where all that blurs it (lens, pixels, smoothing) has a
    sigma of `blur_mm` along the pipe: the mean shift where that is wide, less where it is narrow, nothing where it is
    nil and some light returns from the surface."""
    blur = max(blur_mm, BLUR_LEAST_MM)
    out = np.zeros(3)
    for c, (mean, free) in enumerate(zip(along(wall, incidence), wall.mean_free_mm, strict=True)):
        if mean <= 0.0:
            continue
        x = np.linspace(-0.01 * mean, 1.01 * mean, GRID)
        slope = wall.surface_share * _normal(x, blur)
        slope += (1.0 - wall.surface_share) * _exponential(x, mean, math.hypot(blur, wall.wander * free))
        top = int(np.clip(np.argmax(slope), 1, GRID - 2))
        before, at, after = slope[top - 1 : top + 2]
        bend = before - 2.0 * at + after
        step = 0.5 * (before - after) / bend if bend < 0.0 else 0.0
        out[c] = x[top] + float(np.clip(step, -0.5, 0.5)) * (x[1] - x[0])
    return out


def leaving(wall: Translucency, incidence: float) -> FloatArray:
    """(3, PARTS + 1, 3) of red, green and blue light: what leaves the wall as a sum of parts, each displaced along the
    pipe (mm), with its share of the light, and blurred by a sigma (mm). Mean and spread are the kernel's."""
    edges = np.arange(PARTS) / PARTS  # of equal shares of an exponential
    last = -np.log1p(-edges)
    left = (1.0 - edges) * last
    mean = PARTS * (left - np.append(left[1:], 0.0)) + 1.0
    square = (1.0 - edges) * last**2
    within = PARTS * (square - np.append(square[1:], 0.0)) + 2.0 * mean - mean**2
    out = np.zeros((3, PARTS + 1, 3))
    out[:, 0, 1] = wall.surface_share
    out[:, 1:, 1] = (1.0 - wall.surface_share) / PARTS
    for c, (way, free) in enumerate(zip(along(wall, incidence), wall.mean_free_mm, strict=True)):
        out[c, 1:, 0] = way * mean
        out[c, 1:, 2] = np.sqrt(way**2 * within + (wall.wander * free) ** 2)
    return out


def slit_shift_mm(shift_mm: FloatArray | Triple, colours: str) -> FloatArray:
    """(K,) of (3,) shifts of red, green and blue edges: what the middle of each slit moves by, of `colours` the stripes
    about them (K + 1), of which each slit has an edge of either side."""
    edges = np.asarray(shift_mm)[["RGB".index(colour) for colour in colours]]
    return np.asarray(0.5 * (edges[:-1] + edges[1:]))


def wall_from_dict(data: object) -> tuple[Triple, Triple | None]:
    """A calibration's section "wall": how far edges of red, green and blue light move, mm, and its sigma where it has
    one. Raises ValueError naming the key that is wrong."""
    if not isinstance(data, Mapping) or "translucency_mm" not in data:
        raise ValueError('"wall" must be an object with "translucency_mm"')
    return _of_colours(data, "translucency_mm"), _of_colours(data, "sigma_mm") if "sigma_mm" in data else None


def wall_to_dict(shift_mm: Triple, sigma_mm: Triple | None = None) -> dict[str, Any]:
    """Inverse of `wall_from_dict`."""
    fields = {"translucency_mm": shift_mm, "sigma_mm": sigma_mm}
    return {key: dict(zip("RGB", value, strict=True)) for key, value in fields.items() if value is not None}


def _of_colours(section: Mapping[str, Any], key: str) -> Triple:
    values, where = section[key], f"wall.{key}"
    if not isinstance(values, Mapping) or set(values) != set("RGB"):
        raise ValueError(f'"{where}" must be three numbers, mm, named R, G and B')
    red, green, blue = (untrusted.within(values[c], f'"{where}.{c}"', 0.0, SHIFT_MAX_MM) for c in "RGB")
    return red, green, blue


def _normal(x: FloatArray, sigma: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2.0 * math.pi)))


def _exponential(x: FloatArray, mean: float, sigma: float) -> FloatArray:
    """Density of an exponential of this mean blurred by a normal, written so that neither end overflows."""
    lag = sigma / mean - x / sigma
    near = (
        _normal(x, sigma)
        * math.sqrt(math.pi / 2.0)
        * sigma
        / mean
        * special.erfcx(np.maximum(lag, 0.0) / math.sqrt(2.0))
    )
    far = np.exp(np.minimum(0.5 * (sigma / mean) ** 2 - x / mean, 0.0)) * special.ndtr(-lag) / mean
    return np.asarray(np.where(lag >= 0.0, near, far))
