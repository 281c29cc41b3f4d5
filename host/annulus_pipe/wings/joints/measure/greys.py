"""A volume's greys as parts of plastic: air 0, plastic 1, whatever scale, offset or sign the scanner stored them in.

A CT is grey = a density + b with any a and b: Hounsfield's scale has plastic near -100 and air at -1000, a photograph's
negative has plastic dark. All that follows works on density, so no measure can depend on the scale. What a
reconstruction did not compute, a frame or what lies outside a disc, is one constant of no meaning (0 is plastic's grey
in Hounsfield units): it is told by being one value in a corner of every slice, and is air here. Assumed: air and
plastic are the two commonest greys, and air surrounds the plastic.
"""

import cv2
import numpy as np

from annulus_pipe.numeric.arrays import BoolArray, Float32Array
from annulus_pipe.numeric.robust import robust_sigma
from annulus_pipe.vocabulary import AnnulusError
from annulus_pipe.wings.joints.measure.unwrap import Volume

LEVEL = 0.5  # of plastic: a surface blurred evenly to both sides is where the density crosses it
BINS = 512
CONTRAST_MIN = 3.0  # of plastic over air, in standard deviations of the quieter one
LOOKS = 12  # slices from which greys are learnt
EVERY = 2  # pixels of them
SAME = 0.9  # of those slices must have one value in a corner for it to be a constant: noise has it in one of ten
# Of a slice: a larger constant is air itself, cut off at a scale's end. A disc inscribed in its slice leaves 0.21 out.
CONSTANT_MAX = 0.5
FRAME = 2  # pixels at the border of what was computed, most of which must be air


class Densities:
    """A volume in parts of plastic. Reads the volume's slices as they are asked for."""

    def __init__(self, volume: Volume, air: float, plastic: float, constant: float | None) -> None:
        """constant : the grey of what was not computed, or None."""
        self._volume, self.air, self.plastic, self._constant = volume, air, plastic, constant
        self.shape, self.voxel_mm = volume.shape, volume.voxel_mm

    def slices(self, start: int, stop: int) -> Float32Array:
        """(stop - start, rows, columns) density: air 0, plastic 1."""
        grey = self._volume.slices(start, stop)
        density = ((grey - self.air) * (1 / (self.plastic - self.air))).astype(np.float32)
        if self._constant is not None:
            for before, after in zip(grey, density, strict=True):
                after[_not_computed(before, self._constant)] = 0.0
        return density


def densities(volume: Volume) -> Densities:
    """Air's and plastic's grey found, and the volume in parts of them.

    Raises AnnulusError where a grey is not finite, all is one grey, or no two greys are apart.
    """
    looks = np.unique(np.linspace(0, volume.shape[0] - 1, LOOKS).round().astype(int))
    slices = [volume.slices(int(z), int(z) + 1)[0] for z in looks]
    if not all(np.isfinite(one).all() for one in slices):
        raise AnnulusError("no plastic in the volume: expected finite greys of plastic and air")
    constant = _constant(slices)
    computed = [np.ones(one.shape, bool) if constant is None else ~_not_computed(one, constant) for one in slices]
    sample = [one[::EVERY, ::EVERY][use[::EVERY, ::EVERY]] for one, use in zip(slices, computed, strict=True)]
    dark, bright = two_greys(np.concatenate(sample))
    around = np.concatenate([one[_frame(use)] for one, use in zip(slices, computed, strict=True)])
    if np.median(around) > 0.5 * (dark + bright):
        dark, bright = bright, dark
    return Densities(volume, dark, bright, constant)


def two_greys(sample: np.ndarray) -> tuple[float, float]:
    """The darker and the brighter grey: medians on both sides of the threshold that parts the histogram best (Otsu)."""
    lowest, highest = np.percentile(sample, (0.1, 99.9))
    if not highest > lowest:
        raise AnnulusError("no plastic in the volume: all of it is one grey")
    count, edges = np.histogram(sample, BINS, (lowest, highest))
    middle = 0.5 * (edges[1:] + edges[:-1])
    below, moment = np.cumsum(count), np.cumsum(count * middle)
    with np.errstate(divide="ignore", invalid="ignore"):
        between = (moment[-1] * below / below[-1] - moment) ** 2 / (below * (below[-1] - below))
    level = middle[int(np.nanargmax(between[:-1]))]
    parts = sample[sample <= level], sample[sample > level]
    dark, bright = (float(np.median(part)) for part in parts)
    if bright - dark < CONTRAST_MIN * min(robust_sigma(part - np.median(part)) for part in parts):
        raise AnnulusError("no plastic in the volume: expected plastic and air, found no two greys apart")
    return dark, bright


def _constant(slices: list[Float32Array]) -> float | None:
    """The value that a corner has in nearly all slices, if it fills no more of them than a frame or a disc leaves."""
    for row, column in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        values, counts = np.unique([one[row, column] for one in slices], return_counts=True)
        value = float(values[np.argmax(counts)])
        if counts.max() < SAME * len(slices):
            continue
        if np.mean([_not_computed(one, value).mean() for one in slices]) <= CONSTANT_MAX:
            return value
    return None


def _not_computed(image: Float32Array, constant: float) -> BoolArray:
    """Where the constant hangs together from the border inwards: the same grey in the middle is a measurement."""
    _, part = cv2.connectedComponents((image == np.float32(constant)).astype(np.uint8), connectivity=4)
    at_border = np.zeros(part.max() + 1, bool)
    at_border[np.concatenate([part[0], part[-1], part[:, 0], part[:, -1]])] = True
    at_border[0] = False
    return np.asarray(at_border[part])


def _frame(computed: BoolArray) -> BoolArray:
    """The border of what was computed, FRAME pixels wide."""
    wide = np.ones((2 * FRAME + 1, 2 * FRAME + 1), np.uint8)
    core = cv2.erode(computed.astype(np.uint8), wide, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return np.asarray(computed & (core == 0))
