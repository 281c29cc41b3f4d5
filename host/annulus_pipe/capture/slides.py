"""Which of a head's slides a camera sees, where they are lit in turn.

A camera that looks away from the slide that is lit gets nothing of it, or what spills over from the side: its picture
says nothing of that flash, and witnesses of time are left. The label is the flash's, as any frame's.
"""

from dataclasses import dataclass

from annulus_pipe.capture.photometry import Light
from annulus_pipe.vocabulary import Flash, Lamp

LIGHTS = {Lamp.PROJECTOR: Light.PROJECTOR, Lamp.LED: Light.LED, Lamp.DARK: Light.DARK}


@dataclass(frozen=True, slots=True)
class SlidesSeen:
    """count : slides that are lit in turn; at slot s slide s modulo count. seen : those that it sees; none: all."""

    count: int = 1
    seen: tuple[int, ...] = ()

    def blind(self, flash: Flash) -> bool:
        """Whether it sees nothing that it could tell this flash by."""
        return bool(self.seen) and flash.lamp is Lamp.PROJECTOR and int(flash.slot) % self.count not in self.seen

    def agrees(self, light: Light | None, flash: Flash) -> bool:
        """Whether a picture may be of this flash."""
        return light is LIGHTS[flash.lamp] or self.blind(flash)


ALL_SLIDES = SlidesSeen()
