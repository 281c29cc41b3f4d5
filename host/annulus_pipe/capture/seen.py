"""A frame as its label sees it, everything but its pixels, and what is found of it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from annulus_pipe.capture.photometry import Photometry
from annulus_pipe.capture.proof import Reason
from annulus_pipe.vocabulary import CameraSequence, Flash, Label


@dataclass(frozen=True, slots=True)
class FrameSeen:
    """A frame without its picture, but with what the picture shows."""

    sequence: CameraSequence | None  # None where the driver does not count
    timestamp_ns: int  # the driver's, host monotonic
    arrived_ns: int  # when we had it, host monotonic
    picture: Photometry
    metadata: Mapping[str, Any]


class Labelled(NamedTuple):
    """The verdict on one frame. `flash` is given whenever one was found, also where the label stays unknown."""

    label: Label
    flash: Flash | None  # fired after the opening edge
    reason: Reason
    residual_ns: int | None  # frame's moment minus its closing edge
    opened_ns: int | None = None  # host time of the opening edge
