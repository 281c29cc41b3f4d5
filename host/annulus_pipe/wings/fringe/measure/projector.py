"""The slide: one phase for every direction of light, and the waveform that phase makes of the light.

    stripes   phase = 2 pi / period * (x cos turn + y sin turn) / z + phase0     period: of the tangent of the angle
    rings     phase = 2 pi / period * R z / hypot(x, y) + phase0                 period: mm on the wall of radius R

in the projector's own frame (z out of its lens). Rings are drawn so that the phase is linear in z on the wall of the
stated pipe (Alzuhiri 2022, §6.8.2.1, Figure 6.12 b): the tangent between, not the angle, carries it.
A lens that distorts (§6.6) shows the slide's point (a', b') in the direction (a, b) = (x / z, y / z), as a camera's
distorts (Brown and Conrady, OpenCV's k1 k2 p1 p2 k3): a', b' then stand for x / z, y / z above, and 1 / hypot(a', b')
for z / hypot(x, y). A convex ball before the slide (Model C, §6.8.2.3, Figure 6.15 b) sends each ray on by the law of
reflection: the phase of a place is that of the ray that comes there, which leaves the slide in another direction. Seen
from the wall such light has no one centre: its rays touch a caustic within the ball.
The light is 1 + m (cos phase + c2 cos 2 phase + s2 sin 2 phase + ..): harmonics are what blur leaves of a slide of
bars.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.numeric.late import transform

PLAIN = 13  # numbers of a slide without harmonics: kind, a, b, phase0, five of the lens, four of the mirror
BOUNCES = 8  # Newton's steps to where a mirror sends light on: the last changes it by less than 1e-12 rad
DISTORTION_MAX = 10.0  # of a coefficient: what is beyond folds the slide over itself at any tangent worth lighting
AXIAL = 7  # of a projector: centre, two of its direction, phase, logarithm of its period; ..
BENDS = 4  # .. k1 k2 p1 p2 of its lens; ..
LAW = AXIAL + BENDS + 4  # .. centre and radius of its mirror
HARMONICS_MAX = 4  # pairs (c, s) above the first: the fifth harmonic of a blurred bar is below 1 % of its first


@dataclass(frozen=True, slots=True)
class FringeProjector:
    """Where the slide's light comes from and what phase it has, all in the head's frame (the first camera's)."""

    kind: Literal["stripes", "rings"]
    centre_mm: tuple[float, float, float]
    rotation: tuple[tuple[float, float, float], ...]  # (3, 3): head's vectors to the projector's
    period: float  # stripes: of the tangent; rings: mm on the wall
    phase0: float = 0.0
    turn_deg: float = 0.0  # of stripes, from x towards y
    nominal_radius_mm: float = 1.0  # rings: the wall on which the phase is linear
    harmonics: tuple[float, ...] = ()  # c2, s2, c3, s3, .. over the first's amplitude
    distortion: tuple[float, ...] = ()  # of its lens: up to five, k1 k2 p1 p2 k3; none: it shows what it is given
    mirror_mm: tuple[float, ...] = ()  # centre x, y, z in the projector's own frame, and radius, of a ball; or none

    @staticmethod
    def from_dict(section: object) -> "FringeProjector":
        """`pattern.projector` of calibration.json. ValueError names the key that is wrong."""
        return _read(section)

    @property
    def numbers(self) -> FloatArray:
        """(PLAIN + 2 k,) as loops take a slide: kind, (a, b) or rate, phase0, lens, mirror, harmonics."""
        rate = 2 * math.pi / self.period
        if self.kind == "stripes":
            turn = math.radians(self.turn_deg)
            head = [0.0, rate * math.cos(turn), rate * math.sin(turn), self.phase0]
        else:
            head = [1.0, rate * self.nominal_radius_mm, 0.0, self.phase0]
        lens = [*self.distortion, *[0.0] * (5 - len(self.distortion))]
        return np.array([*head, *lens, *(self.mirror_mm or [0.0] * 4), *self.harmonics])

    def phase(self, points: FloatArray) -> FloatArray:
        """(..., 3) mm in the head's frame -> (...) rad, not wrapped."""
        return phase_at(self.numbers, (points - np.array(self.centre_mm)) @ np.array(self.rotation).T)

    def lamp(self, point: FloatArray) -> FloatArray:
        """(3,) mm in the head's frame -> (3,): where light comes to it from, the slide or its mirror."""
        turn, centre = np.array(self.rotation), np.array(self.centre_mm)
        return np.asarray(lamp_at(self.numbers, (point - centre) @ turn.T) @ turn + centre)


def phase_at(numbers: FloatArray, q: FloatArray) -> FloatArray:
    """Phase of a slide (`FringeProjector.numbers`) at places (..., 3) mm in its own frame -> (...) rad, not wrapped."""
    kind, a, b, phase0 = numbers[:4]
    if numbers[12] > 0:
        q = reflected(numbers[9:12], numbers[12], q)[0]
    with np.errstate(divide="ignore", invalid="ignore"):
        if numbers[4:9].any():
            x, y = _distorted(numbers[4:9], q[..., 0] / q[..., 2], q[..., 1] / q[..., 2])
            q = np.stack([x, y, np.ones_like(x)], axis=-1) * np.sign(q[..., 2:])
        if kind == 0.0:
            return np.asarray((a * q[..., 0] + b * q[..., 1]) / q[..., 2] + phase0)
        return np.asarray(a * q[..., 2] / np.hypot(q[..., 0], q[..., 1]) + phase0)


def _distorted(lens: FloatArray, a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray]:
    k1, k2, p1, p2, k3 = lens
    r2 = a * a + b * b
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    return a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a), b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b


