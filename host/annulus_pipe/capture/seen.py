"""A frame as its label sees it: everything but its pixels."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from annulus_pipe.capture.photometry import Photometry
from annulus_pipe.vocabulary import CameraSequence


@dataclass(frozen=True, slots=True)
class FrameSeen:
    """A frame without its picture, but with what the picture shows."""

    sequence: CameraSequence | None  # None where the driver does not count
    timestamp_ns: int  # the driver's, host monotonic
    arrived_ns: int  # when we had it, host monotonic
    picture: Photometry
    metadata: Mapping[str, Any]
