"""What is said of a point's error holds for drawn pipes, whose truth is known, and grows with what makes it worse."""

from dataclasses import replace

import numpy as np
from drawn import PIPE_MM, Paint, calibration, draw

from annulus_pipe.geometry.pose import Pose
from annulus_pipe.rings.reconstructor import Reconstructor

POSE = Pose(0.012, -0.01, 1.0, -1.5)


def looked(paint, cal=None, seed=0):
    cal = cal or calibration()
    return Reconstructor(cal, 360).profile(draw(cal, POSE, paint=paint, seed=seed), frame=0, z_mm=0.0)


def test_about_95_of_100_true_radii_lie_within_two_sigma_and_less_light_makes_them_less_certain():
    bright = looked(Paint(supersample=2, noise=5.0))
    error = np.hypot(*bright.points_mm[:, :2].T) - PIPE_MM
    assert len(error) > 1200 and 0.91 < np.mean(np.abs(error) <= 2 * bright.sigma_mm) < 0.995
    dim = looked(Paint(light=((90, 4, 2), (5, 80, 9), (2, 9, 70)), supersample=1, noise=5.0))
    assert np.median(dim.sigma_mm) > 1.2 * np.median(bright.sigma_mm)


def test_what_the_calibration_leaves_open_is_added_and_what_a_pose_takes_back_is_not():
    cal = calibration()
    rings = len(cal.rings)
    alike = np.zeros((6 * rings, 6 * rings))
    alike[3::6, 3::6] = 1.0  # all vertices are off to the side together by 1 mm: the head stands elsewhere, no more
    apart = np.zeros((6 * rings, 6 * rings))
    apart[0, 0] = np.radians(0.05) ** 2  # one half-angle is not known
    tables = []
    for covariance in (alike, apart):
        known = replace(cal, covariance=tuple(tuple(float(v) for v in row) for row in covariance))
        tables.append(Reconstructor(known, 72)._calibrated)
    together, first = tables
    assert together.max() < 0.3  # the camera stays where it is, so not all of it
    assert first[0].min() > 0.4 and first[0].min() > 15 * first[1:].max()
    assert not Reconstructor(cal, 72)._calibrated.any()