def reflected(centre_mm: FloatArray, radius_mm: float, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(..., 3) mm, the slide's own frame: of light that a convex ball sends to q, the direction (unit) in which it
    leaves the slide at the origin, and where it meets the ball.

    In the plane of slide, ball and q, s lies along the way to the ball's middle, t across it: light leaves at the angle
    theta, meets the ball at the angle alpha from there to the slide, and goes back at theta + 2 alpha. alpha is where
    that ray passes through q (Alhazen's problem, by Newton). Behind the ball, in its shadow, what comes is meaningless.
    """
    d = float(np.linalg.norm(centre_mm))
    u = np.asarray(centre_mm) / d
    s = q @ u
    across = q - s[..., None] * u
    t = np.linalg.norm(across, axis=-1)
    w = across / np.maximum(t, 1e-9)[..., None]
    near = d - radius_mm
    image = near + near * radius_mm / (2 * near + radius_mm)
    widest = math.acos(radius_mm / d)
    alpha = np.clip(np.arctan2(t, image - s) / (2 + radius_mm / near), 0, 0.99 * widest)
    for turn in range(BOUNCES + 1):
        ms, mt = d - radius_mm * np.cos(alpha), radius_mm * np.sin(alpha)
        psi = np.arctan2(mt, ms) + 2 * alpha
        if turn == BOUNCES:
            break
        far = (t - mt) * np.sin(psi) - (s - ms) * np.cos(psi)
        swung = (radius_mm * d * np.cos(alpha) - radius_mm**2) / (ms * ms + mt * mt)
        slope = -radius_mm * np.cos(psi - alpha) - (swung + 2) * far
        alpha = np.clip(alpha - ((s - ms) * np.sin(psi) + (t - mt) * np.cos(psi)) / slope, 0, widest)
    met = ms[..., None] * u + mt[..., None] * w
    return met / np.linalg.norm(met, axis=-1)[..., None], met


def lamp_at(numbers: FloatArray, q: FloatArray) -> FloatArray:
    """(..., 3) mm, the slide's own frame: the last point from which light comes to q: the slide, or its mirror."""
    return reflected(numbers[9:12], numbers[12], q)[1] if numbers[12] > 0 else np.zeros_like(q)


def changed(projector: FringeProjector, step: FloatArray) -> FringeProjector:
    """A projector whose numbers (LAW) and harmonics are changed by a step."""
    turn = np.asarray(
        transform.Rotation.from_rotvec([step[3], step[4], 0.0]).as_matrix() @ np.array(projector.rotation)
    )
    lens = np.zeros(5)
    lens[: len(projector.distortion)] = projector.distortion
    lens[:BENDS] += step[AXIAL : AXIAL + BENDS]
    x, y, z = (float(a + b) for a, b in zip(projector.centre_mm, step[:3], strict=True))
    harmonics = np.zeros(max(len(projector.harmonics), len(step) - LAW))
    harmonics[: len(projector.harmonics)] = projector.harmonics
    harmonics[: len(step) - LAW] += step[LAW:]
    return replace(
        projector,
        centre_mm=(x, y, z),
        rotation=tuple((float(a), float(b), float(c)) for a, b, c in turn),
        phase0=projector.phase0 + float(step[5]),
        period=projector.period * float(np.exp(step[6])),
        harmonics=tuple(float(v) for v in harmonics),
        distortion=tuple(float(v) for v in lens) if lens.any() else (),
        mirror_mm=tuple(float(a + b) for a, b in zip(projector.mirror_mm, step[AXIAL + BENDS : LAW], strict=False)),
    )


def _read(section: object) -> FringeProjector:
    where = '"pattern.projector"'
    if not isinstance(section, Mapping):
        raise ValueError(f"{where} must be an object")

    def need(key: str) -> Any:
        if key not in section:
            raise ValueError(f'{where}: "{key}" is missing')
        return section[key]

    def vector(value: object, key: str) -> tuple[float, float, float]:
        x, y, z = untrusted.numbers(value, f'{where}: "{key}"', (3,), 1e5)
        return x, y, z

    kind = need("kind")
    if kind not in ("stripes", "rings"):
        raise ValueError(f"{where}: kind {kind!r}, expected stripes or rings")
    rows = need("rotation")
    if not isinstance(rows, list) or len(rows) != 3:
        raise ValueError(f'{where}: "rotation" must be three rows')
    rotation = tuple(vector(row, "rotation") for row in rows)
    if not np.allclose(np.array(rotation) @ np.array(rotation).T, np.eye(3), atol=1e-6):
        raise ValueError(f'{where}: "rotation" is none: its rows are no unit vectors at right angles')
    if np.linalg.det(np.array(rotation)) < 0:
        raise ValueError(f'{where}: "rotation" is a mirror, expected a rotation: the third row across the first two')
    harmonics = untrusted.numbers(
        section.get("harmonics", []), f'{where}: "harmonics"', range(0, 2 * HARMONICS_MAX + 1, 2), 1.0
    )
    rings = kind == "rings"
    distortion = untrusted.numbers(section.get("distortion", []), f'{where}: "distortion"', range(6), DISTORTION_MAX)
    return FringeProjector(
        kind,
        vector(need("centre_mm"), "centre_mm"),
        rotation,
        untrusted.within(need("period_mm" if rings else "period"), f"{where}: period", 1e-4, 1e3),
        untrusted.within(section.get("phase0", 0.0), f'{where}: "phase0"', -1e4, 1e4),
        untrusted.within(section.get("turn_deg", 0.0), f'{where}: "turn_deg"', -360.0, 360.0),
        untrusted.within(need("nominal_radius_mm"), f'{where}: "nominal_radius_mm"', 1.0, 1e4) if rings else 1.0,
        tuple(harmonics),
        tuple(distortion),
        _mirror(section["mirror"], where) if "mirror" in section else (),
    )


def _mirror(value: object, where: str) -> tuple[float, float, float, float]:
    section = untrusted.mapping(value, f'{where}: "mirror"')
    x, y, z = untrusted.numbers(section.get("centre_mm"), f'{where}: "mirror.centre_mm"', (3,), 1e4)
    radius = untrusted.within(section.get("radius_mm"), f'{where}: "mirror.radius_mm"', 0.1, 1e4)
    if not math.hypot(x, y, z) > radius * (1 + 1e-6):
        raise ValueError(f'{where}: "mirror": the slide\'s light stands within the ball, expected it outside')
    return x, y, z, radius
