"""What head.toml says of the wires between controller, lamps and cameras."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

from annulus_pipe.capture.timing import trigger_named
from annulus_pipe.daemon.camera_config import CameraConfig, Trigger
from annulus_pipe.link.pins import INVERTIBLE
from annulus_pipe.untrusted import shown
from annulus_pipe.vocabulary import AnnulusError

WATCHFUL = ("interlock", "end_low", "end_high")  # inputs that say unsafe when their wire breaks


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
