"""A slide of fringes carried past a plate, calibrated on a plate at known heights, and what it says of the heights.

Pixels' rays meet a relief of slabs, caps and grooves under a soft texture; the slide's phase is of the tangent, bent
by its lens, its wave a bar's with what blur leaves of the harmonics; light falls off; steps are uneven, the stage's
reading has its own error. The whole way of a user: `annulus calibrate fringe` on the reference, then the scan to
heights.
"""

import json
import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.fringe.calibrate_plate import calibrate_fringe, save_fringe
from annulus_pipe.wings.fringe.job import open_fringe
from annulus_pipe.wings.fringe.measure.plate import Plate
from annulus_pipe.wings.fringe.plate import reconstruct_fringe
from tools.bench.blind.others.tally import Case
from tools.bench.blind.score import Number

WIDTH, HEIGHT = 480, 360
REFERENCE_MM = (-4.0, -2.3, -1.1, -0.4, 0.0, 0.5, 1.3, 2.6, 4.2)  # uneven: they tell the fringes' order
EVERY = 11  # cells of which one is held against the truth
EDGE_MM = 1.5  # of a slab's or groove's edge
TEXTURE_MM = 0.5  # a sample of the texture
LEAST_MM = 0.15  # a thing lower than that need not be seen


@dataclass(slots=True)
class Thing:
    """kind slab, cap or groove; where, half length and half width, mm; turn in rad; height towards the head, mm."""

    kind: str
    x: float
    y: float
    length: float
    width: float
    turn: float
    height: float

    def own(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        c, s = math.cos(self.turn), math.sin(self.turn)
        return (c * (x - self.x) + s * (y - self.y)) / self.length, (c * (y - self.y) - s * (x - self.x)) / self.width

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = self.own(x, y)
        if self.kind == "cap":
            return self.height * np.clip(1 - u**2 - v**2, 0, None)
        if self.kind == "groove":
            return -self.height * (np.abs(u) < 1) * np.clip(1 - np.abs(v), 0, None)
        soft = 0.1  # mm: no edge is sharper
        return (
            self.height
            * np.clip((1 - np.abs(u)) * self.length / soft, 0, 1)
            * np.clip((1 - np.abs(v)) * self.width / soft, 0, 1)
        )

    def near(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = self.own(x, y)
        away = np.maximum((np.abs(u) - 1) * self.length, (np.abs(v) - 1) * self.width)
        return (np.abs(away) < EDGE_MM) | ((self.kind == "groove") & (away < EDGE_MM))


@dataclass(slots=True)
class Head:
    """Lengths in mm, of the first camera's frame; bends of lens and slide are parts at a tangent of one, cubed."""

    focal: float
    distance: float
    bend: float
    second: float  # how far the second camera stands along x, 0 without one
    slide_at: np.ndarray
    slide_turn: np.ndarray
    period: float
    slide_bend: float
    wave: tuple[float, float, float]  # modulation, second and third harmonic
    phase0: float

    def phase(self, points: np.ndarray) -> np.ndarray:
        own = (points - self.slide_at) @ self.slide_turn.T
        x, y = own[..., 0] / own[..., 2], own[..., 1] / own[..., 2]
        return 2 * math.pi / self.period * x * (1 + self.slide_bend * (x * x + y * y)) + self.phase0


def draw(rng: np.random.Generator) -> tuple[Head, list[Thing]]:
    distance = rng.uniform(80, 130)
    focal = rng.uniform(0.65, 0.95) * WIDTH
    baseline = rng.uniform(0.18, 0.4) * distance
    turn = cv2.Rodrigues(np.array([rng.normal(0, 0.02), -math.atan(baseline / distance) * rng.uniform(0, 0.8), 0.0]))[0]
    head = Head(
        focal,
        distance,
        rng.uniform(-0.15, 0.05),
        rng.uniform(0.25, 0.4) * distance if rng.random() < 0.4 else 0.0,
        np.array([baseline, rng.normal(0, 1.0), rng.normal(0, 3.0)]),
        np.asarray(turn).T,
        rng.uniform(0.025, 0.05),
        rng.normal(0, 0.004) if rng.random() < 0.6 else 0.0,
        (rng.uniform(0.4, 0.8), rng.normal(0, 0.04), rng.normal(0, 0.04)),
        rng.uniform(0, 2 * math.pi),
    )
    wide, high = 0.5 * WIDTH * distance / focal, 0.5 * HEIGHT * distance / focal
    things = []
    for _ in range(6):
        kind = str(rng.choice(["slab", "cap", "groove"]))
        length, width = rng.uniform(4, 12), rng.uniform(0.3, 1.0) if kind == "groove" else rng.uniform(4, 10)
        tall = rng.uniform(0.1, 1.0) if kind == "groove" else rng.uniform(0.1, 2.5) * rng.choice([-1, 1])
        things.append(
            Thing(
                kind,
                rng.uniform(-0.6, 0.9) * wide,
                rng.uniform(-0.7, 0.7) * high,
                length,
                width,
                rng.uniform(0, math.pi),
                float(tall),
            )
        )
    return head, things


def relief(things: list[Thing], x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sum([thing.at(x, y) for thing in things], axis=0) if things else np.zeros_like(x)


class Studio:
    """Takes pictures of a plate with a head."""

    def __init__(self, head: Head, rng: np.random.Generator) -> None:
        self.head, self.rng = head, rng
        self.noise, self.blur = rng.uniform(0.4, 2.0), rng.uniform(0.5, 0.9)
        self.centre = (WIDTH - 1) / 2 + rng.uniform(-4, 4), (HEIGHT - 1) / 2 + rng.uniform(-4, 4)
        v, u = (np.mgrid[: 2 * HEIGHT, : 2 * WIDTH] + 0.5) / 2 - 0.5
        bent_x, bent_y = (u - self.centre[0]) / head.focal, (v - self.centre[1]) / head.focal
        x, y = bent_x.copy(), bent_y.copy()
        for _ in range(12):
            scale = 1 + head.bend * (x * x + y * y)
            x, y = bent_x / scale, bent_y / scale
        self.tangent = x, y
        rough = gaussian_filter(rng.standard_normal((400, 400)), rng.uniform(1.0, 6.0), mode="wrap")
        self.texture = 1 + rng.uniform(0.02, 0.25) * rough / rough.std()

    def picture(self, things: list[Thing], height_mm: float, moved_mm: float, camera: int) -> np.ndarray:
        """One camera's picture of the plate, with the head that far along x."""
        head, (tx, ty) = self.head, self.tangent
        aside = head.second if camera else 0.0
        z = np.full_like(tx, head.distance - height_mm)
        for _ in range(4 if things else 0):
            z = head.distance - height_mm - relief(things, tx * z + aside + moved_mm, ty * z)
        x, y = tx * z + aside, ty * z
        points = np.stack([x, y, z], axis=-1)
        phase = head.phase(points)
        modulation, second, third = head.wave
        light = 1 + modulation * (np.cos(phase) + second * np.cos(2 * phase) + third * np.cos(3 * phase))
        away = np.linalg.norm(points - head.slide_at, axis=-1)
        light *= (head.distance / away) ** 2 * (z / away)
        index = [np.round(one / TEXTURE_MM).astype(int) % 400 for one in (y, x + moved_mm)]
        light *= np.clip(self.texture[index[0], index[1]], 0.2, None)
        grey = cv2.GaussianBlur(light.reshape(HEIGHT, 2, WIDTH, 2).mean(axis=(1, 3)), (0, 0), self.blur)
        grey = 4 + 85 * grey / (1 + modulation) * 1.3
        noise = self.noise * np.sqrt(np.clip(grey, 1, None) / 80) * self.rng.standard_normal(grey.shape)
        return np.clip(np.round(grey + noise), 0, 255).astype(np.uint8)


def write(folder: Path, studio: Studio, stands: list[tuple[list[Thing], float, float, float]]) -> None:
    """stands : things, the plate's height, the head's true place, and what the stage says."""
    (folder / "frames").mkdir(parents=True, exist_ok=True)
    lines = ["index,camera,file,light,x_mm,height_mm"]
    for k, (things, height, place, reported) in enumerate(stands):
        for camera in range(2 if studio.head.second else 1):
            name = f"frames/{k:03d}-{camera}.png"
            cv2.imwrite(str(folder / name), studio.picture(things, height, place, camera))
            lines.append(f"{k},{camera},{name},projector,{reported:.4f},{height:.4f}")
    (folder / "frames.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")


def cameras(studio: Studio) -> dict[str, object]:
    head = studio.head
    lens = {
        "model": "pinhole",
        "width": WIDTH,
        "height": HEIGHT,
        "fx": head.focal,
        "fy": head.focal,
        "cx": studio.centre[0],
        "cy": studio.centre[1],
        "distortion": [head.bend, 0, 0, 0, 0],
        "rotation": np.eye(3).tolist(),
    }
    all_of_them = [{**lens, "id": 0, "translation_mm": [0, 0, 0]}]
    if head.second:
        all_of_them.append({**lens, "id": 1, "translation_mm": [-head.second, 0, 0]})
    return {
        "format": "annulus-calibration/2",
        "cameras": all_of_them,
        "motion": [1.0, 0.0, 0.0],
        "distance_mm": head.distance,
        "transfer": {"sensor": "linear", "black": 4},
        "pattern": {"kind": "fringe"},
    }


def measured(seed: int, folder: Path) -> Case:
    rng = np.random.default_rng([seed, 95])
    head, things = draw(rng)
    studio = Studio(head, rng)
    frames = int(rng.integers(8, 15))
    fringe = head.period * head.distance
    step = fringe * rng.uniform(0.12, 0.3)
    place = np.concatenate([[0.0], np.cumsum(step * rng.uniform(0.6, 1.4, frames - 1))])
    reported = place * (1 + rng.normal(0, 0.002)) + np.concatenate([[0.0], rng.normal(0, 0.015, frames - 1)])
    write(folder / "reference", studio, [([], h, 0.0, 0.0) for h in REFERENCE_MM])
    write(folder / "scan", studio, [(things, 0.0, float(a), float(b)) for a, b in zip(place, reported, strict=True)])
    prior = folder / "calibration.json"
    prior.write_text(json.dumps(cameras(studio)), encoding="utf-8")
    case = Case(
        seed,
        f"{head.distance:.0f} mm off, fringe {fringe:.1f} mm, slide's bend {head.slide_bend:+.3f}, "
        f"harmonics {head.wave[1]:+.2f} {head.wave[2]:+.2f}, {frames} frames, "
        f"{'two cameras' if head.second else 'one camera'}, noise {studio.noise:.1f}",
    )
    try:
        found = calibrate_fringe(folder / "reference", prior)
        save_fringe(found, prior)
        plate = reconstruct_fringe(open_fringe(folder / "scan", prior))
    except AnnulusError as error:
        case.refused = str(error).replace(str(folder), "")
        return case
    case.marks += f"; reference {found.found.rms_rad:.3f} rad"
    score(case, things, plate)
    return case


def score(case: Case, things: list[Thing], plate: Plate) -> None:
    x, y = np.meshgrid(plate.x_mm, plate.y_mm)
    true = relief(things, x, y)
    edge = np.any([thing.near(x, y) for thing in things], axis=0)
    prior = np.isfinite(plate.height_mm)
    case.unsaid["height, mm"] += int(np.count_nonzero(plate.lit & ~prior)) // EVERY
    for i, j in np.argwhere(prior)[::EVERY]:
        where = "beside an edge" if edge[i, j] else "on a thing" if abs(true[i, j]) > 0.02 else "plain"
        case.numbers.append(
            Number(
                "height, mm", where, float(plate.height_mm[i, j]), 2 * float(plate.sigma_mm[i, j]), float(true[i, j])
            )
        )
    for thing in things:
        u, v = thing.own(x, y)
        inside = (np.abs(u) < 0.6) & (np.abs(v) < (0.3 if thing.kind == "groove" else 0.6)) & plate.lit
        if inside.sum() < 6:
            continue
        seen = inside & prior
        if seen.sum() < 0.3 * inside.sum():
            state, off = "not established", math.nan
        else:
            off = float(np.median(plate.height_mm[seen] - true[seen]))
            strong = float(np.median(np.abs(true[seen])))
            state = "found" if abs(off) < 0.5 * strong else "below the limit" if strong < LEAST_MM else "missed"
        case.things.append((thing.kind, state, f"{thing.height:+.2f} mm, {off:+.3f} off"))
