"""A projector's pattern designed for a head and its pipes: which colours, which angles, what it takes to see them."""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.vocabulary import AnnulusError

# STRIPE_PX by test_pattern from both sides. The others are room left on purpose: twice as much fails no
# test: unguarded.
STRIPES_MAX = 65  # of a calibration
STRIPE_PX = 5.0  # narrower, a stripe's colour is lost in its slits' blur
MARGIN_PX = 10.0  # that the outermost stripe keeps from the image's edge
CLEAR = 1.03  # of the limit angles: room for tolerances
REACH = 3.0  # pipe radii ahead that the innermost stripe falls at when not told
BLACK = 0.02  # of full light, of the preview's slits
STRIPE = {"R": (0.9, 0.04, 0.02), "G": (0.04, 0.8, 0.1), "B": (0.02, 0.08, 0.75)}  # .. and its stripes


@dataclass(frozen=True, slots=True)
class PatternHead:
    """What the pattern has to suit. Diameters of the pipes it is for, mm; `nominal_mm`: the one in which stripes are
    of one width. `distance_mm`: projector behind camera (d_t), `sensor_radius_mm` (R_sen) and `glass_mm`, the length
    of the clear tube (d_g), Alzuhiri 2022, §3.2.3."""

    camera: Camera
    least_mm: float
    most_mm: float
    nominal_mm: float
    distance_mm: float
    sensor_radius_mm: float
    glass_mm: float


@dataclass(frozen=True, slots=True)
class RingPattern:
    """Stripes from the innermost outwards; half-angles in radians at the projector."""

    head: PatternHead
    colours: str
    word: int  # as many neighbouring stripes occur once
    inner: tuple[float, ...]  # inner edge of each stripe
    outer: tuple[float, ...]
    stripe_px: float  # in the nominal pipe
    slit_px: float

    @property
    def slits(self) -> tuple[float, ...]:
        """Half-angle of each slit's cone: the middle of its edges' angles, as the slit finder has it."""
        return tuple((a + b) / 2 for a, b in zip(self.outer, self.inner[1:], strict=False))

    def calibration(self) -> Calibration:
        """What a head built without a fault would be calibrated to: all cones about the optical axis, one vertex."""
        axis, vertex = (0.0, 0.0, 1.0), (0.0, 0.0, -self.head.distance_mm)
        cones = tuple(Cone(angle, axis, vertex) for angle in self.slits)
        return Calibration(self.head.camera, self.colours, cones, self.head.nominal_mm / 2)

    def radii_mm(self, focal_mm: float) -> list[tuple[str, float, float]]:
        """(colour, inner, outer) radius of each stripe on the slide behind a lens of this focal length."""
        edges = zip(self.colours, self.inner, self.outer, strict=True)
        return [(colour, focal_mm * math.tan(a), focal_mm * math.tan(b)) for colour, a, b in edges]

    def widths_px(self, diameter_mm: float) -> FloatArray:
        """(N,) width of each stripe in the image, in a pipe of this diameter."""
        r = diameter_mm / 2
        inner, outer = (
            _seen_px(self.head.camera, r, r / np.tan(edge) - self.head.distance_mm)
            for edge in (np.array(self.inner), np.array(self.outer))
        )
        return np.asarray(outer - inner)

    def to_dict(self) -> dict[str, Any]:
        head = self.head
        limit = 2 * math.degrees(math.atan(head.sensor_radius_mm / head.glass_mm))
        return {
            "colours": self.colours,
            "word": self.word,
            "stripes": len(self.colours),
            "slits": len(self.slits),
            "slit_full_deg": [2 * math.degrees(a) for a in self.slits],
            "inner_full_deg": 2 * math.degrees(self.inner[0]),
            "outer_full_deg": 2 * math.degrees(self.outer[-1]),
            "stripe_px": self.stripe_px,
            "slit_px": self.slit_px,
            "limits": {
                "inner_full_deg_above": limit,
                "distance_mm": head.distance_mm,
                "distance_mm_below": _distance_limit(head, self.outer[-1]),
            },
            "pipes": [
                {
                    "diameter_mm": diameter,
                    "ahead_mm": [
                        diameter / 2 / math.tan(a) - head.distance_mm for a in (self.outer[-1], self.inner[0])
                    ],
                    "stripe_px": [float(v) for v in (self.widths_px(diameter).min(), self.widths_px(diameter).max())],
                }
                for diameter in sorted({head.least_mm, head.nominal_mm, head.most_mm})
            ],
        }


