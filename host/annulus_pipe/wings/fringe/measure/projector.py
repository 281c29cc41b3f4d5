"""The slide: one phase for every direction of light, and the waveform that phase makes of the light.

    stripes   phase = 2 pi / period * (x cos turn + y sin turn) / z + phase0     period: of the tangent of the angle
    rings     phase = 2 pi / period * R z / hypot(x, y) + phase0                 period: mm on the wall of radius R

in the projector's own frame (z out of its lens). Rings are drawn so that the phase is linear in z on the wall of the
stated pipe (Alzuhiri 2022, §6.8.2.1, Figure 6.12 b): the tangent between, not the angle, carries it.
The light is 1 + m (cos phase + c2 cos 2 phase + s2 sin 2 phase + ..): harmonics are what blur leaves of a slide of
bars.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.numeric.arrays import FloatArray

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

    @staticmethod
    def from_dict(section: object) -> "FringeProjector":
        """`pattern.projector` of calibration.json. ValueError names the key that is wrong."""
        return _read(section)

    @property
    def numbers(self) -> FloatArray:
        """(4 + 2 k,) as loops take a slide: kind, (a, b) or rate, phase0, harmonics."""
        rate = 2 * math.pi / self.period
        if self.kind == "stripes":
            turn = math.radians(self.turn_deg)
            head = [0.0, rate * math.cos(turn), rate * math.sin(turn), self.phase0]
        else:
            head = [1.0, rate * self.nominal_radius_mm, 0.0, self.phase0]
        return np.array([*head, *self.harmonics])

    def phase(self, points: FloatArray) -> FloatArray:
        """(..., 3) mm in the head's frame -> (...) rad, not wrapped."""
        q = (points - np.array(self.centre_mm)) @ np.array(self.rotation).T
        kind, a, b, phase0 = self.numbers[:4]
        with np.errstate(divide="ignore", invalid="ignore"):
            if kind == 0.0:
                return np.asarray((a * q[..., 0] + b * q[..., 1]) / q[..., 2] + phase0)
            return np.asarray(a * q[..., 2] / np.hypot(q[..., 0], q[..., 1]) + phase0)


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
    return FringeProjector(
        kind,
        vector(need("centre_mm"), "centre_mm"),
        rotation,
        untrusted.within(need("period_mm" if rings else "period"), f"{where}: period", 1e-4, 1e3),
        untrusted.within(section.get("phase0", 0.0), f'{where}: "phase0"', -1e4, 1e4),
        untrusted.within(section.get("turn_deg", 0.0), f'{where}: "turn_deg"', -360.0, 360.0),
        untrusted.within(need("nominal_radius_mm"), f'{where}: "nominal_radius_mm"', 1.0, 1e4) if rings else 1.0,
        tuple(harmonics),
    )
