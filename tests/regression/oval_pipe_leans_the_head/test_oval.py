"""An oval pipe made the pose lean, by 0.8 degrees at 2 % of ovality, to please half of the points (71a30c7). Fails when
the fit knows no twofold term of the radius (SHAPE_PRIOR = SHAPE_TOLERANCE = 1e-9)."""

import numpy as np

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.wall.pose import fit_pose

RADIUS_MM = 76.2


def test_an_oval_pipe_does_not_make_the_head_lean() -> None:
    rng, pose = np.random.default_rng(1), Pose(0.03, -0.02, 2.0, -1.5)
    phi, z = rng.uniform(0, 1.7 * np.pi, 4000), rng.uniform(60, 160, 4000)
    radius = RADIUS_MM + 0.02 * RADIUS_MM * np.cos(2 * phi + 0.4)
    points = pose.to_camera(np.stack([radius * np.cos(phi), radius * np.sin(phi), z], axis=1))
    fit = fit_pose(points + rng.uniform(-0.1, 0.1, points.shape), RADIUS_MM, np.ones(4000))
    assert fit is not None
    assert np.degrees(max(abs(fit.pose.rx - pose.rx), abs(fit.pose.ry - pose.ry))) < 0.003
    assert max(abs(fit.pose.tx - pose.tx), abs(fit.pose.ty - pose.ty)) < 0.005
