"""From a camera's grey levels to light: black level, the curve the camera put on, gamma, and where it saturates.

A gamma and an even harmonic of the slide look alike where no other light falls on the wall: (1 + m cos)^gamma is a
waveform whatever the wall's albedo. Which of both it is matters to nobody, as long as the scan is taken as the
calibration was; a scan whose grey levels came by another curve has another waveform, and that is seen.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from annulus_pipe import untrusted
from annulus_pipe.geometry.calibration import HeadCamera
from annulus_pipe.numeric.arrays import Float32Array, Image
from annulus_pipe.vocabulary import AnnulusError

WHITE = 255.0
SATURATED = 254  # grey levels from here on say no more than "at least"
GAMMA_MIN = 0.2  # no camera's curve is flatter ..
GAMMA_MAX = 5.0  # .. or steeper


@dataclass(frozen=True, slots=True)
class Transfer:
    """The curve: light = 255 curve((grey - black) / (255 - black)) ** gamma."""

    sensor: Literal["linear", "srgb"] = "linear"
    black: float = 0.0
    gamma: float = 1.0

    def light(self, picture: Image) -> Float32Array:
        """(H, W, 3) BGR or (H, W) uint8 -> (H, W) float32 0..255, linear in light; NaN where a channel saturated."""
        colours = picture.reshape(*picture.shape[:2], -1)
        grey = colours.astype(np.float32).mean(axis=2)
        share = (grey - np.float32(self.black)) / np.float32(WHITE - self.black)
        if self.sensor == "srgb":  # IEC 61966-2-1; below black as it comes: noise has a mean of zero
            high = ((np.maximum(share, 0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
            share = np.where(share <= 0.04045, share / np.float32(12.92), high)
        if self.gamma != 1.0:
            share = np.sign(share) * np.abs(share) ** np.float32(self.gamma)
        lost = (colours >= SATURATED).any(axis=2)
        return np.where(lost, np.float32(np.nan), np.float32(WHITE) * share).astype(np.float32)

    def to_dict(self) -> dict[str, Any]:
        """As calibration.json has it."""
        out: dict[str, Any] = {"sensor": self.sensor, "black": self.black}
        return {**out, "gamma": self.gamma} if self.gamma != 1.0 else out

    @staticmethod
    def from_dict(section: object, where: str = "transfer") -> "Transfer":
        """Raises ValueError naming the key that is wrong."""
        if not isinstance(section, Mapping):
            raise ValueError(f'"{where}" must be an object')
        sensor = section.get("sensor", "linear")
        if sensor not in ("linear", "srgb"):
            raise ValueError(f'"{where}.sensor" is {untrusted.shown(sensor)}, expected linear or srgb')
        return Transfer(
            sensor,
            untrusted.within(section.get("black", 0.0), f'"{where}.black"', 0.0, 200.0),
            untrusted.within(section.get("gamma", 1.0), f'"{where}.gamma"', GAMMA_MIN, GAMMA_MAX),
        )


def light_of(picture: Image, one: HeadCamera, curve: Transfer, where: str) -> Float32Array:
    """(H, W) light of a camera's frame, see `Transfer.light`. AnnulusError, naming `where`, for another size than the
    camera's, and where every pixel is saturated."""
    height, width = picture.shape[:2]
    if (width, height) != (one.camera.width, one.camera.height):
        raise AnnulusError(
            f"calibration: camera {one.id} is {one.camera.width}x{one.camera.height} but {where} is "
            f"{width}x{height}. Calibrate with the camera that took this scan."
        )
    light = curve.light(picture)
    if np.isnan(light).all():
        raise AnnulusError(f"{where} is saturated throughout: expose less")
    return light


def transfers(section: object) -> dict[str, Transfer]:
    """The `transfer` section: one curve for every scan, under "", or one a scan by the name of its folder.

    Raises ValueError naming the key that is wrong."""
    if not isinstance(section, Mapping):
        raise ValueError('"transfer" must be an object')
    if not section or any(key in section for key in ("sensor", "black", "gamma")):
        return {"": Transfer.from_dict(section)}
    return {str(name): Transfer.from_dict(one, f"transfer.{name}") for name, one in section.items()}
