"""The worker process that turns projector frames into profiles. Run as `python -m annulus.daemon.reconstructing`."""

import os
import sys
from typing import Any, cast

import cv2
import numpy as np

from annulus.geometry.calibration import Calibration
from annulus.geometry.cone import intersect_cylinder
from annulus.geometry.pose import Pose
from annulus.numeric.arrays import Image
from annulus.record.recording import to_bgr
from annulus.rings.reconstructor import Reconstructor
from annulus.stream.frames import FrameHeader
from annulus.stream.workers import serve

SLIT_HALF = 0.0035  # radians, about the real slide's


class Reconstructing:
    """A Reconstructor as a job. A frame's `extra` is the last known pose, four numbers, or None."""

    def __init__(self, calibration: Calibration) -> None:
        self._reconstructor = Reconstructor(calibration)
        # Compiles now what the first frame would wait for.
        self._reconstructor.profile(warmup_frame(calibration), frame=0, z_mm=0.0)

    def frame(self, header: FrameHeader, image: Image, extra: Any) -> Any:
        if header.z_mm is None:
            raise ValueError("no place along the pipe is known for this frame")
        seed = None if extra is None else Pose(*extra)
        picture = to_bgr(image, header.encoding)
        if not picture.flags.writeable:  # to numba a read-only array is another type: everything would compile again
            picture = picture.copy()
        return self._reconstructor.profile(
            picture, frame=header.index, z_mm=header.z_mm, seed=seed, roll_deg=header.roll_deg
        ).to_dict()

    def note(self, kind: str, body: Any) -> None:
        pass

    def idle(self) -> Any:
        return None

    def close(self) -> Any:
        return None


def warmup_frame(calibration: Calibration) -> Image:
    """Roughly what the camera sees in a clean pipe, head in the middle: (H, W, 3) BGR. Good for warming up only."""
    camera, step = calibration.camera, 4
    v, u = np.mgrid[0 : camera.height : step, 0 : camera.width : step]
    starts, rays = camera.lines(np.stack([u.ravel(), v.ravel()], axis=1).astype(float))
    with np.errstate(divide="ignore", invalid="ignore"):
        axis = np.array([0.0, 0.0, 1.0])
        wall = intersect_cylinder(rays, np.zeros(3), axis, calibration.pipe_radius_mm, starts)
        stripe, dark = np.zeros(len(rays), np.intp), ~(rays[:, 2] > 0) & camera.central
        for cone in calibration.rings:
            beam = wall - np.array(cone.vertex_mm)
            angle = np.arccos(np.clip(beam @ np.array(cone.axis) / np.linalg.norm(beam, axis=1), -1.0, 1.0))
            stripe += angle > cone.half_angle
            dark |= np.abs(angle - cone.half_angle) < SLIT_HALF
    paint = np.array([{"R": (8, 8, 180), "G": (8, 180, 8), "B": (180, 8, 8)}[c] for c in calibration.colours], np.uint8)
    picture = np.where(dark[:, None], np.uint8(4), paint[stripe]).reshape(*u.shape, 3)
    return cast(Image, cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_LINEAR))


def _prepare(setup: Any) -> Reconstructing:
    os.nice(5)  # labels and recording come first
    cv2.setNumThreads(1)  # one process a core: threads would only fight over them
    return Reconstructing(Calibration.from_dict(setup["calibration"]))


if __name__ == "__main__":
    serve(sys.argv[-1], _prepare)
