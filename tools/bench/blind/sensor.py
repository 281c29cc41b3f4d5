"""What a sensor makes of light: lens blur, a mosaic, electrons, bits, JPEG."""

import cv2
import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tools.bench.blind.pipe import Sensor
from tools.bench.blind.surface import Array, away_deg

WHITE = 255.0
LED_PART = 0.7  # of white: what the LED's exposure aims its 99th percentile at


def exposure(light: Array, part: float) -> float:
    """The factor by which a picture's 99th percentile of its brightest channel becomes `part` of white."""
    bright = float(np.percentile(light.max(axis=2), 99.0))
    return part / max(bright, 1e-4)


def expose(light: Array, factor: float, sensor: Sensor, rng: Generator) -> NDArray[np.uint8]:
    """(H, W, 3) uint8, blue first, of linear light."""
    light = cv2.GaussianBlur(light, (0, 0), sensor.blur_px) * factor
    if sensor.burnt > 1.0:
        light = light * _band(light.shape[:2], sensor)[..., None]
    light = light + sensor.veil
    raw = _mosaic(light)
    electrons = rng.poisson(np.clip(raw, 0.0, 4.0) * sensor.full).astype(np.float64)
    electrons += rng.normal(0.0, sensor.read, raw.shape)
    bits = np.clip(np.round(electrons / sensor.full * WHITE), 0.0, WHITE).astype(np.uint8)
    return np.asarray(cv2.cvtColor(bits, cv2.COLOR_BayerRGGB2BGR), dtype=np.uint8)


def _mosaic(light: Array) -> Array:
    """(H, W): red at even rows and columns, blue at odd ones, green between."""
    raw = np.array(light[..., 1])
    raw[0::2, 0::2] = light[0::2, 0::2, 2]
    raw[1::2, 1::2] = light[1::2, 1::2, 0]
    return raw


def _band(shape: tuple[int, int], sensor: Sensor) -> Array:
    """(H, W): how much stronger the light is, softly within an arc of the picture."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    clock = np.degrees(np.arctan2(x - shape[1] / 2, -(y - shape[0] / 2)))
    middle, arc = sensor.burnt_deg
    inside = np.clip((arc / 2 + 3.0 - np.abs(away_deg(clock, middle))) / 6.0, 0.0, 1.0)
    return np.asarray(1.0 + (sensor.burnt - 1.0) * inside)


def as_jpeg(image: NDArray[np.uint8], quality: int) -> bytes:
    return bytes(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].data)
