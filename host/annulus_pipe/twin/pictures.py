"""Small pictures of a world, and what photometry says of them: the soak's camera shows one of these for each exposure.

Drawn once and kept: pictures lit evenly by one lamp, by both or by none, from some stations along the pipe and each
with noise of its own. What photometry says of them is measured once. An exposure takes one of those and a fingerprint
of its own, as no two real pictures are alike. Everything else, a flash that some rows missed and a torn picture, is
drawn or put together row by row, and measured, as it comes.
"""

from collections import OrderedDict

import numpy as np

from annulus_pipe.capture.photometry import Photometry, measure
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.twin.driver import PicturePart
from annulus_pipe.twin.image_sensor import UNLIT, Exposure
from annulus_pipe.twin.render import Renderer
from annulus_pipe.twin.worlds import World
from annulus_pipe.vocabulary import Lamp

STATIONS = 6
NOISES = 8
EVEN = 0.02  # of a lamp's nominal light: what counts as all of it
KEPT = 8  # pictures drawn for one exposure only: it may be asked for again
_BITS = (1 << 64) - 1


class WorldPictures:
    """Of one world. `travel_mm` of it is where the stations stand; z beyond begins anew."""

    def __init__(self, world: World, seed: int, camera: int = 0) -> None:
        self._world, self._seed = world, seed
        self._renderer = Renderer(world, camera)
        self._kept: dict[tuple[bool, bool, int | None, int, int], tuple[Image, Photometry]] = {}
        self._odd: OrderedDict[int, Image] = OrderedDict()
        self._blank = measure(np.zeros((world.camera.height, world.camera.width), np.uint8))

    def measured(self, parts: tuple[PicturePart, ...]) -> Photometry:
        """What photometry says of a picture."""
        if parts[0].bottom <= parts[0].top:
            return self._blank
        if len(parts) == 1:
            exposure = parts[0].exposure
            lit = _lit(exposure)
            if lit is not None:
                known = self._picture(exposure, lit)[1]
                return self._alone_of_its_kind(known, exposure, exposure)
            return self._alone_of_its_kind(measure(self._image(exposure)), exposure, exposure)
        height = self._world.camera.height
        image = np.empty((height, self._world.camera.width), np.uint8)
        for part in parts:
            rows = slice(round(part.top * height), round(part.bottom * height))
            image[rows] = self._image(part.exposure)[rows]
        return self._alone_of_its_kind(measure(image), parts[0].exposure, parts[-1].exposure)

    def _alone_of_its_kind(self, measured: Photometry, first: Exposure, last: Exposure) -> Photometry:
        """With fingerprints of the exposures that its first and last rows are of."""
        top = mixed = bottom = self._fingerprint(first)
        if first is not last:
            bottom = self._fingerprint(last)
            mixed = top ^ (bottom << 1 & _BITS)
        m = measured
        return Photometry(m.peak, m.lit, m.spread, m.bands, mixed, top >> 16, bottom >> 16, m.contrast)

    def _image(self, exposure: Exposure) -> Image:
        lit = _lit(exposure)
        if lit is not None:
            return self._picture(exposure, lit)[0]
        number = int(exposure.sequence)
        if number not in self._odd:
            z = exposure.z_mm % self._world.travel_mm
            lights, slot = (exposure.projector, exposure.led), _slot(exposure)
            drawn = self._renderer.render(self._world.pose(z), z, *lights, slot=slot, seed=number)
            self._odd[number] = drawn
            if len(self._odd) > KEPT:
                self._odd.popitem(last=False)
        return self._odd[number]

    def _picture(self, exposure: Exposure, lit: tuple[bool, bool]) -> tuple[Image, Photometry]:
        """One of those that are kept. Neighbours never share one."""
        station = int(exposure.z_mm % self._world.travel_mm / self._world.travel_mm * STATIONS)
        noise = int(exposure.sequence) % NOISES
        slot = _slot(exposure)
        key = (*lit, slot, station, noise)
        kept = self._kept.get(key)
        if kept is None:
            z = (station + 0.5) * self._world.travel_mm / STATIONS
            seed = 1 + noise + NOISES * station
            lights = (float(lit[0]), float(lit[1]))
            image = self._renderer.render(self._world.pose(z), z, *lights, slot=slot, seed=seed)
            kept = self._kept[key] = image, measure(image)
        return kept

    def _fingerprint(self, exposure: Exposure) -> int:
        """splitmix64 of the exposure's number."""
        x = (self._seed * 0x9E3779B97F4A7C15 + (int(exposure.sequence) + 1) * 0xD1B54A32D192ED03) & _BITS
        x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9 & _BITS
        x = (x ^ (x >> 27)) * 0x94D049BB133111EB & _BITS
        return x ^ (x >> 31)


def _slot(exposure: Exposure) -> int | None:
    """A slot at which the slide is lit that lit it."""
    return exposure.slides[0] if exposure.slides else None


def _lit(exposure: Exposure) -> tuple[bool, bool] | None:
    """(projector, LED) when each is all there or not at all, else None."""
    lit = []
    extremes = exposure.extremes
    for lamp in (Lamp.PROJECTOR, Lamp.LED):
        least, most = extremes[lamp]
        if most > UNLIT and not 1.0 - EVEN <= least <= most <= 1.0 + EVEN:
            return None
        lit.append(most > UNLIT)
    return lit[0], lit[1]