def de_bruijn(letters: str, word: int) -> str:
    """A cyclic sequence of k^n letters in which every word of n letters occurs once (Alzuhiri 2022, §3.2.2).

    Words are the edges between shorter words, the sequence a closed walk over all of them. With three letters it
    begins with the sequence for n - 1, so that its first stripes can be told apart by shorter words already.
    """
    if word == 1:
        return letters
    for first in (de_bruijn(letters, word - 1), ""):
        start = first[: word - 1] or letters[0] * (word - 1)
        used = {(first + first)[i : i + word] for i in range(len(first))}
        walk, node = [], start
        left = {"".join(w) for w in product(letters, repeat=word)} - used
        ahead: list[tuple[str, str]] = [(start, "")]
        while ahead:  # Hierholzer: go on while there is a way, then back, writing down
            node = ahead[-1][0]
            way = next((node + c for c in reversed(letters) if node + c in left), None)
            if way is None:
                walk.append(ahead.pop()[1])
            else:
                left.remove(way)
                ahead.append((way[1:], way[-1]))
        if not left:
            turned = first[word - 1 :] + first[: word - 1]
            both = turned + "".join(reversed(walk))
            return both[-(word - 1) :] + both[: -(word - 1)]
    raise AssertionError("the graph of all words is connected")


def stripe_colours(letters: str, word: int, stripes: int | None = None) -> str:
    """So many stripes, or k^n, in which no word occurs twice; black slits let equal neighbours stand.

    Of all stretches of the sequence, the one in which most pairs occur only once (a slit that shows such a pair is
    read alone), then the one whose colours are used most evenly.
    """
    if not 2 <= len(letters) <= 3 or len(set(letters)) != len(letters) or set(letters) - set("RGB"):
        raise AnnulusError(f'colours "{letters}", expected two or three of the letters R, G, B')
    if not 2 <= word <= 6:
        raise AnnulusError(f"word length {word}, expected 2 to 6")
    ring = de_bruijn(letters, word)
    most = min(len(ring), STRIPES_MAX)
    count = most if stripes is None else stripes
    if not 2 <= count <= most:
        raise AnnulusError(
            f"{count} stripes, but words of {word} from {len(letters)} colours make {len(ring)} at most"
            + (f", a calibration holds {STRIPES_MAX}" if most < len(ring) else "")
            + f". Expected 2 to {most}."
        )
    stretches = [(ring + ring)[i : i + count] for i in range(len(ring))]

    def worth(stretch: str) -> tuple[int, int]:
        pairs = [stretch[i : i + 2] for i in range(count - 1)]
        return sum(pairs.count(p) == 1 for p in pairs), -max(stretch.count(c) for c in letters)

    return max(stretches, key=worth)


def design(
    head: PatternHead,
    colours: str,
    word: int,
    *,
    slit_px: float = 8.0,
    inner_full_deg: float | None = None,
    outer_full_deg: float | None = None,
) -> RingPattern:
    """Stripes of one width in the image of the nominal pipe, between the innermost and the outermost angle.

    Angles not given are chosen: the inner one clear of the sensor's body and no more than 3 pipe radii ahead, the
    outer one as wide as the camera still sees all round in the smallest pipe. Raises AnnulusError that names the limit
    which is broken and what would mend it. Alzuhiri 2022, Eq. 3.2, 3.3 (full angles there, half-angles here).
    """
    _check(head)
    camera, radius = head.camera, head.nominal_mm / 2
    clear = math.atan(head.sensor_radius_mm / head.glass_mm)
    widest = _widest(head)
    inner = (
        max(CLEAR * clear, math.atan(radius / (REACH * radius + head.distance_mm)))
        if inner_full_deg is None
        else math.radians(inner_full_deg / 2)
    )
    outer = widest / CLEAR if outer_full_deg is None else math.radians(outer_full_deg / 2)
    if inner <= clear:
        needed = head.sensor_radius_mm / math.tan(inner)
        raise AnnulusError(
            f"the innermost stripe, {2 * math.degrees(inner):.1f} deg, is blocked by the sensor's body: at least "
            f"{2 * math.degrees(clear):.1f} deg with {head.sensor_radius_mm:g} mm radius and {head.glass_mm:g} mm of "
            f"glass (Eq. 3.3). Widen it, or make the glass {needed:.0f} mm long."
        )
    if outer > widest * (1 + 1e-9):
        raise AnnulusError(
            f"the outermost stripe, {2 * math.degrees(outer):.1f} deg, leaves the image at {head.least_mm:g} mm: "
            f"the camera may be {_distance_limit(head, outer):.1f} mm from the projector, it is {head.distance_mm:g} "
            f"(Eq. 3.2). Bring it nearer, or end the pattern at {2 * math.degrees(widest):.1f} deg."
        )
    if inner >= outer:
        raise AnnulusError(
            f"no room for a pattern: it must begin at {2 * math.degrees(inner):.1f} deg (Eq. 3.3) and end at "
            f"{2 * math.degrees(outer):.1f} (Eq. 3.2). A wider lens, a slimmer body, or a shorter distance."
        )
    ends = _seen_px(camera, radius, radius / np.tan(np.array([inner, outer])) - head.distance_mm)
    stripes = len(colours)
    stripe_px = (ends[1] - ends[0] - (stripes - 1) * slit_px) / stripes
    if stripe_px < STRIPE_PX:
        fit = int((ends[1] - ends[0] + slit_px) / (STRIPE_PX + slit_px))
        raise AnnulusError(
            f"{stripes} stripes with {slit_px:g} px slits leave {stripe_px:.1f} px a stripe between "
            f"{2 * math.degrees(inner):.1f} and {2 * math.degrees(outer):.1f} deg, expected at least {STRIPE_PX:g}. "
            f"At most {max(fit, 0)} stripes fit: fewer, narrower slits, or a wider range of angles."
        )
    starts = ends[0] + np.arange(stripes) * (stripe_px + slit_px)
    inside, outside = (_angle(head, radius, edge) for edge in (starts, starts + stripe_px))
    return RingPattern(
        head,
        colours,
        word,
        tuple(float(a) for a in inside),
        tuple(float(a) for a in outside),
        float(stripe_px),
        slit_px,
    )


