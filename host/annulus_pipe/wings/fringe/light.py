"""A slide of a sinusoid: stripes across one way, or rings whose phase is linear along a pipe (Alzuhiri 2022, §6.8).

Lens blur is not a filter over the image: it lowers the modulation where the phase changes fast from pixel to pixel, and
each harmonic by its own square.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from annulus_pipe.geometry.calibration import STILL, Calibration, matrix_of, vector_of
from annulus_pipe.numeric.arrays import Float32Array, FloatArray
from annulus_pipe.twin.rays import HeadPosition
from annulus_pipe.twin.worlds.world import World, tupled
from annulus_pipe.wings.fringe.measure import (
    FringeProjector,
    RingSlide,
    SlideLamp,
    lamps_to_list,
    projector_to_dict,
    ring_slide,
)


class FringeSlide:
    """The light of one of a world's `Fringes`. `axis` : of the slide's lens; `rims` : what it may light, rad."""

    kind = 1
    by_coordinate = True

    def __init__(self, light: "Fringes", number: int) -> None:
        fringe = light.slides[number]
        slide = fringe.slide
        self._slide = slide
        rotation = np.array(slide.rotation)
        self.axis = np.concatenate([np.array(slide.centre_mm), rotation[2]])
        if slide.mirror_mm:  # bright and shaded as from the ball's own image of the slide; in phase, each ray by itself
            middle, radius = np.array(slide.mirror_mm[:3]), slide.mirror_mm[3]
            away = float(np.linalg.norm(middle))
            image = (away - radius) * (1 + radius / (2 * away - radius)) / away * middle
            self.axis = np.concatenate([self.axis[:3] + image @ rotation, -middle @ rotation / away])
        wide = [math.radians(angle) for angle in fringe.field_deg]
        rings = slide.kind == "rings"
        self.rims = (wide[0], wide[1]) if rings else (0.0, math.atan(math.hypot(*(math.tan(w) for w in wide))))
        if slide.mirror_mm:
            self.rims = (0.0, math.pi / 2)
        self.brightest = 1.0 / light.reach_mm**2
        self._rotation = rotation
        numbers = [*np.tan(wide), light.modulation, *light.colour, *slide.numbers]
        self._numbers = np.array(numbers, np.float32)

    def coordinate(self, points: FloatArray) -> FloatArray:
        """(N, 3) mm in the head's frame -> (N,) rad: what the slide draws along."""
        return self._slide.phase(points)

    def table(self, pose: HeadPosition, z_mm: float) -> Float32Array:
        """The slide in one frame, as host/native/twin_fringes.c lists it."""
        return np.concatenate([(self._rotation @ pose.rotation).ravel(), self._numbers], dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Fringe:
    """One slide of a sinusoid, in the head's frame. field_deg : of rings the half-angles where they begin and end, of
    stripes half the field across them and along. cameras : numbers of those that look at its light, slots : of the lamp
    cycle at which it is lit; none: all."""

    slide: FringeProjector
    field_deg: tuple[float, float]
    cameras: tuple[int, ...] = ()
    slots: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Fringes:
    """A projector, or several, of static sinusoids. reach_mm : from the light straight to a wall that gets the peak."""

    slides: tuple[Fringe, ...]
    reach_mm: float
    modulation: float = 0.85  # of the light on the wall, where the lens is sharp
    peak: float = 190.0  # grey levels above black on that wall, lit for its nominal time
    colour: tuple[float, float, float] = (0.95, 1.0, 0.9)
    nominal_us: float = 5000.0
    rings: ClassVar[int] = 0

    @property
    def innermost(self) -> float:
        """Half-angle to the pipe at which light begins, rad; of stripes, which look across it, a right angle's half."""
        rings = [one.field_deg[0] for one in self.slides if one.slide.kind == "rings"]
        return math.radians(min(rings, default=45.0))

    @property
    def turns(self) -> int:
        return len(self.slides) if any(one.slots for one in self.slides) else 1

    def lit(self, slot: int | None) -> int:
        """Number of the slide that is lit at a slot of the lamp cycle."""
        return next((k for k, one in enumerate(self.slides) if not one.slots or slot in one.slots), 0)

    def looking(self, slot: int) -> tuple[int, ...]:
        return self.slides[self.lit(slot)].cameras

    def drawn(self) -> tuple[FringeSlide, ...]:
        return tuple(FringeSlide(self, number) for number in range(len(self.slides)))

    @staticmethod
    def designed(*wave: Any, out: Path) -> tuple[RingSlide, list[Path]]:
        """A slide for the pipes of a head, and its files. wave : as `ring_slide` takes it."""
        from annulus_pipe.wings.fringe.slide_drawing import write_ring_slide

        slide = ring_slide(*wave)
        return slide, list(write_ring_slide(slide, out))

    @classmethod
    def read(cls, data: Mapping[str, Any]) -> "Fringes":
        """Of `dataclasses.asdict`."""
        slides = tuple(
            tupled(Fringe, {**one, "slide": tupled(FringeProjector, one["slide"])}) for one in data["slides"]
        )
        return tupled(cls, {**data, "slides": slides})

    def calibration(self, world: World) -> Calibration:
        """Everything in the first camera's frame, as a file has it."""
        turn, moved = np.array(world.mounted[0]), np.array(world.mounted[1])
        lamps = []
        for one in self.slides:
            centre = turn @ np.array(one.slide.centre_mm) + moved
            slide = replace(
                one.slide, centre_mm=vector_of(centre), rotation=matrix_of(np.array(one.slide.rotation) @ turn.T)
            )
            lamps.append(SlideLamp(slide, one.cameras, one.slots))
        others = []
        for other in world.others:
            own = np.array(other.rotation) @ turn.T
            place = np.array(other.translation_mm) - own @ moved
            others.append(replace(other, rotation=matrix_of(own), translation_mm=vector_of(place)))
        several = len(lamps) > 1 or bool(lamps[0].cameras)
        lights = (
            {"projectors": lamps_to_list(lamps)} if several else {"projector": projector_to_dict(lamps[0].projector)}
        )
        beside: dict[str, Any] = {"transfer": {"sensor": "linear", "black": world.optics.black}}
        if world.mounted[0] != STILL:
            beside["pipe"] = {"rotation": turn.T.tolist(), "translation_mm": (-turn.T @ moved).tolist()}
        return Calibration(
            world.camera,
            "",
            (),
            world.radius_mm,
            others=tuple(others),
            pattern={"kind": "fringe", **lights},
            beside=beside,
        )
