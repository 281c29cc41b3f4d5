"""The worker process that turns projector frames into profiles. Run as `python -m annulus.daemon.reconstructing`."""

import os
import sys
from typing import Any

import cv2
import numpy as np

from annulus.geometry.calibration import Calibration
from annulus.geometry.pose import Pose
from annulus.record.recording import to_bgr
from annulus.rings.reconstructor import Reconstructor
from annulus.stream.frames import FrameHeader, Image
from annulus.stream.workers import serve


class Reconstructing:
    """A Reconstructor as a job. A frame's `extra` is the last known pose, four numbers, or None."""

    def __init__(self, calibration: Calibration) -> None:
        self._reconstructor = Reconstructor(calibration)
        camera = calibration.camera
        blank = np.zeros((camera.height, camera.width, 3), np.uint8)
        self._reconstructor.profile(blank, frame=0, z_mm=0.0)  # compiles now what the first frame would wait for

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        if header.z_mm is None:
            raise ValueError("no place along the pipe is known for this frame")
        seed = None if extra is None else Pose(*extra)
        picture = to_bgr(image, header.encoding)
        return self._reconstructor.profile(picture, frame=header.index, z_mm=header.z_mm, seed=seed).to_dict()

    def note(self, kind: str, body: Any) -> None:
        pass

    def idle(self) -> Any:
        return None

    def close(self) -> Any:
        return None


def _prepare(setup: Any) -> Reconstructing:
    os.nice(5)  # labels and recording come first
    cv2.setNumThreads(1)  # one process a core: threads would only fight over them
    return Reconstructing(Calibration.from_dict(setup["calibration"]))


if __name__ == "__main__":
    serve(sys.argv[-1], _prepare)
