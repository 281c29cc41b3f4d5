"""Two cameras beside a projector in a pipe, drawn ray by ray, and what one flash of them says of the wall.

Every pixel's four rays meet the wall r(angle, z), from a round pipe on by Newton's steps; the slide's colour there
falls off with distance and slant. Baselines, turns, lenses, slides, walls, noise, JPEG are each case's own; the head is
told exactly, so that what is off is the method's. A point is right when its radius is within k = 2 of the wall where it
lies, in the pipe as it stands.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from annulus_pipe.geometry.calibration import Calibration, HeadCamera
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.stereo import StereoReconstructor
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wall.profile import Profile
from tools.bench.blind.others.tally import Case
from tools.bench.blind.score import Number

WIDTH, HEIGHT = 832, 616
FLASHES, EVERY = 2, 6  # of each head; points of which one is held against the truth
WALLS = {
    "black": (0.05, 0.05, 0.055),
    "yellow": (0.75, 0.55, 0.08),
    "orange": (0.7, 0.3, 0.06),
    "grey": (0.4, 0.4, 0.4),
}
COLOURS = "RGB"
NEWTON = 4


@dataclass(slots=True)
class Wall:
    """Of radius mm, oval; things: at z, clock in rad, half length, half arc in rad, height inwards, mm."""

    radius: float
    oval: float
    towards: float
    things: list[tuple[float, float, float, float, float]]

    def at(self, phi: np.ndarray, z: np.ndarray) -> np.ndarray:
        out = self.radius * (1 + self.oval * np.cos(2 * (phi - self.towards)))
        for at, clock, half, arc, height in self.things:
            off = (phi - clock + math.pi) % (2 * math.pi) - math.pi
            out = out - height * np.exp(-(((z - at) / half) ** 4) - (off / arc) ** 4)
        return out


@dataclass(slots=True)
class Eye:
    """A lens: pixels from the middle of an angle off its axis, by OpenCV's odd polynomial; where it stands."""

    focal: float
    centre: tuple[float, float]
    bends: tuple[float, float, float, float]
    turn: np.ndarray  # first camera's frame to this one's
    place: np.ndarray  # in the first camera's frame, mm

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """(N, 3) unit vectors in the first camera's frame; NaN beyond 86 degrees."""
        angle = np.linspace(0, 1.5, 6000)
        power = angle**2
        distance = angle * (1 + sum(bend * power ** (k + 1) for k, bend in enumerate(self.bends)))
        x, y = (pixels - self.centre).T / self.focal
        theta, clock = np.interp(np.hypot(x, y), distance, angle, right=np.nan), np.arctan2(y, x)
        own = np.stack([np.sin(theta) * np.cos(clock), np.sin(theta) * np.sin(clock), np.cos(theta)], axis=1)
        return own @ self.turn


@dataclass(slots=True)
class Slide:
    vertex: np.ndarray
    axis: np.ndarray
    half_angles: np.ndarray  # of the slits
    half_width: float
    word: str
    dyes: np.ndarray
    margin: float

    def light(self, points: np.ndarray) -> np.ndarray:
        """(N, 3) red, green, blue at points of the first camera's frame, before distance and slant."""
        away = points - self.vertex
        angle = np.arccos(np.clip(away @ self.axis / np.linalg.norm(away, axis=1), -1, 1))
        edges = np.concatenate(
            [[self.half_angles[0] - self.margin], self.half_angles, [self.half_angles[-1] + self.margin]]
        )
        stripe = np.clip(np.searchsorted(edges, angle) - 1, 0, len(self.word) - 1)
        nearest = np.abs(angle[:, None] - self.half_angles).min(axis=1)
        soft = 0.15 * self.half_width
        lit = np.clip(0.5 + (nearest - self.half_width) / (2 * soft), 0, 1)
        lit *= np.clip(0.5 + (angle - edges[0]) / (2 * soft), 0, 1) * np.clip(
            0.5 + (edges[-1] - angle) / (2 * soft), 0, 1
        )
        return lit[:, None] * self.dyes[["RGB".index(letter) for letter in self.word]][stripe]


def rotation(about: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.Rodrigues(np.asarray(about, float))[0])


def draw_word(rng: np.random.Generator, stripes: int) -> str:
    while True:
        word = "".join(COLOURS[int(k)] for k in rng.integers(0, 3, stripes))
        pairs = [word[k : k + 2] for k in range(stripes - 1)]
        if len({*pairs}) == len(pairs) and {*word} == {*COLOURS}:
            return word


