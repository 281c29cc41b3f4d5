"""Every camera comes through one door, and what it says is checked."""

from typing import Any

import numpy as np
import pytest

from annulus_pipe.capture.camera import BGR8, HeldRequest, OneRequest, grab
from annulus_pipe.vocabulary import AnnulusError


class Lying(OneRequest):
    metadata: dict[str, Any]
    image: Any

    def __init__(self) -> None:
        self.width, self.height, self.encoding = 6, 4, BGR8

    def capture_request(self) -> HeldRequest:
        return HeldRequest(self.image, self.metadata)


def test_a_frame_of_another_size_or_without_a_timestamp_is_not_let_in() -> None:
    camera = Lying()
    camera.image, camera.metadata = np.zeros((4, 7, 3), np.uint8), {"SensorTimestamp": 1}
    with pytest.raises(AnnulusError, match="4x7x3 came, expected uint8 4x6x3"):
        grab(camera)
    camera.image, camera.metadata = np.zeros((4, 6, 3), np.uint8), {}
    with pytest.raises(AnnulusError, match="SensorTimestamp None"):
        grab(camera)
