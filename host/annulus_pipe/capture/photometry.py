"""Which light a frame shows, judged from the picture alone: the witness that checks what timing says.

The projector throws pure red, green and blue stripes, so hue differs from place to place; the LED is white, so hue is
that of the wall everywhere, even on a yellow one. The variance of chromaticity over the picture, weighted with
brightness, is 0.3 to 0.4 for the one, below 0.01 for the other, whatever the gain, pose or exposure.

A projector of a static sinusoid has one hue, too, but its stripes: neighbouring samples differ by 0.16 to 0.36 of their
sum, in the LED's light by 0.06 at most, in the dirtiest pipe there is (test_photometry).

A frame is one exposure from top to bottom. So every band of it must show the same lamp (a torn picture's do not), and
no two frames are the same down to the noise (a picture that the driver handed over twice is). A picture torn between
two projector frames shows one lamp, but its first or last row is that of a picture shown before.
"""

from dataclasses import dataclass
from enum import StrEnum
from hashlib import blake2b

import numpy as np

from annulus_pipe.capture.camera import MOSAICS
from annulus_pipe.numeric.arrays import Float32Array, FloatArray, Image
from annulus_pipe.numeric.chroma import LED_SPREAD_MAX, PROJECTOR_SPREAD_MIN
from annulus_pipe.numeric.chroma import spread as spread_of

GREEN_FIRST = frozenset({MOSAICS["GRBG"], MOSAICS["GBRG"]})
THUMBNAIL_SIDE = 96  # samples along the shorter side; stripes must not melt into one another
NOISE_GREY = 5.0  # a channel below this says nothing of hue
PEAK_SHARE = 0.99
DARK_GREY = 20.0  # brightest percentile of an unlit frame stays below
LIT_EVERYWHERE = 0.5  # of the samples: stripes alone never light that many
LIT_OF_PEAK = 0.2  # a sample brighter than this share of the peak is lit
STRIPED_MIN, PLAIN_MAX = 0.12, 0.06  # difference over sum of neighbouring samples: of fringes, of the LED
STRIPED_PEAK = 2 * DARK_GREY  # in less light noise is striped
EVEN_GREY = 1  # a picture whose samples differ by less than this in no channel is of no lens: an empty buffer's
BANDS = 8
ROW_SPREAD_MAX = 2 * LED_SPREAD_MAX  # a row alone is noisier than a picture
BUSY_GREY = 3  # a row whose samples differ by less may be any picture's
ROW_LIT_MIN = 0.02  # of a row's samples: with fewer lit ones it is dark


class Light(StrEnum):
    """What a picture shows. UNCLEAR: lit, but by nothing that is known."""

    DARK = "dark"
    PROJECTOR = "projector"
    LED = "led"
    BOTH = "both"
    UNCLEAR = "unclear"


@dataclass(frozen=True, slots=True)
class Photometry:
    """Thumbnail statistics of one frame."""

    peak: float  # 99th percentile of the brightest channel, grey levels
    lit: float  # fraction of the samples brighter than a fifth of the peak
    spread: float  # brightness-weighted variance of chromaticity, 0..2/3
    bands: tuple[Light, ...] = ()  # of BANDS horizontal strips, from the top; empty: not looked at
    fingerprint: int | None = None  # 64 bits of the sampled pixels; the same for a picture handed over twice
    top: int | None = None  # 48 bits of the first row of samples; None: it is too plain to be known again
    bottom: int | None = None  # .. and of the last
    contrast: float = 0.0  # of one hue: difference over sum of neighbouring samples, along or across

    @property
    def light(self) -> Light:
        """Of the picture as a whole."""
        if self.peak < DARK_GREY:
            return Light.DARK
        if self.spread <= LED_SPREAD_MAX:
            return Light.PROJECTOR if self.striped else Light.LED
        if self.spread >= PROJECTOR_SPREAD_MIN:
            return Light.PROJECTOR
        return Light.BOTH if self.lit >= LIT_EVERYWHERE else Light.UNCLEAR

    @property
    def striped(self) -> bool:
        """Whether light of one hue comes in fringes."""
        return self.contrast >= STRIPED_MIN and self.peak >= STRIPED_PEAK

    @property
    def torn(self) -> bool:
        """Whether some band shows another lamp than the picture: two exposures in one."""
        light = self.light
        if light is Light.PROJECTOR:
            return any(band in (Light.LED, Light.BOTH, Light.UNCLEAR) for band in self.bands)
        return light is Light.LED and any(band in (Light.PROJECTOR, Light.BOTH) for band in self.bands)

    @property
    def unlit(self) -> tuple[bool, ...]:
        """Of each band of an LED picture, whether some of it is dark: a lens may be masked there, or a strip be of a
        projector picture, which is dark in places. Empty for others.
        """
        if self.light is not Light.LED:
            return ()
        return tuple(band in (Light.DARK, Light.UNCLEAR) for band in self.bands)