def draw(rng: np.random.Generator) -> tuple[Wall, list[Eye], Slide]:
    radius = float(rng.choice([38.0, 51.0, 76.2, 101.6]))
    things = [
        (
            radius * rng.uniform(0.9, 2.0),
            rng.uniform(0, 2 * math.pi),
            radius * rng.uniform(0.08, 0.25),
            rng.uniform(0.1, 0.5),
            radius * rng.uniform(-0.05, 0.05),
        )
        for _ in range(4)
    ]
    wall = Wall(radius, rng.uniform(0, 0.015), rng.uniform(0, math.pi), things)
    way = rng.uniform(0, 2 * math.pi)
    first, second = rng.uniform(0.16, 0.32, 2) * radius
    vertex = np.array([first * math.cos(way), first * math.sin(way), rng.uniform(-0.15, 0.05) * radius])
    away = way + rng.choice([-1, 1]) * rng.uniform(1.0, 2.2)
    place = vertex + np.array([second * math.cos(away), second * math.sin(away), rng.uniform(-0.03, 0.08) * radius])
    focal = rng.uniform(255, 300)
    eyes = [
        Eye(
            focal * rng.uniform(0.98, 1.02),
            ((WIDTH - 1) / 2 + rng.uniform(-8, 8), (HEIGHT - 1) / 2 + rng.uniform(-8, 8)),
            tuple(float(v) for v in rng.normal(0, (0.02, 0.004, 0.001, 0.0))),
            turn,
            at,
        )
        for turn, at in (
            (np.eye(3), np.zeros(3)),
            (rotation([*rng.normal(0, 0.02, 2), 0]) @ rotation([0, 0, rng.uniform(-2.5, 2.5)]), place),
        )
    ]
    slits = int(rng.integers(5, 9))
    axis = np.array([*rng.normal(0, 0.02, 2), 1.0])
    far, near = rng.uniform(1.6, 2.0), rng.uniform(0.85, 1.0)
    angles = np.linspace(math.atan(1 / far), math.atan(1 / near), slits)
    dyes = np.array([[1.0, 0.05, 0.03], [0.06, 0.9, 0.12], [0.03, 0.12, 0.85]]) * rng.uniform(0.85, 1.15, (3, 3))
    width = (angles[1] - angles[0]) * rng.uniform(0.11, 0.19)
    return (
        wall,
        eyes,
        Slide(
            vertex,
            axis / np.linalg.norm(axis),
            angles,
            width,
            draw_word(rng, slits + 1),
            dyes,
            math.radians(rng.uniform(3, 5)),
        ),
    )


def photograph(
    wall: Wall,
    eye: Eye,
    slide: Slide,
    turn: np.ndarray,
    shift: np.ndarray,
    colour: np.ndarray,
    rng: np.random.Generator,
    electrons: float,
    blur: float,
) -> np.ndarray:
    """One eye's picture, blue first; a pipe's point p lies at turn p + shift of the first camera's frame."""
    v, u = (np.mgrid[: 2 * HEIGHT, : 2 * WIDTH] + 0.5) / 2 - 0.5
    rays = eye.rays(np.stack([u.ravel(), v.ravel()], axis=1)) @ turn  # of the pipe's frame
    start = turn.T @ (eye.place - shift)
    # From where a round pipe is met, on those rays only that the slide lights there.
    flat2, toward = (rays[:, :2] ** 2).sum(axis=1), rays[:, :2] @ start[:2]
    reach = (np.sqrt(toward**2 - flat2 * (start[:2] @ start[:2] - wall.radius**2)) - toward) / flat2
    off = (start + reach[:, None] * rays) @ turn.T + shift - slide.vertex
    angle = np.arccos(off @ slide.axis / np.linalg.norm(off, axis=1))
    spare = slide.margin + 0.1
    usable = np.flatnonzero((angle > slide.half_angles[0] - spare) & (angle < slide.half_angles[-1] + spare))
    rays, reach = rays[usable], reach[usable]
    for _ in range(NEWTON):
        point = start + reach[:, None] * rays
        rho = np.hypot(point[:, 0], point[:, 1])
        slope = (point[:, :2] * rays[:, :2]).sum(axis=1) / rho
        reach = reach - (rho - wall.at(np.arctan2(point[:, 1], point[:, 0]), point[:, 2])) / slope
    point = start + reach[:, None] * rays
    light = slide.light(point @ turn.T + shift)
    way = point - turn.T @ (slide.vertex - shift)
    distance = np.linalg.norm(way, axis=1)
    slant = np.hypot(way[:, 0], way[:, 1]) / distance
    fine = np.zeros((4 * WIDTH * HEIGHT, 3))
    fine[usable] = light * (slant / distance**2)[:, None] * colour
    picture = cv2.GaussianBlur(fine.reshape(HEIGHT, 2, WIDTH, 2, 3).mean(axis=(1, 3)), (0, 0), blur)
    picture *= 0.75 / np.percentile(picture.max(axis=2), 99)
    raw = picture[..., 1].copy()
    raw[::2, ::2], raw[1::2, 1::2] = picture[::2, ::2, 0], picture[1::2, 1::2, 2]
    raw = rng.poisson(electrons * np.clip(raw, 0, 1.2)) / electrons + rng.normal(0, 0.004, raw.shape)
    return np.asarray(cv2.cvtColor(np.clip(np.round(255 * raw), 0, 255).astype(np.uint8), cv2.COLOR_BayerRGGB2BGR))


