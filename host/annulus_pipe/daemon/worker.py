"""The worker process that turns projector frames into profiles. Run as `python -m annulus_pipe.daemon.worker`."""

import os
import sys
from collections.abc import Sequence
from typing import Any

import cv2

from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.pose import Pose
from annulus_pipe.numeric.arrays import Image
from annulus_pipe.record.codec import to_picture
from annulus_pipe.reprocess.method import method_for
from annulus_pipe.rings.colour import ColourProfile
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.stream.working import serve


class ReconstructionJob:
    """A head's method as a job. A frame's `extra` is the last known pose, four numbers, or None."""

    def __init__(self, calibration: Calibration, colour: ColourProfile | None = None) -> None:
        self._joins = bool(calibration.others)  # its profiles say themselves which camera saw what
        self._method = method_for(calibration, colour)

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        return self.flash([(header, image)], extra)

    def flash(self, frames: Sequence[tuple[FrameHeader, Image]], extra: Any) -> Any:
        seed = None if extra is None else Pose(*extra)
        header = frames[0][0]
        images = {one.camera: to_picture(image, one.encoding) for one, image in frames}
        profile = self._method(header, images, seed).to_dict()
        return profile if self._joins else {**profile, "camera": header.camera}

    def note(self, kind: str, body: Any) -> None:
        pass

    def idle(self) -> Any:
        return None

    def close(self) -> Any:
        return None


def _prepare(setup: Any) -> ReconstructionJob:
    cv2.setNumThreads(1)  # one process a core: threads would only fight over them
    colour = None if setup["colour"] is None else ColourProfile.from_dict(setup["colour"])
    job = ReconstructionJob(Calibration.from_dict(setup["calibration"]), colour)
    os.nice(5)  # labels and recording come first; but nobody is to wait for a worker that is not up
    return job


if __name__ == "__main__":
    serve(sys.argv[-1], _prepare)
