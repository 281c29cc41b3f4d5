"""Promises of the worker that reconstructs."""

import math

import pytest

from annulus_pipe.daemon.worker import ReconstructionJob
from annulus_pipe.geometry.calibration import Calibration
from annulus_pipe.geometry.camera import Camera
from annulus_pipe.geometry.cone import Cone
from annulus_pipe.reprocess.drawn import drawn_frame
from annulus_pipe.stream.frames import FrameHeader
from annulus_pipe.vocabulary import Label
from annulus_pipe.wall.profile import Profile

pytestmark = pytest.mark.deep(gate="tests/system/test_scan.py::test_a_scan_is_labelled_recorded_and_reconstructed")


def test_a_drawn_frame_goes_through_the_whole_method() -> None:
    """Of one that nobody can decode the pace of a machine would be measured too high."""
    rings = tuple(Cone(math.radians(full / 2), (0.0, 0.0, 1.0), (0.0, 0.0, -56.0)) for full in (38, 42, 47, 53, 58))
    calibration = Calibration(Camera("pinhole", 1664, 1232, 470.0, 470.0, 831.5, 615.5), "RRGBGR", rings, 76.2)
    job = ReconstructionJob(calibration)
    header = FrameHeader(4, None, 0, Label.PROJECTOR, "", None, None, None, 2.0, "bgr8", 1664, 1232)
    profile = Profile.from_dict(job.frame(header, drawn_frame(calibration), [0.0, 0.0, 0.0, 0.0]))
    assert profile.frame == 4 and profile.pose is not None
    assert len(profile.points_mm) > 0.8 * 5 * 720
