"""What the stripes' colours look like on one pipe through one camera, learnt from a few frames of it.

Red, green and blue light come back as three mixtures: the filters of slide and sensor overlap (crosstalk), and the
wall's paint takes its part of every channel. A profile holds both, so that a stripe is named after what it shows.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.numeric.arrays import FloatArray
from annulus_pipe.rings.decode import NONE, StripeColours, classify
from annulus_pipe.rings.order import PlacedSlits
from annulus_pipe.rings.slits import Slits

FORMAT = "annulus-colour/1"
# GAIN_MOST and FULL: topic colour, gains set. DIFFERS: test_limits. LEAST: unguarded.
LEAST = 50  # stripe observations of each colour
FULL = 235.0  # grey levels above black: the mean beside a slit of a stripe that reaches full scale
GAIN_MOST = 4.0  # of a channel; beyond it a camera raises its noise more than it helps the colours
DIFFERS = 1.8  # a channel's share of the light changed by this factor is another paint or another white balance

Matrix = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Stripes:
    """Light of stripes beside slits, made comparable: light (N, 3) red green blue, grey levels as on the outermost
    slit, the slit's own darkness taken off; colour (N,) index into "RGB" of the stripe by its place; clipped (N,): a
    channel was at full scale, its light is a lower limit."""

    light: FloatArray
    colour: NDArray[np.int64]
    clipped: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class ColourProfile:
    """crosstalk[c][s]: what channel c sees of stripe s, over what it sees of its own stripe; 1 on the diagonal.
    level: grey levels that red, green and blue see of their own stripe (0: not in the pattern). gains: white balance to
    set on the camera, red and blue relative to green; camera_gains: what was set when this was learnt.

    named: share of stripes named right before (by their brightest channel) and after (by this profile). separation:
    degrees between the two colours most alike, as they come and as the profile sees them; 90 would be perfect.
    """

    crosstalk: Matrix
    level: Triple
    camera_gains: tuple[float, float]
    gains: tuple[float, float]
    named: tuple[float, float]
    separation: tuple[float, float]
    frames: int

    @property
    def reflectance(self) -> Triple:
        """What comes back of each channel, over the channel that comes back best: paint, lamp and sensor together."""
        most = max(self.level)
        return self.level[0] / most, self.level[1] / most, self.level[2] / most

    def seen(self) -> StripeColours:
        """What `classify` needs."""
        gain = np.array([1.0 / value if value > 0 else 0.0 for value in self.level])
        matrix = np.array(self.crosstalk)
        used = np.flatnonzero(gain)
        reference = matrix[:, used].T * (gain > 0)
        return StripeColours(gain, reference / np.linalg.norm(reference, axis=1, keepdims=True))

    def to_dict(self) -> dict[str, Any]:
        return {
            "format": FORMAT,
            "crosstalk": [list(row) for row in self.crosstalk],
            "level": list(self.level),
            "reflectance": list(self.reflectance),
            "camera_gains": {"red": self.camera_gains[0], "blue": self.camera_gains[1]},
            "gains": {"red": self.gains[0], "blue": self.gains[1]},
            "named": {"before": self.named[0], "after": self.named[1]},
            "separation": {"before": self.separation[0], "after": self.separation[1]},
            "frames": self.frames,
        }

    @classmethod
    def from_dict(cls, data: object) -> "ColourProfile":
        """Inverse of `to_dict`. Raises ValueError naming the key that is wrong."""
        if not isinstance(data, Mapping) or data.get("format") != FORMAT:
            raise ValueError(f'"format" is not "{FORMAT}"')
        rows = data.get("crosstalk")
        if not isinstance(rows, Sequence) or len(rows) != 3:
            raise ValueError('"crosstalk" must be three rows of three numbers')
        level = _triple(data.get("level"), "level")
        if not max(level) > 0:
            raise ValueError('"level" must have a channel above zero')
        matrix = (_triple(rows[0], "crosstalk"), _triple(rows[1], "crosstalk"), _triple(rows[2], "crosstalk"))
        if any(matrix[c][c] <= 0 for c in range(3) if level[c] > 0):
            raise ValueError('"crosstalk" must be 1 on its diagonal')
        frames = data.get("frames")
        if isinstance(frames, bool) or not isinstance(frames, int):
            raise ValueError('"frames" must be a whole number')
        return cls(
            matrix,
            level,
            _pair(data, "camera_gains", "red", "blue"),
            _pair(data, "gains", "red", "blue"),
            _pair(data, "named", "before", "after"),
            _pair(data, "separation", "before", "after"),
            frames,
        )


def stripes(slits: Slits, placed: PlacedSlits, calibration: Calibration) -> Stripes:
    """The stripes' light on both sides of every named slit of a frame.

    Light spreads from the projector and meets the wall aslant: it falls as the cubed sine of the cone's half-angle.
    """
    pattern = np.array(["RGB".index(c) for c in calibration.colours])
    fall = np.array([math.sin(cone.half_angle) ** 3 for cone in calibration.rings])
    fall /= fall[-1]
    named = np.flatnonzero(placed.ring != NONE)
    ring = placed.ring[named]
    light = np.vstack([slits.inside[named], slits.outside[named]])[:, ::-1]
    return Stripes(
        light / np.tile(fall[ring], 2)[:, None],
        np.concatenate([pattern[ring], pattern[ring + 1]]),
        light.max(axis=1) >= FULL,
    )


def learn(seen: Sequence[Stripes], camera_gains: tuple[float, float] = (1.0, 1.0)) -> ColourProfile:
    """A profile from the stripes of some frames of one pipe.

    Raises ValueError where a colour was seen too seldom, or comes back no more in its own channel than elsewhere.
    """
    light = np.concatenate([one.light for one in seen])
    colour = np.concatenate([one.colour for one in seen])
    whole = ~np.concatenate([one.clipped for one in seen])
    mixture = np.zeros((3, 3))  # channel, stripe
    used = [s for s in range(3) if (colour == s).any()]
    for s in used:
        mine = light[(colour == s) & whole]
        if len(mine) < LEAST:  # all of it at full scale: its own channel is then known as a lower limit
            mine = light[colour == s]
        if len(mine) < LEAST:
            raise ValueError(f"{'RGB'[s]} stripes were seen {len(mine)} times, at least {LEAST} are needed")
        mixture[:, s] = np.median(mine, axis=0)
    level = np.diag(mixture).copy()
    for s in used:
        if level[s] < 2.0:
            raise ValueError(
                f"the {('red', 'green', 'blue')[s]} channel sees nothing of its own stripes "
                f"({level[s]:.1f} grey levels): raise its gain or the exposure"
            )
    scale = np.where(level > 0, 1.0 / np.maximum(level, 1e-9), 0.0)
    crosstalk = mixture * scale[:, None]
    red, green, blue = level
    # Below 1 a gain would cut red off below full scale; above GAIN_MOST it is noise that grows.
    gains = [
        float(np.clip(g * green / max(own, 1e-9), 1.0, GAIN_MOST)) if own > 0 and green > 0 else g
        for g, own in zip(camera_gains, (red, blue), strict=True)
    ]
    draft = ColourProfile(
        _matrix(crosstalk),
        (float(red), float(green), float(blue)),
        camera_gains,
        (gains[0], gains[1]),
        (0.0, 0.0),
        (0.0, 0.0),
        len(seen),
    )
    named = classify(light[:, ::-1], "".join("RGB"[s] for s in used), draft.seen())
    before = float((light.argmax(axis=1) == colour).mean())
    return ColourProfile(
        draft.crosstalk,
        draft.level,
        camera_gains,
        draft.gains,
        (before, float((named == colour).mean())),
        (separation(mixture[:, used]), separation(crosstalk[:, used])),
        len(seen),
    )


def separation(matrix: FloatArray) -> float:
    """Least angle between two columns, degrees; matrix (3, C): what the channels see of each colour."""
    unit = _unit(matrix.T)
    likeness = [float(a @ b) for i, a in enumerate(unit) for b in unit[i + 1 :]]
    return math.degrees(math.acos(min(max(likeness, default=0.0), 1.0)))


def differs(profile: ColourProfile, seen: Sequence[Stripes]) -> str | None:
    """How the light of these frames is unlike the profile's, in words; None where it is like it."""
    try:
        own = learn(seen, profile.camera_gains)
    except ValueError as error:
        return str(error)
    shares = [[value / sum(p.level) for value in p.level] for p in (own, profile)]
    ratios = [max(a / b, b / a) if a > 0 and b > 0 else 1.0 for a, b in zip(*shares, strict=True)]
    worst = int(np.argmax(ratios))
    if ratios[worst] < DIFFERS:
        return None
    name = ("red", "green", "blue")[worst]
    here, there = (100 * share[worst] for share in shares)
    return f"{name} brings {here:.0f} % of the light here and {there:.0f} % in the profile"


def _unit(light: FloatArray) -> FloatArray:
    return np.asarray(light / np.maximum(np.linalg.norm(light, axis=1, keepdims=True), 1e-9))


def _matrix(values: FloatArray) -> Matrix:
    a, b, c = ((float(row[0]), float(row[1]), float(row[2])) for row in values)
    return a, b, c


def _triple(value: object, name: str) -> Triple:
    if not isinstance(value, Sequence) or isinstance(value, str) or len(value) != 3:
        raise ValueError(f'"{name}" must be three numbers')
    a, b, c = (_number(one, name) for one in value)
    return a, b, c


def _pair(data: Mapping[Any, Any], name: str, first: str, second: str) -> tuple[float, float]:
    value = data.get(name)
    if not isinstance(value, Mapping):
        raise ValueError(f'"{name}" must have "{first}" and "{second}"')
    return _number(value.get(first), f"{name}.{first}"), _number(value.get(second), f"{name}.{second}")


def _number(value: object, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < 1e6:
        raise ValueError(f'"{name}" is {value!r}, expected a number from 0')
    return float(value)