def measure(image: Image, green_first: bool = False) -> Photometry:
    """Statistics of a frame, (H, W, 3) BGR or (H, W) raw mosaic, which may begin with green. Red and blue are alike.

    Samples single pixels (or 2x2 cells), never averages: an average over a stripe's edge is white.
    """
    blue, green, red, sampled = _samples(image, green_first)
    fingerprint = _hashed(sampled, 8)
    top, bottom = (_hashed(row, 6) if np.ptp(row) >= BUSY_GREY else None for row in (sampled[0], sampled[-1]))
    brightest = np.maximum(np.maximum(blue, green), red)
    peak = _percentile(brightest, PEAK_SHARE)
    if all(np.ptp(channel) < EVEN_GREY for channel in (blue, green, red)):
        return Photometry(0.0, 0.0, 0.0, (Light.DARK,) * BANDS, fingerprint)
    row = np.ones(brightest.shape[1], np.float32)
    lit = ((brightest > LIT_OF_PEAK * peak).astype(np.float32) @ row).astype(np.float64) / len(row)
    # Of each row and channel: the light, and the light weighted with its share. What is too dark has no hue.
    share_of = np.reciprocal(np.maximum(blue + green + red, 1.0))
    share_of *= brightest > NOISE_GREY
    light, pure = np.empty((2, 3, len(lit)))
    for i, channel in enumerate((blue, green, red)):
        chromaticity = channel * share_of
        light[i] = (channel * (brightest > NOISE_GREY)) @ row
        pure[i] = np.einsum("ij,ij->i", channel, chromaticity)
    spread = float(spread_of(light.sum(1), pure.sum(1)))
    bands, contrast = (Light.DARK,) * BANDS, 0.0
    one_hue = spread <= LED_SPREAD_MAX
    if one_hue and peak >= STRIPED_PEAK:
        contrast = _contrast(brightest)
    if contrast >= STRIPED_MIN:
        bands = _striped_bands(brightest, lit)
    elif peak >= DARK_GREY:
        bands = _bands(lit, spread_of(light, pure), _off_hue(light) if one_hue else np.ones(len(lit)))
    return Photometry(peak, float(lit.mean()), spread, bands, fingerprint, top, bottom, contrast)


def _hashed(samples: Image, size: int) -> int:
    return int.from_bytes(blake2b(samples.data, digest_size=size).digest(), "little")


def _percentile(values: Float32Array, share: float) -> float:
    """numpy's, between its two neighbours, in a quarter of the time."""
    at = share * (values.size - 1)
    low = int(at)
    high = min(low + 1, values.size - 1)
    ordered = np.partition(values, (low, high), axis=None)
    return float(ordered[low] + (at - low) * (ordered[high] - ordered[low]))


def _off_hue(light: FloatArray) -> FloatArray:
    """Square of the distance of each row's chromaticity from the picture's."""
    rows = light / np.maximum(light.sum(0), 1e-9)
    whole = light.sum(1) / max(float(light.sum()), 1e-9)
    off: FloatArray = ((rows - whole[:, None]) ** 2).sum(0)
    return off


def _bands(lit: FloatArray, spread: FloatArray, off_hue: FloatArray) -> tuple[Light, ...]:
    """Each row is looked at alone, for a tear falls anywhere in a band: a row of white light has one hue, that of the
    picture or all over the row; a row of one stripe has one hue too, but another, and is mostly dark.
    """
    dark = lit < ROW_LIT_MIN
    white = ~dark & (spread <= ROW_SPREAD_MAX) & ((off_hue <= ROW_SPREAD_MAX) | (lit >= LIT_EVERYWHERE))
    bands = []
    for i in range(BANDS):
        band = slice(i * len(lit) // BANDS, (i + 1) * len(lit) // BANDS)
        rows, of_white, of_dark = len(lit[band]), int(white[band].sum()), int(dark[band].sum())
        if of_white == rows > 0:
            bands.append(Light.LED)
        elif of_white:
            bands.append(Light.UNCLEAR if of_white + of_dark == rows else Light.BOTH)
        else:
            bands.append(Light.DARK if of_dark == rows else Light.PROJECTOR)
    return tuple(bands)


def _contrast(bright: Float32Array) -> float:
    """The larger of both ways; stripes may lie along one."""
    ways = ((bright[1:], bright[:-1]), (bright[:, 1:], bright[:, :-1]))
    return max(float(np.abs(a - b).sum()) / max(float((a + b).sum()), 1.0) for a, b in ways)


def _striped_bands(bright: Float32Array, lit: FloatArray) -> tuple[Light, ...]:
    """Of a picture of fringes: a band that is lit without them is the LED's."""
    bands = []
    for i in range(BANDS):
        band = slice(i * len(lit) // BANDS, (i + 1) * len(lit) // BANDS)
        if not lit[band].max(initial=0.0) >= ROW_LIT_MIN:
            bands.append(Light.DARK)
        else:
            plain = lit[band].min() >= LIT_EVERYWHERE and _contrast(bright[band]) <= PLAIN_MAX
            bands.append(Light.LED if plain else Light.PROJECTOR)
    return tuple(bands)


def _samples(image: Image, green_first: bool) -> tuple[Float32Array, Float32Array, Float32Array, Image]:
    """Blue, green and red of every so many pixels, and one of them as it came."""
    step = max(1, min(image.shape[:2]) // THUMBNAIL_SIDE)
    if image.ndim == 3:
        pixels = image[step // 2 :: step, step // 2 :: step]
        blue, green, red = (pixels[..., i].astype(np.float32) for i in range(3))
        return blue, green, red, np.ascontiguousarray(pixels[..., 1])
    step = max(2, step + step % 2)  # stay on the mosaic's 2x2 cells
    rows, columns = (side // 2 * 2 for side in image.shape)
    cells = image[:rows, :columns]
    other, first = (0, 1) if green_first else (1, 0)  # columns: of the first row's green, of its other colour
    sampled = np.ascontiguousarray(cells[0::step, other::step])
    green = np.multiply(sampled.astype(np.float32) + cells[1::step, first::step], np.float32(0.5))
    blue = cells[1::step, other::step].astype(np.float32)
    return blue, green, cells[0::step, first::step].astype(np.float32), sampled
