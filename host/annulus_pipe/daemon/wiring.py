"""What head.toml says of the wires between controller, lamps and cameras."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

from annulus_pipe.capture.timing import trigger_named
from annulus_pipe.controller import SLIDES_MAX
from annulus_pipe.daemon.camera_config import CameraConfig, Trigger
from annulus_pipe.link.pins import INVERTIBLE, check_slides
from annulus_pipe.untrusted import shown, whole
from annulus_pipe.vocabulary import AnnulusError

WATCHFUL = ("interlock", "end_low", "end_high")  # inputs that say unsafe when their wire breaks

SLIDES_RANGE = (1, SLIDES_MAX)


def inverted_pins(content: Mapping[str, Any]) -> tuple[str, ...]:
    """Of [controller]. Raises ValueError."""
    names = content.get("inverted", [])
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"[controller] inverted is {shown(names)}, expected a list of {', '.join(INVERTIBLE)}")
    for name in names:
        if name not in INVERTIBLE:
            why = ": a broken wire must say unsafe" if name in WATCHFUL else ""
            raise ValueError(f"[controller] inverted names {shown(name)}{why}, expected of {', '.join(INVERTIBLE)}")
    if len(set(names)) < len(names):
        raise ValueError(f"[controller] inverted is {shown(names)}, expected each pin once")
    return tuple(names)


def trigger_of(content: Mapping[str, Any]) -> Trigger:
    """Of [camera]. Raises ValueError."""
    try:
        return cast(Trigger, trigger_named(content.get("trigger", "none")))
    except AnnulusError as error:
        raise ValueError(f"[camera] {error}") from None


def slides_seen(content: Mapping[str, Any]) -> tuple[int, ...]:
    """Of [camera]: numbers of slides. Raises ValueError."""
    numbers = content.get("slides", [])
    if not isinstance(numbers, list) or len(numbers) > SLIDES_MAX:
        raise ValueError(f"[camera] slides is {shown(numbers)}, expected a list of at most {SLIDES_MAX} numbers")
    return tuple(sorted({whole(number, "[camera] slides", 0, SLIDES_MAX - 1) for number in numbers}))


def check_cycle(slides: int, ratio: int, cameras: Sequence[CameraConfig]) -> None:
    """Slides share the cycle evenly, and cameras name those there are. Raises ValueError."""
    try:
        check_slides(slides, ratio)
    except ValueError as error:
        raise ValueError(f"[lamps] {error}") from None
    for number, one in enumerate(cameras):
        if one.slides and one.slides[-1] >= slides:
            last = f"0 to {slides - 1}" if slides > 1 else "none where [lamps] slides is 1"
            raise ValueError(f"[camera] slides of camera {number} names {one.slides[-1]}, expected {last}")


def check_triggers(cameras: Sequence[CameraConfig]) -> None:
    """There is one trigger for all: they must want the same, and have time for it. Raises ValueError."""
    for one in cameras:
        try:
            _ = one.flash_timing
        except AnnulusError as error:
            raise ValueError(f"[camera] {error}") from None
    for one in cameras[1:]:
        if one.trigger != cameras[0].trigger:
            raise ValueError("[camera] trigger differs from camera to camera, but there is one line for all")
        if one.trigger != "none" and one.timing.exposure_us != cameras[0].timing.exposure_us:
            raise ValueError("[camera] exposure_us differs from camera to camera, but their trigger makes it")