def prior(wall: Wall, eyes: list[Eye], slide: Slide) -> Calibration:
    cameras = [Camera("fisheye", WIDTH, HEIGHT, one.focal, one.focal, *one.centre, one.bends) for one in eyes]
    second = eyes[1]
    other = HeadCamera(
        1, cameras[1], tuple(map(tuple, second.turn.tolist())), tuple((-second.turn @ second.place).tolist())
    )
    axis, vertex = tuple(slide.axis.tolist()), tuple(slide.vertex.tolist())
    cones = tuple(Cone(float(angle), axis, vertex) for angle in slide.half_angles)
    return Calibration(cameras[0], slide.word, cones, wall.radius, others=(other,))


def measured(seed: int, folder: Path) -> Case:
    rng = np.random.default_rng([seed, 94])
    wall, eyes, slide = draw(rng)
    name = str(rng.choice(list(WALLS)))
    electrons, quality, blur = rng.uniform(2000, 15000), int(rng.choice([80, 90, 97])), rng.uniform(0.5, 1.0)
    base = np.linalg.norm(slide.vertex[:2]), np.linalg.norm((eyes[1].place - slide.vertex)[:2])
    case = Case(
        seed,
        f"{2 * wall.radius:.0f} mm, {name}, baselines {base[0]:.0f} and {base[1]:.0f} mm, "
        f"{len(slide.half_angles)} slits {slide.word}, oval {200 * wall.oval:.1f} %, "
        f"{electrons / 1000:.0f}k electrons, JPEG {quality}",
    )
    try:
        head = StereoReconstructor(prior(wall, eyes, slide))
        for flash in range(FLASHES):
            turn = rotation([*rng.normal(0, 0.02, 2), 0.0])
            shift = np.array([*(rng.normal(0, 0.02, 2) * wall.radius), 0.0]) - 0.5 * np.array([*slide.vertex[:2], 0.0])
            pictures = {}
            for k, eye in enumerate(eyes):
                sharp = photograph(wall, eye, slide, turn, shift, np.array(WALLS[name]), rng, electrons, blur)
                packed = cv2.imencode(".jpg", sharp, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
                pictures[k] = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR), dtype=np.uint8)
                cv2.imwrite(str(folder / f"{flash}-{k}.jpg"), pictures[k])
            score(case, wall, turn, shift, head.profile(pictures, frame=flash, z_mm=0.0), len(slide.half_angles))
    except AnnulusError as error:
        case.refused = str(error)
    return case


def score(case: Case, wall: Wall, turn: np.ndarray, shift: np.ndarray, profile: Profile, slits: int) -> None:
    for ring in range(slits):
        seen = int(np.count_nonzero(profile.ring == ring))
        case.things.append(("ring", "found" if seen > 100 else "not established", f"ring {ring}: {seen} points"))
    if profile.pose is None:
        return
    own = profile.points_mm[::EVERY].astype(float) @ profile.pose.rotation.T + profile.pose.translation
    true = (own - shift) @ turn
    phi = np.arctan2(true[:, 1], true[:, 0])
    wall_mm = wall.at(phi, true[:, 2])
    radius = np.hypot(true[:, 0], true[:, 1])
    plain = np.abs(wall_mm - wall.radius * (1 + wall.oval * np.cos(2 * (phi - wall.towards)))) < 0.002 * wall.radius
    both = profile.seen_by[::EVERY] == 2
    for k, sigma in enumerate(profile.sigma_mm[::EVERY].tolist()):
        what = f"point's radius, mm, {'both cameras' if both[k] else 'one camera'}"
        where = "plain wall" if plain[k] else "on a bump or pocket"
        case.numbers.append(Number(what, where, float(radius[k]), 2 * sigma, float(wall_mm[k])))
