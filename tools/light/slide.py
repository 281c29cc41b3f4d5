"""What a slide lets through, as a picture on the plane a unit before the projector, and dust on it.

Stripes are functions of the half-angle alone. A wall that scatters smears them along the pipe: what enters it leaves it
farther on, which for a wall at a known distance is a smear over half-angles (`smeared`).
"""

import math
from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tools.bench.blind.pipe import Head
from tools.light.effects import Colour

Array = NDArray[np.float64]
ANGLES = 6000  # of a table over half-angles; 0.0002 rad apart, a fiftieth of a slit
EDGE_OF_SLIT = 0.12  # of a slit's width: over which light goes to dark
TEXELS = 2048
OPEN = 1.06  # the picture is larger than the outermost stripe by this
SPECKS_OF_SLIT = (0.1, 0.6)  # radii of dust, of a slit's width


def stripes(head: Head) -> list[tuple[float, float, Colour]]:
    """(inner, outer) half-angle and colour of every stripe from the axis outwards."""
    first, last = head.slits[0][0] - head.margin_rad, head.slits[-1][1] + head.margin_rad
    inner = [first, *(outer for _, outer in head.slits)]
    outer = [*(inner for inner, _ in head.slits), last]
    dyes = {letter: head.dyes["RGB".index(letter)] for letter in "RGB"}
    return [(a, b, dyes[letter]) for a, b, letter in zip(inner, outer, head.colours, strict=True)]


def angles_of(head: Head) -> Array:
    """(ANGLES,) half-angles of a table that goes a little beyond the outermost stripe."""
    return np.linspace(0.0, 1.15 * (head.slits[-1][1] + head.margin_rad), ANGLES)


def transmission(head: Head, angles: Array) -> Array:
    """(N, 3) red, green, blue, 0..1, of half-angles."""
    soft = EDGE_OF_SLIT * (head.slits[0][1] - head.slits[0][0])
    light = np.zeros((len(angles), 3))
    for inner, outer, colour in stripes(head):
        inside = _step((angles - inner) / soft) * _step((outer - angles) / soft)
        light += inside[:, None] * np.array(colour)
    return light


def _step(x: Array) -> Array:
    """0 to 1 about 0, smoothly, within half of a unit to either side."""
    t = np.clip(x + 0.5, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def smeared(angles: Array, light: Array, radius_mm: float, parts: Callable[[float], tuple[Array, Array]]) -> Array:
    """The same light where it leaves a wall at `radius_mm`: parts(half-angle) gives displacements along the pipe (S,),
    mm, and weights (S, 3) of each colour."""
    along = radius_mm / np.tan(np.maximum(angles, 1e-3))
    out = np.zeros_like(light)
    nodes = np.linspace(angles[0], angles[-1], 24)
    for k, node in enumerate(nodes):  # a hat over half-angles: the smear changes slowly from ring to ring
        near = np.interp(angles, nodes, np.eye(len(nodes))[k])
        mine = near > 0.0
        shifts, weights = parts(float(node))
        total = np.zeros((int(mine.sum()), 3))
        for shift, weight in zip(shifts, weights, strict=True):
            came = np.arctan2(radius_mm, along[mine] - shift)
            total += weight * np.stack([np.interp(came, angles, light[:, c]) for c in range(3)], 1)
        out[mine] += near[mine, None] * total
    return out


def picture(
    angles: Array, light: Array, half_angle: float, came: Callable[[Array, Array], Array] | None = None
) -> NDArray[np.float32]:
    """(TEXELS, TEXELS, 3) of a table of light, as far as `half_angle`, x to the right and y down; a lens lights the
    plane less by the fourth power of the cosine. came(half-angle,
    azimuth) : the half-angle at the slide of what leaves there, if glass lies between."""
    edge = math.tan(half_angle)
    at = (np.arange(TEXELS) + 0.5) / TEXELS * 2.0 * edge - edge
    theta = np.arctan(np.hypot(at[None, :], at[:, None]))
    fall = (np.cos(theta) ** 4)[..., None]
    if came is not None:
        theta = came(theta, np.arctan2(at[:, None], at[None, :]))
    light = np.stack([np.interp(theta, angles, light[:, c], right=0.0) for c in range(3)], -1)
    return np.asarray(fall * light, np.float32)


def dusty(image: NDArray[np.float32], head: Head, half_angle: float, specks: int, rng: Generator) -> None:
    """Darkens round specks in place, evenly strewn over the lit part of the slide."""
    edge, slit = math.tan(half_angle), head.slits[0][1] - head.slits[0][0]
    at = (np.arange(TEXELS) + 0.5) / TEXELS * 2.0 * edge - edge
    least, most = (math.tan(one) for one in (head.slits[0][0] - head.margin_rad, head.slits[-1][1] + head.margin_rad))
    for _ in range(specks):
        away, turn = math.sqrt(rng.uniform(least**2, most**2)), rng.uniform(0.0, 2.0 * math.pi)
        size = slit * rng.uniform(*SPECKS_OF_SLIT)
        x, y = away * math.cos(turn), away * math.sin(turn)
        i, j = (slice(*np.searchsorted(at, (v - 1.5 * size, v + 1.5 * size))) for v in (y, x))
        distance = np.hypot(at[None, j] - x, at[i, None] - y)
        image[i, j] *= _step((distance - size) / (0.3 * size))[..., None].astype(np.float32)
