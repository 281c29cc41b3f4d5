"""Two frames at one station made the pose of an LED frame a TypeError: equal places were ordered by their poses
(dc09097). Fails when the sort is not by place alone."""

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.profile import Profile
from annulus_pipe.wall.texture import HeadPath


def test_frames_at_one_station_have_no_order() -> None:
    nothing = np.zeros((0, 3), np.float32), np.zeros((0, 3), np.uint8), np.zeros(0, np.uint8), np.zeros(0, np.uint16)
    still = [Profile(frame, 7.0, Pose(tx=frame), *nothing) for frame in (1, 2)]
    pose = HeadPath(still).at(7.0)
    assert pose is not None and 1.0 <= pose.tx <= 2.0
