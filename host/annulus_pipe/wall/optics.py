"""What a head's optics may have drifted by since its calibration, before a frame is looked at: by what they are made of
and how much warmer they are.

A plastic lens grows by 1e-4 of its focal length a kelvin, a glass one by 3e-5: 0.1 % at 10 and at 35 K. Acrylic
lengthens by 7e-5, steel by 1.2e-5, aluminium by 2.3e-5, polyester film by 2e-5 and by 1e-5 a per cent of humidity,
glass by 8e-6. What a table says of one head is good to a half.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from annulus_pipe import untrusted

# Of length a kelvin, see above.
LENSES: Mapping[str, float] = {"plastic": 1e-4, "glass": 3e-5}
TUBES: Mapping[str, float] = {"acrylic": 7e-5, "steel": 1.2e-5, "aluminium": 2.3e-5}
SLIDES: Mapping[str, float] = {"film": 2e-5, "glass": 8e-6}
PARTS: Mapping[str, Mapping[str, float]] = {"lens": LENSES, "tube": TUBES, "slide": SLIDES}
KNOWN = 0.5  # of a coefficient: how well a table's is that of one head
# Standard deviations, parts of one. Without a temperature: 15 K either way of plastic and acrylic, a film in a season's
# humidity, a lens that was touched. With it: what is no matter of warmth. Guarded by test_scale.py, topic absolute.
FOCAL = 0.0015  # of the lens: focal length
SLIDE = 0.0015  # of the rings' angles
TUBE = 0.0025  # of the way from slide to camera
ANAMORPHIC = 0.001  # of a lens that draws one axis longer than the other; no matter of warmth
STILL = {"lens": 0.0003, "slide": 0.0005, "tube": 0.0005}
CELSIUS = (-60.0, 120.0)
KELVIN_MOST = 40.0  # warmer or colder than that since its calibration no head is: a sensor that is stuck
SAMPLES_LEAST = 3  # a single reading may be a slip of the bus


@dataclass(frozen=True, slots=True)
class Prior:
    """Means and standard deviations, parts of one, of focal length, slide and tube (of its length); of fy over fx the
    second only."""

    focal: float = FOCAL
    slide: float = SLIDE
    tube: float = TUBE
    anamorphic: float = ANAMORPHIC
    focal_mean: float = 0.0
    slide_mean: float = 0.0
    tube_mean: float = 0.0
    by: str = ""  # what narrows it, in words


@dataclass(frozen=True, slots=True)
class Optics:
    """[optics] of head.toml: what lens, slide and tube are made of, and how warm the head was when calibrated, degC."""

    lens: str = "plastic"
    slide: str = "film"
    tube: str = "acrylic"
    calibrated_c: float | None = None

    @classmethod
    def from_dict(cls, data: object, what: str = "[optics]") -> "Optics":
        """Of plain values, as TOML has them. Raises ValueError naming the key."""
        section = untrusted.mapping(data, what)
        named: dict[str, str] = {}
        for name, value in section.items():
            if name == "calibrated_c":
                continue
            if name not in PARTS:
                raise ValueError(
                    f"{what} {untrusted.shown(name)} is not known, expected lens, slide, tube or calibrated_c"
                )
            if not isinstance(value, str) or value not in PARTS[name]:
                raise ValueError(f"{what} {name} is {untrusted.shown(value)}, expected {' or '.join(PARTS[name])}")
            named[name] = value
        warm = section.get("calibrated_c")
        celsius = None if warm is None else untrusted.within(warm, f"{what} calibrated_c", *CELSIUS)
        return cls(**named, calibrated_c=celsius)

    def to_dict(self) -> dict[str, str | float]:
        out: dict[str, str | float] = {"lens": self.lens, "slide": self.slide, "tube": self.tube}
        return out if self.calibrated_c is None else {**out, "calibrated_c": self.calibrated_c}

    def prior(self, celsius: Iterable[float] = ()) -> Prior:
        """celsius : readings of the head's temperature during the scan."""
        known = [one for one in celsius if CELSIUS[0] <= one <= CELSIUS[1]]
        if self.calibrated_c is None or len(known) < SAMPLES_LEAST:
            return Prior()
        if abs(float(np.median(known)) - self.calibrated_c) > KELVIN_MOST:
            return Prior()
        kelvin, apart = float(np.median(known)) - self.calibrated_c, float(np.ptp(known)) / math.sqrt(12.0)
        mean, sigma = {}, {}
        for name, own in (("lens", self.lens), ("slide", self.slide), ("tube", self.tube)):
            rate = PARTS[name][own]
            mean[name] = rate * kelvin
            sigma[name] = math.hypot(STILL[name], KNOWN * rate * kelvin, rate * apart)
        return Prior(
            sigma["lens"],
            sigma["slide"],
            sigma["tube"],
            ANAMORPHIC,
            mean["lens"],
            mean["slide"],
            mean["tube"],
            f"the head was {kelvin:+.1f} K from its calibration's temperature",
        )
