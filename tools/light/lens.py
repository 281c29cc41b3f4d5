"""What a real lens makes of a perfect picture: colours of different size, blur that grows outwards, ghost and veil; and
a fisheye's picture from a plane one."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from tools.light.effects import Effects

Array = NDArray[np.float64]
BLURS = 6  # pictures of different blur that are mixed
GHOST_BLUR = 0.012  # of the height: a ghost is out of focus
VEIL_BLUR = 0.12


def through_lens(light: Array, effects: Effects, centre: tuple[float, float]) -> Array:
    """(H, W, 3) red first, linear, of the same."""
    image = lateral(light, effects.lateral, centre) if any(effects.lateral) else light
    if effects.curvature_px:
        image = curved(image, effects.curvature_px, centre)
    if effects.ghost:
        image = image + effects.ghost * _ghost(image, centre)
    if effects.veil:
        high = VEIL_BLUR * image.shape[0]
        image = (1.0 - effects.veil) * image + effects.veil * cv2.GaussianBlur(image, (0, 0), high)
    return image


def lateral(light: Array, parts: tuple[float, float], centre: tuple[float, float]) -> Array:
    """Red and blue magnified by 1 + part about `centre`, green as it is."""
    channels = [
        light[..., c] if part == 0.0 else _moved(light[..., c], *_about(light, centre, 1.0 / (1.0 + part)))
        for c, part in zip((0, 1, 2), (parts[0], 0.0, parts[1]), strict=True)
    ]
    return np.stack(channels, -1)


def curved(light: Array, sigma_px: float, centre: tuple[float, float]) -> Array:
    """A blur of sigma_px at half the height from `centre`, with the square of the distance from it."""
    y, x = np.mgrid[: light.shape[0], : light.shape[1]]
    away = np.hypot(x - centre[0], y - centre[1]) / (light.shape[0] / 2)
    sigmas = np.linspace(0.0, sigma_px * float(away.max()) ** 2, BLURS)
    place = np.interp(sigma_px * away**2, sigmas, np.arange(BLURS))
    out = np.zeros_like(light)
    for k, sigma in enumerate(sigmas):
        weight = np.clip(1.0 - np.abs(place - k), 0.0, None)[..., None]
        out += weight * (cv2.GaussianBlur(light, (0, 0), float(sigma)) if sigma > 0.0 else light)
    return out


def _ghost(light: Array, centre: tuple[float, float]) -> Array:
    soft = cv2.GaussianBlur(light, (0, 0), GHOST_BLUR * light.shape[0])
    return _moved(soft, *_about(light, centre, -1.0))


def _about(light: Array, centre: tuple[float, float], scale: float) -> tuple[Array, Array]:
    y, x = np.mgrid[: light.shape[0], : light.shape[1]].astype(np.float64)
    return centre[0] + scale * (x - centre[0]), centre[1] + scale * (y - centre[1])


def _moved(light: Array, x: Array, y: Array) -> Array:
    moved = cv2.remap(
        light.astype(np.float32),
        x.astype(np.float32),
        y.astype(np.float32),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_CONSTANT,
    )
    return np.maximum(moved.astype(np.float64), 0.0)


def fisheye(
    plane: Array, focal_plane: float, focal: float, size: tuple[int, int], centre: tuple[float, float]
) -> Array:
    """(H, W, 3) of an equidistant lens, from a plane picture with the axis in its middle; black beyond that one."""
    y, x = np.mgrid[: size[1], : size[0]].astype(np.float64)
    x, y = x - centre[0], y - centre[1]
    away = np.hypot(x, y)
    angle = np.minimum(away / focal, 0.49 * math.pi)
    scale = focal_plane * np.tan(angle) / np.maximum(away, 1e-9)
    middle = (plane.shape[1] - 1) / 2, (plane.shape[0] - 1) / 2
    return _moved(plane, middle[0] + scale * x, middle[1] + scale * y)