def preview(pattern: RingPattern, diameter_mm: float, every: int = 2) -> NDArray[np.uint8]:
    """(H, W, 3) RGB: what the camera sees, centred in a clean pipe; one pixel in `every`."""
    camera, r = pattern.head.camera, diameter_mm / 2
    x, y = np.arange(0, camera.width, every), np.arange(0, camera.height, every)
    rays = camera.rays(np.stack(np.meshgrid(x, y), axis=2).reshape(-1, 2).astype(float))
    across = np.hypot(rays[:, 0], rays[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        ahead = r * rays[:, 2] / across
        angle = np.arctan2(r, ahead + pattern.head.distance_mm)
    out = np.full((len(rays), 3), BLACK)
    fall = np.clip((r / np.hypot(r, np.nan_to_num(ahead, posinf=1e6))) ** 2 * 2.2, 0.25, 1.0)
    for colour, inner, outer in zip(pattern.colours, pattern.inner, pattern.outer, strict=True):
        lit = (angle >= inner) & (angle <= outer)
        out[lit] = np.array(STRIPE[colour]) * fall[lit, None]
    return np.asarray(np.rint(255 * out.reshape(len(y), len(x), 3)), np.uint8)


def _check(head: PatternHead) -> None:
    if head.camera.model == "mirror":
        raise AnnulusError("pattern design knows cameras that look ahead; this one looks at a mirror")
    for what, value in (
        ("distance", head.distance_mm),
        ("sensor radius", head.sensor_radius_mm),
        ("glass length", head.glass_mm),
    ):
        if not 0 < value < 1e4:
            raise AnnulusError(f"{what} is {value:g} mm, expected more than 0")
    if not 0 < head.least_mm <= head.nominal_mm <= head.most_mm < 1e4:
        raise AnnulusError(
            f"pipes of {head.least_mm:g} to {head.most_mm:g} mm, nominal {head.nominal_mm:g}: expected rising diameters"
        )
    if head.least_mm / 2 <= head.sensor_radius_mm:
        raise AnnulusError(
            f"a sensor of {2 * head.sensor_radius_mm:g} mm does not go into a pipe of {head.least_mm:g} mm"
        )


def _view(camera: Camera) -> float:
    """Half of the viewing angle in which a circle about the principal point is seen whole, rad."""
    reach = min(camera.cx, camera.cy, camera.width - 1 - camera.cx, camera.height - 1 - camera.cy) - MARGIN_PX
    if reach < 20:
        raise AnnulusError("camera: the principal point lies at the image's edge, no ring would be seen whole")
    edges = camera.rays(np.array([[camera.cx + reach, camera.cy], [camera.cx, camera.cy + reach]]))
    angle = np.arctan2(np.hypot(edges[:, 0], edges[:, 1]), edges[:, 2])
    if not np.isfinite(angle).all():
        raise AnnulusError(
            "camera: the lens model ends inside the image, it cannot tell what the pattern would look like"
        )
    return float(angle.min())


def _widest(head: PatternHead) -> float:
    """Half-angle of the outermost edge that is still seen all round in the smallest pipe."""
    r = head.least_mm / 2
    return math.atan2(r, r / math.tan(_view(head.camera)) + head.distance_mm)


def _distance_limit(head: PatternHead, outer: float) -> float:
    r = head.least_mm / 2
    return r / math.tan(outer) - r / math.tan(_view(head.camera))


def _seen_px(camera: Camera, radius_mm: float, ahead_mm: FloatArray) -> FloatArray:
    """(N,) pixels from the principal point at which the wall so far ahead is seen."""
    points = np.stack([np.full_like(ahead_mm, radius_mm), np.zeros_like(ahead_mm), ahead_mm], axis=1)
    return np.asarray(np.linalg.norm(camera.project(points) - [camera.cx, camera.cy], axis=1))


def _angle(head: PatternHead, radius_mm: float, seen_px: FloatArray) -> FloatArray:
    """(N,) half-angle at the projector of the wall seen so far from the principal point."""
    rays = head.camera.rays(np.stack([head.camera.cx + seen_px, np.full_like(seen_px, head.camera.cy)], axis=1))
    ahead = radius_mm * rays[:, 2] / np.hypot(rays[:, 0], rays[:, 1])
    return np.asarray(np.arctan2(radius_mm, ahead + head.distance_mm))
