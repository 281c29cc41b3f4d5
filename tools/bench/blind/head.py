"""The head of a scene: lens, slide, rods, and how it travelled."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from tools.bench.blind.pipe import Head, Stand

WIDTHS, WIDTH_ODDS = (640, 832, 1024), (0.45, 0.45, 0.1)
LED_EVERY = 5  # four projector frames, one of the LED
FRAMES = (34, 42)
BACK, RESTS = 8, 6  # frames of a head that turns back and comes again, and of one that stands still
STEP_OF_RADIUS = (0.065, 0.095)  # of a head that loses no frame


@dataclass(frozen=True, slots=True)
class Reach:
    """Two stations; of a head: where ahead of its camera the outermost and the innermost ring fall in its pipe."""

    first: float
    last: float

    @property
    def near(self) -> float:
        return self.first

    @property
    def far(self) -> float:
        return self.last


def draw_head(rng: Generator, radius: float) -> Head:
    """A camera before its projector, both about the pipe's axis, the slits evenly apart in the picture."""
    width = int(rng.choice(WIDTHS, p=WIDTH_ODDS))
    height = round(width * 0.74)
    model = str(rng.choice(["pinhole", "fisheye"], p=[0.8, 0.2]))
    near, far = rng.uniform(0.8, 1.15), rng.uniform(1.8, 2.5)  # of the radius
    behind = rng.uniform(0.6, 0.9) * radius
    fills = rng.uniform(0.34, 0.41) * height  # the outermost ring's radius in the picture
    widest = math.atan(1.0 / near)
    focal = fills * near if model == "pinhole" else fills / widest
    slits = int(rng.integers(5, 8))
    half_px = rng.uniform(2.2, 3.2) * width / 832
    innermost = focal / far if model == "pinhole" else focal * math.atan(1.0 / far)
    middles = np.linspace(innermost, fills, slits)

    def angle(px: float) -> float:
        """Half-angle at the projector of what falls so far from the picture's middle, in a straight pipe."""
        view = math.atan(px / focal) if model == "pinhole" else px / focal
        return math.atan2(radius, radius / math.tan(view) + behind)

    off = rng.uniform(-6.0, 6.0, 2) if model == "pinhole" else (0.0, 0.0)  # POV-Ray has its fisheye in the middle
    centre = (width - 1) / 2 + off[0], (height - 1) / 2 + off[1]
    aside = rng.normal(0.0, 0.012, 2) * radius
    axis = np.array([*rng.normal(0.0, 0.012, 2), 1.0])
    axis /= np.linalg.norm(axis)
    dyes = np.array([[1.0, 0.05, 0.03], [0.06, 0.9, 0.12], [0.03, 0.12, 0.85]]) * rng.uniform(0.85, 1.15, (3, 3))
    turn = rng.uniform(0.0, 120.0)
    count = int(rng.choice([0, 3, 3, 4]))
    rods = tuple(
        (float(turn + 360.0 * k / max(count, 1)), float(0.2 * radius), float(rng.uniform(0.008, 0.013) * radius))
        for k in range(count)
    )
    return Head(
        width,
        height,
        model,
        float(focal),
        (float(centre[0]), float(centre[1])),
        (float(aside[0]), float(aside[1]), float(-behind)),
        (float(axis[0]), float(axis[1]), float(axis[2])),
        tuple((angle(px - half_px), angle(px + half_px)) for px in middles),
        _word(rng, slits + 1),
        float(math.radians(rng.uniform(2.5, 4.5))),
        tuple((float(a), float(b), float(c)) for a, b, c in dyes),
        rods,
    )


def _word(rng: Generator, stripes: int) -> str:
    """Colours in a row of which no two neighbours occur twice in their order."""
    while True:
        word = "".join(rng.choice(list("RGB"), stripes))
        pairs = [word[i : i + 2] for i in range(stripes - 1)]
        if len(set(pairs)) == len(pairs) and len(set(word)) == 3:
            return word


def reach_of(head: Head, radius: float) -> Reach:
    """Where the rings fall ahead of the camera, mm."""
    inner, outer = (sum(head.slits[k]) / 2 for k in (0, -1))
    return Reach(radius / math.tan(outer) + head.vertex_mm[2], radius / math.tan(inner) + head.vertex_mm[2])


def draw_stands(rng: Generator, radius: float, marks: tuple[str, ...]) -> tuple[Stand, ...]:
    """Every frame's place: it goes ahead, leans, and as `marks` say stands still, turns back or loses frames."""
    frames = int(rng.integers(*FRAMES)) + (BACK if "backward" in marks else 0) + (RESTS if "still" in marks else 0)
    step = rng.uniform(*STEP_OF_RADIUS) * radius
    going = np.ones(frames - 1)
    if "still" in marks:
        first = int(rng.integers(5, frames - 12))
        going[first : first + RESTS] = 0.0
    if "backward" in marks:
        first = int(rng.integers(12, frames - 8))
        going[first : first + BACK // 2] = -1.0
    z = np.concatenate([[0.0], np.cumsum(going * step)])
    lean = math.radians(rng.uniform(2.0, 4.0) if "leaning" in marks else rng.uniform(0.2, 1.5))
    aside = rng.uniform(0.01, 0.05) * radius
    wave = rng.uniform(0.4, 1.4, 4) * radius
    phase = rng.uniform(0.0, 2.0 * math.pi, 4)
    constant = rng.normal(0.0, 0.4, 4)
    sway = 0.7 * np.sin(2 * math.pi * z[:, None] / wave + phase) + constant
    error = np.cumsum(rng.normal(0.0, 2e-4 * radius, frames) * (going != 0).astype(float)[[0, *range(frames - 1)]])
    keep = np.ones(frames, bool)
    if "lost" in marks:
        every = int(rng.choice([2, 3]))
        keep = np.arange(frames) % every != 1 if every == 3 else np.arange(frames) % 2 == 0
    stands = []
    for i in np.flatnonzero(keep):
        lamp = "led" if i % LED_EVERY == LED_EVERY - 1 else "projector"
        rx, ry, tx, ty = sway[i] * (lean, lean, aside, aside)
        done = i / (frames - 1)
        reported = z[i] + error[i]
        stands.append(
            Stand(int(i), lamp, *(float(v) for v in (z[i], reported, rx, ry, tx - lean_aside(ry, radius), ty, done)))
        )
    return tuple(stands)


def lean_aside(angle: float, radius: float) -> float:
    """A head on wheels leans about its middle, which is behind its camera."""
    return 0.5 * radius * math.tan(angle)
